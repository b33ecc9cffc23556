//! A table of stored throws as bytes: a header that names the robot, then records, each with its own checksum.

use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::path::Path;

use super::record::{Record, crc32, size};

const MAGIC: &[u8; 8] = b"CUBESTOR";
const VERSION: u32 = 2;
const HEADER: usize = 8 + 4 + 8 + 4;

fn header(robot: u64) -> [u8; HEADER] {
    let mut out = [0; HEADER];
    out[..8].copy_from_slice(MAGIC);
    out[8..12].copy_from_slice(&VERSION.to_le_bytes());
    out[12..20].copy_from_slice(&robot.to_le_bytes());
    let sum = crc32(&out[..20]);
    out[20..].copy_from_slice(&sum.to_le_bytes());
    out
}

/// The records of a table for the robot of `joints` joints with this fingerprint; `None` for the table of another robot or format, and for a damaged one.
#[must_use]
pub fn parse(bytes: &[u8], robot: u64, joints: usize) -> Option<Vec<Record>> {
    bytes
        .strip_prefix(&header(robot))?
        .chunks(size(joints))
        .map(|record| Record::from_bytes(joints, record))
        .collect()
}

/// The records of a table for any robot of `joints` joints.
#[must_use]
pub fn parse_any(bytes: &[u8], joints: usize) -> Option<Vec<Record>> {
    let robot = bytes.get(12..20)?.try_into().ok()?;
    parse(bytes, u64::from_le_bytes(robot), joints)
}

/// A whole table as bytes.
#[must_use]
pub fn to_bytes(robot: u64, records: &[Record]) -> Vec<u8> {
    let mut bytes = header(robot).to_vec();
    for record in records {
        bytes.extend_from_slice(&record.to_bytes());
    }
    bytes
}

/// Writes a file that appears complete or not at all; a special file (a pipe, a terminal) is written directly.
///
/// # Errors
/// If writing or renaming fails; nothing is left behind then.
pub fn write_whole(path: &Path, bytes: &[u8]) -> io::Result<()> {
    if path.exists() && !path.is_file() {
        return OpenOptions::new().write(true).open(path)?.write_all(bytes);
    }
    // Files that differ in their extension alone are written beside each other.
    let part = path.with_added_extension("part");
    let written = fs::write(&part, bytes).and_then(|()| fs::rename(&part, path));
    if written.is_err() {
        // That it cannot be removed either would change nothing.
        let _ = fs::remove_file(&part);
    }
    written
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_comes_back_and_one_that_is_damaged_or_of_another_robot_does_not() {
        let records = [Record::example(1.0), Record::example(2.0)];
        let bytes = to_bytes(7, &records);
        assert_eq!(parse(&bytes, 7, 6), Some(records.to_vec()));
        assert_eq!(parse(&bytes, 8, 6), None, "another robot");
        assert_eq!(parse(&bytes, 7, 5), None, "other joints");
        assert_eq!(parse(&bytes[..bytes.len() - 5], 7, 6), None, "cut");
        for at in [8, HEADER + 9] {
            let mut other = bytes.clone();
            other[at] ^= 1;
            assert_eq!(parse(&other, 7, 6), None, "byte {at}");
        }
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn what_is_no_ordinary_file_is_written_and_not_replaced() {
        let e = write_whole(Path::new("/dev/full"), b"anything").expect_err("full");
        assert_eq!(e.kind(), io::ErrorKind::StorageFull);
        assert!(!Path::new("/dev/full").is_file() && !Path::new("/dev/full.part").exists());
        let path = std::env::temp_dir().join(format!("cubectl-whole-{}", std::process::id()));
        write_whole(&path, b"anything").expect("writes");
        assert_eq!(fs::read(&path).expect("reads"), b"anything");
        assert!(!path.with_added_extension("part").exists());
        fs::remove_file(&path).expect("removes");
    }
}

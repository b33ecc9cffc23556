//! The store's file: a header that names the robot, then records, only ever appended.
//!
//! A record carries its own checksum, so a torn write or a flipped bit costs that record and nothing else. Damage is
//! reported, the damaged file is kept beside the store under another name, and the readable records are written again.
//! A store of an older format is kept the same way and a new one is begun. Who writes holds the file's advisory lock for
//! that moment, so that several planners can share a store.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use super::record::{Record, crc32, size};
use crate::throw::JOINTS;

const MAGIC: &[u8; 8] = b"CUBESTOR";
/// Version of the file format.
pub const VERSION: u32 = 2;
const HEADER: usize = 8 + 4 + 8 + 4;

/// The store could not be opened or written.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// Reading or writing failed.
    #[error("store {path}: {source}")]
    Io {
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// A folder or a device has that name.
    #[error("store {path} is not an ordinary file: name another store")]
    NoFile { path: PathBuf },
    /// The file was written by a newer program.
    #[error(
        "store {path} has format version {found}, this program reads up to {VERSION}: update cubectl, or name another store"
    )]
    Newer {
        path: PathBuf,
        /// Its version.
        found: u32,
    },
    /// The file was written by an older program; [`StoreFile::open`] keeps it and begins a new one.
    #[error(
        "store {path} has format version {found}, this program reads version {VERSION}: name another store, or let `plan throw` begin a new one"
    )]
    Older {
        path: PathBuf,
        /// Its version.
        found: u32,
    },
    /// Another process has held the lock for too long.
    #[error(
        "store {path} is locked by another process: wait until it ends, name another store with --store, or plan with --no-store"
    )]
    Locked { path: PathBuf },
    /// The file belongs to another robot, or the robot file has changed since.
    #[error(
        "store {path} was made for another robot or another version of its file (fingerprint {found:016x}, now {wanted:016x}): name another store, or remove it"
    )]
    OtherRobot {
        path: PathBuf,
        /// Fingerprint in the file.
        found: u64,
        /// Fingerprint of the robot in use.
        wanted: u64,
    },
}

/// What opening a store found.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct OpenReport {
    /// Records that were read.
    pub records: usize,
    /// Records (or a header) that were damaged and left out.
    pub damaged: usize,
    /// Version of the format, if it was an older one.
    pub older: Option<u32>,
    /// Where the damaged or older file was kept.
    pub kept_as: Option<PathBuf>,
}

#[derive(Debug)]
pub struct StoreFile<const N: usize = JOINTS> {
    path: PathBuf,
    robot: u64,
}

fn header(robot: u64) -> [u8; HEADER] {
    let mut out = [0; HEADER];
    out[..8].copy_from_slice(MAGIC);
    out[8..12].copy_from_slice(&VERSION.to_le_bytes());
    out[12..20].copy_from_slice(&robot.to_le_bytes());
    let sum = crc32(&out[..20]);
    out[20..].copy_from_slice(&sum.to_le_bytes());
    out
}

/// Reads the bytes of a store: records, and how many were damaged.
///
/// # Errors
/// If the bytes are of another version or another robot. A damaged header is not an error here: it counts as damage, and
/// records are still looked for behind it.
pub fn parse<const N: usize>(
    path: &Path,
    bytes: &[u8],
    robot: u64,
) -> Result<(Vec<Record<N>>, usize), StoreError> {
    let mut damaged = 0;
    let head = bytes.get(..HEADER).unwrap_or_default();
    let sound = head.len() == HEADER && head[..8] == *MAGIC && head[20..] == crc32(&head[..20]).to_le_bytes();
    if sound {
        let found = u32::from_le_bytes([head[8], head[9], head[10], head[11]]);
        if found > VERSION {
            return Err(StoreError::Newer { path: path.to_owned(), found });
        }
        if found < VERSION {
            // Records of another length: starts can be found again, so they are not worth a second reader.
            return Err(StoreError::Older { path: path.to_owned(), found });
        }
        let found = u64::from_le_bytes(std::array::from_fn(|i| head[12 + i]));
        if found != robot {
            return Err(StoreError::OtherRobot { path: path.to_owned(), found, wanted: robot });
        }
    } else {
        damaged += 1;
    }
    let mut records = Vec::new();
    let mut at = HEADER.min(bytes.len());
    while at < bytes.len() {
        match bytes.get(at..at + size(N)).and_then(Record::from_bytes) {
            Some(record) => {
                records.push(record);
                at += size(N);
            }
            None => {
                damaged += 1;
                // Look for the next sound record: bytes may have been lost, not only changed.
                at += 1;
                while at + size(N) <= bytes.len()
                    && Record::<N>::from_bytes(&bytes[at..at + size(N)]).is_none()
                {
                    at += 1;
                }
                if at + size(N) > bytes.len() {
                    break;
                }
            }
        }
    }
    Ok((records, damaged))
}

impl<const N: usize> StoreFile<N> {
    /// Opens or creates a store for the robot with this fingerprint and reads its records.
    ///
    /// # Errors
    /// [`StoreError`]; a damaged store is not an error but repaired, see [`OpenReport`].
    pub fn open(path: &Path, robot: u64) -> Result<(Self, Vec<Record<N>>, OpenReport), StoreError> {
        let fail = |source| StoreError::Io { path: path.to_owned(), source };
        if let Some(folder) = path.parent().filter(|p| !p.as_os_str().is_empty()) {
            fs::create_dir_all(folder).map_err(fail)?;
        }
        // A device may have no end.
        if fs::metadata(path).is_ok_and(|found| !found.is_file()) {
            return Err(StoreError::NoFile { path: path.to_owned() });
        }
        let mut file = open_locked(path)?;
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes).map_err(fail)?;
        let mut report = OpenReport::default();
        let mut records = Vec::new();
        if bytes.is_empty() {
            file.write_all(&header(robot)).map_err(fail)?;
        } else {
            let kept_as = match parse(path, &bytes, robot) {
                Ok((sound, 0)) => {
                    records = sound;
                    None
                }
                Ok((sound, damaged)) => {
                    records = sound;
                    report.damaged = damaged;
                    Some(free_name(path, "damaged"))
                }
                Err(StoreError::Older { found, .. }) => {
                    report.older = Some(found);
                    Some(free_name(path, &format!("version{found}")))
                }
                Err(e) => return Err(e),
            };
            if let Some(kept) = kept_as {
                fs::rename(path, &kept).map_err(fail)?;
                write_all(path, robot, &records).map_err(fail)?;
                report.kept_as = Some(kept);
            }
        }
        report.records = records.len();
        Ok((Self { path: path.to_owned(), robot }, records, report))
    }

    /// Appends a record and hands it to the system in one write.
    ///
    /// # Errors
    /// If the store stays locked or writing fails.
    pub fn append(&mut self, record: &Record<N>) -> Result<(), StoreError> {
        // Opened again: another process may have put a repaired file in its place.
        let mut file = open_locked(&self.path)?;
        let begun = file.metadata().map(|m| m.len() > 0);
        begun
            .and_then(|begun| if begun { Ok(()) } else { file.write_all(&header(self.robot)) })
            .and_then(|()| file.write_all(&record.to_bytes()))
            .map_err(|source| StoreError::Io { path: self.path.clone(), source })
    }
}

/// Opens a store to read and append, locked until the file is closed.
fn open_locked(path: &Path) -> Result<File, StoreError> {
    let fail = |source| StoreError::Io { path: path.to_owned(), source };
    for _ in 0..LOCK_TRIES {
        let file = OpenOptions::new().read(true).append(true).create(true).open(path).map_err(fail)?;
        match file.try_lock() {
            Ok(()) => return Ok(file),
            Err(TryLockError::WouldBlock) => std::thread::sleep(LOCK_PAUSE),
            // A file system without locks is as good as before there were any.
            Err(TryLockError::Error(e)) if e.kind() == io::ErrorKind::Unsupported => return Ok(file),
            Err(TryLockError::Error(e)) => return Err(fail(e)),
        }
    }
    Err(StoreError::Locked { path: path.to_owned() })
}

/// How long a lock is waited for: two seconds, a hundred times as long as a repair takes.
const LOCK_TRIES: usize = 100;
const LOCK_PAUSE: Duration = Duration::from_millis(20);

/// Writes a whole store; the file appears complete or not at all.
///
/// # Errors
/// If writing or renaming fails.
pub fn write_all<const N: usize>(path: &Path, robot: u64, records: &[Record<N>]) -> io::Result<()> {
    write_whole(path, &to_bytes(robot, records))
}

/// A whole store as bytes.
#[must_use]
pub fn to_bytes<const N: usize>(robot: u64, records: &[Record<N>]) -> Vec<u8> {
    let mut bytes = header(robot).to_vec();
    for record in records {
        bytes.extend_from_slice(&record.to_bytes());
    }
    bytes
}

/// Writes a file that appears complete or not at all; what is no ordinary file (a pipe, a terminal) is written as it is.
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

/// A name beside the store that is free.
fn free_name(path: &Path, what: &str) -> PathBuf {
    (1..)
        .map(|n| path.with_extension(format!("{what}-{n}")))
        .find(|p| !p.exists())
        .unwrap_or_else(|| path.with_extension(what))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(name: &str) -> PathBuf {
        let path = std::env::temp_dir().join(format!("cubectl-store-{name}-{}", std::process::id()));
        fs::create_dir_all(&path).expect("temporary folder");
        path
    }

    #[test]
    fn records_come_back_after_reopening() {
        let path = folder("reopen").join("throws.store");
        let _ = fs::remove_file(&path);
        let (mut store, none, _) = StoreFile::<6>::open(&path, 7).expect("opens");
        assert!(none.is_empty());
        store.append(&Record::<6>::example(1.0)).expect("writes");
        store.append(&Record::<6>::example(2.0)).expect("writes");
        let (_, records, report) = StoreFile::<6>::open(&path, 7).expect("opens");
        assert_eq!(records, [Record::<6>::example(1.0), Record::<6>::example(2.0)]);
        assert_eq!(report, OpenReport { records: 2, ..OpenReport::default() });
    }

    #[test]
    fn damage_costs_one_record_and_the_damaged_file_is_kept() {
        let path = folder("damage").join("throws.store");
        let _ = fs::remove_file(&path);
        let (mut store, _, _) = StoreFile::<6>::open(&path, 7).expect("opens");
        for r in [1.0, 2.0, 3.0, 4.0] {
            store.append(&Record::<6>::example(r)).expect("writes");
        }
        let mut bytes = fs::read(&path).expect("reads");
        bytes[HEADER + size(6) + 9] ^= 1;
        // The last write was torn.
        bytes.truncate(bytes.len() - 5);
        fs::write(&path, &bytes).expect("writes");
        let (_, records, report) = StoreFile::<6>::open(&path, 7).expect("opens");
        assert_eq!(records, [Record::<6>::example(1.0), Record::<6>::example(3.0)]);
        assert_eq!(report.damaged, 2);
        let kept = report.kept_as.expect("kept");
        assert_eq!(fs::read(kept).expect("reads"), bytes, "nothing is lost");
        assert_eq!(StoreFile::<6>::open(&path, 7).expect("opens").2.damaged, 0, "repaired");
    }

    #[test]
    fn other_robots_and_newer_versions_are_refused() {
        let path = folder("refuse").join("throws.store");
        let _ = fs::remove_file(&path);
        drop(StoreFile::<6>::open(&path, 7).expect("opens"));
        assert!(matches!(
            StoreFile::<6>::open(&path, 8),
            Err(StoreError::OtherRobot { found: 7, wanted: 8, .. })
        ));
        let mut bytes = header(7);
        bytes[8] = 9;
        let sum = crc32(&bytes[..20]).to_le_bytes();
        bytes[20..].copy_from_slice(&sum);
        fs::write(&path, bytes).expect("writes");
        assert!(matches!(StoreFile::<6>::open(&path, 7), Err(StoreError::Newer { found: 9, .. })));
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn what_is_no_ordinary_file_is_written_and_not_replaced() {
        let e = write_whole(Path::new("/dev/full"), b"anything").expect_err("full");
        assert_eq!(e.kind(), io::ErrorKind::StorageFull);
        assert!(!Path::new("/dev/full").is_file() && !Path::new("/dev/full.part").exists());
        let path = folder("whole").join("result");
        write_whole(&path, b"anything").expect("writes");
        assert_eq!(fs::read(&path).expect("reads"), b"anything");
        assert!(!path.with_extension("part").exists());
    }

    #[test]
    fn a_folder_or_a_device_is_refused_as_a_store() {
        let folder = folder("no-file");
        for path in [
            folder.as_path(),
            #[cfg(target_os = "linux")]
            Path::new("/dev/full"),
        ] {
            let refused = StoreFile::<6>::open(path, 7).map(|_| ()).expect_err("no file");
            assert!(matches!(refused, StoreError::NoFile { .. }), "{refused}");
        }
    }

    #[test]
    fn an_older_store_is_kept_and_a_new_one_begun() {
        let path = folder("older").join("throws.store");
        let _ = fs::remove_file(&path);
        let mut bytes = header(7).to_vec();
        bytes[8] = 1;
        let sum = crc32(&bytes[..20]).to_le_bytes();
        bytes[20..].copy_from_slice(&sum);
        bytes.extend_from_slice(b"records of another length");
        fs::write(&path, &bytes).expect("writes");
        let (mut store, none, report) = StoreFile::<6>::open(&path, 7).expect("opens");
        assert!(none.is_empty());
        assert_eq!((report.older, report.damaged), (Some(1), 0));
        assert_eq!(fs::read(report.kept_as.expect("kept")).expect("reads"), bytes, "nothing is lost");
        store.append(&Record::<6>::example(1.0)).expect("writes");
        assert_eq!(StoreFile::<6>::open(&path, 7).expect("opens").1, [Record::<6>::example(1.0)]);
    }

    #[test]
    fn a_locked_store_is_refused_by_name_and_two_planners_can_share_one() {
        let path = folder("locked").join("throws.store");
        let _ = fs::remove_file(&path);
        let (mut one, _, _) = StoreFile::<6>::open(&path, 7).expect("opens");
        let (mut two, _, _) = StoreFile::<6>::open(&path, 7).expect("opens");
        one.append(&Record::<6>::example(1.0)).expect("writes");
        two.append(&Record::<6>::example(2.0)).expect("writes");
        assert_eq!(StoreFile::<6>::open(&path, 7).expect("opens").1.len(), 2);
        let holder = File::open(&path).expect("opens");
        holder.lock().expect("locks");
        let refused = one.append(&Record::<6>::example(3.0)).expect_err("locked");
        assert!(refused.to_string().contains("locked by another process"), "{refused}");
    }
}

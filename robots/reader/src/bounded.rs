//! Files of bounded size.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

/// Longest description that is read, bytes: robots, scenarios, gains, settings. The largest that comes with the program
/// has 20 kB.
pub const DESCRIPTION_MAX_BYTES: u64 = 4 << 20;

/// Next step if the system refuses a file; `None` for other errors, and for those that the system did not report.
#[must_use]
pub fn next_of_file(error: &io::Error) -> Option<&'static str> {
    error.raw_os_error()?;
    Some(match error.kind() {
        io::ErrorKind::NotFound => {
            "check the name of the file; a name without a leading slash counts from the folder in which the command runs"
        }
        io::ErrorKind::PermissionDenied => {
            "ask for the right to the file and its folder (`ls -l`), or use another file"
        }
        io::ErrorKind::IsADirectory => "name a file in that folder",
        io::ErrorKind::NotADirectory => "check the folders in the name: one of them is a file",
        _ => return None,
    })
}

/// The bytes of a file.
///
/// # Errors
/// The error of the system; [`io::ErrorKind::FileTooLarge`] if there are more than `max_bytes`. No more than those are read.
pub fn read_bytes(path: &Path, max_bytes: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    File::open(path)?.take(max_bytes.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > max_bytes {
        let text =
            format!("the file has more than {max_bytes} bytes, the most that is read of this kind of file");
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, text));
    }
    Ok(bytes)
}

/// The text of a file.
///
/// # Errors
/// As [`read_bytes`]; [`io::ErrorKind::InvalidData`] if it is not UTF-8.
pub fn read_text(path: &Path, max_bytes: u64) -> io::Result<String> {
    String::from_utf8(read_bytes(path, max_bytes)?)
        .map_err(|error| io::Error::new(io::ErrorKind::InvalidData, error.utf8_error().to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_without_an_end_is_refused_after_the_bytes_that_are_allowed() {
        let error = read_text(Path::new("/dev/zero"), 1_000).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::FileTooLarge);
        assert!(error.to_string().contains("more than 1000 bytes"), "{error}");
    }

    #[test]
    fn a_file_of_exactly_the_bytes_that_are_allowed_is_read() {
        let path = std::env::temp_dir().join(format!("bounded-{}", std::process::id()));
        std::fs::write(&path, "abc\u{b5}").unwrap();
        assert_eq!(read_text(&path, 5).unwrap(), "abc\u{b5}");
        assert!(read_text(&path, 4).is_err());
        std::fs::write(&path, [0xFF]).unwrap();
        assert_eq!(read_text(&path, 5).unwrap_err().kind(), io::ErrorKind::InvalidData);
        std::fs::remove_file(&path).unwrap();
    }
}

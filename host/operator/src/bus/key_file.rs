//! The key of a controller: a file that only its owner can read.

use std::io::{self, Write};
use std::os::unix::fs::{OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};

use firmware::authority::Key;
use protocol::cyphal::cubecell::authorization::KEY_LEN;

/// Names the key file where `--key-file` does not.
pub const ENVIRONMENT: &str = "CUBECTL_KEY_FILE";
/// Group and others: read, write, execute.
const NOT_OWNER: u32 = 0o077;

/// Why a key file is not used.
#[derive(Debug, thiserror::Error)]
pub enum KeyFileError {
    /// It cannot be read or written.
    #[error("key file {path}: {source}")]
    Io { path: PathBuf, source: io::Error },
    /// Others can read or change it.
    #[error("key file {path}: others than its owner may use it (mode {mode:03o})")]
    Open {
        path: PathBuf,
        /// Its permissions.
        mode: u32,
    },
    #[error("key file {path}: not a key of {KEY_LEN} bytes in {} hexadecimal digits", 2 * KEY_LEN)]
    NoKey { path: PathBuf },
}

impl KeyFileError {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        Some(match self {
            Self::Io { .. } => {
                "name a key file that exists; `cubectl controller key make FILE` makes one".to_owned()
            }
            Self::Open { path, .. } => {
                format!("`chmod 600 {}`; if others could read it, make and set a new key", path.display())
            }
            Self::NoKey { .. } => "`cubectl controller key make FILE` makes one".to_owned(),
        })
    }
}

#[derive(Clone, Debug, Default, clap::Args)]
pub struct KeyArgs {
    /// File with the key of the controller, where it has one. Default: the file that the environment variable
    /// CUBECTL_KEY_FILE names.
    #[arg(long, value_name = "FILE", help_heading = "Bus")]
    pub key_file: Option<PathBuf>,
}

impl KeyArgs {
    /// The key, if one is named.
    pub fn load(&self) -> Result<Option<Key>, KeyFileError> {
        let named = self.key_file.clone().or_else(|| std::env::var_os(ENVIRONMENT).map(PathBuf::from));
        named.map(|path| read(&path)).transpose()
    }
}

/// Bytes of a key file that only its owner can use.
///
/// # Errors
/// [`KeyFileError`].
pub fn read_bytes(path: &Path) -> Result<[u8; KEY_LEN], KeyFileError> {
    let io = |source| KeyFileError::Io { path: path.to_owned(), source };
    let file = std::fs::File::open(path).map_err(io)?;
    let mode = file.metadata().map_err(io)?.permissions().mode() & 0o777;
    if mode & NOT_OWNER != 0 {
        return Err(KeyFileError::Open { path: path.to_owned(), mode });
    }
    let mut text = String::new();
    // A key and the end of its line: a longer file is not a key file.
    io::Read::read_to_string(&mut io::Read::take(file, 2 * KEY_LEN as u64 + 2), &mut text).map_err(io)?;
    parse(text.trim_end()).ok_or(KeyFileError::NoKey { path: path.to_owned() })
}

/// As [`read_bytes`].
pub fn read(path: &Path) -> Result<Key, KeyFileError> {
    read_bytes(path).map(Key::new)
}

fn parse(text: &str) -> Option<[u8; KEY_LEN]> {
    if text.len() != 2 * KEY_LEN || !text.is_ascii() {
        return None;
    }
    let mut bytes = [0; KEY_LEN];
    for (place, at) in bytes.iter_mut().zip((0..).step_by(2)) {
        // `from_str_radix` would take a sign.
        let digits = text.get(at..at + 2).filter(|digits| digits.bytes().all(|b| b.is_ascii_hexdigit()))?;
        *place = u8::from_str_radix(digits, 16).ok()?;
    }
    Some(bytes)
}

/// Makes a file with a key that only its owner can read. A file that exists is left alone.
///
/// # Errors
/// [`KeyFileError::Io`].
pub fn make(path: &Path, bytes: &[u8; KEY_LEN]) -> Result<(), KeyFileError> {
    let text: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
    let mut options = std::fs::File::options();
    let written = options
        .write(true)
        .create_new(true)
        .mode(0o600)
        .open(path)
        .and_then(|mut file| file.write_all((text + "\n").as_bytes()).and_then(|()| file.sync_all()));
    written.map_err(|source| KeyFileError::Io { path: path.to_owned(), source })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scratch(name: &str) -> PathBuf {
        let path = std::env::temp_dir().join(format!("cubectl-key-{name}-{}", std::process::id()));
        let _ = std::fs::remove_file(&path);
        path
    }

    #[test]
    fn a_made_key_is_read_back_is_for_its_owner_only_and_never_overwrites_a_file() {
        let path = scratch("made");
        let bytes = std::array::from_fn(|i| i as u8);
        make(&path, &bytes).unwrap();
        assert_eq!(read_bytes(&path).unwrap(), bytes);
        assert_eq!(std::fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
        assert!(matches!(make(&path, &[1; KEY_LEN]), Err(KeyFileError::Io { .. })));
        assert_eq!(read_bytes(&path).unwrap(), bytes);
        std::fs::remove_file(&path).unwrap();
    }

    #[test]
    fn a_key_file_that_others_can_use_or_that_holds_no_key_is_refused_and_its_text_is_not_printed() {
        let path = scratch("open");
        make(&path, &[7; KEY_LEN]).unwrap();
        for mode in [0o640, 0o604, 0o660, 0o610] {
            std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).unwrap();
            assert!(matches!(read(&path), Err(KeyFileError::Open { .. })), "{mode:o}");
        }
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o600)).unwrap();
        for text in ["", "00", &"g0".repeat(32), &"+0".repeat(32), &"00".repeat(33), &"ä".repeat(32)] {
            std::fs::write(&path, text).unwrap();
            let refused = read(&path).unwrap_err();
            assert!(matches!(refused, KeyFileError::NoKey { .. }), "{text}: {refused}");
            assert!(text.len() < 3 || !refused.to_string().contains(text), "{refused}");
        }
        std::fs::remove_file(&path).unwrap();
    }
}

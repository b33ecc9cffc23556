//! Permanent storage of a controller that runs as a program: one file.

use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;
use std::path::Path;

use firmware::store::{Area, Storage, StorageError};

/// Content of an erased byte, as in flash.
const ERASED: u8 = 0xFF;

/// The areas of a controller's storage one after the other in a file, which is locked while this lives.
///
/// Every write is on the disk when it returns: the store's promise (the old trajectory, the new one or none, never half
/// of one) holds for a power cut of the computer as it does for one of a board.
#[derive(Debug)]
pub struct FileStorage {
    file: File,
}

impl FileStorage {
    /// Opens the file, or makes it with all areas erased.
    ///
    /// # Errors
    ///
    /// The file cannot be opened, another program holds it ([`io::ErrorKind::WouldBlock`]), or it has another length than a
    /// storage file ([`io::ErrorKind::InvalidData`]): it is then left as it is.
    pub fn open(path: &Path) -> io::Result<Self> {
        let file = File::options().read(true).write(true).create(true).truncate(false).open(path)?;
        file.try_lock().map_err(|error| match error {
            std::fs::TryLockError::Error(error) => error,
            std::fs::TryLockError::WouldBlock => {
                io::Error::new(io::ErrorKind::WouldBlock, "another controller runs on this file")
            }
        })?;
        match file.metadata()?.len() {
            0 => {
                file.write_all_at(&vec![ERASED; total_len()], 0)?;
                file.sync_all()?;
            }
            len if len == total_len() as u64 => {}
            len => {
                let text = format!(
                    "not the storage of a controller: {len} bytes, a storage file has {}",
                    total_len()
                );
                return Err(io::Error::new(io::ErrorKind::InvalidData, text));
            }
        }
        Ok(Self { file })
    }
}

fn total_len() -> usize {
    Area::ALL.iter().map(|area| area.len()).sum()
}

/// Place in the file of `len` bytes at `offset` of an area.
fn place(area: Area, offset: usize, len: usize) -> Result<u64, StorageError> {
    let end = offset.checked_add(len).ok_or(StorageError)?;
    if end > area.len() {
        return Err(StorageError);
    }
    let before: usize =
        Area::ALL.iter().take_while(|earlier| **earlier != area).map(|earlier| earlier.len()).sum();
    Ok((before + offset) as u64)
}

impl Storage for FileStorage {
    fn erase(&mut self, area: Area) -> Result<(), StorageError> {
        self.write(area, 0, &vec![ERASED; area.len()])
    }

    fn write(&mut self, area: Area, offset: usize, data: &[u8]) -> Result<(), StorageError> {
        let at = place(area, offset, data.len())?;
        self.file.write_all_at(data, at).and_then(|()| self.file.sync_data()).map_err(|_| StorageError)
    }

    fn read(&self, area: Area, offset: usize, out: &mut [u8]) -> Result<(), StorageError> {
        let at = place(area, offset, out.len())?;
        self.file.read_exact_at(out, at).map_err(|_| StorageError)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use firmware::settings::Settings;
    use firmware::store::{Slot, load_settings, save_settings};

    /// A path of this test's own that is removed in the end.
    struct Scratch(std::path::PathBuf);

    impl Scratch {
        fn new(name: &str) -> Self {
            let path = std::env::temp_dir().join(format!("cubectl-{name}-{}", std::process::id()));
            let _ = std::fs::remove_file(&path);
            Self(path)
        }
    }

    impl Drop for Scratch {
        fn drop(&mut self) {
            let _ = std::fs::remove_file(&self.0);
        }
    }

    #[test]
    fn settings_saved_in_one_run_are_found_in_the_next() {
        let path = Scratch::new("settings");
        let mut settings = Settings::powercube6();
        settings.node_id = 33;
        let mut storage = FileStorage::open(&path.0).unwrap();
        assert_eq!(load_settings(&storage, &Settings::powercube6()).node_id, 10);
        save_settings(&mut storage, &settings).unwrap();
        drop(storage);
        let again = FileStorage::open(&path.0).unwrap();
        assert_eq!(load_settings(&again, &Settings::powercube6()), settings);
    }

    #[test]
    fn areas_do_not_touch_each_other_and_nothing_leaves_its_area() {
        let path = Scratch::new("areas");
        let mut storage = FileStorage::open(&path.0).unwrap();
        for (mark, area) in (1u8..).zip(Area::ALL) {
            storage.erase(area).unwrap();
            storage.write(area, 0, &vec![mark; area.len()]).unwrap();
            assert_eq!(storage.write(area, area.len(), &[0]), Err(StorageError));
            assert_eq!(storage.read(area, usize::MAX, &mut [0]), Err(StorageError));
        }
        for (mark, area) in (1u8..).zip(Area::ALL) {
            let mut bytes = vec![0; area.len()];
            storage.read(area, 0, &mut bytes).unwrap();
            assert!(bytes.iter().all(|byte| *byte == mark), "{area:?}");
        }
        storage.erase(Area::Bank(Slot::B)).unwrap();
        let mut first = [0];
        storage.read(Area::BankSeal(Slot::A), 0, &mut first).unwrap();
        assert_eq!(first, [3]);
    }

    #[test]
    fn foreign_file_and_a_file_in_use_are_refused_and_left_alone() {
        let path = Scratch::new("foreign");
        std::fs::write(&path.0, "a letter").unwrap();
        assert_eq!(FileStorage::open(&path.0).unwrap_err().kind(), io::ErrorKind::InvalidData);
        assert_eq!(std::fs::read(&path.0).unwrap(), b"a letter");
        std::fs::remove_file(&path.0).unwrap();
        let _held = FileStorage::open(&path.0).unwrap();
        assert_eq!(FileStorage::open(&path.0).unwrap_err().kind(), io::ErrorKind::WouldBlock);
    }
}

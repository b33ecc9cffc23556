//! What a board must provide: areas that are erased as a whole and written once.

use crate::credentials::KEY_LEN;
use crate::fault::{Cause, Refusal};
use crate::registers;
use crate::trajectory_format::FILE_LEN_MAX;

/// Bytes of a seal.
pub const RECORD_LEN: usize = 24;

/// One of two slots.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Slot {
    /// The first.
    #[default]
    A,
    /// The second.
    B,
}

impl Slot {
    /// The other one.
    #[must_use]
    pub const fn other(self) -> Self {
        match self {
            Self::A => Self::B,
            Self::B => Self::A,
        }
    }
}

/// Part of the storage that is erased as a whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Area {
    /// Trajectory file, [`FILE_LEN_MAX`] bytes.
    Bank(Slot),
    /// Seal of a trajectory bank, [`RECORD_LEN`] bytes.
    BankSeal(Slot),
    /// Settings, [`registers::STORED_LEN`] bytes.
    Settings(Slot),
    /// Seal of a settings slot, [`RECORD_LEN`] bytes.
    SettingsSeal(Slot),
    /// Key, [`KEY_LEN`] bytes.
    Key(Slot),
    /// Seal of a key slot, [`RECORD_LEN`] bytes.
    KeySeal(Slot),
}

impl Area {
    /// All of them.
    pub const ALL: [Self; 12] = [
        Self::Bank(Slot::A),
        Self::Bank(Slot::B),
        Self::BankSeal(Slot::A),
        Self::BankSeal(Slot::B),
        Self::Settings(Slot::A),
        Self::Settings(Slot::B),
        Self::SettingsSeal(Slot::A),
        Self::SettingsSeal(Slot::B),
        Self::Key(Slot::A),
        Self::Key(Slot::B),
        Self::KeySeal(Slot::A),
        Self::KeySeal(Slot::B),
    ];

    /// Bytes.
    pub const fn len(self) -> usize {
        match self {
            Self::Bank(_) => FILE_LEN_MAX,
            Self::Settings(_) => registers::STORED_LEN,
            Self::BankSeal(_) | Self::SettingsSeal(_) | Self::KeySeal(_) => RECORD_LEN,
            Self::Key(_) => KEY_LEN,
        }
    }

    /// False: no area is empty.
    pub const fn is_empty(self) -> bool {
        false
    }
}

/// The storage device failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StorageError;

impl From<StorageError> for Refusal {
    fn from(_: StorageError) -> Self {
        Self::of(Cause::StorageFailed)
    }
}

/// Permanent storage of a board.
///
/// Semantics like flash: an area is erased as a whole and then written once, in ascending order, in pieces. If
/// power fails during a call, any part of its data may have been written, and the rest of the area that it writes
/// may read as anything.
pub trait Storage {
    /// Makes an area ready to be written; its content is lost.
    ///
    /// # Errors
    ///
    /// The device failed; the area may hold anything.
    fn erase(&mut self, area: Area) -> Result<(), StorageError>;

    /// Writes `data` at `offset` of an area that was erased and not written there since.
    ///
    /// # Errors
    ///
    /// The device failed or the data ends outside the area; the area may hold anything.
    fn write(&mut self, area: Area, offset: usize, data: &[u8]) -> Result<(), StorageError>;

    /// Fills `out` from `offset` of an area.
    ///
    /// # Errors
    ///
    /// The device failed or `out` ends outside the area.
    fn read(&self, area: Area, offset: usize, out: &mut [u8]) -> Result<(), StorageError>;
}

/// Storage in RAM, lost at power off: for boards without permanent storage, simulation and tests.
#[derive(Clone)]
pub struct RamStorage {
    banks: [[u8; FILE_LEN_MAX]; 2],
    settings: [[u8; registers::STORED_LEN]; 2],
    keys: [[u8; KEY_LEN]; 2],
    seals: [[u8; RECORD_LEN]; 6],
}

impl RamStorage {
    /// Empty storage. Zeros, not the 0xFF of erased flash: so it takes no space in the start-up data of a board.
    pub const fn new() -> Self {
        Self {
            banks: [[0; FILE_LEN_MAX]; 2],
            settings: [[0; registers::STORED_LEN]; 2],
            keys: [[0; KEY_LEN]; 2],
            seals: [[0; RECORD_LEN]; 6],
        }
    }

    /// Content of an area.
    pub const fn bytes(&self, area: Area) -> &[u8] {
        let ([bank_a, bank_b], [settings_a, settings_b]) = (&self.banks, &self.settings);
        let ([key_a, key_b], [a, b, c, d, e, f]) = (&self.keys, &self.seals);
        match area {
            Area::Bank(Slot::A) => bank_a,
            Area::Bank(Slot::B) => bank_b,
            Area::Settings(Slot::A) => settings_a,
            Area::Settings(Slot::B) => settings_b,
            Area::BankSeal(Slot::A) => a,
            Area::BankSeal(Slot::B) => b,
            Area::SettingsSeal(Slot::A) => c,
            Area::SettingsSeal(Slot::B) => d,
            Area::Key(Slot::A) => key_a,
            Area::Key(Slot::B) => key_b,
            Area::KeySeal(Slot::A) => e,
            Area::KeySeal(Slot::B) => f,
        }
    }

    /// Content of an area, to change.
    pub const fn bytes_mut(&mut self, area: Area) -> &mut [u8] {
        let ([bank_a, bank_b], [settings_a, settings_b]) = (&mut self.banks, &mut self.settings);
        let ([key_a, key_b], [a, b, c, d, e, f]) = (&mut self.keys, &mut self.seals);
        match area {
            Area::Bank(Slot::A) => bank_a,
            Area::Bank(Slot::B) => bank_b,
            Area::Settings(Slot::A) => settings_a,
            Area::Settings(Slot::B) => settings_b,
            Area::BankSeal(Slot::A) => a,
            Area::BankSeal(Slot::B) => b,
            Area::SettingsSeal(Slot::A) => c,
            Area::SettingsSeal(Slot::B) => d,
            Area::Key(Slot::A) => key_a,
            Area::Key(Slot::B) => key_b,
            Area::KeySeal(Slot::A) => e,
            Area::KeySeal(Slot::B) => f,
        }
    }
}

impl Default for RamStorage {
    fn default() -> Self {
        Self::new()
    }
}

impl Storage for RamStorage {
    fn erase(&mut self, area: Area) -> Result<(), StorageError> {
        self.bytes_mut(area).fill(0xFF);
        Ok(())
    }

    fn write(&mut self, area: Area, offset: usize, data: &[u8]) -> Result<(), StorageError> {
        let end = offset.checked_add(data.len()).ok_or(StorageError)?;
        let place = self.bytes_mut(area).get_mut(offset..end).ok_or(StorageError)?;
        for (to, from) in place.iter_mut().zip(data) {
            *to = *from;
        }
        Ok(())
    }

    fn read(&self, area: Area, offset: usize, out: &mut [u8]) -> Result<(), StorageError> {
        let end = offset.checked_add(out.len()).ok_or(StorageError)?;
        let from = self.bytes(area).get(offset..end).ok_or(StorageError)?;
        for (to, from) in out.iter_mut().zip(from) {
            *to = *from;
        }
        Ok(())
    }
}

/// Storage by reference: a board may keep it in a static place.
impl<S: Storage> Storage for &mut S {
    fn erase(&mut self, area: Area) -> Result<(), StorageError> {
        (**self).erase(area)
    }

    fn write(&mut self, area: Area, offset: usize, data: &[u8]) -> Result<(), StorageError> {
        (**self).write(area, offset, data)
    }

    fn read(&self, area: Area, offset: usize, out: &mut [u8]) -> Result<(), StorageError> {
        (**self).read(area, offset, out)
    }
}

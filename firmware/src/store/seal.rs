//! The record that makes an area valid: written last, erased first.

use super::storage::{Area, RECORD_LEN, Storage, StorageError};
use crate::crc::Crc32;

const RECORD_MAGIC: u32 = 0x4C41_4553;

/// Content of a seal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Seal {
    pub(super) sequence: u32,
    pub(super) len: u32,
    pub(super) crc64: u64,
}

impl Seal {
    fn to_bytes(self) -> [u8; RECORD_LEN] {
        let mut bytes = [0; RECORD_LEN];
        let words = [RECORD_MAGIC, self.sequence, self.len, self.crc64 as u32, (self.crc64 >> 32) as u32];
        let (places, _) = bytes.as_chunks_mut::<4>();
        let mut crc = Crc32::new();
        for (place, word) in places.iter_mut().zip(words) {
            *place = word.to_le_bytes();
            crc.update(place);
        }
        if let Some(last) = places.last_mut() {
            *last = crc.get().to_le_bytes();
        }
        bytes
    }

    fn of(bytes: [u8; RECORD_LEN]) -> Option<Self> {
        let (body, crc) = bytes.split_last_chunk::<4>()?;
        let mut words = body.as_chunks::<4>().0.iter().map(|word| u32::from_le_bytes(*word));
        let magic = words.next()?;
        if magic != RECORD_MAGIC || Crc32::of(body) != u32::from_le_bytes(*crc) {
            return None;
        }
        let (sequence, len) = (words.next()?, words.next()?);
        let crc64 = u64::from(words.next()?) | u64::from(words.next()?) << 32;
        Some(Self { sequence, len, crc64 })
    }

    pub(super) fn read(storage: &impl Storage, area: Area) -> Option<Self> {
        let mut bytes = [0; RECORD_LEN];
        storage.read(area, 0, &mut bytes).ok()?;
        Self::of(bytes)
    }

    pub(super) fn write(self, storage: &mut impl Storage, area: Area) -> Result<(), StorageError> {
        storage.write(area, 0, &self.to_bytes())?;
        // Read back: a seal that cannot be read does not count.
        if Self::read(storage, area) == Some(self) { Ok(()) } else { Err(StorageError) }
    }
}

//! The two key slots. A slot without a key records that the key was removed.

use protocol::cyphal::crc::Crc64;

use super::seal::Seal;
use super::storage::{Area, Slot, Storage};
use crate::credentials::{KEY_LEN, Key};
use crate::fault::Refusal;

/// Stores the key, or the fact that there is no key, in the slot not in use; then erases the other slot.
///
/// # Errors
///
/// [`Cause::StorageFailed`](crate::fault::Cause::StorageFailed); what was stored before is still found.
pub fn save_key(storage: &mut impl Storage, key: Option<&Key>) -> Result<(), Refusal> {
    let (slot, sequence) =
        newest(storage).map_or((Slot::A, 1), |(slot, seal)| (slot.other(), seal.sequence.saturating_add(1)));
    let bytes: &[u8] = key.map_or(&[], |key| key.bytes());
    storage.erase(Area::KeySeal(slot))?;
    storage.erase(Area::Key(slot))?;
    storage.write(Area::Key(slot), 0, bytes)?;
    let seal = Seal { sequence, len: bytes.len() as u32, crc64: Crc64::of(bytes) };
    seal.write(storage, Area::KeySeal(slot))?;
    // The old key is no longer needed. If the power fails here, the newer slot still counts.
    storage.erase(Area::KeySeal(slot.other()))?;
    Ok(storage.erase(Area::Key(slot.other()))?)
}

/// The stored key, if there is one.
pub fn load_key(storage: &impl Storage) -> Option<Key> {
    let (slot, _) = newest(storage)?;
    read(storage, slot).map(|(_, key)| key)?
}

fn newest(storage: &impl Storage) -> Option<(Slot, Seal)> {
    let [a, b] = [Slot::A, Slot::B].map(|slot| read(storage, slot).map(|(seal, _)| (slot, seal)));
    match (a, b) {
        (Some(one), Some(two)) if two.1.sequence > one.1.sequence => Some(two),
        (Some(one), _) => Some(one),
        (None, two) => two,
    }
}

/// Seal and content of a slot that is complete.
fn read(storage: &impl Storage, slot: Slot) -> Option<(Seal, Option<Key>)> {
    let seal = Seal::read(storage, Area::KeySeal(slot))?;
    let mut bytes = [0; KEY_LEN];
    let bytes = bytes.get_mut(..seal.len as usize)?;
    storage.read(Area::Key(slot), 0, bytes).ok()?;
    if Crc64::of(bytes) != seal.crc64 {
        return None;
    }
    let key = <[u8; KEY_LEN]>::try_from(&*bytes).ok().map(Key::new);
    // Neither a whole key nor empty: `save_key` did not write it.
    (key.is_some() || bytes.is_empty()).then_some((seal, key))
}

//! The two settings slots.

use protocol::cyphal::crc::Crc64;

use super::seal::Seal;
use super::storage::{Area, Slot, Storage};
use crate::fault::Refusal;
use crate::registers;
use crate::settings::Settings;

/// Stores the settings in the slot not in use.
///
/// # Errors
///
/// [`Cause::StorageFailed`](crate::fault::Cause::StorageFailed); what was stored before is still found.
pub fn save_settings(storage: &mut impl Storage, settings: &Settings) -> Result<(), Refusal> {
    let [a, b] = [Slot::A, Slot::B].map(|slot| valid_settings(storage, slot));
    let (slot, sequence) = match (a, b) {
        (Some(one), Some(two)) if two > one => (Slot::A, two.saturating_add(1)),
        (Some(one), _) => (Slot::B, one.saturating_add(1)),
        (None, Some(two)) => (Slot::A, two.saturating_add(1)),
        (None, None) => (Slot::A, 1),
    };
    storage.erase(Area::SettingsSeal(slot))?;
    storage.erase(Area::Settings(slot))?;
    let (mut crc64, mut offset) = (Crc64::new(), 0);
    for index in 0..registers::REGISTERS_MAX {
        let Some(row) = registers::to_row(settings, index) else { continue };
        storage.write(Area::Settings(slot), offset, &row)?;
        crc64.update(&row);
        offset += row.len();
    }
    let seal = Seal { sequence, len: offset as u32, crc64: crc64.get() };
    Ok(seal.write(storage, Area::SettingsSeal(slot))?)
}

/// Stored settings over `defaults`. A setting that is unknown or out of range keeps its default; if the settings
/// together are inconsistent, all keep their defaults.
pub fn load_settings(storage: &impl Storage, defaults: &Settings) -> Settings {
    let [a, b] = [Slot::A, Slot::B].map(|slot| valid_settings(storage, slot));
    let slot = match (a, b) {
        (Some(one), Some(two)) if two > one => Slot::B,
        (Some(_), _) => Slot::A,
        (None, Some(_)) => Slot::B,
        (None, None) => return *defaults,
    };
    let mut settings = *defaults;
    for_each_row(storage, slot, |row| {
        registers::take_row(&mut settings, row);
    });
    if settings.check().is_ok() { settings } else { *defaults }
}

fn for_each_row<const N: usize>(
    storage: &impl Storage,
    slot: Slot,
    mut take: impl FnMut(&[u8; N]),
) -> Option<()> {
    let seal = Seal::read(storage, Area::SettingsSeal(slot))?;
    let mut row = [0; N];
    for index in 0..(seal.len as usize).checked_div(N)?.min(registers::REGISTERS_MAX) {
        storage.read(Area::Settings(slot), index * N, &mut row).ok()?;
        take(&row);
    }
    Some(())
}

/// Sequence number of a slot whose content matches its seal.
fn valid_settings(storage: &impl Storage, slot: Slot) -> Option<u32> {
    let seal = Seal::read(storage, Area::SettingsSeal(slot))?;
    let mut crc64 = Crc64::new();
    for_each_row::<{ registers::ROW_LEN }>(storage, slot, |row| crc64.update(row))?;
    (crc64.get() == seal.crc64).then_some(seal.sequence)
}

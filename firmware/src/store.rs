//! Permanent things: two trajectory banks, two settings slots, and what happens when power fails.
//!
//! # Rule
//!
//! A bank is runnable only through its *seal*, a small record with the file's length and checksums
//! and a sequence number, written last. The seal of a bank is erased before the bank is touched. At
//! start-up the valid seal with the highest number wins, and its file is checked again. So power may fail between
//! or within any two writes: the old trajectory is found, or the new one, or none, never half of one.
//! Settings go the same way: the slot not in use is erased and written, its record last.

use crate::crc::{Crc32, Crc64};
use crate::fault::{Cause, Refusal};
use crate::registers;
use crate::settings::Settings;
use crate::spline::Spline;
use crate::trajectory_format::{self, FILE_LEN_MAX, Header};

/// One of two.
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
}

impl Area {
    /// All of them.
    pub const ALL: [Self; 8] = [
        Self::Bank(Slot::A),
        Self::Bank(Slot::B),
        Self::BankSeal(Slot::A),
        Self::BankSeal(Slot::B),
        Self::Settings(Slot::A),
        Self::Settings(Slot::B),
        Self::SettingsSeal(Slot::A),
        Self::SettingsSeal(Slot::B),
    ];

    /// Bytes.
    pub const fn len(self) -> usize {
        match self {
            Self::Bank(_) => FILE_LEN_MAX,
            Self::Settings(_) => registers::STORED_LEN,
            Self::BankSeal(_) | Self::SettingsSeal(_) => RECORD_LEN,
        }
    }

    /// No area is empty.
    pub const fn is_empty(self) -> bool {
        false
    }
}

/// Storage could not do it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StorageError;

impl From<StorageError> for Refusal {
    fn from(_: StorageError) -> Self {
        Self::of(Cause::StorageFailed)
    }
}

/// Permanent storage of a board.
///
/// Semantics like flash: an area is erased as a whole and then written once, in ascending order, in
/// pieces. If power fails during a call, any part of what the call should have written may have been
/// written, and the rest of the area it touches may read as anything.
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

/// Storage that forgets: for boards without any, simulation and tests.
#[derive(Clone)]
pub struct RamStorage {
    banks: [[u8; FILE_LEN_MAX]; 2],
    settings: [[u8; registers::STORED_LEN]; 2],
    seals: [[u8; RECORD_LEN]; 4],
}

impl RamStorage {
    /// Holds nothing. Zeros, not the 0xFF of erased flash: a board keeps it out of its start-up data.
    pub const fn new() -> Self {
        Self {
            banks: [[0; FILE_LEN_MAX]; 2],
            settings: [[0; registers::STORED_LEN]; 2],
            seals: [[0; RECORD_LEN]; 4],
        }
    }

    /// Content of an area.
    pub const fn bytes(&self, area: Area) -> &[u8] {
        let ([bank_a, bank_b], [settings_a, settings_b], [a, b, c, d]) =
            (&self.banks, &self.settings, &self.seals);
        match area {
            Area::Bank(Slot::A) => bank_a,
            Area::Bank(Slot::B) => bank_b,
            Area::Settings(Slot::A) => settings_a,
            Area::Settings(Slot::B) => settings_b,
            Area::BankSeal(Slot::A) => a,
            Area::BankSeal(Slot::B) => b,
            Area::SettingsSeal(Slot::A) => c,
            Area::SettingsSeal(Slot::B) => d,
        }
    }

    /// Content of an area, to change.
    pub const fn bytes_mut(&mut self, area: Area) -> &mut [u8] {
        let ([bank_a, bank_b], [settings_a, settings_b], [a, b, c, d]) =
            (&mut self.banks, &mut self.settings, &mut self.seals);
        match area {
            Area::Bank(Slot::A) => bank_a,
            Area::Bank(Slot::B) => bank_b,
            Area::Settings(Slot::A) => settings_a,
            Area::Settings(Slot::B) => settings_b,
            Area::BankSeal(Slot::A) => a,
            Area::BankSeal(Slot::B) => b,
            Area::SettingsSeal(Slot::A) => c,
            Area::SettingsSeal(Slot::B) => d,
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

/// A board's storage may live in a static place of its own.
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

/// Bytes of a seal.
pub const RECORD_LEN: usize = 24;
const RECORD_MAGIC: u32 = 0x4C41_4553;

/// What a seal says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Seal {
    sequence: u32,
    len: u32,
    crc64: u64,
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

    fn read(storage: &impl Storage, area: Area) -> Option<Self> {
        let mut bytes = [0; RECORD_LEN];
        storage.read(area, 0, &mut bytes).ok()?;
        Self::of(bytes)
    }

    fn write(self, storage: &mut impl Storage, area: Area) -> Result<(), StorageError> {
        storage.write(area, 0, &self.to_bytes())?;
        // Read back: a seal that cannot be read is no seal.
        if Self::read(storage, area) == Some(self) { Ok(()) } else { Err(StorageError) }
    }
}

/// Name of a trajectory file: what a commit and a run refer to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FileName {
    /// CRC-64/WE of the whole file.
    pub crc64: u64,
    /// Bytes.
    pub len: u32,
}

/// The trajectory that may run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Committed {
    slot: Slot,
    sequence: u32,
    /// Its name.
    pub name: FileName,
    /// What its header says.
    pub header: Header,
}

/// File on its way in.
#[derive(Clone, Copy, Debug)]
struct Upload {
    len: usize,
    crc64: Crc64,
}

/// The two banks.
#[derive(Debug)]
pub struct TrajectoryStore {
    committed: Option<Committed>,
    upload: Option<Upload>,
}

impl TrajectoryStore {
    /// Nothing known yet.
    pub const fn new() -> Self {
        Self { committed: None, upload: None }
    }

    /// The trajectory that may run.
    pub const fn committed(&self) -> Option<&Committed> {
        self.committed.as_ref()
    }

    /// Name of what is in the upload bank so far.
    pub fn uploaded(&self) -> Option<FileName> {
        self.upload.map(|upload| FileName { crc64: upload.crc64.get(), len: upload.len as u32 })
    }

    /// Looks for the committed trajectory after power on and loads it into `spline`.
    pub fn find(&mut self, storage: &impl Storage, settings: &Settings, spline: &mut Spline) {
        (self.committed, self.upload) = (None, None);
        let [a, b] = [Slot::A, Slot::B].map(|slot| (slot, Seal::read(storage, Area::BankSeal(slot))));
        let newest_first = match (a.1, b.1) {
            (Some(one), Some(two)) if two.sequence > one.sequence => [b, a],
            _ => [a, b],
        };
        for (slot, seal) in newest_first {
            let Some(Seal { sequence, len, crc64 }) = seal else { continue };
            let name = FileName { crc64, len };
            if let Ok(header) = load(storage, slot, name, settings, spline) {
                self.committed = Some(Committed { slot, sequence, name, header });
                return;
            }
        }
        spline.clear(0);
    }

    /// The bank an upload goes to.
    fn upload_slot(&self) -> Slot {
        self.committed.map_or(Slot::A, |committed| committed.slot.other())
    }

    /// Takes the next piece of a file. A piece that came before is compared and passes again, so a
    /// lost answer does no harm; offset 0 with other content begins a new file.
    ///
    /// # Errors
    ///
    /// [`Cause::UploadOutOfOrder`], [`Cause::FileTooLong`], [`Cause::StorageFailed`].
    pub fn write(&mut self, storage: &mut impl Storage, offset: usize, data: &[u8]) -> Result<(), Refusal> {
        let slot = self.upload_slot();
        let bank = Area::Bank(slot);
        let end = offset.checked_add(data.len()).filter(|&end| end <= FILE_LEN_MAX);
        let Some(end) = end else { return Err(Refusal::of(Cause::FileTooLong)) };
        let have = self.upload.map_or(0, |upload| upload.len);
        if self.upload.is_some() && end <= have && same(storage, bank, offset, data)? {
            return Ok(());
        }
        if offset == 0 {
            self.upload = None;
            storage.erase(Area::BankSeal(slot))?;
            storage.erase(bank)?;
            self.upload = Some(Upload { len: 0, crc64: Crc64::new() });
        }
        let Some(upload) = self.upload.as_mut().filter(|upload| upload.len == offset) else {
            return Err(Refusal::of(Cause::UploadOutOfOrder));
        };
        match storage.write(bank, offset, data) {
            Ok(()) => {
                upload.len = end;
                upload.crc64.update(data);
                Ok(())
            }
            Err(error) => {
                self.upload = None;
                Err(error.into())
            }
        }
    }

    /// Reads back from the upload bank, else from the committed file; returns the bytes filled.
    ///
    /// # Errors
    ///
    /// [`Cause::StorageFailed`].
    pub fn read(&self, storage: &impl Storage, offset: usize, out: &mut [u8]) -> Result<usize, Refusal> {
        let (slot, len) = match (self.upload, self.committed) {
            (Some(upload), _) => (self.upload_slot(), upload.len),
            (None, Some(committed)) => (committed.slot, committed.name.len as usize),
            (None, None) => return Ok(0),
        };
        let count = len.saturating_sub(offset).min(out.len());
        let Some(out) = out.get_mut(..count) else { return Ok(0) };
        if count > 0 {
            storage.read(Area::Bank(slot), offset, out)?;
        }
        Ok(count)
    }

    /// Checks the uploaded file and makes it the one that may run; loads it into `spline`. A repeated
    /// commit of the committed file passes.
    ///
    /// # Errors
    ///
    /// Whatever check fails; the trajectory that was committed before then stays, and is loaded.
    pub fn commit(
        &mut self,
        storage: &mut impl Storage,
        name: FileName,
        settings: &Settings,
        spline: &mut Spline,
    ) -> Result<(), Refusal> {
        if self.upload.is_none() && self.committed.is_some_and(|committed| committed.name == name) {
            return Ok(());
        }
        let outcome = self.seal(storage, name, settings, spline);
        if outcome.is_err() {
            self.reload(storage, settings, spline);
        }
        outcome
    }

    fn seal(
        &mut self,
        storage: &mut impl Storage,
        name: FileName,
        settings: &Settings,
        spline: &mut Spline,
    ) -> Result<(), Refusal> {
        let uploaded = self.uploaded().ok_or(Refusal::of(Cause::FileIncomplete))?;
        if uploaded.len != name.len {
            return Err(Refusal::of(Cause::FileIncomplete));
        }
        if uploaded.crc64 != name.crc64 {
            return Err(Refusal::of(Cause::FileChecksum));
        }
        let slot = self.upload_slot();
        let header = load(storage, slot, name, settings, spline)?;
        let sequence = self.committed.map_or(1, |committed| committed.sequence.saturating_add(1));
        let seal = Seal { sequence, len: name.len, crc64: name.crc64 };
        seal.write(storage, Area::BankSeal(slot))?;
        self.committed = Some(Committed { slot, sequence, name, header });
        self.upload = None;
        Ok(())
    }

    fn reload(&mut self, storage: &impl Storage, settings: &Settings, spline: &mut Spline) {
        let loaded = self
            .committed
            .is_some_and(|committed| load(storage, committed.slot, committed.name, settings, spline).is_ok());
        if !loaded {
            self.committed = None;
            spline.clear(0);
        }
    }
}

impl Default for TrajectoryStore {
    fn default() -> Self {
        Self::new()
    }
}

fn same(storage: &impl Storage, area: Area, offset: usize, data: &[u8]) -> Result<bool, Refusal> {
    let mut bytes = [0; 64];
    for (index, piece) in data.chunks(64).enumerate() {
        let Some(bytes) = bytes.get_mut(..piece.len()) else { return Ok(false) };
        storage.read(area, offset + 64 * index, bytes)?;
        if bytes != piece {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Reads, names and checks the file of a bank.
fn load(
    storage: &impl Storage,
    slot: Slot,
    name: FileName,
    settings: &Settings,
    spline: &mut Spline,
) -> Result<Header, Refusal> {
    let len = name.len as usize;
    let mut crc64 = Crc64::new();
    let read = |offset: usize, out: &mut [u8]| -> Result<(), Refusal> {
        storage.read(Area::Bank(slot), offset, out)?;
        crc64.update(out);
        Ok(())
    };
    let header = trajectory_format::decode(len, read, spline)?;
    if crc64.get() != name.crc64 {
        return Err(Refusal::of(Cause::FileChecksum));
    }
    trajectory_format::check(&header, spline, settings)?;
    Ok(header)
}

/// Stores the settings in the slot not in use.
///
/// # Errors
///
/// [`Cause::StorageFailed`]; what was stored before is still found.
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
    for index in 0..registers::TABLE.len() {
        let Some(row) = registers::to_row(settings, index) else { continue };
        storage.write(Area::Settings(slot), offset, &row)?;
        crc64.update(&row);
        offset += row.len();
    }
    let seal = Seal { sequence, len: offset as u32, crc64: crc64.get() };
    Ok(seal.write(storage, Area::SettingsSeal(slot))?)
}

/// Stored settings over `defaults`; what is unknown or out of range keeps its default, and if the
/// whole does not go together all of it does.
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
    for index in 0..(seal.len as usize).checked_div(N)?.min(registers::TABLE.len()) {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::joints::PerJoint;
    use crate::trajectory_format::rest;

    /// Storage whose power fails after a number of bytes written or erased; a cut erase leaves the
    /// area half erased, and the next byte of a cut write is garbage.
    struct Failing {
        cells: RamStorage,
        left: usize,
    }

    impl Failing {
        fn spend(&mut self, wanted: usize) -> usize {
            let granted = wanted.min(self.left);
            self.left -= granted;
            granted
        }
    }

    impl Storage for Failing {
        fn erase(&mut self, area: Area) -> Result<(), StorageError> {
            let len = self.cells.bytes(area).len();
            let granted = self.spend(len);
            self.cells.bytes_mut(area)[..granted].fill(0xFF);
            if granted == len { Ok(()) } else { Err(StorageError) }
        }

        fn write(&mut self, area: Area, offset: usize, data: &[u8]) -> Result<(), StorageError> {
            let granted = self.spend(data.len());
            self.cells.write(area, offset, &data[..granted])?;
            if granted == data.len() {
                return Ok(());
            }
            self.cells.bytes_mut(area)[offset + granted] ^= 0x5A;
            Err(StorageError)
        }

        fn read(&self, area: Area, offset: usize, out: &mut [u8]) -> Result<(), StorageError> {
            self.cells.read(area, offset, out)
        }
    }

    fn file(q_rad: f32) -> Vec<u8> {
        let header = Header { joints: 6, period_us: 3_000, ..Header::default() };
        let mut out = vec![0; FILE_LEN_MAX];
        let len =
            trajectory_format::encode(&header, &rest(PerJoint::splat(q_rad), 500_000), &mut out).unwrap();
        out.truncate(len);
        out
    }

    fn name(file: &[u8]) -> FileName {
        FileName { crc64: Crc64::of(file), len: file.len() as u32 }
    }

    fn upload(store: &mut TrajectoryStore, storage: &mut impl Storage, file: &[u8]) -> Result<(), Refusal> {
        for (index, piece) in file.chunks(50).enumerate() {
            store.write(storage, 50 * index, piece)?;
        }
        Ok(())
    }

    fn find(storage: &impl Storage) -> (TrajectoryStore, Box<Spline>) {
        let (mut store, mut spline) = (TrajectoryStore::new(), Box::new(Spline::empty()));
        store.find(storage, &Settings::powercube6(), &mut spline);
        (store, spline)
    }

    #[test]
    fn committed_file_survives_a_restart_and_can_be_read_back() {
        let (mut storage, settings) = (Box::new(RamStorage::new()), Settings::powercube6());
        let (mut store, mut spline) = find(&*storage);
        assert!(store.committed().is_none());
        let first = file(0.1);
        upload(&mut store, &mut *storage, &first).unwrap();
        assert_eq!(store.commit(&mut *storage, name(&first), &settings, &mut spline), Ok(()));
        assert_eq!(
            store.commit(&mut *storage, name(&first), &settings, &mut spline),
            Ok(()),
            "again: harmless"
        );
        let (store, spline) = find(&*storage);
        assert_eq!(store.committed().unwrap().name, name(&first));
        assert!((spline.knots()[0].state.0[0].0 - 0.1).abs() < 1e-7);
        let mut back = vec![0; 500];
        let len = store.read(&*storage, 0, &mut back).unwrap();
        assert_eq!(back[..len], first);
    }

    #[test]
    fn power_cut_at_every_byte_leaves_the_old_trajectory_or_the_new_one() {
        let settings = Settings::powercube6();
        let (old, new) = (file(0.1), file(0.2));
        let mut sealed = Box::new(RamStorage::new());
        let (mut store, mut spline) = find(&*sealed);
        upload(&mut store, &mut *sealed, &old).unwrap();
        store.commit(&mut *sealed, name(&old), &settings, &mut spline).unwrap();
        let total = RECORD_LEN + FILE_LEN_MAX + new.len() + RECORD_LEN;
        let mut seen = [0, 0];
        // Every byte of the records and the file; the big erase only now and then.
        let steps = (0..RECORD_LEN + 8).chain((RECORD_LEN + 8..total - new.len() - RECORD_LEN).step_by(997));
        for left in steps.chain(total - new.len() - RECORD_LEN - 2..=total) {
            let mut storage = Failing { cells: (*sealed).clone(), left };
            let (mut store, mut spline) = find(&storage);
            let outcome = upload(&mut store, &mut storage, &new)
                .and_then(|()| store.commit(&mut storage, name(&new), &settings, &mut spline));
            if outcome.is_err() {
                // The controller goes on with what it had, without a restart.
                assert_eq!(store.committed().unwrap().name, name(&old));
            }
            let (store, spline) = find(&storage);
            let found = store.committed().expect("a trajectory was committed before").name;
            let is_new = found == name(&new);
            assert!(is_new || found == name(&old), "half a trajectory after {left} bytes");
            assert_eq!(is_new, left == total);
            assert!((spline.knots()[0].state.0[0].0 - if is_new { 0.2 } else { 0.1 }).abs() < 1e-7);
            seen[usize::from(is_new)] += 1;
        }
        assert!(seen[0] > 200 && seen[1] == 1);
    }

    #[test]
    fn power_cut_during_the_first_upload_leaves_none() {
        let new = file(0.2);
        for left in [0, 10, RECORD_LEN + FILE_LEN_MAX + 20, RECORD_LEN + FILE_LEN_MAX + new.len() + 5] {
            let mut storage = Failing { cells: RamStorage::new(), left };
            let (mut store, mut spline) = find(&storage);
            let outcome = upload(&mut store, &mut storage, &new)
                .and_then(|()| store.commit(&mut storage, name(&new), &Settings::powercube6(), &mut spline));
            assert!(outcome.is_err());
            assert!(find(&storage).0.committed().is_none());
        }
    }

    #[test]
    fn repeated_and_restarted_pieces_pass_and_gaps_do_not() {
        let mut storage = Box::new(RamStorage::new());
        let (mut store, mut spline) = find(&*storage);
        let (one, two) = (file(0.1), file(0.2));
        store.write(&mut *storage, 0, &one[..50]).unwrap();
        store.write(&mut *storage, 0, &one[..50]).unwrap();
        let gap = store.write(&mut *storage, 60, &one[60..]).unwrap_err();
        assert_eq!(gap.cause, Cause::UploadOutOfOrder);
        let long = store.write(&mut *storage, FILE_LEN_MAX, &[0]).unwrap_err();
        assert_eq!(long.cause, Cause::FileTooLong);
        assert_eq!(store.write(&mut *storage, usize::MAX, &[0]).unwrap_err().cause, Cause::FileTooLong);
        upload(&mut store, &mut *storage, &two).unwrap();
        let settings = Settings::powercube6();
        let wrong = store.commit(&mut *storage, name(&one), &settings, &mut spline).unwrap_err();
        assert_eq!(wrong.cause, Cause::FileChecksum, "a commit names what it commits");
        store.commit(&mut *storage, name(&two), &settings, &mut spline).unwrap();
    }

    #[test]
    fn file_that_breaks_a_limit_is_not_committed_and_the_old_one_stays_loaded() {
        let (mut storage, settings) = (Box::new(RamStorage::new()), Settings::powercube6());
        let (mut store, mut spline) = find(&*storage);
        let (good, bad) = (file(0.1), file(9.0));
        upload(&mut store, &mut *storage, &good).unwrap();
        store.commit(&mut *storage, name(&good), &settings, &mut spline).unwrap();
        upload(&mut store, &mut *storage, &bad).unwrap();
        let refused = store.commit(&mut *storage, name(&bad), &settings, &mut spline).unwrap_err();
        assert_eq!(refused.cause, Cause::PlanPosition);
        assert_eq!(store.committed().unwrap().name, name(&good));
        assert!((spline.knots()[0].state.0[0].0 - 0.1).abs() < 1e-7);
    }

    #[test]
    fn settings_survive_a_power_cut_at_every_byte_as_old_or_new() {
        let defaults = Settings::powercube6();
        let (mut old, mut new) = (defaults, defaults);
        (old.cycle_period_us, new.cycle_period_us) = (5_000, 7_000);
        let mut cells = Box::new(RamStorage::new());
        assert_eq!(load_settings(&*cells, &defaults), defaults);
        save_settings(&mut *cells, &old).unwrap();
        assert_eq!(load_settings(&*cells, &defaults), old);
        let total = 2 * (RECORD_LEN + registers::STORED_LEN);
        for left in (0..total).step_by(7).chain(total - RECORD_LEN - 1..=total) {
            let mut storage = Failing { cells: (*cells).clone(), left };
            let outcome = save_settings(&mut storage, &new);
            let found = load_settings(&storage, &defaults);
            assert_eq!(found, if outcome.is_ok() { new } else { old }, "after {left} bytes");
        }
    }
}

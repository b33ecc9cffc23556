//! Power cuts at every byte, restarts, wrong files.

use protocol::JointIndex;
use protocol::cyphal::crc::Crc64;

use super::*;
use crate::credentials::{KEY_LEN, Key, Peer};
use crate::fault::{Cause, Refusal};
use crate::joints::PerJoint;
use crate::registers;
use crate::settings::Settings;
use crate::spline::Spline;
use crate::trajectory_format::{self, FILE_LEN_MAX, Header, rest};

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
    let len = trajectory_format::encode(&header, &rest(PerJoint::splat(q_rad), 500_000), &mut out).unwrap();
    out.truncate(len);
    out
}

fn joint() -> JointIndex {
    JointIndex::new(0).unwrap()
}

fn name(file: &[u8]) -> FileName {
    FileName { crc64: Crc64::of(file), len: file.len() as u32 }
}

fn upload(store: &mut TrajectoryStore, storage: &mut impl Storage, file: &[u8]) -> Result<(), Refusal> {
    for (index, piece) in file.chunks(50).enumerate() {
        store.write(storage, Peer::LOCAL, 50 * index, piece)?;
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
    assert_eq!(store.commit(&mut *storage, name(&first), &settings, &mut spline), Ok(()), "again: harmless");
    let (store, spline) = find(&*storage);
    assert_eq!(store.committed().unwrap().name, name(&first));
    assert!((spline.start_rad(joint()) - 0.1).abs() < 1e-7);
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
    // Every byte of the records and the file; only some bytes of the long erase.
    let steps = (0..RECORD_LEN + 8).chain((RECORD_LEN + 8..total - new.len() - RECORD_LEN).step_by(997));
    for left in steps.chain(total - new.len() - RECORD_LEN - 2..=total) {
        let mut storage = Failing { cells: (*sealed).clone(), left };
        let (mut store, mut spline) = find(&storage);
        let outcome = upload(&mut store, &mut storage, &new)
            .and_then(|()| store.commit(&mut storage, name(&new), &settings, &mut spline));
        if outcome.is_err() {
            // The controller continues with what it had, without a restart.
            assert_eq!(store.committed().unwrap().name, name(&old));
        }
        let (store, spline) = find(&storage);
        let found = store.committed().expect("a trajectory was committed before").name;
        let is_new = found == name(&new);
        assert!(is_new || found == name(&old), "half a trajectory after {left} bytes");
        assert_eq!(is_new, left == total);
        assert!((spline.start_rad(joint()) - if is_new { 0.2 } else { 0.1 }).abs() < 1e-7);
        seen[usize::from(is_new)] += 1;
    }
    assert!(seen[0] > 200 && seen[1] == 1);
}

#[test]
fn power_cut_during_the_first_upload_leaves_no_committed_trajectory() {
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
    store.write(&mut *storage, Peer::LOCAL, 0, &one[..50]).unwrap();
    store.write(&mut *storage, Peer::LOCAL, 0, &one[..50]).unwrap();
    let gap = store.write(&mut *storage, Peer::LOCAL, 60, &one[60..]).unwrap_err();
    assert_eq!(gap.cause, Cause::UploadOutOfOrder);
    let long = store.write(&mut *storage, Peer::LOCAL, FILE_LEN_MAX, &[0]).unwrap_err();
    assert_eq!(long.cause, Cause::FileTooLong);
    assert_eq!(
        store.write(&mut *storage, Peer::LOCAL, usize::MAX, &[0]).unwrap_err().cause,
        Cause::FileTooLong
    );
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
    assert!((spline.start_rad(joint()) - 0.1).abs() < 1e-7);
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

/// Each save uses the slot with the older settings, A or B: a power cut never loses the newest.
#[test]
fn settings_saved_again_and_again_survive_a_power_cut_as_the_last_two() {
    let defaults = Settings::powercube6();
    let of = |period_us: u32| Settings { cycle_period_us: period_us, ..defaults };
    let mut cells = Box::new(RamStorage::new());
    save_settings(&mut *cells, &of(5_000)).unwrap();
    for period_us in [6_000, 7_000, 8_000, 9_000] {
        let total = 2 * (RECORD_LEN + registers::STORED_LEN);
        for left in (0..total).step_by(61) {
            let mut storage = Failing { cells: (*cells).clone(), left };
            let outcome = save_settings(&mut storage, &of(period_us));
            let found = load_settings(&storage, &defaults);
            let expected = if outcome.is_ok() { period_us } else { period_us - 1_000 };
            assert_eq!(found.cycle_period_us, expected, "after {left} bytes");
        }
        save_settings(&mut *cells, &of(period_us)).unwrap();
        assert_eq!(load_settings(&*cells, &defaults).cycle_period_us, period_us);
    }
}

/// After a power cut, a changed key is the old one or the new one; it is the new one as soon as its seal is written.
#[test]
fn key_that_is_changed_survives_a_power_cut_at_every_byte_as_old_or_new() {
    let key = |number: u8| Key::new([number; KEY_LEN]);
    let number = |storage: &Failing| load_key(storage).map(|key| key.bytes()[0]);
    let mut cells = Box::new(RamStorage::new());
    save_key(&mut *cells, Some(&key(1))).unwrap();
    for new in 2..6u8 {
        let (mut old_kept, mut new_early, mut done) = (0, 0, 0);
        for left in 0..=2 * (RECORD_LEN + KEY_LEN) + RECORD_LEN + KEY_LEN {
            let mut storage = Failing { cells: (*cells).clone(), left };
            let outcome = save_key(&mut storage, Some(&key(new)));
            match (outcome.is_ok(), number(&storage)) {
                (true, Some(found)) if found == new => done += 1,
                (false, Some(found)) if found == new => new_early += 1,
                (false, Some(found)) if found == new - 1 => {
                    old_kept += 1;
                    assert_eq!((new_early, done), (0, 0), "after {left} bytes");
                }
                found => panic!("{found:?} after {left} bytes of key {new}"),
            }
        }
        assert!(old_kept > 0 && new_early > 0 && done > 0, "{old_kept} {new_early} {done}");
        save_key(&mut *cells, Some(&key(new))).unwrap();
    }
}

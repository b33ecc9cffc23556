//! Permanent storage: two trajectory banks, two settings slots, two key slots, and what happens when power fails.
//!
//! `storage` is what a board provides, `seal` the record that makes an area valid, `trajectories`, `settings` and `key` the
//! contents.
//!
//! # Rule
//!
//! A bank is runnable only through its *seal*, a small record with the file's length and checksums and a sequence
//! number, written last. The seal of a bank is erased before the bank is changed. At start-up the valid seal with
//! the highest number is used, and its file is checked again. So power may fail between or within any two writes:
//! the controller finds the old trajectory, the new one, or no trajectory, never half of one. Settings and the key
//! are stored in the same way: the slot not in use is erased and written, its record last.

mod key;
mod seal;
mod settings;
mod storage;
#[cfg(test)]
mod tests;
mod trajectories;

pub use key::{load_key, save_key};
pub use settings::{load_settings, save_settings};
pub use storage::{Area, RECORD_LEN, RamStorage, Slot, Storage, StorageError};
pub use trajectories::{Committed, TrajectoryStore};

pub use crate::trajectory_format::FileName;

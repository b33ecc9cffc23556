//! The main job: from a plan and a bus to where the ball landed.
//!
//! ```text
//! plan ─▶ find the controller ─▶ drives ─▶ home ─▶ gains ─▶ to the start ─▶ upload ─▶ arm ─▶ throw ─▶ landing
//! ```
//!
//! | module | holds |
//! |---|---|
//! | [`trajectory`] | motions, and the one place where they become a controller's file |
//! | [`approach`] | motions from rest to rest around everything in the way |
//! | [`cell`](mod@cell) | the simulated cell that a plan reckons with |
//! | [`job`] | the steps above, in order, for any [operator](crate::port::Operator) |
//! | [`record`] | what a job is given, its steps, and what is known of it so far |
//! | [`outcome`] | how a throw ended: landed, missed, not released, stopped, and what is known where nobody watches |
//! | [`mod@summary`] | the run in numbers, as JSON |
//!
//! # Invariants
//!
//! * Nothing here prints or asks a person; the caller learns what begins and ends.
//! * Whatever ends a step early, the arm stands when it returns.

pub mod approach;
pub mod cell;
pub mod job;
pub mod outcome;
pub mod record;
pub mod summary;
pub mod trajectory;

pub use outcome::{Outcome, Verdict};
pub use record::{Job, JobError, Record, Step};

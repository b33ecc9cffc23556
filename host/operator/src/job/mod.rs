//! The one job: order to an arm, executed over any link, judged, and kept as one record.
//!
//! ```text
//! find the controller ─▶ drives ─▶ home ─▶ gains ─▶ to the start ─▶ upload ─▶ arm ─▶ run ─▶ flight ─▶ back
//! ```
//!
//! | module | holds |
//! |---|---|
//! | [`order`] | the order, made from a plan, and its judge |
//! | [`mod@perform`] | the steps above, in order, for any [operator](crate::port::Operator) |
//! | [`record`] | the steps, their data, and why a job ends early |
//! | [`verdict`] | how a job ended |
//! | [`throw`], [`follow`], [`reach`] | the judges: a ball released at an instant, by a hand that follows its flight; a motion |
//! | [`target`] | target of a motion, and the way there |
//! | [`cell`](mod@cell) | the simulated cell that a plan assumes |
//! | [`mod@summary`] | a record in numbers, as JSON |
//!
//! # Invariants
//!
//! * Nothing here prints or asks a person; the caller gets begin and end of each step.
//! * If a step ends early, for any reason, the arm stands when it returns.
//! * A stop that this program did not send ends the job, in every step.
//! * The record is complete when [`perform()`] returns: nothing is judged later.

pub mod cell;
pub mod follow;
pub mod order;
pub mod perform;
pub mod reach;
pub mod record;
pub mod summary;
pub mod target;
pub mod throw;
pub mod verdict;

pub use order::{Extent, Judge, Order, Program, Tolerances};
pub use perform::{Answer, OnProgress, Progress, Question, perform};
pub use record::{BallOutcome, JobError, Landing, LandingSource, Record, Start, Step};
pub use target::{Target, TargetError};
pub use throw::default_tolerance_m;
pub use verdict::{Outcome, Verdict};

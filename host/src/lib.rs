//! Host tools: the verbs of `cubectl`.
//!
//! # Map
//! An arrow goes from user to used; none goes up.
//!
//! ```text
//! complete            what a shell offers for the values of options
//!  |
//!  v
//! cli                 command line: which verb, with which arguments
//!  |
//!  v
//! cmd                 one verb per file
//!  |   \     \
//!  v    v     v
//! report trust error  summaries, HTML reports, pictures; throws with faults, judged from the plant; expected errors
//!    advice            command lines in messages, for the bus of the command that prints them
//!                |
//!                v
//!               exit  documented exit codes
//! ```
//!
//! `tables` has lists of targets and the part files of `plan sweep`.
//!
//! Everything else is in the packages below: `operator` (a throw as a job on a bus), `planner`, `tuner`.

#![warn(clippy::print_stdout, clippy::print_stderr)]

pub mod advice;
pub mod cli;
pub mod cmd;
pub mod complete;
pub mod error;
pub mod exit;
pub mod report;
mod tables;
pub mod trust;

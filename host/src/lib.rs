//! Host tools: the verbs of `cubectl`.
//!
//! # Map
//! An arrow goes from user to used; none goes up.
//!
//! ```text
//! cli                 command line: which verb, with which arguments
//!  |    \
//!  |     v
//!  |    program        what surrounds a verb: completions, the command line, how it ends; the same for `cubelab`
//!  |     |     \
//!  v     v      v
//! cmd  advice  complete  one verb per file; command lines in messages, for the bus of the command that prints them;
//!  |   \                 what a shell offers for the values of options
//!  v    v
//! report error         summaries, HTML reports, pictures; expected errors
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
pub mod program;
pub mod report;
mod tables;

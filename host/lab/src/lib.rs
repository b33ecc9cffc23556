//! Studies of arms that throw and catch: the verbs of `cubelab`. No program for arms depends on this package.
//!
//! # Map
//! An arrow goes from user to used; none goes up.
//!
//! ```text
//! cli                 command line: which verb, with which arguments
//!  |
//!  v
//! cmd                 one verb per file
//!  |   \      \
//!  v    v      v
//! report rally trust  page of a rally; two arms with a ball between them; throws with faults, judged from the plant
//! ```
//!
//! Exit codes, expected errors, reports and what surrounds a verb are those of `host`.

#![warn(clippy::print_stdout, clippy::print_stderr)]

pub mod cli;
pub mod cmd;
pub mod rally;
mod report;
pub mod trust;

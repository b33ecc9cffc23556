//! Host tools: the verbs of `cubectl`.
//!
//! # Map
//! | module | holds |
//! |---|---|
//! | [`cli`], [`cmd`] | command line; one verb per file |
//! | [`exit`], [`error`] | documented exit codes, expected errors |
//! | [`report`] | summaries, HTML reports, pictures |
//! | [`trust`] | throws with faults in the simulated cell, judged from the plant itself |

#![warn(clippy::print_stdout, clippy::print_stderr)]

pub mod cli;
pub mod cmd;
pub mod error;
pub mod exit;
pub mod report;
pub mod trust;

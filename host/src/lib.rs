//! Host tools: the verbs of `cubectl`.
//!
//! # Map
//! | module | holds |
//! |---|---|
//! | [`cli`], [`cmd`] | command line; one verb per file |
//! | [`exit`], [`error`] | documented exit codes, expected errors |
//! | [`report`] | summaries, HTML reports, pictures |
//! | [`bus`] | access to a bus: sessions in virtual and real time, requests to drives, bounded motions |
//! | [`mod@throw`] | the main job: from a plan to where the ball landed |
//! | [`log`] | recordings: candump text and MCAP; what their frames say |
//! | [`analysis`] | a recorded run against its plan: tracking, currents, timing, bus, events |
//! | [`trust`] | throws with faults in the simulated cell, judged from the plant itself |
//! | [`identify`] | experiments that measure the parameters of a drive |

#![warn(clippy::print_stdout, clippy::print_stderr)]

pub mod analysis;
pub mod bus;
pub mod cli;
pub mod cmd;
pub mod error;
pub mod exit;
pub mod identify;
pub mod log;
pub mod report;
pub mod throw;
pub mod trust;

//! A bus: opened from the `--bus` string, with the host's node on it and, if wanted, a controller of this program.
//!
//! # Map
//! From the bottom to the top; each file uses those above it in this table only.
//!
//! | modules | hold | must not |
//! |---|---|---|
//! | [`entropy`], [`key_file`], [`storage`] | random bytes of the operating system; key files; what a controller on this machine keeps | be used for tokens in virtual time |
//! | [`settings`] | settings of a controller for a robot | choose gains |
//! | [`failure`], `seen` | why a bus failed; its events in one step | recover |
//! | [`cycle_timing`], [`period`] | which control period machine and bus can keep, measured; the choice of one, with gains | move anything |
//! | [`soft`], [`sim`], [`live`] | a controller in a thread; the embedded cell in virtual time; a link in real time | know the task of a verb |
//! | [`session`] | time and frames for the host node, for every bus | know the task of a verb |
//! | [`args`] | options of every verb that uses a bus; opens the session | send anything |
//!
//! # Invariants
//!
//! * One node, [`crate::node::host_node::HostNode`], is the host. The same verb therefore runs unchanged with the
//!   simulated cell and with drives.
//! * Every frame in either direction passes the [`crate::tap::Tap`]s of the session, in order.
//! * Every motion is bounded: by a deadline, by reduced speed, by current; and a session that fails or is
//!   interrupted stops it before it returns.

pub mod args;
pub mod cycle_timing;
pub mod entropy;
pub mod failure;
pub mod key_file;
pub mod live;
pub mod period;
mod seen;
pub mod session;
pub mod settings;
pub mod sim;
pub mod soft;
pub mod storage;

pub use args::BusArgs;
pub use failure::BusFailure;
pub use session::{BIT_RATE_BIT_S, Ended, Session};

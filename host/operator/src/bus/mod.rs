//! A bus: opened from the `--bus` string, with the host's node on it and, if wanted, a controller of this program.
//!
//! # Map
//! From the bottom to the top; each file uses those above it in this table only.
//!
//! | modules | hold | must not |
//! |---|---|---|
//! | [`entropy`], [`key_file`], [`storage`] | random bytes of the operating system; key files; what a controller on this machine keeps | be used for tokens in virtual time |
//! | [`settings`], [`can_drives`] | settings of a controller for a robot, and the group of its drives | choose gains |
//! | [`failure`], `seen` | why a bus is lost; what it saw in one step | recover |
//! | [`cycle_timing`], [`period`] | which control period machine and bus hold, measured; the choice of one, with gains | move anything |
//! | [`soft`], [`sim`], [`live`] | a controller in a thread; the embedded cell in virtual time; a link in real time | know what a verb wants |
//! | [`session`] | time and frames for the host node, whatever the bus is | know what a verb wants |
//! | [`args`] | what every verb that touches a bus takes on its command line; opens the session | talk to anybody |
//!
//! # Invariants
//!
//! * One node, [`crate::node::host_node::HostNode`], speaks for the host. The same verb therefore runs unchanged against the
//!   simulated cell and against drives.
//! * Every frame in either direction passes the [`crate::tap::Tap`]s of the session, in order.
//! * What moves is bounded: by a deadline, by reduced speed, by current; and a session that fails or is
//!   interrupted stops it before it returns.

pub mod args;
pub mod can_drives;
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
pub use session::{Ended, Session};

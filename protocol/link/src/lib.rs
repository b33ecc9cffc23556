//! Links of the operating system to a CAN bus, and a runner that drives nodes on them in real time.
//!
//! # Map
//!
//! | layer | files | is | must not |
//! |---|---|---|---|
//! | spec | [`BusSpec`] | the `--bus` string, checked | open anything |
//! | contract | [`Link`], [`Event`], [`wait`] | what every link is: frames and bus errors in, frames out, never blocking | know a particular medium |
//! | media | [`socketcand`] | one folder per medium, client and server side | know another medium |
//! | runner | [`Runner`], [`Lateness`] | the loop of the [`protocol::Node`] contract on a link, with the monotonic clock | interpret a frame |
//!
//! # Invariants of the crate
//!
//! * No threads. A link works only inside the calls of its owner, so latency is the owner's own and
//!   nothing happens behind its back.
//! * No call but [`wait`] blocks, and every queue is bounded. What is dropped when a queue is full is
//!   written on the queue and counted in [`LinkStats`].
//! * Times are [`protocol::Instant`]s of one [`Clock`]: monotonic, zero when the clock was made.
//! * Expected failures say what happened, where, and what to do next.
//!
//! Unix only: waiting is `poll(2)`. SocketCAN needs Linux.

mod clock;
mod error;
mod lateness;
mod link;
mod runner;
pub mod socketcand;
mod spec;
mod stream;

pub use clock::Clock;
pub use error::{LinkError, OpenError, SendError};
pub use lateness::Lateness;
pub use link::{Event, Link, LinkStats, PollSet, wait};
pub use runner::{Direction, RunError, RunStats, Runner};
pub use spec::{BusSpec, SlcanPort, SpecError};

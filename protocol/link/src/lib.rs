//! Links of the operating system to a CAN bus, and a runner that drives nodes on them in real time.
//!
//! # Map
//!
//! | layer | files | is | must not |
//! |---|---|---|---|
//! | spec | [`BusSpec`] | the `--bus` string, checked | open anything |
//! | contract | [`CanLink`], [`LinkEvent`], [`wait`] | interface of every link: frames and bus errors in, frames out, never blocking | know a particular medium |
//! | many peers, one bus | [`Hub`], [`Station`] | the server's and the client's half of a text protocol: sockets, queues, fairness | know the texts |
//! | media | [`socketcand`], [`slcan`] | one folder per medium: the sequence of messages | open a socket of their own |
//! | | [`SocketCan`] | a CAN interface of Linux | |
//! | entry | [`open`], [`serve`] | from the spec to a link, as participant or as the bus | |
//! | runner | [`Runner`], [`Lateness`] | the loop of the [`protocol::Node`] contract on a link, with the monotonic clock | interpret a frame |
//! | system | [`Urgent`] | requests to the operating system for a thread that must not be late | fail when it is refused |
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

mod bus_error;
mod clock;
mod error;
mod hub;
mod lateness;
mod link;
mod net;
mod open;
mod runner;
mod serial;
pub mod slcan;
#[cfg(target_os = "linux")]
mod socket_can;
pub mod socketcand;
mod spec;
mod station;
mod stream;
mod urgent;

pub use bus_error::{BusError, Cause};
pub use clock::Clock;
pub use error::{LinkError, OpenError, SendError};
pub use hub::{ClientId, Hub, Relay, ServerEvent, ServerOptions};
pub use lateness::Lateness;
pub use link::{CanLink, LinkEvent, LinkStats, PollSet, wait};
pub use open::{BusServer, open, serve};
pub use runner::{Direction, RunError, RunStats, Runner};
#[cfg(target_os = "linux")]
pub use socket_can::SocketCan;
pub use spec::{BusSpec, LIVE_BUSES, RsiSpec, SlcanPort, SpecError, bus_of_option};
pub use station::Station;
pub use urgent::{Granted, Role, Urgent};

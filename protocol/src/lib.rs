//! All formats on the bus, and the contract of its participants.
//!
//! # Map
//!
//! | layer | modules | is | must not |
//! |---|---|---|---|
//! | base | [`id`], [`frame`], [`time`], [`units`], [`module`] | checked values: CAN ids, CAN frames (classical and FD), integer microseconds, physical units, wire address apart from joint number | know any higher protocol |
//! | wire | [`bits`] | exact length and CRC of a frame on the wire, longest and shortest length of its kind | know sender or time |
//! | drives | [`powercube`] | the M5 protocol of the modules, both directions, its tables and its DBC file | keep state between frames |
//! | | [`canopen`] | CiA 301 for a master and for its nodes, drives of CiA 402 | |
//! | | [`mit`] | MIT frames of Damiao motors | keep state between frames |
//! | | [`odrive`] | CANSimple of ODrives | keep state between frames |
//! | text | [`text`] | frames as lines for common tools: candump logs, SLCAN, socketcand | touch a socket, a file or a clock |
//! | contract | [`node`] | interface of a participant of the bus: frames and times in, frames and deadlines out | do IO, read a clock, sleep |
//! | host link | [`cyphal`] | Cyphal/CAN v1.0: transport, standard services, messages of this project | know the drives |
//!
//! # Invariants of the crate
//!
//! * `no_std`, no heap, no `unsafe`, and no path that panics: indexing is by `get`, arithmetic on
//!   foreign values saturates or is checked, every loop is bounded by a constant or a slice.
//! * Decoding never fails silently: a value that cannot be represented is an error that carries what
//!   was found, so that a bad frame can still be shown to a person.
//! * Numbers with a unit carry it in their type at the borders ([`units`]) and in their name inside.

#![warn(missing_docs)]
#![cfg_attr(not(test), no_std)]
#![cfg_attr(
    not(test),
    deny(
        clippy::unwrap_used,
        clippy::expect_used,
        clippy::panic,
        clippy::unreachable,
        clippy::indexing_slicing
    )
)]

pub mod bits;
pub mod canopen;
pub mod cyphal;
pub mod frame;
pub mod id;
pub mod mit;
pub mod module;
pub mod node;
pub mod odrive;
pub mod powercube;
pub mod text;
pub mod time;
pub mod units;

pub use frame::{FdFlags, Frame, FrameError, MAX_DATA_LEN};
pub use id::{ExtendedId, Id, IdError, StandardId};
pub use module::{JOINTS_MAX, JointIndex, ModuleId, RangeError};
pub use node::Node;
pub use time::{Duration, Instant};

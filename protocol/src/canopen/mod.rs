//! CANopen: CiA 301 for a master and for its nodes, and the drives of CiA 402.
//!
//! # Map
//!
//! | module | holds |
//! |---|---|
//! | [`id`] | which frame an id stands for: [`Function`] and [`NodeId`] |
//! | [`nmt`] | network management: commands, heartbeats |
//! | [`emcy`] | emergencies with their codes |
//! | [`sdo`] | service data: frames of both sides, abort codes |
//! | [`block`] | service data in blocks: frames of both sides, for reading |
//! | [`client`] | [`client::Transfer`]: one read or write of an object, expedited or in segments |
//! | [`long_read`] | [`long_read::LongRead`]: a read of an object of any length, in blocks or in segments |
//! | [`pdo`] | process data: mapped objects, their place in a frame, how a map is configured |
//! | [`cia402`] | state machine, modes, control and status words of a drive |
//!
//! Little-endian throughout. Remote frames are not used: node guarding and requested PDOs are left to other programs.
//!
//! # Sources
//!
//! The public contents of CiA 301 4.2.0 and CiA 402-2; frames of `canopen` 2.4.1, a public master, as vectors. No
//! real node was at hand.

pub mod block;
pub mod cia402;
pub mod client;
pub mod emcy;
pub mod id;
pub mod long_read;
pub mod nmt;
pub mod pdo;
pub mod sdo;

pub use id::{Function, NodeId};

use core::fmt;

/// An object of a node's dictionary.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Object {
    /// Index.
    pub index: u16,
    /// Sub-index.
    pub sub: u8,
}

impl Object {
    /// An object by index and sub-index.
    #[must_use]
    pub const fn new(index: u16, sub: u8) -> Self {
        Self { index, sub }
    }
}

impl fmt::Display for Object {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:04X}:{:02X}", self.index, self.sub)
    }
}

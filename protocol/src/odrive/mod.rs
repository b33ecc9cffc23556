//! CANSimple, the protocol of ODrive controllers, versions 0.5.6 and 0.6.x, both directions.
//!
//! # Map
//!
//! | module | holds |
//! |---|---|
//! | [`order`] | [`Order`]: messages of a host to an axis |
//! | [`report`] | [`Report`]: messages of an axis, by itself or on request; [`Request`]: the requests |
//!
//! # On the wire
//!
//! * id = node << 5 | command, 11 bits; little-endian; floats are IEEE-754 binary32. The form with 29-bit ids is not read.
//! * A request is a remote frame, or a data frame without data, on the id of its answer.
//! * **Positions and speeds are turns of the encoder's shaft.** The host applies gear ratio, sign and offset.
//! * A command may have more data than it needs: some programs pad to eight bytes. A command with less data is ignored.
//! * Both versions use the same ids for some different messages. A reader must know the version ([`Version`]); 0.6 reports its
//!   own ([`Report::Version`]), 0.5 does not answer that request.
//!
//! # Sources
//!
//! The maker's description; frames agree with the DBC files of `odrive-can` 2.1.0 (0.5.6 and 0.6.10). No real controller was at hand.

pub mod order;
pub mod report;

pub use order::{AxisState, Clipped, ControlMode, InputMode, NotFinite, Order, Sdo};
pub use report::{Errors, Heartbeat, Report, Request};

use core::fmt;

use crate::{Frame, Id, StandardId};

/// Which messages an axis understands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Version {
    /// 0.5.x; tables are those of 0.5.6.
    V05,
    /// 0.6.x; tables are those of 0.6.10.
    V06,
}

/// Number of an axis on its bus, 0 to 62. In 0.6, 63 means that it has no number yet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct NodeId(u8);

impl NodeId {
    /// `None` above 62.
    pub const fn new(id: u8) -> Option<Self> {
        if id < 63 { Some(Self(id)) } else { None }
    }

    /// The number.
    pub const fn get(self) -> u8 {
        self.0
    }
}

impl fmt::Display for NodeId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.0)
    }
}

/// Bits of the command in an id.
const COMMAND_BITS: u16 = 5;

fn id(node: NodeId, command: u8) -> Id {
    Id::Standard(StandardId::from_low_bits(u16::from(node.get()) << COMMAND_BITS | u16::from(command & 0x1F)))
}

fn frame<const N: usize>(node: NodeId, command: u8, data: [u8; N]) -> Frame {
    Frame::from_array(id(node, command), data)
}

/// Node and command of an 11-bit id.
fn parts(frame: &Frame) -> Option<(NodeId, u8)> {
    let Id::Standard(id) = frame.id() else { return None };
    Some((NodeId::new((id.get() >> COMMAND_BITS) as u8)?, (id.get() & 0x1F) as u8))
}

/// `N` bytes from `at` on.
fn bytes<const N: usize>(data: &[u8], at: usize) -> Option<[u8; N]> {
    data.get(at..)?.first_chunk::<N>().copied()
}

fn f32_at(data: &[u8], at: usize) -> Option<f32> {
    bytes(data, at).map(f32::from_le_bytes)
}

fn u32_at(data: &[u8], at: usize) -> Option<u32> {
    bytes(data, at).map(u32::from_le_bytes)
}

/// Two groups of four bytes.
const fn joined([a, b, c, d]: [u8; 4], [e, f, g, h]: [u8; 4]) -> [u8; 8] {
    [a, b, c, d, e, f, g, h]
}

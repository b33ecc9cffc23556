//! `cubecell.Stop.1.0`: stop the arm now.
//!
//! The only message sent with [`Priority::Exceptional`](crate::cyphal::id::Priority::Exceptional). Always one
//! frame; received on an [idempotent port](crate::cyphal::rx::Port::idempotent), so that repetition and a full
//! session table do no harm. The sender repeats it until the group state shows that it worked.

use super::super::bits::{Decode, DecodeError, Encode, Reader, Writer};
use super::super::id::SubjectId;
use super::super::rx::Port;

/// Default subject.
pub const SUBJECT: SubjectId = SubjectId::from_low_bits(1000);
/// Bytes of the message known here; its DSDL extent limits it to one frame.
pub const EXTENT: u16 = 4;
/// Full type name for the register `uavcan.sub.stop.type`.
pub const TYPE: &str = "cubecell.Stop.1.0";

/// The port on which to listen for it.
pub const fn port(subject: SubjectId) -> Port {
    Port::message(subject, EXTENT).idempotent()
}

/// Why; numbers that are not named here stop as well.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Reason(pub u8);

impl Reason {
    /// A person ordered it.
    pub const OPERATOR: Self = Self(1);
    /// The host program noticed something.
    pub const HOST: Self = Self(2);
    /// Another controller detected a fault.
    pub const CONTROLLER: Self = Self(3);
    /// A stop button or a safety input.
    pub const INPUT: Self = Self(4);
    /// The sender ends.
    pub const SHUTDOWN: Self = Self(5);
}

/// What kind of thing sent it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sender(pub u8);

impl Sender {
    /// The command-line tool.
    pub const CUBECTL: Self = Self(1);
    /// A controller that runs on the host.
    pub const SOFT_CONTROLLER: Self = Self(2);
    /// A controller on a board.
    pub const BOARD: Self = Self(3);
    /// An operator panel.
    pub const PANEL: Self = Self(4);
}

/// `cubecell.Stop`: halts all drives, from any sender.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stop {
    /// Reason of the stop; every value stops.
    pub reason: Reason,
    /// What kind of thing sent it; its node-ID is in the CAN id.
    pub sender: Sender,
    /// Number of the fault that caused it; 0 = none.
    pub detail: u16,
}

impl Encode for Stop {
    fn encode(&self, out: &mut Writer<'_>) {
        out.u8(self.reason.0);
        out.u8(self.sender.0);
        out.u16(self.detail);
    }
}

impl Decode<'_> for Stop {
    /// Any bytes are a stop; missing ones are zero.
    fn decode(input: &mut Reader<'_>) -> Result<Self, DecodeError> {
        Ok(Self { reason: Reason(input.u8()), sender: Sender(input.u8()), detail: input.u16() })
    }
}

//! `uavcan.node.Heartbeat.1.0`: each node reports once a second that it is alive, and its health.

use super::super::bits::{Decode, DecodeError, Encode, Reader, Writer};
use super::super::id::SubjectId;
use super::super::rx::Port;
use crate::time::Duration;

/// Fixed subject.
pub const SUBJECT: SubjectId = SubjectId::from_low_bits(7509);
/// Bytes of the message: one frame.
pub const EXTENT: u16 = 7;
/// Longest time between two heartbeats of a node.
pub const PERIOD: Duration = Duration::from_secs(1);
/// A node silent for this long is offline.
pub const OFFLINE_TIMEOUT: Duration = Duration::from_secs(3);

/// The port on which to listen for it: one frame that may come twice, so no session is needed.
pub const PORT: Port = Port::message(SUBJECT, EXTENT).idempotent();

/// How a node is, worst last (`uavcan.node.Health.1.0`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Health {
    /// Works.
    #[default]
    Nominal = 0,
    /// Something minor that may go away.
    Advisory = 1,
    /// Serious degradation, or nearly out of range.
    Caution = 2,
    /// Cannot work.
    Warning = 3,
}

/// What a node is doing (`uavcan.node.Mode.1.0`), 0..=7; 4..=7 are reserved.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Mode(u8);

impl Mode {
    /// Does its work.
    pub const OPERATIONAL: Self = Self(0);
    /// Starting up.
    pub const INITIALIZATION: Self = Self(1);
    /// Calibration, self-test and the like.
    pub const MAINTENANCE: Self = Self(2);
    /// New software is being loaded.
    pub const SOFTWARE_UPDATE: Self = Self(3);

    /// The number, 0..=7.
    pub const fn get(self) -> u8 {
        self.0
    }
}

/// `uavcan.node.Heartbeat`, sent once per second.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Heartbeat {
    /// Seconds since the node started; stays at the largest number.
    pub uptime_s: u32,
    /// Health, as the node judges it.
    pub health: Health,
    /// Whether it works, starts, or is in maintenance.
    pub mode: Mode,
    /// Free for the maker of the node; our controller: number of its state
    /// ([`State`](crate::cyphal::cubecell::group_state::State)).
    pub vendor_status: u8,
}

impl Encode for Heartbeat {
    fn encode(&self, out: &mut Writer<'_>) {
        out.u32(self.uptime_s);
        out.u8(self.health as u8);
        out.u8(self.mode.0);
        out.u8(self.vendor_status);
    }
}

impl Decode<'_> for Heartbeat {
    fn decode(input: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let uptime_s = input.u32();
        let health = match input.u8() & 3 {
            0 => Health::Nominal,
            1 => Health::Advisory,
            2 => Health::Caution,
            _ => Health::Warning,
        };
        Ok(Self { uptime_s, health, mode: Mode(input.u8() & 7), vendor_status: input.u8() })
    }
}

//! Events that a bus reports to its owner, and disturbances of the bus.

use protocol::Frame;

use super::stats::ErrorKind;

/// A bit of one frame that is read wrongly.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Disturbance {
    /// Counted from start of frame (0), stuff bits included.
    pub bit: u32,
    /// Ports that read the inverted level; all ones: all nodes, also the sender.
    pub seen_by: u64,
}

/// Decides at each start of frame whether the line disturbs it.
pub trait Wire {
    /// `from` has won the right to send `frame`, `bits` long up to the end of frame.
    fn disturb(&mut self, now_ns: u64, from: usize, frame: &Frame, bits: u32) -> Option<Disturbance>;
}

/// A line without disturbances.
#[derive(Clone, Copy, Debug, Default)]
pub struct QuietWire;

impl Wire for QuietWire {
    fn disturb(&mut self, _: u64, _: usize, _: &Frame, _: u32) -> Option<Disturbance> {
        None
    }
}

/// Something that happened on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BusEvent {
    /// A frame became valid for its receivers.
    Frame {
        /// When, nanoseconds.
        at_ns: u64,
        /// Port of the transmitter, the lowest if several sent the same frame; `None` if it was disconnected.
        from: Option<usize>,
        frame: Frame,
        /// Ports that accepted it.
        receivers: u64,
    },
    /// A node began an error flag.
    Error {
        /// When, nanoseconds.
        at_ns: u64,
        port: usize,
        kind: ErrorKind,
    },
    /// A node counted itself out.
    BusOff {
        /// When, nanoseconds.
        at_ns: u64,
        port: usize,
    },
    /// A node came (back) on the bus.
    Joined {
        /// When, nanoseconds.
        at_ns: u64,
        port: usize,
    },
}

impl BusEvent {
    /// When it happened, nanoseconds.
    pub const fn at_ns(&self) -> u64 {
        match self {
            Self::Frame { at_ns, .. }
            | Self::Error { at_ns, .. }
            | Self::BusOff { at_ns, .. }
            | Self::Joined { at_ns, .. } => *at_ns,
        }
    }
}

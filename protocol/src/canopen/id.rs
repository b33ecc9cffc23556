//! Which frame an id stands for (CiA 301, 7.3.5, pre-defined connection set).

use core::fmt;

use crate::{Frame, Id, StandardId};

/// Number of a node, 1 to 127.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct NodeId(u8);

impl NodeId {
    /// `None` outside 1 to 127.
    pub const fn new(id: u8) -> Option<Self> {
        match id {
            1..=127 => Some(Self(id)),
            _ => None,
        }
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

/// Purpose of a frame. PDOs are numbered from 1 to 4; their ids can be configured otherwise.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Function {
    /// 000: network management.
    Nmt,
    /// 080: SYNC.
    Sync,
    /// 080 + node: emergency.
    Emergency(NodeId),
    /// 100: time.
    Time,
    /// 180, 280, 380, 480 + node: process data from the node.
    Tpdo(u8, NodeId),
    /// 200, 300, 400, 500 + node: process data to the node.
    Rpdo(u8, NodeId),
    /// 580 + node: service data from the node.
    SdoFromNode(NodeId),
    /// 600 + node: service data to the node.
    SdoToNode(NodeId),
    /// 700 + node: heartbeat.
    Heartbeat(NodeId),
}

impl Function {
    /// The 11-bit id. A PDO number outside 1 to 4 counts as the nearest of them.
    #[must_use]
    pub fn id(self) -> u16 {
        let of = |base: u16, node: NodeId| base + u16::from(node.get());
        let pdo = |base: u16, number: u8, node| of(base + 0x100 * u16::from(number.clamp(1, 4) - 1), node);
        match self {
            Self::Nmt => 0x000,
            Self::Sync => 0x080,
            Self::Time => 0x100,
            Self::Emergency(node) => of(0x080, node),
            Self::Tpdo(number, node) => pdo(0x180, number, node),
            Self::Rpdo(number, node) => pdo(0x200, number, node),
            Self::SdoFromNode(node) => of(0x580, node),
            Self::SdoToNode(node) => of(0x600, node),
            Self::Heartbeat(node) => of(0x700, node),
        }
    }

    /// Purpose of a standard id; `None` for an id that the standard set does not use.
    #[must_use]
    pub fn of(id: u16) -> Option<Self> {
        let node = || NodeId::new((id & 0x7F) as u8);
        let number = (id >> 8) as u8;
        Some(match id & 0x780 {
            0x000 if id == 0 => Self::Nmt,
            0x080 if id == 0x080 => Self::Sync,
            0x080 => Self::Emergency(node()?),
            0x100 if id == 0x100 => Self::Time,
            0x180 | 0x280 | 0x380 | 0x480 => Self::Tpdo(number, node()?),
            0x200 | 0x300 | 0x400 | 0x500 => Self::Rpdo(number - 1, node()?),
            0x580 => Self::SdoFromNode(node()?),
            0x600 => Self::SdoToNode(node()?),
            0x700 => Self::Heartbeat(node()?),
            _ => return None,
        })
    }

    /// Purpose of a data frame; `None` for remote frames and 29-bit ids.
    #[must_use]
    pub fn of_frame(frame: &Frame) -> Option<Self> {
        match frame.id() {
            Id::Standard(id) if !frame.is_remote() => Self::of(id.get()),
            _ => None,
        }
    }

    /// A data frame with this id.
    #[must_use]
    pub fn frame<const N: usize>(self, data: [u8; N]) -> Frame {
        Frame::from_array(Id::Standard(StandardId::from_low_bits(self.id())), data)
    }
}

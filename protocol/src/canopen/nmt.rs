//! Network management (CiA 301, 7.2.8).

use crate::Frame;

use super::id::{Function, NodeId};

/// What a master orders.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Command {
    /// 01: process data run.
    Start,
    /// 02: only network management runs.
    Stop,
    /// 80: service data run, process data do not.
    PreOperational,
    /// 81: the node starts again.
    ResetNode,
    /// 82: its communication starts again.
    ResetCommunication,
}

impl Command {
    const ALL: [(Self, u8); 5] = [
        (Self::Start, 0x01),
        (Self::Stop, 0x02),
        (Self::PreOperational, 0x80),
        (Self::ResetNode, 0x81),
        (Self::ResetCommunication, 0x82),
    ];

    /// The frame to one node, or to all of them.
    #[must_use]
    pub fn encode(self, to: Option<NodeId>) -> Frame {
        let code = Self::ALL.iter().find(|(own, _)| *own == self).map_or(0, |(_, code)| *code);
        Function::Nmt.frame([code, to.map_or(0, NodeId::get)])
    }

    /// The command of a frame and its node; `None` in the second place: all nodes.
    #[must_use]
    pub fn decode(from: &Frame) -> Option<(Self, Option<NodeId>)> {
        let (Function::Nmt, [code, node]) = (Function::of_frame(from)?, from.data()) else { return None };
        let (command, _) = Self::ALL.iter().find(|(_, own)| own == code)?;
        match node {
            0 => Some((*command, None)),
            id => Some((*command, Some(NodeId::new(*id)?))),
        }
    }
}

/// State of a node in its heartbeat.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum State {
    /// 00: it has just started.
    BootUp,
    /// 04.
    Stopped,
    /// 05.
    Operational,
    /// 7F.
    PreOperational,
}

impl State {
    /// Heartbeat of a node in this state.
    #[must_use]
    pub fn encode(self, node: NodeId) -> Frame {
        let code = match self {
            Self::BootUp => 0x00,
            Self::Stopped => 0x04,
            Self::Operational => 0x05,
            Self::PreOperational => 0x7F,
        };
        Function::Heartbeat(node).frame([code])
    }

    /// The node of a heartbeat, and its state. The highest bit, which node guarding toggles, is ignored.
    #[must_use]
    pub fn decode(from: &Frame) -> Option<(NodeId, Self)> {
        let (Function::Heartbeat(node), [code]) = (Function::of_frame(from)?, from.data()) else {
            return None;
        };
        let state = match code & 0x7F {
            0x00 => Self::BootUp,
            0x04 => Self::Stopped,
            0x05 => Self::Operational,
            0x7F => Self::PreOperational,
            _ => return None,
        };
        Some((node, state))
    }
}

/// SYNC without a counter.
#[must_use]
pub fn sync() -> Frame {
    Function::Sync.frame([])
}

//! Who sits on the bus: nodes by index, and the physical process behind them.

use std::borrow::Cow;

use protocol::{Frame, Instant, Node};

use crate::bus::TxOrder;
use crate::fault::FaultTarget;

/// How a node is connected to the bus right now.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BusConnection {
    /// Powered, at the rate of the bus.
    #[default]
    On,
    /// Without power: no acknowledge, no frames, counters lost.
    Off,
    /// Set to another bit rate (baud broadcast). The model separates such a node from the bus; the error frames
    /// that a real one would cause can be simulated with the `babble` and `corrupt` faults.
    OtherRate,
}

/// A bounded set of nodes, addressed by index, with the physics that moves on between events.
///
/// # Contract
///
/// * [`Participants::len`] never changes during a run.
/// * [`Participants::advance`] is called with times that never decrease, before any node gets an event of
///   that time. Its result may depend on the times of the *events* only, not on how often it was called.
/// * Nodes reach each other through frames only; what they share physically is in `advance`.
pub trait Participants {
    fn len(&self) -> usize;

    /// True without any node.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The node at `index`, below [`Participants::len`]; panics beyond.
    fn node(&mut self, index: usize) -> &mut dyn Node;

    /// What people call the node at `index`.
    fn name(&self, index: usize) -> Cow<'_, str>;

    /// Moves the physical process on to `to`.
    fn advance(&mut self, to: Instant) {
        let _ = to;
    }

    /// Whether the node at `index` is connected to the bus; checked after each of its events and after each start
    /// or end of a fault.
    fn connection(&self, index: usize) -> BusConnection {
        let _ = index;
        BusConnection::On
    }

    /// Acceptance filter of the node at `index`: a frame that it refuses is acknowledged, but not passed on, as in
    /// a CAN controller. Only for speed: a node must ignore such a frame anyway.
    fn accepts(&self, index: usize, frame: &Frame) -> bool {
        let _ = (index, frame);
        true
    }

    /// Order in which the node at `index` sends its waiting frames; `None`: as set for the bus. Read once.
    fn tx_order(&self, index: usize) -> Option<TxOrder> {
        let _ = index;
        None
    }

    /// Data rate of CAN FD that the nodes need, bits per second; `None`: they are classical. Read once.
    fn data_bit_rate_bit_s(&self) -> Option<u32> {
        None
    }

    /// Wire address of the node at `index` if it is a drive, so that a fault can name it.
    fn module(&self, index: usize) -> Option<protocol::ModuleId> {
        let _ = index;
        None
    }

    /// Takes the faults of drives, supplies and gripper; `None` without such parts.
    fn physics(&mut self) -> Option<&mut dyn FaultTarget> {
        None
    }
}

/// Two groups of participants on one bus, the nodes of the first one first: for example a cell and the controller under test.
///
/// Physical faults go to the first participants that have physics.
impl<A: Participants, B: Participants> Participants for (A, B) {
    fn len(&self) -> usize {
        self.0.len() + self.1.len()
    }

    fn node(&mut self, index: usize) -> &mut dyn Node {
        match index.checked_sub(self.0.len()) {
            None => self.0.node(index),
            Some(rest) => self.1.node(rest),
        }
    }

    fn name(&self, index: usize) -> Cow<'_, str> {
        match index.checked_sub(self.0.len()) {
            None => self.0.name(index),
            Some(rest) => self.1.name(rest),
        }
    }

    fn advance(&mut self, to: Instant) {
        self.0.advance(to);
        self.1.advance(to);
    }

    fn connection(&self, index: usize) -> BusConnection {
        match index.checked_sub(self.0.len()) {
            None => self.0.connection(index),
            Some(rest) => self.1.connection(rest),
        }
    }

    fn accepts(&self, index: usize, frame: &Frame) -> bool {
        match index.checked_sub(self.0.len()) {
            None => self.0.accepts(index, frame),
            Some(rest) => self.1.accepts(rest, frame),
        }
    }

    fn tx_order(&self, index: usize) -> Option<TxOrder> {
        match index.checked_sub(self.0.len()) {
            None => self.0.tx_order(index),
            Some(rest) => self.1.tx_order(rest),
        }
    }

    fn data_bit_rate_bit_s(&self) -> Option<u32> {
        self.0.data_bit_rate_bit_s().or(self.1.data_bit_rate_bit_s())
    }

    fn module(&self, index: usize) -> Option<protocol::ModuleId> {
        match index.checked_sub(self.0.len()) {
            None => self.0.module(index),
            Some(rest) => self.1.module(rest),
        }
    }

    fn physics(&mut self) -> Option<&mut dyn FaultTarget> {
        match self.0.physics() {
            Some(target) => Some(target),
            None => self.1.physics(),
        }
    }
}

/// One node with a name, as participants.
#[derive(Clone, Debug)]
pub struct Solo<N> {
    /// What people call it.
    pub name: String,
    pub node: N,
}

impl<N: Node> Solo<N> {
    pub fn new(name: impl Into<String>, node: N) -> Self {
        Self { name: name.into(), node }
    }
}

impl<N: Node> Participants for Solo<N> {
    fn len(&self) -> usize {
        1
    }

    fn node(&mut self, _index: usize) -> &mut dyn Node {
        &mut self.node
    }

    fn name(&self, _index: usize) -> Cow<'_, str> {
        Cow::Borrowed(&self.name)
    }
}

/// Any number of nodes of one kind, each with its name and without shared physics.
impl<N: Node> Participants for Vec<Solo<N>> {
    fn len(&self) -> usize {
        self.len()
    }

    fn node(&mut self, index: usize) -> &mut dyn Node {
        &mut self[index].node
    }

    fn name(&self, index: usize) -> Cow<'_, str> {
        Cow::Borrowed(&self[index].name)
    }
}

/// Participants behind a pointer, so that a program can choose it at run time.
impl<C: Participants + ?Sized> Participants for Box<C> {
    fn len(&self) -> usize {
        (**self).len()
    }

    fn node(&mut self, index: usize) -> &mut dyn Node {
        (**self).node(index)
    }

    fn name(&self, index: usize) -> Cow<'_, str> {
        (**self).name(index)
    }

    fn advance(&mut self, to: Instant) {
        (**self).advance(to);
    }

    fn connection(&self, index: usize) -> BusConnection {
        (**self).connection(index)
    }

    fn accepts(&self, index: usize, frame: &Frame) -> bool {
        (**self).accepts(index, frame)
    }

    fn tx_order(&self, index: usize) -> Option<TxOrder> {
        (**self).tx_order(index)
    }

    fn data_bit_rate_bit_s(&self) -> Option<u32> {
        (**self).data_bit_rate_bit_s()
    }

    fn module(&self, index: usize) -> Option<protocol::ModuleId> {
        (**self).module(index)
    }

    fn physics(&mut self) -> Option<&mut dyn FaultTarget> {
        (**self).physics()
    }
}

//! One node's place on the bus: whether it takes part, and its error counters.

use super::counters::{Confinement, Counters, RECOVERY_SEQUENCES};

/// Recessive bits an error-passive transmitter adds to the intermission.
const SUSPEND_BITS: u64 = 8;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Presence {
    Detached,
    /// Bus-off without permission to recover.
    HeldOff,
    /// Counts sequences of eleven recessive bits: after power on (one) or after bus-off (128).
    Waiting {
        sequences_left: u16,
        run: u8,
    },
    Online,
}

/// What the bus keeps of one node's CAN controller.
#[derive(Clone, Debug)]
pub struct Controller {
    pub counters: Counters,
    presence: Presence,
    automatic_recovery: bool,
}

impl Controller {
    /// A node on the bus, error-active, both counters zero.
    pub fn new(automatic_recovery: bool) -> Self {
        Self { counters: Counters::default(), presence: Presence::Online, automatic_recovery }
    }

    /// Recessive sequences left until the node joins, and recessive bits of the current one.
    pub fn waiting(&self) -> Option<(u16, u8)> {
        match self.presence {
            Presence::Waiting { sequences_left, run } => Some((sequences_left, run)),
            _ => None,
        }
    }

    /// Sets the progress of a node that waits.
    pub fn set_waiting(&mut self, sequences_left: u16, run: u8) {
        if self.waiting().is_some() {
            self.presence = Presence::Waiting { sequences_left, run };
        }
    }

    /// The last sequence is complete (rule 12): counters zero, and part of the bus.
    pub fn join(&mut self) {
        self.counters.clear();
        self.presence = Presence::Online;
    }

    /// Takes the node off the bus at once.
    pub fn detach(&mut self) {
        self.presence = Presence::Detached;
    }

    /// Connects a detached node: counters zero, joins after eleven recessive bits.
    pub fn attach(&mut self) {
        if self.presence == Presence::Detached {
            self.counters.clear();
            self.presence = Presence::Waiting { sequences_left: 1, run: 0 };
        }
    }

    /// Puts the node into bus-off, from any value of its counter.
    pub fn enter_bus_off(&mut self) {
        self.counters.force_bus_off();
        self.presence = if self.automatic_recovery {
            Presence::Waiting { sequences_left: RECOVERY_SEQUENCES, run: 0 }
        } else {
            Presence::HeldOff
        };
    }

    /// Permits recovery of a node that does not recover by itself; false if the node does not wait for it.
    pub fn request_recovery(&mut self) -> bool {
        let held = self.presence == Presence::HeldOff;
        if held {
            self.presence = Presence::Waiting { sequences_left: RECOVERY_SEQUENCES, run: 0 };
        }
        held
    }

    /// Bits that the node waits after the intermission when it was the transmitter.
    pub fn suspend_bits(&self) -> u64 {
        if self.counters.state() == Confinement::Passive { SUSPEND_BITS } else { 0 }
    }
}

//! Ring of recent events, as facts without strings; decoded off the board.

use protocol::cyphal::cubecell::group_state::State as StateKind;
use protocol::{Instant, JointIndex};

use crate::credentials::Peer;
use crate::fault::{Cause, Fault};
use crate::orders::OrderKind;

/// Events kept.
pub const TRACE_LEN: usize = 64;

/// Something that happened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TraceEvent {
    /// The state changed.
    State {
        /// From.
        from: StateKind,
        /// To.
        to: StateKind,
        /// Why, if there was a stop or a fault.
        fault: Option<Fault>,
    },
    /// A fault came after the first one and changed nothing.
    FurtherFault(Fault),
    /// An order was taken.
    Order(OrderKind),
    /// An order was refused.
    Refused(OrderKind, Cause),
    /// A drive missed a reply.
    Missed(JointIndex),
    /// A drive reported a position that it cannot have reached.
    Implausible(JointIndex),
    /// A control cycle began late or before the last one was done.
    LateCycle,
    /// The gripper output was switched (true: open).
    Gripper(bool),
    /// The halt broadcast went out.
    Halt,
    /// A node unlocked the limits.
    Unlocked(Peer),
    /// Limits beyond those of the robot were put back, or can no longer be set.
    LimitsPutBack,
    /// A limit was changed: the committed trajectory has to be committed again.
    LimitsChanged,
    /// A key was set (true) or removed.
    Key(bool),
    /// A node wrote to the upload of another node, which is now void.
    UploadVoided(Peer),
    /// A register write was refused: its number.
    RegisterRefused(u8, Cause),
}

/// The last [`TRACE_LEN`] events.
#[derive(Clone, Debug)]
pub struct Trace {
    events: [Option<(Instant, TraceEvent)>; TRACE_LEN],
    next: usize,
    total: u32,
}

impl Default for Trace {
    fn default() -> Self {
        Self { events: [None; TRACE_LEN], next: 0, total: 0 }
    }
}

impl Trace {
    /// Records an event; the oldest one is dropped.
    pub fn note(&mut self, now: Instant, event: TraceEvent) {
        if let Some(place) = self.events.get_mut(self.next) {
            *place = Some((now, event));
        }
        self.next = (self.next + 1) % TRACE_LEN;
        self.total = self.total.wrapping_add(1);
    }

    /// Events since start-up, dropped ones included; modulo 2^32.
    pub const fn total(&self) -> u32 {
        self.total
    }

    /// The events that are kept, in the order of the ring, each with its number since start-up.
    pub fn places(&self) -> impl Iterator<Item = Option<(u32, Instant, TraceEvent)>> + '_ {
        let next = self.next;
        self.events.iter().enumerate().map(move |(place, entry)| {
            // The place before `next` holds the newest event.
            let older = (next + TRACE_LEN - 1 - place) % TRACE_LEN;
            entry.map(|(at, event)| (self.total.wrapping_sub(older as u32), at, event))
        })
    }

    /// The events that are kept, oldest first.
    pub fn iter(&self) -> impl Iterator<Item = (Instant, TraceEvent)> + '_ {
        let (newer, older) = self.events.split_at_checked(self.next).unwrap_or((&self.events, &[]));
        older.iter().chain(newer).flatten().copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ring_keeps_the_latest_in_order() {
        let mut trace = Trace::default();
        for k in 0..100 {
            trace.note(Instant::from_micros(k), TraceEvent::Halt);
        }
        let times: Vec<u64> = trace.iter().map(|(at, _)| at.as_micros()).collect();
        assert_eq!(times, (36..100).collect::<Vec<u64>>());
        assert_eq!(trace.total(), 100);
        let mut numbered: Vec<(u32, u64)> =
            trace.places().flatten().map(|(sequence, at, _)| (sequence, at.as_micros())).collect();
        numbered.sort_unstable();
        assert_eq!(numbered, (36..100).map(|k| (k as u32 + 1, k)).collect::<Vec<_>>());
    }
}

//! Small rig around a bus without nodes.

pub(crate) mod nodes;

use hil_sim::bus::{Bus, BusConfig, BusEvent, Disturbance, Wire};
use protocol::{ExtendedId, Frame, StandardId};

pub(crate) const EVERYBODY: u64 = u64::MAX;

pub(crate) fn standard(id: u16, data: &[u8]) -> Frame {
    Frame::new(StandardId::new(id).unwrap(), data).unwrap()
}

pub(crate) fn extended(id: u32, data: &[u8]) -> Frame {
    Frame::new(ExtendedId::new(id).unwrap(), data).unwrap()
}

/// Disturbs the attempts that the list names, counted from 0; or all of them.
#[derive(Clone, Debug, Default)]
pub(crate) struct Script {
    pub(crate) attempts: Vec<(usize, Disturbance)>,
    pub(crate) always: Option<Disturbance>,
    pub(crate) seen: usize,
}

impl Script {
    pub(crate) fn once(bit: u32, seen_by: u64) -> Self {
        Self { attempts: vec![(0, Disturbance { bit, seen_by })], ..Self::default() }
    }

    pub(crate) fn always(bit: u32, seen_by: u64) -> Self {
        Self { always: Some(Disturbance { bit, seen_by }), ..Self::default() }
    }
}

impl Wire for Script {
    fn disturb(&mut self, _: u64, _: usize, _: &Frame, _: u32) -> Option<Disturbance> {
        let attempt = self.seen;
        self.seen += 1;
        self.attempts.iter().find(|(at, _)| *at == attempt).map(|(_, d)| *d).or(self.always)
    }
}

/// Bits of a frame, start of frame to end of frame.
pub(crate) fn frame_bits(frame: &Frame) -> u32 {
    protocol::bits::length(frame).frame()
}

/// A bus of 1 Mbit/s: one bit is one microsecond.
pub(crate) fn bus(ports: usize) -> Bus {
    Bus::new(BusConfig::default(), ports).unwrap()
}

pub(crate) const BIT_NS: u64 = 1_000;

/// All events up to a time in bits.
pub(crate) fn run(bus: &mut Bus, wire: &mut impl Wire, until_bits: u64) -> Vec<BusEvent> {
    std::iter::from_fn(|| bus.run_until(until_bits * BIT_NS, wire)).collect()
}

/// Only the frames: (end in bits, port, frame, receivers).
pub(crate) fn frames(events: &[BusEvent]) -> Vec<(u64, Option<usize>, Frame, u64)> {
    events
        .iter()
        .filter_map(|event| match *event {
            BusEvent::Frame { at_ns, from, frame, receivers } => {
                Some((at_ns / BIT_NS, from, frame, receivers))
            }
            _ => None,
        })
        .collect()
}

//! The slow gear: every controller, bit by bit, whenever something is out of the ordinary.

use protocol::{Frame, Id};

use super::super::controller::Outcome;
use super::super::counters::Confinement;
use super::super::encode::{DOMINANT, RECESSIVE, frame_bits};
use super::super::event::{BusEvent, Disturbance, QuietWire, Wire};
use super::super::stats::ErrorKind;
use super::{Bus, Gear, Port, indices};

/// Progress of the slow gear.
#[derive(Clone, Copy, Debug)]
pub(super) struct BitGear {
    /// Start of the next bit.
    pub(super) next_ns: u64,
    /// Bits since the last start of frame.
    index: u32,
    start_ns: u64,
    pub(super) disturbance: Option<Disturbance>,
    /// Whose frame is (or was last) on the bus, for the figures.
    id: Option<Id>,
}

impl Bus {
    pub(super) fn enter_bits(&mut self, start_ns: u64) {
        for port in 0..self.ports.len() {
            self.settle_waiting(port, start_ns);
            let node = &mut self.ports[port];
            let left_ns = node.suspend_until_ns.saturating_sub(start_ns);
            node.controller.resume_suspend(left_ns.div_ceil(self.bit_ns) as u8);
        }
        self.gear =
            Gear::Bits(BitGear { next_ns: start_ns, index: 0, start_ns, disturbance: None, id: None });
    }

    fn leave_bits(&mut self, now_ns: u64) {
        for node in &mut self.ports {
            node.suspend_until_ns = now_ns + u64::from(node.controller.suspend_left()) * self.bit_ns;
            node.controller.leave_suspend();
            node.waiting_since_ns = now_ns;
        }
        self.gear = Gear::Quiet { ready_ns: now_ns };
    }

    /// Before a node vanishes in the middle of a frame: if it is the sender, or the only one to
    /// acknowledge, replays the frame's bits so far, so that the rest happens bit by bit.
    pub(super) fn leave_frame_gear_without(&mut self, port: usize, now_ns: u64) {
        let Gear::Frame(flight) = self.gear else { return };
        let others = self.online & !(1 << flight.from) & !(1 << port);
        if flight.delivered || (flight.from != port && others != 0) {
            return;
        }
        self.enter_bits(flight.start_ns);
        let mut wire = QuietWire;
        let replay_until_ns = now_ns.min(flight.start_ns + u64::from(flight.bits - 2) * self.bit_ns);
        while let Gear::Bits(gear) = self.gear
            && gear.next_ns + self.bit_ns <= replay_until_ns
        {
            self.step_bit(gear, &mut wire);
        }
    }

    pub(super) fn run_bits(&mut self, limit_ns: u64, wire: &mut impl Wire) -> bool {
        while let Gear::Bits(gear) = self.gear {
            if gear.next_ns + self.bit_ns > limit_ns {
                return false;
            }
            self.step_bit(gear, wire);
            if !self.out.is_empty() {
                return true;
            }
        }
        true
    }

    fn step_bit(&mut self, mut gear: BitGear, wire: &mut impl Wire) {
        let (start_ns, end_ns) = (gear.next_ns, gear.next_ns + self.bit_ns);
        let offers = self.offers(start_ns);
        self.start_of_frame(&mut gear, offers, wire);
        let disturbed = match gear.disturbance {
            Some(d) if gear.index >= d.first_bit && gear.index - d.first_bit < d.bits => d.seen_by,
            _ => 0,
        };
        let was_quiet = self.all_quiet() && offers & self.idle_ports() == 0;

        let mut level = if self.held_dominant { DOMINANT } else { RECESSIVE };
        for (port, node) in self.ports.iter_mut().enumerate() {
            let offer = offer(node, offers >> port & 1 == 1);
            level &= node.controller.output(offer.as_ref());
        }
        let (mut received, mut receivers) = (None, 0);
        let mut went_off = 0;
        for port in 0..self.ports.len() {
            let seen = level ^ (disturbed >> port & 1 == 1);
            let node = &mut self.ports[port];
            let offer = offer(node, offers >> port & 1 == 1);
            let before = node.controller.counters.state();
            let was_sending = node.controller.is_sending();
            let outcome = node.controller.sample(seen, offer.as_ref());
            if before == Confinement::Active && node.controller.counters.state() == Confinement::Passive {
                node.stats.became_passive += 1;
            }
            if node.controller.took_offer() {
                node.sending = node.queue.head().unwrap_or(0);
            }
            match outcome {
                None => {}
                Some(Outcome::Received(frame)) => {
                    node.stats.received += 1;
                    received = Some(frame);
                    receivers |= 1 << port;
                }
                Some(Outcome::Transmitted) => {
                    let bits = gear.index + 1;
                    self.finish_transmission(port, gear.start_ns, bits, end_ns);
                }
                Some(Outcome::LostArbitration) => self.lost_arbitration(port),
                Some(Outcome::Error(kind)) => self.count_error(port, was_sending, kind, &gear, end_ns),
                Some(Outcome::Overload) => node.stats.overloads += 1,
                Some(Outcome::BusOff(cause)) => {
                    if let Some(kind) = cause {
                        self.count_error(port, was_sending, kind, &gear, end_ns);
                    }
                    went_off |= 1 << port;
                }
                Some(Outcome::Joined) => self.joined(port, end_ns),
            }
        }
        for port in indices(went_off) {
            self.went_off(port, end_ns);
        }
        if let Some(frame) = received {
            let from = (0..self.ports.len()).find(|p| self.ports[*p].controller.is_transmitter());
            self.out.push_back(BusEvent::Frame { at_ns: end_ns, from, frame, receivers });
        }
        self.now_ns = self.now_ns.max(end_ns);
        gear.next_ns = end_ns;
        gear.index += 1;
        self.gear = Gear::Bits(gear);
        let is_quiet = self.all_quiet();
        if !(was_quiet && is_quiet) || level == DOMINANT {
            self.busy_ns += self.bit_ns;
        }
        if is_quiet && !self.held_dominant {
            self.leave_bits(end_ns);
        }
    }

    fn offers(&self, now_ns: u64) -> u64 {
        let mut offers = 0;
        for port in indices(self.pending & self.online) {
            if self.ports[port].queue.get(0).is_some_and(|w| w.since_ns <= now_ns) {
                offers |= 1 << port;
            }
        }
        offers
    }

    fn idle_ports(&self) -> u64 {
        let mut idle = 0;
        for (port, node) in self.ports.iter().enumerate() {
            idle |= u64::from(node.controller.is_idle()) << port;
        }
        idle
    }

    fn all_quiet(&self) -> bool {
        self.ports.iter().all(|node| node.controller.is_quiet())
    }

    /// Notes a start of frame in this bit and asks the wire whether it disturbs it.
    fn start_of_frame(&mut self, gear: &mut BitGear, offers: u64, wire: &mut impl Wire) {
        let starters = offers & self.idle_ports();
        if starters == 0 {
            return;
        }
        let mut best: Option<(u32, usize, Frame)> = None;
        for port in indices(starters) {
            let node = &self.ports[port];
            if let Some(waiting) = node.queue.head().and_then(|head| node.queue.get(head))
                && best.is_none_or(|(key, ..)| waiting.key < key)
            {
                best = Some((waiting.key, port, waiting.frame));
            }
        }
        if let Some((_, port, frame)) = best {
            let first_of_gear = gear.index == 0 && gear.disturbance.is_some();
            if !first_of_gear {
                gear.disturbance = wire.disturb(gear.next_ns, port, &frame, frame_bits(&frame));
            }
            gear.index = 0;
            gear.start_ns = gear.next_ns;
            gear.id = Some(frame.id());
        }
    }

    fn count_error(&mut self, port: usize, was_sending: bool, kind: ErrorKind, gear: &BitGear, at_ns: u64) {
        let node = &mut self.ports[port];
        node.stats.errors.add(kind);
        if was_sending && let Some(waiting) = node.queue.get_mut(node.sending) {
            waiting.failed += 1;
            node.stats.failed_attempts += 1;
        }
        if let Some(row) = gear.id.and_then(|id| self.ids.row(id)) {
            row.errors.add(kind);
        }
        self.out.push_back(BusEvent::Error { at_ns, port, kind });
    }
}

/// The frame a node would start with.
fn offer(node: &Port, offered: bool) -> Option<Frame> {
    if !offered {
        return None;
    }
    node.queue.head().and_then(|head| node.queue.get(head)).map(|waiting| waiting.frame)
}

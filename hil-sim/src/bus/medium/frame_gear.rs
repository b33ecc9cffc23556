//! The fast gear: a whole frame in one step, as long as nothing disturbs it.

use protocol::bits::INTERFRAME_SPACE as INTERMISSION_BITS;

use super::super::counters::SEQUENCE_BITS;
use super::super::encode::frame_bits;
use super::super::event::{BusEvent, Wire};
use super::{Bus, Gear, InFlight, indices};

/// Recessive bits at the end of a good frame: acknowledge delimiter and end of frame.
const TRAILING_RECESSIVE: u8 = 8;

impl Bus {
    /// False if nothing more happens before the limit.
    pub(super) fn run_quiet(&mut self, ready_ns: u64, limit_ns: u64, wire: &mut impl Wire) -> bool {
        let mut start_ns = u64::MAX;
        let candidates = self.pending & self.online;
        for port in indices(candidates) {
            start_ns = start_ns.min(self.ready_to_send_ns(port, ready_ns));
        }
        if self.held_dominant {
            start_ns = start_ns.min(ready_ns.max(self.now_ns));
        }
        if self.waiting != 0 {
            let (join_ns, port) = self.next_join();
            if join_ns <= start_ns && join_ns <= limit_ns {
                self.now_ns = self.now_ns.max(join_ns);
                self.join(port, join_ns);
                return true;
            }
        }
        if start_ns >= limit_ns {
            return false;
        }
        self.now_ns = self.now_ns.max(start_ns);
        let (mut best, mut best_key, mut ties) = (usize::MAX, u32::MAX, 0);
        let mut starters = 0_u64;
        for port in indices(candidates) {
            if self.ready_to_send_ns(port, ready_ns) > start_ns {
                continue;
            }
            starters |= 1 << port;
            let node = &mut self.ports[port];
            let Some(head) = node.queue.head() else { continue };
            node.sending = head;
            let Some(waiting) = node.queue.get(head) else { continue };
            if waiting.key < best_key {
                (best, best_key, ties) = (port, waiting.key, 1);
            } else if waiting.key == best_key {
                ties += 1;
            }
        }
        if ties != 1 || self.held_dominant || self.config.bit_by_bit || self.online.count_ones() < 2 {
            self.enter_bits(start_ns);
            return true;
        }
        let Some(frame) = self.ports[best].queue.get(self.ports[best].sending).map(|w| w.frame) else {
            return false;
        };
        let bits = frame_bits(&frame);
        let disturbance = wire.disturb(start_ns, best, &frame, bits);
        if disturbance.is_some() {
            self.enter_bits(start_ns);
            if let Gear::Bits(gear) = &mut self.gear {
                gear.disturbance = disturbance;
            }
            return true;
        }
        for port in indices(self.waiting) {
            self.settle_waiting(port, start_ns);
        }
        self.gear = Gear::Frame(InFlight {
            from: best,
            frame,
            start_ns,
            bits,
            losers: starters & !(1 << best),
            delivered: false,
        });
        true
    }

    pub(super) fn ready_to_send_ns(&self, port: usize, ready_ns: u64) -> u64 {
        let node = &self.ports[port];
        // Whatever waits longest decides when the node may start; in both orders it is the first.
        let queued_ns = node.queue.get(0).map_or(0, |waiting| waiting.since_ns);
        queued_ns.max(ready_ns).max(node.suspend_until_ns)
    }

    pub(super) fn lost_arbitration(&mut self, port: usize) {
        let node = &mut self.ports[port];
        node.stats.arbitrations_lost += 1;
        if let Some(waiting) = node.queue.get(node.sending)
            && let Some(row) = self.ids.row(waiting.frame.id())
        {
            row.arbitrations_lost += 1;
        }
    }

    pub(super) fn run_frame(&mut self, flight: InFlight, limit_ns: u64) -> bool {
        let end_ns = flight.start_ns + u64::from(flight.bits) * self.bit_ns;
        if !flight.delivered {
            let valid_ns = end_ns - self.bit_ns;
            if valid_ns > limit_ns {
                return false;
            }
            self.now_ns = self.now_ns.max(valid_ns);
            let receivers = self.online & !(1 << flight.from);
            for port in indices(flight.losers) {
                self.lost_arbitration(port);
            }
            for port in indices(receivers) {
                self.ports[port].controller.received_in_one();
                self.ports[port].stats.received += 1;
            }
            self.gear = Gear::Frame(InFlight { delivered: true, ..flight });
            self.out.push_back(BusEvent::Frame {
                at_ns: valid_ns,
                from: Some(flight.from),
                frame: flight.frame,
                receivers,
            });
            return true;
        }
        if end_ns > limit_ns {
            return false;
        }
        self.now_ns = self.now_ns.max(end_ns);
        let ready_ns = end_ns + u64::from(INTERMISSION_BITS) * self.bit_ns;
        let suspend = self.ports[flight.from].controller.transmitted_in_one();
        if suspend > 0 {
            self.ports[flight.from].suspend_until_ns = ready_ns + u64::from(suspend) * self.bit_ns;
        }
        self.finish_transmission(flight.from, flight.start_ns, flight.bits, end_ns);
        self.busy_ns += ready_ns - flight.start_ns;
        for port in indices(self.waiting) {
            let node = &mut self.ports[port];
            if let Some((left, _)) = node.controller.waiting() {
                node.controller.set_waiting(left, TRAILING_RECESSIVE);
                node.waiting_since_ns = end_ns;
            }
        }
        self.gear = Gear::Quiet { ready_ns };
        true
    }

    pub(super) fn finish_transmission(&mut self, port: usize, start_ns: u64, bits: u32, end_ns: u64) {
        let node = &mut self.ports[port];
        node.stats.sent += 1;
        let Some(done) = node.queue.remove(node.sending) else { return };
        if node.queue.is_empty() {
            self.pending &= !(1 << port);
        }
        self.good_ns += u64::from(bits + INTERMISSION_BITS) * self.bit_ns;
        if let Some(row) = self.ids.row(done.frame.id()) {
            let wait_ns = start_ns.saturating_sub(done.since_ns);
            row.frames += 1;
            row.bits += u64::from(bits + INTERMISSION_BITS);
            row.failed_attempts += u64::from(done.failed);
            row.wait_sum_ns += wait_ns;
            row.wait_max_ns = row.wait_max_ns.max(wait_ns);
            row.response_max_ns = row.response_max_ns.max(end_ns.saturating_sub(done.since_ns));
        }
    }

    // Waiting for recessive sequences in the frame-by-frame gear.

    /// Brings the count of recessive bits of a waiting node up to `now_ns`.
    pub(super) fn settle_waiting(&mut self, port: usize, now_ns: u64) {
        let node = &mut self.ports[port];
        if let Some((left, run)) = node.controller.waiting() {
            let total = u64::from(run) + now_ns.saturating_sub(node.waiting_since_ns) / self.bit_ns;
            let sequences = total / u64::from(SEQUENCE_BITS);
            // Joining itself is an event of its own; here at least one sequence stays.
            let left = u64::from(left).saturating_sub(sequences).max(1) as u16;
            node.controller.set_waiting(left, (total % u64::from(SEQUENCE_BITS)) as u8);
            node.waiting_since_ns = now_ns;
        }
    }

    pub(super) fn next_join(&self) -> (u64, usize) {
        let mut first = (u64::MAX, usize::MAX);
        for port in indices(self.waiting) {
            let node = &self.ports[port];
            if let Some((left, run)) = node.controller.waiting() {
                let bits = u64::from(left) * u64::from(SEQUENCE_BITS) - u64::from(run);
                first = first.min((node.waiting_since_ns + bits * self.bit_ns, port));
            }
        }
        first
    }

    pub(super) fn join(&mut self, port: usize, at_ns: u64) {
        self.ports[port].controller.set_waiting(0, 0);
        self.joined(port, at_ns);
    }

    pub(super) fn joined(&mut self, port: usize, at_ns: u64) {
        self.waiting &= !(1 << port);
        self.online |= 1 << port;
        self.ports[port].suspend_until_ns = 0;
        self.out.push_back(BusEvent::Joined { at_ns, port });
    }
}

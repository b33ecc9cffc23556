//! A frame on the bus, from arbitration to its end.

use protocol::Frame;
use protocol::bits::{self, INTERFRAME_SPACE as INTERMISSION_BITS};

use super::super::counters::SEQUENCE_BITS;
use super::super::event::{BusEvent, Wire};
use super::errors::Failure;
use super::{Bus, Stage, indices};

/// Recessive bits at the end of a good frame and of an error frame.
pub(super) const TRAILING_RECESSIVE: u8 = 8;

/// ESI and length code of CAN FD.
const CONTROL_BITS: u32 = 5;

/// Frame under way.
#[derive(Clone, Copy, Debug)]
pub(super) struct Attempt {
    /// Nodes that send it: one, or several with the same frame.
    pub(super) senders: u64,
    pub(super) frame: Frame,
    pub(super) start_ns: u64,
    /// Start of frame to end of frame.
    pub(super) bits: u32,
    /// Of these, the first one at the data rate, how many follow, and how long each lasts.
    fast_from: u32,
    fast_bits: u32,
    fast_bit_ns: u64,
    /// Receivers that take it, one bit before its end.
    pub(super) takers: u64,
    pub(super) delivered: bool,
    pub(super) failure: Option<Failure>,
}

impl Attempt {
    fn new(senders: u64, frame: Frame, start_ns: u64, takers: u64, fast_bit_ns: u64) -> Self {
        let length = bits::length(&frame);
        Self {
            senders,
            frame,
            start_ns,
            bits: length.frame(),
            fast_from: length.before_fast(),
            fast_bits: length.fast,
            fast_bit_ns,
            takers,
            delivered: false,
            failure: None,
        }
    }

    pub(super) fn at_bit_ns(&self, bit: u32, bit_ns: u64) -> u64 {
        let fast = bit.saturating_sub(self.fast_from).min(self.fast_bits);
        self.start_ns + u64::from(bit - fast) * bit_ns + u64::from(fast) * self.fast_bit_ns
    }

    /// Whole bits that are over at `now_ns`.
    pub(super) fn bits_over(&self, now_ns: u64, bit_ns: u64) -> u32 {
        let mut over = (now_ns.saturating_sub(self.start_ns) / bit_ns) as u32;
        if self.fast_bits > 0 && over > self.fast_from {
            let in_fast_ns = now_ns - self.at_bit_ns(self.fast_from, bit_ns);
            let fast = ((in_fast_ns / self.fast_bit_ns) as u32).min(self.fast_bits);
            let behind_ns = in_fast_ns - u64::from(fast) * self.fast_bit_ns;
            over =
                self.fast_from + fast + if fast < self.fast_bits { 0 } else { (behind_ns / bit_ns) as u32 };
        }
        over
    }

    /// First bit after ESI and length code, where a controller that does not know CAN FD has noticed.
    pub(super) fn after_control(&self) -> u32 {
        self.fast_from + CONTROL_BITS
    }
}

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
        for port in indices(self.waiting) {
            self.settle_waiting(port, start_ns);
        }
        if self.held_dominant {
            self.hold(start_ns);
            return true;
        }
        let Some((senders, frame)) = self.arbitrate(candidates, ready_ns, start_ns) else { return false };
        let takers = self.online & !senders;
        let mut attempt = Attempt::new(senders, frame, start_ns, takers, self.fast_bit_ns);
        if self.is_collision(senders, &frame) {
            attempt.failure = self.collide(&mut attempt);
        }
        if attempt.failure.is_none() && frame.fd().is_some() {
            self.take_for_error(&mut attempt);
        }
        if attempt.failure.is_none() {
            let from = senders.trailing_zeros() as usize;
            let disturbance = wire.disturb(start_ns, from, &frame, attempt.bits);
            self.judge(&mut attempt, disturbance);
        }
        self.stage = Stage::Attempt(attempt);
        true
    }

    /// All nodes with the lowest key among those that start, and the frame of the node that sends dominant longest.
    fn arbitrate(&mut self, candidates: u64, ready_ns: u64, start_ns: u64) -> Option<(u64, Frame)> {
        let (mut starters, mut winners) = (0_u64, 0_u64);
        let mut best: Option<(u32, Frame)> = None;
        for port in indices(candidates) {
            if self.ready_to_send_ns(port, ready_ns) > start_ns {
                continue;
            }
            let node = &mut self.ports[port];
            let Some(head) = node.queue.head() else { continue };
            node.sending = head;
            let Some(waiting) = node.queue.get(head) else { continue };
            starters |= 1 << port;
            match best {
                Some((key, _)) if waiting.key > key => {}
                Some((key, frame)) if waiting.key == key => {
                    winners |= 1 << port;
                    best = Some((key, dominant(frame, waiting.frame)));
                }
                _ => (winners, best) = (1 << port, Some((waiting.key, waiting.frame))),
            }
        }
        for port in indices(starters & !winners) {
            self.lost_arbitration(port);
        }
        best.map(|(_, frame)| (winners, frame))
    }

    pub(super) fn ready_to_send_ns(&self, port: usize, ready_ns: u64) -> u64 {
        let node = &self.ports[port];
        // The frame that waits longest determines when the node may start; in both orders it is the first one.
        let queued_ns = node.queue.get(0).map_or(0, |waiting| waiting.since_ns);
        queued_ns.max(ready_ns).max(node.suspend_until_ns)
    }

    fn lost_arbitration(&mut self, port: usize) {
        let node = &mut self.ports[port];
        node.stats.arbitrations_lost += 1;
        if let Some(waiting) = node.queue.get(node.sending)
            && let Some(row) = self.ids.row(waiting.frame.id())
        {
            row.arbitrations_lost += 1;
        }
    }

    pub(super) fn run_attempt(&mut self, attempt: Attempt, limit_ns: u64) -> bool {
        let end_ns = attempt.at_bit_ns(attempt.bits, self.bit_ns);
        let valid_ns = end_ns - self.bit_ns;
        let flag_ns = attempt.failure.map(|failure| attempt.at_bit_ns(failure.flag_bit, self.bit_ns));
        if !attempt.delivered && flag_ns.is_none_or(|flag_ns| flag_ns >= valid_ns) {
            if valid_ns > limit_ns {
                return false;
            }
            self.deliver(attempt, valid_ns);
            return true;
        }
        let over_ns = flag_ns.unwrap_or(end_ns);
        if over_ns > limit_ns {
            return false;
        }
        self.now_ns = self.now_ns.max(over_ns);
        match attempt.failure {
            Some(failure) => self.fail(&attempt, &failure, over_ns),
            None => self.succeed(&attempt, end_ns),
        }
        true
    }

    fn deliver(&mut self, attempt: Attempt, valid_ns: u64) {
        self.now_ns = self.now_ns.max(valid_ns);
        self.stage = Stage::Attempt(Attempt { delivered: true, ..attempt });
        let receivers = attempt.takers & self.online;
        if receivers == 0 {
            return;
        }
        for port in indices(receivers) {
            self.ports[port].controller.counters.received();
            self.ports[port].stats.received += 1;
        }
        let from = indices(attempt.senders & self.attached).next();
        self.out.push_back(BusEvent::Frame { at_ns: valid_ns, from, frame: attempt.frame, receivers });
    }

    fn succeed(&mut self, attempt: &Attempt, end_ns: u64) {
        for port in indices(attempt.senders) {
            self.ports[port].controller.counters.transmitted();
            self.finish_transmission(port, attempt, end_ns);
        }
        self.end_attempt(attempt, end_ns);
    }

    /// The last recessive bits are over at `end_ns`; the intermission follows.
    pub(super) fn end_attempt(&mut self, attempt: &Attempt, end_ns: u64) {
        let ready_ns = end_ns + u64::from(INTERMISSION_BITS) * self.bit_ns;
        for port in indices(attempt.senders) {
            let node = &mut self.ports[port];
            node.suspend_until_ns = ready_ns + node.controller.suspend_bits() * self.bit_ns;
        }
        self.busy_ns += ready_ns - attempt.start_ns;
        self.restart_waiting(end_ns, TRAILING_RECESSIVE);
        self.stage = Stage::Quiet { ready_ns };
    }

    /// Dominant bits ended the sequences of all that wait; `run` recessive ones came since.
    pub(super) fn restart_waiting(&mut self, now_ns: u64, run: u8) {
        for port in indices(self.waiting) {
            let node = &mut self.ports[port];
            if let Some((left, _)) = node.controller.waiting() {
                node.controller.set_waiting(left, run);
                node.waiting_since_ns = now_ns;
            }
        }
    }

    fn finish_transmission(&mut self, port: usize, attempt: &Attempt, end_ns: u64) {
        let taken_ns = end_ns - attempt.start_ns + u64::from(INTERMISSION_BITS) * self.bit_ns;
        let node = &mut self.ports[port];
        node.stats.sent += 1;
        let Some(done) = node.queue.remove(node.sending) else { return };
        if node.queue.is_empty() {
            self.pending &= !(1 << port);
        }
        self.good_ns += taken_ns;
        if let Some(row) = self.ids.row(done.frame.id()) {
            let wait_ns = attempt.start_ns.saturating_sub(done.since_ns);
            row.frames += 1;
            row.busy_ns += taken_ns;
            row.failed_attempts += u64::from(done.failed);
            row.wait_sum_ns += wait_ns;
            row.wait_max_ns = row.wait_max_ns.max(wait_ns);
            row.response_max_ns = row.response_max_ns.max(end_ns.saturating_sub(done.since_ns));
        }
    }

    /// Brings the count of recessive bits of a waiting node up to `now_ns`.
    fn settle_waiting(&mut self, port: usize, now_ns: u64) {
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

    fn join(&mut self, port: usize, at_ns: u64) {
        self.ports[port].controller.join();
        self.waiting &= !(1 << port);
        self.online |= 1 << port;
        self.ports[port].suspend_until_ns = 0;
        self.out.push_back(BusEvent::Joined { at_ns, port });
    }
}

/// Of two frames with the same key, the one that is dominant where they first differ.
fn dominant(a: Frame, b: Frame) -> Frame {
    // FDF is recessive: of two with one id the classical one.
    let order = |frame: &Frame| (frame.fd().is_some(), frame.dlc());
    if (order(&b), b.data()) < (order(&a), a.data()) { b } else { a }
}

//! Attempts that fail, and a line that is held dominant.
//!
//! | error | first error flag | counters that change (rules of part A section 8) |
//! |---|---|---|
//! | a sender reads a bit wrongly | after that bit | senders 8 (rule 3), receivers 1 (rule 1) |
//! | a receiver reads a bit wrongly | after the acknowledge delimiter, or after a later bit | senders 8, that receiver 1 + 8 (rule 2), others 1 |
//! | the same, error-passive | none: it misses the frame | that receiver 1 |
//! | no node acknowledges | after the acknowledge slot | the sender 8, nothing once it is error-passive (rule 3, exception 1) |
//! | a CAN FD frame, and a receiver that is classical | after ESI and length code | senders 8, that receiver 1 + 8 (rule 2), others 1 |
//! | the same, error-passive | none: it misses the frame | that receiver 1 |
//! | two nodes send one id with other data | after the first byte that differs | both 8, receivers 1 |
//! | the line is held dominant | - | all nodes as receivers: 1, then 8 per eight bits (rules 1, 2 and 6) |
//!
//! Flags of several nodes overlap and take up to twelve bits together; the model uses twelve.

use protocol::Frame;
use protocol::bits::{FIXED_FORM, INTERFRAME_SPACE};

use super::super::counters::Confinement;
use super::super::event::{BusEvent, Disturbance};
use super::super::stats::ErrorKind;
use super::attempt::{Attempt, TRAILING_RECESSIVE};
use super::{Bus, Stage, indices};

/// Bits before the end of the frame at which the acknowledge slot is over.
const AFTER_ACK_SLOT: u32 = FIXED_FORM - 2;
/// The same for the acknowledge delimiter.
const AFTER_ACK_DELIMITER: u32 = FIXED_FORM - 3;

const FLAG_BITS: u64 = 6;

/// How an attempt fails.
#[derive(Clone, Copy, Debug)]
pub(super) struct Failure {
    /// Bits from the start of frame to the first error flag.
    pub(super) flag_bit: u32,
    /// What the senders see.
    kind: ErrorKind,
    /// Receivers that found the error first.
    first: u64,
    /// Receivers that see the flag of another within the frame.
    others: u64,
}

/// A line that is held dominant.
#[derive(Clone, Copy, Debug)]
pub(super) struct Held {
    since_ns: u64,
    /// Up to here it is in [`Bus::busy_ns`].
    busy_until_ns: u64,
    /// Times at which the nodes have counted.
    counted: u32,
}

impl Held {
    /// A stuff error after six dominant bits; after the own flag the first bit, then the 14th since it began, then each
    /// eighth.
    pub(super) fn next_count_ns(&self, bit_ns: u64) -> u64 {
        let bits = match self.counted {
            0 => 6,
            1 => 13,
            n => 20 + 8 * (u64::from(n) - 2),
        };
        self.since_ns + bits * bit_ns
    }
}

impl Bus {
    pub(super) fn is_collision(&self, senders: u64, frame: &Frame) -> bool {
        indices(senders).any(|port| self.sent_by(port).is_some_and(|other| other != *frame))
    }

    fn sent_by(&self, port: usize) -> Option<Frame> {
        let node = &self.ports[port];
        node.queue.get(node.sending).map(|waiting| waiting.frame)
    }

    fn is_passive(&self, port: usize) -> bool {
        self.ports[port].controller.counters.state() == Confinement::Passive
    }

    /// Two nodes send one id with different data. A node that reads a dominant bit for its recessive one ends the
    /// frame for all nodes if it is error-active, and only its own if it is error-passive.
    pub(super) fn collide(&mut self, attempt: &mut Attempt) -> Option<Failure> {
        let differs = |port: &usize| self.sent_by(*port).is_some_and(|other| other != attempt.frame);
        let losers: Vec<usize> = indices(attempt.senders).filter(differs).collect();
        let others = losers.iter().filter_map(|port| self.sent_by(*port));
        let differing_bits = others.map(|other| bits_to_difference(&attempt.frame, &other)).min();
        if losers.iter().all(|port| self.is_passive(*port)) {
            // They are no receivers of this frame either: they wait for its end.
            for port in losers {
                attempt.senders &= !(1 << port);
                self.count_sender(port, ErrorKind::Bit, attempt, attempt.start_ns);
            }
            return None;
        }
        Some(Failure {
            flag_bit: differing_bits.unwrap_or(attempt.bits).min(attempt.bits - FIXED_FORM),
            kind: ErrorKind::Bit,
            first: 0,
            others: attempt.takers,
        })
    }

    /// A CAN FD frame on a bus with controllers that do not know it: they read its data phase as stuff and form errors.
    pub(super) fn take_for_error(&mut self, attempt: &mut Attempt) {
        let classical = attempt.takers & self.classical;
        if classical == 0 {
            return;
        }
        attempt.takers &= !classical;
        if indices(classical).all(|port| self.is_passive(port)) {
            self.count_receivers(classical, ErrorKind::Stuff, attempt, attempt.start_ns);
            return;
        }
        let others = std::mem::take(&mut attempt.takers);
        let flag_bit = attempt.after_control();
        attempt.failure = Some(Failure { flag_bit, kind: ErrorKind::Bit, first: classical, others });
    }

    /// Sets who takes the frame and how it fails, if it does.
    pub(super) fn judge(&mut self, attempt: &mut Attempt, disturbance: Option<Disturbance>) {
        let receivers = attempt.takers;
        let no_answer =
            Failure { flag_bit: attempt.bits - AFTER_ACK_SLOT, kind: ErrorKind::Ack, first: 0, others: 0 };
        let Some(Disturbance { bit, seen_by }) = disturbance else {
            attempt.failure = (receivers == 0).then_some(no_answer);
            return;
        };
        let bit = bit.min(attempt.bits - 1);
        let wrong = seen_by & receivers;
        // A receiver has the frame one bit before its end. A wrong last bit is not an error for it.
        let (last, last_but_one) = (bit == attempt.bits - 1, bit == attempt.bits - 2);
        if seen_by & attempt.senders != 0 {
            let is_form = bit >= attempt.bits - AFTER_ACK_SLOT;
            attempt.takers = match (last, last_but_one) {
                (true, _) => receivers,
                (_, true) => receivers & !wrong,
                _ => 0,
            };
            attempt.failure = Some(Failure {
                flag_bit: bit + 1,
                kind: if is_form { ErrorKind::Form } else { ErrorKind::Bit },
                first: 0,
                others: receivers & !attempt.takers,
            });
            return;
        }
        if receivers == 0 {
            attempt.failure = Some(no_answer);
            return;
        }
        if last || wrong == 0 {
            return;
        }
        attempt.takers = receivers & !wrong;
        let before_ack = bit < attempt.bits - AFTER_ACK_SLOT;
        if attempt.takers == 0 && before_ack {
            attempt.failure = Some(Failure { others: wrong, ..no_answer });
        } else if indices(wrong).all(|port| self.is_passive(port)) {
            self.count_receivers(wrong, ErrorKind::Crc, attempt, attempt.start_ns);
        } else {
            let flag_bit = (bit + 1).max(attempt.bits - AFTER_ACK_DELIMITER);
            let others = if last_but_one { 0 } else { attempt.takers };
            attempt.takers &= !others;
            attempt.failure = Some(Failure { flag_bit, kind: ErrorKind::Form, first: wrong, others });
        }
    }

    /// Before a node is disconnected: ends the attempt if no other node sends it, or no other node acknowledges it.
    pub(super) fn leave_attempt(&mut self, port: usize, now_ns: u64) {
        let Stage::Attempt(mut attempt) = self.stage else { return };
        if attempt.delivered {
            return;
        }
        attempt.takers &= !(1 << port);
        let over = attempt.bits_over(now_ns, self.bit_ns);
        let others = self.online & !attempt.senders & !(1 << port);
        if attempt.senders == 1 << port {
            attempt.senders = 0;
            attempt.takers = 0;
            // Six recessive bits follow: a stuff error.
            let flag_bit = over + FLAG_BITS as u32;
            attempt.failure = Some(Failure { flag_bit, kind: ErrorKind::Bit, first: 0, others });
        } else {
            attempt.senders &= !(1 << port);
            let ack_bit = attempt.bits - AFTER_ACK_SLOT;
            if others == 0 && attempt.failure.is_none() && over < ack_bit {
                let kind = ErrorKind::Ack;
                attempt.failure = Some(Failure { flag_bit: ack_bit, kind, first: 0, others: 0 });
            }
        }
        self.stage = Stage::Attempt(attempt);
    }

    pub(super) fn fail(&mut self, attempt: &Attempt, failure: &Failure, at_ns: u64) {
        for port in indices(attempt.senders & self.online) {
            self.count_sender(port, failure.kind, attempt, at_ns);
        }
        // A classical controller stumbles within a CAN FD frame, others find a wrong checksum behind it.
        let found = if failure.kind == ErrorKind::Bit { ErrorKind::Stuff } else { ErrorKind::Crc };
        self.count_receivers(failure.first, found, attempt, at_ns);
        for port in indices(failure.first & self.online) {
            self.ports[port].controller.counters.receive_error_grave();
        }
        self.count_receivers(failure.others, ErrorKind::Stuff, attempt, at_ns);
        let answered = self.online & !attempt.senders != 0;
        let flags = if answered { 2 * FLAG_BITS } else { FLAG_BITS };
        self.end_attempt(attempt, at_ns + (flags + u64::from(TRAILING_RECESSIVE)) * self.bit_ns);
    }

    fn count_sender(&mut self, port: usize, kind: ErrorKind, attempt: &Attempt, at_ns: u64) {
        let is_passive = self.is_passive(port);
        let node = &mut self.ports[port];
        node.stats.failed_attempts += 1;
        if let Some(waiting) = node.queue.get_mut(node.sending) {
            waiting.failed += 1;
        }
        if !(kind == ErrorKind::Ack && is_passive) {
            node.controller.counters.transmit_error();
        }
        self.note_error(port, kind, attempt, is_passive, at_ns);
        if self.confinement(port) == Confinement::BusOff {
            self.went_off(port, at_ns);
        }
    }

    fn count_receivers(&mut self, ports: u64, kind: ErrorKind, attempt: &Attempt, at_ns: u64) {
        for port in indices(ports & self.online) {
            let was_passive = self.is_passive(port);
            self.ports[port].controller.counters.receive_error();
            self.note_error(port, kind, attempt, was_passive, at_ns);
        }
    }

    fn note_error(&mut self, port: usize, kind: ErrorKind, attempt: &Attempt, was_passive: bool, at_ns: u64) {
        if let Some(row) = self.ids.row(attempt.frame.id()) {
            row.errors.add(kind);
        }
        self.tell_error(port, kind, was_passive, at_ns);
    }

    fn tell_error(&mut self, port: usize, kind: ErrorKind, was_passive: bool, at_ns: u64) {
        let became_passive = !was_passive && self.is_passive(port);
        let stats = &mut self.ports[port].stats;
        stats.errors.add(kind);
        stats.became_passive += u64::from(became_passive);
        self.out.push_back(BusEvent::Error { at_ns, port, kind });
    }

    pub(super) fn hold(&mut self, since_ns: u64) {
        self.stage = Stage::Held(Held { since_ns, busy_until_ns: since_ns, counted: 0 });
    }

    pub(super) fn run_held(&mut self, held: Held, limit_ns: u64) -> bool {
        if !self.held_dominant {
            let free_ns = self.now_ns;
            let end_ns = free_ns + u64::from(TRAILING_RECESSIVE) * self.bit_ns;
            self.busy_ns += end_ns - held.busy_until_ns;
            self.restart_waiting(free_ns, 0);
            let ready_ns = end_ns + u64::from(INTERFRAME_SPACE) * self.bit_ns;
            self.stage = Stage::Quiet { ready_ns };
            return true;
        }
        let at_ns = held.next_count_ns(self.bit_ns);
        if at_ns > limit_ns {
            return false;
        }
        self.now_ns = self.now_ns.max(at_ns);
        self.busy_ns += at_ns - held.busy_until_ns;
        for port in indices(self.online) {
            let was_passive = self.is_passive(port);
            let counters = &mut self.ports[port].controller.counters;
            if held.counted == 0 {
                counters.receive_error();
                self.tell_error(port, ErrorKind::Stuff, was_passive, at_ns);
            } else {
                counters.receive_error_grave();
                let became_passive = !was_passive && self.is_passive(port);
                self.ports[port].stats.became_passive += u64::from(became_passive);
            }
        }
        self.stage = Stage::Held(Held { counted: held.counted + 1, busy_until_ns: at_ns, ..held });
        true
    }
}

/// Bits from the start of frame to the end of the first length code or data byte that differs in two frames with
/// one id, with the largest possible number of stuff bits.
fn bits_to_difference(a: &Frame, b: &Frame) -> u32 {
    let header = match (a.fd(), a.is_extended()) {
        (None, true) => 39,
        (None, false) => 19,
        (Some(_), true) => 41,
        (Some(_), false) => 22,
    };
    let bytes = if a.dlc() == b.dlc() && a.fd() == b.fd() {
        1 + a.data().iter().zip(b.data()).take_while(|(a, b)| a == b).count() as u32
    } else {
        0
    };
    let bits = header + 8 * bytes;
    bits + (bits - 1) / 4
}

//! One node's CAN protocol machine, a bit at a time.
//!
//! ```text
//!            dominant bit, or own start of frame
//!   Idle ───────────────────────────────────────▶ Stuffed ─▶ CrcDelimiter ─▶ AckSlot ─▶ AckDelimiter ─▶ EndOfFrame
//!    ▲ ▲                                            │              (any error, in any of them)               │
//!    │ └── Suspend ◀─ passive transmitter ─┐        ▼                                                       │
//!    └──────────────── Intermission ◀──────┴── Delimiter ◀─ AfterFlag ◀─ Flag                             │
//!                            ▲   └── dominant in bit 1 or 2: overload flag ──▶ ▲                            │
//!                            └──────────────────────────────────────────────────────────────────────────────┘
//!   BusOff / Joining ── sequences of eleven recessive bits ──▶ Idle
//! ```
//!
//! Per bit: [`Controller::output`] for all nodes, the logical AND is the bus, [`Controller::sample`] for all
//! nodes. Nothing else passes between nodes.

mod signalling;

use protocol::Frame;

use super::counters::{Confinement, Counters, RECOVERY_SEQUENCES, SEQUENCE_BITS};
use super::encode::{DOMINANT, RECESSIVE, WireBits};
use super::parse::{Parser, Step};
use super::stats::ErrorKind;

/// Bits of end of frame.
const EOF_BITS: u8 = 7;
const INTERMISSION_BITS: u8 = 3;
/// Recessive bits an error-passive transmitter adds to the intermission.
pub const SUSPEND_BITS: u8 = 8;

/// What the node was doing when it began to send a flag.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum FlagKind {
    /// Six dominant bits that break the stuffing rule for everybody.
    ActiveError,
    /// Six recessive bits; complete after six equal bits on the bus.
    PassiveError,
    /// Six dominant bits outside a frame.
    Overload,
}

/// State of the protocol machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// Not connected.
    Detached,
    /// Counts sequences of eleven recessive bits: after power on (one) or after bus-off (128).
    Waiting {
        run: u8,
        sequences_left: u16,
    },
    /// Bus-off without permission to recover.
    HeldOff,
    /// Nothing on the bus.
    Idle,
    /// Start of frame to checksum.
    Stuffed,
    CrcDelimiter,
    AckSlot,
    AckDelimiter,
    EndOfFrame {
        seen: u8,
    },
    /// `seen` bits of the flag are over; for a passive flag `seen` equal ones in a row.
    Flag {
        kind: FlagKind,
        seen: u8,
    },
    /// Waits for the first recessive bit after the own flag.
    AfterFlag {
        kind: FlagKind,
        dominant: u8,
        first: bool,
    },
    /// `seen` recessive bits of the delimiter are over.
    Delimiter {
        seen: u8,
    },
    Intermission {
        seen: u8,
    },
    Suspend {
        seen: u8,
    },
}

/// Effect of a sampled bit, for statistics and for delivery of frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// A frame became valid for this receiver (last but one bit of end of frame).
    Received(Frame),
    /// The own frame became valid (last bit of end of frame).
    Transmitted,
    /// Lost arbitration and goes on as receiver.
    LostArbitration,
    /// Began an error flag.
    Error(ErrorKind),
    /// Began an overload flag.
    Overload,
    /// Counted itself out; with the error that did it, unless that was in a flag.
    BusOff(Option<ErrorKind>),
    /// Back on the bus after bus-off or power on.
    Joined,
}

/// Protocol machine of one node.
#[derive(Clone, Debug)]
pub struct Controller {
    /// Error counters.
    pub counters: Counters,
    phase: Phase,
    parser: Parser,
    /// The frame being sent, and the index of its next bit.
    sending: Option<(WireBits, u32, bool)>,
    /// Role for the error rules: transmitter from start of frame until idle or lost arbitration.
    transmitter: bool,
    /// Rule 3, exception 1: counts eight only if a dominant bit shows up in the passive flag.
    ack_error_pending: bool,
    /// Polarity that a passive flag's run consists of.
    flag_level: bool,
    /// Level put on the bus in this bit.
    level: bool,
    /// Took what it was offered since the last [`Controller::took_offer`].
    took_offer: bool,
    automatic_recovery: bool,
}

impl Controller {
    /// A node on the bus, error-active, both counters zero.
    pub fn new(automatic_recovery: bool) -> Self {
        Self {
            counters: Counters::default(),
            phase: Phase::Idle,
            parser: Parser::after_start_of_frame(),
            sending: None,
            transmitter: false,
            ack_error_pending: false,
            flag_level: RECESSIVE,
            level: RECESSIVE,
            took_offer: false,
            automatic_recovery,
        }
    }

    /// True if the node neither sends nor follows anything: the bus may leave the bit-by-bit gear.
    pub fn is_quiet(&self) -> bool {
        matches!(
            self.phase,
            Phase::Idle | Phase::Suspend { .. } | Phase::Detached | Phase::HeldOff | Phase::Waiting { .. }
        )
    }

    /// True if the node could start to send now.
    pub fn is_idle(&self) -> bool {
        self.phase == Phase::Idle
    }

    /// True if the node follows the bus: it acknowledges and takes frames.
    pub fn is_online(&self) -> bool {
        !matches!(self.phase, Phase::Detached | Phase::HeldOff | Phase::Waiting { .. })
    }

    /// True while the node transmits a frame or clears up after its own.
    pub fn is_transmitter(&self) -> bool {
        self.transmitter
    }

    /// True from start of frame until the own frame succeeds, fails or loses arbitration.
    pub fn is_sending(&self) -> bool {
        self.sending.is_some()
    }

    /// True once after the node began with the frame it was offered.
    pub fn took_offer(&mut self) -> bool {
        std::mem::take(&mut self.took_offer)
    }

    /// Bits of suspend transmission still to wait; 0 if none.
    pub fn suspend_left(&self) -> u8 {
        match self.phase {
            Phase::Suspend { seen } => SUSPEND_BITS - seen,
            _ => 0,
        }
    }

    /// Recessive sequences left until the node joins, and recessive bits of the current one.
    pub fn waiting(&self) -> Option<(u16, u8)> {
        match self.phase {
            Phase::Waiting { run, sequences_left } => Some((sequences_left, run)),
            _ => None,
        }
    }

    /// Takes the node off the bus at once.
    pub fn detach(&mut self) {
        self.phase = Phase::Detached;
        self.sending = None;
        self.transmitter = false;
        self.level = RECESSIVE;
    }

    /// Connects a detached node: counters zero, joins after eleven recessive bits.
    pub fn attach(&mut self) {
        if self.phase == Phase::Detached {
            self.counters.clear();
            self.phase = Phase::Waiting { run: 0, sequences_left: 1 };
        }
    }

    /// Puts the node into bus-off whatever it does.
    pub fn force_bus_off(&mut self) {
        if self.phase != Phase::Detached {
            self.counters.force_bus_off();
            self.enter_bus_off();
        }
    }

    /// Permits recovery of a node that does not recover by itself; false if there is nothing to permit.
    pub fn request_recovery(&mut self) -> bool {
        let held = self.phase == Phase::HeldOff;
        if held {
            self.phase = Phase::Waiting { run: 0, sequences_left: RECOVERY_SEQUENCES };
        }
        held
    }

    /// After a transmission in the frame-by-frame gear: rule 7. Returns the bits to suspend.
    pub fn transmitted_in_one(&mut self) -> u8 {
        self.counters.transmitted();
        if self.counters.state() == Confinement::Passive { SUSPEND_BITS } else { 0 }
    }

    /// After a reception in the frame-by-frame gear: rule 8.
    pub fn received_in_one(&mut self) {
        self.counters.received();
    }

    /// Enters the bit-by-bit gear with what is left to suspend.
    pub fn resume_suspend(&mut self, bits_left: u8) {
        if self.is_idle() && bits_left > 0 {
            self.phase = Phase::Suspend { seen: SUSPEND_BITS.saturating_sub(bits_left) };
        }
    }

    /// Leaves the bit-by-bit gear: the bus keeps count of the suspension from here on.
    pub fn leave_suspend(&mut self) {
        if matches!(self.phase, Phase::Suspend { .. }) {
            self.phase = Phase::Idle;
        }
    }

    /// Takes over the progress of waiting from the frame-by-frame gear; true if the node joined.
    pub fn set_waiting(&mut self, sequences_left: u16, run: u8) -> bool {
        if self.waiting().is_none() {
            return false;
        }
        self.phase = Phase::Waiting { run, sequences_left };
        if sequences_left == 0 {
            self.join();
        }
        sequences_left == 0
    }

    fn join(&mut self) {
        self.counters.clear();
        self.transmitter = false;
        self.phase = Phase::Idle;
    }

    fn enter_bus_off(&mut self) {
        self.sending = None;
        self.transmitter = false;
        self.level = RECESSIVE;
        self.phase = if self.automatic_recovery {
            Phase::Waiting { run: 0, sequences_left: RECOVERY_SEQUENCES }
        } else {
            Phase::HeldOff
        };
    }

    /// Level for the next bit. `offer` is the frame the node would start with if it may.
    pub fn output(&mut self, offer: Option<&Frame>) -> bool {
        if self.phase == Phase::Idle
            && let Some(frame) = offer
        {
            self.sending = Some((WireBits::new(frame), 0, frame.is_extended()));
            self.took_offer = true;
        }
        self.level = match self.phase {
            Phase::Idle => {
                if self.sending.is_some() {
                    DOMINANT
                } else {
                    RECESSIVE
                }
            }
            Phase::Stuffed => match &mut self.sending {
                Some((bits, next, _)) => bits.get(*next),
                None => RECESSIVE,
            },
            Phase::AckSlot => {
                if !self.transmitter && self.parser.checksum_ok() {
                    DOMINANT
                } else {
                    RECESSIVE
                }
            }
            Phase::Flag { kind: FlagKind::ActiveError | FlagKind::Overload, .. } => DOMINANT,
            _ => RECESSIVE,
        };
        self.level
    }

    /// Takes the bus level of the bit just driven. `offer` as in [`Controller::output`]: a node that sees a
    /// start of frame in the last bit of intermission joins in with its first id bit.
    pub fn sample(&mut self, bit: bool, offer: Option<&Frame>) -> Option<Outcome> {
        match self.phase {
            Phase::Detached | Phase::HeldOff => None,
            Phase::Waiting { run, sequences_left } => self.sample_waiting(bit, run, sequences_left),
            Phase::Idle => self.sample_idle(bit),
            Phase::Stuffed => self.sample_stuffed(bit),
            Phase::CrcDelimiter => {
                if bit == DOMINANT {
                    return self.error(self.fixed_form_error());
                }
                self.phase = Phase::AckSlot;
                None
            }
            Phase::AckSlot => self.sample_ack_slot(bit),
            Phase::AckDelimiter => {
                if bit == DOMINANT {
                    return self.error(self.fixed_form_error());
                }
                if !self.transmitter && !self.parser.checksum_ok() {
                    // A checksum error is signalled after the acknowledge delimiter, not before.
                    return self.error(ErrorKind::Crc);
                }
                self.phase = Phase::EndOfFrame { seen: 0 };
                None
            }
            Phase::EndOfFrame { seen } => self.sample_end_of_frame(bit, seen),
            Phase::Flag { kind, seen } => self.sample_flag(bit, kind, seen),
            Phase::AfterFlag { kind, dominant, first } => self.sample_after_flag(bit, kind, dominant, first),
            Phase::Delimiter { seen } => self.sample_delimiter(bit, seen),
            Phase::Intermission { seen } => self.sample_intermission(bit, seen, offer),
            Phase::Suspend { seen } => {
                if bit == DOMINANT {
                    // Another node was faster: receive.
                    self.transmitter = false;
                    self.start_of_frame();
                } else if seen + 1 == SUSPEND_BITS {
                    self.transmitter = false;
                    self.phase = Phase::Idle;
                } else {
                    self.phase = Phase::Suspend { seen: seen + 1 };
                }
                None
            }
        }
    }

    fn sample_waiting(&mut self, bit: bool, run: u8, sequences_left: u16) -> Option<Outcome> {
        let run = if bit == RECESSIVE { run + 1 } else { 0 };
        if run < SEQUENCE_BITS {
            self.phase = Phase::Waiting { run, sequences_left };
            return None;
        }
        if sequences_left > 1 {
            self.phase = Phase::Waiting { run: 0, sequences_left: sequences_left - 1 };
            return None;
        }
        self.join();
        Some(Outcome::Joined)
    }

    fn sample_idle(&mut self, bit: bool) -> Option<Outcome> {
        if let Some((_, next, _)) = &mut self.sending {
            *next = 1;
            self.transmitter = true;
            if bit == RECESSIVE {
                return self.error(ErrorKind::Bit);
            }
            self.start_of_frame();
        } else if bit == DOMINANT {
            self.start_of_frame();
        }
        None
    }

    fn start_of_frame(&mut self) {
        self.parser = Parser::after_start_of_frame();
        self.phase = Phase::Stuffed;
    }

    fn sample_stuffed(&mut self, bit: bool) -> Option<Outcome> {
        let mut lost = None;
        if let Some((_, next, extended)) = &mut self.sending {
            let extended = *extended;
            *next += 1;
            if self.level != bit {
                let arbitrating = self.level == RECESSIVE && self.parser.in_arbitration(extended);
                if !arbitrating {
                    return self.error(ErrorKind::Bit);
                }
                if self.parser.expects_stuff_bit() {
                    return self.error(ErrorKind::StuffInArbitration);
                }
                self.sending = None;
                self.transmitter = false;
                lost = Some(Outcome::LostArbitration);
            }
        }
        match self.parser.accept(bit) {
            Step::StuffError => return self.error(ErrorKind::Stuff),
            Step::Complete => self.phase = Phase::CrcDelimiter,
            Step::More => {}
        }
        lost
    }

    fn sample_ack_slot(&mut self, bit: bool) -> Option<Outcome> {
        if self.transmitter {
            if bit == RECESSIVE {
                return self.error(ErrorKind::Ack);
            }
        } else if self.level == DOMINANT {
            if bit == RECESSIVE {
                return self.error(ErrorKind::Bit);
            }
            self.counters.received();
        }
        self.phase = Phase::AckDelimiter;
        None
    }

    fn sample_end_of_frame(&mut self, bit: bool, seen: u8) -> Option<Outcome> {
        let last = seen + 1 == EOF_BITS;
        if bit == DOMINANT {
            if self.transmitter || !last {
                return self.error(self.fixed_form_error());
            }
            // A receiver has accepted the frame one bit ago: overload, not error.
            return self.overload();
        }
        if last {
            self.phase = Phase::Intermission { seen: 0 };
            if self.transmitter {
                self.sending = None;
                self.counters.transmitted();
                return Some(Outcome::Transmitted);
            }
            return None;
        }
        self.phase = Phase::EndOfFrame { seen: seen + 1 };
        if seen + 2 == EOF_BITS && !self.transmitter {
            return self.parser.frame().map(Outcome::Received);
        }
        None
    }

    fn sample_intermission(&mut self, bit: bool, seen: u8, offer: Option<&Frame>) -> Option<Outcome> {
        let last = seen + 1 == INTERMISSION_BITS;
        if bit == DOMINANT {
            if !last {
                return self.overload();
            }
            let suspended = self.must_suspend();
            self.transmitter = false;
            self.sending = None;
            if let (Some(frame), false) = (offer, suspended) {
                self.sending = Some((WireBits::new(frame), 1, frame.is_extended()));
                self.took_offer = true;
                self.transmitter = true;
            }
            self.start_of_frame();
            return None;
        }
        if !last {
            self.phase = Phase::Intermission { seen: seen + 1 };
            return None;
        }
        self.phase = if self.must_suspend() { Phase::Suspend { seen: 0 } } else { Phase::Idle };
        self.sending = None;
        self.transmitter = false;
        None
    }

    fn must_suspend(&self) -> bool {
        self.transmitter && self.counters.state() == Confinement::Passive
    }
}

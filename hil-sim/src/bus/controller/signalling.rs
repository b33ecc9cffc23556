//! Error and overload frames: flags, delimiters, and what they do to the counters.
//!
//! Rules are those of fault confinement, numbered as in [`counters`](super::super::counters).

use super::super::counters::Confinement;
use super::super::encode::{DOMINANT, RECESSIVE};
use super::super::stats::ErrorKind;
use super::{Controller, FlagKind, Outcome, Phase};

/// Bits of an error or overload flag.
const FLAG_BITS: u8 = 6;
/// Bits of an error or overload delimiter.
const DELIMITER_BITS: u8 = 8;
/// Dominant bits after the own flag from which on rule 6 counts, and then for each further eight.
const RULE_6_BITS: u8 = 8;

impl Controller {
    pub(super) fn sample_flag(&mut self, bit: bool, kind: FlagKind, seen: u8) -> Option<Outcome> {
        let seen = match kind {
            FlagKind::PassiveError => {
                if bit == DOMINANT && self.ack_error_pending {
                    self.ack_error_pending = false;
                    self.counters.transmit_error();
                    if self.counters.state() == Confinement::BusOff {
                        self.enter_bus_off();
                        return Some(Outcome::BusOff(None));
                    }
                }
                if seen > 0 && bit == self.flag_level { seen + 1 } else { 1 }
            }
            FlagKind::ActiveError | FlagKind::Overload => {
                if bit == RECESSIVE {
                    // Rules 4 and 5; rule 1 leaves this case out.
                    return self.count_eight_and(|node| {
                        node.begin_flag(FlagKind::ActiveError);
                        Some(Outcome::Error(ErrorKind::Bit))
                    });
                }
                seen + 1
            }
        };
        self.flag_level = bit;
        self.phase = if seen == FLAG_BITS {
            self.ack_error_pending = false;
            Phase::AfterFlag { kind, dominant: 0, first: true }
        } else {
            Phase::Flag { kind, seen }
        };
        None
    }

    pub(super) fn sample_after_flag(
        &mut self,
        bit: bool,
        kind: FlagKind,
        dominant: u8,
        first: bool,
    ) -> Option<Outcome> {
        if bit == RECESSIVE {
            self.phase = Phase::Delimiter { seen: 1 };
            return None;
        }
        if first && !self.transmitter && kind != FlagKind::Overload {
            // Rule 2.
            self.counters.receive_error_grave();
        }
        let dominant = dominant + 1;
        if dominant < RULE_6_BITS {
            self.phase = Phase::AfterFlag { kind, dominant, first: false };
            return None;
        }
        // Rule 6: the 14th dominant bit in a row with an own active or overload flag, the eighth
        // after a passive one, and every eight more.
        self.phase = Phase::AfterFlag { kind, dominant: 0, first: false };
        self.count_eight_and(|_| None)
    }

    pub(super) fn sample_delimiter(&mut self, bit: bool, seen: u8) -> Option<Outcome> {
        if bit == DOMINANT {
            if seen + 1 == DELIMITER_BITS {
                return self.overload();
            }
            return self.error(ErrorKind::Form);
        }
        self.phase = if seen + 1 == DELIMITER_BITS {
            Phase::Intermission { seen: 0 }
        } else {
            Phase::Delimiter { seen: seen + 1 }
        };
        None
    }

    /// A dominant bit where the form is fixed and recessive: for the transmitter it differs from what it sent.
    pub(super) fn fixed_form_error(&self) -> ErrorKind {
        if self.transmitter { ErrorKind::Bit } else { ErrorKind::Form }
    }

    pub(super) fn overload(&mut self) -> Option<Outcome> {
        self.begin_flag(FlagKind::Overload);
        Some(Outcome::Overload)
    }

    fn begin_flag(&mut self, kind: FlagKind) {
        self.phase = Phase::Flag { kind, seen: 0 };
    }

    /// Counts by rules 1 and 3 and begins the flag of the state *before* counting (rule 9).
    pub(super) fn error(&mut self, kind: ErrorKind) -> Option<Outcome> {
        let was_passive = self.counters.state() == Confinement::Passive;
        self.sending = None;
        self.ack_error_pending = false;
        if self.transmitter {
            match kind {
                // Rule 3, exception 1: decided by what the passive flag meets.
                ErrorKind::Ack if was_passive => self.ack_error_pending = true,
                // Rule 3, exception 2.
                ErrorKind::StuffInArbitration => {}
                _ => self.counters.transmit_error(),
            }
        } else {
            self.counters.receive_error();
        }
        if self.counters.state() == Confinement::BusOff {
            self.enter_bus_off();
            return Some(Outcome::BusOff(Some(kind)));
        }
        self.begin_flag(if was_passive { FlagKind::PassiveError } else { FlagKind::ActiveError });
        Some(Outcome::Error(kind))
    }

    /// Rules 4, 5 and 6: eight for the role's counter, then `next` unless that was the end.
    fn count_eight_and(&mut self, next: impl FnOnce(&mut Self) -> Option<Outcome>) -> Option<Outcome> {
        if self.transmitter {
            self.counters.transmit_error();
        } else {
            self.counters.receive_error_grave();
        }
        if self.counters.state() == Confinement::BusOff {
            self.enter_bus_off();
            return Some(Outcome::BusOff(None));
        }
        next(self)
    }
}

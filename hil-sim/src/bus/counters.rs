//! Transmit and receive error counters and the state that follows from them.

use serde::Serialize;

/// Error-passive from this count on (rule 9).
pub const PASSIVE_LIMIT: u16 = 128;
/// Bus-off from this transmit count on (rule 10).
pub const BUS_OFF_LIMIT: u16 = 256;
/// Sequences of eleven recessive bits that end bus-off (rule 12).
pub const RECOVERY_SEQUENCES: u16 = 128;
/// Recessive bits of one such sequence.
pub const SEQUENCE_BITS: u8 = 11;
/// New value of a receive counter above 127 after rule 8: "a value between 119 and 127". 127 keeps the node closest
/// to its present state.
pub const REC_AFTER_SUCCESS: u16 = 127;
/// Above passive, larger receive counters make no difference; the counter stops here, as an 8-bit register does.
const REC_MAX: u16 = 255;

/// Fault confinement state of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Confinement {
    /// Sends active error flags.
    Active,
    /// Sends passive error flags and waits eight more bits before it transmits again.
    Passive,
    /// Takes no part in the bus.
    BusOff,
}

/// TEC and REC with the increments of the specification.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    tec: u16,
    rec: u16,
    tec_peak: u16,
    rec_peak: u16,
}

impl Counters {
    /// Transmit error counter.
    pub const fn tec(&self) -> u16 {
        self.tec
    }

    /// Receive error counter, stops at 255.
    pub const fn rec(&self) -> u16 {
        self.rec
    }

    /// Largest transmit error counter seen.
    pub const fn tec_peak(&self) -> u16 {
        self.tec_peak
    }

    /// Largest receive error counter seen.
    pub const fn rec_peak(&self) -> u16 {
        self.rec_peak
    }

    /// State by rules 9, 10 and 11.
    pub const fn state(&self) -> Confinement {
        if self.tec >= BUS_OFF_LIMIT {
            Confinement::BusOff
        } else if self.tec >= PASSIVE_LIMIT || self.rec >= PASSIVE_LIMIT {
            Confinement::Passive
        } else {
            Confinement::Active
        }
    }

    /// Rules 3, 4 and 6: transmit errors count eight.
    pub fn transmit_error(&mut self) {
        // Counting stops with bus-off.
        self.tec = (self.tec + 8).min(BUS_OFF_LIMIT);
        self.tec_peak = self.tec_peak.max(self.tec);
    }

    /// Rule 1: an error detected as receiver counts one.
    pub fn receive_error(&mut self) {
        self.add_rec(1);
    }

    /// Rules 2, 5 and 6: grave receive errors count eight.
    pub fn receive_error_grave(&mut self) {
        self.add_rec(8);
    }

    fn add_rec(&mut self, by: u16) {
        self.rec = (self.rec + by).min(REC_MAX);
        self.rec_peak = self.rec_peak.max(self.rec);
    }

    /// Rule 7: successful transmission.
    pub fn transmitted(&mut self) {
        self.tec = self.tec.saturating_sub(1);
    }

    /// Rule 8: successful reception.
    pub fn received(&mut self) {
        self.rec = if self.rec > 127 { REC_AFTER_SUCCESS } else { self.rec.saturating_sub(1) };
    }

    /// Rule 12, or power on: both counters zero. Peaks stay for the report.
    pub fn clear(&mut self) {
        self.tec = 0;
        self.rec = 0;
    }

    /// Sets the transmit counter to bus-off, as the `bus-off` fault does.
    pub fn force_bus_off(&mut self) {
        self.tec = BUS_OFF_LIMIT;
        self.tec_peak = BUS_OFF_LIMIT;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn after_transmit_errors(count: usize) -> Counters {
        let mut counters = Counters::default();
        (0..count).for_each(|_| counters.transmit_error());
        counters
    }

    #[test]
    fn rule_9_passive_starts_at_128_of_either_counter() {
        assert_eq!(after_transmit_errors(15).state(), Confinement::Active);
        assert_eq!(after_transmit_errors(16).state(), Confinement::Passive);
        let mut counters = Counters::default();
        (0..127).for_each(|_| counters.receive_error());
        assert_eq!(counters.state(), Confinement::Active);
        counters.receive_error();
        assert_eq!(counters.state(), Confinement::Passive);
    }

    #[test]
    fn rule_10_bus_off_starts_at_256_and_receive_errors_never_lead_there() {
        assert_eq!(after_transmit_errors(31).state(), Confinement::Passive);
        assert_eq!(after_transmit_errors(32).state(), Confinement::BusOff);
        let mut counters = Counters::default();
        (0..10_000).for_each(|_| counters.receive_error_grave());
        assert_eq!((counters.rec(), counters.state()), (255, Confinement::Passive));
    }

    #[test]
    fn rule_7_and_8_successes_count_down_to_zero_and_not_below() {
        let mut counters = after_transmit_errors(1);
        (0..20).for_each(|_| counters.transmitted());
        assert_eq!(counters.tec(), 0);
        counters.receive_error();
        counters.received();
        counters.received();
        assert_eq!(counters.rec(), 0);
    }

    #[test]
    fn rule_8_a_receive_counter_above_127_falls_into_119_to_127_at_once() {
        let mut counters = Counters::default();
        (0..25).for_each(|_| counters.receive_error_grave());
        assert_eq!(counters.rec(), 200);
        counters.received();
        assert!((119..=127).contains(&counters.rec()));
    }

    #[test]
    fn rule_11_active_again_only_when_both_counters_are_below_128() {
        let mut counters = after_transmit_errors(16);
        (0..16).for_each(|_| counters.receive_error_grave());
        counters.transmitted();
        assert_eq!((counters.tec(), counters.rec(), counters.state()), (127, 128, Confinement::Passive));
        counters.received();
        assert_eq!(counters.state(), Confinement::Active);
    }
}

//! How long a control cycle takes here, with this bus and these drives: known before anything moves.
//!
//! # What bounds a cycle
//!
//! Per joint four frames: write 95, acknowledge 71, motion 95, answer 111 bits, 372 without stuff bits, up to 450 with them.
//! Six joints fill 2.2 to 2.7 ms at 1 Mbit/s. Drives think at the same time, so their answer time D shows only at the two ends
//! of a cycle where the bus waits: before the first acknowledge, and after the last motion. So
//!
//! ```text
//! cycle ≈ joints × bits × bit time + about D       while in_flight_max × (request + answer) > request + D + answer
//! cycle ≈ 2 joints × (request + D + answer) / in_flight_max      beyond: drives that slow leave the bus idle
//! ```
//!
//! Four in flight at 1 Mbit/s hold the first line up to D = 0.55 ms. What is left of the period is for the watchdog's sign of
//! life and Cyphal; they wait, a joint never waits for them. The read for monitoring has its place in the cycle, and is left out after
//! a late one.
//!
//! # Timing check
//!
//! While nothing moves, every fourth poll of the drives is a timing check: a cycle that only reads, with two reads per joint in
//! the order and with the pipelining of a control cycle, at 8 % fewer bits. Its duration, with those bits added, must fit into the period
//! before a motion may begin ([`Cause::CycleTooShort`](crate::fault::Cause::CycleTooShort) names the period that would do).
//! Readiness takes the last 32 timing checks, ignores the slowest quarter and two more, and uses the longest of the rest. So a
//! computer that is late now and then does not count as a slow drive; single late cycles stop nothing either. With a window of
//! eight timing checks, one throw of some hundred was refused at 3 ms and 200 ± 100 µs, although all of them can run.

use protocol::Instant;

/// Bits by which a joint's writes, acknowledge and motion exceed the reads of a timing check (40), with stuff bits, µs at 1 Mbit/s.
const MORE_PER_JOINT_US: u32 = 44;
/// The read for monitoring of a cycle: request and answer, 158 bits and stuff bits, µs at 1 Mbit/s.
pub(crate) const MONITORING_US: u32 = 175;
/// Timing checks that are kept.
const WINDOW: usize = 32;
/// The longest of each four is ignored, and two more, because there may be few at first.
const SHARE: usize = 4;

/// Durations of control cycles since the run began; zero without any.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CycleTimes {
    /// Cycles in which every joint answered.
    pub cycles: u32,
    /// From the start of a cycle to the last joint's answer: sum of all, µs.
    pub sum_us: u32,
    /// The longest, µs.
    pub worst_us: u32,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Check,
    Cycle,
}

/// Measures how long timing checks and control cycles take.
#[derive(Clone, Copy, Debug, Default)]
pub struct CycleTimer {
    begun: Option<(Instant, Kind)>,
    checked: usize,
    /// The last timing checks, in no order, µs.
    last_us: [u32; WINDOW],
    times: CycleTimes,
}

impl CycleTimer {
    /// A timing check begins.
    pub const fn begin_check(&mut self, now: Instant) {
        self.begun = Some((now, Kind::Check));
    }

    /// A control cycle begins.
    pub const fn begin_cycle(&mut self, now: Instant) {
        self.begun = Some((now, Kind::Cycle));
    }

    /// Drops the measurement: a reply was missed, or another request came in between.
    pub const fn abandon(&mut self) {
        self.begun = None;
    }

    /// True during a timing check.
    pub fn is_checking(&self) -> bool {
        self.begun.is_some_and(|(_, kind)| kind == Kind::Check)
    }

    fn end(&mut self, now: Instant, of: Kind) -> Option<u32> {
        let (begun, _) = self.begun.take().filter(|(_, kind)| *kind == of)?;
        Some(u32::try_from(now.saturating_since(begun).as_micros()).unwrap_or(u32::MAX))
    }

    /// The last answer of a timing check has come.
    pub fn end_check(&mut self, now: Instant) {
        let Some(us) = self.end(now, Kind::Check) else { return };
        if let Some(place) = self.last_us.get_mut(self.checked % WINDOW) {
            *place = us;
        }
        self.checked = (self.checked + 1) % (2 * WINDOW);
        if self.checked == 0 {
            // Full stays full.
            self.checked = WINDOW;
        }
    }

    /// The last joint's answer of a control cycle has come.
    pub fn end_cycle(&mut self, now: Instant) {
        let Some(us) = self.end(now, Kind::Cycle) else { return };
        self.times.cycles = self.times.cycles.saturating_add(1);
        self.times.sum_us = self.times.sum_us.saturating_add(us);
        self.times.worst_us = self.times.worst_us.max(us);
    }

    /// A run begins: its cycles are counted again.
    pub fn begin_run(&mut self) {
        (self.begun, self.times) = (None, CycleTimes::default());
    }

    /// Nothing is known about these drives.
    pub fn forget(&mut self) {
        *self = Self::default();
    }

    /// How long a control cycle of this many joints takes, with a read for monitoring or without, µs; `None` before the first
    /// timing check.
    pub fn cycle_us(&self, joints: u32, monitored: bool) -> Option<u32> {
        let last_us = self.last_us.get(..self.checked.min(WINDOW)).unwrap_or(&self.last_us);
        let outliers = (last_us.len() / SHARE + 2).min(last_us.len().saturating_sub(1));
        let as_long = |us: u32| last_us.iter().filter(|other| **other >= us).count();
        let longest_us = last_us.iter().copied().filter(|us| as_long(*us) > outliers).max()?;
        Some(
            longest_us.saturating_add(joints * MORE_PER_JOINT_US + if monitored { MONITORING_US } else { 0 }),
        )
    }

    /// Cycles of the last run.
    pub const fn times(&self) -> CycleTimes {
        self.times
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(timing: &mut CycleTimer, us: u64) {
        timing.begin_check(Instant::from_micros(1_000));
        timing.end_check(Instant::from_micros(1_000 + us));
    }

    #[test]
    fn the_longest_of_the_last_timing_checks_counts_but_for_a_quarter_and_two() {
        let mut timing = CycleTimer::default();
        assert_eq!(timing.cycle_us(6, true), None);
        check(&mut timing, 2_500);
        assert_eq!(timing.cycle_us(6, true), Some(2_500 + 6 * MORE_PER_JOINT_US + MONITORING_US));
        for us in [9_000, 2_100, 2_000, 2_600, 2_050, 2_200, 2_300] {
            check(&mut timing, us);
        }
        assert_eq!(timing.cycle_us(0, false), Some(2_200), "the four longest are left out");
        for _ in 0..3 * WINDOW {
            check(&mut timing, 2_000);
        }
        assert_eq!(timing.cycle_us(0, false), Some(2_000), "what is old is forgotten");
    }

    #[test]
    fn a_missed_reply_spoils_a_measurement() {
        let mut timing = CycleTimer::default();
        timing.begin_check(Instant::ZERO);
        timing.abandon();
        timing.end_check(Instant::from_micros(90_000));
        timing.begin_cycle(Instant::ZERO);
        timing.end_check(Instant::from_micros(90_000));
        assert_eq!(timing.cycle_us(6, true), None);
    }

    #[test]
    fn a_run_counts_its_own_cycles() {
        let mut timing = CycleTimer::default();
        for us in [2_000, 2_600] {
            timing.begin_cycle(Instant::ZERO);
            timing.end_cycle(Instant::from_micros(us));
        }
        assert_eq!(timing.times(), CycleTimes { cycles: 2, sum_us: 4_600, worst_us: 2_600 });
        timing.begin_run();
        assert_eq!(timing.times(), CycleTimes::default());
    }
}

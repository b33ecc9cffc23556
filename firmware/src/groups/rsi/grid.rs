//! When the robot's cycles begin, from the numbers of its telegrams and the times at which they arrive (pure).

use protocol::{Duration, Instant};

/// Cycles without a telegram after which it counts as missed.
pub(super) const WINDOWS: u64 = 3;
/// The grid follows arrival times with this fraction, as 1/n.
const SHARE: u64 = 16;
/// And by this share of the period at most, as 1/n. It raises the speed of set points by the same share, and a planned speed may
/// be 0.5 % below the robot's limit. Clocks drift by less than a tenth of it.
const CAP: u64 = 512;

/// See the [module](self).
#[derive(Debug, Default)]
pub(super) struct Grid {
    /// Beginning of the robot's cycle of the last telegram, smoothed: a network and a busy computer delay telegrams unevenly, and
    /// a millisecond of that would be a leap of the set points.
    pub(super) at: Instant,
    /// Time of the last telegram.
    pub(super) heard_at: Instant,
    /// Number of the last telegram, and by how much numbers rise per cycle; 0: not known yet.
    ipoc: u64,
    ipoc_step: u64,
}

impl Grid {
    /// Moves on to the cycle of the telegram `ipoc` that arrives now; returns the cycles that have passed, at least 1.
    ///
    /// Its number says how many: a telegram that a busy computer or a held-up robot hands over late, but before it counts as
    /// missed, is still the next one. The time says it for a number ahead by more than one cycle, which is wrong, and after a
    /// silence since the telegram before, in which the robot stood.
    pub(super) fn advance(&mut self, now: Instant, period: Duration, ipoc: u64) -> u32 {
        let period_us = period.as_micros().max(1);
        let cycles_since = |at: Instant| {
            (now.saturating_since(at).as_micros().saturating_add(period_us / 2) / period_us).max(1)
        };
        let by_time = cycles_since(self.at);
        let rise = ipoc.saturating_sub(self.ipoc);
        if rise > 0 && (self.ipoc_step == 0 || rise < self.ipoc_step) {
            self.ipoc_step = rise;
        }
        let by_number = rise.checked_div(self.ipoc_step).filter(|_| rise > 0).unwrap_or(by_time).max(1);
        let is_ahead = by_number > by_time.saturating_add(1);
        let is_missed = cycles_since(self.heard_at) >= by_number.saturating_add(WINDOWS);
        let cycles = if is_ahead || is_missed { by_time } else { by_number };
        let expected = self.at + period * cycles;
        let towards = |off: Duration| Duration::from_micros((off.as_micros() / SHARE).min(period_us / CAP));
        self.at = match now.checked_since(expected) {
            Some(later) => expected + towards(later),
            None => expected.saturating_sub(towards(expected.saturating_since(now))),
        };
        (self.heard_at, self.ipoc) = (now, ipoc);
        u32::try_from(cycles).unwrap_or(u32::MAX)
    }

    /// The telegram that arrived now may be of another run: its cycle begins now, and its numbers may rise otherwise.
    pub(super) fn begin_anew(&mut self, now: Instant) {
        (self.ipoc_step, self.at) = (0, now);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn telegram_counts_cycles_by_its_number_unless_that_is_ahead_of_the_time() {
        let period = Duration::from_millis(4);
        let after = |ms: u64, ipoc: u64| {
            let at = Instant::from_micros(1_000_000);
            let mut grid = Grid { at, heard_at: at, ipoc: 100, ipoc_step: 4 };
            (grid.advance(at + Duration::from_millis(ms), period, ipoc), grid.at)
        };
        assert_eq!(after(4, 104), (1, Instant::from_micros(1_004_000)));
        // Held up by more than a cycle: the next telegram all the same, and the grid follows slowly, by 1/512 of a cycle at most.
        assert_eq!(after(12, 104), (1, Instant::from_micros(1_004_007)));
        assert_eq!(after(5, 104), (1, Instant::from_micros(1_004_007)));
        assert_eq!(after(3, 104), (1, Instant::from_micros(1_003_993)));
        assert_eq!(after(12, 112).0, 3, "two were lost");
        assert_eq!(after(40, 104).0, 10, "a silence");
        assert_eq!(after(4, 2_900).0, 1, "a wrong number");
    }
}

//! How late things happen: a histogram with fixed memory.

use std::fmt;

use protocol::Duration;

/// Powers of two of microseconds: bucket 0 holds 0 µs, bucket k holds 2^(k-1)..2^k µs, the last one
/// everything from about half a second.
const BUCKETS: usize = 21;

/// Distribution of delays, in microseconds.
///
/// Minimum, maximum and mean are exact; percentiles are upper bounds, at most twice the true value.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Lateness {
    count: u64,
    sum_us: u64,
    min_us: u64,
    max_us: u64,
    buckets: [u64; BUCKETS],
}

impl Lateness {
    pub fn record(&mut self, late: Duration) {
        let us = late.as_micros();
        self.min_us = if self.count == 0 { us } else { self.min_us.min(us) };
        self.max_us = self.max_us.max(us);
        self.sum_us = self.sum_us.saturating_add(us);
        self.count += 1;
        let bucket = ((u64::BITS - us.leading_zeros()) as usize).min(BUCKETS - 1);
        if let Some(slot) = self.buckets.get_mut(bucket) {
            *slot += 1;
        }
    }

    /// Number of recorded delays.
    pub const fn count(&self) -> u64 {
        self.count
    }

    /// Smallest delay; `None` if there were no delays.
    pub fn min(&self) -> Option<Duration> {
        (self.count > 0).then(|| Duration::from_micros(self.min_us))
    }

    /// Largest delay; `None` if there were no delays.
    pub fn max(&self) -> Option<Duration> {
        (self.count > 0).then(|| Duration::from_micros(self.max_us))
    }

    /// Mean delay, rounded down; `None` if there were no delays.
    pub fn mean(&self) -> Option<Duration> {
        self.sum_us.checked_div(self.count).map(Duration::from_micros)
    }

    /// A delay that the given share of all delays (0.0..=1.0) does not exceed; `None` if there were no delays.
    pub fn percentile(&self, share: f64) -> Option<Duration> {
        let wanted = ((share.clamp(0.0, 1.0) * self.count as f64).ceil() as u64).max(1);
        let mut seen = 0;
        for (bucket, count) in self.buckets.iter().enumerate() {
            seen += count;
            if seen >= wanted {
                // Largest value of the bucket, or of all values if that is less.
                let bound = if bucket == BUCKETS - 1 { u64::MAX } else { (1 << bucket) - 1 };
                return Some(Duration::from_micros(bound.min(self.max_us)));
            }
        }
        None
    }
}

/// `1000 times, 12 us at least, 60 us on average, 99 % within 127 us, 310 us at most`
impl fmt::Display for Lateness {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.min(), self.mean(), self.percentile(0.99), self.max()) {
            (Some(min), Some(mean), Some(p99), Some(max)) => write!(
                f,
                "{} times, {min} at least, {mean} on average, 99 % within {p99}, {max} at most",
                self.count
            ),
            _ => f.write_str("never"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_bound_the_true_value_from_above_within_a_factor_of_two() {
        let mut lateness = Lateness::default();
        for us in 1..=1000 {
            lateness.record(Duration::from_micros(us));
        }
        for (share, exact) in [(0.5, 500), (0.99, 990), (1.0, 1000), (0.0, 1)] {
            let bound = lateness.percentile(share).unwrap().as_micros();
            assert!((exact..=2 * exact).contains(&bound), "{share}: {bound}");
        }
        assert_eq!(lateness.mean(), Some(Duration::from_micros(500)));
        assert_eq!((lateness.min().unwrap().as_micros(), lateness.max().unwrap().as_micros()), (1, 1000));
    }

    #[test]
    fn nothing_recorded_is_never_and_extremes_are_kept() {
        let mut lateness = Lateness::default();
        assert_eq!((lateness.to_string().as_str(), lateness.percentile(0.5)), ("never", None));
        lateness.record(Duration::MAX);
        lateness.record(Duration::ZERO);
        assert_eq!(lateness.percentile(0.5), Some(Duration::ZERO));
        assert_eq!(lateness.percentile(1.0), Some(Duration::MAX));
    }
}

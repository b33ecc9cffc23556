//! Time as an argument: integer microseconds since an origin that the runner chooses.
//!
//! Only a runner reads a clock. All arithmetic saturates: a deadline computed from hostile input is at worst
//! "never" (584 000 years); it does not wrap and does not panic.

use core::fmt;
use core::ops::{Add, AddAssign, Mul, Sub};

/// Point in time, microseconds since the runner's origin.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Instant(u64);

impl Instant {
    /// The runner's origin.
    pub const ZERO: Self = Self(0);
    /// Later than everything: a deadline that never comes.
    pub const FAR_FUTURE: Self = Self(u64::MAX);

    /// From microseconds since the origin.
    pub const fn from_micros(us: u64) -> Self {
        Self(us)
    }

    /// Microseconds since the origin.
    pub const fn as_micros(self) -> u64 {
        self.0
    }

    /// Seconds since the origin; exact up to 2^53 µs (285 years).
    pub const fn as_secs_f64(self) -> f64 {
        self.0 as f64 * 1e-6
    }

    /// Time since `earlier`; zero if `earlier` is later.
    pub const fn saturating_since(self, earlier: Self) -> Duration {
        Duration(self.0.saturating_sub(earlier.0))
    }

    /// Time since `earlier`; `None` if `earlier` is later.
    pub const fn checked_since(self, earlier: Self) -> Option<Duration> {
        match self.0.checked_sub(earlier.0) {
            Some(us) => Some(Duration(us)),
            None => None,
        }
    }

    /// `self - span`, not before the origin.
    pub const fn saturating_sub(self, span: Duration) -> Self {
        Self(self.0.saturating_sub(span.0))
    }
}

/// Length of time, microseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Duration(u64);

impl Duration {
    /// No time at all.
    pub const ZERO: Self = Self(0);
    /// The longest span.
    pub const MAX: Self = Self(u64::MAX);

    /// From microseconds.
    pub const fn from_micros(us: u64) -> Self {
        Self(us)
    }

    /// From milliseconds.
    pub const fn from_millis(ms: u64) -> Self {
        Self(ms.saturating_mul(1_000))
    }

    /// From seconds.
    pub const fn from_secs(s: u64) -> Self {
        Self(s.saturating_mul(1_000_000))
    }

    /// Rounds to the nearest microsecond; NaN and negative spans become zero, huge ones the longest.
    pub const fn from_secs_f64(s: f64) -> Self {
        // A float-to-integer cast saturates and maps NaN to zero; +0.5 rounds half up.
        Self((s * 1e6 + 0.5) as u64)
    }

    /// Microseconds.
    pub const fn as_micros(self) -> u64 {
        self.0
    }

    /// Seconds, for reports and double-precision models.
    pub const fn as_secs_f64(self) -> f64 {
        self.0 as f64 * 1e-6
    }

    /// `self - other`, not below zero.
    pub const fn saturating_sub(self, other: Self) -> Self {
        Self(self.0.saturating_sub(other.0))
    }

    /// True for no time at all.
    pub const fn is_zero(self) -> bool {
        self.0 == 0
    }
}

impl Add<Duration> for Instant {
    type Output = Self;
    fn add(self, span: Duration) -> Self {
        Self(self.0.saturating_add(span.0))
    }
}

impl AddAssign<Duration> for Instant {
    fn add_assign(&mut self, span: Duration) {
        *self = *self + span;
    }
}

impl Add for Duration {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self(self.0.saturating_add(other.0))
    }
}

impl AddAssign for Duration {
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl Sub for Duration {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self.saturating_sub(other)
    }
}

impl Mul<u64> for Duration {
    type Output = Self;
    fn mul(self, factor: u64) -> Self {
        Self(self.0.saturating_mul(factor))
    }
}

/// Seconds with six decimals, as in a candump log.
impl fmt::Display for Instant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{:06}", self.0 / 1_000_000, self.0 % 1_000_000)
    }
}

impl fmt::Display for Duration {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            us @ 0..1_000 => write!(f, "{us} us"),
            us @ 1_000..1_000_000 => write!(f, "{}.{:03} ms", us / 1_000, us % 1_000),
            us => write!(f, "{}.{:06} s", us / 1_000_000, us % 1_000_000),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deadlines_saturate_instead_of_wrapping() {
        assert_eq!(Instant::FAR_FUTURE + Duration::from_secs(1), Instant::FAR_FUTURE);
        assert_eq!(Duration::from_secs(u64::MAX), Duration::MAX);
        assert_eq!(Instant::ZERO.saturating_since(Instant::from_micros(5)), Duration::ZERO);
        assert_eq!(Instant::ZERO.checked_since(Instant::from_micros(5)), None);
    }

    #[test]
    fn float_seconds_round_to_the_nearest_microsecond_and_never_go_negative() {
        assert_eq!(Duration::from_secs_f64(0.017), Duration::from_micros(17_000));
        assert_eq!(Duration::from_secs_f64(1.4e-6), Duration::from_micros(1));
        assert_eq!(Duration::from_secs_f64(-1.0), Duration::ZERO);
        assert_eq!(Duration::from_secs_f64(f64::NAN), Duration::ZERO);
        assert_eq!(Duration::from_secs_f64(f64::INFINITY), Duration::MAX);
    }

    #[test]
    fn display_shows_microseconds_exactly() {
        assert_eq!(Instant::from_micros(1_000_017).to_string(), "1.000017");
        assert_eq!(Duration::from_micros(17_250).to_string(), "17.250 ms");
    }
}

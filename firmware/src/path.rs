//! Time along the plan, and how it is slowed down so that a stop keeps the path (pure).
//!
//! With path time s(t) a joint's reference is q(s): velocity q' ṡ, acceleration q'' ṡ² + q' s̈. While running
//! ṡ = 1. A stop lowers ṡ to zero; all joints stay on the curve they would have taken, only later. In each cycle
//! the hardest deceleration s̈ is taken that leaves every joint within its share of the acceleration:
//!
//! ```text
//! -a ≤ q'' ṡ² + q' s̈ ≤ a      for every joint: an interval for s̈; all of them are intersected
//! ```
//!
//! An empty intersection, or one in which the path cannot be slowed, means that the path cannot be kept.

use protocol::{Duration, Instant, JointIndex};

use crate::joints::clamp;
use crate::span;
use crate::spline::{Setpoint, Spline};

/// Hardest slowing down of path time, 1/s: from full speed to rest in 25 ms, when the joints hardly move.
pub const RATE_DROP_MAX_1_S: f32 = 40.0;

/// Path time as a function of time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathClock {
    at: Instant,
    s_us: i64,
    rate: f32,
    rate_dot_1_s: f32,
}

impl PathClock {
    /// Runs at full speed and is at the start of the plan at `start`.
    pub const fn starting(start: Instant) -> Self {
        Self { at: start, s_us: 0, rate: 1.0, rate_dot_1_s: 0.0 }
    }

    /// ṡ at the last call of [`Self::advance`].
    pub const fn rate(&self) -> f32 {
        self.rate
    }

    /// Path time s in µs and ṡ at a time near the last call of [`Self::advance`]; before it the
    /// clock is taken to have run at the rate it had then.
    #[inline]
    pub fn at(&self, t: Instant) -> (i64, f32) {
        if self.runs_freely() {
            // Either sign; spans are far below 2^63 µs.
            let since_us = t.as_micros().wrapping_sub(self.at.as_micros()) as i64;
            return (self.s_us.saturating_add(since_us), 1.0);
        }
        self.at_slowed(t)
    }

    /// When a clock that runs at full speed is at a time of the plan.
    pub fn when(&self, s_us: u32) -> Instant {
        let ahead_us = i64::from(s_us).saturating_sub(self.s_us);
        Instant::from_micros(self.at.as_micros().saturating_add_signed(ahead_us))
    }

    #[inline(never)]
    fn at_slowed(&self, t: Instant) -> (i64, f32) {
        if let Some(before) = self.at.checked_since(t) {
            let back_us = before.as_micros().min(i64::MAX as u64) as i64;
            // A step back is at most a few cycles, also through 32 bits; 64-bit conversions are software on a Cortex-M4.
            let back_us = if self.rate == 1.0 {
                back_us
            } else {
                i64::from((self.rate * u32::try_from(back_us).unwrap_or(u32::MAX) as f32) as i32)
            };
            return (self.s_us.saturating_sub(back_us), self.rate);
        }
        let dt_s = span::seconds(t.saturating_since(self.at));
        let left_s = if self.rate_dot_1_s < 0.0 { self.rate / -self.rate_dot_1_s } else { f32::INFINITY };
        // Zero is set, not computed: `rate + rate_dot * left` is off by a rounding, and a clock with a rate of 1e-45 would
        // never stand.
        let (dt_s, rate) = if dt_s < left_s {
            (dt_s, (self.rate + self.rate_dot_1_s * dt_s).max(0.0))
        } else {
            (left_s, 0.0)
        };
        let s_us = 0.5 * (self.rate + rate) * dt_s * 1e6;
        (self.s_us.saturating_add(i64::from(libm::roundf(s_us) as i32)), rate)
    }

    /// Reference as a function of time, from the reference along the path.
    #[inline]
    pub fn in_time(&self, t: Instant, along: Setpoint) -> Setpoint {
        if self.runs_freely() {
            return along;
        }
        let (_, rate) = self.at(t);
        let slowing = if t < self.at || rate == 0.0 { 0.0 } else { self.rate_dot_1_s };
        Setpoint {
            q_rad: along.q_rad,
            qd_rad_s: along.qd_rad_s * rate,
            qdd_rad_s2: along.qdd_rad_s2 * rate * rate + along.qd_rad_s * slowing,
        }
    }

    /// Reference of a joint at a time, and its velocity a period later.
    #[inline]
    pub fn interval(
        &self,
        spline: &mut Spline,
        joint: JointIndex,
        from: Instant,
        period: Duration,
    ) -> (Setpoint, f32) {
        if self.runs_freely() {
            let (s_us, _) = self.at(from);
            let to_us = s_us.saturating_add(period.as_micros() as i64);
            return (spline.at(joint, s_us), spline.at(joint, to_us).qd_rad_s);
        }
        let to = self.reference(spline, joint, from + period);
        (self.reference(spline, joint, from), to.qd_rad_s)
    }

    /// Reference of a joint at a time.
    pub fn reference(&self, spline: &mut Spline, joint: JointIndex, t: Instant) -> Setpoint {
        let (s_us, _) = self.at(t);
        self.in_time(t, spline.at(joint, s_us))
    }

    /// True if path time and time differ only by an offset.
    const fn runs_freely(&self) -> bool {
        self.rate == 1.0 && self.rate_dot_1_s == 0.0
    }

    /// Moves the origin to `t` and goes on with another slowing down.
    pub fn advance(&mut self, t: Instant, rate_dot_1_s: f32) {
        let (s_us, rate) = self.at(t);
        *self = Self { at: t, s_us, rate, rate_dot_1_s };
    }

    /// True if path time stands.
    pub const fn is_standing(&self) -> bool {
        self.rate <= 0.0
    }

    /// Origin of the clock.
    pub const fn since(&self) -> Instant {
        self.at
    }
}

/// Interval of s̈ that keeps all joints seen so far within their acceleration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slowing {
    low: f32,
    high: f32,
}

impl Default for Slowing {
    fn default() -> Self {
        Self { low: -RATE_DROP_MAX_1_S, high: 0.0 }
    }
}

impl Slowing {
    /// Takes a joint into account: its reference along the path at rate `rate`, and the acceleration that it may use.
    pub fn require(&mut self, along: Setpoint, rate: f32, a_max_rad_s2: f32) {
        let (slope, centre) = (along.qd_rad_s, along.qdd_rad_s2 * rate * rate);
        if slope.abs() < 1e-3 {
            return;
        }
        let (one, two) = ((-a_max_rad_s2 - centre) / slope, (a_max_rad_s2 - centre) / slope);
        self.low = self.low.max(one.min(two));
        self.high = self.high.min(one.max(two));
    }

    /// The hardest slowing down, 1/s; `None` if the path cannot be kept, or cannot be slowed down at once.
    pub fn hardest_1_s(&self) -> Option<f32> {
        (self.low <= self.high && self.low < -0.1).then_some(clamp(self.low, -RATE_DROP_MAX_1_S, 0.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const US: fn(u64) -> Instant = Instant::from_micros;

    #[test]
    fn running_clock_counts_microseconds_exactly_also_before_the_start() {
        let clock = PathClock::starting(US(1_000_000_000_000));
        assert_eq!(clock.at(US(1_000_000_000_017)), (17, 1.0));
        assert_eq!(clock.at(US(999_999_999_990)), (-10, 1.0));
    }

    #[test]
    fn slowed_clock_covers_half_the_way_and_then_stands() {
        let mut clock = PathClock::starting(US(0));
        clock.advance(US(1_000_000), -10.0);
        assert_eq!(clock.at(US(1_050_000)).1, 0.5);
        let (s, rate) = clock.at(US(2_000_000));
        assert_eq!((s, rate), (1_050_000, 0.0));
        clock.advance(US(2_000_000), 0.0);
        assert!(clock.is_standing());
        assert_eq!(clock.at(US(9_000_000)).0, 1_050_000);
    }

    #[test]
    fn slowed_clock_went_at_its_rate_before_the_last_call() {
        let clock = PathClock { at: US(100_000), s_us: 70_000, rate: 0.5, rate_dot_1_s: -2.0 };
        assert_eq!(clock.at(US(90_000)), (65_000, 0.5));
        // s = 70 ms + 0.5 t - t^2 at 0.1 s.
        assert_eq!(clock.at(US(200_000)), (110_000, 0.3));
    }

    #[test]
    fn reference_of_a_slowed_path_follows_the_chain_rule() {
        let clock = PathClock { at: US(100_000), s_us: 0, rate: 0.6, rate_dot_1_s: -0.8 };
        let along = Setpoint { q_rad: 0.25, qd_rad_s: 2.0, qdd_rad_s2: 3.0 };
        for (t_us, rate, rate_dot) in [
            (200_000, 0.52, -0.8),
            (100_000, 0.6, -0.8),
            (90_000, 0.6, 0.0),
            (850_000, 0.0, 0.0),
            (2_000_000, 0.0, 0.0),
        ] {
            let now = clock.in_time(US(t_us), along);
            assert_eq!(now.q_rad, 0.25);
            assert!((now.qd_rad_s - 2.0 * rate).abs() < 1e-6, "{t_us} us: {now:?}");
            let qdd_rad_s2 = 3.0 * rate * rate + 2.0 * rate_dot;
            assert!((now.qdd_rad_s2 - qdd_rad_s2).abs() < 1e-6, "{t_us} us: {now:?}, not {qdd_rad_s2}");
        }
        // At full rate and about to slow down, the path is already in time.
        let clock = PathClock { rate: 1.0, ..clock };
        assert!((clock.in_time(US(100_000), along).qdd_rad_s2 - (3.0 - 1.6)).abs() < 1e-6);
    }

    #[test]
    fn contradicting_joints_or_nearly_no_slowing_down_mean_that_the_path_is_not_kept() {
        let along = |qd_rad_s: f32, qdd_rad_s2: f32| Setpoint { q_rad: 0.0, qd_rad_s, qdd_rad_s2 };
        let after = |joints: &[Setpoint]| {
            let mut slowing = Slowing::default();
            for joint in joints {
                slowing.require(*joint, 1.0, 10.0);
            }
            slowing.hardest_1_s()
        };
        assert_eq!(after(&[]), Some(-RATE_DROP_MAX_1_S));
        assert_eq!(after(&[along(2.0, 4.0)]), Some(-7.0));
        // One asks for -11 to -1, the other for -1 to 9 and then for 1 to 11 1/s.
        assert_eq!(after(&[along(1.0, 1.0), along(1.0, -9.0)]), Some(-1.0));
        assert_eq!(after(&[along(1.0, -9.0), along(1.0, 11.0), along(1.0, 15.0), along(1.0, -11.0)]), None);
        assert_eq!(after(&[along(1.0, -9.95)]), None, "0.05 1/s would take for ever");
        // A joint that stands sets no limit.
        assert_eq!(after(&[along(1e-4, 20.0)]), Some(-RATE_DROP_MAX_1_S));
    }

    /// In one of two hundred stops, rounding left a rate of 1e-45: the group waited for the longest time of a stop.
    #[test]
    fn clock_that_is_slowed_down_stands_after_its_time_whatever_the_numbers() {
        const PERIOD_US: u64 = 3_000;
        for k in 0..20_000u32 {
            let rate_dot = -5.0 - 35.0 * (k as f32 / 20_000.0);
            let mut clock = PathClock::starting(US(0));
            let cycles = (1e6 / (-rate_dot * PERIOD_US as f32)) as u64 + 3;
            for cycle in 0..cycles {
                clock.advance(US(PERIOD_US * cycle), rate_dot);
            }
            assert!(clock.is_standing(), "{rate_dot} 1/s: {clock:?}");
        }
    }

    proptest! {
        #[test]
        fn slowing_keeps_every_joint_within_its_acceleration(
            joints in proptest::collection::vec((-3f32..3.0, -9f32..9.0), 6), rate in 0.05f32..1.0,
        ) {
            let mut slowing = Slowing::default();
            let along = |&(qd_rad_s, qdd_rad_s2): &(f32, f32)| Setpoint { q_rad: 0.0, qd_rad_s, qdd_rad_s2 };
            for joint in &joints {
                slowing.require(along(joint), rate, 10.0);
            }
            if let Some(slow) = slowing.hardest_1_s() {
                for &(qd, qdd) in joints.iter().filter(|joint| joint.0.abs() >= 1e-3) {
                    prop_assert!((qdd * rate * rate + qd * slow).abs() <= 10.0 + 1e-3);
                }
                prop_assert!((-RATE_DROP_MAX_1_S..0.0).contains(&slow));
            }
        }
    }
}

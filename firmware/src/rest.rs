//! Rest as it is measured (pure): a joint stands if its position has stayed within the steps of its encoder for a while.
//!
//! What this shows: a joint that counts as standing moves by less than [`BAND_RAD`] in [`WINDOW`], 10 mrad/s on
//! average. What it cannot show: a drive whose answers are frozen also stands still in this measurement. So the
//! state word, which must show no MOTION, and the model of the drive must agree before anything relies on the rest.

use protocol::{Duration, Instant};

use crate::group::PositionSample;

/// Time for which a position must stay within [`BAND_RAD`]. The group reads the positions of standing joints every
/// 20 ms, so three of them agree.
pub const WINDOW: Duration = Duration::from_millis(50);
/// Width of a standing position, rad: one and a half steps of the encoder (0.02 degrees, `robot-models` 1.2). A joint that
/// stands between two steps toggles by one.
pub const BAND_RAD: f32 = 530e-6;

/// Longest time from a halt to measured rest: the slowest drive brakes from its highest speed in less than half of it.
pub const HALT_REST_MAX: Duration = Duration::from_millis(1_500);
/// Added to the computed time of a ramp to get the latest time of measured rest: the window, and the settling time of a drive's
/// loop.
pub const REST_SLACK: Duration = Duration::from_millis(250);

/// Time since which a joint stands.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Rest {
    since: Option<PositionSample>,
    last: Instant,
}

impl Rest {
    /// Takes a measured position.
    pub fn take(&mut self, sample: PositionSample) {
        self.take_within(sample, BAND_RAD);
    }

    /// Takes a measured position of a joint that stands within `band_rad`.
    pub fn take_within(&mut self, sample: PositionSample, band_rad: f32) {
        // The comparison is false for NaN: such a position does not stand.
        let stands = self.since.is_some_and(|since| (sample.q_rad - since.q_rad).abs() <= band_rad);
        if !stands {
            self.since = Some(sample);
        }
        self.last = sample.at;
    }

    /// A motion was commanded: earlier measurements do not count for the rest at its end. Otherwise a drive whose
    /// answers are frozen would stand at once, and a state word from before the motion would agree.
    pub const fn forget(&mut self) {
        self.since = None;
    }

    /// The time since which the joint stands, if that is long enough and the last position is no older than `age_max`.
    pub fn since(&self, now: Instant, age_max: Duration) -> Option<Instant> {
        let since = self.since?.at;
        let stood = self.last.saturating_since(since) >= WINDOW;
        (stood && now.saturating_since(self.last) <= age_max).then_some(since)
    }

    /// True if the last positions differ by more than those of a standing joint, and are no older than `age_max`.
    pub fn is_moving(&self, now: Instant, age_max: Duration) -> bool {
        self.since.is_some()
            && now.saturating_since(self.last) <= age_max
            && self.since(now, age_max).is_none()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(ms: u64) -> Instant {
        Instant::from_micros(1_000 * ms)
    }
    const AGE: Duration = Duration::from_millis(80);

    fn measured(speed_rad_s: f32, every_ms: u64) -> Rest {
        let step = 0.02f32.to_radians();
        let mut rest = Rest::default();
        for k in 0..=20 {
            let at = ms(k * every_ms);
            let q_rad = (speed_rad_s * (k * every_ms) as f32 * 1e-3 / step).round() * step;
            rest.take(PositionSample { q_rad, at });
        }
        rest
    }

    #[test]
    fn joint_stands_once_its_position_has_not_changed_for_the_window() {
        let mut rest = Rest::default();
        assert_eq!(rest.since(ms(0), AGE), None, "nothing measured");
        for (at, stands) in [(0, false), (20, false), (40, false), (50, true), (70, true)] {
            rest.take(PositionSample { q_rad: 1.0, at: ms(at) });
            assert_eq!(rest.since(ms(at), AGE).is_some(), stands, "{at} ms");
            assert_eq!(rest.is_moving(ms(at), AGE), !stands, "{at} ms");
        }
        assert_eq!(rest.since(ms(70), AGE), Some(ms(0)));
        assert_eq!(rest.since(ms(170), AGE), None, "too old");
        assert!(!rest.is_moving(ms(170), AGE), "and says nothing about motion either");
    }

    #[test]
    fn rest_begins_anew_after_a_motion_was_commanded() {
        let mut rest = measured(0.0, 10);
        assert_eq!(rest.since(ms(200), AGE), Some(ms(0)));
        rest.forget();
        for at in [210, 240, 250] {
            rest.take(PositionSample { q_rad: 0.0, at: ms(at) });
            assert_eq!(rest.since(ms(at), AGE), None, "{at} ms");
        }
        rest.take(PositionSample { q_rad: 0.0, at: ms(260) });
        assert_eq!(rest.since(ms(260), AGE), Some(ms(210)));
    }

    #[test]
    fn slow_motion_is_no_rest_and_a_toggling_step_is() {
        for speed in [-2.0, -0.1, 0.02, 0.012] {
            assert!(measured(speed, 10).is_moving(ms(200), AGE), "{speed}");
        }
        let mut rest = Rest::default();
        for k in 0..10 {
            let q_rad = if k % 2 == 0 { 0.0 } else { 0.02f32.to_radians() };
            rest.take(PositionSample { q_rad, at: ms(10 * k) });
        }
        assert!(rest.since(ms(90), AGE).is_some());
    }

    #[test]
    fn position_that_is_no_number_is_no_rest() {
        let mut rest = Rest::default();
        for k in 0..10 {
            rest.take(PositionSample { q_rad: f32::NAN, at: ms(10 * k) });
        }
        assert_eq!(rest.since(ms(90), AGE), None);
    }
}

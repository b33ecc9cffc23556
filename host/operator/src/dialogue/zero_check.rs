//! Whether a drive had lost encoder counts: its reading leaps when homing finds the switch.
//!
//! At the switch the drive sets its counter to the known place of the switch. A counter that was right continues
//! without a step. If counts were lost, it steps by the lost counts. The readings are taken some milliseconds
//! apart, while the joint moves slowly, so the step is visible as soon as it is larger than the way between two
//! readings.
//!
//! A joint with many lost counts meets its end stop on the way, and moves faster than homing for a moment when it
//! leaves the stop. Such leaps are not caused by the switch: the largest leap is the offset, and the others count
//! as its uncertainty.

use protocol::Instant;

/// Step of the readings of a drive, rad: 0.02°.
const QUANTUM_RAD: f64 = 3.5e-4;
/// Room for the times of the readings.
const MOTION_FACTOR: f64 = 1.5;
/// Second largest leap as a share of the largest: above it the leap of the switch is not clear.
const OTHERS_SHARE_MAX: f64 = 0.5;

/// A step larger than the motion, rad, with the time it took and the speed before it.
#[derive(Clone, Copy, Debug)]
struct Leap {
    step_rad: f64,
    dt_s: f64,
    v_before_rad_s: f64,
}

#[derive(Clone, Copy, Debug)]
pub struct ZeroCheck {
    v_max_rad_s: f64,
    last: Option<(Instant, f64)>,
    /// Speed between the last two readings without a leap.
    v_rad_s: f64,
    /// Counts if the reading goes on smoothly after it.
    candidate: Option<Leap>,
    /// Largest leap less the motion in it, rad.
    largest_rad: f64,
    /// Sum of the magnitudes of all other leaps, rad.
    others_rad: f64,
    resolution_rad: f64,
    is_clear: bool,
}

/// Result of the comparison.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ZeroOffset {
    /// Reading before homing, less what it should have been, rad; 0 if it is below the resolution.
    pub offset_rad: f64,
    /// A smaller offset is not seen, and the true one is not farther from `offset_rad`, rad.
    pub resolution_rad: f64,
}

impl ZeroCheck {
    /// For a homing that moves at `v_max_rad_s` at most.
    #[must_use]
    pub fn new(v_max_rad_s: f64) -> Self {
        Self {
            v_max_rad_s,
            last: None,
            v_rad_s: 0.0,
            candidate: None,
            largest_rad: 0.0,
            others_rad: 0.0,
            resolution_rad: 0.0,
            is_clear: true,
        }
    }

    /// Takes the next reading.
    pub fn take(&mut self, at: Instant, q_rad: f64) {
        let Some((before, q_before_rad)) = self.last.replace((at, q_rad)) else { return };
        let dt_s = at.saturating_since(before).as_secs_f64();
        let motion_rad = MOTION_FACTOR * self.v_max_rad_s * dt_s + 2.0 * QUANTUM_RAD;
        self.resolution_rad = self.resolution_rad.max(motion_rad);
        let step_rad = q_rad - q_before_rad;
        if step_rad.abs() > motion_rad {
            // Two in a row are a motion faster than was thought, and no leap.
            self.is_clear &= self.candidate.is_none();
            self.candidate = Some(Leap { step_rad, dt_s, v_before_rad_s: self.v_rad_s });
            return;
        }
        self.v_rad_s = if dt_s > 0.0 { step_rad / dt_s } else { 0.0 };
        if let Some(leap) = self.candidate.take() {
            self.add(leap.step_rad - 0.5 * (leap.v_before_rad_s + self.v_rad_s) * leap.dt_s);
        }
    }

    fn add(&mut self, leap_rad: f64) {
        let smaller_rad = leap_rad.abs().min(self.largest_rad.abs());
        if leap_rad.abs() > self.largest_rad.abs() {
            self.largest_rad = leap_rad;
        }
        self.others_rad += smaller_rad;
    }

    /// The result; `None` if the readings do not allow one: fewer than two, a motion faster than homing, or no leap
    /// that is clearly the largest.
    #[must_use]
    pub fn finish(self) -> Option<ZeroOffset> {
        let enough = self.is_clear && self.candidate.is_none() && self.resolution_rad > 0.0;
        let stands_out = self.others_rad <= OTHERS_SHARE_MAX * self.largest_rad.abs();
        (enough && stands_out).then_some(ZeroOffset {
            offset_rad: -self.largest_rad,
            resolution_rad: self.resolution_rad + self.others_rad,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(readings: impl Iterator<Item = f64>) -> Option<ZeroOffset> {
        let mut check = ZeroCheck::new(0.2);
        for (i, q_rad) in readings.enumerate() {
            check.take(Instant::from_micros(5_000 * i as u64), q_rad);
        }
        check.finish()
    }

    /// At homing speed until the joint stands.
    fn motion(i: i32) -> f64 {
        -0.2 * 0.005 * f64::from(i.min(120))
    }

    #[test]
    fn a_step_at_the_switch_is_the_offset_and_motion_alone_is_not() {
        let found = check((0..200).map(motion)).unwrap();
        assert_eq!(found.offset_rad, 0.0);
        assert!((0.001..0.003).contains(&found.resolution_rad), "{found:?}");
        for lost_rad in [0.0873, -0.0873, 0.004] {
            let found = check((0..200).map(|i| motion(i) + if i < 100 { lost_rad } else { 0.0 })).unwrap();
            assert!((found.offset_rad - lost_rad).abs() < found.resolution_rad, "{lost_rad}: {found:?}");
        }
    }

    #[test]
    fn a_small_jump_beside_the_switch_widens_the_uncertainty_and_two_large_jumps_give_no_result() {
        let readings = |stop_rad: f64| {
            (0..200).map(move |i| {
                motion(i) + if i < 40 { stop_rad } else { 0.0 } + if i < 100 { 1.5 } else { 0.0 }
            })
        };
        let found = check(readings(0.003)).unwrap();
        assert!((found.offset_rad - 1.5).abs() < 1e-3, "{found:?}");
        assert!((0.004..0.006).contains(&found.resolution_rad), "{found:?}");
        assert_eq!(check(readings(1.0)), None);
    }

    #[test]
    fn a_motion_that_is_faster_than_homing_allows_no_result() {
        assert_eq!(check((0..50).map(|i| 0.05 * f64::from(i))), None);
        assert_eq!(check(std::iter::once(0.3)), None);
    }
}

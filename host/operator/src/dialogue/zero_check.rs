//! Whether a drive had lost encoder counts: its reading jumps when homing finds the switch.
//!
//! At the switch the drive sets its counter to the known place of the switch. A counter that was right goes on without
//! a step. One that had lost counts steps by what was lost. The readings are taken some milliseconds apart, while the
//! joint moves slowly, so the step stands out from the motion as soon as it is larger than the way between two readings.

use protocol::Instant;

/// Step of the readings of a drive, rad: 0.02°.
const QUANTUM_RAD: f64 = 3.5e-4;
/// Room for the times of the readings.
const MOTION_FACTOR: f64 = 1.5;

/// See the [module](self).
#[derive(Clone, Copy, Debug)]
pub struct ZeroCheck {
    v_max_rad_s: f64,
    last: Option<(Instant, f64)>,
    /// A step that counts if the reading goes on smoothly after it.
    candidate_rad: Option<f64>,
    jump_rad: f64,
    resolution_rad: f64,
    is_clear: bool,
}

/// What the comparison says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ZeroOffset {
    /// Reading before homing, less what it should have been, rad; 0 if it is below the resolution.
    pub offset_rad: f64,
    /// A smaller offset is not seen, rad.
    pub resolution_rad: f64,
}

impl ZeroCheck {
    /// For a homing that moves at `v_max_rad_s` at most.
    #[must_use]
    pub fn new(v_max_rad_s: f64) -> Self {
        Self {
            v_max_rad_s,
            last: None,
            candidate_rad: None,
            jump_rad: 0.0,
            resolution_rad: 0.0,
            is_clear: true,
        }
    }

    /// Takes the next reading.
    pub fn take(&mut self, at: Instant, q_rad: f64) {
        if let Some((before, q_before_rad)) = self.last.replace((at, q_rad)) {
            let dt_s = at.saturating_since(before).as_secs_f64();
            let motion_rad = MOTION_FACTOR * self.v_max_rad_s * dt_s + 2.0 * QUANTUM_RAD;
            let step_rad = q_rad - q_before_rad;
            let is_step = step_rad.abs() > motion_rad;
            match (self.candidate_rad.take(), is_step) {
                (Some(jump_rad), false) => self.jump_rad += jump_rad,
                // Two in a row are a motion faster than was thought, and no step.
                (Some(_), true) => self.is_clear = false,
                (None, true) => self.candidate_rad = Some(step_rad),
                (None, false) => {}
            }
            self.resolution_rad = self.resolution_rad.max(motion_rad);
        }
    }

    /// The result; `None` if the readings do not allow one.
    #[must_use]
    pub fn finish(self) -> Option<ZeroOffset> {
        let enough = self.is_clear && self.candidate_rad.is_none() && self.resolution_rad > 0.0;
        enough.then_some(ZeroOffset { offset_rad: -self.jump_rad, resolution_rad: self.resolution_rad })
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

    #[test]
    fn a_step_at_the_switch_is_the_offset_and_motion_alone_is_none() {
        let motion = |i: i32| -0.2 * 0.005 * f64::from(i.min(120));
        let found = check((0..200).map(motion)).unwrap();
        assert_eq!(found.offset_rad, 0.0);
        assert!((0.001..0.003).contains(&found.resolution_rad), "{found:?}");
        for lost_rad in [0.0873, -0.0873, 0.004] {
            let found = check((0..200).map(|i| motion(i) + if i < 100 { lost_rad } else { 0.0 })).unwrap();
            assert!((found.offset_rad - lost_rad).abs() < found.resolution_rad, "{lost_rad}: {found:?}");
        }
    }

    #[test]
    fn a_motion_that_is_faster_than_homing_allows_no_result() {
        assert_eq!(check((0..50).map(|i| 0.05 * f64::from(i))), None);
        assert_eq!(check(std::iter::once(0.3)), None);
    }
}

//! Set points of one axis: from the one in force to the next, without a leap that trips the robot (pure).

use crate::joints::{at_most, clamp};

/// Two speeds nearer than this are one, rad/s: the difference of two set points near pi rad, rounded, over 4 ms.
const ROUNDED_RAD_S: f32 = 2e-4;

/// Set point of an axis in force, and the speed with which set points move.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Axis {
    /// Position, rad.
    pub q_rad: f32,
    /// Difference to the set point before over the period, rad/s.
    pub v_rad_s: f32,
}

impl Axis {
    /// Follows a reference that moves to `to_rad` from `from_rad`. A set point on the reference stays on it if that needs no
    /// more than `a_cap`; one beside it approaches with half of it. True if the cap acted.
    pub(super) fn follow(&mut self, from_rad: f32, to_rad: f32, v_max: f32, a_cap: f32, dt_s: f32) -> bool {
        let gap = from_rad - self.q_rad;
        let catching = at_most(libm::sqrtf(a_cap * gap.abs()), gap.abs() / dt_s);
        let wish = (to_rad - from_rad) / dt_s + libm::copysignf(catching, gap);
        let step = a_cap * dt_s;
        let v = clamp(clamp(wish, self.v_rad_s - step, self.v_rad_s + step), -v_max, v_max);
        self.go(v, dt_s);
        (v - wish).abs() > 1e-4
    }

    /// Moves towards `end_rad` with a trapezoid of speed.
    pub(super) fn approach(&mut self, end_rad: f32, v_max: f32, a_max: f32, dt_s: f32) {
        let way = end_rad - self.q_rad;
        // The cycle that is already at work counts.
        let stopping = libm::sqrtf(2.0 * a_max * way.abs()) - 0.5 * a_max * dt_s;
        let speed = at_most(at_most(stopping, v_max), way.abs() / dt_s);
        let wish = if way.abs() <= a_max * dt_s * dt_s { way / dt_s } else { libm::copysignf(speed, way) };
        let step = a_max * dt_s;
        self.go(clamp(wish, self.v_rad_s - step, self.v_rad_s + step), dt_s);
    }

    /// Changes the speed to `v_rad_s` with at most `a_max`.
    pub(super) fn drive(&mut self, v_rad_s: f32, a_max: f32, dt_s: f32) {
        let step = a_max * dt_s;
        self.go(clamp(v_rad_s, self.v_rad_s - step, self.v_rad_s + step), dt_s);
    }

    /// The set point after this one that is nearest to `wish` and that a robot follows: with at most `v_max`, and with a change
    /// of speed by at most `a_max`. A wish that is no number is no motion.
    pub(super) fn within(self, wish: Self, v_max: f32, a_max: f32, dt_s: f32) -> Self {
        let v_wish = (wish.q_rad - self.q_rad) / dt_s;
        let v_wish = if v_wish.is_finite() { v_wish } else { 0.0 };
        let step = a_max * dt_s;
        let v = clamp(clamp(v_wish, self.v_rad_s - step, self.v_rad_s + step), -v_max, v_max);
        // Differences of rounded numbers: a wish within the limits stays as it is.
        let is_within = (v - v_wish).abs() <= ROUNDED_RAD_S;
        if is_within && wish.q_rad.is_finite() {
            return Self {
                q_rad: wish.q_rad,
                v_rad_s: if (wish.v_rad_s - v).abs() <= ROUNDED_RAD_S { wish.v_rad_s } else { v },
            };
        }
        Self { q_rad: self.q_rad + v * dt_s, v_rad_s: v }
    }

    /// Moves with a speed for one period.
    pub(super) fn go(&mut self, v_rad_s: f32, dt_s: f32) {
        self.v_rad_s = v_rad_s;
        self.q_rad += v_rad_s * dt_s;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f32 = 0.012;

    #[test]
    fn axis_that_was_held_up_returns_to_the_reference_within_the_cap() {
        let reference = |k: i32| 1.5 * DT * k as f32;
        let mut axis = Axis { q_rad: 0.0, v_rad_s: 0.0 };
        let (mut before, mut worst) = (0.0f32, 0.0f32);
        for k in 3..120 {
            axis.follow(reference(k - 1), reference(k), 2.6, 33.0, DT);
            worst = worst.max((axis.v_rad_s - before).abs() / DT);
            before = axis.v_rad_s;
        }
        assert!((axis.q_rad - reference(119)).abs() < 1e-4, "{}", axis.q_rad - reference(119));
        assert!((30.0..33.01).contains(&worst), "{worst}");
    }

    #[test]
    fn approach_ends_at_its_target_without_passing_it() {
        for way in [0.5f32, -0.02, 1e-4, 0.0] {
            let mut axis = Axis::default();
            for _ in 0..600 {
                axis.approach(way, 0.25, 1.0, DT);
                assert!(axis.q_rad.abs() <= way.abs() + 2e-4, "{way}: {}", axis.q_rad);
            }
            assert!((axis.q_rad - way).abs() < 1e-5 && axis.v_rad_s.abs() < 1e-3, "{way}: {axis:?}");
        }
    }
}

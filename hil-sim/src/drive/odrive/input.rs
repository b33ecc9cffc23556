//! From what a host wants to the set point of the loops: the input modes.

use protocol::odrive::InputMode;

/// Bandwidth of the position filter, rad/s.
const FILTER_RAD_S: f64 = 20.0;
/// Ramp of the velocity, turns/s², and of the torque, N·m/s.
const VELOCITY_RAMP: f64 = 10.0;
const TORQUE_RAMP: f64 = 1.0;
/// A trapezoid ends here, turns.
const DONE_REV: f64 = 1e-4;

/// Position, velocity and torque, in turns of the motor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct SetPoint {
    pub(super) rev: f64,
    pub(super) rev_s: f64,
    pub(super) nm: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Trapezoid {
    /// turns/s.
    pub(super) velocity: f64,
    /// turns/s².
    pub(super) acceleration: f64,
    pub(super) deceleration: f64,
}

impl Default for Trapezoid {
    /// As shipped.
    fn default() -> Self {
        Self { velocity: 2.0, acceleration: 0.5, deceleration: 0.5 }
    }
}

fn towards(value: f64, wanted: f64, most: f64) -> f64 {
    value + (wanted - value).clamp(-most, most)
}

impl SetPoint {
    /// Moves on by `dt_s`; says whether a trapezoid has arrived.
    pub(super) fn follow(&mut self, mode: InputMode, wanted: &Self, limits: &Trapezoid, dt_s: f64) -> bool {
        match mode {
            InputMode::Inactive => {}
            InputMode::Direct => *self = *wanted,
            InputMode::VelocityRamp => {
                self.rev_s = towards(self.rev_s, wanted.rev_s, VELOCITY_RAMP * dt_s);
                self.nm = wanted.nm;
            }
            InputMode::TorqueRamp => self.nm = towards(self.nm, wanted.nm, TORQUE_RAMP * dt_s),
            InputMode::PositionFilter => {
                let acceleration = FILTER_RAD_S * FILTER_RAD_S * (wanted.rev - self.rev)
                    + 2.0 * FILTER_RAD_S * (wanted.rev_s - self.rev_s);
                self.rev_s += acceleration * dt_s;
                self.rev += self.rev_s * dt_s;
                self.nm = wanted.nm;
            }
            InputMode::Trapezoid => {
                let left = wanted.rev - self.rev;
                // The speed from which it still comes to rest in time, less what the next step covers.
                let brakes =
                    (2.0 * limits.deceleration * (left.abs() - self.rev_s.abs() * dt_s).max(0.0)).sqrt();
                let speed = brakes.min(limits.velocity).copysign(left);
                let slows = speed.abs() < self.rev_s.abs();
                let rate = if slows { limits.deceleration } else { limits.acceleration };
                self.rev_s = towards(self.rev_s, speed, rate * dt_s);
                self.rev += self.rev_s * dt_s;
                self.nm = wanted.nm;
                if (wanted.rev - self.rev).abs() < DONE_REV {
                    (self.rev, self.rev_s) = (wanted.rev, 0.0);
                    return true;
                }
                return false;
            }
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trapezoid_keeps_its_limits_and_takes_the_time_of_the_closed_form() {
        let (mut set, limits, dt_s) = (SetPoint::default(), Trapezoid::default(), 1e-4);
        let wanted = SetPoint { rev: 10.0, ..SetPoint::default() };
        let (mut t_s, mut before) = (0.0, 0.0);
        while !set.follow(InputMode::Trapezoid, &wanted, &limits, dt_s) {
            assert!(set.rev_s <= 2.0 + 1e-9 && set.rev <= 10.0 + 1e-6, "{set:?}");
            assert!((set.rev_s - before).abs() <= 0.5 * dt_s * (1.0 + 1e-9), "{set:?} at {t_s}");
            (t_s, before) = (t_s + dt_s, set.rev_s);
            assert!(t_s < 12.0);
        }
        // 4 s up, 1 s at full speed, 4 s down.
        assert!((t_s - 9.0).abs() < 0.05, "{t_s}");
    }

    #[test]
    fn a_filter_arrives_without_going_beyond() {
        let mut set = SetPoint::default();
        let wanted = SetPoint { rev: 1.0, ..SetPoint::default() };
        for _ in 0..10_000 {
            set.follow(InputMode::PositionFilter, &wanted, &Trapezoid::default(), 1e-4);
            assert!(set.rev <= 1.0 + 1e-6);
        }
        assert!((set.rev - 1.0).abs() < 1e-4 && set.rev_s.abs() < 1e-3, "{set:?}");
    }
}

//! Limits of the robot file against the joints as they moved: the witness of every trial, for both arms.

use std::collections::VecDeque;

use hil_sim::two_arms::JointsNow;
use planner::catch::Joints;
use robot_model::RobotModel;
use serde::Serialize;

/// Steps of 1 ms between the three places that give an acceleration: over less, the resolution of the drives (0.02 degrees) would be
/// taken for one; it makes less than 5 % of the limit here.
const WINDOW: usize = 40;

/// Largest use of limits by joints that moved: 1 is the limit.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Executed {
    /// Largest share of a speed limit.
    pub speed: f64,
    /// Largest share of an acceleration limit: change of the mean speed from one 40 ms to the next.
    pub acceleration: f64,
    pub left_range: bool,
}

impl Executed {
    #[must_use]
    pub fn within(&self) -> bool {
        self.speed <= 1.0 && self.acceleration <= 1.0 && !self.left_range
    }
}

#[derive(Debug)]
pub(super) struct LimitWatch<'a> {
    model: &'a RobotModel,
    past: VecDeque<(f64, Joints)>,
    executed: Executed,
}

impl<'a> LimitWatch<'a> {
    pub(super) fn new(model: &'a RobotModel) -> Self {
        Self { model, past: VecDeque::new(), executed: Executed::default() }
    }

    /// Takes the joints at a time, each millisecond.
    pub(super) fn see(&mut self, t_s: f64, now: &JointsNow) {
        self.past.push_back((t_s, now.q));
        if self.past.len() > 2 * WINDOW + 1 {
            self.past.pop_front();
        }
        let full = self.past.len() > 2 * WINDOW;
        for (i, joint) in self.model.joints().iter().enumerate() {
            let l = &joint.limits;
            self.executed.speed = self.executed.speed.max(now.qd[i].abs() / l.v_max_rad_s);
            self.executed.left_range |= !(l.q_min_rad..=l.q_max_rad).contains(&now.q[i]);
            if full {
                let ((t0_s, first), (_, middle)) = (self.past[0], self.past[WINDOW]);
                let h_s = 0.5 * (t_s - t0_s);
                let a = (now.q[i] - 2.0 * middle[i] + first[i]).abs() / (h_s * h_s);
                let share = a / l.a_max_rad_s2.min(l.a_control_max_rad_s2);
                self.executed.acceleration = self.executed.acceleration.max(share);
            }
        }
    }

    pub(super) fn executed(&self) -> Executed {
        self.executed
    }
}

#[cfg(test)]
mod tests {
    use robot_model::RobotModel;

    use super::*;

    fn watched(v: impl Fn(f64) -> f64, q0: f64) -> Executed {
        let model = RobotModel::load("powercube6").unwrap();
        let mut watch = LimitWatch::new(&model);
        let mut q = q0;
        for ms in 0..200 {
            let t_s = 1e-3 * f64::from(ms);
            q += 1e-3 * v(t_s);
            let joint = |x: f64| Joints::from([0.0, 0.0, x, 0.0, 0.0, 0.0]);
            watch.see(t_s, &JointsNow { q: joint(q), qd: joint(v(t_s)) });
        }
        watch.executed()
    }

    #[test]
    fn speed_acceleration_and_range_that_pass_a_limit_are_seen() {
        let slow = watched(|t_s| 5.2 * t_s, -1.0);
        assert!((slow.acceleration - 0.5).abs() < 0.01 && slow.within(), "{slow:?}");
        assert!((slow.speed - 5.2 * 0.199 / 149.0_f64.to_radians()).abs() < 1e-6, "{slow:?}");
        let jump = watched(|t_s| if t_s < 0.1 { 0.0 } else { 0.6 }, -1.0);
        assert!(jump.acceleration > 1.0 && !jump.within(), "{jump:?}");
        let fast = watched(|_| 2.7, -1.0);
        assert!(fast.speed > 1.0 && !fast.within(), "{fast:?}");
        let out = watched(|_| 1.0, 0.8);
        assert!(out.left_range && !out.within(), "{out:?}");
    }
}

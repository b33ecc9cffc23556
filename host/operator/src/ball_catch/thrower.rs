//! A planned throw as it is executed.

use hil_sim::rng::Rng;
use hil_sim::two_arms::JointsNow;
use nalgebra::{SMatrix, SVector};
use planner::catch::Joints;
use planner::catch::draw::{Aimed, scatter};
use planner::throw::Throw;
use robot_model::{Pose, RobotModel};

use crate::flight_estimator::FlightPrior;

/// How far a throw is from its plan: standard deviations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scatter {
    /// Of the gripper's delay, s.
    pub delay_s: f64,
    /// Of each joint's speed, share.
    pub share: f64,
}

impl Default for Scatter {
    /// 5 ms, 1 %.
    fn default() -> Self {
        Self { delay_s: 0.005, share: 0.01 }
    }
}

/// Place of the ball in the hand is known to this, m.
const HAND_SIGMA_M: f64 = 0.002;
/// A ball that no arm throws is announced to this, m and m/s.
const ANNOUNCED_SIGMA: (f64, f64) = (0.005, 0.1);

#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ThrowFault {
    NotReleased,
    /// The arm stops this long before the release, and keeps the ball, s.
    Stops {
        before_s: f64,
    },
}

#[derive(Debug, Clone)]
pub struct Thrower {
    planned: Throw,
    executed: Throw,
    start_s: f64,
    release_s: f64,
    fault: Option<ThrowFault>,
}

impl Thrower {
    /// Begins at `start_s`; scatter from `rng`, as far as the arm's speeds and ranges allow.
    #[must_use]
    pub fn new(
        arm: &RobotModel,
        aimed: &Aimed,
        start_s: f64,
        of: &Scatter,
        fault: Option<ThrowFault>,
        rng: &mut Rng,
    ) -> Self {
        let late_s = of.delay_s * rng.normal();
        let mut executed = aimed.throw;
        for i in 0..6 {
            let limit = &arm.joints()[i].limits;
            let scattered = executed.qd_rad_s[i] * (1.0 + of.share * rng.normal());
            executed.qd_rad_s[i] = scattered.clamp(-limit.v_max_rad_s, limit.v_max_rad_s);
            let range = limit.q_min_rad..=limit.q_max_rad;
            if !range.contains(&executed.start()[i]) || !range.contains(&executed.stop()[i]) {
                executed.qd_rad_s[i] = aimed.throw.qd_rad_s[i];
            }
        }
        Self {
            planned: aimed.throw,
            executed,
            start_s,
            release_s: start_s + aimed.throw.ha_s + late_s,
            fault,
        }
    }

    /// When the fingers open, s; `None` if they never do.
    #[must_use]
    pub fn release_s(&self) -> Option<f64> {
        self.fault.is_none().then_some(self.release_s)
    }

    /// When the plan says that they open, s.
    #[must_use]
    pub fn planned_release_s(&self) -> f64 {
        self.start_s + self.planned.ha_s
    }

    /// Where the joints are at a time.
    #[must_use]
    pub fn joints(&self, t_s: f64) -> JointsNow {
        let throw = &self.executed;
        let since = t_s - self.start_s;
        if let Some(ThrowFault::Stops { before_s }) = self.fault {
            let stop_at = throw.ha_s - before_s;
            if since > stop_at {
                // Stops with constant deceleration in as long as the throw itself would have.
                let at = throw.at_time(stop_at);
                let h = (since - stop_at).min(throw.hb_s);
                let qd = at.qd * (1.0 - h / throw.hb_s);
                return JointsNow { q: at.q + (at.qd + qd) * (0.5 * h), qd };
            }
        }
        let at = throw.at_time(since);
        JointsNow { q: at.q, qd: at.qd }
    }

    /// What a catcher knows who has the plan: place and velocity at the planned release with the covariance of the scatter.
    #[must_use]
    pub fn prior(&self, arm: &RobotModel, x_wb: &Pose, aimed: &Aimed, of: &Scatter) -> FlightPrior {
        let covariance = if aimed.throw.qd_rad_s == Joints::zeros(6) {
            let (p, v) = ANNOUNCED_SIGMA;
            SMatrix::from_diagonal(&SVector::from([p * p, p * p, p * p, v * v, v * v, v * v]))
        } else {
            scatter(arm, x_wb, &aimed.throw, of.delay_s, of.share, HAND_SIGMA_M)
        };
        FlightPrior { t_s: self.planned_release_s(), p_m: aimed.p_m, v_m_s: aimed.v_m_s, covariance }
    }
}

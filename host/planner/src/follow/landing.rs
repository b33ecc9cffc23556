//! Where the ball lands if the gripper opens at another instant than planned.

use nalgebra::Vector3;
use robot_model::cubic::Cubic;
use serde::{Deserialize, Serialize};

use super::limits::{Arm, Axes, Limits};
use super::motion::{FollowMotion, RampPlan, Ramps};
use super::ramp::RampShape;

/// Distances of landings from the target for opening times spread evenly about the planned one.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Sensitivity {
    /// Largest departure of the opening time, in s.
    pub jitter_s: f64,
    /// Root mean square distance in m.
    pub rms_m: f64,
    /// Largest distance in m.
    pub largest_m: f64,
    /// Openings whose ball does not come down to the height of the target.
    pub missed: usize,
}

/// Opening times that are tried.
const OPENINGS: usize = 201;

/// Landings of a motion for opening times within `jitter_s` of `opening_s` (from the first step on the parabola).
#[must_use]
pub fn sensitivity(
    arm: &Arm,
    motion: &FollowMotion,
    target: &Vector3<f64>,
    opening_s: f64,
    jitter_s: f64,
) -> Sensitivity {
    let (mut squares, mut largest_m, mut missed) = (0.0, 0.0_f64, 0);
    for k in 0..OPENINGS {
        let share = 2.0 * k as f64 / (OPENINGS - 1) as f64 - 1.0;
        match landing_error_m(arm, motion, target, opening_s + share * jitter_s) {
            Some(error_m) => {
                squares += error_m * error_m;
                largest_m = largest_m.max(error_m);
            }
            None => missed += 1,
        }
    }
    let landed = (OPENINGS - missed).max(1) as f64;
    Sensitivity { jitter_s, rms_m: (squares / landed).sqrt(), largest_m, missed }
}

/// Horizontal distance from the target, at its height, of a ball that is free from `opening_s` on (from the first step
/// on the parabola); `None` if it never is at this height on its way down.
///
/// Between the steps the joints move along cubics with the angles and speeds of both steps.
#[must_use]
pub fn landing_error_m(
    arm: &Arm,
    motion: &FollowMotion,
    target: &Vector3<f64>,
    opening_s: f64,
) -> Option<f64> {
    let (q, qd) = between(motion, motion.first as f64 + opening_s / motion.period_s);
    let frames = arm.fk(&q);
    let p = arm.ball(&frames).pos;
    let twist = frames.jacobian(&p) * qd;
    let v: Vector3<f64> = twist.fixed_rows::<3>(0).into();
    let g = arm.world().gravity_m_s2;
    // z(t) = target.z, the later of the two instants.
    let root = v.z * v.z + 2.0 * g * (p.z - target.z);
    if root < 0.0 {
        return None;
    }
    let t = (v.z + root.sqrt()) / g;
    (t >= 0.0).then(|| (p + v * t - target).xy().norm())
}

/// Angles and speeds at a fractional step.
fn between(motion: &FollowMotion, step: f64) -> (Axes, Axes) {
    let end = motion.states.len() - 1;
    let k = (step.max(0.0).floor() as usize).min(end.saturating_sub(1));
    let (a, b) = (&motion.states[k], &motion.states[(k + 1).min(end)]);
    let cubic = Cubic::between(motion.period_s, (a.q, a.qd), (b.q, b.qd));
    let t_s = (step - k as f64).clamp(0.0, 1.0) * motion.period_s;
    (cubic.position(t_s), cubic.velocity(t_s))
}

/// The same throw without following: the ramps of the paper through the middle step of the window.
#[must_use]
pub fn without_following(motion: &FollowMotion, limits: &Limits) -> FollowMotion {
    let middle = motion.states[(motion.first + motion.last) / 2];
    let plan = RampPlan { shape: RampShape { blend_s: 0.0, fade_s: 0.0 }, together: 1.0 };
    let (start, stop) = (Ramps::start(&middle, plan, limits), Ramps::stop(&middle, plan, limits));
    FollowMotion::around(&[middle], &start, &stop, motion.period_s)
}

//! Where the ball lands if the gripper opens at another instant than planned, or if the lag of the axes differs from the plan.

use nalgebra::{Rotation2, Vector2, Vector3};
use robot_model::cubic::Cubic;
use serde::{Deserialize, Serialize};

use super::limits::{AXES, Arm, Axes, Limits};
use super::motion::{FollowMotion, RampPlan, Ramps};
use super::posture::Posture;
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

/// A motion, the instant at which its gripper opens, and where the ball is to land.
#[derive(Debug, Clone, PartialEq)]
pub struct Release {
    pub motion: FollowMotion,
    /// The opening, from the first step on the parabola, in s.
    pub opening_s: f64,
    /// Target in m, world frame.
    pub target: Vector3<f64>,
}

impl Release {
    /// Distance of the landing from the target if the gripper opens `late_s` after its instant, in m; `None` without a landing.
    #[must_use]
    pub fn error_m(&self, arm: &Arm, late_s: f64) -> Option<f64> {
        landing_error_m(arm, &self.motion, &self.target, self.opening_s + late_s)
    }

    /// Landings for openings within `jitter_s` of the instant.
    #[must_use]
    pub fn sensitivity(&self, arm: &Arm, jitter_s: f64) -> Sensitivity {
        sensitivity(arm, &self.motion, &self.target, self.opening_s, jitter_s)
    }
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

/// Instants per step at which an executed motion is sampled, and at which openings are tried.
const SAMPLES: usize = 12;
/// A lag counts as settled after this many time constants.
const SETTLED: f64 = 8.0;
/// Steps after the window at which openings are still tried: a lag carries the flight on beyond it.
const STEPS_BEYOND: usize = 4;
/// Openings about the planned one whose landings are taken together.
const SPREAD: usize = 33;

/// Motion that a first-order lag of `lag_s` makes of commands that lead by `lead_s`, set points joined by straight lines.
///
/// Sampled [`SAMPLES`] times per step; sample `SAMPLES k` is at the time of step `k`, so the motion is late by about
/// `lag_s - lead_s`.
pub(super) fn executed(motion: &FollowMotion, lead_s: f64, lag_s: f64) -> FollowMotion {
    let commands = motion.commands(lead_s);
    let h = motion.period_s / SAMPLES as f64;
    let decay = if lag_s > 0.0 { (-h / lag_s).exp() } else { 0.0 };
    let mut q = commands[0];
    let mut states = vec![Posture { q, qd: Axes::zeros(AXES), qdd: Axes::zeros(AXES) }];
    let settling = (SETTLED * lag_s / motion.period_s).ceil() as usize;
    let last = commands[commands.len() - 1];
    let ends = commands.iter().skip(1).copied().chain(std::iter::repeat_n(last, settling));
    let mut from = commands[0];
    for to in ends {
        let slope = (to - from) / motion.period_s;
        for k in 1..=SAMPLES {
            // x' = (u - x) / T with u = u0 + s t: x = u - T s + c e^(-t/T).
            let (before, after) = (from + slope * ((k - 1) as f64 * h), from + slope * (k as f64 * h));
            q = after - slope * lag_s + (q - before + slope * lag_s) * decay;
            let qd = if lag_s > 0.0 { (after - q) / lag_s } else { slope };
            states.push(Posture { q, qd, qdd: Axes::zeros(AXES) });
        }
        from = to;
    }
    FollowMotion { period_s: h, states, first: SAMPLES * motion.first, last: SAMPLES * motion.last }
}

/// When to open, where to turn the throw, and what then becomes of the landing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Opening {
    /// From the first step on the parabola, by the time of the plan, in s.
    pub at_s: f64,
    /// Turn of the whole throw about the vertical through the origin, in rad.
    pub turn_rad: f64,
    /// Root mean square distance of the landings from the target, in m.
    pub rms_m: f64,
}

/// The opening and the turn whose landings have the smallest root mean square distance from the target, if the axes lag by a first
/// order of `lag_s` behind commands that lead by `lead_s`, and the opening varies evenly by up to `jitter_s`.
/// Axes whose lag differs from the plan are off the parabola: most after the leap of the acceleration at the first
/// step on it, less with every step. Late in the window the landing depends little on the instant, but is beside
/// the target; a turn corrects this. The time of the plan is that of a robot with a delay of `lag_s - lead_s`.
/// `None` if no opening has landings.
#[must_use]
pub(crate) fn best_opening(
    arm: &Arm,
    motion: &FollowMotion,
    target: &Vector3<f64>,
    (lead_s, lag_s): (f64, f64),
    jitter_s: f64,
) -> Option<Opening> {
    let executed = executed(motion, lead_s, lag_s);
    let shift_s = lag_s - lead_s;
    let can_turn = turn_of_first_axis(arm).is_some();
    let tried = (motion.last - motion.first + STEPS_BEYOND) * SAMPLES;
    let openings = (0..=tried).filter_map(|k| {
        let at_s = k as f64 * executed.period_s;
        let spread = |n: usize| at_s + shift_s + (2.0 * n as f64 / (SPREAD - 1) as f64 - 1.0) * jitter_s;
        let offs: Option<Vec<_>> =
            (0..SPREAD).map(|n| landing_off_m(arm, &executed, target, spread(n))).collect();
        let landings: Vec<Vector2<f64>> = offs?.into_iter().map(|off| target.xy() + off).collect();
        let mean = landings.iter().sum::<Vector2<f64>>();
        let turn_rad = if can_turn { target.y.atan2(target.x) - mean.y.atan2(mean.x) } else { 0.0 };
        let turn = Rotation2::new(turn_rad);
        let squares: f64 = landings.iter().map(|p| (turn * p - target.xy()).norm_squared()).sum();
        Some(Opening { at_s, turn_rad, rms_m: (squares / SPREAD as f64).sqrt() })
    });
    openings.min_by(|a, b| a.rms_m.total_cmp(&b.rms_m))
}

/// Sign with which the first axis turns the arm about the vertical through the origin; `None` if it is another axis.
#[must_use]
pub(crate) fn turn_of_first_axis(arm: &Arm) -> Option<f64> {
    let frames = arm.fk(&Axes::zeros(AXES));
    let (axis, origin) = (frames.axis(0), frames.origin(0));
    let vertical = axis.xy().norm() < 1e-9 && origin.xy().norm() < 1e-9;
    vertical.then(|| axis.z.signum())
}

/// Horizontal distance from the target of the landing of a ball that is let go when the gripper opens at `opening_s`, in m.
#[must_use]
pub fn landing_error_m(
    arm: &Arm,
    motion: &FollowMotion,
    target: &Vector3<f64>,
    opening_s: f64,
) -> Option<f64> {
    landing_off_m(arm, motion, target, opening_s).map(|off| off.norm())
}

/// From the target to the landing at its height, of a ball that is free from `opening_s` on (from the first step
/// on the parabola), in m; `None` if it never is at this height on its way down.
///
/// Between the steps the joints move along cubics with the angles and speeds of both steps.
#[must_use]
pub(crate) fn landing_off_m(
    arm: &Arm,
    motion: &FollowMotion,
    target: &Vector3<f64>,
    opening_s: f64,
) -> Option<Vector2<f64>> {
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
    (t >= 0.0).then(|| (p + v * t - target).xy())
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

//! Postures of the arm at a release, from which local solves start.

use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::ops::RangeInclusive;

use nalgebra::{Matrix3, Vector3};
use robot_model::{JointVec, Pose, RobotModel};

use super::problem::Problem;
use super::rng::SplitMix64;
use crate::throw::Throw;

/// Starts of the numerical inverse kinematics. They find some of the postures, not all.
const NUMERIC_STARTS: usize = 12;
/// A random start uses this share of each joint's range, about its middle.
const START_SHARE: f64 = 0.7;
/// Largest angle, seen from above, between the ball of a start and the target.
const START_SIDE_RAD: f64 = 0.75;
/// Share of the starts whose wrist joints are near a quarter turn. In many of the best throws the wrist lies in the plane of the throw
/// or square to it.
const SQUARE_WRISTS: f64 = 0.5;
/// Largest distance of these wrist joints from a quarter turn.
const START_WRIST_RAD: f64 = 0.1;
/// Damping of the least squares for the speeds of a start, in m².
const DAMPING_M2: f64 = 1e-4;
/// Farthest that a joint before the wrist is moved from where a throw has it, in rad.
const VARIED_RAD: f64 = 0.6;
/// First joint of the wrist.
const WRIST: usize = 3;

/// Postures inside the joint ranges in which the hand is at `x_we`, each with its number.
///
/// The closed form gives all of them, numbered by branch. Without a closed form, damped least squares searches them
/// from several starts; arms with more than six joints have a family of postures, of which some are found.
pub(super) fn postures(arm: &RobotModel, x_we: &Pose) -> Vec<(usize, JointVec)> {
    match arm.ik(x_we) {
        Ok(solutions) => solutions.in_range().map(|s| (s.branch.index(), s.q)).collect(),
        Err(_) => arm.ik_search(x_we, NUMERIC_STARTS).into_iter().enumerate().collect(),
    }
}

/// A start in a random posture in which the ball is launched to the target, as far as the speeds of the joints allow.
pub(super) fn launching_start(problem: &Problem<'_>, rng: &mut SplitMix64) -> Throw {
    let start = resting_start(problem, rng);
    let frames = problem.arm.fk(&start.q_rad);
    let p = problem.arm.ball(&frames).pos;
    let meeting = problem.aim.point_at(start.flight_s);
    let Ok(launch) = problem.flight.launch(&p, &meeting, start.flight_s) else { return start };
    // Least squares: the hand may turn as it likes.
    let (n, jacobian) = (problem.joints(), frames.jacobian(&p));
    let columns = (0..n).map(|k| jacobian.linear(k));
    let square =
        columns.fold(Matrix3::identity() * DAMPING_M2, |sum, column| sum + column * column.transpose());
    let Some(force) = square.cholesky().map(|c| c.solve(&launch.v0)) else { return start };
    let v = &problem.limits.v;
    let qd_rad_s = JointVec::from_fn(n, |k| jacobian.linear(k).dot(&force).clamp(-v[k], v[k]));
    Throw { qd_rad_s, ..start }
}

/// A start from a throw that was found: the wrist anywhere and at rest, the other joints a little beside.
pub(super) fn varied_start(problem: &Problem<'_>, from: &Throw, rng: &mut SplitMix64) -> Throw {
    let (l, n) = (&problem.limits, problem.joints());
    let q_rad = JointVec::from_fn(n, |j| {
        let away = 2.0 * rng.unit() - 1.0;
        let (middle, half) = (0.5 * (l.q_min[j] + l.q_max[j]), 0.5 * (l.q_max[j] - l.q_min[j]));
        let q = if j < WRIST { from.q_rad[j] + VARIED_RAD * away } else { middle + half * away };
        q.clamp(l.q_min[j], l.q_max[j])
    });
    let arm_alone = |v: &JointVec| JointVec::from_fn(n, |j| if j < WRIST { v[j] } else { 0.0 });
    let (qd_rad_s, qdd_rad_s2) = (arm_alone(&from.qd_rad_s), arm_alone(&from.qdd_rad_s2));
    Throw { q_rad, qd_rad_s, qdd_rad_s2, ..*from }
}

/// A start at rest in a random posture, with the base turned so that the ball is roughly on the side of the target.
///
/// The hand may point anywhere, and the throw may break limits. The local solve corrects both.
pub(super) fn resting_start(problem: &Problem<'_>, rng: &mut SplitMix64) -> Throw {
    let (arm, l, b) = (problem.arm, &problem.limits, &problem.bounds);
    let mut within = |r: &RangeInclusive<f64>| r.start() + (r.end() - r.start()) * rng.unit();
    let (flight_s, duration_s) = (within(&b.flight_s), within(&b.duration_s));
    let hb_s = within(&b.braking_ratio) * duration_s;
    let n = problem.joints();
    let middle = |j: usize| 0.5 * (l.q_min[j] + l.q_max[j]);
    // More than a turn repeats postures.
    let share = |j: usize| (START_SHARE * (l.q_max[j] - middle(j))).min(PI);
    let mut q_rad = JointVec::from_fn(n, |j| middle(j) + share(j) * within(&(-1.0..=1.0)));
    if within(&(0.0..=1.0)) < SQUARE_WRISTS {
        for j in WRIST..n {
            let square = (q_rad[j] / FRAC_PI_2).round() * FRAC_PI_2;
            q_rad[j] = (square + within(&(-START_WRIST_RAD..=START_WRIST_RAD))).clamp(l.q_min[j], l.q_max[j]);
        }
    }
    let frames = arm.fk(&q_rad);
    let axis = frames.axis(0);
    if axis.z.abs() > 0.9 {
        let side = |p: &Vector3<f64>| p.y.atan2(p.x);
        let off = within(&(-START_SIDE_RAD..=START_SIDE_RAD));
        let turn = side(&problem.aim.point_at(flight_s)) - side(&arm.ball(&frames).pos) + off;
        let away = q_rad[0] + turn * axis.z.signum() - middle(0);
        q_rad[0] = (middle(0) + away - TAU * (away / TAU).round()).clamp(l.q_min[0], l.q_max[0]);
    }
    let (qd_rad_s, qdd_rad_s2) = (JointVec::zeros(n), JointVec::zeros(n));
    Throw { q_rad, qd_rad_s, qdd_rad_s2, flight_s, ha_s: duration_s - hb_s, hb_s }
}

/// Signs that mirror a posture in the plane of the base axis, if the arm has that symmetry: joints whose axis lies in
/// the plane at zero change sign, joints across it keep theirs.
pub(super) fn mirror_signs(problem: &Problem<'_>) -> Option<JointVec> {
    let (n, arm) = (problem.joints(), problem.arm);
    let zero = arm.fk(&JointVec::zeros(n));
    let signs = JointVec::from_fn(n, |j| if zero.axis(j).y.abs() > 0.5 { 1.0 } else { -1.0 });
    let q = JointVec::from_fn(n, |j| 0.3 + 0.37 * j as f64);
    let mirrored = JointVec::from_fn(n, |j| q[j] * signs[j]);
    let (a, b) = (arm.ball(&arm.fk(&q)), arm.ball(&arm.fk(&mirrored)));
    let flip = |v: Vector3<f64>| Vector3::new(v.x, -v.y, v.z);
    let same_point = (flip(a.pos) - b.pos).norm() < 1e-9;
    let same_throw = (flip(a.rot.column(2).into()) - Vector3::from(b.rot.column(2))).norm() < 1e-9;
    (same_point && same_throw).then_some(signs)
}

//! Postures of the arm at a release, from which local solves start.

use nalgebra::{Matrix3, Vector3};
use robot_model::{JointVec, Pose, RobotModel};

use super::problem::Problem;
use super::rng::SplitMix64;
use crate::throw::Throw;

/// Starts of the numerical inverse kinematics; a start of the planner needs a posture, not all of them.
const NUMERIC_STARTS: usize = 12;
/// Random postures of which a start takes the best.
const POSTURES: usize = 24;
/// Damping of the least squares for the launch velocity, in m².
const DAMPING_M2: f64 = 1e-4;

/// Postures inside the joint ranges in which the hand is at `x_we`, each with its number.
///
/// The closed form gives all of them, numbered by branch. Without one they are looked for by damped least squares from
/// several starts; arms with more than six joints have a family of postures, of which some are found.
pub(super) fn postures<const N: usize>(arm: &RobotModel<N>, x_we: &Pose) -> Vec<(usize, JointVec<N>)> {
    match arm.ik(x_we) {
        Ok(solutions) => solutions.in_range().map(|s| (s.branch.index(), s.q)).collect(),
        Err(_) => arm.ik_search(x_we, NUMERIC_STARTS).into_iter().enumerate().collect(),
    }
}

/// A start for an arm with fewer than six joints, whose hand cannot take every pose: of some random postures the one
/// whose hand points best along the launch velocity that reaches the target from there.
///
/// `times` are the time of flight and the two phases, in s.
pub(super) fn pointing_start<const N: usize>(
    problem: &Problem<'_, N>,
    rng: &mut SplitMix64,
    [flight_s, ha_s, hb_s]: [f64; 3],
) -> Throw<N> {
    let (arm, l) = (problem.arm, &problem.limits);
    let meeting = problem.aim.point_at(flight_s);
    let mut best: Option<(f64, JointVec<N>, JointVec<N>)> = None;
    for _ in 0..POSTURES {
        let q = JointVec::<N>::from_fn(|j, _| l.q_min[j] + (l.q_max[j] - l.q_min[j]) * rng.unit());
        let frames = arm.fk(&q);
        let ball = arm.ball(&frames);
        let Ok(launch) = problem.flight.launch(&ball.pos, &meeting, flight_s) else { continue };
        let pointing = ball.rot.column(2).dot(&launch.v0) / launch.v0.norm();
        if best.as_ref().is_some_and(|b| b.0 >= pointing) {
            continue;
        }
        // Least squares: the hand may turn as it likes.
        let jacobian = frames.jacobian(&ball.pos);
        let linear = jacobian.fixed_rows::<3>(0);
        let square: Matrix3<f64> = linear * linear.transpose() + Matrix3::identity() * DAMPING_M2;
        let Some(force) = square.cholesky().map(|c| -> Vector3<f64> { c.solve(&launch.v0) }) else {
            continue;
        };
        best = Some((pointing, q, linear.transpose() * force));
    }
    let middle = || JointVec::from_fn(|j, _| 0.5 * (l.q_min[j] + l.q_max[j]));
    let (q_rad, qd_rad_s) = best.map_or_else(|| (middle(), JointVec::zeros()), |(_, q, qd)| (q, qd));
    let qd_rad_s = JointVec::from_fn(|j, _| qd_rad_s[j].clamp(-l.v[j], l.v[j]));
    Throw { q_rad, qd_rad_s, qdd_rad_s2: JointVec::zeros(), flight_s, ha_s, hb_s }
}

/// Signs that mirror a posture in the plane of the base axis, if the arm has that symmetry: joints whose axis lies in
/// the plane at zero change sign, joints across it keep theirs.
pub(super) fn mirror_signs<const N: usize>(problem: &Problem<'_, N>) -> Option<[f64; N]> {
    let arm = problem.arm;
    let zero = arm.fk(&JointVec::zeros());
    let signs: [f64; N] = std::array::from_fn(|j| if zero.axis(j).y.abs() > 0.5 { 1.0 } else { -1.0 });
    let q = JointVec::from_fn(|j, _| 0.3 + 0.37 * j as f64);
    let mirrored = JointVec::from_fn(|j, _| q[j] * signs[j]);
    let (a, b) = (arm.ball(&arm.fk(&q)), arm.ball(&arm.fk(&mirrored)));
    let flip = |v: Vector3<f64>| Vector3::new(v.x, -v.y, v.z);
    let same_point = (flip(a.pos) - b.pos).norm() < 1e-9;
    let same_throw = (flip(a.rot.column(2).into()) - Vector3::from(b.rot.column(2))).norm() < 1e-9;
    (same_point && same_throw).then_some(signs)
}

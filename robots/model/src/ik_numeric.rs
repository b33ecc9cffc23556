//! Inverse kinematics by iteration, for arms without a closed form.
//!
//! One solution: damped least squares (Levenberg-Marquardt) on position and rotation from a start. All solutions:
//! the same from many starts that cover the joint ranges evenly; equal solutions are kept once. A finite number of
//! starts cannot prove that all branches were found.

use nalgebra::{Matrix3, Vector3, Vector6};

use crate::ik::place;
use crate::linalg::Cholesky;
use crate::model::RobotModel;
use crate::per_joint::JointVec;
use crate::pose::Pose;

/// Largest position error of a solution, in m.
const POSITION_TOL_M: f64 = 1e-10;
/// Largest rotation error of a solution, in rad.
const ROTATION_TOL_RAD: f64 = 1e-10;
/// Steps from one start; from a good start three to five are enough.
const STEPS_MAX: usize = 60;
/// Two solutions are one if no joint differs by more than this, in rad, whole turns aside.
const SAME_RAD: f64 = 1e-5;
/// More solutions than a six-joint arm can have (16) mean a singular pose with a continuum of them.
const SOLUTIONS_MAX: usize = 32;
/// The first bases of the Halton sequence, one per joint.
const PRIMES: [u32; 8] = [2, 3, 5, 7, 11, 13, 17, 19];

impl RobotModel {
    /// The solution that damped least squares finds from `q_start`, for an end-effector pose in the world.
    ///
    /// Angles are not limited to the joint ranges and not moved by whole turns: a start near a solution gives that
    /// solution, so that a path can be followed. Works for every arm, of any family. `None` if no solution is reached
    /// within a fixed number of steps (out of reach, or a start that leads to a local minimum).
    #[must_use]
    pub fn ik_from(&self, x_we: &Pose, q_start: &JointVec) -> Option<JointVec> {
        let mut q = *q_start;
        let mut frames = self.fk(&q);
        let mut error = pose_error(x_we, &self.ee(&frames));
        let mut damping = 1e-6;
        for _ in 0..STEPS_MAX {
            if error.fixed_rows::<3>(0).norm() <= POSITION_TOL_M
                && error.fixed_rows::<3>(3).norm() <= ROTATION_TOL_RAD
            {
                return Some(q);
            }
            let jacobian = frames.jacobian(&self.ee(&frames).pos);
            let square = jacobian.times_transposed();
            // The step is taken if it brings the hand nearer; else it is shortened by more damping.
            loop {
                let mut damped = square;
                (0..6).for_each(|i| damped[(i, i)] += damping);
                let solved = Cholesky::new(&damped)?.solve(&JointVec::from(error));
                let q_next = q + jacobian.tr_mul(&Vector6::from_column_slice(&solved));
                let frames_next = self.fk(&q_next);
                let error_next = pose_error(x_we, &self.ee(&frames_next));
                if error_next.norm_squared() < error.norm_squared() {
                    (q, frames, error) = (q_next, frames_next, error_next);
                    damping = (damping * 0.1).max(1e-14);
                    break;
                }
                damping *= 10.0;
                if damping.is_nan() || damping > 1e3 {
                    return None;
                }
            }
        }
        None
    }

    /// The solutions reached from `starts` starts spread over the joint ranges, each once, with angles moved by whole
    /// turns into the ranges where that is possible; solutions outside of the ranges are left out.
    ///
    /// Allocates. The order is that of the starts, which are the same in every call.
    #[must_use]
    pub fn ik_search(&self, x_we: &Pose, starts: usize) -> Vec<JointVec> {
        let mut found: Vec<JointVec> = Vec::new();
        let mut outside: Vec<JointVec> = Vec::new();
        for k in 0..starts {
            if found.len() + outside.len() >= SOLUTIONS_MAX {
                break;
            }
            let Some(q) = self.ik_from(x_we, &self.spread_configuration(k)) else { continue };
            if found.iter().chain(&outside).any(|known| same_posture(known, &q)) {
                continue;
            }
            match self.in_turns(&q) {
                Some(q) => found.push(q),
                None => outside.push(q),
            }
        }
        found
    }

    /// The angles moved by whole turns into their ranges, as near to the middle as possible; `None` if one does not fit.
    fn in_turns(&self, q: &JointVec) -> Option<JointVec> {
        let mut placed = *q;
        for (i, joint) in self.joints().iter().enumerate() {
            let (min, max) = (joint.limits.q_min_rad, joint.limits.q_max_rad);
            let (angle, inside) = place(q[i], 0.5 * (min + max), min, max);
            placed[i] = angle;
            if !inside {
                return None;
            }
        }
        Some(placed)
    }

    /// Configuration number `k` of a sequence that covers the joint ranges evenly (Halton).
    #[must_use]
    pub fn spread_configuration(&self, k: usize) -> JointVec {
        JointVec::from_fn(self.n(), |i| {
            let limits = &self.joints()[i].limits;
            let share = radical_inverse(k as u64 + 1, PRIMES[i % PRIMES.len()]);
            limits.q_min_rad + share * (limits.q_max_rad - limits.q_min_rad)
        })
    }
}

/// Number `k` of the van der Corput sequence in `base`, in [0, 1).
#[must_use]
pub fn radical_inverse(mut k: u64, base: u32) -> f64 {
    let base_u64 = u64::from(base);
    let (mut value, mut digit) = (0.0, 1.0 / f64::from(base));
    while k > 0 {
        value += digit * (k % base_u64) as f64;
        digit /= f64::from(base);
        k /= base_u64;
    }
    value
}

/// `[p_want - p; rotation vector from the actual to the wanted rotation]`, in the world.
fn pose_error(want: &Pose, is: &Pose) -> Vector6<f64> {
    let turn = rotation_vector(&(want.rot * is.rot.transpose()));
    let way = want.pos - is.pos;
    Vector6::new(way.x, way.y, way.z, turn.x, turn.y, turn.z)
}

/// Axis times angle of a rotation, the angle in [0, π].
fn rotation_vector(r: &Matrix3<f64>) -> Vector3<f64> {
    let twice_sine = Vector3::new(r[(2, 1)] - r[(1, 2)], r[(0, 2)] - r[(2, 0)], r[(1, 0)] - r[(0, 1)]);
    let (sine, cosine) = (0.5 * twice_sine.norm(), 0.5 * (r.trace() - 1.0));
    let angle = sine.atan2(cosine);
    if sine > 1e-6 {
        return twice_sine * (0.5 * angle / sine);
    }
    if cosine > 0.0 {
        return twice_sine * 0.5;
    }
    // Half a turn: R + I = 2 a aᵀ.
    let projector = r + Matrix3::identity();
    let longest = (0..3).max_by(|a, b| projector[(*a, *a)].total_cmp(&projector[(*b, *b)])).unwrap_or(0);
    let axis: Vector3<f64> = projector.column(longest).into();
    axis.normalize() * angle
}

fn same_posture(a: &JointVec, b: &JointVec) -> bool {
    use std::f64::consts::TAU;
    a.iter().zip(b.iter()).all(|(a, b)| {
        let apart = a - b;
        (apart - TAU * (apart / TAU).round()).abs() <= SAME_RAD
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rotation_vectors_of_known_turns_also_half_a_turn() {
        for (axis, angle) in [
            (Vector3::new(0.0, 0.0, 1.0), 0.3),
            (Vector3::new(0.6, 0.0, 0.8), 3.0),
            (Vector3::new(0.0, 1.0, 0.0), 1e-9),
            (Vector3::new(0.48, 0.64, 0.6), std::f64::consts::PI),
        ] {
            let turn = nalgebra::Rotation3::new(axis * angle).into_inner();
            let got = rotation_vector(&turn);
            let apart = (got - axis * angle).norm().min((got + axis * angle).norm());
            assert!(apart < 1e-8, "{axis:?} {angle}: {got:?}");
            assert!(angle > 3.1 || (got - axis * angle).norm() < 1e-8, "wrong sign at {angle}");
        }
    }

    #[test]
    fn the_sequence_of_starts_has_its_known_first_values() {
        let base2: Vec<f64> = (1..=4).map(|k| radical_inverse(k, 2)).collect();
        assert_eq!(base2, [0.5, 0.25, 0.75, 0.125]);
        assert!((radical_inverse(5, 3) - (2.0 / 3.0 + 1.0 / 9.0)).abs() < 1e-15);
    }
}

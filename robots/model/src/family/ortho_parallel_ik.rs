//! Ortho-parallel arms with a spherical wrist: inverse kinematics.
//!
//! The wrist centre fixes joints 1 to 3 (two shoulders times two elbows), the remaining rotation fixes the wrist
//! (two twins each). Sines and cosines of intermediate angles come from complex products of known vectors, so that
//! the only transcendental functions are the arc tangents of the results.

use nalgebra::Matrix3;

use super::ortho_parallel::OrthoParallel;
use super::planar::{Complex, EDGE_SLACK, ON_AXIS, TwoLinks};
use crate::ik_solution::{Branch, IkSolutions};
use crate::mat3;
use crate::per_joint::JointVec;
use crate::pose::Pose;

/// A wrist with a smaller sine of its middle angle is straight: joints 4 and 6 turn about one line.
const STRAIGHT_WRIST: f64 = 1e-10;

impl OrthoParallel {
    /// All solutions for the pose of the last joint frame in the world, or that of the branch `only`; free angles are taken from `q_ref`.
    ///
    /// Angles are in (-3π, 3π), not yet placed in the joint ranges.
    pub(crate) fn solve(&self, x_wn: &Pose, q_ref: &JointVec, only: Option<Branch>) -> IkSolutions {
        let mut out = IkSolutions::none(6);
        let r_fn = mat3::tr_mul(&self.x_wf.rot, &x_wn.rot);
        let centre = self.x_wf.inverse_transform_point(&x_wn.transform_point(&self.wrist_centre_n));

        let reach = self.c2_m + self.k_m;
        let across = Complex::new(centre.x, centre.y);
        let across2 = across.re * across.re + across.im * across.im;
        let radial2 = across2 - self.b_m * self.b_m;
        // False for NaN, too.
        let outside_cylinder = radial2 >= -EDGE_SLACK * reach * reach;
        if !outside_cylinder {
            // Inside the cylinder about axis 1 that the offset b keeps free.
            out.reach_margin_m = [across2.sqrt() - self.b_m.abs(); 2];
            return out;
        }
        let radial = radial2.max(0.0).sqrt();
        let on_axis1 = across2.sqrt() <= ON_AXIS * reach;
        for (back, radial) in [(false, radial), (true, -radial)] {
            if only.is_some_and(|branch| branch.shoulder_back() != back) {
                continue;
            }
            // Joint 1 turns (radial, b) onto the wrist centre.
            let turn1 = if on_axis1 {
                let free = Complex::turn(q_ref[0]);
                if back { Complex::new(-free.re, -free.im) } else { free }
            } else {
                across.times(Complex::new(radial, -self.b_m)).unit(across2)
            };
            let target = Complex::new(centre.z - self.c1_m, radial - self.a1_m);
            self.solve_elbows(&mut out, back, turn1, on_axis1, target, &r_fn, (q_ref, only));
        }
        out
    }

    /// Joints 2 and 3 for one shoulder; `target` is the wrist centre seen from axis 2, as z + i x.
    #[expect(clippy::too_many_arguments, reason = "one step of one solution, split for reading")]
    fn solve_elbows(
        &self,
        out: &mut IkSolutions,
        back: bool,
        turn1: Complex,
        free1: bool,
        target: Complex,
        r_fn: &Matrix3<f64>,
        (q_ref, only): (&JointVec, Option<Branch>),
    ) {
        let links = TwoLinks { upper_m: self.c2_m, fore_m: self.k_m };
        out.reach_margin_m[usize::from(back)] = links.margin_m(target);
        let Some(bends) = links.bends(target, self.sign2 * q_ref[1] + self.upper_arm_zero_rad) else {
            return;
        };
        let free = free1 || links.is_free(target);
        let q1 = turn1.angle();
        let r_1 = rot_z_transposed(turn1, r_fn);
        for (bend, negative) in bends.into_iter().zip([false, true]) {
            if only.is_some_and(|branch| branch.elbow_negative() != negative) {
                continue;
            }
            let q2 = self.sign2 * (bend.upper.angle() - self.upper_arm_zero_rad);
            let q3 = self.sign3 * (bend.elbow_rad - self.forearm_zero_rad + self.upper_arm_zero_rad);
            // How far the forearm has turned about y since q = 0.
            let pitch = bend.upper.times(bend.elbow).times(self.forearm_zero.conj());
            let wrist = mat3::tr_mul(&self.r_f4_zero, &rot_y_transposed(pitch, &r_1));
            self.solve_wrists(out, (back, negative), [q1, q2, q3], free, &wrist, q_ref);
        }
    }

    /// Joints 4 to 6 from the rotation left for them, `Rz(u) Ry(v) Rz(w)`.
    fn solve_wrists(
        &self,
        out: &mut IkSolutions,
        (back, negative): (bool, bool),
        [q1, q2, q3]: [f64; 3],
        arm_free: bool,
        m: &Matrix3<f64>,
        q_ref: &JointVec,
    ) {
        let side = Complex::new(m[(0, 2)], m[(1, 2)]);
        let sin_v = side.norm();
        let straight = sin_v <= STRAIGHT_WRIST;
        let turn_u = if straight { Complex::turn(q_ref[3] + self.wrist_zero4_rad) } else { side.unit(sin_v) };
        let u = turn_u.angle();
        let v = sin_v.atan2(m[(2, 2)]);
        // The second row of Rz(-u) m is (sin w, cos w, 0): well conditioned also for a nearly straight wrist.
        let w = Complex::new(
            turn_u.re * m[(1, 1)] - turn_u.im * m[(0, 1)],
            turn_u.re * m[(1, 0)] - turn_u.im * m[(0, 0)],
        )
        .angle();
        let half_turn = std::f64::consts::PI;
        for (flipped, u, v, w) in [(false, u, v, w), (true, u + half_turn, -v, w + half_turn)] {
            let q4 = u - self.wrist_zero4_rad;
            let q5 = -v - self.wrist_zero5_rad;
            let q6 = w - self.wrist_zero6_rad;
            out.set(
                Branch::new(back, negative, flipped),
                [q1, q2, q3, q4, q5, q6].into(),
                arm_free || straight,
            );
        }
    }

    /// Lower bound, in rad: a solution of another branch for the same pose differs by at least twice this value in one joint. The two
    /// solutions of the wrist differ by half a turn in joint 4.
    pub(crate) fn half_gap_rad(&self, q: &[f64; 6]) -> f64 {
        use std::f64::consts::{FRAC_PI_2, PI, TAU};
        let upper_arm = self.upper_arm_zero_rad + self.sign2 * q[1];
        let forearm = self.forearm_zero_rad + self.sign2 * q[1] + self.sign3 * q[2];
        let radial = self.a1_m + self.c2_m * upper_arm.sin() + self.k_m * forearm.sin();
        let elbow = forearm - upper_arm;
        let bent = (elbow - TAU * (elbow / TAU).round_ties_even()).abs();
        bent.min(PI - bent).min(radial.abs().atan2(self.b_m.abs())).min(FRAC_PI_2)
    }

    /// The branch of a configuration.
    pub(crate) fn branch_of(&self, q: &[f64; 6]) -> Branch {
        let upper_arm = self.upper_arm_zero_rad + self.sign2 * q[1];
        let forearm = self.forearm_zero_rad + self.sign2 * q[1] + self.sign3 * q[2];
        let radial = self.a1_m + self.c2_m * upper_arm.sin() + self.k_m * forearm.sin();
        let elbow = (forearm - upper_arm).sin();
        let wrist = -(q[4] + self.wrist_zero5_rad).sin();
        Branch::new(radial < 0.0, elbow < 0.0, wrist < 0.0)
    }
}

/// `Rz(angle)ᵀ m`.
fn rot_z_transposed(turn: Complex, m: &Matrix3<f64>) -> Matrix3<f64> {
    let (c, s) = (turn.re, turn.im);
    let (x, y) = (m.row(0), m.row(1));
    Matrix3::from_rows(&[x * c + y * s, y * c - x * s, m.row(2).into_owned()])
}

/// `Ry(angle)ᵀ m`.
fn rot_y_transposed(turn: Complex, m: &Matrix3<f64>) -> Matrix3<f64> {
    let (c, s) = (turn.re, turn.im);
    let (x, z) = (m.row(0), m.row(2));
    Matrix3::from_rows(&[x * c - z * s, m.row(1).into_owned(), x * s + z * c])
}

//! Ortho-parallel arms with a spherical wrist: geometry.
//!
//! Axis 1 is free in space, axis 2 is perpendicular to it, axis 3 is parallel to axis 2, and axes 4, 5 and 6 meet
//! in one point (the wrist centre), each perpendicular to the one before. Seen in the frame F of joint 1, with z
//! along axis 1, y along axis 2 (or against it) at q1 = 0 and x = y × z forwards:
//!
//! ```text
//!   z |          . W  wrist centre
//!     |      k .
//!     |      o---axis 3 (y, into the page)
//!     |     / c2
//!     |    o  axis 2 (y) at (a1, *, c1)
//!     +---------- x          W stays at y = b while joint 1 rests
//! ```
//!
//! The usual parameters of Brandstötter, Angerer and Hofbaur ("An analytical solution of the inverse kinematics
//! problem of industrial serial manipulators with an ortho-parallel basis and a spherical wrist", 2014) can be
//! computed from these: `k² = a2² + c3²`, and c4 is part of the end-effector frame. Only `k` and the direction of W
//! from axis 3 matter for the solution, so axis 4 may pass axis 3 at any place.

use nalgebra::{Matrix3, Vector3};

use super::lines::{LENGTH_TOL_M, Line, plane_frame};
use super::planar::Complex;
use crate::error::FamilyMismatch;
use crate::pose::Pose;

/// Dimensions of an ortho-parallel arm with spherical wrist.
///
/// Obtained by [`crate::RobotModel`] from the joint frames; lengths in m, angles in rad.
#[derive(Debug, Clone, PartialEq)]
pub struct OrthoParallel {
    /// Joint-1 frame in the world at q1 = 0, turned about z so that x is forwards and y along axis 2 or against it: frame F.
    pub(crate) x_wf: Pose,
    /// Distance of axis 2 from axis 1 along x.
    pub a1_m: f64,
    /// Lateral offset of the wrist centre along y.
    pub b_m: f64,
    /// Height of axis 2 in F.
    pub c1_m: f64,
    /// Distance between axes 2 and 3.
    pub c2_m: f64,
    /// Distance of the wrist centre from axis 3.
    pub k_m: f64,
    /// Direction of axis 3 seen from axis 2 at q2 = 0, from z towards x.
    pub(super) upper_arm_zero_rad: f64,
    /// Direction of the wrist centre seen from axis 3 at q2 = q3 = 0, from z towards x.
    pub(super) forearm_zero_rad: f64,
    /// The same as cosine and sine.
    pub(super) forearm_zero: Complex,
    /// +1 where axis 2 and axis 3 are along y, -1 where they are against it.
    pub(super) sign2: f64,
    pub(super) sign3: f64,
    /// Constant rotation K: frame 4 at q1..q3 = 0, before its own turn, in F.
    pub(crate) r_f4_zero: Matrix3<f64>,
    /// Wrist centre in the last joint frame.
    pub(crate) wrist_centre_n: Vector3<f64>,
    /// q4 = u - this.
    pub(crate) wrist_zero4_rad: f64,
    /// q5 = -v - this.
    pub(crate) wrist_zero5_rad: f64,
    /// q6 = w - this.
    pub(crate) wrist_zero6_rad: f64,
}

impl OrthoParallel {
    /// Largest distance of the wrist centre from the shoulder (a1 = b = 0), in m.
    #[must_use]
    pub fn arm_reach_m(&self) -> f64 {
        self.c2_m + self.k_m
    }

    /// Measures the dimensions; the error names the first condition that fails.
    pub(crate) fn fit(x_pj: &[Pose]) -> Result<Self, FamilyMismatch> {
        let [x1, x2, x3, x4, x5, x6] = x_pj else {
            return Err(FamilyMismatch::Joints { needed: 6, found: x_pj.len() });
        };
        // Joint frames at q = 0, seen from the frame of joint 1.
        let t2 = *x2;
        let t3 = t2 * *x3;
        let t4 = t3 * *x4;
        let t5 = t4 * *x5;
        let t6 = t5 * *x6;
        let axis1 = Line::of(1, &Pose::identity());
        let (axis2, axis3) = (Line::of(2, &t2), Line::of(3, &t3));
        let (axis4, axis5, axis6) = (Line::of(4, &t4), Line::of(5, &t5), Line::of(6, &t6));
        axis1.require_perpendicular(&axis2)?;
        let sign3_to_2 = axis2.require_parallel(&axis3)?;
        axis4.require_perpendicular(&axis5)?;
        axis5.require_perpendicular(&axis6)?;
        let wrist = axis4.require_meeting(&axis5)?;
        let gap_m = (axis5.require_meeting(&axis6)? - wrist).norm();
        if gap_m > LENGTH_TOL_M {
            return Err(FamilyMismatch::NoWristCentre { gap_m });
        }

        let (r_1f, sign2) = plane_frame(&axis2);
        let upper_arm = r_1f.tr_mul(&(axis3.point - axis2.point));
        let forearm = r_1f.tr_mul(&(wrist - axis3.point));
        let shoulder = r_1f.tr_mul(&axis2.point);
        let c2_m = upper_arm.x.hypot(upper_arm.z);
        let k_m = forearm.x.hypot(forearm.z);
        if c2_m <= LENGTH_TOL_M {
            return Err(FamilyMismatch::NoLength { a: 2, b: 3 });
        }
        if k_m <= LENGTH_TOL_M {
            return Err(FamilyMismatch::NoLength { a: 3, b: 5 });
        }
        // A quarter turn about x between axes 4 and 5, and back between 5 and 6, for all frames: A5 = Rz(alpha5)
        // Rx(+90°) Rz(beta5), A6 = Rz(alpha6) Rx(-90°) Rz(beta6).
        let (a5, a6) = (&x5.rot, &x6.rot);
        let alpha5 = a5[(0, 2)].atan2(-a5[(1, 2)]);
        let beta5 = a5[(2, 0)].atan2(a5[(2, 1)]);
        let alpha6 = (-a6[(0, 2)]).atan2(a6[(1, 2)]);
        let beta6 = (-a6[(2, 0)]).atan2(-a6[(2, 1)]);
        Ok(Self {
            x_wf: *x1 * Pose::new(r_1f, Vector3::zeros()),
            a1_m: shoulder.x,
            b_m: r_1f.tr_mul(&wrist).y,
            c1_m: shoulder.z,
            c2_m,
            k_m,
            upper_arm_zero_rad: upper_arm.x.atan2(upper_arm.z),
            forearm_zero_rad: forearm.x.atan2(forearm.z),
            forearm_zero: Complex::new(forearm.z / k_m, forearm.x / k_m),
            sign2,
            sign3: sign2 * sign3_to_2,
            r_f4_zero: r_1f.tr_mul(&t4.rot),
            wrist_centre_n: t6.inverse_transform_point(&wrist),
            wrist_zero4_rad: alpha5,
            wrist_zero5_rad: beta5 + alpha6,
            wrist_zero6_rad: beta6,
        })
    }
}

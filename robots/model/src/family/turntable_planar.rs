//! A turntable with three parallel axes across it: four joints, a point and the elevation of the hand.
//!
//! Frame F is the frame of joint 1, with z along axis 1, y along axis 2 (or against it) at q1 = 0 and x = y × z
//! forwards. Axes 2, 3 and 4 are parallel, so the hand stays in the upright plane in which the turntable points. A
//! full pose can be reached only if its y axis fits that plane; [`TurntablePlanar::aim`] makes such poses from a
//! point and an elevation.

use nalgebra::{Matrix3, Vector3};

use super::lines::{LENGTH_TOL_M, Line, plane_frame};
use super::planar::{Complex, ON_AXIS, TwoLinks};
use crate::error::FamilyMismatch;
use crate::ik_solution::{Branch, IkSolutions};
use crate::per_joint::JointVec;
use crate::pose::Pose;

/// A pose off the arm's plane by more than this (m, or the sine of an angle) is out of reach.
const OFF_PLANE: f64 = 1e-6;

/// Dimensions of a turntable with three parallel axes; lengths in m, angles in rad.
#[derive(Debug, Clone, PartialEq)]
pub struct TurntablePlanar {
    /// Joint-1 frame in the world at q1 = 0, turned about z so that x is forwards: frame F.
    x_wf: Pose,
    /// Distance of axis 2 from axis 1.
    pub a1_m: f64,
    /// Height of axis 2 in F.
    pub c1_m: f64,
    /// Distance between axes 2 and 3.
    pub upper_m: f64,
    /// Distance between axes 3 and 4.
    pub fore_m: f64,
    /// Distance of the end effector from axis 4, in the plane.
    pub hand_m: f64,
    /// Directions of the three links at q = 0, from z towards x.
    upper_zero_rad: f64,
    fore_zero_rad: f64,
    hand_zero_rad: f64,
    /// +1 where axes 2, 3 and 4 are along y, -1 where they are against it.
    sign2: f64,
    sign3: f64,
    sign4: f64,
    /// Rotation of joint frame 4 in F at q = 0.
    r_f4_zero: Matrix3<f64>,
    /// Place of joint frame 4 and of the end effector across the plane.
    side4_m: f64,
    side_e_m: f64,
    /// End effector in joint frame 4.
    x_4e: Pose,
}

impl TurntablePlanar {
    /// Measures the dimensions; the error names the first condition that fails.
    pub(crate) fn fit(x_pj: &[Pose], x_ne: &Pose) -> Result<Self, FamilyMismatch> {
        let [x1, x2, x3, x4] = x_pj else {
            return Err(FamilyMismatch::Joints { needed: 4, found: x_pj.len() });
        };
        let t2 = *x2;
        let t3 = t2 * *x3;
        let t4 = t3 * *x4;
        let axis1 = Line::of(1, &Pose::identity());
        let (axis2, axis3, axis4) = (Line::of(2, &t2), Line::of(3, &t3), Line::of(4, &t4));
        axis1.require_perpendicular(&axis2)?;
        let sign3_to_2 = axis2.require_parallel(&axis3)?;
        let sign4_to_2 = axis2.require_parallel(&axis4)?;

        let (r_1f, sign2) = plane_frame(&axis2);
        let in_f = |p: Vector3<f64>| r_1f.tr_mul(&p);
        let upper = in_f(axis3.point - axis2.point);
        let fore = in_f(axis4.point - axis3.point);
        let hand = in_f((t4 * *x_ne).pos - axis4.point);
        let length = |v: &Vector3<f64>| v.x.hypot(v.z);
        let angle = |v: &Vector3<f64>| v.x.atan2(v.z);
        if length(&upper) <= LENGTH_TOL_M {
            return Err(FamilyMismatch::NoLength { a: 2, b: 3 });
        }
        if length(&fore) <= LENGTH_TOL_M {
            return Err(FamilyMismatch::NoLength { a: 3, b: 4 });
        }
        if length(&hand) <= LENGTH_TOL_M {
            return Err(FamilyMismatch::EndEffectorOnAxis { joint: 4 });
        }
        let shoulder = in_f(axis2.point);
        let side4_m = in_f(axis4.point).y;
        Ok(Self {
            x_wf: *x1 * Pose::new(r_1f, Vector3::zeros()),
            a1_m: shoulder.x,
            c1_m: shoulder.z,
            upper_m: length(&upper),
            fore_m: length(&fore),
            hand_m: length(&hand),
            upper_zero_rad: angle(&upper),
            fore_zero_rad: angle(&fore),
            hand_zero_rad: angle(&hand),
            sign2,
            sign3: sign2 * sign3_to_2,
            sign4: sign2 * sign4_to_2,
            r_f4_zero: r_1f.tr_mul(&t4.rot),
            side4_m,
            side_e_m: side4_m + hand.y,
            x_4e: *x_ne,
        })
    }

    /// End-effector poses at a point (world, m) with the hand pointing `elevation_rad` above the horizontal: outwards
    /// from the turntable's axis, and the same point reached over the back.
    ///
    /// `None` if the point is too close to the axis for the arm's plane to pass through it.
    #[must_use]
    pub fn aim(&self, point_w: &Vector3<f64>, elevation_rad: f64) -> [Option<Pose>; 2] {
        let p = self.x_wf.inverse_transform_point(point_w);
        let across = Complex::new(p.x, p.y);
        let radial2 = p.x * p.x + p.y * p.y - self.side_e_m * self.side_e_m;
        // False for NaN, too.
        let has_plane = radial2 > 0.0 && radial2.is_finite();
        let radial = radial2.max(0.0).sqrt();
        [radial, -radial].map(|radial| {
            if !has_plane {
                return None;
            }
            let turn = across.times(Complex::new(radial, -self.side_e_m)).angle();
            // Over the back the outward direction is the plane's -x.
            let from_z = std::f64::consts::FRAC_PI_2 - elevation_rad;
            let direction = if radial < 0.0 { -from_z } else { from_z };
            let pitch = direction - self.hand_zero_rad;
            let rot_f4 = Pose::rot_z(turn).rot * Pose::rot_y(pitch).rot * self.r_f4_zero;
            let rot = self.x_wf.rot * rot_f4 * self.x_4e.rot;
            Some(Pose::new(rot, *point_w))
        })
    }

    /// Solutions for the pose of the last joint frame in the world; both elbows.
    pub(crate) fn solve(&self, x_wn: &Pose, q_ref: &JointVec) -> IkSolutions {
        let mut out = IkSolutions::none(4);
        // The rotation must be Rz(q1) Ry(pitch) K.
        let turned = self.x_wf.rot.tr_mul(&x_wn.rot) * self.r_f4_zero.transpose();
        let side = Complex::new(turned[(1, 1)], -turned[(0, 1)]);
        let turn1 = side.unit(side.norm());
        let w = self.x_wf.inverse_transform_point(&x_wn.pos);
        let across = Complex::new(w.x, w.y).times(turn1.conj());
        let off_plane = turned[(2, 1)].abs().max((across.im - self.side4_m).abs());
        let in_plane = off_plane <= OFF_PLANE;
        if !in_plane {
            out.reach_margin_m = [-off_plane; 2];
            return out;
        }
        let back = across.re < 0.0;
        let links = TwoLinks { upper_m: self.upper_m, fore_m: self.fore_m };
        let target = Complex::new(w.z - self.c1_m, across.re - self.a1_m);
        out.reach_margin_m = [links.margin_m(target); 2];
        let Some(bends) = links.bends(target, self.sign2 * q_ref[1] + self.upper_zero_rad) else {
            return out;
        };
        let free = links.is_free(target) || side.norm() <= ON_AXIS;
        let pitch = Complex::new(turned[(2, 2)], -turned[(2, 0)]).angle();
        for (bend, negative) in bends.into_iter().zip([false, true]) {
            let q2 = self.sign2 * (bend.upper.angle() - self.upper_zero_rad);
            let q3 = self.sign3 * (bend.elbow_rad - self.fore_zero_rad + self.upper_zero_rad);
            let q4 = self.sign4 * (pitch - self.sign2 * q2 - self.sign3 * q3);
            out.set(Branch::new(back, negative, false), [turn1.angle(), q2, q3, q4].into(), free);
        }
        out
    }

    /// The branch of a configuration.
    pub(crate) fn branch_of(&self, q: &[f64; 4]) -> Branch {
        let upper = self.upper_zero_rad + self.sign2 * q[1];
        let fore = self.fore_zero_rad + self.sign2 * q[1] + self.sign3 * q[2];
        let radial = self.a1_m + self.upper_m * upper.sin() + self.fore_m * fore.sin();
        Branch::new(radial < 0.0, (fore - upper).sin() < 0.0, false)
    }
}

//! Rigid poses `X_AB`: frame B seen from frame A.

use nalgebra::{Matrix3, Matrix4, Vector3};

use crate::mat3;

/// Pose `X_AB` of frame B in frame A: `p_A = rot · p_B + pos`.
///
/// A rotation matrix instead of a quaternion: every use here (axes, Jacobian columns, box edges) reads columns
/// of the matrix, and chains are at most eight links long, so re-normalisation is not needed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Rotation R_AB; its columns are the axes of B in A.
    pub rot: Matrix3<f64>,
    /// Origin of B in A, in metres.
    pub pos: Vector3<f64>,
}

impl Default for Pose {
    fn default() -> Self {
        Self::identity()
    }
}

impl Pose {
    /// From rotation matrix and origin; the caller guarantees that `rot` is a rotation (see [`Pose::rotation_error`]).
    #[must_use]
    #[inline]
    pub fn new(rot: Matrix3<f64>, pos: Vector3<f64>) -> Self {
        Self { rot, pos }
    }

    /// Frame B equal to frame A.
    #[must_use]
    pub fn identity() -> Self {
        Self::new(Matrix3::identity(), Vector3::zeros())
    }

    /// Pure translation in metres.
    #[must_use]
    pub fn translation(x_m: f64, y_m: f64, z_m: f64) -> Self {
        Self::new(Matrix3::identity(), Vector3::new(x_m, y_m, z_m))
    }

    /// Rotation about x by an angle in radians.
    ///
    /// Multiples of a quarter turn give exact zeros and ones, so that tables written in degrees leave no entries of
    /// 1e-17 in sparse matrices.
    #[must_use]
    pub fn rot_x(angle_rad: f64) -> Self {
        let (s, c) = exact_sin_cos(angle_rad);
        Self::new(Matrix3::new(1.0, 0.0, 0.0, 0.0, c, -s, 0.0, s, c), Vector3::zeros())
    }

    /// Rotation about y by an angle in radians; exact at quarter turns.
    #[must_use]
    pub fn rot_y(angle_rad: f64) -> Self {
        let (s, c) = exact_sin_cos(angle_rad);
        Self::new(Matrix3::new(c, 0.0, s, 0.0, 1.0, 0.0, -s, 0.0, c), Vector3::zeros())
    }

    /// Rotation about z by an angle in radians; exact at quarter turns.
    #[must_use]
    pub fn rot_z(angle_rad: f64) -> Self {
        let (s, c) = exact_sin_cos(angle_rad);
        Self::new(Matrix3::new(c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0), Vector3::zeros())
    }

    /// Rotation by fixed-axis roll, pitch, yaw in radians (`Rz(yaw) Ry(pitch) Rx(roll)`, the URDF convention).
    #[must_use]
    pub fn from_rpy(rpy_rad: [f64; 3], pos: Vector3<f64>) -> Self {
        let [roll, pitch, yaw] = rpy_rad;
        let rot = Self::rot_z(yaw).rot * Self::rot_y(pitch).rot * Self::rot_x(roll).rot;
        Self::new(rot, pos)
    }

    /// Fixed-axis roll, pitch, yaw of the rotation; at pitch = ±90° yaw is set to zero.
    #[must_use]
    pub fn rpy_rad(&self) -> [f64; 3] {
        let r = &self.rot;
        let cos_pitch = r[(0, 0)].hypot(r[(1, 0)]);
        let pitch = (-r[(2, 0)]).atan2(cos_pitch);
        if cos_pitch > 1e-12 {
            [r[(2, 1)].atan2(r[(2, 2)]), pitch, r[(1, 0)].atan2(r[(0, 0)])]
        } else {
            [(-r[(1, 2)]).atan2(r[(1, 1)]), pitch, 0.0]
        }
    }

    /// Inverse pose `X_BA`.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let rot = self.rot.transpose();
        Self::new(rot, -(rot * self.pos))
    }

    /// Point given in B, returned in A.
    #[must_use]
    #[inline]
    pub fn transform_point(&self, p_b: &Vector3<f64>) -> Vector3<f64> {
        mat3::mul_v(&self.rot, p_b) + self.pos
    }

    /// Point given in A, returned in B.
    #[must_use]
    #[inline]
    pub fn inverse_transform_point(&self, p_a: &Vector3<f64>) -> Vector3<f64> {
        mat3::tr_mul_v(&self.rot, &(p_a - self.pos))
    }

    /// Homogeneous 4×4 matrix.
    #[must_use]
    pub fn to_matrix(&self) -> Matrix4<f64> {
        let mut m = Matrix4::identity();
        m.fixed_view_mut::<3, 3>(0, 0).copy_from(&self.rot);
        m.fixed_view_mut::<3, 1>(0, 3).copy_from(&self.pos);
        m
    }

    /// How far `rot` is from a proper rotation: largest entry of `RᵀR − I`, or infinity for a mirrored frame.
    #[must_use]
    pub fn rotation_error(&self) -> f64 {
        if self.rot.determinant() < 0.0 {
            return f64::INFINITY;
        }
        (self.rot.tr_mul(&self.rot) - Matrix3::identity()).amax()
    }
}

impl std::ops::Mul for Pose {
    type Output = Self;
    /// Chain: `X_AC = X_AB · X_BC`.
    #[inline]
    fn mul(self, rhs: Self) -> Self {
        Self::new(mat3::mul(&self.rot, &rhs.rot), self.transform_point(&rhs.pos))
    }
}

fn exact_sin_cos(angle_rad: f64) -> (f64, f64) {
    let quarter_turns = angle_rad / std::f64::consts::FRAC_PI_2;
    // Two ulp of slack: degrees converted to radians do not land on the multiple exactly.
    if (quarter_turns - quarter_turns.round()).abs() <= 4.0 * f64::EPSILON * quarter_turns.abs() {
        match quarter_turns.round().rem_euclid(4.0) as u8 {
            0 => (0.0, 1.0),
            1 => (1.0, 0.0),
            2 => (0.0, -1.0),
            _ => (-1.0, 0.0),
        }
    } else {
        libm::sincos(angle_rad)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quarter_turns_are_exact() {
        for k in -8..=8_i32 {
            let m = Pose::rot_x(f64::from(90 * k).to_radians()).rot;
            assert!(m.iter().all(|v| *v == 0.0 || v.abs() == 1.0), "{k}: {m}");
        }
    }

    #[test]
    fn inverse_undoes_the_pose() {
        let x = Pose::from_rpy([0.3, -0.7, 1.9], Vector3::new(0.1, -0.2, 0.3));
        let id = x * x.inverse();
        assert!((id.to_matrix() - Matrix4::identity()).amax() < 1e-15);
        assert!(x.rotation_error() < 1e-15);
    }

    #[test]
    fn rpy_survives_the_round_trip_also_at_the_pole() {
        for rpy in [
            [0.3, -0.7, 1.9],
            [0.4, std::f64::consts::FRAC_PI_2, 0.0],
            [-2.0, -std::f64::consts::FRAC_PI_2, 0.5],
        ] {
            let x = Pose::from_rpy(rpy, Vector3::zeros());
            let back = Pose::from_rpy(x.rpy_rad(), Vector3::zeros());
            assert!((x.rot - back.rot).amax() < 1e-15, "{rpy:?}");
        }
    }

    #[test]
    fn a_mirrored_frame_is_no_rotation() {
        let mut x = Pose::identity();
        x.rot[(2, 2)] = -1.0;
        assert_eq!(x.rotation_error(), f64::INFINITY);
    }
}

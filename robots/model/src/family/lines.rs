//! Joint axes as lines, for measuring a robot's geometry.

use nalgebra::{Matrix3, Vector3};

use crate::error::FamilyMismatch;
use crate::pose::Pose;

/// Angles below this count as zero when a family's conditions are checked, in rad.
///
/// Frames come from tables in degrees, so a robot of the family fits to rounding. A measured (calibrated) model
/// with real offsets is not of the family and must be refused: its inverse kinematics would be wrong by the
/// offsets.
pub(super) const ANGLE_TOL_RAD: f64 = 1e-9;
/// Lengths below this count as zero, in m.
pub(super) const LENGTH_TOL_M: f64 = 1e-9;

/// A joint axis: a point on it and its unit direction.
#[derive(Debug, Clone, Copy)]
pub(super) struct Line {
    pub(super) joint: usize,
    pub(super) point: Vector3<f64>,
    pub(super) dir: Vector3<f64>,
}

impl Line {
    /// The axis of joint `joint` (from 1) whose joint frame is `x`.
    pub(super) fn of(joint: usize, x: &Pose) -> Self {
        Self { joint, point: x.pos, dir: x.rot.column(2).into() }
    }

    pub(super) fn require_perpendicular(&self, other: &Self) -> Result<(), FamilyMismatch> {
        let off_rad = self.dir.dot(&other.dir).clamp(-1.0, 1.0).asin().abs();
        if off_rad <= ANGLE_TOL_RAD {
            Ok(())
        } else {
            Err(FamilyMismatch::NotPerpendicular { a: self.joint, b: other.joint, off_rad })
        }
    }

    /// Checks that the axes are parallel; +1 for the same direction, -1 for opposite ones.
    pub(super) fn require_parallel(&self, other: &Self) -> Result<f64, FamilyMismatch> {
        let off_rad = self.dir.cross(&other.dir).norm().min(1.0).asin();
        if off_rad <= ANGLE_TOL_RAD {
            Ok(self.dir.dot(&other.dir).signum())
        } else {
            Err(FamilyMismatch::NotParallel { a: self.joint, b: other.joint, off_rad })
        }
    }

    /// The point where two perpendicular axes meet.
    pub(super) fn require_meeting(&self, other: &Self) -> Result<Vector3<f64>, FamilyMismatch> {
        let between = other.point - self.point;
        let normal = self.dir.cross(&other.dir);
        let gap_m = between.dot(&normal).abs() / normal.norm();
        if gap_m > LENGTH_TOL_M {
            return Err(FamilyMismatch::NotMeeting { a: self.joint, b: other.joint, gap_m });
        }
        Ok(self.point + self.dir * between.dot(&self.dir))
    }
}

/// Frame F of a robot in the frame of joint 1: z along axis 1, y along axis 2 or against it, x = y × z on the side
/// of the x axis of joint frame 1, so that "forwards" is the same as in the given frames.
///
/// Returns the rotation of F, and +1 if axis 2 is along y, -1 if against. The axes must be perpendicular.
pub(super) fn plane_frame(axis2: &Line) -> (Matrix3<f64>, f64) {
    let z = Vector3::z();
    let x = axis2.dir.cross(&z);
    let sign2 = if x.x < -ANGLE_TOL_RAD { -1.0 } else { 1.0 };
    (Matrix3::from_columns(&[x * sign2, axis2.dir * sign2, z]), sign2)
}

//! Forward kinematics.

use nalgebra::{ArrayStorage, Matrix3, Vector3};

use crate::model::RobotModel;
use crate::per_joint::{JointVec, PerJoint};
use crate::pose::Pose;

/// Poses of all joint frames in the world for one configuration.
///
/// Computed once by [`RobotModel::fk`]; Jacobians, end effector, ball and collision boxes are then computed from it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frames {
    /// `X_Wi`: joint frame `i` in the world; its z axis is the axis of joint `i`. Index 0 is joint 1.
    pub x_w: PerJoint<Pose>,
}

impl Frames {
    /// Number of joints.
    #[must_use]
    #[inline]
    pub fn n(&self) -> usize {
        self.x_w.len()
    }

    /// Unit axis of joint `i` (index from 0) in the world.
    #[must_use]
    pub fn axis(&self, i: usize) -> Vector3<f64> {
        self.x_w[i].rot.column(2).into()
    }

    /// Origin of joint frame `i` (index from 0) in the world, in m.
    #[must_use]
    pub fn origin(&self, i: usize) -> Vector3<f64> {
        self.x_w[i].pos
    }
}

impl RobotModel {
    /// Forward kinematics: all joint frames in the world for joint angles in rad.
    ///
    /// Any finite angle is accepted; ranges are not applied here.
    #[must_use]
    pub fn fk(&self, q_rad: &JointVec) -> Frames {
        let mut before = Pose::identity();
        let x_w = PerJoint::from_fn(self.n(), |i| {
            before = before * turned(&self.joints[i].x_pj, q_rad[i]);
            before
        });
        Frames { x_w }
    }

    /// End effector in the world, `X_WE`.
    #[must_use]
    pub fn ee(&self, frames: &Frames) -> Pose {
        frames.x_w[frames.n() - 1] * self.x_ne
    }

    /// Release frame in the world; its origin is the ball's centre.
    #[must_use]
    pub fn ball(&self, frames: &Frames) -> Pose {
        self.ee(frames) * self.gripper.x_eb
    }
}

/// `x · Rz(q)`, without multiplying by the zeros of the rotation.
#[inline]
pub(crate) fn turned(x: &Pose, q_rad: f64) -> Pose {
    Pose::new(turned_rot(&x.rot, q_rad), x.pos)
}

/// `r · Rz(q)`.
#[inline]
pub(crate) fn turned_rot(r: &Matrix3<f64>, q_rad: f64) -> Matrix3<f64> {
    // From libm, not from the system: the same bits on every host, so that simulations can be compared.
    let (s, c) = libm::sincos(q_rad);
    let [x, y, z] = &r.data.0;
    Matrix3::from_data(ArrayStorage([
        std::array::from_fn(|i| x[i] * c + y[i] * s),
        std::array::from_fn(|i| y[i] * c - x[i] * s),
        *z,
    ]))
}

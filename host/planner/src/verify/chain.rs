//! Forward kinematics by the product of exponentials: `T(q) = e^{[S₁]q₁} … e^{[S_n]q_n} M`.
//!
//! Screws S and home poses M are read off once, at q = 0; after that no joint frame is used any more.

use nalgebra::{Matrix3, Rotation3, Unit, Vector3};
use robot_model::{JointVec, PerJoint, Pose, RobotModel};

/// The arm as screws and home poses.
#[derive(Debug, Clone)]
pub struct Chain {
    /// Direction of each axis and a point on it, world, at q = 0.
    screws: Vec<(Unit<Vector3<f64>>, Vector3<f64>)>,
    /// Joint frames at q = 0.
    home: Vec<Pose>,
}

/// Displacements of the links from home: `x ↦ R x + d`.
pub type Displacements = PerJoint<(Matrix3<f64>, Vector3<f64>)>;

impl Chain {
    /// Reads screws and home poses.
    #[must_use]
    pub fn new(arm: &RobotModel) -> Self {
        let mut frame = Pose::identity();
        let mut home = Vec::with_capacity(arm.n());
        for joint in arm.joints() {
            frame = frame * joint.x_pj;
            home.push(frame);
        }
        let screws =
            home.iter().map(|h| (Unit::new_normalize(Vector3::from(h.rot.column(2))), h.pos)).collect();
        Self { screws, home }
    }

    /// Displacement of every link from home.
    #[must_use]
    pub(crate) fn displacements(&self, q: &JointVec) -> Displacements {
        let (mut r, mut d) = (Matrix3::identity(), Vector3::zeros());
        PerJoint::from_fn(self.screws.len(), |j| {
            let (axis, point) = &self.screws[j];
            // e^{[S] q}: Rodrigues' rotation about a line.
            let turn = Rotation3::from_axis_angle(axis, q[j]).into_inner();
            let shift = point - turn * point;
            d += r * shift;
            r *= turn;
            (r, d)
        })
    }

    /// Pose of link `i` (from 0), as its joint frame.
    #[must_use]
    pub fn link(&self, displacements: &Displacements, i: usize) -> Pose {
        let (r, d) = &displacements[i];
        Pose::new(r * self.home[i].rot, r * self.home[i].pos + d)
    }

    /// Axis of joint `j` now: direction and a point on it.
    #[must_use]
    pub fn axis(&self, displacements: &Displacements, j: usize) -> (Vector3<f64>, Vector3<f64>) {
        let (r, d) = &displacements[j];
        let (axis, point) = &self.screws[j];
        (r * axis.into_inner(), r * point + d)
    }
}

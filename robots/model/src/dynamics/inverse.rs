//! Inverse dynamics by the recursive Newton-Euler algorithm, in link coordinates.

use nalgebra::{Matrix3, Vector3};

use crate::kinematics::turned_rot;
use crate::mat3;
use crate::model::{LinkInertia, RobotModel};
use crate::per_joint::{JOINTS_MAX, JointVec};

/// Force and moment about the origin of a joint frame.
#[derive(Clone, Copy)]
struct Wrench {
    force: Vector3<f64>,
    moment: Vector3<f64>,
}

impl RobotModel {
    /// Joint torques in N·m that produce `qdd` in state `(q, qd)`: `τ = M q̈ + C q̇ + g`.
    ///
    /// Angles in rad, rates in rad/s and rad/s². Gravity as in the robot file; the hand is empty ([`RobotModel::holding_ball`]).
    /// Source: Luh, Walker, Paul 1980; Craig, "Introduction to Robotics", section 6.5.
    #[must_use]
    pub fn inverse_dynamics(&self, q: &JointVec, qd: &JointVec, qdd: &JointVec) -> JointVec {
        let mut rot = [Matrix3::zeros(); JOINTS_MAX];
        let mut on_link = [Wrench { force: Vector3::zeros(), moment: Vector3::zeros() }; JOINTS_MAX];

        // Outward: angular velocity ω, angular acceleration α and acceleration a of each joint frame, in itself. The
        // matrix W = [α×] + [ω×][ω×] gives the acceleration W p of a point p of the link against the frame's origin.
        let mut w = Vector3::zeros();
        let mut alpha = Vector3::zeros();
        let mut w_mat = Matrix3::zeros();
        // An upward acceleration of the base stands for gravity.
        let mut a = Vector3::new(0.0, 0.0, self.world.gravity_m_s2);
        for i in 0..self.n() {
            let joint = &self.joints[i];
            let r = turned_rot(&joint.x_pj.rot, q[i]);
            let a_origin = a + mat3::mul_v(&w_mat, &joint.x_pj.pos);
            let w_parent = mat3::tr_mul_v(&r, &w);
            a = mat3::tr_mul_v(&r, &a_origin);
            alpha = mat3::tr_mul_v(&r, &alpha);
            // ω × z q̇ has only these two components.
            alpha.x += w_parent.y * qd[i];
            alpha.y -= w_parent.x * qd[i];
            alpha.z += qdd[i];
            w = w_parent;
            w.z += qd[i];
            w_mat = acceleration_matrix(&w, &alpha);
            on_link[i] = inertial_wrench(&self.links[i].inertia, &w, &alpha, &w_mat, &a);
            rot[i] = r;
        }
        self.project(&rot, on_link)
    }

    /// Joint torques in N·m that hold the arm at rest in `q`: `g(q)`.
    #[must_use]
    pub fn gravity_torques(&self, q: &JointVec) -> JointVec {
        let mut rot = [Matrix3::zeros(); JOINTS_MAX];
        let mut on_link = [Wrench { force: Vector3::zeros(), moment: Vector3::zeros() }; JOINTS_MAX];
        let mut a = Vector3::new(0.0, 0.0, self.world.gravity_m_s2);
        for i in 0..self.n() {
            rot[i] = turned_rot(&self.joints[i].x_pj.rot, q[i]);
            a = mat3::tr_mul_v(&rot[i], &a);
            let inertia = &self.links[i].inertia;
            on_link[i] =
                Wrench { force: a * inertia.mass_kg(), moment: mat3::cross(&inertia.first_moment_kg_m, &a) };
        }
        self.project(&rot, on_link)
    }

    /// Torques that act at zero joint acceleration: `C(q, q̇) q̇ + g(q)`, in N·m.
    #[must_use]
    pub fn bias_torques(&self, q: &JointVec, qd: &JointVec) -> JointVec {
        self.inverse_dynamics(q, qd, &JointVec::zeros(self.n()))
    }

    /// Inward: sums the wrenches towards the base and takes the part about each axis.
    fn project(&self, rot: &[Matrix3<f64>; JOINTS_MAX], mut on_link: [Wrench; JOINTS_MAX]) -> JointVec {
        let mut tau = JointVec::zeros(self.n());
        for i in (0..self.n()).rev() {
            let own = on_link[i];
            tau[i] = own.moment.z;
            if i > 0 {
                let force = mat3::mul_v(&rot[i], &own.force);
                on_link[i - 1].force += force;
                on_link[i - 1].moment +=
                    mat3::mul_v(&rot[i], &own.moment) + mat3::cross(&self.joints[i].x_pj.pos, &force);
            }
        }
        tau
    }
}

/// `[α×] + [ω×][ω×]`.
#[inline]
fn acceleration_matrix(w: &Vector3<f64>, alpha: &Vector3<f64>) -> Matrix3<f64> {
    let (xx, yy, zz) = (w.x * w.x, w.y * w.y, w.z * w.z);
    let (xy, xz, yz) = (w.x * w.y, w.x * w.z, w.y * w.z);
    Matrix3::new(
        -yy - zz,
        xy - alpha.z,
        xz + alpha.y,
        xy + alpha.z,
        -xx - zz,
        yz - alpha.x,
        xz - alpha.y,
        yz + alpha.x,
        -xx - yy,
    )
}

/// Wrench that moves a link, about the origin of its frame: with first moment h = m c and inertia I about the origin,
/// `f = m a + W h` and `n = I α + ω × I ω + h × a`.
#[inline]
fn inertial_wrench(
    inertia: &LinkInertia,
    w: &Vector3<f64>,
    alpha: &Vector3<f64>,
    w_mat: &Matrix3<f64>,
    a: &Vector3<f64>,
) -> Wrench {
    let h = &inertia.first_moment_kg_m;
    let i_o = &inertia.about_origin_kg_m2;
    Wrench {
        force: a * inertia.mass_kg() + mat3::mul_v(w_mat, h),
        moment: mat3::mul_v(i_o, alpha) + mat3::cross(w, &mat3::mul_v(i_o, w)) + mat3::cross(h, a),
    }
}

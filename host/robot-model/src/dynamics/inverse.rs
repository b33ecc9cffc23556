//! Inverse dynamics by the recursive Newton-Euler algorithm, in link coordinates.

use nalgebra::{Matrix3, Vector3};

use crate::kinematics::turned;
use crate::model::{JointVec, LinkInertia, RobotModel};

/// Force and moment about the origin of a joint frame.
#[derive(Clone, Copy)]
struct Wrench {
    force: Vector3<f64>,
    moment: Vector3<f64>,
}

impl<const N: usize> RobotModel<N> {
    /// Joint torques in N·m that produce `qdd` in state `(q, qd)`: `τ = M q̈ + C q̇ + g`.
    ///
    /// Angles in rad, rates in rad/s and rad/s². Gravity as in the robot file; the ball's mass is not included.
    /// Source: Luh, Walker, Paul 1980; Craig, "Introduction to Robotics", section 6.5.
    #[must_use]
    pub fn inverse_dynamics(&self, q: &JointVec<N>, qd: &JointVec<N>, qdd: &JointVec<N>) -> JointVec<N> {
        let mut rot = [Matrix3::zeros(); N];
        let mut on_link = [Wrench { force: Vector3::zeros(), moment: Vector3::zeros() }; N];

        // Outward: angular velocity ω, angular acceleration α and acceleration a of each joint frame, in itself.
        let mut w = Vector3::zeros();
        let mut alpha = Vector3::zeros();
        // An upward acceleration of the base stands for gravity.
        let mut a = Vector3::new(0.0, 0.0, self.world.gravity_m_s2);
        for i in 0..N {
            let joint = &self.joints[i];
            let p = &joint.x_pj.pos;
            let r = turned(&joint.x_pj, q[i]).rot;
            let a_origin = a + alpha.cross(p) + w.cross(&w.cross(p));
            let w_parent = r.tr_mul(&w);
            a = r.tr_mul(&a_origin);
            alpha = r.tr_mul(&alpha);
            // ω × z q̇ has only these two components.
            alpha.x += w_parent.y * qd[i];
            alpha.y -= w_parent.x * qd[i];
            alpha.z += qdd[i];
            w = w_parent;
            w.z += qd[i];
            on_link[i] = inertial_wrench(&self.links[i].inertia, &w, &alpha, &a);
            rot[i] = r;
        }
        self.project(&rot, on_link)
    }

    /// Joint torques in N·m that hold the arm at rest in `q`: `g(q)`.
    #[must_use]
    pub fn gravity_torques(&self, q: &JointVec<N>) -> JointVec<N> {
        let mut rot = [Matrix3::zeros(); N];
        let mut on_link = [Wrench { force: Vector3::zeros(), moment: Vector3::zeros() }; N];
        let mut a = Vector3::new(0.0, 0.0, self.world.gravity_m_s2);
        for i in 0..N {
            rot[i] = turned(&self.joints[i].x_pj, q[i]).rot;
            a = rot[i].tr_mul(&a);
            let inertia = &self.links[i].inertia;
            on_link[i] = Wrench { force: a * inertia.mass_kg(), moment: inertia.first_moment_kg_m.cross(&a) };
        }
        self.project(&rot, on_link)
    }

    /// Torques that act at zero joint acceleration: `C(q, q̇) q̇ + g(q)`, in N·m.
    #[must_use]
    pub fn bias_torques(&self, q: &JointVec<N>, qd: &JointVec<N>) -> JointVec<N> {
        self.inverse_dynamics(q, qd, &JointVec::zeros())
    }

    /// Inward: sums the wrenches towards the base and takes the part about each axis.
    fn project(&self, rot: &[Matrix3<f64>; N], mut on_link: [Wrench; N]) -> JointVec<N> {
        let mut tau = JointVec::zeros();
        for i in (0..N).rev() {
            let own = on_link[i];
            tau[i] = own.moment.z;
            if i > 0 {
                let force = rot[i] * own.force;
                on_link[i - 1].force += force;
                on_link[i - 1].moment += rot[i] * own.moment + self.joints[i].x_pj.pos.cross(&force);
            }
        }
        tau
    }
}

/// Wrench that moves a link, about the origin of its frame: with first moment h = m c and inertia I about the origin,
/// `f = m a + α × h + ω × (ω × h)` and `n = I α + ω × I ω + h × a`.
fn inertial_wrench(
    inertia: &LinkInertia,
    w: &Vector3<f64>,
    alpha: &Vector3<f64>,
    a: &Vector3<f64>,
) -> Wrench {
    let h = &inertia.first_moment_kg_m;
    let i_o = &inertia.about_origin_kg_m2;
    Wrench {
        force: a * inertia.mass_kg() + alpha.cross(h) + w.cross(&w.cross(h)),
        moment: i_o * alpha + w.cross(&(i_o * w)) + h.cross(a),
    }
}

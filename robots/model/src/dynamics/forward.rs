//! Mass matrix, forward dynamics and energies.

use nalgebra::{Matrix3, Vector3};

use crate::kinematics::turned_rot;
use crate::linalg::{Cholesky, SquareMatrix};
use crate::mat3;
use crate::model::{LinkInertia, RobotModel};
use crate::per_joint::{JointVec, PerJoint};

/// One link and all after it up to the hand, as if welded: mass, first moment and inertia about the origin of the first joint
/// frame.
#[derive(Clone, Copy, Default)]
struct Composite {
    m: f64,
    h: Vector3<f64>,
    i: Matrix3<f64>,
}

impl Composite {
    fn of(link: &LinkInertia) -> Self {
        Self { m: link.mass_kg(), h: link.first_moment_kg_m, i: link.about_origin_kg_m2 }
    }

    /// Adds a composite given in a frame that is turned by `r` and shifted by `p`.
    fn add(&mut self, other: &Self, r: &Matrix3<f64>, p: &Vector3<f64>) {
        let h = mat3::mul_v(r, &other.h);
        let turned = mat3::mul(&mat3::mul(r, &other.i), &r.transpose());
        let cross = p * h.transpose();
        let scalar = Matrix3::identity() * (2.0 * p.dot(&h) + other.m * p.norm_squared());
        self.i += turned + scalar - cross - cross.transpose() - p * p.transpose() * other.m;
        self.h += h + p * other.m;
        self.m += other.m;
    }
}

impl RobotModel {
    /// Mass matrix `M(q)` in kg·m²: symmetric and positive definite for every model that the loader accepts.
    ///
    /// Composite-rigid-body algorithm (Featherstone 2008, section 6.2).
    #[must_use]
    pub fn mass_matrix(&self, q: &JointVec) -> SquareMatrix {
        let n = self.n();
        let rot = PerJoint::from_fn(n, |i| turned_rot(&self.joints[i].x_pj.rot, q[i]));
        let mut composite = PerJoint::from_fn(n, |i| Composite::of(&self.links[i].inertia));
        let mut mass = SquareMatrix::zeros(n);
        for i in (0..n).rev() {
            let c = composite[i];
            if i > 0 {
                composite[i - 1].add(&c, &rot[i], &self.joints[i].x_pj.pos);
            }
            // Wrench for unit acceleration about the axis, carried to the base.
            let mut force = Vector3::new(-c.h.y, c.h.x, 0.0);
            let mut moment: Vector3<f64> = c.i.column(2).into();
            mass[(i, i)] = moment.z;
            for j in (0..i).rev() {
                force = mat3::mul_v(&rot[j + 1], &force);
                moment =
                    mat3::mul_v(&rot[j + 1], &moment) + mat3::cross(&self.joints[j + 1].x_pj.pos, &force);
                mass[(i, j)] = moment.z;
                mass[(j, i)] = moment.z;
            }
        }
        mass
    }

    /// Joint accelerations in rad/s² that torques `tau` in N·m cause in state `(q, qd)`: `M⁻¹ (τ - C q̇ - g)`.
    ///
    /// Friction and motors are not included. Not finite if the arguments are not.
    #[must_use]
    pub fn forward_dynamics(&self, q: &JointVec, qd: &JointVec, tau: &JointVec) -> JointVec {
        let free = tau - self.bias_torques(q, qd);
        match Cholesky::new(&self.mass_matrix(q)) {
            Some(mass) => mass.solve(&free),
            // Masses are positive, so only angles that are not numbers come here.
            None => JointVec::repeat(self.n(), f64::NAN),
        }
    }

    /// Kinetic energy in J.
    #[must_use]
    pub fn kinetic_energy_j(&self, q: &JointVec, qd: &JointVec) -> f64 {
        0.5 * qd.dot(&(&self.mass_matrix(q) * qd))
    }

    /// Potential energy of the links in J; zero for a link whose centre of mass is at the height of the world origin.
    #[must_use]
    pub fn potential_energy_j(&self, q: &JointVec) -> f64 {
        let frames = self.fk(q);
        let moment: f64 = self
            .links
            .iter()
            .zip(&frames.x_w)
            .map(|(link, x_w)| link.inertia.mass_kg() * x_w.transform_point(link.inertia.com_m()).z)
            .sum();
        moment * self.world.gravity_m_s2
    }
}

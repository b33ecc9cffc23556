//! Inverse dynamics with exact derivatives in one pass.
//!
//! Closed-form partial derivatives instead of dual numbers: for six joints one pass gives the torque, both 6 × 6
//! Jacobians and the mass matrix, where forward-mode duals would carry twelve tangents through every product.
//! Source: S. Singh, R. P. Russo, P. M. Wensing, "Efficient Analytical Derivatives of Rigid-Body Dynamics Using
//! Spatial Vector Algebra", IEEE RA-L 7(2), 2022, eq. (15) to (20), for a chain of revolute joints.

use super::spatial::{Coriolis, ForceVector, Inertia, MotionVector};
use crate::kinematics::Frames;
use crate::linalg::SquareMatrix;
use crate::model::RobotModel;
use crate::per_joint::{JOINTS_MAX, JointVec};

/// Torque with its derivatives; entry `(i, j)` of a matrix is the derivative of `τ_i` by joint `j`.
#[derive(Clone, Copy)]
pub struct InverseDynamicsGradient {
    /// `τ(q, q̇, q̈)` in N·m.
    pub tau: JointVec,
    /// `∂τ/∂q` in N·m/rad.
    pub by_q: SquareMatrix,
    /// `∂τ/∂q̇` in N·m·s/rad.
    pub by_qd: SquareMatrix,
    /// `∂τ/∂q̈ = M(q)`, the mass matrix, in kg·m².
    pub by_qdd: SquareMatrix,
}

impl RobotModel {
    /// Inverse dynamics and its derivatives in the state `(q, qd)` at the acceleration `qdd` (rad, s).
    #[must_use]
    pub fn inverse_dynamics_gradient(
        &self,
        q: &JointVec,
        qd: &JointVec,
        qdd: &JointVec,
    ) -> InverseDynamicsGradient {
        self.inverse_dynamics_gradient_at(&self.fk(q), qd, qdd)
    }

    /// As [`RobotModel::inverse_dynamics_gradient`], for frames that are already known.
    #[must_use]
    pub fn inverse_dynamics_gradient_at(
        &self,
        frames: &Frames,
        qd: &JointVec,
        qdd: &JointVec,
    ) -> InverseDynamicsGradient {
        let n = self.n();
        // Notation of the source: S joint screws, Ψ̇ and Ψ̈ their rates as seen from the link before.
        let mut s = [MotionVector::zero(); JOINTS_MAX];
        let mut psi_d = [MotionVector::zero(); JOINTS_MAX];
        let mut psi_dd = [MotionVector::zero(); JOINTS_MAX];
        let mut inertia = [Inertia::zero(); JOINTS_MAX];
        let mut coriolis = [Coriolis::zero(); JOINTS_MAX];
        let mut force = [ForceVector::zero(); JOINTS_MAX];

        let mut v = MotionVector::zero();
        let mut a = MotionVector::zero();
        a.v.z = self.world.gravity_m_s2;
        for i in 0..n {
            s[i] = MotionVector::joint_axis(frames, i);
            psi_d[i] = v.cross(&s[i]);
            psi_dd[i] = a.cross(&s[i]).plus(&v.cross(&psi_d[i]), 1.0);
            v = v.plus(&s[i], qd[i]);
            a = a.plus(&s[i], qdd[i]).plus(&psi_d[i], qd[i]);
            inertia[i] = Inertia::of(&self.links[i].inertia, &frames.x_w[i]);
            coriolis[i] = Coriolis::of(&inertia[i], &v);
            let momentum = inertia[i].times(&v);
            force[i] = inertia[i].times(&a).plus(&v.cross_force(&momentum));
        }

        let mut out = InverseDynamicsGradient {
            tau: JointVec::zeros(n),
            by_q: SquareMatrix::zeros(n),
            by_qd: SquareMatrix::zeros(n),
            by_qdd: SquareMatrix::zeros(n),
        };
        for i in (0..n).rev() {
            if i + 1 < n {
                inertia[i] = inertia[i].plus(&inertia[i + 1]);
                coriolis[i] = coriolis[i].plus(&coriolis[i + 1]);
                force[i] = force[i].plus(&force[i + 1]);
            }
            let (ic, bc, fc) = (&inertia[i], &coriolis[i], &force[i]);
            out.tau[i] = s[i].dot(fc);
            // Row i, columns j ≤ i: what joints before i do to τ_i.
            let row_m = ic.times(&s[i]);
            let row_b = bc.twice_transposed(&s[i]);
            // Column i, rows j < i: what joint i does to the torques before it.
            let by_q = bc.twice(&psi_d[i]).plus(&ic.times(&psi_dd[i])).plus(&s[i].cross_force(fc));
            let by_qd = bc.twice(&s[i]).plus(&ic.times(&psi_d[i])).plus(&ic.times(&psi_d[i]));
            for j in 0..=i {
                out.by_qdd[(i, j)] = s[j].dot(&row_m);
                out.by_q[(i, j)] = row_b.dot(&psi_d[j].w) + psi_dd[j].dot(&row_m);
                out.by_qd[(i, j)] = row_b.dot(&s[j].w) + 2.0 * psi_d[j].dot(&row_m);
                if j < i {
                    out.by_qdd[(j, i)] = out.by_qdd[(i, j)];
                    out.by_q[(j, i)] = s[j].dot(&by_q);
                    out.by_qd[(j, i)] = s[j].dot(&by_qd);
                }
            }
        }
        out
    }
}

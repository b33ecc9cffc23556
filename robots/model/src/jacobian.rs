//! Geometric Jacobian of a point on the last link, and its derivatives.
//!
//! With `z_i` the axis of joint `i` and `o_i` a point on it, column `i` is `[v_i; z_i]`, `v_i = z_i × (p - o_i)`.
//! Turning joint `k` turns everything after it, so
//! `∂v_i/∂q_k = z_k × v_i` for `k < i` and `z_i × v_k` for `k ≥ i`; `∂z_i/∂q_k = z_k × z_i` for `k < i`, else 0.

use nalgebra::{DMatrix, SMatrix, Vector3, Vector6};

use crate::kinematics::Frames;
use crate::linalg::JointVec;
use crate::linalg::{Cholesky, Lu};
use crate::mat3;

/// Geometric Jacobian: maps joint speeds to the twist `[v; ω]` of a point, in the world.
pub type Jacobian<const N: usize> = SMatrix<f64, 6, N>;

fn linear<const N: usize>(jacobian: &Jacobian<N>, i: usize) -> Vector3<f64> {
    jacobian.fixed_view::<3, 1>(0, i).into_owned()
}

fn set<const N: usize>(jacobian: &mut Jacobian<N>, i: usize, v: &Vector3<f64>, w: &Vector3<f64>) {
    jacobian.fixed_view_mut::<3, 1>(0, i).copy_from(v);
    jacobian.fixed_view_mut::<3, 1>(3, i).copy_from(w);
}

impl<const N: usize> Frames<N> {
    /// Jacobian of the point of the last link that is now at `p_w` (world, m).
    #[must_use]
    pub fn jacobian(&self, p_w: &Vector3<f64>) -> Jacobian<N> {
        self.jacobian_on_link(N - 1, p_w)
    }

    /// Jacobian of the point of link `link` (index from 0) that is now at `p_w`; columns of later joints are zero.
    #[must_use]
    pub fn jacobian_on_link(&self, link: usize, p_w: &Vector3<f64>) -> Jacobian<N> {
        let mut jacobian = Jacobian::zeros();
        for i in 0..=link.min(N - 1) {
            let z = self.axis(i);
            set(&mut jacobian, i, &mat3::cross(&z, &(p_w - self.origin(i))), &z);
        }
        jacobian
    }

    /// `∂(J(q) r)/∂q` for constant joint rates `r`: column `k` is the change of the twist with `q_k`.
    ///
    /// `jacobian` is the one of a point of the last link in this configuration; the point moves with the link.
    /// For `q̇ = J⁻¹ V` this gives `δq̇ = J⁻¹ (δV - ∂(J q̇)/∂q δq)`.
    #[must_use]
    pub fn twist_gradient(&self, jacobian: &Jacobian<N>, r: &JointVec<N>) -> Jacobian<N> {
        let mut out = Jacobian::zeros();
        // Sums over the joints after k (twist) and up to k (angular velocity).
        let mut v_after = Vector3::zeros();
        let mut w_after = Vector3::zeros();
        let mut w_upto: Vector3<f64> = (0..N).map(|i| self.axis(i) * r[i]).sum();
        for k in (0..N).rev() {
            let z = self.axis(k);
            let v = linear(jacobian, k);
            set(
                &mut out,
                k,
                &(mat3::cross(&z, &v_after) + mat3::cross(&w_upto, &v)),
                &mat3::cross(&z, &w_after),
            );
            v_after += v * r[k];
            w_after += z * r[k];
            w_upto -= z * r[k];
        }
        out
    }

    /// Time derivative `J̇` of the Jacobian for joint speeds `qd` in rad/s; arguments as in [`Frames::twist_gradient`].
    #[must_use]
    pub fn jacobian_rate(&self, jacobian: &Jacobian<N>, qd: &JointVec<N>) -> Jacobian<N> {
        let mut out = Jacobian::zeros();
        let mut v_from: Vector3<f64> = (0..N).map(|i| linear(jacobian, i) * qd[i]).sum();
        let mut w_before = Vector3::zeros();
        for i in 0..N {
            let z = self.axis(i);
            let v = linear(jacobian, i);
            set(
                &mut out,
                i,
                &(mat3::cross(&w_before, &v) + mat3::cross(&z, &v_from)),
                &mat3::cross(&w_before, &z),
            );
            v_from -= v * qd[i];
            w_before += z * qd[i];
        }
        out
    }

    /// `J̇ q̇`: the acceleration `[a; α]` of the point at zero joint acceleration.
    #[must_use]
    pub fn bias_acceleration(&self, jacobian: &Jacobian<N>, qd: &JointVec<N>) -> Vector6<f64> {
        self.jacobian_rate(jacobian, qd) * qd
    }
}

/// Joint speeds that give the point of `jacobian` the twist `[v; ω]`; `None` at a singularity.
///
/// Six joints: the one solution. More: the one of least norm. Fewer: the one that comes nearest in the sum of squares.
#[must_use]
pub fn joint_rates<const N: usize>(jacobian: &Jacobian<N>, twist: &Vector6<f64>) -> Option<JointVec<N>> {
    if N == 6 {
        let square = SMatrix::<f64, 6, 6>::from_fn(|i, k| jacobian[(i, k)]);
        let rates = Lu::new(&square)?.solve(twist);
        return Some(JointVec::from_fn(|i, _| rates[i]));
    }
    if N > 6 {
        let square = jacobian * jacobian.transpose();
        return Some(jacobian.tr_mul(&Cholesky::new(&square)?.solve(twist)));
    }
    let square: SMatrix<f64, N, N> = jacobian.tr_mul(jacobian);
    Some(Cholesky::new(&square)?.solve(&jacobian.tr_mul(twist)))
}

/// Singular values of a Jacobian, largest first; metres and radians are weighed alike.
///
/// Allocates; for reports, not for inner loops.
#[must_use]
pub fn singular_values<const N: usize>(jacobian: &Jacobian<N>) -> Vec<f64> {
    let mut values: Vec<f64> =
        DMatrix::from_column_slice(6, N, jacobian.as_slice()).singular_values().iter().copied().collect();
    values.sort_by(|a, b| b.total_cmp(a));
    values
}

/// Yoshikawa's manipulability: the product of the singular values (|det J| for six joints); zero at a singularity.
#[must_use]
pub fn manipulability<const N: usize>(jacobian: &Jacobian<N>) -> f64 {
    singular_values(jacobian).iter().product()
}

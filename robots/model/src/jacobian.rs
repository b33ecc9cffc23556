//! Geometric Jacobian of a point on the last link, and its derivatives.
//!
//! With `z_i` the axis of joint `i` and `o_i` a point on it, column `i` is `[v_i; z_i]`, `v_i = z_i × (p - o_i)`.
//! Turning joint `k` turns everything after it, so
//! `∂v_i/∂q_k = z_k × v_i` for `k < i` and `z_i × v_k` for `k ≥ i`; `∂z_i/∂q_k = z_k × z_i` for `k < i`, else 0.

use std::ops::{Index, Mul};

use nalgebra::{DMatrix, Vector3, Vector6};

use crate::kinematics::Frames;
use crate::linalg::{Cholesky, Lu, SquareMatrix};
use crate::mat3;
use crate::per_joint::{JointVec, PerJoint};

/// What one joint adds to the twist of a point, per rad/s.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Column {
    v: Vector3<f64>,
    w: Vector3<f64>,
}

impl Default for Column {
    fn default() -> Self {
        Self { v: Vector3::zeros(), w: Vector3::zeros() }
    }
}

/// Geometric Jacobian: maps joint speeds to the twist `[v; ω]` of a point, in the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Jacobian {
    columns: PerJoint<Column>,
}

impl Jacobian {
    fn zeros(n: usize) -> Self {
        Self { columns: PerJoint::default_of(n) }
    }

    fn set(&mut self, i: usize, v: Vector3<f64>, w: Vector3<f64>) {
        self.columns[i] = Column { v, w };
    }

    /// Number of joints.
    #[must_use]
    #[inline]
    pub fn n(&self) -> usize {
        self.columns.len()
    }

    /// Velocity of the point per speed of joint `k` (index from 0).
    #[must_use]
    #[inline]
    pub fn linear(&self, k: usize) -> Vector3<f64> {
        self.columns[k].v
    }

    /// Angular velocity per speed of joint `k`: its axis.
    #[must_use]
    #[inline]
    pub fn angular(&self, k: usize) -> Vector3<f64> {
        self.columns[k].w
    }

    /// Row `i` of the twist: 0 to 2 of the velocity, 3 to 5 of the angular velocity.
    #[must_use]
    pub fn row(&self, i: usize) -> JointVec {
        JointVec::from_fn(self.n(), |k| self[(i, k)])
    }

    /// Factors of the Jacobian of six joints; `None` at a singularity, and for another number of joints.
    #[must_use]
    pub fn lu(&self) -> Option<Lu> {
        (self.n() == 6).then(|| Lu::new(&SquareMatrix::from_fn(6, |i, k| self[(i, k)])))?
    }

    /// `J Jᵀ`, of six rows.
    #[must_use]
    pub fn times_transposed(&self) -> SquareMatrix {
        let rows: [JointVec; 6] = std::array::from_fn(|i| self.row(i));
        SquareMatrix::from_fn(6, |i, k| rows[i].dot(&rows[k]))
    }

    /// The twist of the point at joint speeds.
    #[inline]
    fn twist(&self, rates: &JointVec) -> Vector6<f64> {
        let (mut v, mut w) = (Vector3::zeros(), Vector3::zeros());
        for (column, rate) in self.columns.iter().zip(rates) {
            v += column.v * *rate;
            w += column.w * *rate;
        }
        Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z)
    }

    /// `Jᵀ` times a wrench or twist.
    #[must_use]
    #[inline]
    pub fn tr_mul(&self, y: &Vector6<f64>) -> JointVec {
        JointVec::from_fn(self.n(), |k| {
            let column = &self.columns[k];
            let linear = (0..3).fold(0.0, |sum, i| sum + column.v[i] * y[i]);
            (0..3).fold(linear, |sum, i| sum + column.w[i] * y[3 + i])
        })
    }
}

impl Index<(usize, usize)> for Jacobian {
    type Output = f64;
    #[inline]
    fn index(&self, (i, k): (usize, usize)) -> &f64 {
        let column = &self.columns[k];
        if i < 3 { &column.v[i] } else { &column.w[i - 3] }
    }
}

impl From<Jacobian> for DMatrix<f64> {
    fn from(jacobian: Jacobian) -> Self {
        Self::from_fn(6, jacobian.n(), |i, k| jacobian[(i, k)])
    }
}

impl Mul<&JointVec> for &Jacobian {
    type Output = Vector6<f64>;
    #[inline]
    fn mul(self, rates: &JointVec) -> Vector6<f64> {
        self.twist(rates)
    }
}

impl Mul<JointVec> for Jacobian {
    type Output = Vector6<f64>;
    #[inline]
    fn mul(self, rates: JointVec) -> Vector6<f64> {
        self.twist(&rates)
    }
}

impl Frames {
    /// Jacobian of the point of the last link that is now at `p_w` (world, m).
    #[must_use]
    pub fn jacobian(&self, p_w: &Vector3<f64>) -> Jacobian {
        self.jacobian_on_link(self.n() - 1, p_w)
    }

    /// Jacobian of the point of link `link` (index from 0) that is now at `p_w`; columns of later joints are zero.
    #[must_use]
    pub fn jacobian_on_link(&self, link: usize, p_w: &Vector3<f64>) -> Jacobian {
        let mut jacobian = Jacobian::zeros(self.n());
        for i in 0..=link.min(self.n() - 1) {
            let z = self.axis(i);
            jacobian.set(i, mat3::cross(&z, &(p_w - self.origin(i))), z);
        }
        jacobian
    }

    /// `∂(J(q) r)/∂q` for constant joint rates `r`: column `k` is the change of the twist with `q_k`.
    ///
    /// `jacobian` is the one of a point of the last link in this configuration; the point moves with the link.
    /// For `q̇ = J⁻¹ V` this gives `δq̇ = J⁻¹ (δV - ∂(J q̇)/∂q δq)`.
    #[must_use]
    pub fn twist_gradient(&self, jacobian: &Jacobian, r: &JointVec) -> Jacobian {
        let n = self.n();
        let mut out = Jacobian::zeros(n);
        // Sums over the joints after k (twist) and up to k (angular velocity).
        let mut v_after = Vector3::zeros();
        let mut w_after = Vector3::zeros();
        let mut w_upto: Vector3<f64> = (0..n).map(|i| self.axis(i) * r[i]).sum();
        for k in (0..n).rev() {
            let z = self.axis(k);
            let v = jacobian.linear(k);
            out.set(k, mat3::cross(&z, &v_after) + mat3::cross(&w_upto, &v), mat3::cross(&z, &w_after));
            v_after += v * r[k];
            w_after += z * r[k];
            w_upto -= z * r[k];
        }
        out
    }

    /// Time derivative `J̇` of the Jacobian for joint speeds `qd` in rad/s; arguments as in [`Frames::twist_gradient`].
    #[must_use]
    pub fn jacobian_rate(&self, jacobian: &Jacobian, qd: &JointVec) -> Jacobian {
        let n = self.n();
        let mut out = Jacobian::zeros(n);
        let mut v_from: Vector3<f64> = (0..n).map(|i| jacobian.linear(i) * qd[i]).sum();
        let mut w_before = Vector3::zeros();
        for i in 0..n {
            let z = self.axis(i);
            let v = jacobian.linear(i);
            out.set(i, mat3::cross(&w_before, &v) + mat3::cross(&z, &v_from), mat3::cross(&w_before, &z));
            v_from -= v * qd[i];
            w_before += z * qd[i];
        }
        out
    }

    /// `J̇ q̇`: the acceleration `[a; α]` of the point at zero joint acceleration.
    #[must_use]
    pub fn bias_acceleration(&self, jacobian: &Jacobian, qd: &JointVec) -> Vector6<f64> {
        &self.jacobian_rate(jacobian, qd) * qd
    }
}

/// Joint speeds that give the point of `jacobian` the twist `[v; ω]`; `None` at a singularity.
///
/// Six joints: the one solution. More: the one of least norm. Fewer: the one with the least sum of squared deviations.
#[must_use]
pub fn joint_rates(jacobian: &Jacobian, twist: &Vector6<f64>) -> Option<JointVec> {
    let n = jacobian.n();
    if n == 6 {
        return Some(jacobian.lu()?.solve(&JointVec::from(*twist)));
    }
    if n > 6 {
        let y = Cholesky::new(&jacobian.times_transposed())?.solve(&JointVec::from(*twist));
        return Some(jacobian.tr_mul(&Vector6::from_column_slice(&y)));
    }
    let square = SquareMatrix::from_fn(n, |i, k| {
        jacobian.linear(i).dot(&jacobian.linear(k)) + jacobian.angular(i).dot(&jacobian.angular(k))
    });
    Some(Cholesky::new(&square)?.solve(&jacobian.tr_mul(twist)))
}

/// Singular values of a Jacobian, largest first; metres and radians have equal weight.
///
/// Allocates; for reports, not for inner loops.
#[must_use]
pub fn singular_values(jacobian: &Jacobian) -> Vec<f64> {
    let mut values: Vec<f64> = DMatrix::from(*jacobian).singular_values().iter().copied().collect();
    values.sort_by(|a, b| b.total_cmp(a));
    values
}

/// Yoshikawa's manipulability: the product of the singular values (|det J| for six joints); zero at a singularity.
#[must_use]
pub fn manipulability(jacobian: &Jacobian) -> f64 {
    singular_values(jacobian).iter().product()
}

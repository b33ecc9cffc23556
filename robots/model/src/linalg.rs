//! Square matrices of at most eight rows, and the small dense solvers that inner loops need, on the stack.

use std::ops::{Index, IndexMut, Mul};

use nalgebra::DMatrix;

use crate::per_joint::{JOINTS_MAX, JointVec, PerJoint};

/// A square matrix of at most [`JOINTS_MAX`] rows.
#[derive(Clone, Copy)]
pub struct SquareMatrix {
    rows: [[f64; JOINTS_MAX]; JOINTS_MAX],
    n: usize,
}

impl SquareMatrix {
    /// Zeros.
    ///
    /// # Panics
    /// With more than [`JOINTS_MAX`] rows.
    #[must_use]
    #[inline]
    pub fn zeros(n: usize) -> Self {
        assert!(n <= JOINTS_MAX, "{n} rows, a square matrix of joints has at most {JOINTS_MAX}");
        Self { rows: [[0.0; JOINTS_MAX]; JOINTS_MAX], n }
    }

    /// Matrix with the entry `of(row, column)`.
    ///
    /// # Panics
    /// With more than [`JOINTS_MAX`] rows.
    #[must_use]
    #[inline]
    pub fn from_fn(n: usize, mut of: impl FnMut(usize, usize) -> f64) -> Self {
        let mut out = Self::zeros(n);
        for i in 0..n {
            for k in 0..n {
                out.rows[i][k] = of(i, k);
            }
        }
        out
    }

    /// A diagonal matrix.
    #[must_use]
    pub fn from_diagonal(diagonal: &JointVec) -> Self {
        Self::from_fn(diagonal.len(), |i, k| if i == k { diagonal[i] } else { 0.0 })
    }

    /// Number of rows, and of columns.
    #[must_use]
    #[inline]
    pub fn n(&self) -> usize {
        self.n.min(JOINTS_MAX)
    }

    /// Row `i`.
    #[must_use]
    #[inline]
    pub fn row(&self, i: usize) -> JointVec {
        PerJoint::padded(self.rows[i], self.n)
    }

    #[inline]
    fn times(&self, vector: &JointVec) -> JointVec {
        JointVec::from_fn(self.n(), |i| self.row(i).dot(vector))
    }

    /// The largest absolute value; 0 without rows.
    #[must_use]
    pub fn amax(&self) -> f64 {
        (0..self.n()).fold(0.0, |most, i| self.row(i).amax().max(most))
    }
}

impl Index<(usize, usize)> for SquareMatrix {
    type Output = f64;
    #[inline]
    fn index(&self, (i, k): (usize, usize)) -> &f64 {
        debug_assert!(i < self.n && k < self.n, "entry ({i}, {k}) of {} rows", self.n);
        &self.rows[i][k]
    }
}

impl IndexMut<(usize, usize)> for SquareMatrix {
    #[inline]
    fn index_mut(&mut self, (i, k): (usize, usize)) -> &mut f64 {
        debug_assert!(i < self.n && k < self.n, "entry ({i}, {k}) of {} rows", self.n);
        &mut self.rows[i][k]
    }
}

impl Mul<&JointVec> for &SquareMatrix {
    type Output = JointVec;
    #[inline]
    fn mul(self, vector: &JointVec) -> JointVec {
        self.times(vector)
    }
}

impl Mul<JointVec> for SquareMatrix {
    type Output = JointVec;
    #[inline]
    fn mul(self, vector: JointVec) -> JointVec {
        self.times(&vector)
    }
}

impl From<SquareMatrix> for DMatrix<f64> {
    fn from(matrix: SquareMatrix) -> Self {
        Self::from_fn(matrix.n(), matrix.n(), |i, k| matrix[(i, k)])
    }
}

/// LU factors of a square matrix, rows permuted for stability.
#[derive(Clone, Copy)]
pub struct Lu {
    factors: SquareMatrix,
    row_of: PerJoint<usize>,
    odd: bool,
}

impl Lu {
    /// Factors `a`; `None` if a pivot vanishes next to the largest entry of `a` (relative 1e-14) or `a` is not finite.
    #[must_use]
    pub fn new(a: &SquareMatrix) -> Option<Self> {
        // The compiler makes a version for six rows, with loops of known length.
        match a.n() {
            6 => Self::of(a, 6),
            n => Self::of(a, n),
        }
    }

    #[inline(always)]
    fn of(a: &SquareMatrix, n: usize) -> Option<Self> {
        let mut m = *a;
        let mut row_of = PerJoint::from_fn(n, |i| i);
        let mut odd = false;
        let tiny = 1e-14 * a.amax();
        let rows = &mut m.rows;
        for k in 0..n {
            let mut pivot = k;
            for i in k + 1..n {
                if rows[i][k].abs() > rows[pivot][k].abs() {
                    pivot = i;
                }
            }
            // Written so that NaN fails too.
            if !(rows[pivot][k].abs() > tiny && rows[pivot][k].is_finite()) {
                return None;
            }
            if pivot != k {
                rows.swap(pivot, k);
                row_of.swap(pivot, k);
                odd = !odd;
            }
            let of_pivot = rows[k];
            let inverse_pivot = 1.0 / of_pivot[k];
            for row in &mut rows[k + 1..n] {
                let l = row[k] * inverse_pivot;
                row[k] = l;
                for j in k + 1..n {
                    row[j] -= l * of_pivot[j];
                }
            }
        }
        Some(Self { factors: m, row_of, odd })
    }

    /// Solution of `A x = b`.
    #[must_use]
    pub fn solve(&self, b: &JointVec) -> JointVec {
        match self.factors.n() {
            6 => self.solved(b, 6),
            n => self.solved(b, n),
        }
    }

    #[inline(always)]
    fn solved(&self, b: &JointVec, n: usize) -> JointVec {
        let rows = &self.factors.rows;
        let mut x = [0.0; JOINTS_MAX];
        for i in 0..n {
            x[i] = b[self.row_of[i]];
        }
        for i in 1..n {
            for j in 0..i {
                x[i] -= rows[i][j] * x[j];
            }
        }
        for i in (0..n).rev() {
            for j in i + 1..n {
                x[i] -= rows[i][j] * x[j];
            }
            x[i] /= rows[i][i];
        }
        JointVec::padded(x, n)
    }

    /// Solution of `Aᵀ x = b`: one of these gives the gradient of a scalar of `A⁻¹ y`.
    #[must_use]
    pub fn solve_transposed(&self, b: &JointVec) -> JointVec {
        let m = &self.factors;
        let n = m.n();
        let mut y = *b;
        for i in 0..n {
            for j in 0..i {
                y[i] -= m[(j, i)] * y[j];
            }
            y[i] /= m[(i, i)];
        }
        for i in (0..n).rev() {
            for j in i + 1..n {
                y[i] -= m[(j, i)] * y[j];
            }
        }
        let mut x = JointVec::zeros(n);
        for i in 0..n {
            x[self.row_of[i]] = y[i];
        }
        x
    }

    /// Determinant of `A`.
    #[must_use]
    pub fn determinant(&self) -> f64 {
        let product: f64 = (0..self.factors.n()).map(|i| self.factors[(i, i)]).product();
        if self.odd { -product } else { product }
    }
}

/// Lower Cholesky factor `L` of a symmetric positive definite matrix `A = L Lᵀ`.
#[derive(Clone, Copy)]
pub struct Cholesky {
    lower: SquareMatrix,
}

impl Cholesky {
    /// Factors `a`, of which only the lower triangle is read; `None` if it is not positive definite.
    #[must_use]
    pub fn new(a: &SquareMatrix) -> Option<Self> {
        let n = a.n();
        let mut l = SquareMatrix::zeros(n);
        for j in 0..n {
            let mut d = a[(j, j)];
            for k in 0..j {
                d -= l[(j, k)] * l[(j, k)];
            }
            // Written so that NaN fails too.
            if !(d > 0.0 && d.is_finite()) {
                return None;
            }
            let root = d.sqrt();
            l[(j, j)] = root;
            for i in j + 1..n {
                let mut v = a[(i, j)];
                for k in 0..j {
                    v -= l[(i, k)] * l[(j, k)];
                }
                l[(i, j)] = v / root;
            }
        }
        Some(Self { lower: l })
    }

    /// Solution of `A x = b`.
    #[must_use]
    pub fn solve(&self, b: &JointVec) -> JointVec {
        let l = &self.lower;
        let n = l.n();
        let mut x = *b;
        for i in 0..n {
            for j in 0..i {
                x[i] -= l[(i, j)] * x[j];
            }
            x[i] /= l[(i, i)];
        }
        for i in (0..n).rev() {
            for j in i + 1..n {
                x[i] -= l[(j, i)] * x[j];
            }
            x[i] /= l[(i, i)];
        }
        x
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix4, Vector4};

    use super::*;

    fn matrix() -> Matrix4<f64> {
        // The zero in the corner makes the pivoting work.
        Matrix4::new(0.0, 2.0, -1.0, 3.0, 4.0, 1.0, 0.5, -2.0, 1.0, -3.0, 2.5, 0.0, -2.0, 0.25, 1.0, 1.5)
    }

    fn padded(a: &Matrix4<f64>) -> SquareMatrix {
        SquareMatrix::from_fn(4, |i, k| a[(i, k)])
    }

    fn plain(x: &JointVec) -> Vector4<f64> {
        Vector4::from_column_slice(x)
    }

    const B: [f64; 4] = [1.0, -2.0, 0.5, 3.0];

    #[test]
    fn lu_solves_and_knows_the_determinant() {
        let a = matrix();
        let lu = Lu::new(&padded(&a)).expect("regular");
        let b = Vector4::from(B);
        assert!((a * plain(&lu.solve(&B.into())) - b).amax() < 1e-14);
        assert!((a.transpose() * plain(&lu.solve_transposed(&B.into())) - b).amax() < 1e-14);
        assert!((lu.determinant() - a.determinant()).abs() < 1e-13);
    }

    #[test]
    fn lu_refuses_singular_and_nan() {
        let mut a = matrix();
        a.set_row(3, &(a.row(0) * 2.0));
        assert!(Lu::new(&padded(&a)).is_none());
        a[(1, 1)] = f64::NAN;
        assert!(Lu::new(&padded(&a)).is_none());
    }

    #[test]
    fn cholesky_solves_and_refuses_indefinite() {
        let a = matrix();
        let spd = a * a.transpose();
        let x = Cholesky::new(&padded(&spd)).expect("positive definite").solve(&B.into());
        assert!((spd * plain(&x) - Vector4::from(B)).amax() < 1e-12);
        assert!(Cholesky::new(&padded(&(spd - Matrix4::identity() * 10.0))).is_none());
    }
}

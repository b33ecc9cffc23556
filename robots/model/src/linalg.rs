//! Vectors with one entry per joint, and small dense solvers with the size in the type, on the stack.
//!
//! nalgebra's decompositions are bounded by traits that a const parameter `N` does not satisfy, so the two that the
//! inner loops need are here: LU with partial pivoting and Cholesky.

use nalgebra::{SMatrix, SVector};

/// One number per joint.
pub type JointVec<const N: usize> = SVector<f64, N>;

/// LU factors of a square matrix, rows permuted for stability.
#[derive(Debug, Clone, Copy)]
pub struct Lu<const N: usize> {
    factors: SMatrix<f64, N, N>,
    row_of: [usize; N],
    odd: bool,
}

impl<const N: usize> Lu<N> {
    /// Factors `a`; `None` if a pivot vanishes next to the largest entry of `a` (relative 1e-14) or `a` is not finite.
    #[must_use]
    pub fn new(a: &SMatrix<f64, N, N>) -> Option<Self> {
        let mut m = *a;
        let mut row_of: [usize; N] = std::array::from_fn(|i| i);
        let mut odd = false;
        let tiny = 1e-14 * a.amax();
        for k in 0..N {
            let mut pivot = k;
            for i in k + 1..N {
                if m[(i, k)].abs() > m[(pivot, k)].abs() {
                    pivot = i;
                }
            }
            // Written so that NaN fails too.
            if !(m[(pivot, k)].abs() > tiny && m[(pivot, k)].is_finite()) {
                return None;
            }
            if pivot != k {
                m.swap_rows(pivot, k);
                row_of.swap(pivot, k);
                odd = !odd;
            }
            let inverse_pivot = 1.0 / m[(k, k)];
            for i in k + 1..N {
                let l = m[(i, k)] * inverse_pivot;
                m[(i, k)] = l;
                for j in k + 1..N {
                    m[(i, j)] -= l * m[(k, j)];
                }
            }
        }
        Some(Self { factors: m, row_of, odd })
    }

    /// Solution of `A x = b`.
    #[must_use]
    pub fn solve(&self, b: &SVector<f64, N>) -> SVector<f64, N> {
        let m = &self.factors;
        let mut x = SVector::<f64, N>::from_fn(|i, _| b[self.row_of[i]]);
        for i in 1..N {
            for j in 0..i {
                x[i] -= m[(i, j)] * x[j];
            }
        }
        for i in (0..N).rev() {
            for j in i + 1..N {
                x[i] -= m[(i, j)] * x[j];
            }
            x[i] /= m[(i, i)];
        }
        x
    }

    /// Solution of `Aᵀ x = b`: one of these gives the gradient of a scalar of `A⁻¹ y`.
    #[must_use]
    pub fn solve_transposed(&self, b: &SVector<f64, N>) -> SVector<f64, N> {
        let m = &self.factors;
        let mut y = *b;
        for i in 0..N {
            for j in 0..i {
                y[i] -= m[(j, i)] * y[j];
            }
            y[i] /= m[(i, i)];
        }
        for i in (0..N).rev() {
            for j in i + 1..N {
                y[i] -= m[(j, i)] * y[j];
            }
        }
        let mut x = SVector::zeros();
        for i in 0..N {
            x[self.row_of[i]] = y[i];
        }
        x
    }

    /// Determinant of `A`.
    #[must_use]
    pub fn determinant(&self) -> f64 {
        let product: f64 = (0..N).map(|i| self.factors[(i, i)]).product();
        if self.odd { -product } else { product }
    }
}

/// Lower Cholesky factor `L` of a symmetric positive definite matrix `A = L Lᵀ`.
#[derive(Debug, Clone, Copy)]
pub struct Cholesky<const N: usize> {
    lower: SMatrix<f64, N, N>,
}

impl<const N: usize> Cholesky<N> {
    /// Factors `a`, of which only the lower triangle is read; `None` if it is not positive definite.
    #[must_use]
    pub fn new(a: &SMatrix<f64, N, N>) -> Option<Self> {
        let mut l = SMatrix::<f64, N, N>::zeros();
        for j in 0..N {
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
            for i in j + 1..N {
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
    pub fn solve(&self, b: &SVector<f64, N>) -> SVector<f64, N> {
        let l = &self.lower;
        let mut x = *b;
        for i in 0..N {
            for j in 0..i {
                x[i] -= l[(i, j)] * x[j];
            }
            x[i] /= l[(i, i)];
        }
        for i in (0..N).rev() {
            for j in i + 1..N {
                x[i] -= l[(j, i)] * x[j];
            }
            x[i] /= l[(i, i)];
        }
        x
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix4, Vector4};

    fn matrix() -> Matrix4<f64> {
        // The zero in the corner makes the pivoting work.
        Matrix4::new(0.0, 2.0, -1.0, 3.0, 4.0, 1.0, 0.5, -2.0, 1.0, -3.0, 2.5, 0.0, -2.0, 0.25, 1.0, 1.5)
    }

    #[test]
    fn lu_solves_and_knows_the_determinant() {
        let a = matrix();
        let lu = Lu::new(&a).expect("regular");
        let b = Vector4::new(1.0, -2.0, 0.5, 3.0);
        assert!((a * lu.solve(&b) - b).amax() < 1e-14);
        assert!((a.transpose() * lu.solve_transposed(&b) - b).amax() < 1e-14);
        assert!((lu.determinant() - a.determinant()).abs() < 1e-13);
    }

    #[test]
    fn lu_refuses_singular_and_nan() {
        let mut a = matrix();
        a.set_row(3, &(a.row(0) * 2.0));
        assert!(Lu::new(&a).is_none());
        a[(1, 1)] = f64::NAN;
        assert!(Lu::new(&a).is_none());
    }

    #[test]
    fn cholesky_solves_and_refuses_indefinite() {
        let a = matrix();
        let spd = a * a.transpose();
        let b = Vector4::new(1.0, -2.0, 0.5, 3.0);
        let x = Cholesky::new(&spd).expect("positive definite").solve(&b);
        assert!((spd * x - b).amax() < 1e-12);
        assert!(Cholesky::new(&(spd - Matrix4::identity() * 10.0)).is_none());
    }
}

//! Level 2 and 3 routines: op(X) is X or X' as BLAS names it.

use crate::memory::{View, ViewMut};
use nalgebra::{DMatrix, DVector};

/// `uplo`: which triangle of a symmetric matrix is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Triangle {
    Upper,
    Lower,
}

impl Triangle {
    pub(crate) fn parse(flag: u8) -> Option<Self> {
        match flag {
            b'U' => Some(Self::Upper),
            b'L' => Some(Self::Lower),
            _ => None,
        }
    }

    /// Rows of column `j` that are stored, in an n x n matrix.
    fn rows(self, j: usize, n: usize) -> core::ops::Range<usize> {
        match self {
            Self::Upper => 0..j + 1,
            Self::Lower => j..n,
        }
    }
}

/// `trans`: `Some(true)` for a transposed operand; the conjugate is the transpose for reals.
pub(crate) fn transposed(flag: u8) -> Option<bool> {
    match flag {
        b'N' => Some(false),
        b'T' | b'C' => Some(true),
        _ => None,
    }
}

/// The full symmetric matrix behind a stored triangle.
pub(crate) fn symmetric(uplo: Triangle, a: &View<'_>) -> DMatrix<f64> {
    DMatrix::from_fn(a.nrows(), a.ncols(), |i, j| match uplo {
        Triangle::Upper => a[(i.min(j), i.max(j))],
        Triangle::Lower => a[(i.max(j), i.min(j))],
    })
}

/// `beta c` with the BLAS rule that `beta = 0` does not read `c` (it may hold NaN).
fn scaled(beta: f64, c: f64) -> f64 {
    if beta == 0.0 { 0.0 } else { beta * c }
}

/// C = alpha op(A) op(B) + beta C.
pub(crate) fn gemm(
    (ta, tb): (bool, bool),
    alpha: f64,
    (a, b): (&View<'_>, &View<'_>),
    beta: f64,
    c: &mut ViewMut<'_>,
) {
    c.apply(|x| *x = scaled(beta, *x));
    let k = if ta { a.nrows() } else { a.ncols() };
    if alpha == 0.0 || k == 0 {
        return;
    }
    match (ta, tb) {
        (false, false) => c.gemm(alpha, a, b, 1.0),
        (true, false) => c.gemm_tr(alpha, a, b, 1.0),
        (false, true) => c.gemm(alpha, a, &b.transpose(), 1.0),
        (true, true) => c.gemm_tr(alpha, a, &b.transpose(), 1.0),
    }
}

/// y = alpha op(A) x + beta y.
pub(crate) fn gemv(ta: bool, alpha: f64, a: &View<'_>, x: &DVector<f64>, beta: f64, y: &mut DVector<f64>) {
    y.apply(|v| *v = scaled(beta, *v));
    if alpha == 0.0 || x.is_empty() {
        return;
    }
    if ta {
        y.gemv_tr(alpha, a, x, 1.0);
    } else {
        y.gemv(alpha, a, x, 1.0);
    }
}

/// y = alpha A x + beta y, A symmetric.
pub(crate) fn symv(
    uplo: Triangle,
    alpha: f64,
    a: &View<'_>,
    x: &DVector<f64>,
    beta: f64,
    y: &mut DVector<f64>,
) {
    y.apply(|v| *v = scaled(beta, *v));
    if alpha != 0.0 {
        y.gemv(alpha, &symmetric(uplo, a), x, 1.0);
    }
}

/// Adds `alpha m` to the stored triangle of `beta C`; the other triangle is left alone.
fn update_triangle(uplo: Triangle, alpha: f64, m: &DMatrix<f64>, beta: f64, c: &mut ViewMut<'_>) {
    let n = c.ncols();
    for j in 0..n {
        for i in uplo.rows(j, n) {
            c[(i, j)] = scaled(beta, c[(i, j)]) + if alpha == 0.0 { 0.0 } else { alpha * m[(i, j)] };
        }
    }
}

/// C = alpha op(A) op(A)' + beta C on one triangle.
pub(crate) fn syrk(uplo: Triangle, ta: bool, alpha: f64, a: &View<'_>, beta: f64, c: &mut ViewMut<'_>) {
    let m = if ta { a.tr_mul(a) } else { a * a.transpose() };
    update_triangle(uplo, alpha, &m, beta, c);
}

/// C = alpha (op(A) op(B)' + op(B) op(A)') + beta C on one triangle.
pub(crate) fn syr2k(
    uplo: Triangle,
    ta: bool,
    alpha: f64,
    (a, b): (&View<'_>, &View<'_>),
    beta: f64,
    c: &mut ViewMut<'_>,
) {
    let half = if ta { a.tr_mul(b) } else { a * b.transpose() };
    let m = &half + half.transpose();
    update_triangle(uplo, alpha, &m, beta, c);
}

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
    let k = if ta { a.nrows() } else { a.ncols() };
    if alpha != 0.0
        && let Some(product) = Product::of((ta, a), (tb, b))
    {
        for j in 0..c.ncols() {
            for (i, x) in c.column_mut(j).as_mut_slice().iter_mut().enumerate() {
                *x = scaled(beta, *x) + alpha * product.at(i, j);
            }
        }
        return;
    }
    c.apply(|x| *x = scaled(beta, *x));
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
fn update_triangle(
    uplo: Triangle,
    alpha: f64,
    m: impl Fn(usize, usize) -> f64,
    beta: f64,
    c: &mut ViewMut<'_>,
) {
    let n = c.ncols();
    for j in 0..n {
        for i in uplo.rows(j, n) {
            c[(i, j)] = scaled(beta, c[(i, j)]) + if alpha == 0.0 { 0.0 } else { alpha * m(i, j) };
        }
    }
}

/// C = alpha op(A) op(A)' + beta C on one triangle.
pub(crate) fn syrk(uplo: Triangle, ta: bool, alpha: f64, a: &View<'_>, beta: f64, c: &mut ViewMut<'_>) {
    if let Some(m) = Product::of((ta, a), (!ta, a)) {
        return update_triangle(uplo, alpha, |i, j| m.at(i, j), beta, c);
    }
    let m = if ta { a.tr_mul(a) } else { a * a.transpose() };
    update_triangle(uplo, alpha, |i, j| m[(i, j)], beta, c);
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
    if let Some(m) = Product::of((ta, a), (!ta, b)) {
        return update_triangle(uplo, alpha, |i, j| m.at(i, j) + m.at(j, i), beta, c);
    }
    let half = if ta { a.tr_mul(b) } else { a * b.transpose() };
    update_triangle(uplo, alpha, |i, j| half[(i, j)] + half[(j, i)], beta, c);
}

/// A product of matrices that are small enough to be multiplied on the stack.
///
/// The blocks of the gain designs have 2 to 7 rows. For these a general product spends most of its time on packing and
/// allocation; loops of a known length need neither, and the compiler turns them into vector instructions.
#[expect(clippy::large_enum_variant, reason = "lives for one call; a box would be the allocation it saves")]
enum Product {
    Four(Tile<4>),
    Eight(Tile<8>),
}

impl Product {
    /// op(A) op(B); `None` if one of them is too large.
    #[inline]
    fn of(a: (bool, &View<'_>), b: (bool, &View<'_>)) -> Option<Self> {
        let side = [a, b].iter().map(|(_, m)| m.nrows().max(m.ncols())).fold(0, usize::max);
        match side {
            0..=4 => Some(Self::Four(Tile::product(a, b))),
            5..=8 => Some(Self::Eight(Tile::product(a, b))),
            _ => None,
        }
    }

    fn at(&self, i: usize, j: usize) -> f64 {
        match self {
            Self::Four(tile) => tile.0[j][i],
            Self::Eight(tile) => tile.0[j][i],
        }
    }
}

/// A matrix of at most `SIDE` rows and columns, by columns, filled up with zeros.
struct Tile<const SIDE: usize>([[f64; SIDE]; SIDE]);

impl<const SIDE: usize> Tile<SIDE> {
    /// op(A).
    #[inline]
    fn of((transposed, a): (bool, &View<'_>)) -> Self {
        let mut tile = [[0.0; SIDE]; SIDE];
        for (j, column) in a.column_iter().enumerate() {
            for (i, x) in column.as_slice().iter().enumerate() {
                if transposed {
                    tile[i][j] = *x;
                } else {
                    tile[j][i] = *x;
                }
            }
        }
        Self(tile)
    }

    /// op(A) op(B).
    #[inline]
    fn product(a: (bool, &View<'_>), b: (bool, &View<'_>)) -> Self {
        let (left, right) = (Self::of(a), Self::of(b));
        let depth = if a.0 { a.1.nrows() } else { a.1.ncols() };
        let columns = if b.0 { b.1.nrows() } else { b.1.ncols() };
        let mut product = [[0.0; SIDE]; SIDE];
        for (out, weights) in product.iter_mut().zip(&right.0).take(columns) {
            // Only the common side: what lies beyond it is zero, and zero times infinity is not.
            for (column, weight) in left.0.iter().zip(weights).take(depth) {
                for (sum, x) in out.iter_mut().zip(column) {
                    *sum += x * weight;
                }
            }
        }
        Self(product)
    }
}

//! Definiteness with a bound on every rounding error: the base of the certificate check.
//!
//! If floating-point Cholesky runs to completion on A - c I, with c at least the backward error of
//! the factorisation, then A is positive definite (S. M. Rump, "Verification of positive
//! definiteness", BIT 46, 2006). The bound used here is (n + 1) u / (1 - (n + 1) u) tr A, doubled.

use nalgebra::allocator::Allocator;
use nalgebra::{Cholesky, DefaultAllocator, Dim, OMatrix};

/// Unit roundoff of binary64.
const UNIT_ROUNDOFF: f64 = f64::EPSILON / 2.0;

/// A lower bound of the smallest eigenvalue of every symmetric matrix within `entry_error`
/// (absolute, per entry) of `a`; may be negative; NaN or infinities give minus infinity.
///
/// Proven by a Cholesky run, not by an eigenvalue routine: a bisection looks for the largest shift
/// whose run completes, and only completed runs count.
pub(super) fn min_eigenvalue_bound<D: Dim>(a: &OMatrix<f64, D, D>, entry_error: f64) -> f64
where
    DefaultAllocator: Allocator<D, D>,
{
    min_eigenvalue_bound_below(f64::INFINITY, a, entry_error)
}

/// As [`min_eigenvalue_bound`], but at most `ceiling`: for the worst of many matrices, of which most
/// need a single Cholesky run.
pub(super) fn min_eigenvalue_bound_below<D: Dim>(
    ceiling: f64,
    a: &OMatrix<f64, D, D>,
    entry_error: f64,
) -> f64
where
    DefaultAllocator: Allocator<D, D>,
{
    let n = a.nrows();
    if n == 0 || a.iter().any(|x| !x.is_finite()) || entry_error.is_nan() || entry_error < 0.0 {
        return f64::NEG_INFINITY;
    }
    // A matrix of entries at most e has spectral norm at most n e. The symmetric part costs one rounding.
    let asymmetry = (a - a.transpose()).amax();
    let perturbation = n as f64 * (entry_error + asymmetry);
    let symmetric = (a + a.transpose()) * 0.5;
    if ceiling.is_finite() && provably_above(&symmetric, ceiling + perturbation) {
        return ceiling;
    }
    let top = (0..n).map(|i| symmetric[(i, i)]).fold(f64::INFINITY, f64::min);
    let (mut low, mut high) = (-(n as f64) * symmetric.amax() - 1.0, top);
    // Largest provable shift: 60 halvings reach the resolution of the numbers themselves.
    for _ in 0..60 {
        let shift = 0.5 * (low + high);
        if provably_above(&symmetric, shift) {
            low = shift;
        } else {
            high = shift;
        }
    }
    (low - perturbation).min(ceiling)
}

/// Whether every eigenvalue of the symmetric `a` is proven to exceed `shift`.
fn provably_above<D: Dim>(a: &OMatrix<f64, D, D>, shift: f64) -> bool
where
    DefaultAllocator: Allocator<D, D>,
{
    let n = a.nrows();
    let trace: f64 = (0..n).map(|i| (a[(i, i)] - shift).abs()).sum();
    let k = (n + 1) as f64 * UNIT_ROUNDOFF;
    let backward_error = 2.0 * k / (1.0 - k) * trace + f64::MIN_POSITIVE;
    // The subtraction of the shift rounds too: one unit of each diagonal entry.
    let subtraction = 2.0 * UNIT_ROUNDOFF * (a.amax() + shift.abs());
    let mut shifted = a.clone();
    for i in 0..n {
        shifted[(i, i)] -= shift + backward_error + subtraction;
    }
    Cholesky::new(shifted).is_some()
}

/// Entrywise bound of the rounding error of the product x y computed in f64, plus what errors
/// `ex`, `ey` (per entry) of its factors contribute.
pub(super) fn product_error<R: Dim, K: Dim, C: Dim>(
    (x, ex): (&OMatrix<f64, R, K>, f64),
    (y, ey): (&OMatrix<f64, K, C>, f64),
) -> f64
where
    DefaultAllocator: Allocator<R, K> + Allocator<K, C>,
{
    let k = x.ncols() as f64;
    let (mx, my) = (x.amax(), y.amax());
    k * (mx * ey + my * ex + ex * ey) + 2.0 * k * k * UNIT_ROUNDOFF * mx * my
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DMatrix;
    use proptest::prelude::*;

    /// Integer matrices have exact determinants: the Hilbert-like worst case is checked against them.
    #[test]
    fn nearly_singular_matrices_are_not_called_definite() {
        // det = 1 - (1 - 2^-54)^2 < 0 in exact arithmetic, invisible to a naive Cholesky.
        let a = DMatrix::from_row_slice(2, 2, &[1.0 - f64::EPSILON / 2.0, 1.0, 1.0, 1.0]);
        assert!(min_eigenvalue_bound(&a, 0.0) <= 0.0);
        assert!(min_eigenvalue_bound(&DMatrix::identity(3, 3), 0.0) > 0.999_999);
        assert!(min_eigenvalue_bound(&DMatrix::identity(3, 3), 0.5) < 0.0);
    }

    #[test]
    fn lost_numbers_prove_nothing() {
        let a = DMatrix::from_element(2, 2, f64::NAN);
        assert_eq!(min_eigenvalue_bound(&a, 0.0), f64::NEG_INFINITY);
        assert_eq!(min_eigenvalue_bound(&DMatrix::identity(2, 2), f64::NAN), f64::NEG_INFINITY);
    }

    proptest! {
        #[test]
        fn bound_is_below_the_true_value_and_close_to_it(seed in prop::collection::vec(-1.0f64..1.0, 36), low in -1.0f64..1.0) {
            // Q D Q' with known spectrum; Q from a QR factor.
            let q = DMatrix::from_vec(6, 6, seed).qr().q();
            let d = DMatrix::from_fn(6, 6, |i, j| if i == j { low + i as f64 } else { 0.0 });
            let a = &q * d * q.transpose();
            let bound = min_eigenvalue_bound(&a, 0.0);
            prop_assert!(bound <= low + 1e-14);
            prop_assert!(bound >= low - 1e-12);
        }
    }
}

//! Factorisations. Each returns the LAPACK `info` it would report as `Err(info)`.

use crate::blas::{Triangle, symmetric};
use crate::memory::{View, ViewMut};
use nalgebra::{DMatrix, DVector, SymmetricEigen, SymmetricTridiagonal};

/// Sweeps after which an iteration counts as not converging (LAPACK allows 30 per eigenvalue).
const MAX_SWEEPS_PER_VALUE: usize = 60;
/// From here on zeta^2 + 1 is zeta^2 in f64.
const ZETA_LARGE: f64 = 1e9;

/// Cholesky factor in place: A = U'U or L L' on the stored triangle.
///
/// `Err(i)`: the leading minor of order i is not positive definite.
pub(crate) fn potrf(uplo: Triangle, a: &mut ViewMut<'_>) -> Result<(), i32> {
    let n = a.ncols();
    // The recurrence below walks the lower factor; the upper one is its transpose in storage.
    let place = |i: usize, j: usize| if uplo == Triangle::Lower { (i, j) } else { (j, i) };
    for j in 0..n {
        let pivot = a[(j, j)] - (0..j).map(|k| a[place(j, k)] * a[place(j, k)]).sum::<f64>();
        // Negated so that NaN counts as not positive definite.
        if !(pivot > 0.0 && pivot.is_finite()) {
            return Err(j as i32 + 1);
        }
        let l_jj = pivot.sqrt();
        a[(j, j)] = l_jj;
        for i in j + 1..n {
            let dot: f64 = (0..j).map(|k| a[place(i, k)] * a[place(j, k)]).sum();
            a[place(i, j)] = (a[place(i, j)] - dot) / l_jj;
        }
    }
    Ok(())
}

/// Solves A X = B in place from the factor of [`potrf`].
pub(crate) fn potrs(uplo: Triangle, a: &View<'_>, b: &mut ViewMut<'_>) {
    if b.is_empty() {
        return;
    }
    match uplo {
        Triangle::Lower => {
            a.solve_lower_triangular_mut(b);
            a.tr_solve_lower_triangular_mut(b);
        }
        Triangle::Upper => {
            a.tr_solve_upper_triangular_mut(b);
            a.solve_upper_triangular_mut(b);
        }
    }
}

/// Solves A X = B by LU with partial pivoting; A becomes its factors, `ipiv` the row exchanges (1-based).
///
/// `Err(i)`: U(i, i) is exactly zero; B is untouched then.
pub(crate) fn gesv(a: &mut ViewMut<'_>, ipiv: &mut [i32], b: &mut ViewMut<'_>) -> Result<(), i32> {
    let n = a.ncols();
    let mut first_zero = None;
    for j in 0..n {
        let p = (j..n).fold(j, |best, i| if a[(i, j)].abs() > a[(best, j)].abs() { i } else { best });
        ipiv[j] = p as i32 + 1;
        if a[(p, j)] == 0.0 {
            first_zero.get_or_insert(j as i32 + 1);
            continue;
        }
        a.swap_rows(j, p);
        for i in j + 1..n {
            let factor = a[(i, j)] / a[(j, j)];
            a[(i, j)] = factor;
            for k in j + 1..n {
                a[(i, k)] -= factor * a[(j, k)];
            }
        }
    }
    if let Some(info) = first_zero {
        return Err(info);
    }
    if b.is_empty() {
        return Ok(());
    }
    for (j, &p) in ipiv.iter().enumerate().take(n) {
        b.swap_rows(j, p as usize - 1);
    }
    let factors = a.as_view::<nalgebra::Dyn, nalgebra::Dyn, nalgebra::U1, nalgebra::Dyn>();
    factors.solve_lower_triangular_with_diag_mut(b, 1.0);
    factors.solve_upper_triangular_mut(b);
    Ok(())
}

/// The full matrix at unit scale, which the deflation tests of the iterations ask for (they square entries), and
/// the scale; scale 0 is the zero matrix.
///
/// `Err(1)`: the matrix is not finite.
fn unit_scale(uplo: Triangle, a: &View<'_>) -> Result<(DMatrix<f64>, f64), i32> {
    let mut full = symmetric(uplo, a);
    if full.iter().any(|x| !x.is_finite()) {
        return Err(1);
    }
    let scale = full.amax();
    if scale > 0.0 {
        full /= scale;
    }
    Ok((full, scale))
}

/// Eigenvalues in ascending order and the matching eigenvectors as columns.
///
/// `Err(1)`: no convergence, or the matrix is not finite.
pub(crate) fn syev(uplo: Triangle, a: &View<'_>) -> Result<(DVector<f64>, DMatrix<f64>), i32> {
    let (full, scale) = unit_scale(uplo, a)?;
    let n = full.nrows();
    if scale == 0.0 {
        return Ok((DVector::zeros(n), DMatrix::identity(n, n)));
    }
    let eigen = SymmetricEigen::try_new(full, f64::EPSILON, MAX_SWEEPS_PER_VALUE * n).ok_or(1)?;
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|&i, &j| eigen.eigenvalues[i].total_cmp(&eigen.eigenvalues[j]));
    let values = DVector::from_fn(n, |i, _| eigen.eigenvalues[order[i]] * scale);
    let vectors = DMatrix::from_fn(n, n, |r, c| eigen.eigenvectors[(r, order[c])]);
    Ok((values, vectors))
}

/// Eigenvalues alone, in ascending order: the solver asks for those of every block four times a step.
///
/// `Err(1)`: no convergence, or the matrix is not finite.
pub(crate) fn syev_values(uplo: Triangle, a: &View<'_>) -> Result<DVector<f64>, i32> {
    let (full, scale) = unit_scale(uplo, a)?;
    let n = full.nrows();
    if scale == 0.0 {
        return Ok(DVector::zeros(n));
    }
    let (mut d, mut e) = SymmetricTridiagonal::new(full).unpack_tridiagonal();
    diagonalise(d.as_mut_slice(), e.as_mut_slice())?;
    d.as_mut_slice().sort_by(f64::total_cmp);
    Ok(d * scale)
}

/// Turns the symmetric tridiagonal matrix of diagonal `d` and off-diagonal `e` into a diagonal one of the same
/// eigenvalues.
///
/// `Err(1)`: no convergence.
fn diagonalise(d: &mut [f64], e: &mut [f64]) -> Result<(), i32> {
    let mut end = d.len();
    let negligible =
        |d: &[f64], e: &[f64], i: usize| e[i].abs() <= f64::EPSILON * (d[i].abs() + d[i + 1].abs());
    for _ in 0..=MAX_SWEEPS_PER_VALUE * d.len() {
        while end > 1 && negligible(d, e, end - 2) {
            end -= 1;
        }
        if end <= 1 {
            return Ok(());
        }
        let start = (0..end - 1).rev().find(|&i| negligible(d, e, i)).map_or(0, |i| i + 1);
        qr_step(&mut d[start..end], &mut e[start..end - 1]);
    }
    Err(1)
}

/// One implicit QR step with Wilkinson's shift (G. Golub, C. Van Loan, "Matrix Computations", 2013, section 8.3.5);
/// at least two rows.
fn qr_step(d: &mut [f64], e: &mut [f64]) {
    let n = d.len();
    // The eigenvalue of the last two rows that is nearer to the last entry.
    let (half, b) = (0.5 * (d[n - 2] - d[n - 1]), e[n - 2]);
    let mu = d[n - 1] - b * b / (half + half.hypot(b).copysign(half));
    let (mut x, mut z) = (d[0] - mu, e[0]);
    for k in 0..n - 1 {
        // The rotation of rows and columns k, k + 1 that takes (x, z) to (r, 0).
        let r = (x * x + z * z).sqrt();
        let (c, s) = if r > 0.0 { (x / r, z / r) } else { (1.0, 0.0) };
        if k > 0 {
            e[k - 1] = r;
        }
        let (p, q, t) = (d[k], d[k + 1], e[k]);
        let (cc, ss, cs) = (c * c, s * s, c * s);
        d[k] = cc * p + ss * q + 2.0 * cs * t;
        d[k + 1] = ss * p + cc * q - 2.0 * cs * t;
        e[k] = cs * (q - p) + (cc - ss) * t;
        if k + 2 < n {
            x = e[k];
            z = s * e[k + 1];
            e[k + 1] *= c;
        }
    }
}

/// U, s, V'.
pub(crate) type ThinSvd = (DMatrix<f64>, DVector<f64>, DMatrix<f64>);

/// Thin singular value decomposition: U (m x r), descending s (r), V' (r x n), r = min(m, n).
///
/// One-sided Jacobi (Hestenes): rotates pairs of columns until all are orthogonal. It keeps U and V
/// orthogonal to rounding on graded and rank-deficient matrices, which the scaling of a nearly
/// solved semidefinite cone is; nalgebra's bidiagonal iteration failed the graded cases of the tests.
///
/// `Err(1)`: no convergence, or the matrix is not finite.
pub(crate) fn svd(a: &View<'_>) -> Result<ThinSvd, i32> {
    if a.iter().any(|x| !x.is_finite()) {
        return Err(1);
    }
    if a.nrows() >= a.ncols() {
        tall_svd(a.clone_owned())
    } else {
        let (v, s, u_t) = tall_svd(a.transpose())?;
        Ok((u_t.transpose(), s, v.transpose()))
    }
}

/// [`svd`] of an m x n matrix with m >= n.
fn tall_svd(mut w: DMatrix<f64>) -> Result<ThinSvd, i32> {
    let (m, n) = w.shape();
    let scale = if n == 0 { 0.0 } else { w.amax() };
    if scale == 0.0 {
        return Ok((DMatrix::identity(m, n), DVector::zeros(n), DMatrix::identity(n, n)));
    }
    w /= scale;
    let mut v = DMatrix::<f64>::identity(n, n);
    let mut converged = false;
    for _ in 0..MAX_SWEEPS_PER_VALUE {
        converged = true;
        for p in 0..n {
            for q in p + 1..n {
                let (pp, qq, pq) = products(columns(&mut w, (p, q)));
                if pq.abs() <= f64::EPSILON * (m as f64) * (pp * qq).sqrt() || pq.abs() < f64::MIN_POSITIVE {
                    continue;
                }
                converged = false;
                // The smaller root of t^2 + 2 zeta t - 1 = 0 makes the rotated pair orthogonal.
                let zeta = (qq - pp) / (2.0 * pq);
                let root = if zeta.abs() < ZETA_LARGE { (zeta * zeta + 1.0).sqrt() } else { zeta.abs() };
                let t = zeta.signum() / (zeta.abs() + root);
                let c = 1.0 / (t * t + 1.0).sqrt();
                rotate(columns(&mut w, (p, q)), (c, c * t));
                rotate(columns(&mut v, (p, q)), (c, c * t));
            }
        }
        if converged {
            break;
        }
    }
    if !converged {
        return Err(1);
    }
    let norms: Vec<f64> = (0..n).map(|j| w.column(j).norm()).collect();
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|&i, &j| norms[j].total_cmp(&norms[i]));
    let mut u = DMatrix::zeros(m, n);
    for (k, &j) in order.iter().enumerate() {
        // Below this the squared norms above have underflowed and the direction means nothing.
        if norms[j] > 1e-150 {
            u.set_column(k, &(w.column(j) / norms[j]));
        } else {
            complete(&mut u, k);
        }
    }
    let s = DVector::from_fn(n, |k, _| norms[order[k]] * scale);
    let v_t = DMatrix::from_fn(n, n, |k, i| v[(i, order[k])]);
    Ok((u, s, v_t))
}

/// Columns `p` < `q`.
fn columns(m: &mut DMatrix<f64>, (p, q): (usize, usize)) -> (&mut [f64], &mut [f64]) {
    let rows = m.nrows();
    let (left, right) = m.as_mut_slice().split_at_mut(q * rows);
    (&mut left[p * rows..(p + 1) * rows], &mut right[..rows])
}

/// p'p, q'q, p'q.
fn products((p, q): (&mut [f64], &mut [f64])) -> (f64, f64, f64) {
    p.iter().zip(q.iter()).fold((0.0, 0.0, 0.0), |(pp, qq, pq), (x, y)| (pp + x * x, qq + y * y, pq + x * y))
}

/// The pair of columns times the rotation [[c, s], [-s, c]].
fn rotate((p, q): (&mut [f64], &mut [f64]), (c, s): (f64, f64)) {
    for (x, y) in p.iter_mut().zip(q) {
        (*x, *y) = (c * *x - s * *y, s * *x + c * *y);
    }
}

/// Sets column `k` to a unit vector orthogonal to the columns before it (k < number of rows).
fn complete(u: &mut DMatrix<f64>, k: usize) {
    let mut best = DVector::zeros(u.nrows());
    let mut best_norm = -1.0;
    for axis in 0..u.nrows() {
        let mut e = DVector::zeros(u.nrows());
        e[axis] = 1.0;
        for _ in 0..2 {
            for j in 0..k {
                let dot = u.column(j).dot(&e);
                e.axpy(-dot, &u.column(j), 1.0);
            }
        }
        let norm = e.norm();
        if norm > best_norm {
            (best, best_norm) = (e / norm, norm);
        }
    }
    u.set_column(k, &best);
}

//! Level 2 and 3 symbols.

use crate::blas::{self, Triangle, transposed};
use crate::memory::{flag, gather, int, real, scatter, shape_ok, view, view_mut};
use core::ffi::{c_char, c_int};

/// C = alpha op(A) op(B) + beta C.
///
/// # Safety
/// Module contract; `c` is the output.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgemm_(
    transa: *const c_char,
    transb: *const c_char,
    m: *const c_int,
    n: *const c_int,
    k: *const c_int,
    alpha: *const f64,
    a: *const f64,
    lda: *const c_int,
    b: *const f64,
    ldb: *const c_int,
    beta: *const f64,
    c: *mut f64,
    ldc: *const c_int,
) {
    // SAFETY: `transa` and `transb` are valid for one read (module contract).
    let (ta, tb) = unsafe { (transposed(flag(transa)), transposed(flag(transb))) };
    // SAFETY: `m`, `n`, `k`, `lda`, `ldb`, `ldc` are valid for one read (module contract).
    let (m, n, k, lda, ldb, ldc) = unsafe { (int(m), int(n), int(k), int(lda), int(ldb), int(ldc)) };
    // SAFETY: `alpha` and `beta` are valid for one read (module contract).
    let (alpha, beta) = unsafe { (real(alpha), real(beta)) };
    let (Some(ta), Some(tb)) = (ta, tb) else { return };
    let ((ra, ca), (rb, cb)) = (if ta { (k, m) } else { (m, k) }, if tb { (n, k) } else { (k, n) });
    if !(shape_ok(ra, ca, lda) && shape_ok(rb, cb, ldb) && shape_ok(m, n, ldc)) {
        return;
    }
    // SAFETY: shape checked; `a` holds op(A)'s source (module contract).
    let a = unsafe { view(a, ra, ca, lda) };
    // SAFETY: shape checked; `b` holds op(B)'s source (module contract).
    let b = unsafe { view(b, rb, cb, ldb) };
    // SAFETY: shape checked; `c` is the unaliased output (module contract).
    let mut c = unsafe { view_mut(c, m, n, ldc) };
    blas::gemm((ta, tb), alpha, (&a, &b), beta, &mut c);
}

/// y = alpha op(A) x + beta y.
///
/// # Safety
/// Module contract; `y` is the output.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgemv_(
    trans: *const c_char,
    m: *const c_int,
    n: *const c_int,
    alpha: *const f64,
    a: *const f64,
    lda: *const c_int,
    x: *const f64,
    incx: *const c_int,
    beta: *const f64,
    y: *mut f64,
    incy: *const c_int,
) {
    // SAFETY: `trans` is valid for one read (module contract).
    let ta = unsafe { transposed(flag(trans)) };
    // SAFETY: `m`, `n`, `lda`, `incx`, `incy` are valid for one read (module contract).
    let (m, n, lda, incx, incy) = unsafe { (int(m), int(n), int(lda), int(incx), int(incy)) };
    // SAFETY: `alpha` and `beta` are valid for one read (module contract).
    let (alpha, beta) = unsafe { (real(alpha), real(beta)) };
    let Some(ta) = ta else { return };
    if !shape_ok(m, n, lda) || incx == 0 || incy == 0 {
        return;
    }
    let (len_x, len_y) = if ta { (m, n) } else { (n, m) };
    // SAFETY: shape checked; `a` holds the matrix (module contract).
    let a = unsafe { view(a, m, n, lda) };
    // SAFETY: `incx != 0`; `x` holds `len_x` elements at that increment (module contract).
    let x = unsafe { gather(x, len_x as usize, incx) };
    // SAFETY: `incy != 0`; `y` holds `len_y` elements at that increment (module contract).
    let mut out = unsafe { gather(y, len_y as usize, incy) };
    blas::gemv(ta, alpha, &a, &x, beta, &mut out);
    // SAFETY: `y` is the unaliased output of the same shape (module contract).
    unsafe { scatter(y, incy, &out) };
}

/// y = alpha A x + beta y with A symmetric, one triangle stored.
///
/// # Safety
/// Module contract; `y` is the output.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dsymv_(
    uplo: *const c_char,
    n: *const c_int,
    alpha: *const f64,
    a: *const f64,
    lda: *const c_int,
    x: *const f64,
    incx: *const c_int,
    beta: *const f64,
    y: *mut f64,
    incy: *const c_int,
) {
    // SAFETY: `uplo` is valid for one read (module contract).
    let uplo = unsafe { Triangle::parse(flag(uplo)) };
    // SAFETY: `n`, `lda`, `incx`, `incy` are valid for one read (module contract).
    let (n, lda, incx, incy) = unsafe { (int(n), int(lda), int(incx), int(incy)) };
    // SAFETY: `alpha` and `beta` are valid for one read (module contract).
    let (alpha, beta) = unsafe { (real(alpha), real(beta)) };
    let Some(uplo) = uplo else { return };
    if !shape_ok(n, n, lda) || incx == 0 || incy == 0 {
        return;
    }
    // SAFETY: shape checked; `a` holds the matrix (module contract).
    let a = unsafe { view(a, n, n, lda) };
    // SAFETY: `incx != 0`; `x` holds `n` elements at that increment (module contract).
    let x = unsafe { gather(x, n as usize, incx) };
    // SAFETY: `incy != 0`; `y` holds `n` elements at that increment (module contract).
    let mut out = unsafe { gather(y, n as usize, incy) };
    blas::symv(uplo, alpha, &a, &x, beta, &mut out);
    // SAFETY: `y` is the unaliased output of the same shape (module contract).
    unsafe { scatter(y, incy, &out) };
}

/// C = alpha op(A) op(A)' + beta C on one triangle.
///
/// # Safety
/// Module contract; `c` is the output.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dsyrk_(
    uplo: *const c_char,
    trans: *const c_char,
    n: *const c_int,
    k: *const c_int,
    alpha: *const f64,
    a: *const f64,
    lda: *const c_int,
    beta: *const f64,
    c: *mut f64,
    ldc: *const c_int,
) {
    // SAFETY: `uplo` and `trans` are valid for one read (module contract).
    let (uplo, ta) = unsafe { (Triangle::parse(flag(uplo)), transposed(flag(trans))) };
    // SAFETY: `n`, `k`, `lda`, `ldc` are valid for one read (module contract).
    let (n, k, lda, ldc) = unsafe { (int(n), int(k), int(lda), int(ldc)) };
    // SAFETY: `alpha` and `beta` are valid for one read (module contract).
    let (alpha, beta) = unsafe { (real(alpha), real(beta)) };
    let (Some(uplo), Some(ta)) = (uplo, ta) else { return };
    let (rows, cols) = if ta { (k, n) } else { (n, k) };
    if !(shape_ok(rows, cols, lda) && shape_ok(n, n, ldc)) {
        return;
    }
    // SAFETY: shape checked; `a` holds op(A)'s source (module contract).
    let a = unsafe { view(a, rows, cols, lda) };
    // SAFETY: shape checked; `c` is the unaliased output (module contract).
    let mut c = unsafe { view_mut(c, n, n, ldc) };
    blas::syrk(uplo, ta, alpha, &a, beta, &mut c);
}

/// C = alpha (op(A) op(B)' + op(B) op(A)') + beta C on one triangle.
///
/// # Safety
/// Module contract; `c` is the output.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dsyr2k_(
    uplo: *const c_char,
    trans: *const c_char,
    n: *const c_int,
    k: *const c_int,
    alpha: *const f64,
    a: *const f64,
    lda: *const c_int,
    b: *const f64,
    ldb: *const c_int,
    beta: *const f64,
    c: *mut f64,
    ldc: *const c_int,
) {
    // SAFETY: `uplo` and `trans` are valid for one read (module contract).
    let (uplo, ta) = unsafe { (Triangle::parse(flag(uplo)), transposed(flag(trans))) };
    // SAFETY: `n`, `k`, `lda`, `ldb`, `ldc` are valid for one read (module contract).
    let (n, k, lda, ldb, ldc) = unsafe { (int(n), int(k), int(lda), int(ldb), int(ldc)) };
    // SAFETY: `alpha` and `beta` are valid for one read (module contract).
    let (alpha, beta) = unsafe { (real(alpha), real(beta)) };
    let (Some(uplo), Some(ta)) = (uplo, ta) else { return };
    let (rows, cols) = if ta { (k, n) } else { (n, k) };
    if !(shape_ok(rows, cols, lda) && shape_ok(rows, cols, ldb) && shape_ok(n, n, ldc)) {
        return;
    }
    // SAFETY: shape checked; `a` holds op(A)'s source (module contract).
    let a = unsafe { view(a, rows, cols, lda) };
    // SAFETY: shape checked; `b` holds op(B)'s source (module contract).
    let b = unsafe { view(b, rows, cols, ldb) };
    // SAFETY: shape checked; `c` is the unaliased output (module contract).
    let mut c = unsafe { view_mut(c, n, n, ldc) };
    blas::syr2k(uplo, ta, alpha, (&a, &b), beta, &mut c);
}

//! Factorisation symbols.

use crate::blas::Triangle;
use crate::lapack;
use crate::memory::{flag, int, real, shape_ok, slice_mut, view, view_mut};
use core::ffi::{c_char, c_int};

/// Cholesky factor in place.
///
/// # Safety
/// Module contract; `a` and `info` are outputs.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dpotrf_(
    uplo: *const c_char,
    n: *const c_int,
    a: *mut f64,
    lda: *const c_int,
    info: *mut c_int,
) {
    // SAFETY: `uplo`, `n`, `lda` are valid for one read (module contract).
    let (uplo, n, lda) = unsafe { (Triangle::parse(flag(uplo)), int(n), int(lda)) };
    let result = match uplo {
        None => Err(-1),
        _ if n < 0 => Err(-2),
        _ if !shape_ok(n, n, lda) => Err(-4),
        Some(uplo) => {
            // SAFETY: shape checked; `a` is the unaliased in-out matrix (module contract).
            let mut a = unsafe { view_mut(a, n, n, lda) };
            lapack::potrf(uplo, &mut a)
        }
    };
    // SAFETY: `info` is valid for one write (module contract).
    unsafe { *info = result.err().unwrap_or(0) };
}

/// Solves A X = B from the factor of [`dpotrf_`].
///
/// # Safety
/// Module contract; `b` and `info` are outputs.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dpotrs_(
    uplo: *const c_char,
    n: *const c_int,
    nrhs: *const c_int,
    a: *const f64,
    lda: *const c_int,
    b: *mut f64,
    ldb: *const c_int,
    info: *mut c_int,
) {
    // SAFETY: `uplo`, `n`, `nrhs`, `lda`, `ldb` are valid for one read (module contract).
    let (uplo, n, nrhs, lda, ldb) =
        unsafe { (Triangle::parse(flag(uplo)), int(n), int(nrhs), int(lda), int(ldb)) };
    let result = match uplo {
        None => -1,
        _ if n < 0 => -2,
        _ if nrhs < 0 => -3,
        _ if !shape_ok(n, n, lda) => -5,
        _ if !shape_ok(n, nrhs, ldb) => -7,
        Some(uplo) => {
            // SAFETY: shape checked; `a` holds the factor (module contract).
            let a = unsafe { view(a, n, n, lda) };
            // SAFETY: shape checked; `b` is the unaliased in-out matrix (module contract).
            let mut b = unsafe { view_mut(b, n, nrhs, ldb) };
            lapack::potrs(uplo, &a, &mut b);
            0
        }
    };
    // SAFETY: `info` is valid for one write (module contract).
    unsafe { *info = result };
}

/// Solves A X = B by LU with partial pivoting.
///
/// # Safety
/// Module contract; `a`, `ipiv` (n), `b` and `info` are outputs.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgesv_(
    n: *const c_int,
    nrhs: *const c_int,
    a: *mut f64,
    lda: *const c_int,
    ipiv: *mut c_int,
    b: *mut f64,
    ldb: *const c_int,
    info: *mut c_int,
) {
    // SAFETY: `n`, `nrhs`, `lda`, `ldb` are valid for one read (module contract).
    let (n, nrhs, lda, ldb) = unsafe { (int(n), int(nrhs), int(lda), int(ldb)) };
    let result = if n < 0 {
        Err(-1)
    } else if nrhs < 0 {
        Err(-2)
    } else if !shape_ok(n, n, lda) {
        Err(-4)
    } else if !shape_ok(n, nrhs, ldb) {
        Err(-7)
    } else {
        // SAFETY: shape checked; `a` is the unaliased in-out matrix (module contract).
        let mut a = unsafe { view_mut(a, n, n, lda) };
        // SAFETY: `ipiv` is valid for `n` elements (module contract).
        let ipiv = unsafe { slice_mut(ipiv, n as usize) };
        // SAFETY: shape checked; `b` is the unaliased in-out matrix (module contract).
        let mut b = unsafe { view_mut(b, n, nrhs, ldb) };
        lapack::gesv(&mut a, ipiv, &mut b)
    };
    // SAFETY: `info` is valid for one write (module contract).
    unsafe { *info = result.err().unwrap_or(0) };
}

/// Eigenvalues (ascending) and, with `jobz = 'V'`, eigenvectors of a symmetric matrix; `range`
/// 'A'll, 'V'alues in (vl, vu] or 'I'ndices il..=iu.
///
/// # Safety
/// Module contract; `a` (destroyed in the reference, kept here), `m`, `w` (n), `z`, `isuppz` (2 m),
/// `work`, `iwork` and `info` are outputs.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dsyevr_(
    jobz: *const c_char,
    range: *const c_char,
    uplo: *const c_char,
    n: *const c_int,
    a: *mut f64,
    lda: *const c_int,
    vl: *const f64,
    vu: *const f64,
    il: *const c_int,
    iu: *const c_int,
    _abstol: *const f64,
    m: *mut c_int,
    w: *mut f64,
    z: *mut f64,
    ldz: *const c_int,
    isuppz: *mut c_int,
    work: *mut f64,
    lwork: *const c_int,
    iwork: *mut c_int,
    liwork: *const c_int,
    info: *mut c_int,
) {
    // SAFETY: `jobz`, `range`, `uplo` are valid for one read (module contract).
    let (jobz, range, uplo) = unsafe { (flag(jobz), flag(range), Triangle::parse(flag(uplo))) };
    // SAFETY: `n`, `lda`, `ldz`, `lwork`, `liwork` are valid for one read (module contract).
    let (n, lda, ldz, lwork, liwork) = unsafe { (int(n), int(lda), int(ldz), int(lwork), int(liwork)) };
    let vectors_wanted = jobz == b'V';
    // The sizes of the reference are reported, so that a caller sized by them would also suit it.
    let query = lwork == -1 || liwork == -1;
    let uplo = match uplo {
        _ if !matches!(jobz, b'N' | b'V') => Err(-1),
        _ if !matches!(range, b'A' | b'V' | b'I') => Err(-2),
        None => Err(-3),
        _ if n < 0 => Err(-4),
        _ if !shape_ok(n, n, lda) => Err(-6),
        _ if ldz < 1 || (vectors_wanted && ldz < n) => Err(-15),
        _ if !query && lwork < (26 * n).max(1) => Err(-18),
        _ if !query && liwork < (10 * n).max(1) => Err(-20),
        Some(uplo) => Ok(uplo),
    };
    let uplo = match uplo {
        Ok(uplo) => uplo,
        Err(code) => {
            // SAFETY: `info` is valid for one write (module contract).
            unsafe { *info = code };
            return;
        }
    };
    if query {
        // SAFETY: `work` is valid for one write in a query (module contract).
        unsafe { *work = f64::from((26 * n).max(1)) };
        // SAFETY: `iwork` is valid for one write in a query (module contract).
        unsafe { *iwork = (10 * n).max(1) };
        // SAFETY: `info` is valid for one write (module contract).
        unsafe { *info = 0 };
        return;
    }
    // SAFETY: shape checked; `a` holds the matrix (module contract).
    let a = unsafe { view(a, n, n, lda) };
    let found = if vectors_wanted {
        lapack::syev(uplo, &a).map(|(values, vectors)| (values, Some(vectors)))
    } else {
        lapack::syev_values(uplo, &a).map(|values| (values, None))
    };
    let (values, vectors) = match found {
        Ok(found) => found,
        Err(code) => {
            // SAFETY: `info` is valid for one write (module contract).
            unsafe { *info = code };
            return;
        }
    };
    let chosen: Vec<usize> = match range {
        b'V' => {
            // SAFETY: `vl` and `vu` are valid for one read when `range` is 'V' (module contract).
            let (vl, vu) = unsafe { (real(vl), real(vu)) };
            (0..n as usize).filter(|&i| values[i] > vl && values[i] <= vu).collect()
        }
        b'I' => {
            // SAFETY: `il` and `iu` are valid for one read when `range` is 'I' (module contract).
            let (il, iu) = unsafe { (int(il), int(iu)) };
            (0..n as usize).filter(|&i| (i as i32) + 1 >= il && (i as i32) < iu).collect()
        }
        _ => (0..n as usize).collect(),
    };
    // SAFETY: `w` is valid for `n` elements (module contract).
    let w = unsafe { slice_mut(w, n as usize) };
    for (out, &i) in w.iter_mut().zip(&chosen) {
        *out = values[i];
    }
    if let Some(vectors) = vectors {
        // SAFETY: `ldz >= n` was checked; `z` has a column per chosen eigenvalue (module contract).
        let mut z = unsafe { view_mut(z, n, chosen.len() as i32, ldz) };
        // SAFETY: `isuppz` is valid for two entries per chosen eigenvalue (module contract).
        let isuppz = unsafe { slice_mut(isuppz, 2 * chosen.len()) };
        for (column, &i) in chosen.iter().enumerate() {
            z.set_column(column, &vectors.column(i));
            isuppz[2 * column] = 1;
            isuppz[2 * column + 1] = n;
        }
    }
    // SAFETY: `m` is valid for one write (module contract).
    unsafe { *m = chosen.len() as i32 };
    // SAFETY: `info` is valid for one write (module contract).
    unsafe { *info = 0 };
}

/// Which singular vectors a routine was asked for.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Basis {
    None,
    Thin,
}

/// 'N', 'S', and 'A' where it equals 'S'.
fn basis(job: u8, full_is_thin: bool) -> Option<Basis> {
    match job {
        b'N' => Some(Basis::None),
        b'S' => Some(Basis::Thin),
        b'A' if full_is_thin => Some(Basis::Thin),
        _ => None,
    }
}

/// Checked arguments of both singular value routines.
struct SvdCall {
    u: Basis,
    v: Basis,
    m: i32,
    n: i32,
    lda: i32,
    ldu: i32,
    ldvt: i32,
}

impl SvdCall {
    /// Runs the decomposition and stores what was asked for.
    ///
    /// # Safety
    /// Module contract for `a`, `s` (min(m, n)), `u`, `vt`; shapes checked before.
    unsafe fn run(&self, a: *const f64, s: *mut f64, u: *mut f64, vt: *mut f64) -> i32 {
        let r = self.m.min(self.n);
        // SAFETY: shape checked by the caller; `a` holds the matrix (module contract).
        let a = unsafe { view(a, self.m, self.n, self.lda) };
        let (u_found, s_found, vt_found) = match lapack::svd(&a) {
            Ok(found) => found,
            Err(code) => return code,
        };
        // SAFETY: `s` is valid for min(m, n) elements (module contract).
        unsafe { slice_mut(s, r as usize) }.copy_from_slice(s_found.as_slice());
        if self.u == Basis::Thin {
            // SAFETY: `ldu >= m` was checked; `u` has min(m, n) columns (module contract).
            unsafe { view_mut(u, self.m, r, self.ldu) }.copy_from(&u_found);
        }
        if self.v == Basis::Thin {
            // SAFETY: `ldvt >= min(m, n)` was checked; `vt` has n columns (module contract).
            unsafe { view_mut(vt, r, self.n, self.ldvt) }.copy_from(&vt_found);
        }
        0
    }

    /// Leading dimensions: argument numbers of a, u, vt for the error codes.
    fn check(&self, (arg_m, arg_a, arg_u, arg_vt): (i32, i32, i32, i32)) -> Result<(), i32> {
        let r = self.m.min(self.n);
        if self.m < 0 {
            Err(-arg_m)
        } else if self.n < 0 {
            Err(-arg_m - 1)
        } else if !shape_ok(self.m, self.n, self.lda) {
            Err(-arg_a)
        } else if self.ldu < 1 || (self.u == Basis::Thin && self.ldu < self.m) {
            Err(-arg_u)
        } else if self.ldvt < 1 || (self.v == Basis::Thin && self.ldvt < r) {
            Err(-arg_vt)
        } else {
            Ok(())
        }
    }
}

/// Singular value decomposition (divide and conquer in the reference).
///
/// # Safety
/// Module contract; `s`, `u`, `vt`, `work`, `info` are outputs; `a` is kept.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgesdd_(
    jobz: *const c_char,
    m: *const c_int,
    n: *const c_int,
    a: *mut f64,
    lda: *const c_int,
    s: *mut f64,
    u: *mut f64,
    ldu: *const c_int,
    vt: *mut f64,
    ldvt: *const c_int,
    work: *mut f64,
    lwork: *const c_int,
    _iwork: *mut c_int,
    info: *mut c_int,
) {
    // SAFETY: `jobz`, `m`, `n` are valid for one read (module contract).
    let (jobz, m, n) = unsafe { (flag(jobz), int(m), int(n)) };
    // SAFETY: `lda`, `ldu`, `ldvt`, `lwork` are valid for one read (module contract).
    let (lda, ldu, ldvt, lwork) = unsafe { (int(lda), int(ldu), int(ldvt), int(lwork)) };
    let code = match basis(jobz, m == n) {
        None => -1,
        Some(wanted) => {
            let call = SvdCall { u: wanted, v: wanted, m, n, lda, ldu, ldvt };
            match call.check((2, 5, 8, 10)) {
                Err(code) => code,
                Ok(()) if lwork == -1 => {
                    // SAFETY: `work` is valid for one write in a query (module contract).
                    unsafe { *work = 1.0 };
                    0
                }
                Ok(()) if lwork < 1 => -12,
                // SAFETY: shapes checked; pointers by the module contract.
                Ok(()) => unsafe { call.run(a, s, u, vt) },
            }
        }
    };
    // SAFETY: `info` is valid for one write (module contract).
    unsafe { *info = code };
}

/// Singular value decomposition (QR iteration in the reference).
///
/// # Safety
/// Module contract; `s`, `u`, `vt`, `work`, `info` are outputs; `a` is kept.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgesvd_(
    jobu: *const c_char,
    jobvt: *const c_char,
    m: *const c_int,
    n: *const c_int,
    a: *mut f64,
    lda: *const c_int,
    s: *mut f64,
    u: *mut f64,
    ldu: *const c_int,
    vt: *mut f64,
    ldvt: *const c_int,
    work: *mut f64,
    lwork: *const c_int,
    info: *mut c_int,
) {
    // SAFETY: `jobu`, `jobvt`, `m`, `n` are valid for one read (module contract).
    let (jobu, jobvt, m, n) = unsafe { (flag(jobu), flag(jobvt), int(m), int(n)) };
    // SAFETY: `lda`, `ldu`, `ldvt`, `lwork` are valid for one read (module contract).
    let (lda, ldu, ldvt, lwork) = unsafe { (int(lda), int(ldu), int(ldvt), int(lwork)) };
    // A full basis of the short side is the thin one.
    let code = match (basis(jobu, m <= n), basis(jobvt, n <= m)) {
        (None, _) => -1,
        (_, None) => -2,
        (Some(for_u), Some(for_v)) => {
            let call = SvdCall { u: for_u, v: for_v, m, n, lda, ldu, ldvt };
            match call.check((3, 6, 9, 11)) {
                Err(code) => code,
                Ok(()) if lwork == -1 => {
                    // SAFETY: `work` is valid for one write in a query (module contract).
                    unsafe { *work = 1.0 };
                    0
                }
                Ok(()) if lwork < 1 => -13,
                // SAFETY: shapes checked; pointers by the module contract.
                Ok(()) => unsafe { call.run(a, s, u, vt) },
            }
        }
    };
    // SAFETY: `info` is valid for one write (module contract).
    unsafe { *info = code };
}

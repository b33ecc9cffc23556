//! Raw pointers of the Fortran calling convention to slices and views: all `unsafe` reading is here.

use core::ffi::{c_char, c_int};
use nalgebra::{DMatrixView, DMatrixViewMut, Dyn, U1};

/// Column-major matrix with unit row stride and an arbitrary leading dimension.
pub(crate) type View<'a> = DMatrixView<'a, f64, U1, Dyn>;
/// Mutable form of [`View`].
pub(crate) type ViewMut<'a> = DMatrixViewMut<'a, f64, U1, Dyn>;

/// Upper-cased character argument.
///
/// # Safety
/// `p` is valid for one read.
pub(crate) unsafe fn flag(p: *const c_char) -> u8 {
    // SAFETY: `p` is valid for one read by this function's contract.
    (unsafe { *p } as u8).to_ascii_uppercase()
}

/// Integer argument.
///
/// # Safety
/// `p` is valid for one read.
pub(crate) unsafe fn int(p: *const c_int) -> i32 {
    // SAFETY: `p` is valid for one read by this function's contract.
    unsafe { *p }
}

/// Floating-point argument.
///
/// # Safety
/// `p` is valid for one read.
pub(crate) unsafe fn real(p: *const f64) -> f64 {
    // SAFETY: `p` is valid for one read by this function's contract.
    unsafe { *p }
}

/// Number of elements from the first to the last one of a `rows` x `cols` matrix.
fn extent(rows: usize, cols: usize, ld: usize) -> usize {
    if rows == 0 || cols == 0 { 0 } else { (cols - 1) * ld + rows }
}

/// Whether `rows`, `cols` and the leading dimension describe a matrix.
pub(crate) fn shape_ok(rows: i32, cols: i32, ld: i32) -> bool {
    rows >= 0 && cols >= 0 && ld >= rows.max(1)
}

/// Input matrix.
///
/// # Safety
/// `shape_ok(rows, cols, ld)` holds and, unless it is empty, `p` is valid for reading
/// `(cols - 1) ld + rows` elements that nobody writes during `'a`.
pub(crate) unsafe fn view<'a>(p: *const f64, rows: i32, cols: i32, ld: i32) -> View<'a> {
    let (rows, cols, ld) = (rows as usize, cols as usize, ld as usize);
    let data: &[f64] = match extent(rows, cols, ld) {
        0 => &[],
        // SAFETY: `p` is valid for reading `len` elements by this function's contract.
        len => unsafe { core::slice::from_raw_parts(p, len) },
    };
    // SAFETY: the slice covers the last element of the last column, which is the largest offset
    // the view reaches with row stride 1 and column stride `ld`; an empty view reaches none.
    unsafe {
        DMatrixView::from_slice_with_strides_generic_unchecked(data, 0, Dyn(rows), Dyn(cols), U1, Dyn(ld))
    }
}

/// Output (or in-out) matrix.
///
/// # Safety
/// As [`view`], and `p` is valid for writing and not aliased during `'a`.
pub(crate) unsafe fn view_mut<'a>(p: *mut f64, rows: i32, cols: i32, ld: i32) -> ViewMut<'a> {
    let (rows, cols, ld) = (rows as usize, cols as usize, ld as usize);
    let data: &mut [f64] = match extent(rows, cols, ld) {
        0 => &mut [],
        // SAFETY: `p` is valid for reading and writing `len` elements, and unaliased, by contract.
        len => unsafe { core::slice::from_raw_parts_mut(p, len) },
    };
    // SAFETY: as in `view`.
    unsafe {
        DMatrixViewMut::from_slice_with_strides_generic_unchecked(data, 0, Dyn(rows), Dyn(cols), U1, Dyn(ld))
    }
}

/// Plain output vector.
///
/// # Safety
/// `p` is valid for reading and writing `len` elements and not aliased during `'a` (any pointer
/// when `len` is 0).
pub(crate) unsafe fn slice_mut<'a, T>(p: *mut T, len: usize) -> &'a mut [T] {
    if len == 0 {
        return &mut [];
    }
    // SAFETY: by this function's contract.
    unsafe { core::slice::from_raw_parts_mut(p, len) }
}

/// Index of element `i` of a BLAS vector of `n` elements with increment `inc`: a negative increment
/// walks from the far end (BLAS convention).
fn at(i: usize, n: usize, inc: i32) -> usize {
    let step = inc.unsigned_abs() as usize;
    if inc >= 0 { i * step } else { (n - 1 - i) * step }
}

/// Copy of a strided input vector.
///
/// # Safety
/// `inc != 0` and `p` is valid for reading `1 + (n - 1) |inc|` elements.
pub(crate) unsafe fn gather(p: *const f64, n: usize, inc: i32) -> nalgebra::DVector<f64> {
    // SAFETY: `at` stays within `(n - 1) |inc|`, which the caller vouches for.
    nalgebra::DVector::from_fn(n, |i, _| unsafe { *p.add(at(i, n, inc)) })
}

/// Writes a strided output vector.
///
/// # Safety
/// `inc != 0` and `p` is valid for writing `1 + (n - 1) |inc|` elements, `n` the length of `x`.
pub(crate) unsafe fn scatter(p: *mut f64, inc: i32, x: &nalgebra::DVector<f64>) {
    let n = x.len();
    for (i, value) in x.iter().enumerate() {
        // SAFETY: `at` stays within `(n - 1) |inc|`, which the caller vouches for.
        unsafe { *p.add(at(i, n, inc)) = *value };
    }
}

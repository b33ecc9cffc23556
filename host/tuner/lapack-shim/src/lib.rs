//! The eleven BLAS and LAPACK symbols that the conic solver links against, on top of nalgebra.
//!
//! The solver behind `cubectl tune` keeps its semidefinite cone on Fortran BLAS and LAPACK. A system
//! library would need a Fortran compiler or a download at build time; this leaf package exports the
//! handful of routines instead, so that the whole project builds with cargo alone.
//!
//! | file | holds |
//! |---|---|
//! | `blas`, `lapack` | the routines as safe functions over nalgebra views |
//! | `memory` | the only place where a raw pointer becomes a slice or a view |
//! | [`symbols`] | the exported C symbols: read arguments, check them, call the safe routine |
//!
//! Rules:
//! * Nothing else in the process may define these symbols: never link another BLAS next to it.
//! * Argument checks as in LAPACK (`info = -i` for the i-th argument); a BLAS routine has no way to
//!   report one and leaves its output untouched.
//! * What the solver never asks for is refused with `info < 0`, not half done: `jobz = 'O'` and full
//!   bases of rectangular matrices in the singular value decompositions.
//! * Column-major, 32-bit integers (LP64), trailing hidden string lengths ignored.

mod blas;
mod lapack;
mod memory;
pub mod symbols;

/// Keeps the exported symbols in the link of a binary that reaches them only through the solver.
///
/// Call it once before the solver is built; it does nothing else.
pub fn link() {
    let anchor: unsafe extern "C" fn(
        *const core::ffi::c_char,
        *const core::ffi::c_int,
        *mut f64,
        *const core::ffi::c_int,
        *mut core::ffi::c_int,
    ) = symbols::dpotrf_;
    core::hint::black_box(anchor);
}

//! The exported C symbols, each with the signature of the reference BLAS and LAPACK.
//!
//! Argument names and order follow the reference; see there for the meaning of each. All of them
//! share one contract, written out once here.
//!
//! # Safety
//! Every scalar pointer is valid for one read; every array pointer is valid for the elements that
//! the dimensions, leading dimensions and increments describe, for writing where the reference
//! marks it as output, and output arrays alias nothing. This is the Fortran calling convention.

// The contract of the module head holds for each symbol; their argument lists are the reference's.
#![allow(clippy::too_many_arguments)]

mod blas;
mod lapack;

pub use blas::{dgemm_, dgemv_, dsymv_, dsyr2k_, dsyrk_};
pub use lapack::{dgesdd_, dgesv_, dgesvd_, dpotrf_, dpotrs_, dsyevr_};

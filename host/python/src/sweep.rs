//! Sweeps over many targets, by the code of the program.

use std::path::PathBuf;

use host::cmd::plan::for_programs;
use pyo3::prelude::*;

use crate::calls::interruptible;
use crate::errors::refused;

/// Shards that were made and shards that were there, from a request of `cubectl plan sweep` as JSON.
#[pyfunction]
pub(crate) fn sweep(py: Python<'_>, request: String) -> PyResult<(u32, u32)> {
    let made = interruptible(py, move |stop| for_programs::sweep(&request, stop))?;
    made.map(|made| (made.made, made.there)).map_err(|error| refused(&error))
}

/// What the parts in a folder say together, as JSON.
#[pyfunction]
pub(crate) fn sweep_summary(py: Python<'_>, folder: PathBuf) -> PyResult<String> {
    interruptible(py, move |_| for_programs::sweep_summary(&folder))?.map_err(|error| refused(&error))
}

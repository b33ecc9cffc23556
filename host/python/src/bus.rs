//! A bus: who is there, how the modules are, which frames pass. By the code of the program; nothing is set or moved.

use host::cmd::{record, scan, status};
use host::error::ExpectedError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::calls::interruptible;
use crate::errors::refused;
use crate::logs::Columns;

/// What `cubectl scan --json` tells, from words of its command line.
#[pyfunction]
pub(crate) fn bus_scan(py: Python<'_>, words: Vec<String>) -> PyResult<String> {
    let told = interruptible(py, move |stop| scan::for_programs(&words, stop))?;
    told.map(|told| told.to_string()).map_err(|error| refused(&error))
}

/// What `cubectl status --json` tells, from words of its command line.
#[pyfunction]
pub(crate) fn bus_status(py: Python<'_>, words: Vec<String>) -> PyResult<String> {
    let told = interruptible(py, move |stop| status::for_programs(&words, stop))?;
    told.map(|told| told.to_string()).map_err(|error| refused(&error))
}

/// The columns of [`crate::logs::read_log`] of the frames that pass, from words of the command line of `cubectl record`.
#[pyfunction]
pub(crate) fn bus_record(py: Python<'_>, words: Vec<String>) -> PyResult<Bound<'_, PyDict>> {
    let kept =
        interruptible(py, move |stop| record::for_programs(&words, stop).map(|lines| Columns::of(&lines)))?;
    let columns = kept.map_err(|error: ExpectedError| refused(&error))?;
    let all = columns.into_dict(py)?;
    all.set_item("torn", None::<String>)?;
    Ok(all)
}

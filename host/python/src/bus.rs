//! A bus: who is there, how the modules are, which frames pass. By the code of the program; nothing is set or moved.

use host::cmd::arm::status;
use host::cmd::log::record;
use host::error::ExpectedError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::calls::interruptible;
use crate::errors::refused;
use crate::logs::Columns;

/// What `cubectl arm status --json` prints, from words of its command line; see `status::for_programs`.
#[pyfunction]
pub(crate) fn bus_modules(py: Python<'_>, words: Vec<String>, all_must_answer: bool) -> PyResult<String> {
    let modules = interruptible(py, move |stop| status::for_programs(&words, all_must_answer, stop))?;
    modules.map(|modules| modules.to_string()).map_err(|error| refused(&error))
}

/// The columns of [`crate::logs::read_log`] of the frames that pass, from words of the command line of `cubectl log record`.
#[pyfunction]
pub(crate) fn bus_record(py: Python<'_>, words: Vec<String>) -> PyResult<Bound<'_, PyDict>> {
    let kept =
        interruptible(py, move |stop| record::for_programs(&words, stop).map(|lines| Columns::of(&lines)))?;
    let columns = kept.map_err(|error: ExpectedError| refused(&error))?;
    let all = columns.into_dict(py)?;
    all.set_item("torn", None::<String>)?;
    Ok(all)
}

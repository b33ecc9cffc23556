//! Catches of balls and discs, by the code of the program.

use host::cmd::catch::for_programs;
use pyo3::prelude::*;

use crate::calls::interruptible;
use crate::errors::refused;

/// One trial of the cell as JSON, from a request of `cubectl catch` as JSON; the table of the motion in steps of `step_s`.
#[pyfunction]
pub(crate) fn catch_ball(py: Python<'_>, request: String, step_s: f64) -> PyResult<String> {
    let reported = interruptible(py, move |_| for_programs::ball(&request, step_s))?;
    reported.map(|reported| reported.to_string()).map_err(|error| refused(&error))
}

/// A flight of a disc and its catch as JSON, from a request of `cubectl catch` as JSON; tables in steps of `step_s`.
#[pyfunction]
pub(crate) fn catch_disc(py: Python<'_>, request: String, step_s: f64) -> PyResult<String> {
    let reported = interruptible(py, move |_| for_programs::disc(&request, step_s))?;
    reported.map(|reported| reported.to_string()).map_err(|error| refused(&error))
}

//! Catches of balls and discs, by the code of the program.

use host::cmd::catch::for_programs;
use pyo3::prelude::*;

use crate::calls::interruptible;
use crate::errors::refused;

/// One trial of the cell as JSON, from words of the command line of `cubectl catch`; the table of the motion in steps of `step_s`.
#[pyfunction]
pub(crate) fn catch_ball(py: Python<'_>, words: Vec<String>, step_s: f64) -> PyResult<String> {
    let told = interruptible(py, move |_| for_programs::ball(&words, step_s))?;
    told.map(|told| told.to_string()).map_err(|error| refused(&error))
}

/// A flight of a disc and its catch as JSON, from words of the command line of `cubectl catch`; tables in steps of `step_s`.
#[pyfunction]
pub(crate) fn catch_disc(py: Python<'_>, words: Vec<String>, step_s: f64) -> PyResult<String> {
    let told = interruptible(py, move |_| for_programs::disc(&words, step_s))?;
    told.map(|told| told.to_string()).map_err(|error| refused(&error))
}

//! What is refused, as Python exceptions.

use host::error::{Cause, ExpectedError};
use pyo3::create_exception;
use pyo3::exceptions::PyException;
use pyo3::prelude::*;

create_exception!(
    cubecell,
    CubecellError,
    PyException,
    "Something was refused, with the message of `cubectl`; `exit_code` is the code that it ends with."
);

/// The exception for an expected error of the program.
pub(crate) fn refused(error: &ExpectedError) -> PyErr {
    let exception = CubecellError::new_err(error.to_string());
    Python::attach(|py| match exception.value(py).setattr("exit_code", error.code) {
        Ok(()) => exception,
        Err(why) => why,
    })
}

/// The exception for refused input.
pub(crate) fn bad(cause: &(impl Cause + ?Sized)) -> PyErr {
    refused(&ExpectedError::bad_input(cause))
}

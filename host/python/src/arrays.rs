//! Arrays as bytes. A `bytearray` is a buffer that numpy takes as it is and may write to.

use pyo3::prelude::*;
use pyo3::types::PyByteArray;

use crate::errors::bad;

/// Doubles of an array that Python has sent.
pub(crate) fn doubles(bytes: &[u8]) -> PyResult<Vec<f64>> {
    let (whole, rest) = bytes.as_chunks::<8>();
    if !rest.is_empty() {
        return Err(bad(&"an array of doubles has a length in bytes that is a multiple of 8"));
    }
    Ok(whole.iter().map(|eight| f64::from_le_bytes(*eight)).collect())
}

/// An array for Python.
pub(crate) fn array<'py>(py: Python<'py>, values: &[f64]) -> Bound<'py, PyByteArray> {
    let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
    PyByteArray::new(py, &bytes)
}

//! The flight of a ball.

use nalgebra::Vector3;
use planner::flight::FlightModel;
use pyo3::prelude::*;
use pyo3::types::PyByteArray;

use crate::arrays::{array, doubles};
use crate::errors::bad;

/// Gravity in m/s², drag in 1/m, and spin times lift constant in 1/s.
#[derive(Clone, Copy, FromPyObject)]
pub(crate) struct Air(f64, f64, [f64; 3]);

impl Air {
    fn model(&self) -> PyResult<FlightModel> {
        let Self(gravity_m_s2, drag_per_m, magnus_rad_s) = *self;
        FlightModel::vacuum(gravity_m_s2)
            .and_then(|model| model.with_drag(drag_per_m))
            .and_then(|model| model.with_magnus(Vector3::from(magnus_rad_s)))
            .map_err(|error| bad(&error))
    }
}

/// Rows of position and velocity of a ball at times in s after its release.
#[pyfunction]
pub(crate) fn flight<'py>(
    py: Python<'py>,
    position_m: [f64; 3],
    velocity_m_s: [f64; 3],
    times: &[u8],
    air: Air,
) -> PyResult<Bound<'py, PyByteArray>> {
    let model = air.model()?;
    let (p, v) = (Vector3::from(position_m), Vector3::from(velocity_m_s));
    let times = doubles(times)?;
    let rows = py.detach(|| {
        let mut rows = Vec::with_capacity(6 * times.len());
        for t in times {
            let (p, v) = model.coast(&p, &v, t);
            rows.extend(p.iter().chain(v.iter()));
        }
        rows
    });
    Ok(array(py, &rows))
}

/// Where and when a ball comes down on the plane at a height: x, y, z in m, time in s; `None` if it does not.
#[pyfunction]
pub(crate) fn landing(
    position_m: [f64; 3],
    velocity_m_s: [f64; 3],
    height_m: f64,
    air: Air,
) -> PyResult<Option<(f64, f64, f64, f64)>> {
    let landing = air.model()?.land(&Vector3::from(position_m), &Vector3::from(velocity_m_s), height_m);
    Ok(landing.map(|l| (l.p.x, l.p.y, l.p.z, l.time_s)))
}

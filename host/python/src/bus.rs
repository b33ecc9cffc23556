//! A bus: who is there, how the modules are, which frames pass. By the code of the program; nothing is set or moved.

use std::path::PathBuf;

use host::cmd::arm::status::{self, Modules};
use host::cmd::log::record;
use host::error::ExpectedError;
use operator::bus::BusArgs;
use operator::bus::args::CellArgs;
use protocol::ModuleId;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::calls::interruptible;
use crate::errors::refused;
use crate::logs::Columns;

/// Which bus, and the cell behind a simulated one.
#[derive(FromPyObject)]
pub(crate) struct Joined {
    #[pyo3(item)]
    bus: String,
    #[pyo3(item)]
    robot: Option<String>,
    #[pyo3(item)]
    seed: Option<u64>,
    #[pyo3(item)]
    scenario: Option<PathBuf>,
}

impl Joined {
    pub(crate) fn is_simulated(&self) -> bool {
        self.bus == "sim"
    }

    /// # Errors
    /// There is no such bus.
    pub(crate) fn args(&self) -> Result<BusArgs, ExpectedError> {
        let bus = self.bus.parse().map_err(|error| ExpectedError::bad_input(&error))?;
        let cell = CellArgs { robot: self.robot.clone(), seed: self.seed, scenario: self.scenario.clone() };
        Ok(BusArgs { bus, cell, ..BusArgs::default() })
    }
}

/// What `cubectl arm status --json` prints of these addresses, or of all; see `status::for_programs`.
#[pyfunction]
#[pyo3(signature = (bus, modules, all_must_answer))]
pub(crate) fn bus_modules(
    py: Python<'_>,
    bus: Joined,
    modules: Option<Vec<u8>>,
    all_must_answer: bool,
) -> PyResult<String> {
    let found = interruptible(py, move |stop| {
        let ids = modules.map(|ids| ids.into_iter().map(ModuleId::new).collect::<Result<_, _>>());
        let ids = ids
            .transpose()
            .map_err(|error| ExpectedError::bad_input(&format!("modules: address {error}")))?;
        status::for_programs(&bus.args()?, ids.map(Modules).as_ref(), all_must_answer, stop)
    })?;
    found.map(|modules| modules.to_string()).map_err(|error| refused(&error))
}

/// The columns of [`crate::logs::read_log`] of the frames that pass in `for_s` seconds; `controller` as for `record::for_programs`.
#[pyfunction]
pub(crate) fn bus_record(
    py: Python<'_>,
    bus: Joined,
    for_s: f64,
    controller: bool,
) -> PyResult<Bound<'_, PyDict>> {
    let kept = interruptible(py, move |stop| {
        record::for_programs(&bus.args()?, for_s, controller, stop).map(|lines| Columns::of(&lines))
    })?;
    let columns = kept.map_err(|error: ExpectedError| refused(&error))?;
    let all = columns.into_dict(py)?;
    all.set_item("torn", None::<String>)?;
    Ok(all)
}

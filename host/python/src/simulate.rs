//! A throw in the simulated cell, in virtual time, with the controller in this program.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use host::cmd::throw::led;
use host::error::{Cause, ExpectedError};
use operator::bus::args::CellArgs;
use operator::bus::period::{PeriodRequest, apply, choose, settings_with_gains};
use operator::bus::settings::settings_of;
use operator::job::cell::take_plan;
use operator::job::{Answer, Order, perform};
use operator::port::{BallSeen, InProcess};
use planner::follow::plan::FollowPlan;
use planner::way::Travel;
use pyo3::prelude::*;
use pyo3::types::PyByteArray;
use serde_json::json;
use tuner::gains::gains_file::GainsFile;

use crate::arrays::array;
use crate::calls::interruptible;
use crate::errors::refused;
use crate::plans::{NAME, plan_of};

/// What is simulated.
#[derive(FromPyObject)]
pub(crate) struct Request {
    #[pyo3(item)]
    plan: String,
    #[pyo3(item)]
    robot: Option<String>,
    #[pyo3(item)]
    seed: u64,
    /// Gains file, TOML; those of the program without one.
    #[pyo3(item)]
    gains: Option<String>,
    #[pyo3(item)]
    scenario: Option<PathBuf>,
}

/// Outcome, landing of the simulated ball and analysis of the run, as JSON.
#[pyfunction]
pub(crate) fn simulate(py: Python<'_>, request: Request) -> PyResult<String> {
    interruptible(py, move |stop| throw(&request, stop))?.map_err(|error| refused(&error))
}

fn throw(request: &Request, stop: &Arc<AtomicBool>) -> Result<String, ExpectedError> {
    let bad = |error: &dyn Cause| ExpectedError::bad_input(error);
    let (plan, robot) = plan_of(&request.plan, request.robot.as_deref())?;
    let arm = &robot;
    let source = request.robot.clone().unwrap_or_else(|| plan.robot.source.clone());
    let cell = CellArgs { robot: Some(source), seed: Some(request.seed), scenario: request.scenario.clone() };
    let mut setup = cell.load()?.setup;
    take_plan(&mut setup.cell, &plan);
    let settings = match &request.gains {
        None => settings_with_gains(&robot, &setup).map_err(|error| bad(&error))?,
        Some(text) => {
            let gains = GainsFile::from_toml(text, arm.name()).map_err(|error| bad(&error))?;
            let mut settings = settings_of(&robot).map_err(|error| bad(&error))?;
            let choice =
                choose(PeriodRequest::Gains(Box::new(gains)), None, &robot, settings.cycle_period_us)?;
            apply(&choice, &mut settings);
            settings
        }
    };
    let mut operator = InProcess::new(&robot, &setup, request.seed, &settings)?;
    operator.stop_with(Arc::clone(stop));
    let order = Order::throw(arm, &plan, Travel { seed: request.seed, ..Travel::default() });
    let record = perform(&mut operator, &order, &mut |_| Answer::Yes);
    // The simulated cell is the witness.
    let seen = BallSeen::of(operator.cell()).landing;
    let reported = json!({
        "outcome": record.verdict.outcome.json_name(),
        "text": record.verdict.text,
        "tolerance_m": order.judge.tolerance_m(),
        "error": record.ended.as_ref().map(ToString::to_string),
        "landing_m": seen.map(|(_, p)| [p.x, p.y, p.z]),
        "flight_s": seen.map(|(s, _)| s),
        "miss_m": record.landing.map(|landing| landing.error_m),
        "analysis": record.analysis,
    });
    Ok(reported.to_string())
}

/// A throw that follows the flight, with the simulated robot controller inside this program, from a request of
/// `cubectl throw` as JSON: its summary as JSON, and rows of time in s, set axes and actual axes in rad.
#[pyfunction]
pub(crate) fn simulate_follow(
    py: Python<'_>,
    plan: String,
    request: String,
) -> PyResult<(String, Bound<'_, PyByteArray>)> {
    let simulated = interruptible(py, move |stop| {
        let plan = FollowPlan::from_json(Path::new(NAME), &plan)
            .map_err(|error| ExpectedError::bad_input(&error))?;
        led::simulate(&request, &plan, Arc::clone(stop))
    })?;
    let simulated = simulated.map_err(|error| refused(&error))?;
    let rows: Vec<f64> = simulated
        .seen
        .cycles
        .iter()
        .flat_map(|cycle| {
            let axes = cycle.set_deg.iter().chain(&cycle.actual_deg).map(|deg| deg.to_radians());
            std::iter::once(cycle.at.as_secs_f64()).chain(axes).collect::<Vec<f64>>()
        })
        .collect();
    Ok((simulated.summary.to_string(), array(py, &rows)))
}

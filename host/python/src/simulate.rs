//! A throw in the simulated cell, in virtual time, with the controller in this program.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use host::cmd::throw::robot;
use host::error::ExpectedError;
use operator::bus::args::CellArgs;
use operator::bus::period::{PeriodRequest, apply, choose, settings_with_gains};
use operator::bus::settings::settings_of;
use operator::port::{BallSeen, InProcess};
use operator::throw::cell::take_plan;
use operator::throw::outcome::{default_tolerance_m, judge};
use operator::throw::{Job, Record, job};
use planner::follow::plan::FollowPlan;
use pyo3::prelude::*;
use pyo3::types::PyByteArray;
use serde_json::json;
use tuner::gains::gains_file::GainsFile;

use crate::arrays::array;
use crate::calls::interruptible;
use crate::errors::refused;
use crate::plans::{NAME, plan_of};

/// Share of the speed limits that the way to the start of the throw uses, as in `cubectl throw`.
const APPROACH_SHARE: f64 = 0.3;

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
    let bad = |error: &dyn std::fmt::Display| ExpectedError::bad_input(&error);
    let (plan, robot) = plan_of(&request.plan, request.robot.as_deref())?;
    let arm = &robot;
    let source = request.robot.clone().unwrap_or_else(|| plan.robot.source.clone());
    let cell = CellArgs { robot: Some(source), seed: Some(request.seed), scenario: request.scenario.clone() };
    let mut setup = cell.load()?.setup;
    take_plan(&mut setup.cell, &plan);
    let settings = match &request.gains {
        None => settings_with_gains(&robot).map_err(|error| bad(&error))?,
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
    let throw = Job {
        arm,
        plan: &plan,
        gains: None,
        approach_share: APPROACH_SHARE,
        seed: request.seed,
        tolerance_m: default_tolerance_m(arm, &plan),
        go_back: false,
    };
    let mut record = Record::default();
    let ended = job::run(&mut operator, &throw, &mut record, &mut |_| job::Answer::Yes);
    let verdict = judge(&throw, &record, ended.as_ref().copied());
    // The simulated cell is the witness.
    let seen = BallSeen::of(operator.cell()).landing;
    let told = json!({
        "outcome": verdict.outcome.json_name(),
        "text": verdict.text,
        "tolerance_m": verdict.tolerance_m,
        "error": ended.as_ref().err().map(ToString::to_string),
        "landing_m": seen.map(|(_, p)| [p.x, p.y, p.z]),
        "flight_s": seen.map(|(s, _)| s),
        "miss_m": record.landing.map(|landing| landing.error_m),
        "analysis": record.analysis,
    });
    Ok(told.to_string())
}

/// A throw that follows the flight, with the simulated robot controller inside this program, from words of the command line of
/// `cubectl throw`: its summary as JSON, and rows of time in s, set axes and actual axes in rad.
#[pyfunction]
pub(crate) fn simulate_follow(
    py: Python<'_>,
    plan: String,
    words: Vec<String>,
) -> PyResult<(String, Bound<'_, PyByteArray>)> {
    let simulated = interruptible(py, move |_| {
        let plan = FollowPlan::from_json(Path::new(NAME), &plan)
            .map_err(|error| ExpectedError::bad_input(&error))?;
        robot::simulate(&words, &plan)
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

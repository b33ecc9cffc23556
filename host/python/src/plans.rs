//! Plans and gains, by the code of the program.

use std::path::Path;

use host::cmd::plan::check::{follow_findings, follow_json};
use host::cmd::plan::for_programs;
use host::error::{Cause, ExpectedError};
use host::exit;
use planner::follow::limits::{AXES, Arm};
use planner::follow::plan::{FollowPlan, Step};
use planner::motion::{Knot, Motion};
use planner::plan::file::{PlanFile, PlanFileError};
use planner::record::PlanRecord;
use planner::verify;
use pyo3::prelude::*;
use pyo3::types::PyByteArray;
use robot_model::RobotModel;

use crate::arrays::{array, doubles};
use crate::calls::interruptible;
use crate::errors::{bad, refused};

/// The place of a plan file in messages: it was handed over as text.
pub(crate) const NAME: &str = "in memory";

fn input(error: &impl Cause) -> ExpectedError {
    ExpectedError::bad_input(error)
}

/// A plan from its text, and the robot that it names, or the one given.
pub(crate) fn plan_of(text: &str, robot: Option<&str>) -> Result<(PlanFile, RobotModel), ExpectedError> {
    let path = Path::new(NAME);
    let plan = PlanFile::from_json(path, text).map_err(|error| input(&error))?;
    let robot = RobotModel::load(robot.unwrap_or(&plan.robot.source)).map_err(|error| input(&error))?;
    plan.require_robot(path, &robot).map_err(|error| input(&error))?;
    Ok((plan, robot))
}

/// The arm of a plan that follows the flight, or the one given.
pub(crate) fn arm_of(plan: &FollowPlan, robot: Option<&str>) -> Result<Arm, ExpectedError> {
    let source = robot.unwrap_or(&plan.robot.source);
    let arm = RobotModel::load_with_joints(source, AXES).map_err(|error| input(&error))?;
    plan.require_robot(Path::new(NAME), &arm).map_err(|error| input(&error))?;
    Ok(arm)
}

/// A plan as JSON and what was given up for it, from a request of `cubectl plan throw` as JSON.
#[pyfunction]
pub(crate) fn plan(py: Python<'_>, request: String) -> PyResult<(String, Option<&'static str>)> {
    let planned = interruptible(py, move |stop| for_programs::plan(&request, stop))?;
    planned.map(|planned| (planned.plan.to_json(), planned.note)).map_err(|error| refused(&error))
}

/// A plan that follows the flight as JSON, from a request of `cubectl plan throw` as JSON.
#[pyfunction]
pub(crate) fn plan_follow(py: Python<'_>, request: String) -> PyResult<String> {
    let planned = interruptible(py, move |_| for_programs::follow(&request))?;
    planned.map(|plan| plan.to_json()).map_err(|error| refused(&error))
}

/// Findings of the check by other means than the planner's, as JSON: as `cubectl plan check --json` prints them for the kind of the plan.
#[pyfunction]
#[pyo3(signature = (plan, robot))]
pub(crate) fn check(py: Python<'_>, plan: String, robot: Option<String>) -> PyResult<String> {
    let report = interruptible(py, move |_| {
        let report = match record(&plan).map_err(|error| input(&error))? {
            PlanRecord::Follow(plan) => {
                let arm = arm_of(&plan, robot.as_deref())?;
                follow_json(&follow_findings(&arm, &plan))
            }
            _ => {
                let (plan, robot) = plan_of(&plan, robot.as_deref())?;
                let report = verify::check(&robot, &plan);
                serde_json::to_value(&report)
                    .map_err(|error| ExpectedError::new(exit::BUG, error.to_string()))?
            }
        };
        Ok(report.to_string())
    })?;
    report.map_err(|error: ExpectedError| refused(&error))
}

/// The motion of a plan at times in s: rows of positions, speeds and accelerations.
#[pyfunction]
pub(crate) fn sample<'py>(py: Python<'py>, plan: &str, times: &[u8]) -> PyResult<Bound<'py, PyByteArray>> {
    let plan = record(plan).map_err(|error| bad(&error))?;
    let times = doubles(times)?;
    let rows = match &plan {
        PlanRecord::Throw(plan) => sampled(&plan.motion.to_motion(), &times),
        PlanRecord::Move(plan) => sampled(&plan.motion.to_motion(), &times),
        PlanRecord::Follow(plan) => sampled(&led(plan), &times),
    };
    Ok(array(py, &rows))
}

fn record(text: &str) -> Result<PlanRecord, PlanFileError> {
    PlanRecord::from_json(Path::new(NAME), text)
}

/// The motion on which a robot is led: cubics through position and speed of the set points.
fn led(plan: &FollowPlan) -> Motion {
    let knot = |step: &Step| Knot { t_s: step.t_s, q_rad: step.q_rad.into(), qd_rad_s: step.qd_rad_s.into() };
    Motion { knots: plan.steps.iter().map(knot).collect(), events: Vec::new() }
}

fn sampled(motion: &Motion, times: &[f64]) -> Vec<f64> {
    let mut rows = Vec::with_capacity(3 * motion.start_rad().len() * times.len());
    for t in times {
        let state = motion.at(*t);
        rows.extend(state.q.iter().chain(state.qd.iter()).chain(state.qdd.iter()));
    }
    rows
}

/// Gains with their certificates as TOML, for a robot and a request of `cubectl tune` as JSON.
#[pyfunction]
pub(crate) fn tune(py: Python<'_>, robot: String, request: String) -> PyResult<String> {
    let gains = interruptible(py, move |_| host::cmd::tune::gains(&robot, &request))?;
    gains.map(|gains| gains.to_toml()).map_err(|error| refused(&error))
}

//! `cubectl plan throw` and `plan sweep` for programs: a request as JSON in, plans and part files out; nothing is printed.

use std::sync::atomic::AtomicBool;

use super::args::Args;
use super::search::{Solved, Watcher};
use super::shards::{self, Made};
use super::sweep;
use crate::cmd::request;
use crate::error::ExpectedError;
use planner::follow::limits::AXES;
use planner::follow::plan::FollowPlan;

/// The plan that `cubectl plan throw` makes of this request, as [`Solved`] has it. `stop`, once set, ends the search after the
/// start under way, with what was found by then.
///
/// # Errors
/// A field is refused (exit code 2 of the program), input is refused, or no throw reaches the target. Throws that follow the flight
/// of the ball are made by [`follow`].
pub fn plan(request: &str, stop: &AtomicBool) -> Result<Solved, ExpectedError> {
    let args: Args = request::read("plan throw", request)?;
    let robot = crate::cmd::robot(&args.search.options.robot)?;
    if robot.n() == AXES && args.follow.apply_to(&robot) {
        return Err(ExpectedError::bad_input(
            &"this throw would follow the flight of the ball, which is another kind of plan",
        )
        .next("call `plan_follow`, or ask for `no_follow`"));
    }
    args.require_ordinary()?;
    let starts = args.search.options.starts(&robot);
    args.search.solve(&robot, &starts, args.target, (args.seed, args.fast), Watcher::Program(stop), None)
}

/// The plan that `cubectl plan throw` makes of this request for a throw that follows the flight of the ball.
///
/// # Errors
/// As [`plan`]; and the robot has not six joints, or throws in the ordinary way and `follow` is not asked for.
pub fn follow(request: &str) -> Result<FollowPlan, ExpectedError> {
    let args: Args = request::read("plan throw", request)?;
    let arm = crate::cmd::six_axes(&args.search.options.robot)?;
    if !args.follow.apply_to(&arm) {
        return Err(ExpectedError::bad_input(&format!(
            "robot \"{}\" throws in the ordinary way by default",
            arm.name()
        ))
        .next("ask for `follow`"));
    }
    Ok(super::follow::plan(&args, &arm)?.plan)
}

/// Makes the shards that this request of `cubectl plan sweep` asks for. `stop`, once set, ends it; shards that are whole stay.
///
/// # Errors
/// A field is refused (exit code 2 of the program), input is refused, a file cannot be read or written, or it was stopped.
pub fn sweep(request: &str, stop: &AtomicBool) -> Result<Made, ExpectedError> {
    let args: sweep::Args = request::read("plan sweep", request)?;
    sweep::make_shards(&args, Watcher::Program(stop))
}

/// What the parts of a sweep say together, as the JSON of `cubectl plan sweep --summary FOLDER --json`.
pub fn sweep_summary(folder: &std::path::Path) -> Result<String, ExpectedError> {
    shards::summary(folder).map(|(_, json)| json.to_string())
}

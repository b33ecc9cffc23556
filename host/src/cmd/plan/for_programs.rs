//! `cubectl plan throw` for programs: words of its command line in, a plan file out; nothing is printed.

use std::sync::atomic::AtomicBool;

use super::args::Args;
use super::search::{Planned, Watcher};
use crate::cmd::words;
use crate::error::ExpectedError;
use planner::plan::file::PlanFile;
use robot_model::{AnyRobot, for_any_robot};

/// The plan that `cubectl plan throw` makes of these words, as [`Planned`] has it. `stop`, once set, ends the search after the
/// start under way, with what was found by then.
///
/// # Errors
/// A word is refused (exit code 2 of the program), input is refused, or no throw reaches the target. Throws that follow the flight
/// of the ball and lists of targets are for the program alone.
pub fn plan(words: &[String], stop: &AtomicBool) -> Result<Planned<PlanFile>, ExpectedError> {
    let args: Args = words::parse("plan throw", words)?;
    let refused = |why: &str| ExpectedError::bad_input(&format!("{why}: run `cubectl plan throw`"));
    let Some(target) = args.target.filter(|_| args.targets.is_none()) else {
        return Err(refused("lists of targets are for the program"));
    };
    if args.out.is_some() || args.report.is_some() || args.json {
        return Err(refused("--out, --report and --json are for the program"));
    }
    let robot = crate::cmd::robot(&args.search.options.robot)?;
    if let AnyRobot::Six(arm) = &robot {
        if args.follow.apply_to(arm) {
            return Err(refused("throws that follow the flight of the ball are for the program"));
        }
        if let Some(option) = args.follow.first_given() {
            return Err(refused(&format!("{option} is for throws that follow the flight of the ball")));
        }
    }
    for_any_robot!(&robot, arm => {
        let mut starts = args.search.options.starts(arm)?;
        args.search.plan_from(arm, &mut starts, target, (args.seed, args.fast), Watcher::Program(stop))
    })
}

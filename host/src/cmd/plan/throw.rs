//! `cubectl plan throw --target x,y,z`

use super::args::Args;
use super::search::{Solved, Watcher};
use super::{follow, require_writable};
use crate::cmd::meaning::Deed;
use crate::error::ExpectedError;
use crate::exit;
use crate::report::plan as plan_report;
use planner::follow::limits::AXES;
use robot_model::RobotModel;

pub fn run(args: &Args) -> Result<(), ExpectedError> {
    for path in args.out.iter().chain(&args.report) {
        require_writable(path)?;
    }
    let name = &args.search.options.robot;
    let robot = crate::cmd::robot(name)?;
    if robot.n() == AXES && args.follow.apply_to(&robot) {
        return follow::run(args, &robot);
    }
    args.require_ordinary()?;
    run_for(&robot, args)
}

impl Args {
    /// Refuses what means nothing for a throw with the release at one instant.
    pub(super) fn require_ordinary(&self) -> Result<(), ExpectedError> {
        let asked = self.search.options.deeds(false);
        self.given.require_meaning(&[vec![Deed::Ordinary], asked].concat())
    }
}

fn run_for(arm: &RobotModel, args: &Args) -> Result<(), ExpectedError> {
    let starts = args.search.options.starts(arm);
    let Solved { plan, took, .. } =
        args.search.solve(arm, &starts, args.target, (args.seed, args.fast), Watcher::Terminal, None)?;
    if let Some(path) = &args.out {
        plan.write(path).map_err(|e| ExpectedError::of(exit::OUTPUT, &e))?;
    }
    if let Some(path) = &args.report {
        std::fs::write(path, plan_report::html(arm, &plan)).map_err(|e| ExpectedError::output(path, &e))?;
    }
    if args.json {
        console::line!("{}", plan.to_json());
    } else {
        console::text!("{}", plan_report::summary(&plan, took));
    }
    Ok(())
}

//! `cubectl run`

use std::path::PathBuf;

use protocol::Duration;

use super::controller::upload::read;
use super::link::{Link, Machine};
use super::path_file::RetimeArgs;
use super::program_file::is_program;
use super::program_run;
use super::results::Results;
use super::target::Moving;
use crate::error::ExpectedError;
use operator::job::{Order, Tolerances, perform};
use planner::plan::Joints;

/// Longest time that a run is ordered ahead, s: the controller takes 30 s, of which the order needs a little.
const START_IN_MAX_S: f64 = 29.0;

/// Longest time from the planned end of a motion until its end is judged, s.
const GOAL_TIME_MAX_S: f64 = 60.0;

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:\n  cubectl run plan.json --bus can0 --record throw1\n\nThe arm must be homed and stand where the plan begins (`cubectl throw --plan` moves it\nthere); to the first of waypoints it goes by itself. On every bus but `sim` it asks first; without a terminal it needs --yes. Ctrl-C stops it along its path."
)]
pub struct Args {
    /// Plan (JSON), waypoints (CSV, or JointTrajectory as JSON or YAML), program (TOML), or trajectory file of a controller.
    pub file: PathBuf,
    /// Do the steps of a program so often.
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub repeat: u32,
    #[command(flatten)]
    pub moving: Moving,
    /// Begin the plan this many seconds after the order, at a time of the controller's clock; it waits armed.
    #[arg(long = "start-in-s", alias = "start-in", value_name = "SECONDS", value_parser = super::values::at_most(START_IN_MAX_S, "s"))]
    pub start_in: Option<f64>,
    /// Longest time for the run, s.
    #[arg(long = "timeout-s", alias = "timeout", default_value_t = 60.0, value_name = "SECONDS", value_parser = super::values::positive)]
    pub timeout: f64,
    /// Folder for plan.json, bus.log, bus.mcap, summary.json and report.html; of a program cycles.csv instead of plan.json.
    #[arg(long, value_name = "DIR", conflicts_with = "record")]
    pub out: Option<PathBuf>,
    #[command(flatten)]
    pub tolerance: ToleranceArgs,
    #[command(flatten)]
    pub retime: RetimeArgs,
}

#[derive(Debug, Clone, Default, clap::Args)]
#[command(next_help_heading = "Tolerances (as those of the JointTrajectoryController of ros2_control)")]
pub struct ToleranceArgs {
    /// A joint farther from its motion than this is not on it: one number for all joints, or one for each, rad [default: 0.05].
    #[arg(long, value_name = "RAD,..", value_delimiter = ',', value_parser = super::values::positive)]
    pub path_tolerance_rad: Vec<f64>,
    /// A joint farther from the end of its motion than this is not there, rad [default: 0.01].
    #[arg(long, value_name = "RAD,..", value_delimiter = ',', value_parser = super::values::positive)]
    pub goal_tolerance_rad: Vec<f64>,
    /// The end is judged so long after the planned end, s [default: 0.25].
    #[arg(long, value_name = "SECONDS", value_parser = super::values::within(0.0..=GOAL_TIME_MAX_S, "s"))]
    pub goal_time_s: Option<f64>,
}

impl ToleranceArgs {
    /// Those of an arm with so many joints.
    pub(super) fn of(&self, joints: usize) -> Result<Tolerances, ExpectedError> {
        let usual = Tolerances::usual(joints);
        let each = |option: &str, given: &[f64], usual: Joints| match given {
            [] => Ok(usual),
            [all] => Ok(Joints::repeat(joints, *all)),
            given if given.len() == joints => Ok(Joints::from_slice(given)),
            given => Err(ExpectedError::bad_input(&format!(
                "{option} has {} numbers for an arm of {joints} joints",
                given.len()
            ))
            .next("give one number, or one for each joint")),
        };
        Ok(Tolerances {
            path_rad: each("--path-tolerance-rad", &self.path_tolerance_rad, usual.path_rad)?,
            goal_rad: each("--goal-tolerance-rad", &self.goal_tolerance_rad, usual.goal_rad)?,
            goal_time: self.goal_time_s.map_or(usual.goal_time, Duration::from_secs_f64),
        })
    }
}

pub fn run(args: &Args) -> Result<(), ExpectedError> {
    if is_program(&args.file) {
        return program_run::run(args);
    }
    if args.repeat > 1 {
        return Err(ExpectedError::bad_input("--repeat is for programs (TOML); this file is run once")
            .next("leave --repeat out, or make the file a `path` step of a program"));
    }
    let mut ui = args.moving.ui("The arm follows the trajectory. Nobody near?", true)?;
    let mut on = args.moving.on.of_robot()?;
    let source = read(&args.file, on.bus.cell.robot.as_deref(), &args.retime)?;
    on.bus.cell.robot = Some(source.robot.clone());
    let machine = Machine::of(&on)?;
    if machine.is_led() && args.start_in.is_some() {
        return Err(ExpectedError::bad_input("--start-in-s is for a controller with a clock of its own")
            .next("leave --start-in-s out"));
    }
    let results = Results::create(args.out.as_deref(), &mut on.bus)?;
    let order = Order {
        homes: args.moving.home,
        start_in: args.start_in.map(Duration::from_secs_f64),
        patience: Duration::from_secs_f64(args.timeout),
        tolerances: args.tolerance.of(source.arm.n())?,
        travel: source.travels.then(|| machine.travel(args.retime.share(), 1)),
        ..source.order()
    };
    results.write_plan(&machine, order.program.motion())?;
    let link = Link::open(&on, &machine, results.folder(), args.moving.json)?;
    let mut link = link.watched(&args.moving.web, &machine)?;
    let record = link.with(|operator| perform(operator, &order, &mut |step| ui.answer(step)));
    results.conclude(link, &ui, (&order, record), &machine, |record| {
        let end = record.states.last().map(|(_, group)| *group).unwrap_or_default();
        console::line!("{}", record.verdict.text);
        console::line!(
            "{} late cycles, {} missed replies, {} saturated cycles",
            end.cycles_late,
            end.replies_missed,
            end.cycles_saturated
        );
    })
}

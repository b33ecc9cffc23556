//! `cubectl run`

use std::path::PathBuf;

use protocol::Duration;

use super::link::{Link, Machine};
use super::path_file::RetimeArgs;
use super::program_file::is_program;
use super::program_run;
use super::results::Results;
use super::target::Moving;
use super::upload::read;
use crate::error::ExpectedError;
use operator::job::{Order, perform};

/// Longest time that a run is ordered ahead, s: the controller takes 30 s, of which the order needs a little.
const START_IN_MAX_S: f64 = 29.0;

/// Arguments.
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
    /// The arm.
    #[command(flatten)]
    pub moving: Moving,
    /// Begin the plan this many seconds after the order, at a time of the controller's clock; it waits armed.
    #[arg(long, value_name = "SECONDS", value_parser = start_in)]
    pub start_in: Option<f64>,
    /// Longest time for the run, s.
    #[arg(long, default_value_t = 60.0, value_name = "SECONDS", value_parser = super::home::positive)]
    pub timeout: f64,
    /// Folder for plan.json, bus.log, bus.mcap, summary.json and report.html; of a program cycles.csv instead of plan.json.
    #[arg(long, value_name = "DIR", conflicts_with = "record")]
    pub out: Option<PathBuf>,
    /// Times of waypoints.
    #[command(flatten)]
    pub retime: RetimeArgs,
}

fn start_in(text: &str) -> Result<f64, String> {
    let seconds = super::home::positive(text)?;
    if seconds <= START_IN_MAX_S { Ok(seconds) } else { Err(format!("must be at most {START_IN_MAX_S} s")) }
}

/// Runs the verb.
///
/// # Errors
/// The file, the bus, no controller, its refusal, a stop or fault on the way, or an arm that does not follow.
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
        return Err(ExpectedError::bad_input("--start-in is for a controller with a clock of its own")
            .next("leave --start-in out"));
    }
    let results = Results::create(args.out.as_deref(), &mut on.bus)?;
    let order = Order {
        homes: args.moving.home,
        start_in: args.start_in.map(Duration::from_secs_f64),
        patience: Duration::from_secs_f64(args.timeout),
        travel: source.travels.then(|| machine.travel(args.retime.share(), 1)),
        ..source.order()
    };
    results.write_plan(&machine, order.program.motion())?;
    let mut link = Link::open(&on, &machine, results.folder(), args.moving.json)?;
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

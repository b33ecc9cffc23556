//! `cubectl run`

use std::path::PathBuf;

use protocol::Duration;
use protocol::cyphal::id::NodeId;

use super::consent::Consent;
use super::controlled::tell_warnings;
use super::ended::{Seen, failure, off_target, outcome_last};
use super::path_file::RetimeArgs;
use super::print_json;
use super::program_file::is_program;
use super::program_run;
use super::progress::{ProgressView, Ui};
use super::report::BIT_RATE;
use super::results::Results;
use super::upload::{node_id, read};
use crate::error::ExpectedError;
use operator::bus::BusArgs;
use operator::bus::key_file::KeyArgs;
use operator::job::{Order, perform};
use operator::port::OnBus;
use planner::way::Travel;

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
    /// Bus options; on the bus `sim` a soft controller is in the cell.
    #[command(flatten)]
    pub bus: BusArgs,
    /// Key of the controller.
    #[command(flatten)]
    pub key: KeyArgs,
    /// Cyphal node-ID of the controller. Default: the one that is heard.
    #[arg(long, value_name = "NODE-ID", value_parser = node_id)]
    pub controller: Option<NodeId>,
    /// Home what is not homed first.
    #[arg(long)]
    pub home: bool,
    /// Begin the plan this many seconds after the order, at a time of the controller's clock; it waits armed.
    #[arg(long, value_name = "SECONDS", value_parser = start_in)]
    pub start_in: Option<f64>,
    /// Do not ask before the arm moves.
    #[arg(long)]
    pub yes: bool,
    /// Longest time for the run, s.
    #[arg(long, default_value_t = 60.0, value_name = "SECONDS", value_parser = super::home::positive)]
    pub timeout: f64,
    /// Folder for plan.json, bus.log, bus.mcap, summary.json and report.html; of a program for cycles.csv, bus.log, bus.mcap and summary.json.
    #[arg(long, value_name = "DIR", conflicts_with = "record")]
    pub out: Option<PathBuf>,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
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
    let consent = Consent::on(&args.bus.bus, args.yes)?;
    let source = read(&args.file, args.bus.cell.robot.as_deref(), &args.retime)?;
    let key = args.key.load()?;
    let mut bus = args.bus.clone();
    let results = Results::create(args.out.as_deref(), &mut bus)?;
    let mut session = bus.open_with_controller()?;
    session.set_key(key);
    let order = Order {
        homes: args.home,
        start_in: args.start_in.map(Duration::from_secs_f64),
        patience: Duration::from_secs_f64(args.timeout),
        travel: source.travels.then(|| Travel { share: args.retime.share(), ..Travel::default() }),
        ..source.order()
    };
    let words = ["The arm follows the trajectory. Nobody near?"; 2];
    let mut ui = Ui { progress: ProgressView::new(args.json), consent, words, look: None, agreed: false };
    let mut operator = OnBus::new(&mut session, args.controller, BIT_RATE);
    let record = perform(&mut operator, &order, &mut |step| ui.answer(step));
    ui.progress.quiet();
    tell_warnings(&mut session);
    let wrong = failure(&record).or_else(|| off_target(&record, &order.judge));
    let seen = Seen::of(&session);
    let mut finished = session.finish().map_err(ExpectedError::from);
    let summary = seen.summary(&order, &record, wrong.as_ref(), &ui.progress.wall_s);
    if let Some(results) = &results {
        let motion = order.program.motion();
        let written = results.write_plan(source.robot_id(), &source.arm, motion);
        finished = finished.and(written).and(results.write(&source.robot, summary.clone()));
    }
    if args.json {
        print_json(&summary);
    } else if wrong.is_none() {
        let end = record.states.last().map(|(_, group)| *group).unwrap_or_default();
        console::line!("{}", record.verdict.text);
        console::line!(
            "{} late cycles, {} missed replies, {} saturated cycles",
            end.cycles_late,
            end.replies_missed,
            end.cycles_saturated
        );
    }
    if let (Some(results), None, false) = (&results, &wrong, args.json) {
        console::line!("results in {}", results.path().display());
    }
    outcome_last(wrong, finished, results.as_ref().map(Results::path))
}

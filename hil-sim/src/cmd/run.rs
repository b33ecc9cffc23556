//! `hil-sim run SCENARIO`: virtual time.

use std::fs::File;
use std::io::BufWriter;
use std::path::PathBuf;
use std::time::Instant as WallClock;

use hil_sim::Observer;
use hil_sim::record::CandumpLog;
use hil_sim::report::{DriveRow, RunReport, ThrowRow};
use hil_sim::scenario::Scenario;
use protocol::text::BusName;
use protocol::{Duration, Frame, Instant};

use super::exit::{Code, Failure};
use super::progress::{self, Interrupt};

/// Simulated time between two looks at the clock and at Ctrl-C.
const SLICE: Duration = Duration::from_millis(20);

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Scenario file (TOML).
    scenario: PathBuf,
    /// Seed instead of the scenario's.
    #[arg(long)]
    seed: Option<u64>,
    /// Robot instead of the scenario's: a built-in name or a file.
    #[arg(long)]
    robot: Option<String>,
    /// Write a candump log of all good frames.
    #[arg(long, value_name = "FILE")]
    log: Option<PathBuf>,
    /// Print the report as JSON.
    #[arg(long)]
    json: bool,
    /// No progress, no report.
    #[arg(long, short)]
    quiet: bool,
}

/// A log, if one is wanted.
struct MaybeLog<'a>(Option<CandumpLog<'a, BufWriter<File>>>);

impl Observer for MaybeLog<'_> {
    fn on_frame(&mut self, at: Instant, from: Option<usize>, frame: &Frame) {
        if let Some(log) = &mut self.0 {
            log.on_frame(at, from, frame);
        }
    }
}

pub(super) fn run(args: &Args) -> Result<(), Failure> {
    let mut scenario = Scenario::load(&args.scenario)?;
    if let Some(seed) = args.seed {
        scenario.seed = seed;
    }
    if let Some(robot) = &args.robot {
        scenario.robot.clone_from(robot);
    }
    let mut world = scenario.world()?;
    let mut checkers = scenario.checkers(&world.participants().0);
    let mut log = MaybeLog(open_log(args)?);
    let interrupt = Interrupt::listen();
    let bar = progress::bar(scenario.duration.as_micros(), args.quiet || args.json);
    if !args.quiet && !args.json {
        console::note!(
            "{}: robot {}, seed {}, {}",
            scenario.name,
            scenario.robot,
            scenario.seed,
            scenario.duration
        );
    }
    let start = WallClock::now();
    let end = Instant::ZERO + scenario.duration;
    while world.now() < end && !interrupt.came() {
        world.run_until(end.min(world.now() + SLICE), &mut (&mut log, &mut checkers))?;
        bar.set_position(world.now().as_micros());
        let passed = world.now().as_secs_f64() / start.elapsed().as_secs_f64().max(1e-9);
        bar.set_message(format!("{} s, {passed:.0} x real time", world.now()));
    }
    bar.finish_and_clear();
    if let Some(log) = log.0 {
        log.finish()
            .map_err(|error| Failure::new(Code::Output, &format!("the log is incomplete: {error}")))?;
    }
    let cell = &world.participants().0;
    let report = RunReport {
        name: scenario.name.clone(),
        robot: scenario.robot.clone(),
        seed: scenario.seed,
        simulated_s: world.now().as_secs_f64(),
        wall_s: start.elapsed().as_secs_f64(),
        world: world.stats(),
        bus: world.bus_report(),
        drives: DriveRow::of(cell),
        throw: ThrowRow::of(cell),
        faults: world.faults().counts(),
        checks: checkers.finish(world.now(), &scenario.expect),
    };
    if args.json {
        console::line!(
            "{}",
            serde_json::to_string_pretty(&report).map_err(|e| Failure::new(Code::Output, &e))?
        );
    } else if !args.quiet {
        console::text!("{report}");
        if interrupt.came() {
            console::line!("stopped by a signal at {} s", world.now());
        }
    }
    if let Some(what) = report.not_finite() {
        return Err(Failure::new(Code::Defect, &format!("a number is none: {what}")));
    }
    if report.as_expected() || interrupt.came() { Ok(()) } else { Err(Failure::silent(Code::NotAsExpected)) }
}

fn open_log(args: &Args) -> Result<Option<CandumpLog<'static, BufWriter<File>>>, Failure> {
    let Some(path) = &args.log else { return Ok(None) };
    let file = File::create(path).map_err(|error| {
        Failure::new(Code::Output, &format!("cannot write the log {}: {error}", path.display()))
    })?;
    let Ok(bus) = BusName::new("can0") else { return Ok(None) };
    Ok(Some(CandumpLog::new(BufWriter::new(file), bus)))
}

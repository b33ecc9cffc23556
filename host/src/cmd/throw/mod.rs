//! `cubectl throw`

mod folder;
mod last_look;
mod prepare;
mod progress;
pub mod robot;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Instant as WallTime;

use can_link::BusSpec;
use planner::follow::limits::AXES;
use toml_reader::{DESCRIPTION_MAX_BYTES, read_text};

use self::folder::Folder;
pub(super) use self::prepare::period_request;
use self::prepare::{Prepared, diagnosis, prepare};
use self::progress::ProgressView;
use super::consent::Consent;
use super::controlled::tell_warnings;
use super::home::share;
use super::meaning::{Deed, Given};
use super::plan::follow::is_industrial;
use super::plan::search::SearchOptions;
use super::print_json;
use super::report;
use super::tracker::{TargetArg, TrackerArgs};
use super::tune::InForce;
use super::web::WebArgs;
use crate::error::ExpectedError;
use crate::exit;
use operator::bus::args::Controller;
use operator::bus::key_file::KeyArgs;
use operator::bus::period::{NoPeriod, PERIOD_MAX_US, PERIOD_MIN_US};
use operator::bus::soft::SoftReport;
use operator::bus::{BusArgs, Session};
use operator::dialogue::operator::OperatorError;
use operator::interrupt::interrupt;
use operator::port::OnBus;
use operator::throw::job::{Answer, Progress, Question};
use operator::throw::outcome::{Outcome, judge};
use operator::throw::summary::{Circumstances, summary};
use operator::throw::{JobError, Record, Step, Verdict, job};
use tuner::gains::choose::GainsFrom;
use tuner::gains::gains_file::GainsFile;

/// Arguments.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl throw --target 1.0,1.0,-1.0                      # in the simulated cell\n  cubectl throw --target 1.0,1.0,-1.0 --bus can0            # a controller that is heard there, else one in this program\n  cubectl throw --plan plan.json --bus can0 --controller 10\n  cubectl throw --robot kr16_2 --target 2.5,0,0.6           # an industrial robot, inside this program, over RSI\n  cubectl throw --robot kr16_2 --target tracker --bus rsi:udp://0.0.0.0:49152\n\nWrites plan.json, gains.toml, bus.log, bus.mcap, summary.json and report.html into a new folder. Ctrl-C, SIGTERM and\nSIGHUP stop the arm along its path, then end the program with code 6. On every bus but `sim` it asks before the arm moves and\nonce more before the ball is thrown; without a terminal it needs --yes.\n\nOutcomes and exit codes: landed 0, missed 11, not released 12, stopped 13. Only the bus `sim` sees the ball. On every\nother bus the outcome is \"thrown, not observed\" (0): the program then says when the release was ordered and where the\nmeasured motion sends the ball. A drive that has lost encoder counts tells a wrong position without knowing it; nothing\nin its answers shows that."
)]
pub struct Args {
    /// What stands on the command line.
    #[command(flatten)]
    pub given: Given,
    /// Target in m, world frame (arm base, z up), or `tracker`: where an optical tracker sees it.
    #[arg(long, value_name = "X,Y,Z|tracker", allow_hyphen_values = true, required_unless_present = "plan")]
    pub target: Option<TargetArg>,
    /// Throw this plan instead of making one.
    #[arg(long, value_name = "FILE", conflicts_with = "target")]
    pub plan: Option<PathBuf>,
    /// Bus: sim (the cell inside this program, in virtual time), can0, socketcand://host:port/bus,
    /// slcan:/dev/ttyACM0 or slcan://host:port.
    #[arg(long, default_value = "sim", value_name = "SPEC", help_heading = "Bus")]
    pub bus: BusSpec,
    /// Key of the controller.
    #[command(flatten)]
    pub key: KeyArgs,
    /// `soft`: a controller in this program. A number: the one with this Cyphal node-ID. Default: the one that is
    /// heard, else a soft one.
    #[arg(long, value_name = "soft|NODE-ID", help_heading = "Controller")]
    pub controller: Option<Controller>,
    /// Gains with their certificate, from `cubectl tune`; a controller in this program runs at their period. Default: for
    /// a controller in this program those that come with it for powercube6, and a design made on the way for any other
    /// robot; else those that the controller on the bus has.
    #[arg(long, value_name = "FILE", help_heading = "Controller")]
    pub gains: Option<PathBuf>,
    /// Control period of a controller in this program, ms: 3, 5, 10, 17 or 30. Default: the shortest one that this machine
    /// and this bus hold, which is measured first.
    #[arg(long, value_name = "MS", conflicts_with = "gains", value_parser = period_us, help_heading = "Controller")]
    pub period: Option<u32>,
    /// Seed of the planner and of the simulated cell [default: the scenario's, or 1].
    #[arg(long, help_heading = "Simulated cell")]
    pub seed: Option<u64>,
    /// Scenario of the simulated cell: its options, and what goes wrong (`cubectl explain faults` lists the kinds).
    #[arg(long, value_name = "FILE", help_heading = "Simulated cell")]
    pub scenario: Option<PathBuf>,
    /// Folder for the results [default: throw-DATE-TIME].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print the summary as JSON.
    #[arg(long)]
    pub json: bool,
    /// Look for the cheapest throw with random starts too, for some seconds.
    #[arg(long)]
    pub thorough: bool,
    /// Share of the robot's speeds and accelerations on the way to the start.
    #[arg(long, default_value_t = 0.3, value_name = "SHARE", value_parser = share)]
    pub approach_share: f64,
    /// A landing farther from the target than this is a miss, m [default: the distance within which 99 % of the landings
    /// of the plan lie, computed again, from 0.010 to 0.100].
    #[arg(long, value_name = "M", value_parser = super::home::positive)]
    pub tolerance: Option<f64>,
    /// Afterwards go back to where the arm stood. Default: stay where the throw ends.
    #[arg(long)]
    pub back: bool,
    /// Do not ask before the arm moves and before the ball is thrown.
    #[arg(long)]
    pub yes: bool,
    /// Description of an industrial robot and its program: kr-c2, kr-c2-tcp, kr-c4, kr-c4-12ms, or a file as in robots/kr16_2
    /// [default: kr-c2; with --scenario its program].
    #[arg(long, value_name = "DESCRIPTION", help_heading = "Bus")]
    pub rsi: Option<String>,
    /// Live view in a browser.
    #[command(flatten)]
    pub web: WebArgs,
    /// Where the target is measured with `--target tracker`.
    #[command(flatten)]
    pub tracker: TrackerArgs,
    /// How to look for a throw.
    #[command(flatten)]
    pub search: SearchOptions,
}

/// Runs the verb.
///
/// # Errors
/// No throw, a plan that does not fit, the bus, the controller, the disk, or Ctrl-C. The exit code tells them apart.
pub fn run(args: &Args) -> Result<(), ExpectedError> {
    let arm = super::robot(&args.search.options.robot)?;
    if arm.n() == AXES && is_industrial(&arm) {
        return robot::run(args, &arm);
    }
    args.given.require_meaning(&args.deeds(&[Deed::OnCan]))?;
    let consent = Consent::on(&args.bus, args.yes)?;
    let begun = WallTime::now();
    let prepared = prepare(args)?;
    let folder = Folder::create(args.out.as_deref())?;
    prepared.plan.write(&folder.file("plan.json")).map_err(|error| output(&error))?;
    let mut progress = ProgressView::new(args.json);
    prepared.show(&mut progress);
    let mut thrown = throw(args, &prepared, &folder, (&mut progress, consent))?;
    let written = write_summary(args, &prepared, &thrown, &folder, &progress);
    let said = thrown.wrong.is_none().then_some(&thrown.verdict);
    progress.closing(&thrown.record, said, &folder.path, begun);
    outcome_last(thrown.wrong.take(), written, &folder)
}

/// How a throw ends: a result that could not be written never hides the outcome.
fn outcome_last(
    wrong: Option<ExpectedError>,
    written: Result<(), ExpectedError>,
    folder: &Folder,
) -> Result<(), ExpectedError> {
    let Some(mut error) = wrong else { return written };
    error.message += &format!("\n  results in {}", folder.path.display());
    if let Err(lost) = written {
        error.message += &format!("; not all of them: {}", lost.message);
    }
    Err(error)
}

impl Args {
    /// What is asked here, besides `asked`.
    fn deeds(&self, asked: &[Deed]) -> Vec<Deed> {
        let mut deeds = asked.to_vec();
        match &self.plan {
            Some(_) => deeds.push(Deed::PlanOfFile),
            None if asked.contains(&Deed::OnCan) => deeds.extend(self.search.options.deeds(false)),
            None => {}
        }
        deeds.extend((!matches!(self.target, Some(TargetArg::Tracker))).then_some(Deed::TargetGiven));
        deeds.extend((self.bus != BusSpec::Sim).then_some(Deed::Live));
        deeds
    }
}

/// What a throw left behind.
struct Thrown {
    record: Record,
    verdict: Verdict,
    /// What went wrong first.
    wrong: Option<ExpectedError>,
    bus_name: String,
    simulated: bool,
    bus_errors: usize,
    soft: Option<SoftReport>,
}

/// Throws on the bus: opens it, runs the job, judges the outcome, closes it.
fn throw(
    args: &Args,
    prepared: &Prepared,
    folder: &Folder,
    (progress, mut consent): (&mut ProgressView, Consent),
) -> Result<Thrown, ExpectedError> {
    let bus = BusArgs {
        bus: args.bus.clone(),
        cell: prepared.cell_args.clone(),
        record: Some(folder.file(operator::log::FOLDER_NAME)),
        beside: false,
        rsi: None,
    };
    let key = args.key.load()?;
    let mut session = bus.open_cell(&prepared.cell, prepared.soft.then_some(&prepared.settings))?;
    session.set_key(key);
    let job = prepared.job(args);
    let stop = interrupt();
    let _page =
        args.web.serve(&mut session, &prepared.cell.robot, Some(&prepared.plan), Arc::clone(&stop))?;
    let mut record = Record::default();
    let mut gone = None;
    let wanted = match args.controller {
        Some(Controller::Node(node)) => Some(node),
        Some(Controller::Soft) | None => None,
    };
    let mut operator = OnBus::new(&mut session, wanted, report::BIT_RATE);
    let ended = job::run(&mut operator, &job, &mut record, &mut |step| match step {
        Progress::May(_) if stop.load(Ordering::Relaxed) => Answer::No,
        Progress::May(question) => match progress.look(&mut consent, question) {
            Answer::Yes if question == Question::Throw => {
                gone = prepared.tracked.as_ref().and_then(|before| args.tracker.still_there(before).err());
                if gone.is_none() { Answer::Yes } else { Answer::No }
            }
            answer => answer,
        },
        other => {
            progress.show(other);
            Answer::Yes
        }
    });
    progress.quiet();
    tell_warnings(&mut session);
    let verdict = judge(&job, &record, ended.as_ref().copied());
    let failed = gone.or_else(|| {
        let error = ended.err()?;
        Some(explained(error, &record, &verdict, &mut session, prepared, &args.bus))
    });
    let (bus_name, simulated, bus_errors) =
        (session.name().to_owned(), session.is_simulated(), session.bus_errors().len());
    let soft = session.finish_controller();
    let closed = session.finish().map_err(ExpectedError::from);
    let wrong = failed.or_else(|| off_target(&verdict)).or(closed.err());
    Ok(Thrown { record, verdict, wrong, bus_name, simulated, bus_errors, soft })
}

/// The error of a job, with what the drives say about it and the next step.
fn explained(
    error: JobError,
    record: &Record,
    verdict: &Verdict,
    session: &mut Session,
    prepared: &Prepared,
    bus: &BusSpec,
) -> ExpectedError {
    let by_controller = matches!(error, JobError::Operator(_));
    let mut error = failure(error, record, verdict.outcome);
    if prepared.soft
        && by_controller
        && record.at_work.is_some_and(|(step, _)| step == Step::Drives)
        && error.code == exit::DRIVE
        && let Ok(Some(found)) = session.put_back(|session| diagnosis(session, &prepared.arm, |_| true))
    {
        error.message = format!("{}\n{found}", error.message);
    }
    if verdict.outcome == Outcome::Stopped && !session.is_simulated() {
        // Drives stay halted, and a controller of its own keeps its fault.
        error.message += &format!("; then `cubectl clear --bus {bus}`");
    }
    error
}

/// Writes gains, summary and report.
fn write_summary(
    args: &Args,
    prepared: &Prepared,
    thrown: &Thrown,
    folder: &Folder,
    progress: &ProgressView,
) -> Result<(), ExpectedError> {
    let gains_text = gains_toml(&thrown.record, prepared.gains.as_ref());
    let wrong = thrown.wrong.as_ref();
    let circumstances = Circumstances {
        bus: &thrown.bus_name,
        time: if thrown.simulated { "virtual time" } else { "real time" },
        controller: if prepared.soft { "soft" } else { "node" },
        seed: prepared.cell.seed,
        exit_code: wrong.map_or(exit::OK, |error| error.code),
        cause: wrong.map(|error| error.message.as_str()),
        bus_errors: thrown.bus_errors,
        wall_s: &progress.wall_s,
        plan_s: prepared.plan_s,
        gains_from: match (&prepared.choice, args.gains.is_some()) {
            (Some(choice), _) => choice.gains_from,
            (None, true) => GainsFrom::Given,
            (None, false) => GainsFrom::Controller,
        },
        gains_crc32: gains_text.as_ref().map(|text| firmware::crc::Crc32::of(text.as_bytes())),
        soft: thrown.soft.as_ref(),
        period_why: prepared.choice.as_ref().map_or("the controller's", |choice| choice.why),
        timing: prepared.timing.as_ref(),
    };
    let mut value = summary(&prepared.job(args), &thrown.record, &thrown.verdict, &circumstances);
    value["command_line"] = std::env::args().collect::<Vec<_>>().join(" ").into();
    let written = write_results(folder, &value, gains_text.as_deref(), &args.search.options.robot);
    if let (Err(lost), None) = (&written, wrong) {
        (value["exit_code"], value["cause"]) = (lost.code.into(), lost.message.as_str().into());
    }
    if args.json {
        print_json(&value);
    }
    written
}

/// Gains, summary and report. The report is made from the files, as `cubectl report` makes it.
fn write_results(
    folder: &Folder,
    summary: &serde_json::Value,
    gains: Option<&str>,
    robot: &str,
) -> Result<(), ExpectedError> {
    folder.write("summary.json", &format!("{summary:#}\n"))?;
    if let Some(gains) = gains {
        folder.write("gains.toml", gains)?;
    }
    let files = ["plan.json", "bus.log", "summary.json"].map(|name| folder.file(name));
    let [plan, log, summary] = &files;
    let recorded = report::read(plan, log, Some(summary), Some(robot), report::BIT_RATE)?;
    report::write(&recorded, &folder.file("report.html"))
}

/// The error that a verdict about the ball makes; `None` if it is where it should be, as far as is known.
fn off_target(verdict: &Verdict) -> Option<ExpectedError> {
    let next = match verdict.outcome {
        Outcome::Missed => {
            "`cubectl report` on the folder shows tracking and release; `cubectl home --verify` tells whether a drive \
             has lost encoder counts"
        }
        Outcome::NotReleased => {
            "take the ball out of the hand before anything moves; check the gripper, its supply and its output"
        }
        _ => return None,
    };
    let code = exit::of_outcome(verdict.outcome)?;
    Some(ExpectedError::new(code, format!("{}\n  next: {next}", verdict.text)))
}

pub(super) fn read_gains(path: &Path, robot: &str) -> Result<GainsFile, ExpectedError> {
    let text = read_text(path, DESCRIPTION_MAX_BYTES).map_err(|error| ExpectedError::io(path, &error))?;
    GainsFile::from_toml(&text, robot)
        .map_err(|error| ExpectedError::bad_input(&format!("{}: {error}", path.display())))
}

/// `3`, `5`, … as µs.
pub(super) fn period_us(text: &str) -> Result<u32, String> {
    let ms = super::home::positive(text)?;
    let us = (1e3 * ms).round();
    if (f64::from(PERIOD_MIN_US)..=f64::from(PERIOD_MAX_US)).contains(&us) {
        Ok(us as u32)
    } else {
        Err(format!("must be from {} to {} ms", PERIOD_MIN_US / 1_000, PERIOD_MAX_US / 1_000))
    }
}

impl From<NoPeriod> for ExpectedError {
    fn from(error: NoPeriod) -> Self {
        match error {
            NoPeriod::NoGains(_) => Self::bad_input(&error),
            NoPeriod::TooShort { .. } | NoPeriod::None { .. } => Self::new(exit::BUS, error.to_string()),
        }
    }
}

/// From what ended the job to what people read: the step, what happened, what to do.
fn failure(error: JobError, record: &Record, outcome: Outcome) -> ExpectedError {
    let step = record.at_work.map_or("throw", |(step, _)| step.name());
    let expected = match error {
        JobError::Operator(error @ OperatorError::Stopped { .. }) if outcome == Outcome::Stopped => {
            ExpectedError::new(exit::STOPPED, error.to_string())
        }
        JobError::Operator(error) => ExpectedError::from(error),
        JobError::Approach(_) | JobError::Double { .. } => ExpectedError::new(exit::DRIVE, error.to_string()),
        JobError::Declined { .. } => ExpectedError::new(exit::INTERRUPTED, error.to_string()),
        other => ExpectedError::bad_input(&other),
    };
    ExpectedError::new(expected.code, format!("{step}: {}", expected.message))
}

fn output(error: &impl std::fmt::Display) -> ExpectedError {
    ExpectedError::new(exit::OUTPUT, error.to_string())
}

/// The gains in force: the file that was given, or what the controller's registers held, in the form that
/// `cubectl tune --rollback` and `cubectl replay` read; `None` if they were not read.
fn gains_toml(record: &Record, gains: Option<&GainsFile>) -> Option<String> {
    if let Some(gains) = gains {
        return Some(gains.to_toml());
    }
    record.held.as_ref().map(|held| InForce::of(held).to_toml())
}

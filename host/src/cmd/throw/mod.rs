//! `cubectl throw`

mod folder;
mod robot;
mod voice;

use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::time::Instant as WallTime;

use can_link::BusSpec;
use nalgebra::Vector3;
use protocol::ModuleId;
use robot_model::collision::{Obb, Scene};
use robot_model::{AnyRobot, Pose};
use toml_reader::{DESCRIPTION_MAX_BYTES, read_text};

use self::folder::Folder;
use self::voice::Voice;
use super::doctor::{Level, examine_modules};
use super::home::share;
use super::plan::follow::is_industrial;
use super::plan::options::point;
use super::plan::throw::{Planned, SearchOptions};
use super::print_json;
use super::report;
use super::tune::InForce;
use crate::error::ExpectedError;
use crate::exit;
use operator::bus::args::{CellArgs, Controller, interrupt};
use operator::bus::key_file::KeyArgs;
use operator::bus::pace::Pace;
use operator::bus::period::{NoPeriod, PERIOD_MAX_US, PERIOD_MIN_US, Wish, apply, choose};
use operator::bus::settings::settings_of;
use operator::bus::{BusArgs, Session};
use operator::dialogue::operator::OperatorError;
use operator::throw::job::{News, Step};
use operator::throw::outcome::{Outcome, default_tolerance_m, judge};
use operator::throw::summary::{Circumstances, summary};
use operator::throw::{Job, JobError, Record, Verdict, job};
use planner::plan::Arm;
use planner::plan::file::PlanFile;
use planner::verify;
use tuner::gains::choose::GainsFrom;
use tuner::gains::gains_file::GainsFile;

/// How long is listened for a controller before a soft one is started, on a live bus.
const LISTEN: protocol::Duration = protocol::Duration::from_millis(400);

/// Arguments.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl throw --target 1.0,1.0,-1.0                      # in the simulated cell\n  cubectl throw --target 1.0,1.0,-1.0 --bus can0            # a controller that is heard there, else one in this program\n  cubectl throw --plan plan.json --bus can0 --controller 10\n  cubectl throw --robot kr16_2 --target 2.5,0,0.6           # an industrial robot, inside this program, over RSI\n\nWrites plan.json, gains.toml, log.candump, log.mcap, summary.json and report.html into a new folder. Ctrl-C, SIGTERM and\nSIGHUP stop the arm along its path, then end the program with code 6. On a terminal and a live bus it asks before the ball\nis thrown.\n\nOutcomes and exit codes: landed 0, missed 11, not released 12, stopped 13. Only the bus `sim` sees the ball. On every\nother bus the outcome is \"thrown, not observed\" (0): the program then says when the release was ordered and where the\nmeasured motion sends the ball. A drive that has lost encoder counts tells a wrong position without knowing it; nothing\nin its answers shows that."
)]
pub struct Args {
    /// Target in m, world frame (arm base, z up).
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = point, required_unless_present = "plan")]
    pub target: Option<[f64; 3]>,
    /// Throw this plan instead of making one.
    #[arg(long, value_name = "FILE", conflicts_with = "target")]
    pub plan: Option<PathBuf>,
    /// Bus: sim (the cell inside this program, in virtual time), can0, socketcand://host:port/bus,
    /// slcan:/dev/ttyACM0 or slcan://host:port.
    #[arg(long, default_value = "sim", value_name = "SPEC")]
    pub bus: BusSpec,
    /// Key of the controller.
    #[command(flatten)]
    pub key: KeyArgs,
    /// `soft`: a controller in this program. A number: the one with this Cyphal node-ID. Default: the one that is
    /// heard, else a soft one.
    #[arg(long, value_name = "soft|NODE-ID")]
    pub controller: Option<Controller>,
    /// Gains with their certificate, from `cubectl tune`; a controller in this program runs at their period. Default: for
    /// a controller in this program those that come with it for powercube6, and a design made on the way for any other
    /// robot; else those that the controller on the bus has.
    #[arg(long, value_name = "FILE")]
    pub gains: Option<PathBuf>,
    /// Control period of a controller in this program, ms: 3, 5, 10, 17 or 30. Default: the shortest one that this machine
    /// and this bus hold, which is measured first.
    #[arg(long, value_name = "MS", conflicts_with = "gains", value_parser = period_us)]
    pub period: Option<u32>,
    /// Seed of the planner and of the simulated cell [default: the scenario's, or 1].
    #[arg(long)]
    pub seed: Option<u64>,
    /// Scenario of the simulated cell: its options, and what goes wrong (`hil-sim faults` lists the kinds).
    #[arg(long, value_name = "FILE")]
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
    /// that the plan predicts lie, at least 0.010].
    #[arg(long, value_name = "M", value_parser = super::home::positive)]
    pub tolerance: Option<f64>,
    /// Afterwards go back to where the arm stood. Default: stay where the throw ends.
    #[arg(long)]
    pub back: bool,
    /// Do not ask before the ball is thrown.
    #[arg(long)]
    pub yes: bool,
    /// How to look for a throw.
    #[command(flatten)]
    pub search: SearchOptions,
}

/// Runs the verb.
///
/// # Errors
/// As each step: no throw, a plan that does not fit, the bus, the controller, the disk; or Ctrl-C. The exit code says
/// which.
pub fn run(args: &Args) -> Result<(), ExpectedError> {
    if let AnyRobot::Six(arm) = super::robot(&args.search.options.robot)?
        && is_industrial(&arm)
    {
        return robot::run(args, &arm);
    }
    let stop = interrupt();
    let begun = WallTime::now();
    let cell_args = CellArgs {
        robot: Some(args.search.options.robot.clone()),
        seed: args.seed,
        scenario: args.scenario.clone(),
    };
    let mut cell = cell_args.load()?;
    let Planned { arm, plan, took } = planned(args, cell.seed)?;
    let plan_s = took.as_secs_f64();
    if stop.load(std::sync::atomic::Ordering::Relaxed) {
        return Err(ExpectedError::new(exit::INTERRUPTED, "interrupted; nothing has moved"));
    }
    preflight(&arm, &plan)?;
    let Ground { soft, pace } = look(args, &arm)?;
    let mut settings = settings_of(&cell.robot).map_err(|error| ExpectedError::bad_input(&error))?;
    let given = args.gains.as_ref().map(|path| read_gains(path, arm.name())).transpose()?;
    let choice = if soft {
        let wish = wish(given.clone(), args.period);
        let choice = choose(wish, pace.as_ref(), &cell.robot, settings.cycle_period_us)
            .map_err(|refused| without_period(refused, args, &arm))?;
        apply(&choice, &mut settings);
        Some(choice)
    } else {
        None
    };
    // A controller that is on the bus already keeps its own, unless some are given.
    let gains = choice.as_ref().map_or(given, |choice| Some(choice.gains.clone()));
    // On the bus `sim` the ball lands where the target is, not only on the floor.
    cell.setup.cell.gripper.landing_z_m = Some(plan.target.position_m[2]);

    let folder = Folder::create(args.out.as_deref())?;
    plan.write(&folder.file("plan.json")).map_err(|error| output(&error))?;
    let bus =
        BusArgs { bus: args.bus.clone(), cell: cell_args, record: Some(folder.file("log")), beside: false };
    let mut voice = Voice::new(args.json);
    voice.planned(&plan, plan_s);
    if let Some(choice) = &choice {
        voice.gains(choice);
    }
    if let (Some(choice), Some(pace)) = (&choice, &pace) {
        voice.paced(choice, pace);
    }
    let key = args.key.load()?;
    let mut session = bus.open_cell(&cell, soft.then_some(&settings))?;
    session.set_key(key);

    let scene = scene(&args.search);
    let job = Job {
        arm: &arm,
        plan: &plan,
        gains: gains.as_ref(),
        controller: match args.controller {
            Some(Controller::Node(node)) => Some(node),
            Some(Controller::Soft) | None => None,
        },
        scene: &scene,
        approach_share: args.approach_share,
        seed: cell.seed,
        tolerance_m: args.tolerance.unwrap_or_else(|| default_tolerance_m(&plan)),
        go_back: args.back,
        bit_rate_bit_s: report::BIT_RATE,
    };
    let asks = !args.yes && !session.is_simulated() && std::io::stdin().is_terminal();
    let mut record = Record::default();
    let ended = job::run(&mut session, &job, &mut record, &mut |news| match news {
        News::MayThrow => !asks || voice.may_throw(&stop),
        other => {
            voice.tell(other);
            true
        }
    });
    voice.quiet();
    let verdict = judge(&job, &record, ended.as_ref().copied());
    let by_controller = matches!(ended, Err(JobError::Operator(_)));
    let mut failed = ended.err().map(|error| failure(error, &record, verdict.outcome));
    if let Some(error) = &mut failed
        && soft
        && by_controller
        && record.at_work.is_some_and(|(step, _)| step == Step::Drives)
        && error.code == exit::DRIVE
        && let Some(found) = diagnosis(&mut session, &arm, |_| true)
    {
        error.message = format!("{}\n{found}", error.message);
    }
    let gains_text = gains_toml(&record, gains.as_ref());
    let (name, simulated, bus_errors) =
        (session.name().to_owned(), session.is_simulated(), session.bus_errors().len());
    let thread = session.finish_controller();
    let closed = session.finish().map_err(ExpectedError::from);
    let wrong = failed.or_else(|| off_target(&verdict)).or(closed.err());

    let controller = if soft { "soft".to_owned() } else { "node".to_owned() };
    let circumstances = Circumstances {
        bus: &name,
        time: if simulated { "virtual time" } else { "real time" },
        controller: &controller,
        seed: cell.seed,
        exit_code: wrong.as_ref().map_or(exit::OK, |error| error.code),
        cause: wrong.as_ref().map(|error| error.message.as_str()),
        bus_errors,
        wall_s: &voice.wall_s,
        plan_s,
        gains_from: match (&choice, args.gains.is_some()) {
            (Some(choice), _) => choice.gains_from,
            (None, true) => GainsFrom::Given,
            (None, false) => GainsFrom::Controller,
        },
        gains_crc32: gains_text.as_ref().map(|text| firmware::crc::Crc32::of(text.as_bytes())),
        soft: thread.as_ref(),
        period_why: choice.as_ref().map_or("the controller's", |choice| choice.why),
        pace: pace.as_ref(),
    };
    let mut value = summary(&job, &record, &verdict, &circumstances);
    value["command_line"] = std::env::args().collect::<Vec<_>>().join(" ").into();
    let written = write_results(&folder, &value, gains_text.as_deref(), &args.search.options.robot);
    if args.json {
        print_json(&value);
    }
    let Some(mut error) = wrong else {
        written?;
        voice.closing(&record, Some(&verdict), &folder.path, begun);
        return Ok(());
    };
    voice.closing(&record, None, &folder.path, begun);
    error.message += &format!("\n  results in {}", folder.path.display());
    if let Err(lost) = written {
        error.message += &format!("; not all of them: {}", lost.message);
    }
    Err(error)
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
    let files = ["plan.json", "log.candump", "summary.json"].map(|name| folder.file(name));
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

/// The plan of a file, or a new one.
fn planned(args: &Args, seed: u64) -> Result<Planned, ExpectedError> {
    let Some(path) = &args.plan else {
        let target = args.target.ok_or_else(|| ExpectedError::bad_input(&"give --target or --plan"))?;
        return args.search.plan(target, seed, !args.thorough);
    };
    let began = WallTime::now();
    let plan = PlanFile::read(path).map_err(|error| ExpectedError::bad_input(&error))?;
    let arm = super::arm(&args.search.options.robot)?;
    plan.require_robot(path, &arm).map_err(|error| ExpectedError::bad_input(&error))?;
    Ok(Planned { arm, plan, took: began.elapsed() })
}

/// Checks the plan by other means than the planner's.
fn preflight(arm: &Arm, plan: &PlanFile) -> Result<(), ExpectedError> {
    let report = verify::check(arm, plan);
    if report.ok() {
        return Ok(());
    }
    let failed = report.findings.iter().filter(|f| !f.ok && f.enforced);
    let list: Vec<String> = failed.map(|f| format!("{}: {}", f.what, f.worst)).collect();
    Err(ExpectedError::new(
        exit::CHECK_FAILED,
        format!(
            "the plan does not hold what it claims: {}\n  next: plan again; nothing has moved",
            list.join("; ")
        ),
    ))
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

/// Who decides the period.
pub(super) fn wish(gains: Option<GainsFile>, period_us: Option<u32>) -> Wish {
    match (gains, period_us) {
        (Some(gains), _) => Wish::Gains(Box::new(gains)),
        (None, Some(period_us)) => Wish::Period(period_us),
        (None, None) => Wish::Any,
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

/// What is known before the first step.
struct Ground {
    /// The controller runs in this program.
    soft: bool,
    /// What machine and bus hold then; `None` in virtual time.
    pace: Option<Pace>,
}

/// Looks who is on the bus; where a controller in this program shall close the loop, measures whether it can.
fn look(args: &Args, arm: &Arm) -> Result<Ground, ExpectedError> {
    let node_given = matches!(args.controller, Some(Controller::Node(_)));
    if node_given && args.period.is_some() {
        return Err(ExpectedError::bad_input(
            &"--period is for a controller in this program\n  next: `cubectl controller --period`, or register cycle.period_us",
        ));
    }
    match (args.controller, &args.bus) {
        (Some(Controller::Node(_)), BusSpec::Sim) => Err(ExpectedError::bad_input(
            &"the bus sim has no controller but the soft one\n  next: leave --controller out, or name another bus",
        )),
        (Some(Controller::Node(_)), _) => Ok(Ground { soft: false, pace: None }),
        (_, BusSpec::Sim) => Ok(Ground { soft: true, pace: None }),
        (wanted, spec) => {
            let mut session = asking(spec).open()?;
            let found = speaker(&mut session)?;
            if found && wanted == Some(Controller::Soft) {
                return Err(ExpectedError::new(
                    exit::BUS,
                    format!(
                        "{spec}: a controller or host speaks to the modules already; two of them destroy each other's \
                         frames\n  next: leave --controller out to use it, or end it"
                    ),
                ));
            }
            let pace = if found { None } else { session.measure_pace(&modules(arm))? };
            session.finish()?;
            Ok(Ground { soft: !found, pace })
        }
    }
}

/// The bus alone, for a look before the throw: nothing is simulated and nothing recorded.
fn asking(bus: &BusSpec) -> BusArgs {
    BusArgs { bus: bus.clone(), ..BusArgs::default() }
}

/// Addresses of the arm's drives.
fn modules(arm: &Arm) -> Vec<ModuleId> {
    let drives = arm.drives().into_iter().flatten();
    drives.filter_map(|drive| ModuleId::new(drive.address).ok()).collect()
}

/// Whether a controller or another host is heard.
fn speaker(session: &mut Session) -> Result<bool, ExpectedError> {
    let until = session.now() + LISTEN;
    session.run(until, &mut |desk| desk.tally().foreign_requests > 0)?;
    Ok(session.desk().tally().foreign_requests > 0)
}

fn scene(search: &SearchOptions) -> Scene {
    let obstacles = search.options.obstacle.iter().enumerate().map(|(i, b)| {
        let half = Vector3::new(b[3], b[4], b[5]);
        (format!("obstacle {}", i + 1), Obb::new(Pose::translation(b[0], b[1], b[2]), half))
    });
    Scene { obstacles: obstacles.collect(), ball_held: true }
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
        JobError::Declined => {
            ExpectedError::new(exit::INTERRUPTED, "not thrown; the arm stands at the start")
        }
        other => ExpectedError::bad_input(&other),
    };
    ExpectedError::new(expected.code, format!("{step}: {}", expected.message))
}

/// No period holds; drives with something wrong are named first, because double or silent ones make every round long.
fn without_period(refused: NoPeriod, args: &Args, arm: &Arm) -> ExpectedError {
    if matches!(refused, NoPeriod::NoGains(_)) {
        return refused.into();
    }
    let found = asking(&args.bus).open().ok().and_then(|mut session| {
        diagnosis(&mut session, arm, |check| matches!(check, "modules" | "addresses" | "bus errors"))
    });
    let refused = ExpectedError::from(refused);
    match found {
        Some(found) => ExpectedError::new(exit::DRIVE, format!("{found}\n{}", refused.message)),
        None => refused,
    }
}

/// What is wrong with the drives, asked by the host itself with the controller out of the way; only checks that count.
fn diagnosis(session: &mut Session, arm: &Arm, counts: impl Fn(&str) -> bool) -> Option<String> {
    session.switch_controller_off();
    // Answers to it may still be under way.
    session.sleep_until(session.now() + LISTEN).ok()?;
    let (modules, findings) = examine_modules(session, Some(&modules(arm))).ok()?;
    let problems = findings.iter().filter(|f| f.level == Level::Problem && counts(f.check));
    let shown = if modules.is_empty() { 1 } else { usize::MAX };
    let list: Vec<String> = problems.take(shown).map(|f| format!("{}\n  next: {}", f.what, f.next)).collect();
    (!list.is_empty()).then(|| list.join("\n"))
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
    let [k_pos_1_s2, k_vel_1_s, k_last] = record.gains.clone();
    let [estimator_alpha, estimator_beta] = record.estimator?;
    let in_force = InForce {
        period_us: u32::try_from(record.period_us).ok()?,
        robot_crc32: u32::try_from(record.gains_robot_crc32).ok()?,
        certificate_crc32: u32::try_from(record.certificate_crc32).ok()?,
        estimator_alpha,
        estimator_beta,
        k_pos_1_s2,
        k_vel_1_s,
        k_last,
    };
    Some(in_force.to_toml())
}

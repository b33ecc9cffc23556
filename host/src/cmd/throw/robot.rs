//! `cubectl throw` with an industrial robot over RSI: the robot inside this program in virtual time, or one that connects.

use std::path::Path;
use std::time::Instant as WallTime;

use can_link::{BusSpec, Granted, RsiSpec};
use hil_sim::krc::KrcScenario;
use nalgebra::Vector3;
use planner::follow::best::BestOptions;
use planner::follow::limits::{Arm, LimitSource, Limits};
use planner::follow::paper::{Criterion, PaperOptions};
use planner::follow::plan::FollowPlan;
use planner::follow::search::Search;
use planner::follow::setting::{CommandRange, Setting};
use planner::follow::verify::verify_commands;
use planner::plan::file::RobotId;
use planner::store::robot_fingerprint;
use protocol::Instant;
use robot_model::collision::Scene;

use super::Args;
use super::folder::Folder;
use super::last_look::LastLook;
use super::outcome_last;
use crate::cmd::consent::Consent;
use crate::cmd::meaning::Deed;
use crate::cmd::plan::follow::{REFINEMENTS, paper_grid, searched};
use crate::cmd::plan::options::FormName;
use crate::cmd::print_json;
use crate::cmd::rsi::{LOG, Watch, description, next_after, serve_at, write_description};
use crate::error::ExpectedError;
use crate::exit;
use crate::report::motion;
use operator::interrupt::interrupt;
use operator::rsi::cell::{self, Seen};
use operator::rsi::cycles::{cycles, last_outputs};
use operator::rsi::live::Exchange;
use operator::rsi::log::{Line, to_text};
use operator::rsi::outcome::{GripperKnown, RsiBallOutcome, error_m, in_hand, judge, measured, verdict};
use operator::rsi::program::{Lag, can_be_led, command_range, station, way_to_start};
use operator::rsi::station::{Stage, Station};
use operator::throw::approach::ApproachError;
use operator::throw::{Outcome, Verdict};

/// Radius of a bottle, m.
const BOTTLE_M: f64 = 0.035;
/// The place of a plan in messages that was handed over as such.
const IN_MEMORY: &str = "in memory";
/// Starts of the search if no number is asked for.
const STARTS: usize = 64;

/// What is thrown, with what is believed of the robot, and where the results go.
struct Throw<'a> {
    args: &'a Args,
    described: &'a KrcScenario,
    arm: &'a Arm,
    plan: &'a FollowPlan,
}

impl Throw<'_> {
    /// A landing farther from the target than this is a miss, m.
    fn tolerance_m(&self) -> f64 {
        self.args.tolerance.unwrap_or(BOTTLE_M)
    }
}

/// What came of the exchange, from the simulated robot or from a real one.
struct Came {
    verdict: Verdict,
    /// The simulated robot inside this program; `None`: the robot is outside.
    seen: Option<Seen>,
    /// Everything that went in and out.
    lines: Vec<Line>,
    /// Whether the log is whole.
    recorded: Result<(), ExpectedError>,
    exchange: Option<Exchange>,
    granted: Option<Granted>,
}

/// Throws, and writes plan.json, motion.csv, log.rsi, the description of the robot, summary.json and report.html.
///
/// # Errors
/// Options that have no meaning here, no plan, a robot that cannot be led along it, or the outcome of the throw.
pub(super) fn run(args: &Args, arm: &Arm) -> Result<(), ExpectedError> {
    refuse_other_buses(args)?;
    let mut consent = Consent::on(&args.bus, args.yes)?;
    let (truth, described) = believed(args)?;
    let (target_m, tracked) = args.aim()?;
    let begun = WallTime::now();
    let plan = plan(args, arm, &described, target_m)?;
    let plan_s = begun.elapsed().as_secs_f64();
    let mut station = ready(args, arm, &described, &plan)?;
    if let Some(before) = &tracked {
        args.tracker.still_there(before)?;
    }
    let folder = Folder::create(args.out.as_deref())?;
    write_description(&folder.path, &described)?;
    folder.write("plan.json", &plan.to_json())?;
    if !args.json {
        console::line!(
            "plan: {} points of the flight followed, release after {:.3} s ({plan_s:.1} s of search)",
            plan.followed_points,
            plan.release_time_s
        );
    }
    let throw = Throw { args, described: &described, arm, plan: &plan };
    let mut came = match &args.bus {
        BusSpec::Rsi(spec) => {
            consent.require(
                "The robot moves to the start of the throw and throws as soon as its program runs. Ball in the hand, nobody near?",
                &interrupt(),
            )?;
            let look = tracked.as_ref().map(|before| LastLook::new(&args.tracker, before, spec.lockstep));
            outside(&throw, spec, &mut station, look, &folder)?
        }
        _ => {
            let mut came = inside(&throw, truth, &mut station)?;
            came.recorded = folder.write(LOG, &to_text(&came.lines));
            came
        }
    };
    let moved_m = tracked.as_ref().map(|before| args.tracker.moved(before));
    let verdict = &came.verdict;
    let code = exit::of_outcome(verdict.outcome).unwrap_or(exit::DRIVE);
    let results = Results { plan: &plan, described: &described, came: &came, station: &station };
    let mut summary = summary(args, &results, code);
    if let (Some(before), Some(moved_m)) = (&tracked, moved_m) {
        summary["target"] = before.json();
        summary["target"]["moved_during_throw_m"] = serde_json::json!(moved_m.as_ref().ok());
        match moved_m {
            Ok(by_m) if by_m > 1e-3 => {
                console::note!("the target moved by {:.1} mm during the throw", 1e3 * by_m);
            }
            Ok(_) => {}
            Err(error) => console::note!("the target could not be looked at after the throw: {error}"),
        }
    }
    let krc = &described.options;
    let table = match &came.seen {
        Some(seen) => motion::of_robot(seen),
        None => motion::of_telegrams(&cycles(
            &came.lines,
            &described.config,
            &krc.outputs_name,
            krc.sensor_name.as_deref(),
        )),
    };
    // Each is tried; the first that fails is reported.
    let written: Result<(), ExpectedError> = [
        std::mem::replace(&mut came.recorded, Ok(())),
        folder.write("motion.csv", &motion::csv(&table, station.stage())),
        folder.write("summary.json", &format!("{summary:#}\n")),
        crate::cmd::report::write_robot(&folder.path, &folder.file("report.html")),
    ]
    .into_iter()
    .collect();
    if args.json {
        print_json(&summary);
    }
    let Verdict { outcome, text, .. } = &came.verdict;
    if code == exit::OK && !args.json {
        console::line!("{text}");
        console::line!("results in {}", folder.path.display());
    }
    let next = match outcome {
        Outcome::Missed => {
            "compare `path_delay_s` in summary.json with the lag: `cubectl identify` measures it again"
                .to_owned()
        }
        Outcome::NotReleased => "take the ball out; check output and supply of the gripper".to_owned(),
        _ => format!("{}; motion.csv shows where the arm was", next_after(&station)),
    };
    let wrong = (code != exit::OK).then(|| ExpectedError::new(code, format!("{text}\n  next: {next}")));
    outcome_last(wrong, written, &folder)
}

/// A throw with the robot inside this program, in virtual time.
pub struct Simulated {
    /// What `cubectl throw` writes to summary.json.
    pub summary: serde_json::Value,
    /// What the simulated robot tells.
    pub seen: Seen,
}

/// The throw of `plan` that `cubectl throw --plan` makes with these words with the robot inside this program; nothing is written
/// or printed.
///
/// # Errors
/// A word is refused (exit code 2 of the program), input is refused, or the plan does not fit the robot. A throw that fails is no
/// error.
pub fn simulate(words: &[String], plan: &FollowPlan) -> Result<Simulated, ExpectedError> {
    let words: Vec<String> = words.iter().cloned().chain([format!("--plan={IN_MEMORY}")]).collect();
    let args: Args = crate::cmd::words::parse("throw", &words)?;
    if args.bus != BusSpec::Sim {
        return Err(ExpectedError::bad_input(&"--bus is for the program: run `cubectl throw`"));
    }
    refuse_other_buses(&args)?;
    let arm = crate::cmd::six_axes(&args.search.options.robot)?;
    let (truth, described) = believed(&args)?;
    plan.require_true(Path::new(IN_MEMORY), &arm).map_err(|error| ExpectedError::bad_input(&error))?;
    let plan = opened(&args, &arm, &described, plan)?;
    let mut station = ready(&args, &arm, &described, &plan)?;
    let throw = Throw { args: &args, described: &described, arm: &arm, plan: &plan };
    let came = inside(&throw, truth, &mut station)?;
    let code = exit::of_outcome(came.verdict.outcome).unwrap_or(exit::DRIVE);
    let results = Results { plan: &plan, described: &described, came: &came, station: &station };
    let mut summary = summary(&args, &results, code);
    // That of whatever program this is.
    summary.as_object_mut().and_then(|summary| summary.remove("command_line"));
    Ok(Simulated { summary, seen: came.seen.unwrap_or_default() })
}

/// What is true of the simulated robot, if a scenario says it, and what is believed of it.
fn believed(args: &Args) -> Result<(Option<KrcScenario>, KrcScenario), ExpectedError> {
    let truth = args.scenario.as_deref().map(KrcScenario::load).transpose();
    let truth = truth.map_err(|error| ExpectedError::bad_input(&error))?;
    let described = described(args, truth.as_ref())?;
    can_be_led(&described).map_err(|error| ExpectedError::bad_input(&error))?;
    Ok((truth, described))
}

/// The station that leads the robot to the start of the plan and along it.
fn ready(
    args: &Args,
    arm: &Arm,
    described: &KrcScenario,
    plan: &FollowPlan,
) -> Result<Station, ExpectedError> {
    // Such plans have no obstacles.
    let scene = Scene { ball_held: true, ..Scene::default() };
    let how = (args.approach_share, args.seed.unwrap_or(1));
    let ways = way_to_start(described, arm, plan, &scene, how).map_err(|error| no_way(&error))?;
    let lag = Lag::of(described).for_plan(plan);
    station(described, arm, plan, lag, &ways).map_err(|error| ExpectedError::bad_input(&error))
}

/// What is believed of robot and program: the description that was given; else that of the scenario with the usual lag and
/// gripper, which the client cannot know; else the usual one.
fn described(args: &Args, truth: Option<&KrcScenario>) -> Result<KrcScenario, ExpectedError> {
    let tcp = matches!(&args.bus, BusSpec::Rsi(spec) if spec.tcp);
    let usual = if tcp { "kr-c2-tcp" } else { "kr-c2" };
    let mut described = description(Some(args.rsi.as_deref().unwrap_or(usual)))?;
    if let (None, Some(truth)) = (&args.rsi, truth) {
        let usual = described;
        described = truth.clone();
        described.options.lag = usual.options.lag;
        described.options.hand.gripper = usual.options.hand.gripper;
    }
    described.robot = args.search.options.robot.clone();
    Ok(described)
}

/// The robot inside this program, in virtual time.
fn inside(
    throw: &Throw<'_>,
    truth: Option<KrcScenario>,
    station: &mut Station,
) -> Result<Came, ExpectedError> {
    let Throw { args, described, plan, .. } = *throw;
    let mut scenario = truth.unwrap_or_else(|| described.clone());
    scenario.robot = args.search.options.robot.clone();
    scenario.seed = args.seed.unwrap_or(scenario.seed);
    scenario.options.hand.gripper.landing_z_m = Some(plan.target_m[2]);
    let seen = cell::run(&scenario, station).map_err(|error| ExpectedError::bad_input(&error))?;
    let lines = station.take_log();
    let verdict = judge(&seen, station, &plan.target_m, throw.tolerance_m());
    Ok(Came { verdict, seen: Some(seen), lines, recorded: Ok(()), exchange: None, granted: None })
}

/// A robot outside, which connects to this machine. The target is looked at once more with `look`, before the plan begins.
fn outside(
    throw: &Throw<'_>,
    spec: &RsiSpec,
    station: &mut Station,
    mut look: Option<LastLook>,
    folder: &Folder,
) -> Result<Came, ExpectedError> {
    let Throw { args, described, arm, plan } = *throw;
    let log = folder.file(LOG);
    if look.is_some() {
        station.hold(Instant::ZERO);
    }
    let mut on = |now, station: &mut Station| look.as_mut().is_none_or(|look| look.allows(now, station));
    let mut watch = Watch::new(args.bus.to_string(), None, args.json, &mut on).recording(&log)?;
    let (exchange, granted) = serve_at(spec, described, station, &mut watch)?;
    let recorded = watch.finish(&log);
    let interrupted = watch.was_interrupted();
    let ready = watch.require_ready();
    let lines = watch.take_lines();
    if let Some(gone) = look.and_then(|look| look.refused) {
        return Err(gone);
    }
    if !station.stage().is_end() {
        ready?;
        if interrupted {
            return Err(ExpectedError::new(
                exit::INTERRUPTED,
                format!("interrupted before the throw; the robot was only held; {}", station.heard()),
            ));
        }
    }
    let krc = &described.options;
    let table = cycles(&lines, &described.config, &krc.outputs_name, krc.sensor_name.as_deref());
    let gripper = GripperKnown {
        output_bit: krc.hand.output_bit.unwrap_or(0),
        delay_s: krc.hand.gripper.delay.as_secs_f64(),
        jitter_s: krc.hand.gripper.jitter.as_secs_f64(),
        last_outputs: last_outputs(&lines, &krc.outputs_name),
    };
    let ball = match measured(arm, &table, krc.cycle.as_secs_f64(), &gripper, &plan.target_m) {
        RsiBallOutcome::InHand => in_hand(station),
        ball => ball,
    };
    let verdict = verdict(ball, None, station.stage(), throw.tolerance_m());
    Ok(Came { verdict, seen: None, lines, recorded, exchange: Some(exchange), granted })
}

fn no_way(error: &ApproachError) -> ExpectedError {
    let text = error.to_string();
    let what = text.split_once("\n").map_or(text.as_str(), |(what, _)| what);
    ExpectedError::bad_input(&format!(
        "{what}\n  next: let the robot's program begin at another start pose (start_deg of the description), or plan another throw"
    ))
}

/// Refuses a bus that is none of such a robot, and options that mean nothing for it.
fn refuse_other_buses(args: &Args) -> Result<(), ExpectedError> {
    if !matches!(args.bus, BusSpec::Sim | BusSpec::Rsi(_)) {
        return Err(ExpectedError::bad_input(&format!(
            "--bus {} is a CAN bus; {} has a controller of its own and is led over RSI\n  next: --bus rsi:udp://0.0.0.0:49152, or \
             leave --bus out for the robot inside this program",
            args.bus, args.search.options.robot
        )));
    }
    let form = args.search.options.form.search_of_following();
    args.given.require_meaning(&args.deeds(&[Deed::Led, Deed::Following, form]))
}

/// The plan of a file, or a new one for the lag of the robot; verified either way.
fn plan(
    args: &Args,
    arm: &Arm,
    described: &KrcScenario,
    target_m: Option<[f64; 3]>,
) -> Result<FollowPlan, ExpectedError> {
    let source = LimitSource::ControllerModel;
    let limits = Limits::of(arm, source);
    let plan = match (&args.plan, target_m) {
        (Some(path), _) => {
            let plan = FollowPlan::read(path).map_err(|error| refused_plan(path, &error))?;
            plan.require_true(path, arm).map_err(|error| refused_plan(path, &error))?;
            plan
        }
        (None, Some(target_m)) => {
            if !target_m.iter().all(|x| x.is_finite()) {
                return Err(ExpectedError::bad_input(&"the target needs three finite numbers"));
            }
            let seed = args.seed.unwrap_or(1);
            let (search, lag_s) = match args.search.options.form {
                FormName::Paper => {
                    let grid = paper_grid(arm, None);
                    let criterion = Criterion::Points;
                    (Search::Paper(PaperOptions { criterion, refinements: REFINEMENTS, ..grid }), 0.0)
                }
                FormName::Best => (
                    Search::Best(BestOptions {
                        starts: args.search.starts.unwrap_or(STARTS),
                        seed,
                        ..BestOptions::default()
                    }),
                    described.options.lag.time_constant.as_secs_f64(),
                ),
            };
            let period_s = described.options.cycle.as_secs_f64();
            let commands = command_range(described);
            let setting =
                Setting { commands, lag_s, period_s, ..Setting::new(arm, Vector3::from(target_m), limits) };
            let searching = Setting { limits: searched(&limits, args.search.options.form), ..setting };
            let found = search.plan(&searching).map_err(|none| {
                ExpectedError::new(
                    exit::NO_THROW,
                    format!("{none}\n  next: `cubectl plan throw --robot {}` names the nearest target with a plan", arm.name()),
                )
            })?;
            let robot = RobotId {
                name: arm.name().to_owned(),
                source: args.search.options.robot.clone(),
                fingerprint: format!("{:016x}", robot_fingerprint(arm)),
            };
            FollowPlan::new(&setting, source, robot, search.form(), &found, 0.0)
        }
        (None, None) => return Err(ExpectedError::bad_input(&"give --target or --plan")),
    };
    opened(args, arm, described, &plan)
}

/// The plan with the opening that its robot needs, verified.
fn opened(
    args: &Args,
    arm: &Arm,
    described: &KrcScenario,
    plan: &FollowPlan,
) -> Result<FollowPlan, ExpectedError> {
    let limits = Limits::of(arm, LimitSource::ControllerModel);
    let (lag, gripper) = (&described.options.lag, &described.options.hand.gripper);
    let (lag_s, jitter_s) = (lag.time_constant.as_secs_f64(), gripper.jitter.as_secs_f64());
    plan.require_lag(arm, lag_s, jitter_s, args.tolerance.unwrap_or(BOTTLE_M)).map_err(|other| {
        ExpectedError::bad_input(&format!(
            "{other}\n  next: leave --plan out, or plan again with `cubectl plan throw --robot {} --lag-ms {:.0}`",
            arm.name(),
            other.lag_ms
        ))
    })?;
    let plan = plan.opened_for(arm, lag_s, jitter_s);
    // What a plan of a file commands beyond the program's limits is told by the station, with the limits.
    let passed = if args.plan.is_some() { CommandRange::default() } else { command_range(described) };
    match verify_commands(arm, &limits, &passed, &plan).findings.first() {
        None => Ok(plan),
        Some(finding) => Err(ExpectedError::new(
            exit::CHECK_FAILED,
            format!(
                "the plan does not hold what it claims: {finding}\n  next: plan again; nothing has moved"
            ),
        )),
    }
}

fn refused_plan(path: &Path, error: &impl std::fmt::Display) -> ExpectedError {
    ExpectedError::bad_input(&format!(
        "{}: {error}\n  next: make one with `cubectl plan throw --robot ... --out {}`",
        path.display(),
        path.display()
    ))
}

struct Results<'a> {
    plan: &'a FollowPlan,
    described: &'a KrcScenario,
    came: &'a Came,
    station: &'a Station,
}

fn summary(args: &Args, results: &Results<'_>, exit_code: u8) -> serde_json::Value {
    let Results { plan, described, came, station } = results;
    let lag = Lag::of(described);
    let started_s = match station.stage() {
        Stage::Finished { started_at } | Stage::Running { starts_at: started_at } => {
            Some(started_at.as_secs_f64())
        }
        _ => None,
    };
    let released = came.seen.as_ref().and_then(|seen| seen.released).map(|(at, hand)| {
        serde_json::json!({
            "late_s": started_s.map(|started_s| at.as_secs_f64() - started_s - plan.release_time_s),
            "position_m": [hand.p_m.x, hand.p_m.y, hand.p_m.z],
            "velocity_m_s": [hand.v_m_s.x, hand.v_m_s.y, hand.v_m_s.z],
        })
    });
    let landing = came.seen.as_ref().and_then(|seen| {
        let landing = seen.landing.as_ref()?;
        Some(serde_json::json!({
            "source": "simulated ball",
            "position_m": [landing.p_m.x, landing.p_m.y, landing.p_m.z],
            "error_m": error_m(seen, &plan.target_m),
        }))
    });
    let time = match &args.bus {
        BusSpec::Rsi(spec) if spec.lockstep => "time of the robot",
        BusSpec::Rsi(_) => "real time",
        _ => "virtual time",
    };
    let answers = came.exchange.as_ref().map(|exchange| {
        let us = |share| exchange.answer_time_us(share);
        serde_json::json!({
            "own_time_us": { "count": exchange.answer_us.len(), "median": us(0.5), "p99": us(0.99), "p999": us(0.999), "max": us(1.0) },
            "robots_heard": exchange.connections,
            "real_time_rights": came.granted.as_ref().map(ToString::to_string),
        })
    });
    serde_json::json!({
        "format": "cubectl-robot-throw",
        "version": 2,
        "outcome": came.verdict.outcome.json_name(),
        "text": came.verdict.text,
        "exit_code": exit_code,
        "robot": plan.robot.name,
        "link": "RSI",
        "bus": args.bus.to_string(),
        "time": time,
        "seed": args.seed,
        "target_m": plan.target_m,
        "tolerance_m": came.verdict.tolerance_m,
        "landing": landing,
        "release": released,
        "plan_started_s": started_s,
        "followed_points": plan.followed_points,
        "lag": { "dead_time_s": lag.dead_time.as_secs_f64(), "time_constant_s": lag.time_constant.as_secs_f64() },
        "gripper_delay_s": described.options.hand.gripper.delay.as_secs_f64(),
        "path_delay_s": station.path_delay_s(),
        "answers": station.counts().answers,
        "late_answers": came.seen.as_ref().map(|seen| seen.late),
        "refused_answers": came.seen.as_ref().map(|seen| seen.refused),
        "answer_times": answers,
        "robot_fault": came.seen.as_ref().and_then(|seen| seen.fault).map(|fault| fault.to_string()),
        "command_line": std::env::args().collect::<Vec<_>>().join(" "),
    })
}

//! A throw with an industrial robot that is led over RSI: its plan, and the link to the robot inside this program in virtual time, or to
//! one that connects.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Instant as WallTime;

use can_link::BusSpec;
use hil_sim::krc::KrcScenario;
use nalgebra::Vector3;
use planner::follow::best::BestOptions;
use planner::follow::limits::{Arm, LimitSource, Limits};
use planner::follow::plan::FollowPlan;
use planner::follow::search::Search;
use planner::follow::setting::{CommandRange, Setting};
use planner::follow::verify::verify_commands;
use planner::plan::file::{PlanFileError, RobotId};

use super::{Args, Done};
use crate::cmd::ended::{self, failure, off_target};
use crate::cmd::folder::Folder;
use crate::cmd::link::not_on_can;
use crate::cmd::meaning::Deed;
use crate::cmd::plan::follow::throw_for;
use crate::cmd::progress::Ui;
use crate::cmd::rsi::LOG;
use crate::cmd::rsi::link::{Believed, Opening, RobotLink, motion_csv};
use crate::cmd::tracker::Measured;
use crate::error::ExpectedError;
use crate::exit;
use operator::dialogue::operator::OperatorError;
use operator::interrupt::interrupt;
use operator::job::summary::{Circumstances, summary};
use operator::job::{Answer, JobError, OnProgress, Order, Record, Step, perform};
use operator::rsi::cell::Seen;
use operator::rsi::program::{Lag, command_range, station_for, travel};
use operator::rsi::station::Station;
use operator::trajectory::{encode, robot_crc32};

/// Radius of a bottle, m.
const BOTTLE_M: f64 = 0.035;
/// The place of a plan in messages that was handed over as such.
const IN_MEMORY: &str = "in memory";
/// Starts of the search if no number is asked for.
const STARTS: usize = 64;
/// Asked before the robot is waited for: whoever starts its program stands elsewhere.
const QUESTION: &str = "The robot moves to the start of the throw and throws as soon as its program runs. Ball in the hand, nobody near?";

/// A throw that is ready to begin.
pub(super) struct Led {
    pub(super) arm: Arm,
    pub(super) plan: FollowPlan,
    /// Time of planning by the wall, s.
    pub(super) plan_s: f64,
    pub(super) believed: Believed,
    /// The target as the tracker saw it.
    pub(super) tracked: Option<Measured>,
}

/// Plans the throw or reads it, checks it and the robot's program. Nothing moves.
pub(super) fn prepare(args: &Args, arm: Arm) -> Result<Led, ExpectedError> {
    let believed = believed(args)?;
    let described = &believed.described;
    let (target_m, tracked) = args.aim()?;
    let begun = WallTime::now();
    let plan = plan(args, &arm, described, target_m)?;
    let plan_s = begun.elapsed().as_secs_f64();
    ready(&arm, described, &plan)?;
    if let Some(before) = &tracked {
        args.tracker.still_there(before)?;
    }
    Ok(Led { arm, plan, plan_s, believed, tracked })
}

/// A station for the robot; what its controller would refuse of the plan is refused here.
fn ready(arm: &Arm, described: &KrcScenario, plan: &FollowPlan) -> Result<Station, ExpectedError> {
    let station = station_for(described, arm, plan, Lag::of(described).for_plan(plan), &[])
        .map_err(|error| ExpectedError::bad_input(&error))?;
    let (settings, crc32) = (station.settings(), robot_crc32(&plan.robot.fingerprint));
    encode(&operator::rsi::plan::motion_of(plan), settings.cycle_period_us, crc32, Some(settings))
        .map_err(|error| ExpectedError::bad_input(&error))?;
    Ok(station)
}

impl Led {
    pub(super) fn order(&self, args: &Args) -> Order<'_> {
        let described = &self.believed.described;
        let travel = travel(described, &self.arm, args.approach_share, args.seed.unwrap_or(1));
        let tolerance_m = args.tolerance.unwrap_or(BOTTLE_M);
        Order::follow(&self.arm, &self.plan, described, travel, tolerance_m)
    }

    /// Throws with the robot at the bus: opens the link, does the job, closes it.
    pub(super) fn throw(
        &self,
        args: &Args,
        order: &Order<'_>,
        folder: &Folder,
        ui: &mut Ui,
    ) -> Result<Done, ExpectedError> {
        if args.bus != BusSpec::Sim {
            ui.consent.require(QUESTION, &interrupt())?;
        }
        self.perform(args, order, Some(&folder.file(LOG)), interrupt(), &mut |step| ui.answer(step))
    }

    fn perform(
        &self,
        args: &Args,
        order: &Order<'_>,
        log: Option<&Path>,
        stop: Arc<AtomicBool>,
        ui: OnProgress<'_>,
    ) -> Result<Done, ExpectedError> {
        let described = &self.believed.described;
        let mut simulated = self.believed.simulated(args.seed);
        simulated.options.hand.gripper.landing_z_m = Some(self.plan.target_m[2]);
        let opening = Opening { bus: &args.bus, simulated, log, quiet: args.json, stop };
        let mut link = RobotLink::open(opening, described, ready(&self.arm, described, &self.plan)?)?;
        let record = perform(&mut link.operator, order, ui);
        let lost = link.finish().err();
        let (lines, heard) = (link.operator.lines().to_vec(), link.operator.station().heard());
        let wrong = failure(&record).map(|shown| explained(&record, shown, &heard));
        let answering = link.answering();
        let seen = ended::Seen::of_robot(link.name, link.time, answering);
        Ok(Done { record, wrong, lost, lines, seen, ..Done::default() })
    }

    /// Set and actual axes by cycle, from the start of the plan.
    pub(super) fn motion_csv(&self, done: &Done) -> String {
        motion_csv(&self.believed.described, done.record.led.as_ref(), &done.lines)
    }
}

/// What a person reads of a job that ended early.
fn explained(record: &Record, mut shown: ExpectedError, heard: &str) -> ExpectedError {
    match &record.ended {
        Some(JobError::Way(way)) => {
            shown = ExpectedError::new(exit::BAD_INPUT, format!("{}: {way}", Step::Approach.name())).next(
                "let the robot's program begin at another start pose (start_deg of the description), or plan \
                     another throw",
            );
        }
        Some(JobError::Operator(OperatorError::Interrupted))
            if record.at_work.is_some_and(|(step, _)| step == Step::Drives) =>
        {
            shown.what += &format!("; {heard}");
        }
        Some(JobError::Operator(OperatorError::RobotStopped { .. })) => {
            *shown.next.last_mut().unwrap_or(&mut shown.what) += "; motion.csv shows where the arm was";
        }
        _ => {}
    }
    shown
}

/// A throw with the robot inside this program, in virtual time.
pub struct Simulated {
    /// What `cubectl throw` writes to summary.json.
    pub summary: serde_json::Value,
    /// What the simulated robot did.
    pub seen: Seen,
}

/// The throw of `plan` that `cubectl throw --plan` makes for this request, as JSON, with the robot inside this program; nothing is
/// written or printed. `stop`, once set, ends it.
///
/// # Errors
/// A field is refused (exit code 2 of the program), input is refused, or the plan does not fit the robot. A throw that fails is no
/// error.
pub fn simulate(request: &str, plan: &FollowPlan, stop: Arc<AtomicBool>) -> Result<Simulated, ExpectedError> {
    let args: Args = crate::cmd::request::read("throw", request)?;
    let args = Args { plan: Some(IN_MEMORY.into()), ..args };
    require_meaning(&args)?;
    let arm = crate::cmd::six_axes(&args.robot)?;
    let believed = believed(&args)?;
    plan.require_true(Path::new(IN_MEMORY), &arm).map_err(|error| ExpectedError::bad_input(&error))?;
    let plan = opened(&args, &arm, &believed.described, plan)?;
    let led = Led { arm, plan, plan_s: 0.0, believed, tracked: None };
    let order = led.order(&args);
    let mut done = led.perform(&args, &order, None, stop, &mut |_| Answer::Yes)?;
    let wrong = done.wrong.take().or_else(|| off_target(&done.record, &order.judge));
    let about =
        Circumstances { seed: Some(args.seed.unwrap_or(1)), ..done.seen.circumstances(wrong.as_ref()) };
    let summary = summary(&order, &done.record, &about);
    let seen = done.record.led.as_mut().and_then(|led| led.seen.take()).unwrap_or_default();
    Ok(Simulated { summary, seen })
}

fn believed(args: &Args) -> Result<Believed, ExpectedError> {
    let robot = Some(args.robot.as_str());
    Believed::of(&args.bus, args.rsi.as_deref(), args.scenario.as_deref(), robot)
}

/// Refuses a bus that is none of such a robot, and options that mean nothing for it.
pub(super) fn require_meaning(args: &Args) -> Result<(), ExpectedError> {
    if !matches!(args.bus, BusSpec::Sim | BusSpec::Rsi(_)) {
        return Err(not_on_can(&args.bus, &args.robot));
    }
    args.given.require_meaning(&args.deeds(&[Deed::Led, Deed::Following]))
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
            let search = Search::Best(BestOptions {
                starts: args.starts.unwrap_or(STARTS),
                seed: args.seed.unwrap_or(1),
                ..BestOptions::default()
            });
            let lag_s = described.options.lag.time_constant.as_secs_f64();
            let period_s = described.options.cycle.as_secs_f64();
            let commands = command_range(described);
            let setting =
                Setting { commands, lag_s, period_s, ..Setting::new(arm, Vector3::from(target_m), limits) };
            let found = throw_for(&setting, &search)?;
            let robot = RobotId::of(&args.robot, arm);
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
        ExpectedError::bad_input(&other).next(format!(
            "leave --plan out, or plan again with `cubectl plan throw --robot {} --lag-ms {:.0}`",
            arm.name(),
            other.lag_ms
        ))
    })?;
    let plan = plan.opened_for(arm, lag_s, jitter_s);
    // What a plan of a file commands beyond the program's limits is reported by the station, with the limits.
    let passed = if args.plan.is_some() { CommandRange::default() } else { command_range(described) };
    match verify_commands(arm, &limits, &passed, &plan).findings.first() {
        None => Ok(plan),
        Some(finding) => Err(ExpectedError::new(
            exit::CHECK_FAILED,
            format!("the plan does not hold what it claims: {finding}"),
        )
        .next("plan again; nothing has moved")),
    }
}

fn refused_plan(path: &Path, error: &PlanFileError) -> ExpectedError {
    ExpectedError::bad_input(error)
        .at(path.display())
        .next(format!("make one with `cubectl plan throw --robot ... --out {}`", path.display()))
}

//! What happens before anything moves: cell, target, plan, controller, control period and gains.

use std::time::Instant as WallTime;

use can_link::BusSpec;
use firmware::settings::Settings;
use hil_sim::mechanics::Plane;
use nalgebra::Vector3;
use protocol::ModuleId;
use robot_model::Pose;
use robot_model::collision::{Obb, Scene};

use super::progress::ProgressView;
use super::{Args, read_gains};
use crate::cmd::doctor::examine_modules;
use crate::cmd::finding::Level;
use crate::cmd::modules::Wanted;
use crate::cmd::plan::search::{Planned, SearchOptions};
use crate::cmd::tracker::{Measured, TargetArg};
use crate::error::ExpectedError;
use crate::exit;
use operator::bus::args::{Cell, CellArgs, Controller};
use operator::bus::cycle_timing::CycleTiming;
use operator::bus::period::{Choice, NoPeriod, PeriodRequest, apply, choose};
use operator::bus::settings::settings_of;
use operator::bus::{BusArgs, Session};
use operator::interrupt::interrupt;
use operator::throw::Job;
use operator::throw::outcome::default_tolerance_m;
use planner::plan::Arm;
use planner::plan::file::PlanFile;
use planner::request::Plans;
use planner::verify;
use tuner::gains::gains_file::GainsFile;

/// How long the program listens for a controller on a live bus before it starts one itself.
const LISTEN: protocol::Duration = protocol::Duration::from_millis(400);

/// A throw that is ready to begin.
pub(super) struct Prepared {
    pub(super) cell_args: CellArgs,
    pub(super) cell: Cell,
    pub(super) arm: Arm,
    pub(super) plan: PlanFile,
    /// Time of planning by the wall, s.
    pub(super) plan_s: f64,
    /// The target as the tracker saw it.
    pub(super) tracked: Option<Measured>,
    scene: Scene,
    /// The controller runs in this program.
    pub(super) soft: bool,
    /// What machine and bus hold; `None` in virtual time.
    pub(super) timing: Option<CycleTiming>,
    /// Settings of a controller in this program.
    pub(super) settings: Settings,
    /// Period and gains of a controller in this program.
    pub(super) choice: Option<Choice>,
    /// Gains to upload; `None`: those of the controller stay.
    pub(super) gains: Option<GainsFile>,
}

/// Plans the throw or reads it, checks it, looks at the bus, and chooses control period and gains. Nothing moves.
pub(super) fn prepare(args: &Args) -> Result<Prepared, ExpectedError> {
    let cell_args = CellArgs {
        robot: Some(args.search.options.robot.clone()),
        seed: args.seed,
        scenario: args.scenario.clone(),
    };
    let mut cell = cell_args.load()?;
    let (target_m, tracked) = args.aim()?;
    let Planned { plan: (arm, plan), took, .. } = planned(args, target_m, cell.seed)?;
    if interrupt().load(std::sync::atomic::Ordering::Relaxed) {
        return Err(ExpectedError::new(exit::INTERRUPTED, "interrupted; nothing has moved"));
    }
    let touch_allowed = args.search.options.clean_release == Some(false);
    preflight(&arm, &plan, touch_allowed)?;
    let Ground { soft, timing } = probe_bus(args, &arm)?;
    let mut settings = settings_of(&cell.robot).map_err(|error| ExpectedError::bad_input(&error))?;
    let given = args.gains.as_ref().map(|path| read_gains(path, arm.name())).transpose()?;
    let choice = if soft {
        let request = period_request(given.clone(), args.period);
        let choice = choose(request, timing.as_ref(), &cell.robot, settings.cycle_period_us)
            .map_err(|refused| without_period(refused, args, &arm))?;
        apply(&choice, &mut settings);
        Some(choice)
    } else {
        None
    };
    // A controller that is on the bus already keeps its own, unless some are given.
    let gains = choice.as_ref().map_or(given, |choice| Some(choice.gains.clone()));
    // On the bus `sim` the ball lands where the target is, not only on the floor.
    let met_m = plan.meeting_m();
    cell.setup.cell.gripper.landing_z_m = Some(met_m[2]);
    cell.setup.cell.finger_release |= args.search.options.finger_release;
    cell.setup.cell.gripper.landing_plane =
        plan.target.opening.map(|o| Plane { point_m: Vector3::from(met_m), normal: Vector3::from(o.normal) });
    let (plan_s, scene) = (took.as_secs_f64(), scene(&args.search));
    Ok(Prepared { cell_args, cell, arm, plan, plan_s, tracked, scene, soft, timing, settings, choice, gains })
}

impl Prepared {
    /// Shows plan, gains and control period.
    pub(super) fn show(&self, progress: &mut ProgressView) {
        progress.planned(&self.plan, self.plan_s);
        if let Some(choice) = &self.choice {
            progress.gains(choice);
            if let Some(timing) = &self.timing {
                progress.timing(choice, timing);
            }
        }
    }

    /// The job of the operator.
    pub(super) fn job(&self, args: &Args) -> Job<'_> {
        Job {
            arm: &self.arm,
            plan: &self.plan,
            gains: self.gains.as_ref(),
            scene: &self.scene,
            approach_share: args.approach_share,
            seed: self.cell.seed,
            tolerance_m: args.tolerance.unwrap_or_else(|| default_tolerance_m(&self.plan)),
            go_back: args.back,
        }
    }
}

impl Args {
    /// The target: as given, or as the tracker sees it, which is told.
    pub(super) fn aim(&self) -> Result<(Option<[f64; 3]>, Option<Measured>), ExpectedError> {
        match self.target {
            None => Ok((None, None)),
            Some(TargetArg::Point(target_m)) => Ok((Some(target_m), None)),
            Some(TargetArg::Tracker) => {
                let measured = self.tracker.measure()?;
                if !self.json {
                    console::line!("{}", measured.words());
                }
                Ok((Some(measured.robot_m), Some(measured)))
            }
        }
    }
}

/// The plan of a file, or a new one.
fn planned(args: &Args, target_m: Option<[f64; 3]>, seed: u64) -> Result<Planned, ExpectedError> {
    let Some(path) = &args.plan else {
        let target = target_m.ok_or_else(|| ExpectedError::bad_input(&"give --target or --plan"))?;
        return args.search.plan(target, seed, !args.thorough);
    };
    let began = WallTime::now();
    let plan = PlanFile::read(path).map_err(|error| ExpectedError::bad_input(&error))?;
    let arm = crate::cmd::arm(&args.search.options.robot)?;
    plan.require_robot(path, &arm).map_err(|error| ExpectedError::bad_input(&error))?;
    Ok(Planned { plan: (arm, plan), took: began.elapsed(), note: None })
}

/// Checks the plan by other means than the planner's. A ball that would touch the arm misses, also where the plan's form allows
/// it, so that must be asked for.
fn preflight(arm: &Arm, plan: &PlanFile, touch_allowed: bool) -> Result<(), ExpectedError> {
    let report = arm.check(plan);
    if report.ok() {
        let touch = report.findings.iter().find(|f| !f.ok && f.what.starts_with(verify::RELEASED_BALL));
        return match touch.filter(|_| !touch_allowed) {
            None => Ok(()),
            Some(touch) => Err(ExpectedError::bad_input(&format!(
                "the ball would touch the arm after its release: {}: {}; the form of this plan does not forbid it\n  \
                 next: plan with `--clean-release true`, or throw it all the same with `--clean-release false`; nothing has \
                 moved",
                touch.what, touch.worst
            ))),
        };
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

/// What decides the control period: given gains, a given period, or the measurement.
pub(in crate::cmd) fn period_request(gains: Option<GainsFile>, period_us: Option<u32>) -> PeriodRequest {
    match (gains, period_us) {
        (Some(gains), _) => PeriodRequest::Gains(Box::new(gains)),
        (None, Some(period_us)) => PeriodRequest::Period(period_us),
        (None, None) => PeriodRequest::Any,
    }
}

/// What is known before the first step.
struct Ground {
    /// The controller runs in this program.
    soft: bool,
    /// What machine and bus hold then; `None` in virtual time.
    timing: Option<CycleTiming>,
}

/// Listens for a controller on the bus. Without one, measures which control period machine and bus hold.
fn probe_bus(args: &Args, arm: &Arm) -> Result<Ground, ExpectedError> {
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
        (Some(Controller::Node(_)), _) => Ok(Ground { soft: false, timing: None }),
        (_, BusSpec::Sim) => Ok(Ground { soft: true, timing: None }),
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
            let timing = if found { None } else { session.measure_cycle_timing(&modules(arm))? };
            session.finish()?;
            Ok(Ground { soft: !found, timing })
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
    session.run(until, &mut |host_node| host_node.tally().foreign_requests > 0)?;
    Ok(session.host_node().tally().foreign_requests > 0)
}

pub(super) fn scene(search: &SearchOptions) -> Scene {
    let obstacles = search.options.obstacle.iter().enumerate().map(|(i, b)| {
        let half = Vector3::new(b[3], b[4], b[5]);
        (format!("obstacle {}", i + 1), Obb::new(Pose::translation(b[0], b[1], b[2]), half))
    });
    Scene { obstacles: obstacles.collect(), ball_held: true }
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
pub(super) fn diagnosis(session: &mut Session, arm: &Arm, counts: impl Fn(&str) -> bool) -> Option<String> {
    session.switch_controller_off();
    // Answers to it may still be under way.
    session.sleep_until(session.now() + LISTEN).ok()?;
    let (modules, findings) = examine_modules(session, &Wanted::of_arm(arm)).ok()?;
    let problems = findings.iter().filter(|f| f.level == Level::Problem && counts(f.check));
    let shown = if modules.is_empty() { 1 } else { usize::MAX };
    let list: Vec<String> =
        problems.take(shown).map(|f| format!("{}\n  next: {}", f.text(), f.next)).collect();
    (!list.is_empty()).then(|| list.join("\n"))
}

//! A throw with drives on a bus: before anything moves cell, target, plan, controller, control period and gains; then the link.

use std::time::{Duration, Instant as WallTime};

use can_link::BusSpec;
use firmware::settings::Settings;
use protocol::ModuleId;

use super::{Args, Done, read_gains};
use crate::cmd::arm::doctor::examine_modules;
use crate::cmd::controlled::{is_soft, tell_warnings};
use crate::cmd::ended::{Seen, failure};
use crate::cmd::finding::Level;
use crate::cmd::folder::Folder;
use crate::cmd::meaning::Deed;
use crate::cmd::plan::search::{SearchOptions, Solved, Watcher};
use crate::cmd::progress::{ProgressView, Ui};
use crate::cmd::survey::Wanted;
use crate::cmd::tracker::{Measured, TargetArg};
use crate::error::ExpectedError;
use crate::exit;
use operator::bus::args::{Cell, CellArgs, Controller};
use operator::bus::cycle_timing::CycleTiming;
use operator::bus::period::{Choice, NoPeriod, PeriodRequest, apply, choose, usual_us};
use operator::bus::settings::settings_of;
use operator::bus::{BusArgs, Session};
use operator::interrupt::interrupt;
use operator::job::cell::take_plan;
use operator::job::{Extent, JobError, Judge, Order, Outcome, Record, Step, perform};
use operator::port::OnBus;
use planner::plan::Arm;
use planner::plan::file::PlanFile;
use planner::verify;
use planner::way::Travel;
use robot_model::RobotModel;
use tuner::gains::gains_file::GainsFile;

/// Answers to a controller that was taken off the bus have come by then.
const ANSWERS_MAX: protocol::Duration = protocol::Duration::from_millis(400);

/// A throw that is ready to begin.
pub(super) struct Drives {
    pub(super) cell_args: CellArgs,
    pub(super) cell: Cell,
    pub(super) plan: PlanFile,
    /// Time of planning by the wall, s.
    pub(super) plan_s: f64,
    /// The target as the tracker saw it.
    pub(super) tracked: Option<Measured>,
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
pub(super) fn prepare(args: &Args) -> Result<Drives, ExpectedError> {
    let cell_args =
        CellArgs { robot: Some(args.robot.clone()), seed: args.seed, scenario: args.scenario.clone() };
    let mut cell = cell_args.load()?;
    require_gripper(&cell.robot, &args.robot)?;
    let (target_m, tracked) = args.aim()?;
    let (plan, took) = planned(args, &cell.robot, target_m, cell.seed)?;
    if interrupt().load(std::sync::atomic::Ordering::Relaxed) {
        return Err(ExpectedError::new(exit::INTERRUPTED, "interrupted; nothing has moved"));
    }
    preflight(&cell.robot, &plan)?;
    let Ground { soft, timing } = probe_bus(args, &cell.robot)?;
    if !soft {
        args.given.require_meaning(&[Deed::ControllerOnBus])?;
    }
    let mut settings = settings_of(&cell.robot).map_err(|error| ExpectedError::bad_input(&error))?;
    let given = args.gains.as_ref().map(|path| read_gains(path, cell.robot.name())).transpose()?;
    let choice = if soft {
        let request = period_request(given.clone(), args.period);
        let usual_us = usual_us(&cell.robot, &cell.setup, &settings);
        let choice = choose(request, timing.as_ref(), &cell.robot, usual_us)
            .map_err(|refused| without_period(refused, args, &cell.robot))?;
        apply(&choice, &mut settings);
        Some(choice)
    } else {
        None
    };
    // A controller that is on the bus already keeps its own, unless some are given.
    let gains = choice.as_ref().map_or(given, |choice| Some(choice.gains.clone()));
    take_plan(&mut cell.setup.cell, &plan);
    let plan_s = took.as_secs_f64();
    Ok(Drives { cell_args, cell, plan, plan_s, tracked, soft, timing, settings, choice, gains })
}

impl Drives {
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

    pub(super) fn order(&self, args: &Args) -> Order<'_> {
        let travel = Travel { share: args.approach_share, seed: self.cell.seed, range: None };
        let mut order = Order::throw(&self.cell.robot, &self.plan, travel);
        order.gains = self.gains.as_ref();
        order.extent = if args.back { Extent::Back } else { Extent::Run };
        if let Some(tolerance_m) = args.tolerance {
            order.judge = Judge::Throw { plan: &self.plan, tolerance_m };
        }
        order
    }

    /// Throws on the bus: opens it, does the job, closes it.
    pub(super) fn throw(
        &self,
        args: &Args,
        order: &Order<'_>,
        folder: &Folder,
        ui: &mut Ui,
    ) -> Result<Done, ExpectedError> {
        let bus = BusArgs {
            bus: args.bus.clone(),
            cell: self.cell_args.clone(),
            record: Some(folder.file(operator::log::FOLDER_NAME)),
            beside: false,
            rsi: None,
        };
        let key = args.key.load()?;
        let mut session = bus.open_cell(&self.cell, self.soft.then_some(&self.settings))?;
        session.set_key(key);
        if let Some(sim) = session.sim() {
            sim.world().faults_mut().await_throw();
        }
        let page = args.web.serve(&mut session, &self.cell.robot, Some(&self.plan), interrupt())?;
        let wanted = match args.controller {
            Some(Controller::Node(node)) => Some(node),
            Some(Controller::Soft) | None => None,
        };
        let mut operator = OnBus::new(&mut session, wanted);
        let record = perform(&mut operator, order, &mut |step| ui.answer(step));
        ui.progress.quiet();
        tell_warnings(&mut session);
        let wrong = failure(&record).map(|shown| self.explained(&record, shown, &mut session, &args.bus));
        let mut seen = Seen::of(&session);
        seen.controller = if self.soft { "soft" } else { "node" };
        let soft = session.finish_controller();
        let lost = session.finish().err().map(ExpectedError::from);
        Ok(Done { record, wrong, lost, seen, soft, page, ..Done::default() })
    }

    /// The error of a job, with what the drives say about it and the next step.
    fn explained(
        &self,
        record: &Record,
        mut error: ExpectedError,
        session: &mut Session,
        bus: &BusSpec,
    ) -> ExpectedError {
        if self.soft
            && matches!(record.ended, Some(JobError::Operator(_)))
            && record.at_work.is_some_and(|(step, _)| step == Step::Drives)
            && error.code == exit::DRIVE
            && let Ok(Some(found)) =
                session.put_back(|session| diagnosis(session, &self.cell.robot, |_| true))
        {
            error.also.extend(found);
        }
        if record.verdict.outcome == Outcome::Stopped && !session.is_simulated() {
            // Drives stay halted, and a controller of its own keeps its fault.
            let clear = format!("; then `cubectl controller clear --bus {bus}`");
            *error.next.last_mut().unwrap_or(&mut error.what) += &clear;
        }
        error
    }
}

impl Args {
    /// The target: as given, or as the tracker sees it, which is printed.
    pub(super) fn aim(&self) -> Result<(Option<[f64; 3]>, Option<Measured>), ExpectedError> {
        match self.target {
            None => Ok((None, None)),
            Some(TargetArg::Point(target_m)) => Ok((Some(target_m), None)),
            Some(TargetArg::Tracker) => {
                self.tracker.require_robot(&self.robot)?;
                let measured = self.tracker.measure()?;
                if !self.json {
                    console::line!("{}", measured.words());
                }
                Ok((Some(measured.robot_m), Some(measured)))
            }
        }
    }
}

/// Refuses an arm whose hand nothing opens.
fn require_gripper(robot: &RobotModel, path: &str) -> Result<(), ExpectedError> {
    if robot.opens_its_hand() {
        return Ok(());
    }
    let zeros = vec!["0"; robot.n()].join(",");
    let name = robot.name();
    Err(ExpectedError::bad_input(&format!(
        "nothing opens the hand of robot {name}: no drive of its file moves a gripper, so the ball would stay in it"
    ))
    .next(format!("`cubectl move --robot {path} --joints {zeros} --home` moves the arm; nothing has moved")))
}

/// The plan of a file, or a new one; the time that it took.
fn planned(
    args: &Args,
    arm: &Arm,
    target_m: Option<[f64; 3]>,
    seed: u64,
) -> Result<(PlanFile, Duration), ExpectedError> {
    let Some(path) = &args.plan else {
        let target = target_m.ok_or_else(|| ExpectedError::bad_input(&"give --target or --plan"))?;
        let search = SearchOptions::usual(&args.robot, &args.obstacle, args.starts);
        let (starts, watcher) = (search.options.starts(arm), Watcher::Terminal);
        let Solved { plan, took, .. } =
            search.solve(arm, &starts, target, (seed, !args.thorough), watcher, None)?;
        return Ok((plan, took));
    };
    let began = WallTime::now();
    let plan = PlanFile::read(path).map_err(|error| ExpectedError::bad_input(&error))?;
    plan.require_robot(path, arm).map_err(|error| ExpectedError::bad_input(&error))?;
    Ok((plan, began.elapsed()))
}

/// Checks the plan by other means than the planner's. A ball that would touch the arm misses, also where the plan's form allows
/// it, so that must be asked for.
fn preflight(arm: &Arm, plan: &PlanFile) -> Result<(), ExpectedError> {
    let report = verify::check(arm, plan);
    if report.ok() {
        let touch = report.findings.iter().find(|f| !f.ok && f.what.starts_with(verify::RELEASED_BALL));
        return match touch.filter(|_| !plan.search.touch_allowed) {
            None => Ok(()),
            Some(touch) => Err(ExpectedError::bad_input(&format!(
                "the ball would touch the arm after its release: {}: {}; the form of this plan does not forbid it",
                touch.what, touch.worst
            ))
            .next(
                "`cubectl plan throw --clean-release true` plans one that does not touch it, `--clean-release false` one that may; \
                     nothing has moved",
            )),
        };
    }
    let failed = report.findings.iter().filter(|f| !f.ok && f.enforced);
    let list: Vec<String> = failed.map(|f| format!("{}: {}", f.what, f.worst)).collect();
    Err(ExpectedError::new(
        exit::CHECK_FAILED,
        format!("the plan does not hold what it claims: {}", list.join("; ")),
    )
    .next("plan again; nothing has moved"))
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
    let soft = is_soft(&args.bus, args.controller)?;
    if !soft || args.bus == BusSpec::Sim {
        return Ok(Ground { soft, timing: None });
    }
    let mut session = asking(&args.bus).open()?;
    let timing = session.measure_cycle_timing(&modules(arm))?;
    session.finish()?;
    Ok(Ground { soft, timing })
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
        Some(mut found) => {
            let mut first = found.remove(0);
            first.also.extend(found.into_iter().chain([refused]));
            first
        }
        None => refused,
    }
}

/// What is wrong with the drives, asked by the host itself with the controller out of the way; only checks that count. PowerCubes only:
/// others fall without their controller, or do not answer its questions.
pub(super) fn diagnosis(
    session: &mut Session,
    arm: &Arm,
    counts: impl Fn(&str) -> bool,
) -> Option<Vec<ExpectedError>> {
    arm.drives()?;
    session.switch_controller_off();
    // Answers to it may still be under way.
    session.sleep_until(session.now() + ANSWERS_MAX).ok()?;
    let (modules, findings) = examine_modules(session, &Wanted::of_robot(arm)).ok()?;
    let problems = findings.iter().filter(|f| f.level == Level::Problem && counts(f.check));
    let shown = if modules.is_empty() { 1 } else { usize::MAX };
    let found = problems.take(shown).map(|f| ExpectedError::new(exit::DRIVE, f.text()).next(&f.next));
    Some(found.collect()).filter(|found: &Vec<_>| !found.is_empty())
}

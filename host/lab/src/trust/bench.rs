//! One throw in the simulated cell, as a scenario wants it, with the real host job and the real controller.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use firmware::settings::Settings;
use hil_sim::scenario::Scenario;
use nalgebra::Vector3;
use operator::bus::BusArgs;
use operator::bus::BusFailure;
use operator::bus::args::Cell;
use operator::bus::period::{PeriodRequest, apply, choose};
use operator::bus::session::Session;
use operator::bus::settings::settings_of;
use operator::bus::sim::SimSetup;
use operator::dialogue::operator::OperatorError;
use operator::job::cell::take_plan;
use operator::job::{Answer, JobError, Judge, Order, Outcome, Record, Step, default_tolerance_m, perform};
use operator::port::OnBus;
use planner::plan::file::PlanFile;
use planner::plan::{Arm, Joints};
use planner::store::fingerprint_of;
use planner::way::Travel;
use protocol::cyphal::id::NodeId;
use protocol::{Duration, Instant};
use robot_model::{RobotModel, text_of};
use tuner::gains::gains_file::GainsFile;

use super::evidence::{BusTap, Evidence, ReportedOutcome, Seen};

pub const ROBOT: &str = "powercube6";

/// Drives of the arm that throws.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Family {
    PowerCube,
    Cia402,
    /// The same arm with modules in interpolated position mode, which count millidegrees.
    Cia402Interpolating,
    /// The same arm with servos that go on for a period without a new target.
    Cia402Extrapolating,
    Mit,
    Odrive,
}

impl Family {
    /// Those that follow positions.
    pub const FOLLOWING: [Self; 5] =
        [Self::Cia402, Self::Cia402Interpolating, Self::Cia402Extrapolating, Self::Mit, Self::Odrive];

    /// The robot, by name or file, and a throw. It is kept as a file: what a scenario shows depends on the path of the arm, and must not
    /// change with the planner.
    const fn throw(self) -> (&'static str, &'static str) {
        macro_rules! robot {
            ($name:literal) => {
                concat!(env!("CARGO_MANIFEST_DIR"), "/../../robots/", $name, ".toml")
            };
        }
        match self {
            // To (1, 1, -1) m in the default form.
            Self::PowerCube => (ROBOT, include_str!("throw.json")),
            Self::Cia402 | Self::Cia402Interpolating | Self::Cia402Extrapolating => {
                (robot!("canopen6"), include_str!("throw_canopen6.json"))
            }
            Self::Mit => (robot!("openarm7"), include_str!("throw_openarm7.json")),
            Self::Odrive => (robot!("odrive6"), include_str!("throw_odrive6.json")),
        }
    }
}
/// The cell runs on after the job, so that what still moves is seen.
const AFTER: Duration = Duration::from_millis(1_500);
/// The arm starts this far from the start of the plan, towards zero, so that there is an approach.
const START_OFFSET_RAD: f64 = 0.15;

/// Motions beside the throw turn each joint by less.
const ROOM_RAD: f64 = 0.55;

/// What all throws have in common.
pub struct Bench {
    pub family: Family,
    pub robot_source: &'static str,
    pub arm: Arm,
    robot: RobotModel,
    settings: Settings,
    gains: Option<GainsFile>,
    pub plan: PlanFile,
    /// A landing farther from the target counts as missed, m.
    pub tolerance_m: f64,
}

impl Bench {
    /// With PowerCubes.
    pub fn new() -> Result<Self, String> {
        Self::of(Family::PowerCube)
    }

    /// Loads the throw and the gains for it.
    pub fn of(family: Family) -> Result<Self, String> {
        let (robot_source, throw) = family.throw();
        let mut robot = RobotModel::load(robot_source).map_err(|error| error.to_string())?;
        let path = Path::new(robot_source);
        let mut plan = PlanFile::from_json(path, throw).map_err(|error| error.to_string())?;
        plan.require_robot(path, &robot).map_err(|error| error.to_string())?;
        if family == Family::Cia402Interpolating {
            let (file, text) = text_of(robot_source).map_err(|error| error.to_string())?;
            let own = "mode = \"interpolated_position\", counts_per_turn = 360000";
            let text = text.replace("counts_per_turn = 655360", own);
            robot = RobotModel::from_toml(&file, &text).map_err(|error| error.to_string())?;
            // The motion stays the same.
            plan.robot.fingerprint = fingerprint_of(&robot);
        }
        let arm = robot.clone();
        let mut settings = settings_of(&robot).map_err(|error| error.to_string())?;
        let choice = choose(PeriodRequest::Any, None, &robot, settings.cycle_period_us)
            .map_err(|error| error.to_string())?;
        apply(&choice, &mut settings);
        Ok(Self {
            family,
            robot_source,
            tolerance_m: default_tolerance_m(&arm, &plan),
            arm,
            robot,
            settings,
            gains: Some(choice.gains),
            plan,
        })
    }

    /// A pose with each joint turned by so much towards zero, or the other way where the range of the joint ends near zero.
    pub fn turned(&self, q_rad: &Joints, by_rad: f64) -> Joints {
        Joints::from_fn(q_rad.len(), |joint| {
            let (limits, q) = (&self.arm.joints()[joint].limits, q_rad[joint]);
            let has_room = (limits.q_min_rad..=limits.q_max_rad).contains(&(q - ROOM_RAD.copysign(q)));
            q - if has_room { by_rad * 1.0_f64.copysign(q) } else { -by_rad * 1.0_f64.copysign(q) }
        })
    }

    pub fn controller(&self) -> NodeId {
        NodeId::from_low_bits(self.settings.node_id as u8)
    }

    /// A cell whose arm stands homed beside the start of the plan.
    pub fn scenario(&self, seed: u64) -> Scenario {
        let mut scenario = Scenario { name: "trust".to_owned(), seed, ..Scenario::default() };
        scenario.duration = Duration::from_secs(60);
        scenario.cell.drive.starts_homed = true;
        scenario.cell.servos_extrapolate = self.family == Family::Cia402Extrapolating;
        let start = self.plan.motion.to_motion().start_rad();
        scenario.cell.start_q_rad = Some(self.turned(&start, START_OFFSET_RAD).as_slice().to_vec());
        scenario
    }

    /// A cell whose joints have to find their zeros first.
    pub fn scenario_without_zeros(&self, seed: u64) -> Scenario {
        let mut scenario = self.scenario(seed);
        scenario.cell.drive.starts_homed = false;
        // Beside the home switches.
        scenario.cell.start_q_rad = None;
        scenario
    }

    pub fn throw(&self, scenario: &Scenario) -> Evidence {
        match catch_unwind(AssertUnwindSafe(|| self.try_throw(scenario))) {
            Ok(Ok(evidence)) => evidence,
            Ok(Err(failure)) => nothing(ReportedOutcome::Failed(failure.to_string())),
            Err(panic) => {
                let text = panic.downcast_ref::<String>().map(String::as_str);
                let text = text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("unknown");
                nothing(ReportedOutcome::Panicked(text.to_owned()))
            }
        }
    }

    fn try_throw(&self, scenario: &Scenario) -> Result<Evidence, BusFailure> {
        let mut setup = SimSetup {
            cell: scenario.cell.clone(),
            bus: scenario.bus,
            faults: scenario.faults.clone(),
            actions: scenario.actions.clone(),
        };
        take_plan(&mut setup.cell, &self.plan);
        let cell = Cell {
            robot_source: self.robot_source.to_owned(),
            robot: self.robot.clone(),
            seed: scenario.seed,
            setup,
        };
        let mut session = BusArgs::default().open_cell(&cell, Some(&self.settings))?;
        let tap = BusTap::new(&self.arm);
        session.add_tap(Box::new(tap.clone()));
        record_trace(&mut session)?;

        let travel = Travel { seed: scenario.seed, ..Travel::default() };
        let order = Order {
            gains: self.gains.as_ref(),
            judge: Judge::Throw { plan: &self.plan, tolerance_m: self.tolerance_m },
            ..Order::throw(&self.arm, &self.plan, travel)
        };
        let mut operator = OnBus::new(&mut session, None);
        let record = perform(&mut operator, &order, &mut |_| Answer::Yes);
        let job_end = session.now();
        let mut broken = match &record.ended {
            Some(JobError::Operator(OperatorError::Bus(failure))) => world_broken(failure),
            _ => None,
        };
        if broken.is_none() {
            // A program ends its session here; the cell goes on.
            let after = session.halt_if_moving().and_then(|()| session.pass(AFTER));
            broken = after.err().map(|failure| failure.to_string());
        }
        let end = session.now();
        let mut steps = record.steps.clone();
        steps.extend(record.at_work.map(|(step, begun): (Step, Instant)| (step, begun, job_end)));
        let reported = reported(&record);
        let Some(sim) = session.sim() else { return Ok(nothing(reported)) };
        let ball = sim.cell().throw().clone();
        let trace = sim.cell().trace().cloned().unwrap_or_default();
        let target = Vector3::from(self.plan.target.position_m);
        let (seen, reported_ball) = (Seen::of(&ball, &target, self.tolerance_m), record.ball);
        Ok(Evidence {
            reported,
            reported_ball,
            seen,
            ball,
            trace,
            bus: tap.take(),
            steps,
            job_end,
            end,
            broken,
        })
    }
}

/// A failure of the bus or of its simulation; a stop that another node gave is an outcome.
fn world_broken(failure: &BusFailure) -> Option<String> {
    (!matches!(failure, BusFailure::StoppedByOther(_))).then(|| failure.to_string())
}

fn record_trace(session: &mut Session) -> Result<(), BusFailure> {
    if let Some(sim) = session.sim() {
        sim.world().with_participants(|participants, _| participants.0.0.0.record_trace())?;
    }
    Ok(())
}

/// As the program reports it: exit code and text.
fn reported(record: &Record) -> ReportedOutcome {
    let verdict = &record.verdict;
    match (verdict.outcome, &record.ended) {
        (Outcome::Landed, _) => ReportedOutcome::Landed,
        (Outcome::Missed, _) => ReportedOutcome::Missed,
        (Outcome::NotReleased, _) => ReportedOutcome::NotReleased,
        (_, Some(JobError::Operator(OperatorError::Stopped { cause, joint, .. }))) => {
            ReportedOutcome::Cause { cause: *cause, joint: *joint }
        }
        (_, Some(JobError::Operator(OperatorError::Refused { refusal: Some(refusal), .. }))) => {
            ReportedOutcome::Cause { cause: refusal.cause, joint: refusal.joint }
        }
        _ => ReportedOutcome::Failed(verdict.text.clone()),
    }
}

fn nothing(reported: ReportedOutcome) -> Evidence {
    Evidence {
        reported,
        reported_ball: Default::default(),
        seen: Seen::NotReleased,
        ball: Default::default(),
        trace: Default::default(),
        bus: Default::default(),
        steps: Vec::new(),
        job_end: Instant::ZERO,
        end: Instant::ZERO,
        broken: None,
    }
}

//! A planned catch of a disc as a run of a controller: four simulated drives on a simulated bus, in virtual time.
//!
//! ```text
//! planner::disc::intercept ──► Plan ──► trajectory with its close event ──► controller ──► drives ──► plant
//!                                                                                                       │
//!                                      planner::disc::witness ◄── joints as the plant moved them ◄──────┘
//! ```
//!
//! The disc is released at an instant of the session. The run is ordered to begin so that its motion and the flight
//! have the same time zero; readings relate the controller's clock to the session. If plan and joints differ, the
//! drives, the controller and the clocks are the cause. The observer (`planner::disc::witness`) knows nothing of
//! them.

use firmware::settings::Settings;
use hil_sim::drive::PowerCubeDrive;
use hil_sim::fault::{Fault, FaultKind, Target, WireFault};
use planner::disc::Joints;
use planner::disc::arm::DiscArm;
use planner::disc::flight::Path;
use planner::disc::intercept::Plan;
use planner::disc::witness::{self, Gripper, Moment, Rule, Verdict};
use protocol::cyphal::cubecell::group_state::State;
use protocol::{Duration, Instant, ModuleId};
use robot_model::RobotModel;

use crate::bus::args::Cell;
use crate::bus::period::settings_with_gains;
use crate::bus::settings::NoSettings;
use crate::bus::sim::{SimBus, SimSetup};
use crate::bus::{BusArgs, BusFailure, Session};
use crate::dialogue::clock::ControllerClock;
use crate::dialogue::operator::OperatorError;
use crate::trajectory::{TrajectoryError, encode};

/// The arm stands for this long at the beginning of the run, before the disc is released. The gripper opens meanwhile.
const STAND: Duration = Duration::from_millis(200);
/// When the gripper is open, s after the release.
const OPEN_S: f64 = -0.05;
/// The order to close comes this much after the disc is between the fingers, s.
const CLOSE_LATER_S: f64 = 0.002;
/// From the order to run to its beginning.
const AHEAD: Duration = Duration::from_millis(300);
/// Longest time until the controller has found its drives, and for the run.
const READY_MAX: Duration = Duration::from_secs(10);
const RUN_MAX: Duration = Duration::from_secs(20);
/// The joints are looked at for this long after the motion, s.
const AFTER_S: f64 = 0.3;
/// Accelerations are means over this many samples: drives at a step of the acceleration overshoot for some milliseconds.
const WINDOW: usize = 40;

/// Why there is no run.
#[derive(Debug, thiserror::Error)]
pub enum NoRun {
    /// The robot has no drives, or no gains.
    #[error(transparent)]
    Settings(#[from] NoSettings),
    /// The motion is nothing that the controller would take.
    #[error(transparent)]
    Trajectory(#[from] TrajectoryError),
    /// The simulated bus cannot be opened.
    #[error(transparent)]
    Bus(#[from] BusFailure),
    /// The controller refuses or fails before anything has moved.
    #[error(transparent)]
    Operator(#[from] OperatorError),
}

impl NoRun {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        match self {
            Self::Settings(error) => error.next(),
            Self::Trajectory(error) => error.next(),
            Self::Bus(error) => error.next(),
            Self::Operator(error) => error.next(),
        }
    }
}

/// A drive whose frames end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DriveLost {
    /// Joint, from 0.
    pub joint: usize,
    /// When, s after the release of the disc.
    pub at_s: f64,
}

/// Joints as the plant has them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moved {
    /// Time since the release of the disc, s.
    pub t_s: f64,
    /// Angles, rad.
    pub q: Joints,
    /// Speeds, rad/s.
    pub qd: Joints,
}

/// A run that has begun.
#[derive(Debug)]
pub struct Executed {
    /// Result that the controller reported at the end.
    pub reported: Result<(), OperatorError>,
    /// Each millisecond, from the release on.
    pub moved: Vec<Moved>,
    /// When the gripper was ordered to close, s after the release: read at the drive.
    pub closed_s: Option<f64>,
    /// By how much the controller's clock may be off, s.
    pub clock_off_s: f64,
    /// Period of the controller, s.
    pub period_s: f64,
}

/// How far the joints were from the plan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tracking {
    /// Largest distance of each joint, rad.
    pub worst_rad: Joints,
    /// Distance of each joint in the middle of the dwell, rad.
    pub at_catch_rad: Joints,
    /// Tip of the gripper from where the plan has it: largest, and in the middle of the dwell, m.
    pub tip_m: (f64, f64),
}

/// A run and the result of its observer.
#[derive(Debug)]
pub struct Judged {
    pub executed: Executed,
    /// By the geometry of disc and gripper. Caught: the disc stays between the fingers from the order to close on for the dwell.
    pub verdict: Verdict,
    pub tracking: Tracking,
    /// Largest speeds (rad/s), and mean accelerations over 40 ms (rad/s²).
    pub speed_rad_s: Joints,
    pub acceleration_rad_s2: Joints,
}

/// Runs a plan and judges the result.
///
/// # Errors
/// [`NoRun`]: nothing has moved. A run that fails on its way has its cause in [`Executed::reported`].
pub fn run(
    robot: &RobotModel,
    arm: &DiscArm,
    path: &Path,
    plan: &Plan,
    lost: Option<DriveLost>,
) -> Result<Judged, NoRun> {
    let executed = execute(robot, plan, close_s(arm, path, plan), lost)?;
    let moments: Vec<Moment> = executed
        .moved
        .iter()
        .map(|moved| {
            let disc = path.at(moved.t_s);
            Moment { t_s: moved.t_s, q: moved.q, center_m: disc.p_m, normal: disc.normal }
        })
        .collect();
    let verdict = judge(arm, &moments, executed.closed_s);
    let tracking = tracking(arm, plan, &executed.moved);
    let (speed_rad_s, acceleration_rad_s2) = rates(&executed.moved);
    Ok(Judged { executed, verdict, tracking, speed_rad_s, acceleration_rad_s2 })
}

/// When the fingers begin to close, s after the release: by the plan the disc is between them for two milliseconds
/// then. Drives and clocks add less than that.
#[must_use]
pub fn close_s(arm: &DiscArm, path: &Path, plan: &Plan) -> f64 {
    let rule = Rule::default();
    let moments = witness::moments(|t_s| plan.motion.q(t_s), path, plan.motion.end_s());
    let planned = witness::judge(arm, &Gripper::default(), &rule, &moments).caught;
    let since_s = planned.map(|(_, seen)| seen.t_s - rule.dwell_s);
    since_s.unwrap_or(plan.choice.t_s - plan.reach.half_dwell_s) + CLOSE_LATER_S
}

fn execute(
    robot: &RobotModel,
    plan: &Plan,
    close_s: f64,
    lost: Option<DriveLost>,
) -> Result<Executed, NoRun> {
    let settings = settings_with_gains(robot, &SimSetup::default())?;
    let file = trajectory(plan, close_s, &settings)?;
    let mut session = open(robot, &plan.motion.q(plan.motion.from_s), &settings)?;
    session.watch_stops();
    let node = session.find_controller(None)?;
    session.wait_for(READY_MAX, &|state| state == State::Ready)?;
    let name = session.upload(node, &file, &mut |_, _| {})?;
    session.arm(node, &name)?;
    let mut clock = ControllerClock::default();
    session.read_clock(node, &mut clock)?;
    let begin = session.now() + AHEAD;
    let release = begin + STAND;
    let (start, off) = clock.controller_time(begin).ok_or(OperatorError::NoAnswer { node })?;
    if let Some(lost) = lost {
        lose(&mut session, release, lost)?;
    }
    if let Some(sim) = session.sim() {
        let recorded = sim.world().with_participants(|participants, _| participants.0.0.0.record_trace());
        recorded.map_err(BusFailure::from)?;
    }
    let reported =
        session.run_trajectory_at(node, &name, Some(start), RUN_MAX, &[], &mut |_, _| {}).map(drop);
    let until = release + Duration::from_secs_f64(plan.motion.end_s() + AFTER_S);
    session.halt_if_moving()?;
    session.pass(until.saturating_since(session.now()))?;
    let (moved, closed_s) = recorded(&mut session, release, until);
    let period_s = f64::from(settings.cycle_period_us) * 1e-6;
    Ok(Executed { reported, moved, closed_s, clock_off_s: off.as_secs_f64(), period_s })
}

/// The plan as the file of a controller.
fn trajectory(plan: &Plan, close_s: f64, settings: &Settings) -> Result<Vec<u8>, TrajectoryError> {
    let motion = plan.motion.as_motion(STAND.as_secs_f64() + plan.motion.from_s, OPEN_S, close_s);
    encode(&motion, settings.cycle_period_us, settings.robot_crc32, Some(settings))
}

/// The cell at the pose where the plan begins. Servos know their angles without homing.
fn open(robot: &RobotModel, start: &Joints, settings: &Settings) -> Result<Session, BusFailure> {
    let mut setup = SimSetup::default();
    setup.cell.start_q_rad = Some(start.as_slice().to_vec());
    setup.cell.drive.absolute_encoder = true;
    let cell = Cell { robot_source: robot.name().to_owned(), robot: robot.clone(), seed: 1, setup };
    BusArgs::default().open_cell(&cell, Some(settings))
}

fn lose(session: &mut Session, release: Instant, lost: DriveLost) -> Result<(), BusFailure> {
    let drive = |sim: &mut SimBus| sim.cell().drives().get(lost.joint).map(PowerCubeDrive::address);
    let address = session.sim().and_then(drive);
    let module = address.unwrap_or(ModuleId::MIN);
    let shift = Duration::from_secs_f64(lost.at_s.abs());
    let fault = Fault {
        label: "drive lost".to_owned(),
        kind: FaultKind::Wire(WireFault::Silent),
        target: Target::Module(module),
        filter: None,
        start: if lost.at_s < 0.0 { release.saturating_sub(shift) } else { release + shift },
        at: None,
        length: None,
        every: None,
        probability: 1.0,
    };
    if let Some(sim) = session.sim() {
        sim.world().add_fault(fault)?;
    }
    Ok(())
}

/// Motion of the plant between two times, and when its gripper was ordered to close.
fn recorded(session: &mut Session, release: Instant, until: Instant) -> (Vec<Moved>, Option<f64>) {
    let Some(trace) = session.sim().and_then(|sim| sim.cell().trace()) else { return (Vec::new(), None) };
    let since_s = |at: Instant| at.as_secs_f64() - release.as_secs_f64();
    let moved = (trace.index_at(release)..trace.index_at(until)).map(|index| {
        let joints = trace.sample(index);
        let of = |part: usize| Joints::from_fn(|j, _| joints.get(j).map_or(0.0, |joint| joint[part]));
        Moved { t_s: since_s(trace.at(index)), q: of(0), qd: of(1) }
    });
    let closed = trace.gripper_orders().iter().find(|(at, open)| !open && *at > release);
    (moved.collect(), closed.map(|(at, _)| since_s(*at)))
}

/// Contact of the disc before the order to close; then whether it is between the fingers for the dwell.
fn judge(arm: &DiscArm, moments: &[Moment], closed_s: Option<f64>) -> Verdict {
    let gripper = Gripper::default();
    let rule = Rule::default();
    // No disc is that deep: the observer only searches for contact.
    let never = Rule { depth_min_m: f64::INFINITY, ..rule };
    let close_s = closed_s.unwrap_or(f64::INFINITY);
    let split = moments.partition_point(|moment| moment.t_s < close_s);
    let before = witness::judge(arm, &gripper, &never, &moments[..split]);
    let dwell = moments.partition_point(|moment| moment.t_s < close_s + rule.dwell_s + 1.5e-3);
    let after = witness::judge(arm, &gripper, &rule, &moments[split..dwell]);
    let whole = witness::judge(arm, &gripper, &never, moments);
    Verdict {
        caught: after.caught.filter(|_| before.touched.is_none()).map(|(index, seen)| (split + index, seen)),
        touched: before.touched.or(after.touched),
        nearest: [before.nearest, after.nearest]
            .into_iter()
            .flatten()
            .min_by(|a, b| a.tip_to_axis_m.total_cmp(&b.tip_to_axis_m)),
        ..whole
    }
}

fn tracking(arm: &DiscArm, plan: &Plan, moved: &[Moved]) -> Tracking {
    let mut out = Tracking { worst_rad: Joints::zeros(), at_catch_rad: Joints::zeros(), tip_m: (0.0, 0.0) };
    let tip = |q: &Joints| {
        arm.model.ee_at(&(*q).into()).transform_point(&nalgebra::Vector3::new(arm.size.gripper_m, 0.0, 0.0))
    };
    let mut nearest_s = f64::INFINITY;
    for moved in moved {
        let planned = plan.motion.q(moved.t_s);
        let error = (moved.q - planned).abs();
        let tip_m = (tip(&moved.q) - tip(&planned)).norm();
        out.worst_rad = out.worst_rad.sup(&error);
        out.tip_m.0 = out.tip_m.0.max(tip_m);
        let from_catch_s = (moved.t_s - plan.choice.t_s).abs();
        if from_catch_s < nearest_s {
            (nearest_s, out.at_catch_rad, out.tip_m.1) = (from_catch_s, error, tip_m);
        }
    }
    out
}

fn rates(moved: &[Moved]) -> (Joints, Joints) {
    let speed = moved.iter().fold(Joints::zeros(), |most, moved| most.sup(&moved.qd.abs()));
    let means = moved.windows(WINDOW + 1).map(|window| {
        let (first, last) = (window[0], window[WINDOW]);
        ((last.qd - first.qd) / (last.t_s - first.t_s)).abs()
    });
    (speed, means.fold(Joints::zeros(), |most, mean| most.sup(&mean)))
}

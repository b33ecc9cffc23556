//! The steps of a throw, in order, on a session.

use nalgebra::Vector3;
use protocol::cyphal::cubecell::command::{GRIPPER, Gripper, Trajectory};
use protocol::cyphal::cubecell::group_state::{GroupState, State};
use protocol::cyphal::id::NodeId;
use protocol::{Duration, Instant, ModuleId};
use robot_model::collision::Scene;

use super::approach::{ApproachError, rest_to_rest};
use super::measured::{self, Collector, JointMap, Tracking};
use super::trajectory::{Motion, TrajectoryError, robot_crc32};
use crate::bus::Session;
use crate::bus::operator::OperatorError;
use crate::bus::registers::Numbers;
use crate::bus::session::BusFailure;
use crate::flight::FlightModel;
use crate::plan::file::PlanFile;
use crate::plan::{Arm, JOINTS, Joints};
use crate::tune::gains_file::GainsFile;

/// Longest start-up of a controller.
const BOOT_MAX: Duration = Duration::from_secs(20);
/// Longest homing of a group.
const HOMING_MAX: Duration = Duration::from_secs(180);
/// Room after the planned end of a run.
const RUN_EXTRA: Duration = Duration::from_secs(5);

/// What a throw is made of.
#[derive(Clone, Copy)]
pub struct Job<'a> {
    /// The robot.
    pub arm: &'a Arm,
    /// The throw.
    pub plan: &'a PlanFile,
    /// Gains to write into the controller; `None` keeps those it has.
    pub gains: Option<&'a GainsFile>,
    /// Which controller; `None`: the one that is heard.
    pub controller: Option<NodeId>,
    /// What is in the way beside the arm and the floor.
    pub scene: &'a Scene,
    /// Share of the robot's speeds and accelerations on the way to the start and back.
    pub approach_share: f64,
    /// Seed for ways around obstacles.
    pub seed: u64,
    /// Afterwards back to where the arm stood before.
    pub go_back: bool,
}

/// A step of the job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// A controller is heard.
    Controller,
    /// It finds its drives and proves their watchdogs.
    Drives,
    /// The joints find their zeros.
    Home,
    /// Gains and robot are agreed on.
    Gains,
    /// To the start of the plan.
    Approach,
    /// The plan goes to the controller, which checks it.
    Upload,
    /// Armed in two steps.
    Arm,
    /// The throw.
    Throw,
    /// The ball flies.
    Flight,
    /// Back to where the arm stood.
    Return,
}

impl Step {
    /// In words.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Controller => "find the controller",
            Self::Drives => "drives, watchdogs",
            Self::Home => "home",
            Self::Gains => "gains",
            Self::Approach => "to the start",
            Self::Upload => "upload",
            Self::Arm => "arm",
            Self::Throw => "throw",
            Self::Flight => "flight",
            Self::Return => "back",
        }
    }
}

/// Told to whoever calls.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum News<'a> {
    /// A step begins.
    Begin(Step),
    /// Part of it is done: so much of so much.
    Part(usize, usize),
    /// The arm is about to move: an answer of `false` ends the job before.
    MayThrow,
    /// A step has ended; what it found.
    End(Step, &'a str),
}

/// Whoever is told; the answer matters to [`News::MayThrow`] only.
pub type Told<'a> = &'a mut dyn FnMut(News<'_>) -> bool;

/// Why the job ended early.
#[derive(Debug, thiserror::Error)]
pub enum JobError {
    /// The bus, the controller, or Ctrl-C.
    #[error(transparent)]
    Operator(#[from] OperatorError),
    /// No way to the start.
    #[error(transparent)]
    Approach(#[from] ApproachError),
    /// A motion is nothing for a controller.
    #[error(transparent)]
    Trajectory(#[from] TrajectoryError),
    /// Gains for another period.
    #[error(
        "the controller runs at {controller_us} us, the gains are for {gains_us} us\n  next: tune for its period \
         (`cubectl tune --period {}`), or set register cycle.period_us", .controller_us / 1e6)]
    Period {
        /// Of the controller, µs.
        controller_us: f64,
        /// Of the gains, µs.
        gains_us: f64,
    },
    /// Gains for another number of joints.
    #[error("the gains are for joints {found}, the robot has {JOINTS}\n  next: `cubectl tune --joint all`")]
    GainsJoints {
        /// Numbers in the file.
        found: String,
    },
    /// The controller was started for another number of joints.
    #[error(
        "the controller has {found} joints, the robot {JOINTS}\n  next: name the robot of this controller with --robot"
    )]
    Joints {
        /// As it tells.
        found: usize,
    },
    /// Two drives answer where one should.
    #[error(
        "two modules answer at address {addresses}\n  next: unplug one of them and give the other a free address (parameter DefAddress, or the maker's tool)"
    )]
    Double {
        /// Where.
        addresses: String,
    },
    /// Somebody said no.
    #[error("not thrown")]
    Declined,
}

impl From<BusFailure> for JobError {
    fn from(failure: BusFailure) -> Self {
        Self::Operator(failure.into())
    }
}

/// What is known of a run so far; also of one that ended early.
#[derive(Clone, Debug, Default)]
pub struct Record {
    /// Controller.
    pub node: Option<NodeId>,
    /// Each step that ended: bus time at its begin and end.
    pub steps: Vec<(Step, Instant, Instant)>,
    /// The step at work.
    pub at_work: Option<(Step, Instant)>,
    /// Control period, µs.
    pub period_us: u64,
    /// Gains in force: on error, rate and last command, one per joint.
    pub gains: [Vec<f32>; 3],
    /// Checksum of their certificate; 0: none.
    pub certificate_crc32: u64,
    /// Duration of the way to the start, s; `None`: it stood there.
    pub approach_s: Option<f64>,
    /// Name of the throw's file in the controller.
    pub trajectory: Option<Trajectory>,
    /// State before the run, and each one during it with the time of its arrival.
    pub before: GroupState,
    /// During the run.
    pub states: Vec<(Instant, GroupState)>,
    /// When the plan's time was 0, by the session's clock.
    pub start: Option<Instant>,
    /// How well the joints followed, as the drives told.
    pub tracking: Option<Tracking>,
    /// Where the ball landed.
    pub landing: Option<Landed>,
    /// Frames during the throw.
    pub frames: u64,
}

/// Where the landing comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LandingSource {
    /// The simulated ball.
    Cell,
    /// Computed from the measured motion of the joints at the release.
    Measured,
}

/// Where the ball landed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Landed {
    /// How it is known.
    pub source: LandingSource,
    /// Where, m.
    pub position_m: Vector3<f64>,
    /// Distance from the target, m.
    pub error_m: f64,
    /// By how much the ball was free later than planned, s.
    pub release_late_s: Option<f64>,
    /// First contact of the flying ball with the arm, s after the release.
    pub touch_after_s: Option<f64>,
}

/// Does the job; `record` holds what is known, however it ends.
///
/// # Errors
/// [`JobError`]; the arm stands.
pub fn run(
    session: &mut Session,
    job: &Job<'_>,
    record: &mut Record,
    told: Told<'_>,
) -> Result<(), JobError> {
    let collector = Collector::default();
    session.add_tap(Box::new(collector.clone()));
    let mut steps = Steps { session, record, told };

    steps.begin(Step::Controller);
    let node = steps.session.find_controller(job.controller)?;
    steps.record.node = Some(node);
    steps.end(&format!("controller {}", node.get()));

    steps.begin(Step::Drives);
    steps.session.wait_for(BOOT_MAX, &|state| !matches!(state, State::Boot | State::Fault))?;
    let found = steps.session.measured_pose(node)?;
    if found.len() != JOINTS {
        return Err(JobError::Joints { found: found.len() });
    }
    let double: Vec<String> = steps.session.desk().double_answers().iter().map(ToString::to_string).collect();
    if !double.is_empty() {
        return Err(JobError::Double { addresses: double.join(", ") });
    }
    steps.end(&format!("{} drives answer, watchdogs proven", found.len()));

    let group = steps.session.group().unwrap_or_default();
    if group.state == State::Idle {
        steps.begin(Step::Home);
        let mask = !group.homed_mask & ((1 << JOINTS) - 1);
        steps.session.home_group(node, mask, HOMING_MAX)?;
        steps.end(&format!("{} joints found their zeros", mask.count_ones()));
    }

    steps.begin(Step::Gains);
    let map = agree(steps.session, node, job, steps.record)?;
    steps.end(if job.gains.is_some() { "written and read back" } else { "those of the controller" });

    let throw = Motion::of_plan(job.plan)?;
    let before = Joints::from_iterator(steps.session.measured_pose(node)?);
    steps.session.order(node, "to close the gripper", GRIPPER, &Gripper { open: false })?;
    let approach =
        rest_to_rest(job.arm, job.scene, (&before, &throw.start_rad()), job.approach_share, job.seed)?;
    if let Some(motion) = &approach {
        steps.begin(Step::Approach);
        drive(steps.session, node, job, steps.record.period_us, motion)?;
        steps.record.approach_s = Some(motion.duration_s());
        steps.end(&format!("{} legs, {:.1} s", motion.knots.len() - 1, motion.duration_s()));
    }
    if !(steps.told)(News::MayThrow) {
        return Err(JobError::Declined);
    }

    steps.begin(Step::Upload);
    let bytes =
        throw.encode(steps.record.period_us as u32, robot_crc32(&job.plan.robot.fingerprint), None)?;
    let told = &mut *steps.told;
    let name = steps.session.upload(node, &bytes, &mut |done, all| {
        told(News::Part(done, all));
    })?;
    steps.record.trajectory = Some(name);
    steps.end(&format!("{} bytes, hash {:016x}", bytes.len(), name.trajectory_crc64));

    steps.begin(Step::Arm);
    steps.session.arm(node, &name)?;
    steps.end("offered and confirmed");

    steps.begin(Step::Throw);
    collector.clear();
    steps.record.before = steps.session.group().unwrap_or_default();
    let limit = Duration::from_secs_f64(throw.duration_s()) + RUN_EXTRA;
    let states = &mut steps.record.states;
    let ended = steps.session.run_trajectory(node, &name, limit, &mut |at, group| states.push((at, *group)));
    let heard = collector.heard();
    steps.record.frames = heard.frames;
    steps.record.start = start_of(&steps.record.states);
    if let Some(start) = steps.record.start {
        steps.record.tracking = Some(measured::tracking(&heard, &map, &throw, start));
    }
    ended?;
    steps.end(&format!("{:.3} s", throw.duration_s()));

    steps.begin(Step::Flight);
    let flight_left = job.plan.release_time_s + job.plan.landing.flight_s - throw.duration_s();
    steps.session.pass(Duration::from_secs_f64(flight_left.max(0.0) + 0.05))?;
    let landed = landing(steps.session, job, (&throw, steps.record.start), &heard, &map);
    steps.record.landing = landed;
    steps.end(&landed.map_or_else(
        || "the ball did not land".to_owned(),
        |landed| format!("landed {:.1} mm from the target", 1e3 * landed.error_m),
    ));

    if job.go_back {
        let here = Joints::from_iterator(steps.session.measured_pose(node)?);
        let empty = Scene { ball_held: false, ..job.scene.clone() };
        if let Some(motion) = rest_to_rest(job.arm, &empty, (&here, &before), job.approach_share, job.seed)? {
            steps.begin(Step::Return);
            drive(steps.session, node, job, steps.record.period_us, &motion)?;
            steps.end(&format!("{:.1} s", motion.duration_s()));
        }
    }
    Ok(())
}

/// Keeps the times of the steps.
struct Steps<'a, 'b> {
    session: &'a mut Session,
    record: &'a mut Record,
    told: Told<'b>,
}

impl Steps<'_, '_> {
    fn begin(&mut self, step: Step) {
        self.record.at_work = Some((step, self.session.now()));
        (self.told)(News::Begin(step));
    }

    fn end(&mut self, found: &str) {
        if let Some((step, begun)) = self.record.at_work.take() {
            self.record.steps.push((step, begun, self.session.now()));
            (self.told)(News::End(step, found));
        }
    }
}

/// Runs one motion to its end.
fn drive(
    session: &mut Session,
    node: NodeId,
    job: &Job<'_>,
    period_us: u64,
    motion: &Motion,
) -> Result<(), JobError> {
    let bytes = motion.encode(period_us as u32, robot_crc32(&job.plan.robot.fingerprint), None)?;
    let name = session.upload(node, &bytes, &mut |_, _| {})?;
    session.arm(node, &name)?;
    let limit = Duration::from_secs_f64(motion.duration_s()) + RUN_EXTRA;
    session.run_trajectory(node, &name, limit, &mut |_, _| {})?;
    Ok(())
}

/// Gains, robot and period: written where the job says so, read back, kept in the record.
fn agree(
    session: &mut Session,
    node: NodeId,
    job: &Job<'_>,
    record: &mut Record,
) -> Result<JointMap, JobError> {
    const GAINS: [&str; 3] = ["joint.k_error_1_s2", "joint.k_rate_1_s", "joint.k_last"];
    record.period_us = session.natural(node, "cycle.period_us")?;
    let crc = robot_crc32(&job.plan.robot.fingerprint);
    session.set_register(node, "group.robot_crc32", &crc.into())?;
    if let Some(file) = job.gains {
        let gains_us = (file.period_s * 1e6).round();
        if gains_us != record.period_us as f64 {
            return Err(JobError::Period { controller_us: record.period_us as f64, gains_us });
        }
        if !file.joint.iter().map(|joint| joint.number).eq(1..=JOINTS) {
            let numbers: Vec<String> = file.joint.iter().map(|joint| joint.number.to_string()).collect();
            return Err(JobError::GainsJoints { found: numbers.join(", ") });
        }
        for (which, name) in GAINS.into_iter().enumerate() {
            let numbers = file.joint.iter().map(|joint| joint.gains()[which]).collect();
            session.set_register(node, name, &Numbers::Real(numbers))?;
        }
        session.set_register(node, "gains.period_us", &(gains_us as u32).into())?;
        let certificate = firmware::crc::Crc32::of(file.to_toml().as_bytes());
        session.set_register(node, "gains.certificate_crc32", &certificate.into())?;
    }
    for (numbers, name) in record.gains.iter_mut().zip(GAINS) {
        if let Numbers::Real(found) = session.register(node, name)? {
            *numbers = found;
        }
    }
    record.certificate_crc32 = session.natural(node, "gains.certificate_crc32")?;
    joint_map(session, node)
}

fn joint_map(session: &mut Session, node: NodeId) -> Result<JointMap, JobError> {
    let unreadable = || JobError::Operator(OperatorError::Unreadable { node });
    let (Numbers::Natural(addresses), Numbers::Bit(inverted), Numbers::Real(offset_rad)) = (
        session.register(node, "joint.address")?,
        session.register(node, "joint.inverted")?,
        session.register(node, "joint.offset_rad")?,
    ) else {
        return Err(unreadable());
    };
    let modules: Option<Vec<ModuleId>> =
        addresses.iter().map(|n| ModuleId::new(u8::try_from(*n).ok()?).ok()).collect();
    let modules = modules.and_then(|all| all.try_into().ok()).ok_or_else(unreadable)?;
    let offset_rad: Vec<f64> = offset_rad.into_iter().map(f64::from).collect();
    Ok(JointMap {
        modules,
        inverted: inverted.try_into().map_err(|_| unreadable())?,
        offset_rad: offset_rad.try_into().map_err(|_| unreadable())?,
        reply_age: Duration::from_micros(session.natural(node, "reply.age_us")?),
        gripper_opening: Duration::from_micros(session.natural(node, "gripper.opening_us")?),
    })
}

/// When the plan's time was 0, by the session's clock.
///
/// A message says how far the plan was when it was made, by the controller's clock; it arrives later. The one that
/// took the shortest way tells the offset of the two clocks best.
fn start_of(states: &[(Instant, GroupState)]) -> Option<Instant> {
    let running =
        states.iter().filter(|(_, group)| group.state == State::Running && group.trajectory_time_us > 0);
    let offset = |(at, group): &(Instant, GroupState)| at.as_micros() as i64 - group.uptime_us as i64;
    let shortest = running.clone().map(offset).min()?;
    let (_, first) = running.clone().next()?;
    let start = first.uptime_us as i64 - i64::from(first.trajectory_time_us) + shortest;
    u64::try_from(start).ok().map(Instant::from_micros)
}

/// Where the ball landed: the cell knows, or the measured motion says.
fn landing(
    session: &mut Session,
    job: &Job<'_>,
    (motion, start): (&Motion, Option<Instant>),
    heard: &measured::Heard,
    map: &JointMap,
) -> Option<Landed> {
    let target = Vector3::from(job.plan.target.position_m);
    let planned = start.map(|start| start + Duration::from_secs_f64(job.plan.release_time_s));
    let late_s =
        |free: Instant| planned.map(|planned| (free.as_micros() as f64 - planned.as_micros() as f64) * 1e-6);
    let error_m = |p: &Vector3<f64>| (p - target).norm();
    if let Some(sim) = session.sim() {
        let report = sim.cell().throw();
        let landing = report.landing?;
        return Some(Landed {
            source: LandingSource::Cell,
            position_m: landing.p_m,
            error_m: error_m(&landing.p_m),
            release_late_s: report.released_at.and_then(late_s),
            touch_after_s: report.touch.as_ref().map(|(t_s, _)| *t_s),
        });
    }
    let info = &job.plan.landing;
    let flight = FlightModel::vacuum(info.gravity_m_s2).and_then(|f| f.with_drag(info.drag_per_m)).ok()?;
    let flight = flight.with_magnus(Vector3::from(info.magnus_rad_s)).ok()?;
    let free = heard.gripper_ordered_at.map_or(planned, |ordered| Some(ordered + map.gripper_opening))?;
    let state = measured::state_at(heard, map, (motion, start?), free)?;
    let position_m = measured::landing(job.arm, &flight, &state, target.z)?;
    Some(Landed {
        source: LandingSource::Measured,
        position_m,
        error_m: error_m(&position_m),
        release_late_s: late_s(free),
        touch_after_s: None,
    })
}

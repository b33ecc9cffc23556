//! Gains tried on the simulated cell: the controller of the firmware, drives, arm and ball in virtual time.
//!
//! What [`super::compare`] does with one joint and an idealised drive, with all joints, gravity, coupling, bus and the
//! firmware's own estimator: evidence, not proof.

use firmware::Controller;
use firmware::authority::{Peer, Seed};
use firmware::events::PlanEvents;
use firmware::groups::powercube::PowerCubes;
use firmware::joints::PerJoint;
use firmware::orders::{Done, Order};
use firmware::registers::certificate_crc32;
use firmware::settings::Settings;
use firmware::spline::{Knot, Spline};
use firmware::state::StateKind;
use firmware::store::{FileName, RamStorage};
use firmware::trajectory_format::{self, FILE_LEN_MAX, Header};
use hil_sim::bus::BusConfig;
use hil_sim::participants::Solo;
use hil_sim::world::{Observer, World};
use hil_sim::{Cell, CellOptions};
use protocol::cyphal::crc::Crc64;
use protocol::{Duration, Frame, Instant, JointIndex};
use robot_model::RobotModel;
use robot_model::cubic::Cubic;

use super::saturated::Gains;
use crate::model::Estimator;

/// From this period on replies may take as long as in the paper, µs.
const LONG_PERIOD_US: u32 = 10_000;
/// After this the start is over, s.
pub const LATE_S: f64 = 0.35;
/// Time for start-up, self-test of the watchdogs included.
const START_UP: Duration = Duration::from_secs(5);
/// Longest wait for the ball to land.
const FLIGHT: Duration = Duration::from_millis(600);

/// A motion through points with given velocities, cubic in between.
#[derive(Clone, Debug, PartialEq)]
pub struct TrialMotion {
    /// Time, s; position, rad, and velocity, rad/s, of each joint.
    pub knots: Vec<(f64, Vec<(f64, f64)>)>,
    /// When the gripper lets go, s.
    pub release_s: Option<f64>,
    pub target_m: Option<[f64; 3]>,
}

impl TrialMotion {
    /// Position, rad, and velocity, rad/s, of a joint.
    fn at(&self, joint: usize, t_s: f64) -> (f64, f64) {
        let (first, last) = (&self.knots[0], &self.knots[self.knots.len() - 1]);
        let t_s = t_s.clamp(first.0, last.0);
        let after = self.knots.partition_point(|knot| knot.0 < t_s).clamp(1, self.knots.len() - 1);
        let ((t0, from), (t1, to)) = (&self.knots[after - 1], &self.knots[after]);
        let cubic = Cubic::between(t1 - t0, from[joint], to[joint]);
        (cubic.position(t_s - t0), cubic.velocity(t_s - t0))
    }

    fn joints(&self) -> usize {
        self.knots.first().map_or(0, |knot| knot.1.len())
    }

    fn file(&self, period_us: u32) -> Option<Vec<u8>> {
        let us = |t_s: f64| (t_s * 1e6).round() as u32;
        let knots: Vec<Knot> = self
            .knots
            .iter()
            .map(|(t_s, states)| {
                let mut state = PerJoint::default();
                for (joint, (q, v)) in JointIndex::first(states.len()).zip(states) {
                    state.set(joint, (*q as f32, *v as f32));
                }
                Knot { t_us: us(*t_s), state }
            })
            .collect();
        let events = PlanEvents::release(self.release_s.map(us));
        let header = Header { joints: self.joints() as u8, period_us, events, ..Header::default() };
        let mut out = vec![0; FILE_LEN_MAX];
        let len = trajectory_format::encode(&header, &knots, &mut out)?;
        out.truncate(len);
        Some(out)
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct Trial {
    /// Time from the order to run until the position error of each joint stays below half of the initial one, s;
    /// empty without initial error. The plan itself begins two periods after the order.
    pub halved_s: Vec<f64>,
    /// Largest position error of any joint after 0.35 s, rad.
    pub late_max_rad: f64,
    /// Largest position and velocity error at the release, rad and rad/s.
    pub release: (f64, f64),
    /// Distance of the landing from the target, m.
    pub landing_m: Option<f64>,
}

/// Why a trial has no result.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TrialError {
    /// Cell or bus.
    #[error("the simulated cell: {0}")]
    Cell(String),
    /// The controller refuses, stops or does not get ready.
    #[error("the controller in the simulated cell {0}")]
    Controller(String),
}

/// Sees nothing.
struct Quiet;

impl Observer for Quiet {
    fn on_frame(&mut self, _: Instant, _: Option<usize>, _: &Frame) {}
}

/// Settings of the soft controller with these gains; everything else as for the robot.
pub fn settings(of_robot: &Settings, gains: &[Gains], period_s: f64, estimator: Estimator) -> Settings {
    let mut settings = *of_robot;
    let period_us = (period_s * 1e6).round() as u32;
    (settings.cycle_period_us, settings.gains_period_us) = (period_us, period_us);
    (settings.estimator_alpha, settings.estimator_beta) = (estimator.alpha as f32, estimator.beta as f32);
    if period_us >= LONG_PERIOD_US {
        settings.reply_deadline_us = Settings::powercube6_paper().reply_deadline_us;
    }
    for (joint, &[k_pos, k_vel, k_last]) in JointIndex::first(gains.len()).zip(gains) {
        let joint = settings.joint.at_mut(joint);
        (joint.k_error_1_s2, joint.k_rate_1_s, joint.k_last) = (k_pos, k_vel, k_last);
        // Beside the path is where a trial starts.
        joint.start_tolerance_rad = 0.15;
    }
    // The simulated controller runs what is to be compared, proven or not.
    (settings.gains_delay_min_us, settings.gains_delay_max_us) = (period_us, period_us);
    settings.gains_certificate_crc32 = certificate_crc32(&settings);
    settings
}

type Node = Solo<Controller<RamStorage, Spline, PowerCubes>>;

struct Lab {
    world: World<(Cell, Node)>,
    beat: Instant,
}

impl Lab {
    fn pass(&mut self, span: Duration) -> Result<(), TrialError> {
        let cell = |e: hil_sim::world::RunError| TrialError::Cell(e.to_string());
        let end = self.world.now() + span;
        while self.world.now() < end {
            if self.world.now() >= self.beat {
                self.beat = self.world.now() + Duration::from_millis(20);
                self.world
                    .with_participants(|participants, now| participants.1.node.host_heartbeat(now, HOST))
                    .map_err(cell)?;
            }
            self.world.run_until(end.min(self.beat), &mut Quiet).map_err(cell)?;
        }
        Ok(())
    }

    fn order(&mut self, order: Order) -> Result<Done, TrialError> {
        let done =
            self.world.with_participants(|participants, now| participants.1.node.order(now, HOST, order));
        done.map_err(|e| TrialError::Cell(e.to_string()))?
            .map_err(|refusal| TrialError::Controller(format!("refuses: {refusal:?}")))
    }

    fn controller(&self) -> &Controller<RamStorage, Spline, PowerCubes> {
        &self.world.participants().1.node
    }

    fn wait_for(&mut self, kind: StateKind, limit: Duration) -> Result<(), TrialError> {
        let until = self.world.now() + limit;
        while self.controller().state().kind() != kind {
            if self.world.now() >= until {
                let state = self.controller().state().kind();
                return Err(TrialError::Controller(format!("is {state:?} after {limit}")));
            }
            self.pass(Duration::from_millis(10))?;
        }
        Ok(())
    }

    /// Uploads, arms and starts; the time at which the plan begins.
    fn start(&mut self, file: &[u8], period_us: u32) -> Result<Instant, TrialError> {
        self.wait_for(StateKind::Ready, START_UP)?;
        self.pass(Duration::from_millis(60))?;
        let upload =
            self.world.with_participants(|participants, now| participants.1.node.upload(now, HOST, 0, file));
        upload
            .map_err(|e| TrialError::Cell(e.to_string()))?
            .map_err(|refusal| TrialError::Controller(format!("refuses the motion: {refusal:?}")))?;
        let name = FileName { crc64: Crc64::of(file), len: file.len() as u32 };
        self.order(Order::Commit(name))?;
        let valid = Duration::from_secs(5);
        let Done::Offer { token, .. } = self.order(Order::ArmPrepare { crc64: name.crc64, valid })? else {
            return Err(TrialError::Controller("makes no offer to arm".to_owned()));
        };
        self.order(Order::ArmConfirm { token, valid })?;
        self.pass(Duration::from_millis(60))?;
        self.order(Order::Run(name))?;
        Ok(self.world.now() + Duration::from_micros(2 * u64::from(period_us)))
    }
}

/// The node that gives the orders of a trial.
const HOST: Peer = Peer::new(42);

/// Runs `motion` with every joint displaced by `offset_rad` from its start.
pub fn run(
    robot: &RobotModel,
    settings: &Settings,
    motion: &TrialMotion,
    offset_rad: f64,
    seed: u64,
) -> Result<Trial, TrialError> {
    let cell = |e: &dyn std::fmt::Display| TrialError::Cell(e.to_string());
    let mut options = CellOptions::default();
    options.drive.starts_homed = true;
    options.gripper.jitter = Duration::ZERO;
    options.start_q_rad = Some((0..motion.joints()).map(|i| motion.at(i, 0.0).0 + offset_rad).collect());
    let plant = Cell::new(robot, &options, seed).map_err(|e| cell(&e))?;
    let node = Solo::new("controller", Controller::new(RamStorage::new(), settings, Seed::FORESEEABLE));
    let world = World::new((plant, node), BusConfig::default(), seed, Vec::new()).map_err(|e| cell(&e))?;
    let mut lab = Lab { world, beat: Instant::ZERO };
    let file = motion
        .file(settings.cycle_period_us)
        .ok_or_else(|| TrialError::Controller("cannot hold a motion of so many points".to_owned()))?;
    let start = lab.start(&file, settings.cycle_period_us)?;
    let mut trial = Trial {
        halved_s: vec![0.0; if offset_rad == 0.0 { 0 } else { motion.joints() }],
        late_max_rad: 0.0,
        release: (f64::NAN, f64::NAN),
        landing_m: None,
    };
    let lead_s = 2e-6 * f64::from(settings.cycle_period_us);
    let end_s = motion.knots.last().map_or(0.0, |knot| knot.0);
    loop {
        lab.pass(Duration::from_millis(1))?;
        // The plant moves only when it is called; between the commands of a long period it is not.
        lab.world.with_participants(|_, _| ()).map_err(|e| cell(&e))?;
        let t_s = lab.world.participants().0.grid().as_secs_f64() - start.as_secs_f64();
        if t_s > end_s {
            break;
        }
        if lab.controller().state().kind() != StateKind::Running {
            return Err(TrialError::Controller(format!("stops: {:?}", lab.controller().state().kind())));
        }
        observe(&lab.world.participants().0, motion, (t_s, lead_s), offset_rad, &mut trial);
    }
    lab.pass(FLIGHT)?;
    let landing = lab.world.participants().0.throw().landing;
    trial.landing_m = motion
        .target_m
        .zip(landing)
        .map(|(target, landing)| (landing.p_m[0] - target[0]).hypot(landing.p_m[1] - target[1]));
    Ok(trial)
}

/// `lead_s` is between the order to run and time 0 of the motion.
fn observe(cell: &Cell, motion: &TrialMotion, (t_s, lead_s): (f64, f64), offset_rad: f64, trial: &mut Trial) {
    let (mut e_max, mut v_max) = (0.0f64, 0.0f64);
    for i in 0..motion.joints() {
        let (q, v) = motion.at(i, t_s);
        let e = (cell.plant().link_q_rad(i) - q).abs();
        (e_max, v_max) = (e_max.max(e), v_max.max((cell.plant().axis(i).v_rad_s - v).abs()));
        if e > 0.5 * offset_rad.abs() && offset_rad != 0.0 {
            trial.halved_s[i] = t_s + lead_s;
        }
    }
    if t_s > LATE_S {
        trial.late_max_rad = trial.late_max_rad.max(e_max);
    }
    // The grid of the cell is 1 ms.
    if motion.release_s.is_some_and(|release_s| (t_s - release_s).abs() <= 6e-4) {
        trial.release = (e_max, v_max);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn motion_is_watched_between_the_commands_of_a_long_period_too() {
        let upright = [0.1, -1.47, -1.47, 0.1, 0.1, 0.1];
        let all = |way_rad: f64, v_rad_s: f64| upright.map(|q| (q + way_rad, v_rad_s)).to_vec();
        let knots = vec![(0.0, all(0.0, 0.0)), (0.6, all(0.12, 0.3)), (1.0, all(0.2, 0.0))];
        // The release is between two commands.
        let motion = TrialMotion { knots, release_s: Some(0.6), target_m: None };
        let gains = [[-185.5, -23.07, -0.4546]; 6];
        let settings = settings(&Settings::powercube6(), &gains, 0.017, Estimator::PLAIN);
        let robot = RobotModel::load("powercube6").unwrap();
        let found = run(&robot, &settings, &motion, 0.05, 1).unwrap();
        assert!(found.release.0 > 1e-6 && found.release.0 < 5e-3, "{found:?}");
        assert!(found.release.1 > 1e-6 && found.release.1 < 0.1, "{found:?}");
        // Errors that fall alike are halved within a few milliseconds, not within one period.
        let (first, last) =
            found.halved_s.iter().fold((f64::INFINITY, 0.0f64), |(a, b), t| (a.min(*t), b.max(*t)));
        assert!(first > 0.06 && last < 0.2 && last - first < 0.012, "{found:?}");
    }
}

//! An arm of six drives behind its controller, on a simulated bus in virtual time or on a bus in real time.
//!
//! The controller runs a plan that stands still and takes new end states over in flight ([`crate::dialogue::online`]). It solves and
//! checks the way to each of them itself; what comes back is taken, or refused with the cause. Time zero of the trial is a time
//! of the session; the controller's clock is related to it by readings.

use super::executor::{Executor, Order, Refused};
use crate::bus::{BusArgs, BusFailure, Session};
use crate::dialogue::clock::ControllerClock;
use crate::dialogue::online::EndStates;
use crate::dialogue::operator::OperatorError;
use crate::log::keep::Keeper;
use crate::samples::Samples;
use crate::samples::drives::Drives;
use crate::trajectory::{TrajectoryError, encode_any, standing};
use firmware::settings::Settings;
use hil_sim::two_arms::JointsNow;
use planner::catch::Joints;
use planner::motion::Motion;
use protocol::cyphal::cubecell::command::{GRIPPER, Gripper};
use protocol::cyphal::cubecell::group_state::State;
use protocol::cyphal::cubecell::joint_state::JointSample;
use protocol::cyphal::cubecell::stop::Reason;
use protocol::cyphal::id::NodeId;
use protocol::{Duration, Instant};
use robot_model::RobotModel;

/// Longest time from the opening of the session to a controller that answers, and for homing, s.
const READY_MAX: Duration = Duration::from_secs(10);
const HOMING_MAX: Duration = Duration::from_secs(120);
/// Time for the way from the home pose to the waiting pose, and until it has ended.
const WAY: Duration = Duration::from_secs(4);
const SETTLED: Duration = Duration::from_secs(5);
/// An arm that stands is ordered to stand there this much later, s.
const END_S: f64 = 0.2;
/// Time for coming to rest after a halt.
const HALTED: Duration = Duration::from_secs(1);
/// Length of the plan that stands still: longer than any throw.
const STANDING: Duration = Duration::from_secs(20);
/// Time for a motion on top of its own.
const RUN_MORE: Duration = Duration::from_secs(10);

/// Why there is no arm.
#[derive(Debug, thiserror::Error)]
pub enum NoArm {
    #[error(transparent)]
    Bus(#[from] BusFailure),
    #[error(transparent)]
    Operator(#[from] OperatorError),
    #[error("the plan that stands still cannot be written")]
    Plan,
    #[error("the controller refuses the way to the waiting pose: {0}")]
    Wait(String),
    #[error("the controller reports no joints")]
    NoJoints,
    #[error(transparent)]
    Trajectory(#[from] TrajectoryError),
}

impl NoArm {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        match self {
            Self::Bus(error) => error.next(),
            Self::Operator(error) => error.next(),
            Self::Trajectory(error) => error.next(),
            Self::Plan | Self::Wait(_) | Self::NoJoints => None,
        }
    }
}

/// The arm. Its trial begins at [`ControllerArm::begin`].
pub struct ControllerArm {
    session: Session,
    settings: Settings,
    node: NodeId,
    clock: ControllerClock,
    zero: Instant,
    joints: JointsNow,
    sequence: u8,
    refused: Vec<Refused>,
    halted: bool,
    keeper: Keeper,
    /// End states that the controller has taken, and that it has refused.
    pub answered: (usize, usize),
}

impl ControllerArm {
    /// From a decision to the first motion because of it, s: a message of up to 6 ms, two control periods and the lag of the
    /// drives.
    pub const ACTUATION_S: f64 = 0.017;

    /// A simulated arm in virtual time that is homed, has gone to `wait` and takes end states. Some tens of seconds of virtual time.
    pub fn new(wait: &Joints) -> Result<Self, NoArm> {
        Self::on(BusArgs::default().open_with_controller()?, &Settings::powercube6(), wait)
    }

    /// The same on a session whose bus has six drives and a controller with `settings`.
    pub fn on(session: Session, settings: &Settings, wait: &Joints) -> Result<Self, NoArm> {
        let mut arm = Self::at(session, settings, wait)?;
        arm.begin()?;
        Ok(arm)
    }

    /// An arm that rests at `pose`; homed before, if it was not. The way there is straight in the joints and takes four seconds:
    /// nothing looks for contact on it, and nothing stands in the way of a simulated arm.
    fn at(session: Session, settings: &Settings, pose: &Joints) -> Result<Self, NoArm> {
        let mut arm = Self::connect(session, settings)?;
        arm.begin_way(pose)?;
        arm.session.pass(SETTLED)?;
        arm.collect();
        if let Some(why) = arm.refused.pop() {
            return Err(NoArm::Wait(why.to_string()));
        }
        arm.wait_until_ready()?;
        Ok(arm)
    }

    /// The arm as it stands; homed before, if it was not.
    pub fn connect(mut session: Session, settings: &Settings) -> Result<Self, NoArm> {
        session.watch_stops();
        let node = session.find_controller(None)?;
        session.wait_for(READY_MAX, &|state| state != State::Boot)?;
        if session.group().is_some_and(|group| group.state == State::Idle) {
            session.home_group(node, 0x3F, HOMING_MAX)?;
        }
        let mut clock = ControllerClock::default();
        session.read_clock(node, &mut clock)?;
        let zero = session.now();
        let keeper = Keeper::default();
        session.add_tap(Box::new(keeper.clone()));
        Ok(Self {
            session,
            keeper,
            settings: *settings,
            node,
            clock,
            zero,
            joints: JointsNow { q: Joints::zeros(6), qd: Joints::zeros(6) },
            sequence: 0,
            refused: Vec::new(),
            halted: false,
            answered: (0, 0),
        })
    }

    /// Measured joint angles, rad.
    pub fn pose(&mut self) -> Result<Joints, OperatorError> {
        Ok(Joints::from_slice(&self.session.measured_pose(self.node)?))
    }

    /// Keeps what the drives answer from now on, for [`ControllerArm::kept_joints`].
    pub fn keep(&self) {
        self.keeper.start();
    }

    /// Joints as the drives have measured them since [`ControllerArm::keep`], rad, at times of the trial, s. Nothing is kept any more.
    #[must_use]
    pub fn kept_joints(&self, robot: &RobotModel) -> Vec<(f64, Joints)> {
        let lines = self.keeper.stop();
        let Some(drives) = Drives::of(robot) else { return Vec::new() };
        let joints = Samples::of_log(lines, drives, robot, self.session.bit_rate_bit_s()).joints;
        let Some(first) = joints.first() else { return Vec::new() };
        // Drives answer one after the other: the others are taken between two of their answers.
        let at = |at: Instant| {
            let mut q = Joints::zeros(joints.len());
            for (joint, q) in joints.iter().zip(q.iter_mut()) {
                let later = joint.positions.partition_point(|position| position.at < at);
                let (after, before) =
                    (joint.positions.get(later)?, joint.positions.get(later.saturating_sub(1))?);
                let span_s = after.at.saturating_since(before.at).as_secs_f64();
                let share =
                    if span_s > 0.0 { at.saturating_since(before.at).as_secs_f64() / span_s } else { 0.0 };
                *q = before.value + share * (after.value - before.value);
            }
            Some((self.at_s(at), q))
        };
        first.positions.iter().filter_map(|position| at(position.at)).collect()
    }

    /// Time zero of the trial on the session's clock, and Unix time at that clock's zero, which is zero in virtual time.
    #[must_use]
    pub fn zero(&self) -> (Instant, Duration) {
        (self.zero, self.session.zero_unix())
    }

    /// A time of the session as one of the trial, s.
    #[must_use]
    pub fn at_s(&self, at: Instant) -> f64 {
        at.as_secs_f64() - self.zero.as_secs_f64()
    }

    /// Runs a motion from where the arm stands to its end.
    pub fn go(&mut self, motion: &Motion) -> Result<(), NoArm> {
        let Settings { cycle_period_us, robot_crc32, .. } = self.settings;
        let plan = encode_any(motion, cycle_period_us, robot_crc32, Some(&self.settings))?;
        let name = self.session.upload(self.node, &plan.file, &mut |_, _| {})?;
        self.session.arm(self.node, &name)?;
        let limit = Duration::from_secs_f64(motion.duration_s()) + RUN_MORE;
        self.session.run_trajectory_at(self.node, &name, None, limit, &plan.segments, &mut |_, _| {})?;
        Ok(())
    }

    /// Orders the hand to open, or to close; while no motion runs.
    pub fn set_hand(&mut self, open: bool) -> Result<(), OperatorError> {
        let what = if open { "to open the hand" } else { "to close the hand" };
        self.session.order(self.node, what, GRIPPER, &Gripper { open }).map(drop)
    }

    /// Ends a run in which the arm waits where it stands.
    ///
    /// # Errors
    /// The controller does not get ready, or refuses.
    pub fn end(&mut self) -> Result<(), NoArm> {
        if self.session.group().is_some_and(|group| group.state == State::Running) {
            let here = self.pose()?;
            self.send(self.now_s() + END_S, &here, &Joints::zeros(6))
                .map_err(|why| NoArm::Wait(why.to_string()))?;
        }
        self.wait_until_ready()?;
        self.session.release_motion();
        Ok(())
    }

    /// Ends the session; what moves is halted before.
    pub fn finish(mut self) -> Result<(), BusFailure> {
        self.session.halt_if_moving()?;
        self.session.finish()
    }

    /// A run ends when the way to its last end state has ended.
    fn wait_until_ready(&mut self) -> Result<(), NoArm> {
        Ok(self.session.wait_for(READY_MAX, &|state| state == State::Ready)?)
    }

    /// Begins to take end states, for 20 s. The time of the trial is zero now.
    pub fn begin(&mut self) -> Result<(), NoArm> {
        self.begin_for(STANDING)
    }

    /// As [`ControllerArm::begin`], for so long.
    pub fn begin_for(&mut self, span: Duration) -> Result<(), NoArm> {
        self.stand(span)?;
        self.session.read_clock(self.node, &mut self.clock)?;
        self.zero = self.session.now();
        self.answered = (0, 0);
        self.joints = self.joints_now().ok_or(NoArm::NoJoints)?;
        Ok(())
    }

    pub fn parts(&mut self) -> (&mut Session, NodeId, &mut ControllerClock) {
        (&mut self.session, self.node, &mut self.clock)
    }

    /// Time of the trial, s.
    #[must_use]
    pub fn now_s(&self) -> f64 {
        self.at_s(self.session.now())
    }

    /// Begins a run whose end state is rest at `to`, in four seconds. The time of the trial begins again at zero.
    pub fn begin_way(&mut self, to: &Joints) -> Result<(), NoArm> {
        self.stand(STANDING)?;
        self.zero = self.session.now();
        self.send(WAY.as_secs_f64(), to, &Joints::zeros(6)).map_err(|why| NoArm::Wait(why.to_string()))
    }

    /// Uploads, arms and runs a plan that stands where the arm stands and takes new end states.
    fn stand(&mut self, span: Duration) -> Result<(), NoArm> {
        let pose = self.session.measured_pose(self.node)?;
        let span_us = u32::try_from(span.as_micros()).map_err(|_| NoArm::Plan)?;
        let bytes = standing(&self.settings, &pose, span_us).ok_or(NoArm::Plan)?;
        let name = self.session.upload(self.node, &bytes, &mut |_, _| {})?;
        self.session.arm(self.node, &name)?;
        self.session.start_run(self.node, &name)?;
        self.session.pass(Duration::from_millis(100))?;
        Ok(())
    }

    /// Halts the arm and lets it come to rest.
    pub fn stop(&mut self) -> Result<(), NoArm> {
        self.session.halt(Reason::OPERATOR)?;
        self.session.pass(HALTED)?;
        self.halted = true;
        Ok(())
    }

    fn send(&mut self, at_s: f64, q: &Joints, qd: &Joints) -> Result<(), Refused> {
        let ours = self.zero + Duration::from_secs_f64(at_s);
        let Some((at, _)) = self.clock.controller_time(ours) else { return Err(Refused::NotSent) };
        let end = EndStates { at, q_rad: q.to_vec(), qd_rad_s: qd.to_vec(), events: Vec::new() };
        self.sequence = self.sequence.wrapping_add(1);
        self.session.send_target(self.sequence, &end).map_err(|_| Refused::NotSent)
    }

    fn collect(&mut self) {
        for answer in self.session.target_answers(self.node) {
            match answer.outcome {
                Ok(()) => self.answered.0 += 1,
                Err(refusal) => {
                    self.answered.1 += 1;
                    self.refused.push(Refused::Controller(refusal));
                }
            }
        }
    }

    /// In virtual time where the plant has the joints, which no node on the bus can read; otherwise what the controller reported last.
    fn joints_now(&mut self) -> Option<JointsNow> {
        if let Some(sim) = self.session.sim() {
            let plant = sim.cell().plant();
            let q = Joints::from_fn(6, |i| plant.link_q_rad(i));
            let qd = Joints::from_fn(6, |i| plant.axis(i).v_rad_s);
            return Some(JointsNow { q, qd });
        }
        let (_, _, state) = self.session.host_node().inbox()?.joints.as_ref()?;
        let joints = state.joints();
        let of = |number: fn(&JointSample) -> f32| {
            Joints::from_fn(6, |i| joints.get(i).map_or(f64::NAN, |joint| f64::from(number(joint))))
        };
        Some(JointsNow { q: of(|joint| joint.q_rad), qd: of(|joint| joint.qd_rad_s) })
    }
}

impl Executor for ControllerArm {
    fn take(&mut self, order: &Order<'_>, _now_s: f64) -> Result<(), Refused> {
        if self.halted {
            return Err(Refused::Halted);
        }
        self.send(order.t_s, &order.q, &order.qd)
    }

    fn advance(&mut self, to_s: f64) -> JointsNow {
        let to = self.zero + Duration::from_secs_f64(to_s);
        let span = to.saturating_since(self.session.now());
        let passed = span.is_zero() || self.session.pass(span).is_ok();
        self.collect();
        // Ready: the way to the last end state has ended.
        let state = self.session.group().map(|group| group.state);
        self.halted |= !(passed && matches!(state, Some(State::Running | State::Ready)));
        if let Some(joints) = self.joints_now() {
            self.joints = joints;
        }
        self.joints
    }

    fn refused(&mut self) -> Option<Refused> {
        self.refused.pop()
    }

    fn halted(&self) -> bool {
        self.halted
    }
}

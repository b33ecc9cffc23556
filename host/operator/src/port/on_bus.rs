//! The operator of a controller on a bus: a session, and the node of the controller.

use firmware::fault::Refusal;
use protocol::cyphal::cubecell::command::{GRIPPER, Gripper, STOP, Trajectory};
use protocol::cyphal::cubecell::group_state::{GroupState, State};
use protocol::cyphal::id::NodeId;
use protocol::{Duration, Instant};

use super::{BallSeen, Interactive, Operator};
use crate::bus::Session;
use crate::bus::session::Ended;
use crate::dialogue::clock::ControllerClock;
use crate::dialogue::extending::SEGMENT;
use crate::dialogue::online::EndStates;
use crate::dialogue::operator::OperatorError;
use crate::dialogue::registers::Numbers;
use crate::log::keep::Keeper;
use crate::samples::Samples;
use crate::samples::drives::Drives;
use crate::servo::LEAD;
use crate::trajectory::{Encoded, Segment};
use planner::throw::Arm;

/// A stop along the path takes at most this long.
const STOP_MAX: Duration = Duration::from_secs(10);

pub struct OnBus<'a> {
    session: &'a mut Session,
    /// The requested controller; `None`: the one on the bus.
    wanted: Option<NodeId>,
    node: Option<NodeId>,
    clock: ControllerClock,
    keeper: Keeper,
    /// The next run is a throw that releases this long after its start.
    release_after: Option<Duration>,
    /// Segments of the plan that was uploaded last.
    segments: Vec<Segment>,
}

impl<'a> OnBus<'a> {
    /// Operator of the controller `wanted`, or of the one on the bus.
    pub fn new(session: &'a mut Session, wanted: Option<NodeId>) -> Self {
        let keeper = Keeper::default();
        session.add_tap(Box::new(keeper.clone()));
        session.watch_stops();
        Self {
            session,
            wanted,
            node: None,
            clock: ControllerClock::default(),
            keeper,
            release_after: None,
            segments: Vec::new(),
        }
    }

    fn node(&self) -> Result<NodeId, OperatorError> {
        self.node.ok_or(OperatorError::NoController)
    }
}

impl Operator for OnBus<'_> {
    fn now(&self) -> Instant {
        self.session.now()
    }

    fn connect(&mut self) -> Result<Option<NodeId>, OperatorError> {
        self.node = Some(self.session.find_controller(self.wanted)?);
        Ok(self.node)
    }

    fn heed_stops(&mut self) -> Result<(), OperatorError> {
        Ok(self.session.heed_stops()?)
    }

    fn pass(&mut self, span: Duration) -> Result<(), OperatorError> {
        Ok(self.session.pass(span)?)
    }

    fn group(&mut self) -> GroupState {
        self.session.group().unwrap_or_default()
    }

    fn wait_for(&mut self, limit: Duration, wanted: &dyn Fn(State) -> bool) -> Result<(), OperatorError> {
        self.session.wait_for(limit, wanted)
    }

    fn pose(&mut self) -> Result<Vec<f64>, OperatorError> {
        let node = self.node()?;
        self.session.measured_pose(node)
    }

    fn register(&mut self, name: &str) -> Result<Numbers, OperatorError> {
        let node = self.node()?;
        self.session.register(node, name)
    }

    fn set_register(&mut self, name: &str, wanted: &Numbers) -> Result<(), OperatorError> {
        let node = self.node()?;
        self.session.set_register(node, name, wanted)
    }

    fn set_gripper(&mut self, open: bool) -> Result<(), OperatorError> {
        let node = self.node()?;
        let what = if open { "to open the gripper" } else { "to close the gripper" };
        self.session.order(node, what, GRIPPER, &Gripper { open }).map(drop)
    }

    fn home(&mut self, mask: u8, limit: Duration) -> Result<(), OperatorError> {
        let node = self.node()?;
        self.session.home_group(node, mask, limit)
    }

    fn upload(
        &mut self,
        plan: &Encoded,
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<Trajectory, OperatorError> {
        let node = self.node()?;
        self.segments = plan.segments.clone();
        self.session.upload(node, &plan.file, progress)
    }

    fn segment_s(&self) -> f64 {
        SEGMENT.as_secs_f64()
    }

    fn arm(&mut self, name: &Trajectory) -> Result<(), OperatorError> {
        let node = self.node()?;
        self.session.arm(node, name)
    }

    fn expect_throw(&mut self, release_s: f64) {
        self.release_after = Some(Duration::from_secs_f64(release_s));
    }

    fn run(
        &mut self,
        name: &Trajectory,
        start: Option<Instant>,
        limit: Duration,
        progress: &mut dyn FnMut(Instant, &GroupState),
    ) -> Result<(), OperatorError> {
        let node = self.node()?;
        let now = self.session.now();
        let begins = start.unwrap_or(now);
        if let (Some(release), Some(sim)) = (self.release_after.take(), self.session.sim()) {
            sim.world().faults_mut().throw_begins(now, begins, begins + release);
        }
        self.session.run_trajectory_at(node, name, start, limit, &self.segments, progress).map(drop)
    }

    fn controller_time(&mut self, ours: Instant) -> Result<(Instant, Duration), OperatorError> {
        let node = self.node()?;
        let mut clock = ControllerClock::default();
        self.session.read_clock(node, &mut clock)?;
        // There is a reading: the last line made one.
        clock.controller_time(ours).ok_or(OperatorError::Unreadable { node })
    }

    fn stop(&mut self) -> Result<(), OperatorError> {
        let node = self.node()?;
        // The controller's report of this stop is expected.
        self.session.host_node().stops.end();
        self.session.order(node, "to stop", STOP, &())?;
        match self.session.wait_for(STOP_MAX, &|state| !state.may_move()) {
            Err(OperatorError::Stopped { .. }) => Ok(()),
            other => other,
        }
    }

    fn keep_samples(&mut self) {
        self.keeper.start();
    }

    fn frames_kept(&self) -> usize {
        self.keeper.frames()
    }

    fn take_samples(&mut self, arm: &Arm, drives: Option<Drives>) -> Option<Samples> {
        let lines = self.keeper.stop();
        Some(Samples::of_log(lines, drives.or_else(|| Drives::of(arm))?, arm, self.session.bit_rate_bit_s()))
    }

    fn double_answers(&mut self) -> Vec<String> {
        self.session.host_node().double_answers().iter().map(ToString::to_string).collect()
    }

    fn ball(&mut self) -> Option<BallSeen> {
        Some(BallSeen::of(self.session.sim()?.cell()))
    }
}

impl Interactive for OnBus<'_> {
    fn lead(&self) -> Duration {
        LEAD
    }

    fn start(&mut self, name: &Trajectory) -> Result<(), OperatorError> {
        let node = self.node()?;
        self.session.start_run(node, name)
    }

    fn read_clock(&mut self) -> Result<(), OperatorError> {
        let node = self.node()?;
        self.clock = ControllerClock::default();
        self.session.read_clock(node, &mut self.clock)
    }

    fn clock_offset_us(&mut self, ours: Instant) -> Option<f64> {
        let (there, _) = self.clock.controller_time(ours)?;
        Some(there.as_micros() as f64 - ours.as_micros() as f64)
    }

    fn look_at_clock(&mut self) -> Result<(), OperatorError> {
        let node = self.node()?;
        self.session.look_at_clock(node, &mut self.clock)
    }

    fn send_target(&mut self, sequence: u8, end: &EndStates) -> Result<(), OperatorError> {
        self.session.send_target(sequence, end)
    }

    fn refused_targets(&mut self) -> Vec<Refusal> {
        let Some(node) = self.node else { return Vec::new() };
        let answers = self.session.target_answers(node);
        answers.into_iter().filter_map(|answer| answer.outcome.err()).collect()
    }

    fn run_until(&mut self, until: Instant) -> Result<bool, OperatorError> {
        Ok(self.session.run(until, &mut |_| false)? == Ended::Interrupted)
    }

    fn release_motion(&mut self) {
        self.session.release_motion();
    }

    fn is_interrupted(&self) -> bool {
        self.session.is_interrupted()
    }

    fn needs_times(&self) -> bool {
        self.session.is_simulated()
    }

    fn clear_fault(&mut self) -> Result<(), OperatorError> {
        let node = self.session.find_controller(self.wanted)?;
        self.node = Some(node);
        let group = self.session.group().unwrap_or_default();
        if group.state == State::Fault { self.session.clear_fault(node, group.fault_cause) } else { Ok(()) }
    }

    fn heed_stops_from_now(&mut self) {
        self.session.watch_stops();
    }
}

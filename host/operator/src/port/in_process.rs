//! The operator of a controller in this program: orders are calls, without a host link on the wire.
//!
//! The drives are those of a simulated cell, in virtual time. This operator is the host of the controller: while
//! time passes, it gives signs of life.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use firmware::Controller;
use firmware::authority::{Peer, Seed};
use firmware::fault::Cause;
use firmware::group::DriveGroup;
use firmware::host_link::group_message;
use firmware::orders::{Done, Order};
use firmware::settings::Settings;
use firmware::spline::Spline;
use firmware::store::{FileName, RamStorage};
use hil_sim::participants::{Participants, Solo};
use hil_sim::scenario::ScriptedHost;
use hil_sim::{Cell, Observer, World};
use protocol::cyphal::cubecell::command::Trajectory;
use protocol::cyphal::cubecell::group_state::{GroupState, State};
use protocol::cyphal::id::NodeId;
use protocol::{Duration, Frame, Instant};
use robot_model::RobotModel;

use super::{BallSeen, Operator};
use crate::bus::BusFailure;
use crate::bus::sim::SimSetup;
use crate::dialogue::following::Following;
use crate::dialogue::operator::{
    ARMING_VALID_MS, FRESH, FRESH_LOOK, OperatorError, name_of, refused, stopped,
};
use crate::dialogue::presence::PRESENCE;
use crate::dialogue::registers::{Numbers, to_controller, to_host};
use crate::drives::CanDrives;
use crate::node::stop_watch::StopWatch;
use crate::samples::Samples;
use crate::samples::drives::Drives;
use crate::samples::of_controller::Kept;
use crate::trajectory::{Encoded, Segment};
use planner::throw::Arm;

/// Time between two looks at the controller: a few in each control period.
const SLICE: Duration = Duration::from_micros(500);
/// Bytes of one piece of an upload.
const PIECE: usize = 256;
/// A stop along the path takes at most this long.
const STOP_MAX: Duration = Duration::from_secs(10);

type Members = ((Cell, Solo<ScriptedHost>), Solo<Controller<RamStorage, Spline, CanDrives>>);

/// A controller in this program, with the drives of a simulated cell.
pub struct InProcess {
    world: World<Members>,
    /// Report of the controller, and its time.
    reported: (Instant, GroupState),
    kept: Option<Kept>,
    /// Once set, no more time passes.
    stop: Option<Arc<AtomicBool>>,
    stops: StopWatch,
    /// The next run is a throw that releases this long after its start.
    release_after: Option<Duration>,
    /// Segments of the plan that was uploaded last.
    segments: Vec<Segment>,
}

/// Gives the watch every frame but the controller's own.
struct Others<'a> {
    stops: &'a mut StopWatch,
    controller: usize,
}

impl Observer for Others<'_> {
    fn on_frame(&mut self, at: Instant, from: Option<usize>, frame: &Frame) {
        if from != Some(self.controller) {
            self.stops.take_frame(at, frame);
        }
    }
}

impl InProcess {
    /// A controller with `settings` and the cell of `robot`, with chances from `seed`.
    ///
    /// # Errors
    /// The robot has no drives, or there are more nodes than a bus has ports.
    pub fn new(
        robot: &RobotModel,
        setup: &SimSetup,
        seed: u64,
        settings: &Settings,
    ) -> Result<Self, BusFailure> {
        // Orders come only from inside the program, so tokens may be predictable.
        let drives = CanDrives::of(robot)?;
        let (storage, spline) = (RamStorage::new(), Spline::empty());
        let controller = Controller::with_group(storage, spline, drives, settings, Seed::FORESEEABLE);
        let cell = Cell::new(robot, &setup.cell, seed)?;
        let script = Solo::new("script", ScriptedHost::new(&setup.actions));
        let participants = ((cell, script), Solo::new("controller", controller));
        let mut world = World::new(participants, setup.bus, seed, setup.faults.clone())?;
        world.faults_mut().await_throw();
        let reported = (Instant::ZERO, GroupState::default());
        Ok(Self {
            world,
            reported,
            kept: None,
            stop: None,
            stops: StopWatch::of_others(),
            release_after: None,
            segments: Vec::new(),
        })
    }

    /// Lets `flag`, once it is set, end what is under way with [`OperatorError::Interrupted`], at most 0.5 ms of virtual time later.
    pub fn stop_with(&mut self, flag: Arc<AtomicBool>) {
        self.stop = Some(flag);
    }

    #[must_use]
    pub fn cell(&self) -> &Cell {
        &self.world.participants().0.0
    }

    fn controller(&self) -> &Controller<RamStorage, Spline, CanDrives> {
        &self.world.participants().1.node
    }

    /// Acts on the controller; what it wants to send leaves.
    fn act<R>(
        &mut self,
        act: impl FnOnce(&mut Controller<RamStorage, Spline, CanDrives>, Instant) -> R,
    ) -> Result<R, OperatorError> {
        let result = self.world.with_participants(|participants, now| {
            participants.1.node.host_heartbeat(now, Peer::LOCAL);
            act(&mut participants.1.node, now)
        });
        Ok(result.map_err(BusFailure::from)?)
    }

    fn order(&mut self, what: &'static str, order: Order) -> Result<Done, OperatorError> {
        self.heed_stops()?;
        self.act(|controller, now| controller.order(now, Peer::LOCAL, order))?
            .map_err(|refusal| refused(what, refusal))
    }

    /// Lets at most one slice of time pass.
    fn step(&mut self, until: Instant) -> Result<(), OperatorError> {
        if self.stop.as_ref().is_some_and(|stop| stop.load(Ordering::Relaxed)) {
            return Err(OperatorError::Interrupted);
        }
        let to = (self.world.now() + SLICE).min(until);
        let controller = self.world.participants().0.len();
        let was_pending = self.stops.is_pending();
        let mut others = Others { stops: &mut self.stops, controller };
        self.world.run_until(to, &mut others).map_err(BusFailure::from)?;
        if self.stops.is_pending() && !was_pending {
            // Without a host link no other node passes a stop message on to the controller.
            self.act(Controller::stop_now)?;
        }
        let last = self.reported.1;
        let reported = self.act(|controller, now| {
            let due = controller.take_telemetry_due(now);
            (due || controller.state().kind() != last.state).then(|| (due, controller.take_sample(now)))
        })?;
        let now = self.world.now();
        if let Some((_, sample)) = &reported {
            self.reported = (now, group_message(sample, last.sequence.wrapping_add(1), false));
            self.stops.take_state(now, &self.reported.1);
        }
        if let Some(kept) = &mut self.kept {
            let controller = &self.world.participants().1.node;
            kept.collect(now, controller, reported.is_some_and(|(due, _)| due));
            if reported.is_some() {
                kept.hear(now, controller, &self.reported.1);
            }
        }
        Ok(())
    }

    /// Gives the controller the segments from number `next` on for which it has room; how many it has then.
    fn extend_from(&mut self, next: usize) -> Result<usize, OperatorError> {
        let segments = std::mem::take(&mut self.segments);
        let taken = self.act(|controller, now| {
            let refused = |segment: &Segment| controller.extend(now, Peer::LOCAL, &segment.bytes).err();
            segments[next..].iter().map(refused).position(|refusal| refusal.is_some())
        });
        let (all, taken) = (segments.len(), taken?);
        self.segments = segments;
        // Without room, or while the arm stops, segments wait. If a segment is wrong, the plan ends early, and the state shows
        // it.
        Ok(taken.map_or(all, |taken| next + taken))
    }

    /// Reports a stop once, when the controller has reported it or does not.
    fn end_if_stopped(&mut self) -> Result<(), OperatorError> {
        let Some(stop) = self.stops.due(self.world.now(), Some(self.reported)) else { return Ok(()) };
        self.stops.end();
        // The caller gets the controller's report of a fault.
        if stop.by_other { Err(BusFailure::StoppedByOther(stop).into()) } else { Ok(()) }
    }

    /// Lets time pass until `done` returns true; false if it did not before `until`.
    fn pass_until(
        &mut self,
        until: Instant,
        done: &mut dyn FnMut(Instant, &GroupState) -> bool,
    ) -> Result<bool, OperatorError> {
        loop {
            let (at, reported) = self.reported;
            let is_done = done(at, &reported);
            self.end_if_stopped()?;
            if is_done {
                return Ok(true);
            }
            if self.world.now() >= until {
                return Ok(false);
            }
            self.step(until)?;
        }
    }
}

impl Operator for InProcess {
    fn now(&self) -> Instant {
        self.world.now()
    }

    fn connect(&mut self) -> Result<Option<NodeId>, OperatorError> {
        self.stops.start();
        let now = self.world.now();
        let heard = self.pass_until(now + PRESENCE, &mut |at, _| at > now)?;
        if heard { Ok(None) } else { Err(OperatorError::NoController) }
    }

    fn pass(&mut self, span: Duration) -> Result<(), OperatorError> {
        let until = self.world.now() + span;
        while self.world.now() < until {
            self.step(until)?;
        }
        Ok(())
    }

    fn heed_stops(&mut self) -> Result<(), OperatorError> {
        while self.stops.is_pending() {
            self.end_if_stopped()?;
            self.step(self.world.now() + SLICE)?;
        }
        Ok(())
    }

    fn group(&mut self) -> GroupState {
        self.reported.1
    }

    fn wait_for(&mut self, limit: Duration, wanted: &dyn Fn(State) -> bool) -> Result<(), OperatorError> {
        let until = self.world.now() + limit;
        let ended = self.pass_until(until, &mut |_, group| {
            wanted(group.state) || matches!(group.state, State::Fault | State::Stopped)
        })?;
        let group = self.reported.1;
        match ended {
            true if wanted(group.state) => Ok(()),
            true => Err(stopped(&group)),
            false => Err(OperatorError::NoProgress { state: group.state, limit }),
        }
    }

    fn pose(&mut self) -> Result<Vec<f64>, OperatorError> {
        let asked_at = self.world.now();
        let pose = |controller: &Controller<RamStorage, Spline, CanDrives>| {
            let position = |joint| controller.group().position(joint).filter(|p| p.at > asked_at);
            controller.joints().map(|joint| position(joint).map(|p| f64::from(p.q_rad))).collect()
        };
        while self.world.now() < asked_at + PRESENCE {
            self.step(asked_at + PRESENCE)?;
            self.end_if_stopped()?;
            let measured: Option<Vec<f64>> = pose(self.controller());
            if let Some(measured) = measured {
                return Ok(measured);
            }
        }
        Err(OperatorError::NoAnswer { node: node_of(self.controller()) })
    }

    fn register(&mut self, name: &str) -> Result<Numbers, OperatorError> {
        let numbers = self.controller().register_named(name);
        let numbers = numbers.ok_or_else(|| OperatorError::NoRegister { name: name.to_owned() })?;
        Ok(to_host(numbers.as_slice()))
    }

    fn set_register(&mut self, name: &str, wanted: &Numbers) -> Result<(), OperatorError> {
        let numbers = to_controller(wanted);
        self.act(|controller, now| controller.write_register(now, Peer::LOCAL, name, &numbers))?
            .map_err(|refusal| refused("to change a register", refusal))?;
        let found = self.register(name)?;
        if found == *wanted {
            return Ok(());
        }
        let name = name.to_owned();
        Err(OperatorError::RegisterRefused { name, wanted: wanted.to_string(), found: found.to_string() })
    }

    fn set_gripper(&mut self, open: bool) -> Result<(), OperatorError> {
        let what = if open { "to open the gripper" } else { "to close the gripper" };
        self.order(what, Order::Gripper { open }).map(drop)
    }

    fn home(&mut self, mask: u8, limit: Duration) -> Result<(), OperatorError> {
        self.order("homing", Order::Home { mask })?;
        self.wait_for(limit, &|state| state == State::Homing)?;
        self.wait_for(limit, &|state| matches!(state, State::Ready | State::Idle))
    }

    fn upload(
        &mut self,
        plan: &Encoded,
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<Trajectory, OperatorError> {
        let Encoded { file: bytes, segments } = plan;
        let name = name_of(bytes)?;
        self.segments = segments.clone();
        for (k, piece) in bytes.chunks(PIECE).enumerate() {
            self.act(|controller, now| controller.upload(now, Peer::LOCAL, PIECE * k, piece))?
                .map_err(|refusal| refused("the trajectory", refusal))?;
            progress(PIECE * k + piece.len(), bytes.len());
        }
        self.order("the trajectory", Order::Commit(file(&name)))?;
        Ok(name)
    }

    fn arm(&mut self, name: &Trajectory) -> Result<(), OperatorError> {
        let valid = Duration::from_millis(ARMING_VALID_MS.into());
        let offer = Order::ArmPrepare { crc64: name.trajectory_crc64, valid };
        let Done::Offer { token, .. } = self.order("to arm", offer)? else {
            return Err(OperatorError::Unreadable { node: node_of(self.controller()) });
        };
        let until = self.world.now() + FRESH;
        // After homing or a reset the controller reads the drives again before it trusts them.
        loop {
            match self.order("the arming", Order::ArmConfirm { token, valid }) {
                Err(OperatorError::Refused { refusal: Some(refusal), .. })
                    if refusal.cause == Cause::DriveNotReady.code() && self.world.now() < until =>
                {
                    self.pass(FRESH_LOOK)?;
                }
                answer => {
                    answer?;
                    return self.wait_for(Duration::from_secs(2), &|state| state == State::Armed);
                }
            }
        }
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
        // Both clocks are the same, so the order is given shortly before.
        if let Some(start) = start {
            self.pass_until(start, &mut |_, _| false)?;
        }
        self.order("to run", Order::Run(file(name)))?;
        let ordered_at = self.world.now();
        if let Some(release) = self.release_after.take() {
            self.world.faults_mut().throw_begins(ordered_at, ordered_at, ordered_at + release);
        }
        let mut following = Following::new(ordered_at);
        let (until, mut extended) = (ordered_at + limit, 0);
        let ended = loop {
            extended = self.extend_from(extended)?;
            let is_last = extended == self.segments.len();
            let look = if is_last { until } else { (self.world.now() + FRESH_LOOK).min(until) };
            let ended = self.pass_until(look, &mut |at, group| following.has_ended(at, group, progress))?;
            if ended || look == until {
                break ended;
            }
        };
        let group = self.reported.1;
        match (ended, group.state) {
            (true, State::Ready) => Ok(()),
            (true, State::Stopped | State::Fault) => Err(stopped(&group)),
            _ => {
                self.stop()?;
                Err(OperatorError::NoProgress { state: group.state, limit })
            }
        }
    }

    fn stop(&mut self) -> Result<(), OperatorError> {
        self.order("to stop", Order::Stop)?;
        match self.wait_for(STOP_MAX, &|state| !state.may_move()) {
            Err(OperatorError::Stopped { .. }) => Ok(()),
            other => other,
        }
    }

    fn keep_samples(&mut self) {
        self.kept = Some(Kept::new(self.controller()));
    }

    fn take_samples(&mut self, _: &Arm, _: Option<Drives>) -> Option<Samples> {
        self.kept.take().map(|kept| kept.samples)
    }

    fn ball(&mut self) -> Option<BallSeen> {
        Some(BallSeen::of(self.cell()))
    }
}

fn node_of(controller: &Controller<RamStorage, Spline, CanDrives>) -> NodeId {
    NodeId::from_low_bits(controller.settings().node_id as u8)
}

fn file(name: &Trajectory) -> FileName {
    FileName { crc64: name.trajectory_crc64, len: name.length_bytes }
}

//! The joint-group controller: a [`Node`] on the drives' bus, and the doors for a host.
//!
//! # Calls
//!
//! * **Bus**: the [`Node`] contract. Frames of 29-bit ids are not its business.
//! * **Host**: [`Controller::order`], [`Controller::stop_now`], [`Controller::host_heartbeat`], registers, upload.
//!   They do not know by which protocol a host speaks. After each call the runner drains
//!   [`Node::poll_frame`], as after a `handle_*` call; `now` obeys the same rule.
//! * **Queries** change nothing.
//!
//! # Files
//!
//! `drive_io` sends and matches; `boot`, `homing`, `jogging`, `running`, `stopping` are the states that do
//! something; `standing` says whether the joints stand and watches that they do; `authority` says who may order what,
//! `arming` and `host` take orders; `report` makes samples.
//!
//! # Bounded work
//!
//! One call handles one frame or one set of deadlines: at most one control step (a fixed number of
//! operations per joint) and at most [`QUEUE_LEN`](crate::groups::powercube::transmit::QUEUE_LEN) frames out. Only a commit takes longer,
//! a few milliseconds on a Cortex-M4 for the longest file, and it is refused while anything is armed or moves.

mod arming;
mod authority;
mod boot;
mod drive_io;
mod homing;
mod host;
mod jogging;
mod report;
mod running;
mod standing;
mod stopping;

use core::borrow::BorrowMut;

use protocol::powercube::{Broadcast, Gate, Parameter, Request, Value};
use protocol::{Duration, Frame, Instant, JointIndex, Node};

use crate::authority::{Keyring, Peer, Seed, Session, Tokens};
use crate::feedback::ErrorEstimator;
use crate::freeze::FreezeFrame;
use crate::gripper::Gripper;
use crate::groups::powercube::drive_model::DriveModel;
use crate::groups::powercube::drives::Drive;
use crate::groups::powercube::order::Order;
use crate::groups::powercube::pace::{CycleTimes, Pace};
use crate::groups::powercube::ramp;
use crate::groups::powercube::schedule::Schedule;
use crate::groups::powercube::slots::Slots;
use crate::groups::powercube::transmit::TransmitQueue;
use crate::joints::{PerJoint, at_least, clamp};
use crate::registers;
use crate::settings::Settings;
use crate::span;
use crate::spline::{Setpoint, Spline};
use crate::state::{Machine, State, StateKind};
use crate::store::{self, Storage, TrajectoryStore};
use crate::telemetry::Counters;
use crate::trace::{Event, Trace};

/// Firmware that answers [`Parameter::PosStateDio`].
const POS_STATE_GATE: Gate = Gate::From2518Or3518;

/// Generator of a drive as our commands should have left it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Generator {
    v_rad_s: f32,
    a_rad_s2: f32,
    /// Speed it keeps once reached.
    cap_rad_s: f32,
    at: Instant,
}

impl Generator {
    /// Velocity at a time near the last command.
    fn v_at(&self, t: Instant) -> f32 {
        let dt_s = span::seconds(t.saturating_since(self.at));
        let v = self.v_rad_s + self.a_rad_s2 * dt_s;
        if v * self.a_rad_s2 > 0.0 {
            let cap = at_least(self.v_rad_s.abs(), self.cap_rad_s);
            clamp(v, -cap, cap)
        } else {
            v
        }
    }
}

/// A motion on its way: an answer after the next control step belongs to this one, not to the one decided meanwhile.
#[derive(Clone, Copy, Debug, Default)]
struct Sent {
    /// Start of its cycle.
    cycle_at: Instant,
    u_rad_s2: f32,
    qdd_rad_s2: f32,
}

/// Tracking of one joint.
#[derive(Clone, Copy, Debug, Default)]
struct Track {
    estimator: ErrorEstimator,
    generator: Generator,
    model: DriveModel,
    /// Time of the state in the estimator.
    measured_at: Instant,
    /// A motion was answered since the last control step.
    fresh: bool,
    /// Input of the error system in force since the last answered motion.
    u_in_force: f32,
    /// Input and command of this cycle.
    u_sent: f32,
    command: ramp::Command,
    /// The motion last sent, in force once answered.
    sent: Sent,
    /// From the start of a cycle to the drive's measurement, µs.
    phase_us: u32,
    reference: Setpoint,
    saturated: bool,
    missed: bool,
    /// The last position could not be.
    implausible: bool,
    near_limit_in_row: u8,
}

/// Offer to arm that waits for its confirmation.
#[derive(Clone, Copy, Debug)]
struct Offer {
    token: u32,
    until: Instant,
}

/// Limits may be wider than those of the robot.
#[derive(Clone, Copy, Debug)]
struct Unlock {
    peer: Peer,
    until: Instant,
}

/// Start-up of one drive.
#[derive(Clone, Copy, Debug, Default)]
struct BootProgress {
    step: u8,
    tries: u8,
}

/// See the [module](self).
pub struct Controller<S, M = Spline> {
    settings: Settings,
    storage: S,
    store: TrajectoryStore,
    spline: M,
    machine: Machine,
    drives: PerJoint<Drive>,
    schedule: Schedule,
    pace: Pace,
    slots: Slots,
    track: PerJoint<Track>,
    boot: PerJoint<BootProgress>,
    gripper: Gripper,
    transmit: TransmitQueue,
    trace: Trace,
    freeze: Option<FreezeFrame>,
    counters: Counters,
    bus_bits: u32,
    offer: Option<Offer>,
    session: Session,
    tokens: Tokens,
    keyring: Keyring,
    /// Settings the controller was started with: no limit may be wider unless unlocked.
    ceiling: Settings,
    unlock: Option<Unlock>,
    /// Next sign of life to the drives; `None` while they get none.
    watchdog_due: Option<Instant>,
    /// Next step of whatever the state does.
    tick_due: Instant,
    /// Start of the running cycle: when it was due, not when the runner came to it.
    tick_at: Instant,
    ticks: u32,
    late_in_row: u32,
    jitter: Duration,
    /// Drives' state words read before this are from before the last reset.
    reset_at: Instant,
    telemetry_due: Instant,
    /// Where each joint stood when the group came to rest, rad.
    stood_at_rad: PerJoint<f32>,
    /// Next repetition of the halt broadcast if something still moves.
    halt_due: Instant,
    /// Gripper write that waits for its lane.
    gripper_write: Option<bool>,
    /// Time of the last call.
    now: Instant,
}

#[inline(never)]
fn made<T: Default>() -> T {
    T::default()
}

impl<S: Storage> Controller<S> {
    /// [`Self::with_spline`] with a spline of its own.
    pub fn new(storage: S, defaults: &Settings, seed: Seed) -> Self {
        Self::with_spline(storage, Spline::empty(), defaults, seed)
    }
}

impl<S: Storage, M: BorrowMut<Spline>> Controller<S, M> {
    /// Controller with the stored settings over `defaults` and the stored trajectory; it begins to look for
    /// the drives at its first deadline.
    ///
    /// `spline` is where the trajectory is kept; a board gives a static place, because 17 KB on their way through the
    /// stack are too much. `defaults` must pass [`Settings::check`]; others are replaced by [`Settings::powercube6`]. Their
    /// limits are the widest that are taken without an unlock. Tokens are drawn from `seed`.
    pub fn with_spline(storage: S, spline: M, defaults: &Settings, seed: Seed) -> Self {
        let mut controller = Self::asleep(storage, spline, seed);
        controller.wake(defaults);
        controller
    }

    /// Nothing looked up yet. A call of its own for each large part, and no decision in between: so the compiler makes them
    /// where they stay, instead of making and moving them (12 KB more of a board's stack).
    #[inline(never)]
    pub(crate) fn asleep(storage: S, spline: M, seed: Seed) -> Self {
        Self {
            settings: Settings::POWERCUBE6,
            storage,
            store: TrajectoryStore::new(),
            spline,
            machine: Machine::new(),
            drives: made(),
            schedule: made(),
            pace: Pace::default(),
            slots: Slots::default(),
            track: made(),
            boot: PerJoint::default(),
            gripper: Gripper::default(),
            transmit: made(),
            trace: made(),
            freeze: None,
            counters: Counters::default(),
            bus_bits: 0,
            offer: None,
            session: Session::default(),
            tokens: Tokens::new(seed),
            keyring: Keyring::default(),
            ceiling: Settings::POWERCUBE6,
            unlock: None,
            watchdog_due: None,
            tick_due: Instant::ZERO,
            tick_at: Instant::ZERO,
            ticks: 0,
            late_in_row: 0,
            jitter: Duration::ZERO,
            reset_at: Instant::ZERO,
            telemetry_due: Instant::ZERO,
            stood_at_rad: made(),
            halt_due: Instant::ZERO,
            gripper_write: None,
            now: Instant::ZERO,
        }
    }

    /// Takes over what is stored.
    #[inline(never)]
    pub(crate) fn wake(&mut self, defaults: &Settings) {
        let defaults = if defaults.check().is_ok() { defaults } else { &Settings::POWERCUBE6 };
        self.ceiling = *defaults;
        self.settings = store::load_settings(&self.storage, defaults);
        // An unlock ends with the power: limits that were saved meanwhile are put back.
        if registers::narrow(&mut self.settings, &self.ceiling) {
            self.note(Instant::ZERO, Event::LimitsPutBack);
        }
        self.keyring.set(store::load_key(&self.storage));
        self.store.find(&self.storage, &self.settings, self.spline.borrow_mut());
    }

    /// Joints in use, base first.
    pub fn joints(&self) -> impl DoubleEndedIterator<Item = JointIndex> + Clone + use<S, M> {
        self.settings.joints()
    }

    /// The aggregate state.
    pub const fn state(&self) -> &State {
        self.machine.state()
    }

    /// Settings in force.
    pub const fn settings(&self) -> &Settings {
        &self.settings
    }

    /// What happened lately.
    pub const fn trace(&self) -> &Trace {
        &self.trace
    }

    /// The group at the moment of the latched fault.
    pub const fn freeze_frame(&self) -> Option<&FreezeFrame> {
        self.freeze.as_ref()
    }

    /// Durations of the control cycles of the last run; and how long one takes by the last rehearsals, µs
    /// ([`crate::groups::powercube::pace`]), `None` before the first.
    pub fn cycle_times(&self) -> (CycleTimes, Option<u32>) {
        (self.pace.times(), self.pace.cycle_us(self.settings.joints, self.settings.cycle_guest))
    }

    /// A drive as the controller knows it.
    pub const fn drive(&self, joint: JointIndex) -> &Drive {
        self.drives.at(joint)
    }

    /// Level to put on the board's gripper output, once per change.
    pub const fn take_gripper_level(&mut self) -> Option<bool> {
        self.gripper.take_board_level()
    }

    /// The permanent storage.
    pub const fn storage(&self) -> &S {
        &self.storage
    }

    fn kind(&self) -> StateKind {
        self.machine.state().kind()
    }

    fn note(&mut self, now: Instant, event: Event) {
        self.trace.note(now, event);
    }

    /// Period of the state's steps.
    fn tick_period(&self) -> Duration {
        let us = match self.machine.state() {
            State::Running { .. } | State::Stopping { .. } => self.settings.cycle_period_us,
            _ => self.settings.monitor_period_us,
        };
        Duration::from_micros(us.into())
    }

    fn tick(&mut self, now: Instant) {
        let period = self.tick_period();
        let late = now.saturating_since(self.tick_due);
        // Commands keep their distance after a late start as long as their slots are ahead. After a later one they are
        // all moved: one long interval, and no short ones to catch up.
        self.tick_at = if late * 4 > period { now } else { self.tick_due };
        self.tick_due = self.tick_at + period;
        self.ticks = self.ticks.wrapping_add(1);
        self.jitter = self.jitter.max(late);
        match *self.machine.state() {
            State::Boot(stage) => self.boot_tick(now, stage),
            State::Idle
            | State::Ready
            | State::Armed { .. }
            | State::Stopped { .. }
            | State::Fault { .. } => {
                self.monitor_tick(now);
            }
            State::Homing(homing) => {
                self.pace.abandon();
                self.homing_tick(now, homing);
            }
            State::Jogging(jog) => {
                self.pace.abandon();
                self.jogging_tick(now, jog);
            }
            State::Running { .. } => self.running_tick(now, late),
            State::Stopping { .. } => self.stopping_tick(now),
        }
        self.pump(now);
    }

    /// States in which nothing moves: look at one thing of each drive, in turn. Every fourth time at two things, as long
    /// as a control cycle ([`crate::groups::powercube::pace`]).
    fn monitor_tick(&mut self, now: Instant) {
        let free = self.is_cycle_done();
        let reads = self.joints().all(|joint| matches!(self.poll_request(joint), Request::Get(_)));
        let rehearse = free && reads && self.ticks.is_multiple_of(4);
        if rehearse {
            self.pace.begin_rehearsal(now);
        } else if free {
            // One that is at work may last longer than the time between two looks.
            self.pace.abandon();
        }
        self.schedule.set_order(Order::turned(self.settings.joints as usize, self.ticks as usize));
        for joint in self.joints() {
            let request = self.poll_request(joint);
            if self.schedule.is_done(joint, self.drives.at(joint)) {
                if rehearse {
                    self.schedule.push(joint, Request::Get(Parameter::ActPos));
                }
                self.schedule.push(joint, request);
            }
        }
        self.judge_standing(now);
        self.expire(now);
    }

    /// What to read next from a drive that does not move.
    fn poll_request(&self, joint: JointIndex) -> Request {
        let drive = self.drives.at(joint);
        let wants_speed = self.kind() == StateKind::Armed && drive.loaded.v_rad_s.is_none();
        if wants_speed {
            // Then the first cycle of the run need not.
            let v = self.settings.joint.at(joint).v_max_rad_s;
            return Request::Set(Parameter::TargetVel, Value::F32(v));
        }
        let position = if self.has_pos_state(joint) { Parameter::PosStateDio } else { Parameter::ActPos };
        Request::Get(match self.ticks % 4 {
            0 | 2 => position,
            1 => Parameter::CubeState,
            _ => Parameter::Cur,
        })
    }

    fn has_pos_state(&self, joint: JointIndex) -> bool {
        // Not through the parameter table: its texts would fill a board's flash.
        self.drives.at(joint).version.is_some_and(|version| POS_STATE_GATE.allows(version))
    }

    fn drive_is_homed(&self, joint: JointIndex) -> bool {
        use protocol::powercube::CubeState;
        self.drives.at(joint).state.is_some_and(|(state, _)| state.contains(CubeState::HOME_OK))
    }

    fn all_homed(&self) -> bool {
        self.joints().all(|joint| self.drive_is_homed(joint))
    }

    fn host_is_alive(&self, now: Instant) -> bool {
        let timeout = Duration::from_micros(self.settings.host_timeout_us.into());
        self.session.heard_at().is_some_and(|seen| now.saturating_since(seen) <= timeout)
    }

    /// Offers and armings that end by themselves.
    fn expire(&mut self, now: Instant) {
        if self.offer.is_some_and(|offer| offer.until <= now) {
            self.offer = None;
        }
        if let State::Armed { until, .. } = *self.machine.state()
            && (until <= now || !self.host_is_alive(now))
        {
            self.machine.transition_to_ready(now, &mut self.trace);
        }
        if self.unlock.is_some_and(|unlock| unlock.until <= now) {
            self.lock_limits(now);
        }
    }

    /// Sends a sign of life that is due. One that falls due in a control cycle goes with the writes at its beginning:
    /// later it could take a motion's slot.
    fn refresh_watchdog(&mut self, now: Instant) {
        let Some(due) = self.watchdog_due else { return };
        let in_cycle = matches!(self.machine.state(), State::Running { .. } | State::Stopping { .. });
        let early = in_cycle && due < self.tick_due && now < self.tick_at + self.slots.writes();
        if due <= now || early {
            self.send_watchdog(now);
        }
    }

    fn send_watchdog(&mut self, now: Instant) {
        let refresh = Duration::from_micros(self.settings.watchdog_refresh_us.into());
        self.watchdog_due = Some(now + refresh);
        self.send(Broadcast::Watchdog.encode());
    }

    /// Clears errors and halts of all drives; nothing moves by it. What was read before is void.
    fn send_reset(&mut self, now: Instant) {
        self.reset_at = now + Duration::from_micros(1);
        for joint in self.joints() {
            self.drives.at_mut(joint).loaded = ramp::Loaded::default();
        }
        self.send(Broadcast::Reset.encode());
    }

    fn send(&mut self, frame: Frame) {
        self.count_bits(&frame);
        self.transmit.push(frame);
    }

    const fn count_bits(&mut self, frame: &Frame) {
        // ISO 11898-1: 47 or 67 bits around the data, interframe space included, stuff bits not.
        let bits = if frame.is_extended() { 67 } else { 47 };
        let data = if frame.is_remote() { 0 } else { 8 * frame.dlc() as u32 };
        self.bus_bits = self.bus_bits.wrapping_add(bits + data);
    }
}

impl<S: Storage, M: BorrowMut<Spline>> Node for Controller<S, M> {
    fn handle_frame(&mut self, now: Instant, frame: &Frame) {
        self.now = now;
        self.count_bits(frame);
        self.take_drive_frame(now, frame);
        self.refresh_watchdog(now);
        self.pump(now);
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.now = now;
        if self.gripper.take_due(now) {
            self.set_gripper(now, true);
        }
        self.give_up_due(now);
        self.refresh_watchdog(now);
        if self.tick_due <= now {
            self.tick(now);
        } else {
            self.pump(now);
        }
    }

    fn poll_frame(&mut self) -> Option<Frame> {
        self.transmit.pop()
    }

    fn poll_timeout(&self) -> Option<Instant> {
        let replies = self.joints().filter_map(|joint| self.drives.at(joint).deadline());
        // A request may wait for its key to get free.
        let waiting = self.schedule.wake_up(self.now, self.joints(), &self.drives);
        replies
            .chain([self.tick_due])
            .chain(self.watchdog_due)
            .chain(self.gripper.release_at())
            .chain(waiting)
            .min()
    }
}

//! The joint-group controller: state machine, path and law in front of a [group of drives](crate::group).
//!
//! # Calls
//!
//! * **Drives**: [`Controller::handle_packet`], [`Controller::handle_deadline`], [`Controller::poll_packet`],
//!   [`Controller::poll_deadline`]. The type of the packet is defined by the group.
//! * **Host**: [`Controller::order`], [`Controller::stop_now`], [`Controller::host_heartbeat`], registers, upload.
//!   They are independent of the protocol of the host. After each call the runner drains
//!   [`Controller::poll_packet`], as after a `handle_*` call; `now` obeys the same rule.
//! * **Queries** change nothing.
//!
//! # Files
//!
//! | file | is |
//! |---|---|
//! | `cycle` | analyse, decide, act: what follows from each event of the group |
//! | `tracker` | estimator and law of one joint |
//! | `standing`, `slow`, `starting`, `retargeting`, `extending`, `stopping` | standing, homing and jogging, the start of a run, new end states in flight, segments in flight, stops and faults |
//! | `timers` | every deadline by name |
//! | `host`, `arming`, `authority` | orders, what must hold before a run, who may order what |
//! | `report` | samples |
//!
//! # Bounded work
//!
//! One call handles one packet or one set of deadlines. It makes at most one control step (a fixed number of
//! operations per joint) and sends at most as many packets as the transmit queue of the group holds. Only a commit
//! takes longer: a few milliseconds on a Cortex-M4 for the longest file. It is refused while anything is armed or
//! moves.

mod arming;
mod authority;
mod cycle;
mod extending;
mod host;
mod report;
mod retargeting;
mod slow;
mod standing;
mod starting;
mod stopping;
mod timers;
mod tracker;

use core::borrow::BorrowMut;

use protocol::{Duration, Instant, JointIndex};

pub use self::extending::KEPT_US;
use self::tracker::Tracker;
use crate::authority::{Keyring, Peer, Seed, Session, Tokens};
use crate::credentials::Digest;
use crate::freeze::FreezeFrame;
use crate::gripper::Gripper;
use crate::group::{Command, DriveGroup};
use crate::joints::PerJoint;
use crate::registers;
use crate::settings::Settings;
use crate::spline::Spline;
use crate::state::{Machine, State, StateKind};
use crate::store::{self, Storage, TrajectoryStore};
use crate::telemetry::Counters;
use crate::trace::{Trace, TraceEvent};

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

/// See the [module](self).
pub struct Controller<S, M, G> {
    settings: Settings,
    /// Settings the controller was started with: no limit may be wider unless unlocked.
    ceiling: Settings,
    machine: Machine,
    group: G,
    trackers: PerJoint<Tracker>,
    /// The trajectory that may run, and where it is kept.
    spline: M,
    storage: S,
    store: TrajectoryStore,
    gripper: Gripper,
    // Who may order what.
    session: Session,
    tokens: Tokens,
    keyring: Keyring,
    offer: Option<Offer>,
    unlock: Option<Unlock>,
    // What people see.
    trace: Trace,
    freeze: Option<FreezeFrame>,
    counters: Counters,
    jitter: Duration,
    telemetry_due: Instant,
    foreign_bits: u32,
    // Monitored.
    late_in_row: u32,
    /// The first period within the plan has begun.
    is_on_plan: bool,
    /// Motions that the group had ordered when the run began.
    motions_before: u32,
    /// New end states taken since the start of the run.
    targets_taken: u16,
    /// The segment that must come next, and the segment that came last.
    next_segment: Option<Digest>,
    last_segment: Option<Digest>,
    /// Where each joint stood when the group came to rest, rad.
    stood_at_rad: PerJoint<f32>,
    /// Next repetition of the halt if something still moves.
    halt_due: Instant,
    /// Time of the last call.
    now: Instant,
}

#[inline(never)]
fn default_in_place<T: Default>() -> T {
    T::default()
}

impl<S: Storage, G: DriveGroup> Controller<S, Spline, G> {
    /// [`Self::with_spline`] with a spline of its own.
    pub fn new(storage: S, defaults: &Settings, seed: Seed) -> Self {
        Self::with_spline(storage, Spline::empty(), defaults, seed)
    }
}

impl<S: Storage, M: BorrowMut<Spline>, G: DriveGroup> Controller<S, M, G> {
    /// Controller with the stored settings over `defaults` and the stored trajectory; it begins to look for
    /// the drives at its first deadline.
    ///
    /// `spline` is where the trajectory is kept. A board gives a static place, because 17 KB are too much for its
    /// stack. `defaults` must pass [`Settings::check`]; otherwise [`Settings::BUILT_IN`] replaces them. Their
    /// limits are the widest that are accepted without an unlock. Tokens are drawn from `seed`.
    pub fn with_spline(storage: S, spline: M, defaults: &Settings, seed: Seed) -> Self {
        let mut controller = Self::blank(storage, spline, seed);
        controller.restore(defaults);
        controller
    }

    /// [`Self::with_spline`] with a group that was made with options of its own.
    pub fn with_group(storage: S, spline: M, group: G, defaults: &Settings, seed: Seed) -> Self {
        let mut controller = Self::blank(storage, spline, seed);
        controller.set_group(group);
        controller.restore(defaults);
        controller
    }

    /// Replaces the group; call it before [`Self::restore`].
    pub(crate) fn set_group(&mut self, group: G) {
        self.group = group;
    }

    /// A controller that has loaded nothing yet; [`Self::restore`] must follow.
    ///
    /// Each large part comes from a function of its own, without a branch in between. The compiler then builds the parts in
    /// place; otherwise it builds and moves them, which takes 12 KB more of a board's stack.
    #[inline(never)]
    pub(crate) fn blank(storage: S, spline: M, seed: Seed) -> Self {
        Self {
            settings: Settings::BUILT_IN,
            ceiling: Settings::BUILT_IN,
            machine: Machine::new(),
            group: default_in_place(),
            trackers: default_in_place(),
            spline,
            storage,
            store: TrajectoryStore::new(),
            gripper: Gripper::default(),
            session: Session::default(),
            tokens: Tokens::new(seed),
            keyring: Keyring::default(),
            offer: None,
            unlock: None,
            trace: default_in_place(),
            freeze: None,
            counters: Counters::default(),
            jitter: Duration::ZERO,
            telemetry_due: Instant::ZERO,
            foreign_bits: 0,
            late_in_row: 0,
            is_on_plan: false,
            motions_before: 0,
            targets_taken: 0,
            next_segment: None,
            last_segment: None,
            stood_at_rad: default_in_place(),
            halt_due: Instant::ZERO,
            now: Instant::ZERO,
        }
    }

    /// Loads the stored settings and trajectory.
    #[inline(never)]
    pub(crate) fn restore(&mut self, defaults: &Settings) {
        self.ceiling = *defaults;
        self.ceiling.take_family(self.group.registers());
        if self.ceiling.check().is_err() {
            self.ceiling = Settings::BUILT_IN;
            self.ceiling.take_family(self.group.registers());
        }
        self.settings = store::load_settings(&self.storage, &self.ceiling);
        // An unlock ends with the power: limits that were saved during the unlock are put back.
        if registers::narrow(&mut self.settings, &self.ceiling) {
            self.note(Instant::ZERO, TraceEvent::LimitsPutBack);
        }
        self.keyring.set(store::load_key(&self.storage));
        self.store.find(&self.storage, &self.settings, self.spline.borrow_mut());
    }

    /// Joints in use, base first.
    pub fn joints(&self) -> impl DoubleEndedIterator<Item = JointIndex> + Clone + use<S, M, G> {
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

    /// The drives.
    pub const fn group(&self) -> &G {
        &self.group
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

    fn note(&mut self, now: Instant, event: TraceEvent) {
        self.trace.note(now, event);
    }

    fn enter(&mut self, now: Instant, state: State) {
        self.machine.enter(now, &mut self.trace, state);
    }

    /// Enters a state in which the joints stand.
    fn enter_standing(&mut self, now: Instant, state: State) {
        let armed = state.kind() == StateKind::Armed;
        self.group.command(now, &self.settings, Command::Stand { armed });
        self.enter(now, state);
    }

    fn all_homed(&self) -> bool {
        self.joints().all(|joint| self.group.is_homed(joint))
    }

    fn host_is_alive(&self, now: Instant) -> bool {
        let timeout = Duration::from_micros(self.settings.host_timeout_us.into());
        self.session.heard_at().is_some_and(|seen| now.saturating_since(seen) <= timeout)
    }

    /// True if the group is armed or moves, and the host was not heard for more than half of its time-out.
    pub fn is_host_late(&self, now: Instant) -> bool {
        let half = Duration::from_micros((self.settings.host_timeout_us / 2).into());
        let engaged = self.kind().may_move() || self.kind() == StateKind::Armed;
        engaged && self.session.heard_at().is_some_and(|seen| now.saturating_since(seen) > half)
    }

    fn set_gripper(&mut self, now: Instant, open: bool) {
        self.gripper.set(open);
        if !self.group.set_gripper(&self.settings, open) {
            self.gripper.set_board(open != self.settings.gripper_inverted);
        }
        self.note(now, TraceEvent::Gripper(open));
    }

    /// A packet of the drives' port.
    pub fn handle_packet(&mut self, now: Instant, packet: &G::Packet) {
        self.now = now;
        self.group.handle_packet(now, &self.settings, packet);
        self.serve(now);
    }

    /// A deadline of [`Self::poll_deadline`] has come; harmless before.
    pub fn handle_deadline(&mut self, now: Instant) {
        self.now = now;
        self.group.handle_timeout(now, &self.settings);
        self.serve(now);
    }

    /// Next packet for the drives' port.
    pub fn poll_packet(&mut self) -> Option<G::Packet> {
        self.group.poll_packet()
    }

    /// Next deadline.
    pub fn poll_deadline(&self) -> Option<Instant> {
        let group = self.group.poll_timeout(self.now, &self.settings);
        group.into_iter().chain(self.next_timer()).min()
    }
}

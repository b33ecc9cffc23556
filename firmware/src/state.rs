//! The aggregate state of the group.
//!
//! ```text
//!            all drives answer,        all homed
//!            watchdogs proven
//!   ┌──────┐ ─────────────────▶ ┌──────┐ ─────▶ ┌───────┐  prepare + confirm  ┌───────┐
//!   │ Boot │                    │ Idle │ ◀───── │ Ready │ ──────────────────▶ │ Armed │
//!   └──────┘                    └──────┘  lost  └───────┘ ◀────────────────── └───────┘
//!      ▲                         │    ▲   home   │    ▲      disarm, expiry       │
//!      │ clear                   ▼    │          ▼    │                           │ run
//!      │                       ┌────────┐      ┌─────────┐                        ▼
//!      │                       │ Homing │      │ Jogging │      end of plan  ┌─────────┐
//!      │                       └────────┘      └─────────┘        Ready ◀─── │ Running │
//!      │                            │ stop        │ released, stop           └─────────┘
//!      │                            ▼             ▼                               │ stop or fault
//!   ┌───────┐    fault      ┌──────────┐  halt  ┌─────────┐  prepare + confirm    │
//!   │ Fault │ ◀──────────── │ Stopping │ ─────▶ │ Stopped │ ──────────────▶ Armed │
//!   └───────┘  (from any)   └──────────┘        └─────────┘                       │
//!                                 ▲────────────────────────────────────────────────┘
//! ```
//!
//! *clear* is [`Order::ClearFault`](crate::orders::Order::ClearFault), `ExecuteCommand`
//! [`CLEAR_FAULT`](protocol::cyphal::cubecell::command::CLEAR_FAULT) (6) with the number of the fault that was seen. It goes
//! through Boot: drives are reset, looked for and read anew, and the group ends in Idle or Ready if the cause is gone, else
//! in Fault again. Nothing moves by it.
//!
//! Homing and Jogging begin in Idle, Ready and Stopped and end in Idle or Ready. A jog that is released
//! ramps down within Jogging. Motion commands are sent in Homing, Jogging, Running and Stopping, and nowhere else.
//! The first cause is latched: it is carried through Stopping into Stopped (a plain stop) or Fault.

use protocol::{Instant, JointIndex};

use crate::fault::Fault;
use crate::path::PathClock;
use crate::trace::{Event, Trace};

/// A state without its data; the numbers go over the wire.
pub use protocol::cyphal::cubecell::group_state::State as StateKind;

/// Stage of start-up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BootStage {
    /// Waits after a reset broadcast, or until halted drives have come to rest.
    Settle {
        /// End of the wait.
        until: Instant,
        /// As in [`Self::Scan`].
        waits_left: u8,
    },
    /// Each drive is asked and set up, step by step.
    Scan {
        /// How often the scan may be repeated because a drive is halted or in error; 0 after a reset.
        waits_left: u8,
    },
    /// Signs of life go out; each drive must report no error, no halt and no motion.
    Check,
    /// No sign of life is sent, so the watchdogs must expire.
    Starve {
        /// End of the silence.
        until: Instant,
    },
    /// Each drive's state word is read: its watchdog must have stopped it.
    Judge,
    /// The reset was broadcast; each drive is read until it stands.
    Recover {
        /// End of the wait.
        until: Instant,
    },
}

impl BootStage {
    /// A scan that may wait for halted drives to come to rest.
    pub(crate) const FIRST_SCAN: Self = Self::Scan { waits_left: 5 };
}

/// Homing in work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Homing {
    /// Joints to do, bit n: joint n; the highest first.
    pub mask: u8,
    /// The joint at work.
    pub joint: JointIndex,
    /// Step of this joint.
    pub step: HomingStep,
    /// Latest end of this joint's homing.
    pub deadline: Instant,
}

/// Steps of homing one joint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HomingStep {
    /// Current limit, speed and the order itself are on their way.
    Starting,
    /// The drive has taken the order and looks for its zero.
    Searching,
    /// The current limit is put back.
    Restoring,
}

/// Jog in work.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jog {
    /// The joint.
    pub joint: JointIndex,
    /// Wanted velocity, rad/s, already capped.
    pub qd_rad_s: f32,
    /// Ends then unless repeated.
    pub until: Instant,
    /// Step.
    pub step: JogStep,
}

/// Steps of a jog.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JogStep {
    /// Current limit, speed and acceleration are on their way.
    Starting,
    /// Moves.
    Moving,
    /// Ramps down, and is watched until it stands.
    Releasing {
        /// The joint must be measured at rest by then.
        until: Instant,
    },
    /// The current limit is put back.
    Restoring,
}

/// How a group comes to rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StopWay {
    /// Along the path.
    Path,
    /// Each joint on its own.
    Quick,
    /// The halt broadcast is out: the drives brake by themselves, and are watched until they stand.
    Halted,
}

/// State with what exists in it only.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum State {
    /// See [`StateKind::Boot`].
    Boot(BootStage),
    /// See [`StateKind::Idle`].
    Idle,
    /// See [`StateKind::Homing`].
    Homing(Homing),
    /// See [`StateKind::Jogging`].
    Jogging(Jog),
    /// See [`StateKind::Ready`].
    Ready,
    /// See [`StateKind::Armed`].
    Armed {
        /// Token that armed the group.
        token: u32,
        /// Expiry.
        until: Instant,
    },
    /// See [`StateKind::Running`].
    Running {
        /// Time along the plan.
        clock: PathClock,
        /// The plan is at its end: the joints are brought to the last knot. They must be measured at rest by then.
        parking: Option<Instant>,
    },
    /// See [`StateKind::Stopping`].
    Stopping {
        /// Why.
        fault: Fault,
        /// How.
        way: StopWay,
        /// Time along the plan.
        clock: PathClock,
        /// Another way is taken if this one is not done by then.
        deadline: Instant,
    },
    /// See [`StateKind::Stopped`].
    Stopped {
        /// Why.
        fault: Fault,
    },
    /// See [`StateKind::Fault`].
    Fault {
        /// Why.
        fault: Fault,
    },
}

impl State {
    /// The state without its data.
    pub const fn kind(&self) -> StateKind {
        match self {
            Self::Boot(_) => StateKind::Boot,
            Self::Idle => StateKind::Idle,
            Self::Homing(_) => StateKind::Homing,
            Self::Jogging(_) => StateKind::Jogging,
            Self::Ready => StateKind::Ready,
            Self::Armed { .. } => StateKind::Armed,
            Self::Running { .. } => StateKind::Running,
            Self::Stopping { .. } => StateKind::Stopping,
            Self::Stopped { .. } => StateKind::Stopped,
            Self::Fault { .. } => StateKind::Fault,
        }
    }

    /// The latched cause.
    pub const fn fault(&self) -> Option<Fault> {
        match self {
            Self::Stopping { fault, .. } | Self::Stopped { fault } | Self::Fault { fault } => Some(*fault),
            _ => None,
        }
    }
}

/// Holds the state; its `transition_to_*` are the only writers between states.
#[derive(Clone, Debug)]
pub struct Machine {
    state: State,
}

impl Machine {
    /// At power on.
    pub const fn new() -> Self {
        Self { state: State::Boot(BootStage::FIRST_SCAN) }
    }

    /// The state.
    pub const fn state(&self) -> &State {
        &self.state
    }

    /// Data of the state, to go on within it. Must not be used to change the kind.
    pub(crate) const fn data(&mut self) -> &mut State {
        &mut self.state
    }

    fn set(&mut self, now: Instant, trace: &mut Trace, state: State, fault: Option<Fault>) {
        let from = self.state.kind();
        self.state = state;
        trace.note(now, Event::State { from, to: self.state.kind(), fault });
    }

    pub(crate) fn transition_to_boot(&mut self, now: Instant, trace: &mut Trace, stage: BootStage) {
        self.set(now, trace, State::Boot(stage), None);
    }

    pub(crate) fn transition_to_idle(&mut self, now: Instant, trace: &mut Trace) {
        self.set(now, trace, State::Idle, None);
    }

    pub(crate) fn transition_to_ready(&mut self, now: Instant, trace: &mut Trace) {
        self.set(now, trace, State::Ready, None);
    }

    pub(crate) fn transition_to_homing(&mut self, now: Instant, trace: &mut Trace, homing: Homing) {
        self.set(now, trace, State::Homing(homing), None);
    }

    pub(crate) fn transition_to_jogging(&mut self, now: Instant, trace: &mut Trace, jog: Jog) {
        self.set(now, trace, State::Jogging(jog), None);
    }

    pub(crate) fn transition_to_armed(
        &mut self,
        now: Instant,
        trace: &mut Trace,
        token: u32,
        until: Instant,
    ) {
        self.set(now, trace, State::Armed { token, until }, None);
    }

    pub(crate) fn transition_to_running(&mut self, now: Instant, trace: &mut Trace, clock: PathClock) {
        self.set(now, trace, State::Running { clock, parking: None }, None);
    }

    pub(crate) fn transition_to_stopping(
        &mut self,
        now: Instant,
        trace: &mut Trace,
        fault: Fault,
        way: StopWay,
        clock: PathClock,
        deadline: Instant,
    ) {
        self.set(now, trace, State::Stopping { fault, way, clock, deadline }, Some(fault));
    }

    pub(crate) fn transition_to_stopped(&mut self, now: Instant, trace: &mut Trace, fault: Fault) {
        self.set(now, trace, State::Stopped { fault }, Some(fault));
    }

    pub(crate) fn transition_to_fault(&mut self, now: Instant, trace: &mut Trace, fault: Fault) {
        self.set(now, trace, State::Fault { fault }, Some(fault));
    }
}

impl Default for Machine {
    fn default() -> Self {
        Self::new()
    }
}

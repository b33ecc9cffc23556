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
//! through Boot: drives are reset, looked for and read again, and the group ends in Idle or Ready if the cause is gone, else
//! in Fault again. Nothing moves by it.
//!
//! A run with a start time waits in Armed and goes to Running shortly before; a disarm, a lost host, or a check that no
//! longer holds then goes to Ready instead. Running may take new end states over in flight
//! ([`Order::Retarget`](crate::orders::Order::Retarget)): the state stays, the plan changes ([`crate::retarget`]), and its
//! end is the rest after the last end state.
//!
//! Homing and Jogging begin in Idle, Ready and Stopped and end in Idle or Ready. A jog that is released
//! ramps down within Jogging. Motion commands are sent in Homing, Jogging, Running and Stopping, and nowhere else.
//! The first cause is latched: it is carried through Stopping into Stopped (a plain stop) or Fault.

use protocol::{Instant, JointIndex};

use crate::fault::Fault;
use crate::path::PathClock;
use crate::trace::{Trace, TraceEvent};

/// A state without its data; the numbers go over the wire.
pub use protocol::cyphal::cubecell::group_state::State as StateKind;

/// Homing in work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Homing {
    /// Joints to do, bit n: joint n; the highest first.
    pub mask: u8,
    /// The joint at work.
    pub joint: JointIndex,
    /// Latest end of this joint's homing.
    pub deadline: Instant,
}

/// Jog in work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Jog {
    /// The joint.
    pub joint: JointIndex,
    /// It ramps to rest, and the order can no longer be repeated.
    pub released: bool,
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
    Boot,
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
        /// Expiry, if no start is ordered.
        until: Instant,
        /// When the plan is ordered to begin.
        start: Option<Instant>,
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
            Self::Boot => StateKind::Boot,
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

/// Holds the state; `enter` is the only writer between states.
#[derive(Clone, Debug)]
pub struct Machine {
    state: State,
}

impl Machine {
    /// At power on.
    pub const fn new() -> Self {
        Self { state: State::Boot }
    }

    /// The state.
    pub const fn state(&self) -> &State {
        &self.state
    }

    /// Armed: the run begins at `at`.
    pub(crate) const fn start_at(&mut self, at: Instant) {
        if let State::Armed { start, .. } = &mut self.state {
            *start = Some(at);
        }
    }

    /// Jogging: the joint ramps to rest.
    pub(crate) const fn release_jog(&mut self) {
        if let State::Jogging(jog) = &mut self.state {
            jog.released = true;
        }
    }

    /// Running: the plan is at its end, the joints rest by `until`.
    pub(crate) const fn park(&mut self, until: Instant) {
        if let State::Running { parking, .. } = &mut self.state {
            *parking = Some(until);
        }
    }

    /// Stopping: the time along the plan.
    pub(crate) const fn slow_down(&mut self, along: PathClock) {
        if let State::Stopping { clock, .. } = &mut self.state {
            *clock = along;
        }
    }

    /// Stopping: another cause is the first one.
    pub(crate) const fn latch(&mut self, first: Fault) {
        if let State::Stopping { fault, .. } = &mut self.state {
            *fault = first;
        }
    }

    /// Enters a state: the only writer between states.
    pub(crate) fn enter(&mut self, now: Instant, trace: &mut Trace, state: State) {
        let from = self.state.kind();
        self.state = state;
        trace.note(now, TraceEvent::State { from, to: state.kind(), fault: state.fault() });
    }
}

impl Default for Machine {
    fn default() -> Self {
        Self::new()
    }
}

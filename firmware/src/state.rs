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
//! [`CLEAR_FAULT`](protocol::cyphal::cubecell::command::CLEAR_FAULT) (6) with the number of the fault that was
//! seen. It goes through Boot: drives are reset, searched and read again. The group ends in Idle or Ready if the
//! cause is gone, otherwise in Fault again. Nothing moves.
//!
//! A run with a start time waits in Armed and goes to Running shortly before the start. If the group is disarmed,
//! the host is lost, or a check fails at the start, it goes to Ready instead. Running may change to new end states
//! in flight ([`Order::Retarget`](crate::orders::Order::Retarget)): the state stays, the plan changes
//! ([`crate::retarget`]), and its end is the rest after the last end state.
//!
//! Homing and Jogging begin in Idle, Ready and Stopped and end in Idle or Ready. A jog that is released ramps down
//! within Jogging. Motion commands are sent only in Homing, Jogging, Running and Stopping. The first cause is
//! latched: it is kept through Stopping into Stopped (a plain stop) or Fault.

use protocol::{Instant, JointIndex};

use crate::fault::Fault;
use crate::path::PathClock;
use crate::trace::{Trace, TraceEvent};

/// A state without its data; the numbers go over the wire.
pub use protocol::cyphal::cubecell::group_state::State as StateKind;

/// Homing in progress.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Homing {
    /// Joints still to home, bit n: joint n; the highest first.
    pub mask: u8,
    /// The joint that is homed now.
    pub joint: JointIndex,
    /// Latest end of this joint's homing.
    pub deadline: Instant,
}

/// Jog in progress.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Jog {
    /// The joint.
    pub joint: JointIndex,
    /// The joint ramps to rest, and the order can no longer be repeated.
    pub released: bool,
}

/// How a group comes to rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StopWay {
    /// Along the path.
    Path,
    /// Each joint on its own.
    Quick,
    /// The halt broadcast is sent: the drives brake by themselves, and are observed until they stand.
    Halted,
}

/// A state with the data that belong to it.
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
        /// The plan has ended: the joints go to the last knot. They must be measured at rest by this time.
        parking: Option<Instant>,
    },
    /// See [`StateKind::Stopping`].
    Stopping {
        /// Why the group stops.
        fault: Fault,
        /// How the group stops.
        way: StopWay,
        /// Time along the plan.
        clock: PathClock,
        /// If the stop is not done by this time, another way is taken.
        deadline: Instant,
    },
    /// See [`StateKind::Stopped`].
    Stopped {
        /// Why the group stopped.
        fault: Fault,
    },
    /// See [`StateKind::Fault`].
    Fault {
        /// The latched fault.
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

/// Holds the state; only `enter` changes from one state to another.
#[derive(Clone, Debug)]
pub struct Machine {
    state: State,
}

impl Machine {
    /// State at power on.
    pub const fn new() -> Self {
        Self { state: State::Boot }
    }

    /// The state.
    pub const fn state(&self) -> &State {
        &self.state
    }

    /// In Armed: sets the begin of the run to `at`.
    pub(crate) const fn start_at(&mut self, at: Instant) {
        if let State::Armed { start, .. } = &mut self.state {
            *start = Some(at);
        }
    }

    /// In Jogging: the joint ramps to rest.
    pub(crate) const fn release_jog(&mut self) {
        if let State::Jogging(jog) = &mut self.state {
            jog.released = true;
        }
    }

    /// In Running: the plan has ended, and the joints must rest by `until`.
    pub(crate) const fn park(&mut self, until: Instant) {
        if let State::Running { parking, .. } = &mut self.state {
            *parking = Some(until);
        }
    }

    /// In Stopping: sets the time along the plan.
    pub(crate) const fn slow_down(&mut self, along: PathClock) {
        if let State::Stopping { clock, .. } = &mut self.state {
            *clock = along;
        }
    }

    /// In Stopping: replaces the first cause.
    pub(crate) const fn latch(&mut self, first: Fault) {
        if let State::Stopping { fault, .. } = &mut self.state {
            *fault = first;
        }
    }

    /// Enters a state; nothing else changes from one state to another.
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

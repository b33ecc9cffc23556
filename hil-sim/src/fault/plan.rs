//! What is planned to go wrong: one entry per fault, already checked.

use std::fmt;

use protocol::{Duration, Frame, Id, Instant, ModuleId};

use super::physical::{PhysicalFault, Place};

/// Where a fault acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// The line: every node.
    Bus,
    Module(ModuleId),
    /// One supply, counted from 0.
    Supply(u8),
    Gripper,
}

impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Bus => f.write_str("bus"),
            Self::Module(id) => write!(f, "module-{id}"),
            Self::Supply(index) => write!(f, "supply-{index}"),
            Self::Gripper => f.write_str("gripper"),
        }
    }
}

/// Frames whose id equals `id` in the bits of `mask`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct IdFilter {
    /// The id to compare with; its format must match too.
    pub id: Id,
    /// Bits that count.
    pub mask: u32,
}

impl IdFilter {
    /// True if the frame is meant.
    pub fn matches(&self, frame: &Frame) -> bool {
        frame.id().is_extended() == self.id.is_extended()
            && (frame.id().raw() ^ self.id.raw()) & self.mask == 0
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum WrongPart {
    /// The value: a random bit behind command and parameter.
    #[default]
    Value,
    /// The parameter or motion byte: the answer to another request.
    Parameter,
    Command,
    /// The length: one byte short.
    Length,
}

/// What goes wrong on the way between node and bus.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum WireFault {
    /// A frame does not reach the software of the target, although it was acknowledged (receive buffer overrun). On
    /// the bus: no node gets it.
    Drop,
    /// A frame reaches the target later by this much. Later frames may overtake it.
    Delay(Duration),
    /// The sender misses the last bit of end of frame and repeats a frame that all others have accepted.
    Duplicate,
    /// One bit of a frame is read wrongly, by the target or (on the bus) by all nodes.
    Corrupt,
    /// An answer of the target leaves it with a valid checksum and wrong content.
    WrongAnswer(WrongPart),
    /// The target's frames are thrown away before they reach the bus; it still acknowledges.
    Silent,
    /// The target's plug loses and finds contact; dwell times are exponential with these means.
    Intermittent {
        /// Mean time with contact.
        on_mean: Duration,
        /// Mean time without contact.
        off_mean: Duration,
    },
    /// The target's controller goes bus-off at the start.
    BusOff,
    /// The line is held dominant.
    StuckDominant,
    /// A further node sends this frame again and again.
    Babble {
        frame: Frame,
        /// How often it queues one.
        period: Duration,
    },
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FaultKind {
    /// Between node and bus.
    Wire(WireFault),
    /// In drive, supply or gripper.
    Physical(Place, PhysicalFault),
}

/// A time of the throw.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Moment {
    /// The motion of the throw begins.
    Start,
    /// The plan's release of the ball.
    Release,
}

/// A time before or after a moment of the throw.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ThrowTime {
    pub moment: Moment,
    /// Microseconds after it; before it if negative.
    pub offset_us: i64,
}

impl ThrowTime {
    /// When that is, for a throw that starts and releases then.
    #[must_use]
    pub fn at(self, start: Instant, release: Instant) -> Instant {
        let moment = if self.moment == Moment::Start { start } else { release };
        let span = Duration::from_micros(self.offset_us.unsigned_abs());
        if self.offset_us < 0 { moment.saturating_sub(span) } else { moment + span }
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct Fault {
    /// Names its random stream and its lines in logs; unique in a plan.
    pub label: String,
    pub kind: FaultKind,
    pub target: Target,
    /// Frames concerned, for faults that act on frames; `None`: all frames.
    pub filter: Option<IdFilter>,
    pub start: Instant,
    /// Begin of the fault, counted from the throw. In a run with a throw it replaces `start`.
    pub at: Option<ThrowTime>,
    /// Duration; `None`: until the end of the run.
    pub length: Option<Duration>,
    /// Period of repetition, counted from start to start; `None`: once.
    pub every: Option<Duration>,
    /// For faults that act on frames: of each frame. For all others: of each occurrence.
    pub probability: f64,
}

impl Fault {
    /// Name of the kind, as in scenario files.
    pub const fn kind_name(&self) -> &'static str {
        match &self.kind {
            FaultKind::Wire(wire) => wire.name(),
            FaultKind::Physical(_, physical) => physical.name(),
        }
    }
}

impl WireFault {
    /// Name as in scenario files.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Drop => "drop",
            Self::Delay(_) => "delay",
            Self::Duplicate => "duplicate",
            Self::Corrupt => "corrupt",
            Self::WrongAnswer(_) => "wrong-answer",
            Self::Silent => "silent",
            Self::Intermittent { .. } => "intermittent",
            Self::BusOff => "bus-off",
            Self::StuckDominant => "stuck",
            Self::Babble { .. } => "babble",
        }
    }

    /// True if the probability is that of each frame.
    pub const fn is_per_frame(&self) -> bool {
        matches!(
            self,
            Self::Drop
                | Self::Delay(_)
                | Self::Duplicate
                | Self::Corrupt
                | Self::WrongAnswer(_)
                | Self::Silent
        )
    }
}

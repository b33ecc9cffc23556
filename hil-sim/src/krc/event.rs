//! Events that the simulated controller reports.

use std::fmt;

use protocol::Instant;

use crate::mechanics::HandPoint;

/// Why the robot stops.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FaultCause {
    /// More late answers than allowed.
    LateLimit { late: u64 },
    /// More late answers in percent than allowed.
    LatePercent,
    /// The offset from the start pose is larger than the overall limit.
    OverallLimit {
        /// Axis, or component X, Y, Z, A, B, C, from 0.
        component: usize,
        /// Degrees or mm.
        offset: f64,
    },
    /// A set point is outside the range of its axis.
    AxisRange {
        /// Axis, from 0.
        axis: usize,
        q_deg: f64,
    },
    /// A set point is too fast.
    Velocity {
        /// Axis, from 0.
        axis: usize,
        deg_s: f64,
    },
    /// A set point accelerates too much.
    Acceleration {
        /// Axis, from 0.
        axis: usize,
        deg_s2: f64,
    },
    /// The acceleration of a set point changes too fast.
    Jerk {
        /// Axis, from 0.
        axis: usize,
        deg_s3: f64,
    },
    /// No axis position reaches the corrected pose.
    NotReachable,
    /// The TCP connection was closed.
    ConnectionLost,
    /// The telegram is too long to be sent.
    Telegram,
    /// Ordered by a fault of the scenario.
    Ordered,
}

impl FaultCause {
    /// One word for tables.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::LateLimit { .. } => "late-limit",
            Self::LatePercent => "late-percent",
            Self::OverallLimit { .. } => "overall-limit",
            Self::AxisRange { .. } => "axis-range",
            Self::Velocity { .. } => "velocity",
            Self::Acceleration { .. } => "acceleration",
            Self::Jerk { .. } => "jerk",
            Self::NotReachable => "not-reachable",
            Self::ConnectionLost => "connection-lost",
            Self::Telegram => "telegram",
            Self::Ordered => "cut-out",
        }
    }
}

impl fmt::Display for FaultCause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::LateLimit { late } => write!(f, "KSS29002 RSITimeout: {late} late answers"),
            Self::LatePercent => f.write_str("too many late answers in percent"),
            Self::OverallLimit { component, offset } => {
                write!(f, "KSS29000 overall correction exceeded: component {} by {offset:.3}", component + 1)
            }
            Self::AxisRange { axis, q_deg } => {
                write!(f, "software limit switch A{}: {q_deg:.3} deg", axis + 1)
            }
            Self::Velocity { axis, deg_s } => {
                write!(f, "KSS01102 command velocity A{}: {deg_s:.1} deg/s", axis + 1)
            }
            Self::Acceleration { axis, deg_s2 } => {
                write!(f, "command acceleration A{}: {deg_s2:.0} deg/s2", axis + 1)
            }
            Self::Jerk { axis, deg_s3 } => write!(f, "command jerk A{}: {deg_s3:.0} deg/s3", axis + 1),
            Self::NotReachable => f.write_str("the corrected pose cannot be reached"),
            Self::ConnectionLost => f.write_str("the connection was closed"),
            Self::Telegram => f.write_str("the telegram is too long to be sent"),
            Self::Ordered => f.write_str("drives cut out by the scenario"),
        }
    }
}

/// Why an answer does not count.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Refused {
    /// It came after the window, or outside a program run.
    OutsideWindow,
    /// It answers another telegram.
    WrongIpoc {
        got: u64,
        /// The number of the last telegram.
        expected: u64,
    },
    /// Its `Type` differs from the one in the configuration file.
    WrongType,
    /// An answer was already taken in this cycle.
    Second,
    /// It cannot be read.
    Unreadable(String),
    /// Bytes of the stream that belong to no document.
    Torn { bytes: usize },
}

impl Refused {
    /// One word for tables.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::OutsideWindow => "outside-window",
            Self::WrongIpoc { .. } => "wrong-ipoc",
            Self::WrongType => "wrong-type",
            Self::Second => "second",
            Self::Unreadable(_) => "unreadable",
            Self::Torn { .. } => "torn",
        }
    }
}

/// One cycle of a program run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CycleRecord {
    /// When the telegram was sent.
    pub at: Instant,
    pub ipoc: u64,
    /// Set point of the axes.
    pub set_deg: [f64; 6],
    /// Actual axes, without noise.
    pub actual_deg: [f64; 6],
    /// Late answers in all.
    pub late: u64,
    pub outputs: i32,
}

#[derive(Clone, Debug, PartialEq)]
pub enum KrcEvent {
    Started {
        at: Instant,
    },
    /// A telegram was sent.
    Cycle(CycleRecord),
    /// An answer does not count.
    Refused {
        at: Instant,
        why: Refused,
    },
    /// No answer came in the window.
    Late {
        /// End of the window.
        at: Instant,
        /// Late answers in all.
        total: u64,
    },
    /// The share of late answers is above its limit.
    LateWarning {
        at: Instant,
    },
    /// Text for the pendant.
    Text {
        at: Instant,
        text: String,
    },
    Fault {
        at: Instant,
        cause: FaultCause,
    },
    /// The client ended the sensor motion, or the program was stopped.
    Stopped {
        at: Instant,
    },
    /// The set points stand still after a stop or fault.
    Standing {
        at: Instant,
    },
    /// The ball left the hand.
    Released {
        at: Instant,
        /// Where, and how fast.
        hand: HandPoint,
    },
}

impl fmt::Display for KrcEvent {
    /// One line of the log.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Started { at } => write!(f, "{} started", at.as_micros()),
            Self::Cycle(c) => {
                write!(f, "{} cycle {} late {} out {}", c.at.as_micros(), c.ipoc, c.late, c.outputs)?;
                for q in c.set_deg.iter().chain(&c.actual_deg) {
                    write!(f, " {q:.6}")?;
                }
                Ok(())
            }
            Self::Refused { at, why } => write!(f, "{} refused {}", at.as_micros(), why.name()),
            Self::Late { at, total } => write!(f, "{} late {total}", at.as_micros()),
            Self::LateWarning { at } => write!(f, "{} late-warning", at.as_micros()),
            Self::Text { at, text } => write!(f, "{} text {text:?}", at.as_micros()),
            Self::Fault { at, cause } => write!(f, "{} fault {}: {cause}", at.as_micros(), cause.name()),
            Self::Stopped { at } => write!(f, "{} stopped", at.as_micros()),
            Self::Standing { at } => write!(f, "{} standing", at.as_micros()),
            Self::Released { at, hand } => {
                let (p, v) = (hand.p_m, hand.v_m_s);
                write!(f, "{} released {:.6} {:.6} {:.6}", at.as_micros(), p.x, p.y, p.z)?;
                write!(f, " {:.6} {:.6} {:.6}", v.x, v.y, v.z)
            }
        }
    }
}

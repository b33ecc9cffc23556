//! The steps of a job, what is known of it so far, and why it can end early.

use firmware::settings::Settings;
use nalgebra::Vector3;
use protocol::cyphal::cubecell::command::Trajectory;
use protocol::cyphal::cubecell::group_state::GroupState;
use protocol::cyphal::id::NodeId;
use protocol::{Duration, Instant};

use super::follow::Ball;
use super::reach::Reached;
use super::verdict::Verdict;
use crate::analysis::RunAnalysis;
use crate::analysis::coverage::Certified;
use crate::bus::BusFailure;
use crate::dialogue::operator::OperatorError;
use crate::rsi::operator::Led;
use crate::samples::drives::Drives;
use crate::trajectory::TrajectoryError;
use planner::plan::Joints;
use planner::way::WayError;
use tuner::gains::gains_file::GainsFileError;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// A controller has sent a message.
    Controller,
    /// It finds its drives and proves their watchdogs.
    Drives,
    /// The joints find their zeros.
    Home,
    /// Gains and robot are agreed on.
    Gains,
    /// To the start of the program.
    Approach,
    /// The program goes to the controller, which checks it.
    Upload,
    /// Armed in two steps.
    Arm,
    Throw,
    /// The motion of an arm that throws nothing.
    Run,
    /// The ball flies.
    Flight,
    /// Back to where the arm stood.
    Return,
}

impl Step {
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Controller => "find the controller",
            Self::Drives => "drives, watchdogs",
            Self::Home => "home",
            Self::Gains => "gains",
            Self::Approach => "to the start",
            Self::Upload => "upload",
            Self::Arm => "arm",
            Self::Throw => "throw",
            Self::Run => "run",
            Self::Flight => "flight",
            Self::Return => "back",
        }
    }
}

/// Next step if there is no way to the start.
const fn next_of(error: &WayError) -> &'static str {
    match error {
        WayError::Blocked { .. } => "jog the arm free with `cubectl jog`",
        WayError::Share { .. } => "give a share above 0 and at most 1",
        WayError::NoWay { .. }
        | WayError::Goal(_)
        | WayError::Line(_)
        | WayError::Contact { .. }
        | WayError::Leg { .. } => "jog the arm nearer to the start, or plan another motion",
    }
}

/// Why the job ended early.
#[derive(Debug, thiserror::Error)]
pub enum JobError {
    /// The bus, the controller, or Ctrl-C.
    #[error(transparent)]
    Operator(#[from] OperatorError),
    #[error("{0}")]
    Way(#[from] WayError),
    /// A motion is nothing for a controller.
    #[error(transparent)]
    Trajectory(#[from] TrajectoryError),
    /// Gains for another period.
    #[error("the controller runs at {controller_us} us, the gains are for {gains_us} us")]
    Period {
        /// Of the controller, µs.
        controller_us: f64,
        /// Of the gains, µs.
        gains_us: f64,
    },
    #[error("the gains are for joints {found}, the robot has {wanted}")]
    GainsJoints {
        /// Numbers in the file.
        found: String,
        wanted: usize,
    },
    #[error("{0}")]
    GainsRobot(GainsFileError),
    /// The controller was started for another number of joints.
    #[error("the controller has {found} joints, the robot {wanted}")]
    Joints { found: usize, wanted: usize },
    /// Joints without a zero, in a job that does not home.
    #[error("not all joints are homed; nothing moved")]
    NotHomed,
    /// Two drives answer where one should.
    #[error("two modules answer at address {addresses}")]
    Double { addresses: String },
    #[error("not confirmed; {}", if *.moved { "the arm stands at the start" } else { "nothing has moved" })]
    Declined {
        /// The arm has homed or gone to the start before.
        moved: bool,
    },
}

impl JobError {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        Some(match self {
            Self::Period { controller_us, .. } => format!("tune for its period \
         (`cubectl tune --period-ms {}`), or set register cycle.period_us", controller_us / 1e3),
            Self::GainsJoints { .. } => "`cubectl tune --joint all`".to_owned(),
            Self::GainsRobot(..) => "`cubectl tune --robot ROBOT --joint all`".to_owned(),
            Self::Joints { .. } => "name the robot of this controller with --robot".to_owned(),
            Self::NotHomed => "`cubectl run --home`, or `cubectl home` first".to_owned(),
            Self::Double { .. } => "unplug one of them and give the other a free address (parameter DefAddress, or the maker's tool)".to_owned(),
            Self::Way(error) => next_of(error).to_owned(),
            Self::Operator(error) => return error.next(),
            Self::Trajectory(error) => return error.next(),
            _ => return None,
        })
    }
}

impl From<BusFailure> for JobError {
    fn from(failure: BusFailure) -> Self {
        Self::Operator(failure.into())
    }
}

/// When a program was ordered to begin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Start {
    /// By the controller's clock.
    pub at: Instant,
    /// That clock is known to this here.
    pub known_to: Duration,
}

/// Data of a job; also of one that ended early.
#[derive(Debug, Default)]
pub struct Record {
    /// Node of the controller, where the link has nodes.
    pub node: Option<NodeId>,
    /// Each step that ended: time of the link at its begin and end.
    pub steps: Vec<(Step, Instant, Instant)>,
    /// Where the arm stands, rad; of a job that goes as far as [`super::Extent::Ready`].
    pub pose: Option<Joints>,
    pub at_work: Option<(Step, Instant)>,
    /// Control period, µs.
    pub period_us: u64,
    /// Gains in force: on error, rate and last command, one per joint.
    pub gains: [Vec<f32>; 3],
    /// Weights of the controller's estimator, alpha and beta.
    pub estimator: Option<[f32; 2]>,
    /// Gains, and everything that their certificate covers, as the controller holds them; other settings as built in.
    pub held: Option<Settings>,
    /// Checksum of their certificate; 0: no certificate.
    pub certificate_crc32: u64,
    /// Timing that it covers; `None` if the file of the certificate is not known.
    pub certified: Option<Certified>,
    /// Duration of the way to the start, s; `None`: the arm stood there.
    pub approach_s: Option<f64>,
    /// Name of the program's file in the controller.
    pub trajectory: Option<Trajectory>,
    /// When it was ordered to begin, if not at once.
    pub start: Option<Start>,
    /// State before the run, and each one during it with the time of its arrival.
    pub before: GroupState,
    /// During the run.
    pub states: Vec<(Instant, GroupState)>,
    /// Drives of the joints, from the controller's registers.
    pub drives: Option<Drives>,
    /// From the order to open the gripper to the free ball, from the controller's registers.
    pub gripper_opening: Option<Duration>,
    /// Result of the samples of a throw.
    pub analysis: Option<RunAnalysis>,
    /// Result of the samples of any other motion.
    pub reached: Option<Reached>,
    /// Where the ball is, as far as an observer watches it.
    pub ball: BallOutcome,
    /// What is known of a ball whose flight the hand follows.
    pub followed: Option<Ball>,
    /// Where it landed, or where the measured motion sends it.
    pub landing: Option<Landing>,
    /// Data that only a robot that is led has.
    pub led: Option<Led>,
    /// Frames during the run.
    pub frames: u64,
    /// What ended it early.
    pub ended: Option<JobError>,
    pub verdict: Verdict,
}

/// Where the ball is, as far as an observer watches it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BallOutcome {
    #[default]
    NotObserved,
    /// Still in the hand when the job ended.
    InHand,
    /// It left the hand.
    Released,
}

impl BallOutcome {
    /// Field `ball` of `summary.json`.
    #[must_use]
    pub const fn json_name(self) -> &'static str {
        match self {
            Self::NotObserved => "not_observed",
            Self::InHand => "in_hand",
            Self::Released => "released",
        }
    }
}

/// Where a landing is known from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LandingSource {
    /// Seen: the simulated ball.
    Cell,
    /// Computed from the measured motion of the joints at the release; the ball was not observed.
    Measured,
}

impl LandingSource {
    /// An observer watched the ball.
    #[must_use]
    pub const fn is_observed(self) -> bool {
        matches!(self, Self::Cell)
    }

    /// Field `source` of the landing in `summary.json`.
    #[must_use]
    pub const fn json_name(self) -> &'static str {
        match self {
            Self::Cell => "simulated ball",
            Self::Measured => "measured motion at the release",
        }
    }
}

/// Where the ball landed, or should have.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Landing {
    /// How it is known.
    pub source: LandingSource,
    /// Where, m.
    pub position_m: Vector3<f64>,
    /// Distance from the target, m.
    pub error_m: f64,
    /// 99 % of the landings with this measured motion lie within this distance, m; `None` if the ball was seen.
    pub uncertainty_m: Option<f64>,
    /// By how much the ball was free later than planned, s.
    pub release_late_s: Option<f64>,
    /// First contact of the flying ball with the arm, s after the release.
    pub touch_after_s: Option<f64>,
}

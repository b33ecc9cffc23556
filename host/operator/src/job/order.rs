//! An order to an arm and its judge.

use hil_sim::krc::KrcScenario;
use protocol::Duration;
use robot_model::collision::Scene;

use super::follow::GripperKnown;
use super::reach::{GOAL_RAD, REST_S};
use super::throw::default_tolerance_m;
use crate::analysis::POSITION_BOUND_RAD;
use crate::rsi::plan::motion_of;
use crate::rsi::program::Lag;
use crate::trajectory::robot_crc32;
use planner::follow::plan::FollowPlan;
use planner::motion::Motion;
use planner::plan::file::PlanFile;
use planner::plan::{Arm, Joints};
use planner::way::Travel;
use tuner::gains::gains_file::GainsFile;

/// What is run.
#[derive(Clone, Debug, PartialEq)]
pub enum Program {
    Motion(Motion),
    /// A trajectory file of a controller, as it is, and its motion.
    File(Vec<u8>, Motion),
}

impl Program {
    #[must_use]
    pub const fn motion(&self) -> &Motion {
        match self {
            Self::Motion(motion) | Self::File(_, motion) => motion,
        }
    }
}

/// How far a job goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extent {
    /// The arm is ready to move, and its pose is known; the program does not count.
    Ready,
    /// The program is in the controller.
    Upload,
    Run,
    /// The arm is back where it stood.
    Back,
}

/// How the outcome is known.
#[derive(Clone, Copy, Debug)]
pub enum Judge<'a> {
    /// A ball that is released at one instant lands at its target.
    Throw {
        plan: &'a PlanFile,
        /// A landing farther from the target than this counts as missed, m.
        tolerance_m: f64,
    },
    /// A ball whose flight the hand follows lands at its target.
    Follow {
        plan: &'a FollowPlan,
        gripper: GripperKnown,
        /// What is believed of the lag between set points and axes.
        lag: Lag,
        /// As [`Judge::Throw`].
        tolerance_m: f64,
    },
    /// The arm follows the motion and stands at its end.
    Reach,
}

impl Judge<'_> {
    /// A landing farther from the target than this counts as missed, m; `None` if nothing lands.
    #[must_use]
    pub const fn tolerance_m(&self) -> Option<f64> {
        match self {
            Self::Throw { tolerance_m, .. } | Self::Follow { tolerance_m, .. } => Some(*tolerance_m),
            Self::Reach => None,
        }
    }

    /// There is a ball in the hand.
    #[must_use]
    pub const fn throws(&self) -> bool {
        !matches!(self, Self::Reach)
    }
}

/// Largest deviations of the arm from a motion without a throw, as in the constraints of the
/// `JointTrajectoryController` of ros2_control.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerances {
    /// Of each joint from its motion, at any time of it, rad.
    pub path_rad: Joints,
    /// Of each joint from the end of its motion, rad, [`Tolerances::goal_time`] after its planned end.
    pub goal_rad: Joints,
    pub goal_time: Duration,
}

impl Tolerances {
    /// The usual ones for this number of joints: the bound of the throwing paper on the way, 10 mrad at the end, after 0.25 s.
    #[must_use]
    pub fn usual(joints: usize) -> Self {
        Self {
            path_rad: Joints::repeat(joints, POSITION_BOUND_RAD),
            goal_rad: Joints::repeat(joints, GOAL_RAD),
            goal_time: Duration::from_secs_f64(REST_S),
        }
    }
}

/// An order to an arm; made from a plan.
#[derive(Clone, Debug)]
pub struct Order<'a> {
    pub arm: &'a Arm,
    /// Checksum of the robot that the program is for.
    pub robot_crc32: u32,
    pub program: Program,
    /// Everything in the way, and whether a ball is in the hand.
    pub scene: Scene,
    /// Gains to write into the controller; `None` keeps those it has.
    pub gains: Option<&'a GainsFile>,
    /// Joints without a zero may find it.
    pub homes: bool,
    /// How to go to the start and back; `None`: the arm stands where the program begins, and its controller keeps
    /// its robot.
    pub travel: Option<Travel>,
    /// The program begins this much after the order to run, by the controller's clock; `None`: at once.
    pub start_in: Option<Duration>,
    /// Longest time for the run after its planned end.
    pub patience: Duration,
    /// Of a motion that throws nothing.
    pub tolerances: Tolerances,
    pub extent: Extent,
    pub judge: Judge<'a>,
}

impl<'a> Order<'a> {
    /// Longest time for a run after its planned end, by default.
    pub const PATIENCE: Duration = Duration::from_secs(5);

    /// A throw with the release at one instant, from wherever the arm stands; the tolerance is the plan's.
    #[must_use]
    pub fn throw(arm: &'a Arm, plan: &'a PlanFile, travel: Travel) -> Self {
        let judge = Judge::Throw { plan, tolerance_m: default_tolerance_m(arm, plan) };
        let program = Program::Motion(plan.motion.to_motion());
        let order = Self::new(arm, &plan.robot.fingerprint, program, judge);
        Self { scene: plan.scene(), homes: true, travel: Some(travel), ..order }
    }

    /// A throw whose hand follows the flight, with the robot that is described, from where its program begins.
    #[must_use]
    pub fn follow(
        arm: &'a Arm,
        plan: &'a FollowPlan,
        described: &KrcScenario,
        travel: Travel,
        tolerance_m: f64,
    ) -> Self {
        let (gripper, lag) = (GripperKnown::of(described), Lag::of(described));
        let judge = Judge::Follow { plan, gripper, lag, tolerance_m };
        let order = Self::new(arm, &plan.robot.fingerprint, Program::Motion(motion_of(plan)), judge);
        // Such plans have no obstacles.
        let scene = Scene { ball_held: true, ..Scene::default() };
        Self { scene, travel: Some(travel), ..order }
    }

    /// A motion of an arm that stands where it begins.
    #[must_use]
    pub fn new(arm: &'a Arm, fingerprint: &str, program: Program, judge: Judge<'a>) -> Self {
        Self {
            arm,
            robot_crc32: robot_crc32(fingerprint),
            program,
            scene: Scene::default(),
            gains: None,
            homes: false,
            travel: None,
            start_in: None,
            patience: Self::PATIENCE,
            tolerances: Tolerances::usual(arm.n()),
            extent: Extent::Run,
            judge,
        }
    }
}

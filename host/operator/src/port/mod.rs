//! Interface of a job to the controller of the arm, for every link.
//!
//! | operator | link |
//! |---|---|
//! | [`OnBus`] | a controller on a CAN bus, or in a thread of this program beside one; orders over Cyphal |
//! | [`InProcess`] | a controller in this program; orders are calls |
//! | [`LedRobot`] | an industrial robot with a controller in this program between its telegrams |

mod in_process;
mod interactive;
mod on_bus;

use nalgebra::Vector3;
use protocol::cyphal::cubecell::command::Trajectory;
use protocol::cyphal::cubecell::group_state::{GroupState, State};
use protocol::cyphal::id::NodeId;
use protocol::{Duration, Instant};

pub use crate::rsi::operator::LedRobot;
pub use in_process::InProcess;
pub use interactive::Interactive;
pub use on_bus::OnBus;

use crate::dialogue::operator::OperatorError;
use crate::dialogue::registers::Numbers;
use crate::rsi::operator::Led;
use crate::samples::Samples;
use crate::samples::drives::Drives;
use crate::trajectory::Encoded;
use planner::motion::Motion;
use planner::plan::Joints;
use planner::throw::Arm;

/// The ball of a simulated cell: what an onlooker sees.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BallSeen {
    /// When it left the hand.
    pub released_at: Option<Instant>,
    /// How long it flew, s, and where it landed, m.
    pub landing: Option<(f64, Vector3<f64>)>,
    /// First contact of the flying ball with the arm, s after the release.
    pub touch_after_s: Option<f64>,
}

impl BallSeen {
    #[must_use]
    pub fn of(cell: &hil_sim::Cell) -> Self {
        let report = cell.throw();
        Self {
            released_at: report.released_at,
            landing: report.landing.as_ref().map(|landing| (landing.t_s, landing.p_m)),
            touch_after_s: report.touch.as_ref().map(|(t_s, _)| *t_s),
        }
    }
}

/// See the [module](self). After any error the arm stands.
pub trait Operator {
    /// Present time.
    fn now(&self) -> Instant;

    /// Finds the controller; returns its node if the link has nodes. Before anything else.
    ///
    /// # Errors
    /// [`OperatorError::NoController`], and those of the link.
    fn connect(&mut self) -> Result<Option<NodeId>, OperatorError>;

    /// Ends the job if another node or a person has stopped the arm since [`Operator::connect`]. All other
    /// functions except [`Operator::pass`] check this by themselves.
    ///
    /// # Errors
    /// An error for which [`OperatorError::is_stop_by_other`] is true, or the fault that the controller reports.
    fn heed_stops(&mut self) -> Result<(), OperatorError>;

    /// Lets time pass, also after an interruption.
    fn pass(&mut self, span: Duration) -> Result<(), OperatorError>;

    /// Last report of the controller.
    fn group(&mut self) -> GroupState;

    /// Waits for a state that `wanted` takes.
    ///
    /// # Errors
    /// [`OperatorError::Stopped`] for a fault or a stop on the way, [`OperatorError::NoProgress`] after `limit`.
    fn wait_for(&mut self, limit: Duration, wanted: &dyn Fn(State) -> bool) -> Result<(), OperatorError>;

    /// Joint angles measured from now on, rad, base first.
    ///
    /// # Errors
    /// [`OperatorError::NoAnswer`], and those of the link.
    fn pose(&mut self) -> Result<Vec<f64>, OperatorError>;

    /// Numbers of a register.
    ///
    /// # Errors
    /// [`OperatorError::NoRegister`], and those of the link.
    fn register(&mut self, name: &str) -> Result<Numbers, OperatorError>;

    /// Writes a register and checks whether the value was accepted.
    ///
    /// # Errors
    /// [`OperatorError::RegisterRefused`], and those of the link.
    fn set_register(&mut self, name: &str, wanted: &Numbers) -> Result<(), OperatorError>;

    /// Opens or closes the gripper.
    ///
    /// # Errors
    /// [`OperatorError::Refused`], and those of the link.
    fn set_gripper(&mut self, open: bool) -> Result<(), OperatorError>;

    /// Lets the joints of `mask` (bit 0 = first joint) find their zeros, and waits for the end.
    fn home(&mut self, mask: u8, limit: Duration) -> Result<(), OperatorError>;

    /// Stores the file of a motion in the controller and commits it; its segments follow while it runs. `progress` gets bytes
    /// done and bytes in all.
    ///
    /// # Errors
    /// [`OperatorError::Refused`], [`OperatorError::Upload`], and those of the link.
    fn upload(
        &mut self,
        plan: &Encoded,
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<Trajectory, OperatorError>;

    /// Time that a segment of a long motion takes on the link, s.
    fn segment_s(&self) -> f64 {
        0.0
    }

    /// Arms for a trajectory, in two steps.
    ///
    /// # Errors
    /// [`OperatorError::Refused`], and those of the link.
    fn arm(&mut self, name: &Trajectory) -> Result<(), OperatorError>;

    /// The next run is a throw that releases the ball `release_s` after its start. A simulated cell times its faults by it.
    fn expect_throw(&mut self, release_s: f64) {
        let _ = release_s;
    }

    /// Runs the armed trajectory and follows it to its end; `progress` gets each state that the controller reports. It begins at
    /// `start` of the controller's clock, or at once.
    ///
    /// # Errors
    /// [`OperatorError::Stopped`] if the motion was stopped; or another [`OperatorError`]. The arm stands then.
    fn run(
        &mut self,
        name: &Trajectory,
        start: Option<Instant>,
        limit: Duration,
        progress: &mut dyn FnMut(Instant, &GroupState),
    ) -> Result<(), OperatorError>;

    /// The time of the controller's clock at `ours`, and its uncertainty. A controller in this program has the same clock.
    fn controller_time(&mut self, ours: Instant) -> Result<(Instant, Duration), OperatorError> {
        Ok((ours, Duration::ZERO))
    }

    /// Stops the arm along its path, and waits until it stands.
    fn stop(&mut self) -> Result<(), OperatorError>;

    /// Keeps samples from now on, and forgets those before.
    fn keep_samples(&mut self);

    /// Nothing follows: a robot that waits for answers is let go. A job that throws does so by itself.
    fn leave(&mut self) {}

    /// Pose in which the arm will stand when its drives are found, if the link knows it before: the start pose of a robot's
    /// program.
    fn foreseen_pose(&self) -> Option<Joints> {
        None
    }

    /// Does `work`, which takes long; a robot that waits for answers gets them meanwhile.
    fn meanwhile(&mut self, work: &mut (dyn FnMut() + Send)) -> Result<(), OperatorError> {
        work();
        Ok(())
    }

    /// Refuses a motion that the link cannot execute.
    ///
    /// # Errors
    /// [`OperatorError::NotPassed`].
    fn require_passed(&self, motion: &Motion) -> Result<(), OperatorError> {
        let _ = motion;
        Ok(())
    }

    /// Data that only a robot that is led has; after [`Operator::leave`] also its observation from outside.
    fn led(&mut self) -> Option<Led> {
        None
    }

    /// Frames kept so far; 0 if the link is not a bus.
    fn frames_kept(&self) -> usize {
        0
    }

    /// Samples since [`Operator::keep_samples`]; no more is kept. `drives` are those of the joints of `arm`.
    fn take_samples(&mut self, arm: &Arm, drives: Option<Drives>) -> Option<Samples>;

    /// Addresses at which two drives answer, where the link shows it.
    fn double_answers(&mut self) -> Vec<String> {
        Vec::new()
    }

    /// The ball, where an observer watches it.
    fn ball(&mut self) -> Option<BallSeen> {
        None
    }

    /// The number of a register of the group.
    ///
    /// # Errors
    /// As [`Operator::register`]; [`OperatorError::Unreadable`] if it is not a number.
    fn natural(&mut self, name: &str) -> Result<u64, OperatorError> {
        match self.register(name)? {
            Numbers::Natural(numbers) if numbers.len() == 1 => Ok(numbers[0]),
            _ => Err(OperatorError::NoRegister { name: name.to_owned() }),
        }
    }
}

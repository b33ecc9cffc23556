//! An arm that stays connected: one job after the other on one session.

use operator::job::{Extent, Judge, OnProgress, Order, Program, Record, perform};
use operator::port::Interactive;
use planner::motion::Motion;
use robot_model::{JointVec, RobotModel};

use super::ended::{failure, off_target};
use crate::error::ExpectedError;
use crate::exit;

/// An arm this near to the end of its last motion stands there, rad: the next one begins at the planned end. From the measured place
/// each motion would add its own error to those before.
const THERE_RAD: f64 = 5e-3;

/// See the [module](self).
pub struct Connected<'s, 'a> {
    pub operator: &'s mut dyn Interactive,
    pub robot: &'a RobotModel,
    fingerprint: &'a str,
    /// Planned end of the last motion, rad.
    end: Option<JointVec>,
}

impl<'s, 'a> Connected<'s, 'a> {
    /// The arm `robot`, whose fingerprint is given, behind `operator`.
    pub fn new(operator: &'s mut dyn Interactive, robot: &'a RobotModel, fingerprint: &'a str) -> Self {
        Self { operator, robot, fingerprint, end: None }
    }

    /// The next motion begins where the arm is measured.
    pub const fn forget_end(&mut self) {
        self.end = None;
    }

    /// Where the next motion begins, rad. A robot that is led may still be on its way to its start pose: it is not kept waiting while
    /// a motion is planned. Any other arm is made ready.
    pub fn begin(&mut self, homes: bool, ui: OnProgress<'_>) -> Result<JointVec, ExpectedError> {
        match self.operator.foreseen_pose() {
            Some(foreseen) => Ok(self.near_end(foreseen)),
            None => self.ready(homes, ui),
        }
    }

    /// The arm stands and may move: where the next motion begins, rad. With `homes` it finds the zeros that it lacks.
    ///
    /// # Errors
    /// What kept it from that.
    pub fn ready(&mut self, homes: bool, ui: OnProgress<'_>) -> Result<JointVec, ExpectedError> {
        let order = Order { homes, ..self.order(Motion::default(), Extent::Ready) };
        let ready = self.perform(&order, ui)?;
        let measured = ready.pose.ok_or_else(|| ExpectedError::new(exit::DRIVE, "no pose was measured"))?;
        Ok(self.near_end(measured))
    }

    fn near_end(&self, measured: JointVec) -> JointVec {
        self.end.filter(|end| (end - measured).amax() < THERE_RAD).unwrap_or(measured)
    }

    /// A motion of this arm.
    #[must_use]
    pub fn order(&self, motion: Motion, extent: Extent) -> Order<'a> {
        let order = Order::new(self.robot, self.fingerprint, Program::Motion(motion), Judge::Reach);
        Order { extent, ..order }
    }

    /// Runs the motion of an order.
    ///
    /// # Errors
    /// A stop, a fault, or an arm that does not end where it should.
    pub fn run(&mut self, order: &Order<'_>, ui: OnProgress<'_>) -> Result<Record, ExpectedError> {
        self.end = None;
        let record = self.perform(order, ui)?;
        self.end = Some(order.program.motion().stop_rad());
        Ok(record)
    }

    fn perform(&mut self, order: &Order<'_>, ui: OnProgress<'_>) -> Result<Record, ExpectedError> {
        let record = perform(self.operator, order, ui);
        failure(&record).or_else(|| off_target(&record, &order.judge)).map_or(Ok(record), Err)
    }
}

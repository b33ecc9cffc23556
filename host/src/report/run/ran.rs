//! What was run: a throw, or a motion that throws nothing.

use planner::motion::Motion;
use planner::plan::file::{PlanFile, RobotId};

/// A motion and what it is for.
pub struct Ran {
    pub robot: RobotId,
    pub motion: Motion,
    /// `None` if nothing is thrown.
    pub throw: Option<PlanFile>,
}

impl From<PlanFile> for Ran {
    fn from(plan: PlanFile) -> Self {
        Self { robot: plan.robot.clone(), motion: plan.motion.to_motion(), throw: Some(plan) }
    }
}

impl Ran {
    pub(super) fn title(&self) -> String {
        match &self.throw {
            Some(plan) => {
                let [x, y, z] = plan.target.position_m;
                format!("Throw to ({x}, {y}, {z}) m")
            }
            None => "Motion".to_owned(),
        }
    }

    pub(super) fn end_s(&self) -> f64 {
        self.motion.duration_s()
    }

    pub(super) fn release_s(&self) -> Option<f64> {
        self.throw.as_ref().map(|plan| plan.release_time_s)
    }

    pub(super) fn seed(&self) -> Option<u64> {
        self.throw.as_ref().map(|plan| plan.search.seed)
    }
}

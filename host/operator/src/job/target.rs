//! Where a motion is to go, and the way there from where the arm stands.

use planner::motion::Motion;
use planner::plan::{Arm, Joints};
use planner::way::{Goal, Travel, WayError, straight_to, way, way_to};
use robot_model::collision::Scene;

/// Where to.
#[derive(Clone, Debug, PartialEq)]
pub enum Target {
    /// These joint angles, rad.
    Joints(Joints),
    /// Joints, from 0, turned by angles, rad.
    By(Vec<(usize, f64)>),
    /// A place or pose of the hand; on a straight line if requested.
    Hand { goal: Goal, straight: bool },
}

/// A target of an arm with another number of joints.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TargetError {
    #[error("{angles} angles for an arm of {joints} joints")]
    Angles { angles: usize, joints: usize },
    #[error("joint {joint} of an arm of {joints} joints")]
    Joint { joint: usize, joints: usize },
}

impl TargetError {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        Some(match self {
            Self::Angles { .. } => "give one for each joint".to_owned(),
            Self::Joint { joints, .. } => format!("name a joint from 1 to {joints}"),
        })
    }
}

impl Target {
    /// Angles of all joints of `arm`, rad.
    ///
    /// # Errors
    /// [`TargetError::Angles`].
    pub fn joints(arm: &Arm, q_rad: &[f64]) -> Result<Self, TargetError> {
        let (angles, joints) = (q_rad.len(), arm.n());
        (angles == joints)
            .then(|| Self::Joints(Joints::from_slice(q_rad)))
            .ok_or(TargetError::Angles { angles, joints })
    }

    /// Joints of `arm`, from 0, turned by angles, rad.
    ///
    /// # Errors
    /// [`TargetError::Joint`].
    pub fn by(arm: &Arm, turned: &[(usize, f64)]) -> Result<Self, TargetError> {
        let joints = arm.n();
        match turned.iter().find(|(joint, _)| *joint >= joints) {
            Some((joint, _)) => Err(TargetError::Joint { joint: joint + 1, joints }),
            None => Ok(Self::By(turned.to_vec())),
        }
    }

    /// The way there; `None` if the arm is there.
    pub fn way(
        &self,
        arm: &Arm,
        scene: &Scene,
        travel: &Travel,
        from: &Joints,
    ) -> Result<Option<Motion>, WayError> {
        match self {
            Self::Joints(to) => way(arm, scene, travel, from, to),
            Self::By(turned) => {
                let mut to = *from;
                turned.iter().for_each(|(joint, by_rad)| to[*joint] += by_rad);
                way(arm, scene, travel, from, &to)
            }
            Self::Hand { goal, straight: true } => straight_to(arm, scene, travel, from, goal),
            Self::Hand { goal, straight: false } => way_to(arm, scene, travel, from, goal),
        }
    }
}

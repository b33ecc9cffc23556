//! Kinematic families: classes of arms for which inverse kinematics has a closed form.
//!
//! A family is the only thing about machines that is code. Its dimensions are measured from the joint frames of
//! the robot file when it is loaded; frames that do not have the family's geometry are refused.

mod lines;
mod ortho_parallel;
mod ortho_parallel_ik;

use crate::error::FamilyMismatch;
use crate::pose::Pose;
pub use ortho_parallel::OrthoParallel;

/// Kinematic family with the dimensions of one robot.
#[derive(Debug, Clone, PartialEq)]
#[expect(
    clippy::large_enum_variant,
    reason = "one per robot, read in the inner loop of the planner: a box would only add a jump"
)]
#[non_exhaustive]
pub enum Family {
    /// Six joints: upright first axis, two parallel axes across it, wrist of three axes that meet.
    ///
    /// The PowerCube throwing arm (no offsets) and the KUKA KR 16 (shoulder and elbow offsets) are both of this
    /// family, as are most industrial arms.
    OrthoParallel(OrthoParallel),
    /// No closed form; inverse kinematics is not available.
    General,
}

/// Family as named in a robot file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum FamilyName {
    OrthoParallel,
    General,
}

impl FamilyName {
    pub(crate) const WORDS: [(&'static str, Self); 2] =
        [("ortho_parallel", Self::OrthoParallel), ("general", Self::General)];
}

impl Family {
    /// Measures the family's dimensions from the joint frames.
    pub(crate) fn fit(name: FamilyName, x_pj: &[Pose], _x_ne: &Pose) -> Result<Self, FamilyMismatch> {
        match name {
            FamilyName::OrthoParallel => OrthoParallel::fit(x_pj).map(Self::OrthoParallel),
            FamilyName::General => Ok(Self::General),
        }
    }
}

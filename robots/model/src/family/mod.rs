//! Kinematic families: classes of arms for which inverse kinematics has a closed form.
//!
//! The family is the only property of a machine that is code. Its dimensions are computed from the joint frames of
//! the robot file when it is loaded; frames that do not have the family's geometry are refused.

mod lines;
mod ortho_parallel;
mod ortho_parallel_axis;
mod ortho_parallel_ik;
mod planar;
mod turntable_planar;

use crate::error::FamilyMismatch;
use crate::pose::Pose;
pub use ortho_parallel::OrthoParallel;
pub use turntable_planar::TurntablePlanar;

/// Kinematic family with the dimensions of one robot.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Family {
    /// Six joints: upright first axis, two parallel axes across it, wrist of three axes that meet.
    ///
    /// The PowerCube throwing arm (no offsets) and the KUKA KR 16 (shoulder and elbow offsets) are both of this
    /// family, as are most industrial arms.
    OrthoParallel(OrthoParallel),
    /// Four joints: a turntable and three parallel axes across it, like the Pincher.
    TurntablePlanar(TurntablePlanar),
    /// No closed form; inverse kinematics is not available.
    General,
}

/// Family as named in a robot file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum FamilyName {
    OrthoParallel,
    TurntablePlanar,
    General,
}

impl FamilyName {
    pub(crate) const WORDS: [(&'static str, Self); 3] = [
        ("ortho_parallel", Self::OrthoParallel),
        ("turntable_planar", Self::TurntablePlanar),
        ("general", Self::General),
    ];
}

impl Family {
    /// Measures the family's dimensions from the joint frames and the end effector in the last of them.
    pub(crate) fn fit(name: FamilyName, x_pj: &[Pose], x_ne: &Pose) -> Result<Self, FamilyMismatch> {
        match name {
            FamilyName::OrthoParallel => OrthoParallel::fit(x_pj).map(Self::OrthoParallel),
            FamilyName::TurntablePlanar => TurntablePlanar::fit(x_pj, x_ne).map(Self::TurntablePlanar),
            FamilyName::General => Ok(Self::General),
        }
    }

    /// The family that fits, if one does.
    pub(crate) fn recognise(x_pj: &[Pose], x_ne: &Pose) -> Self {
        [FamilyName::OrthoParallel, FamilyName::TurntablePlanar]
            .into_iter()
            .find_map(|name| Self::fit(name, x_pj, x_ne).ok())
            .unwrap_or(Self::General)
    }

    /// Name as in a robot file.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::OrthoParallel(_) => "ortho_parallel",
            Self::TurntablePlanar(_) => "turntable_planar",
            Self::General => "general",
        }
    }
}

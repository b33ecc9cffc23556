//! What the robot and its controller allow.

use robot_model::{JointVec, RobotModel};
use serde::{Deserialize, Serialize};

/// Six joints: the hand's position and rotation fix them all.
pub const AXES: usize = 6;

/// One number per joint.
pub type Axes = JointVec;

pub type Arm = RobotModel;

/// Cut-out of the simulated KR C by acceleration, deg/s² (chosen; the paper's run gives a lower bound).
const KRC_CUT_OUT_DEG_S2: f64 = 2000.0;
/// Cut-out of the simulated KR C by jerk, deg/s³ (chosen as above).
pub(crate) const KRC_CUT_OUT_DEG_S3: f64 = 1.5e5;

/// Shares of the limits that a search with [`Limits::with_spare_for_commands`] uses: of accelerations and jerks, and of speeds.
const COMMAND_SHARE: f64 = 0.95;
const SPEED_SHARE: f64 = 0.995;

/// Limits per axis. Speed, acceleration and jerk hold for finite differences of the *commanded* set points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Range of the joints in rad.
    pub q_min_rad: Axes,
    /// Range of the joints in rad.
    pub q_max_rad: Axes,
    /// Speed in rad/s.
    pub v_max_rad_s: Axes,
    /// Acceleration of the ramps in rad/s².
    pub ramp_rad_s2: Axes,
    /// Acceleration anywhere in rad/s².
    pub a_max_rad_s2: Axes,
    /// Jerk anywhere in rad/s³.
    pub j_max_rad_s3: Axes,
}

/// Where the limits of acceleration and jerk come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LimitSource {
    /// The robot file: following acceleration (else the one of plans) and jerk.
    RobotFile,
    /// The following acceleration of the robot file; else, and for the jerk, the cut-out of the simulated KR C.
    ControllerModel,
}

impl Limits {
    /// Limits of the paper: it states no acceleration for set points on the flight, so only the cut-out of the simulated KR C
    /// applies.
    #[must_use]
    pub fn of_paper(arm: &Arm) -> Self {
        let a_max_rad_s2 = Axes::repeat(AXES, KRC_CUT_OUT_DEG_S2.to_radians());
        Self { a_max_rad_s2, ..Self::of(arm, LimitSource::ControllerModel) }
    }

    /// The limits of an arm.
    #[must_use]
    pub fn of(arm: &Arm, source: LimitSource) -> Self {
        let (a_max_rad_s2, j_max_rad_s3) = match source {
            LimitSource::RobotFile => (
                arm.limit(|l| l.a_follow_max_rad_s2.unwrap_or(l.a_max_rad_s2)),
                arm.limit(|l| l.j_max_rad_s3),
            ),
            LimitSource::ControllerModel => {
                let cut_out = KRC_CUT_OUT_DEG_S2.to_radians();
                (
                    arm.limit(|l| l.a_follow_max_rad_s2.unwrap_or(cut_out).min(cut_out)),
                    Axes::repeat(AXES, KRC_CUT_OUT_DEG_S3.to_radians()),
                )
            }
        };
        Self {
            q_min_rad: arm.q_min(),
            q_max_rad: arm.q_max(),
            v_max_rad_s: arm.limit(|l| l.v_max_rad_s),
            ramp_rad_s2: arm.limit(|l| l.a_max_rad_s2),
            a_max_rad_s2,
            j_max_rad_s3,
        }
    }

    /// Limits for a search whose commands a robot takes at its own times, with its own decimals: differences at
    /// times between those of the plan are up to 1 % larger.
    #[must_use]
    pub fn with_spare_for_commands(&self) -> Self {
        Self {
            v_max_rad_s: self.v_max_rad_s * SPEED_SHARE,
            a_max_rad_s2: self.a_max_rad_s2 * COMMAND_SHARE,
            j_max_rad_s3: self.j_max_rad_s3 * COMMAND_SHARE,
            ..*self
        }
    }

    /// The same with another acceleration of the ramps, in rad/s² for every axis.
    #[must_use]
    pub fn with_ramps(mut self, rad_s2: f64) -> Self {
        self.ramp_rad_s2 = Axes::repeat(AXES, rad_s2);
        self
    }
}

//! The plan file: a throw with everything needed to run it and to judge it.
//!
//! JSON, versioned, units in the names of the keys; `host/planner/schemas/plan.schema.json` is made from the types. Numbers are written
//! so that they read back to the same bits.
//!
//! # Map
//! | module | holds |
//! |---|---|
//! | here | the keys of the file |
//! | `claims` | what follows from the rest of the file, computed again |
//! | `compose` | from a throw to its plan |
//! | `motion` | knots and events; their form in files before version 6 |
//! | `io` | reading, writing, and refusals |

mod claims;
mod compose;
mod io;
mod motion;

use robot_model::RobotModel;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(crate) use self::claims::first_difference;
pub use self::io::{FILE_MAX_BYTES, PlanFileError, fields, parse, require_robot, tagged_json};
pub use self::motion::{EventInfo, KnotInfo, MotionInfo};
use super::optima::Confidence;
use super::paper::PaperParameters;
use super::problem::{Form, Weights};
use super::statistics::{Noise, Region};
use crate::store::fingerprint_of;

/// Version of the format that this program writes, and the newest it reads.
pub const VERSION: u32 = 11;
/// First field of every plan file.
pub const FORMAT: &str = "cubectl-plan";

/// Kind of a plan file: its field `kind`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A throw.
    Throw,
    /// A throw whose hand follows the flight of the ball for a while.
    Follow,
    /// A motion, without more about it.
    Move,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Self; 3] = [Self::Throw, Self::Follow, Self::Move];

    /// Text of the field.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Throw => "throw",
            Self::Follow => "follow",
            Self::Move => "move",
        }
    }

    /// The kind of a name.
    #[must_use]
    pub(crate) fn of_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }
}

/// The plan of a throw. In the file the field `kind` stands before it: [`Kind::Throw`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PlanFile {
    /// Always [`FORMAT`].
    pub format: String,
    /// Version of the format.
    pub version: u32,
    /// Which robot.
    pub robot: RobotId,
    /// Target of the throw.
    pub target: Target,
    /// Boxes in the way; files before version 4 do not name them.
    #[serde(default)]
    pub obstacles: Vec<ObstacleInfo>,
    /// How it was found.
    pub search: Search,
    /// The paper's parameters of the throw; for a free spin ω is the part about the throw.
    pub parameters: PaperParameters,
    /// The motion.
    pub motion: MotionInfo,
    /// When the ball is free, in s from the start of the motion; the first `open` of its events.
    pub release_time_s: f64,
    /// When the motion ends, in s: its last knot.
    pub end_time_s: f64,
    /// State at the release.
    pub release: Release,
    /// Release frame in the end-effector frame, row by row.
    pub t_ball: [[f64; 4]; 4],
    /// Objective (1).
    pub objective: Objective,
    /// Flight and landing.
    pub landing: LandingInfo,
    /// What is left of every limit.
    pub margins: MarginsInfo,
    /// Largest currents.
    pub currents: Currents,
    /// What was checked, with which tolerance.
    pub checks: Vec<CheckInfo>,
}

/// Which robot a plan is for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RobotId {
    /// Name in the robot file.
    pub name: String,
    /// What was given to `--robot`.
    pub source: String,
    /// Fingerprint of everything a throw depends on, hexadecimal.
    pub fingerprint: String,
}

impl RobotId {
    /// Of `arm`, which `source` names.
    #[must_use]
    pub fn of(source: &str, arm: &RobotModel) -> Self {
        let fingerprint = fingerprint_of(arm);
        Self { name: arm.name().to_owned(), source: source.to_owned(), fingerprint }
    }
}

/// The target.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Target {
    /// Point in the world, at the planned release.
    pub position_m: [f64; 3],
    /// Region that counts as a hit, in the plane of the target.
    pub region: Option<Region>,
    /// The opening that the ball passes, with its centre at the point; without one the ball comes down on a horizontal
    /// plane. New in version 7.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub opening: Option<OpeningInfo>,
    /// How the target moves from the planned release on: velocity in m/s, then the coefficients of t², t³, …; empty: it
    /// is at rest. New in version 7.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub course: Vec<[f64; 3]>,
}

/// An opening that the ball passes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct OpeningInfo {
    /// Unit normal, to the side from which the ball comes.
    pub normal: [f64; 3],
    /// Unit axes of the coordinates in its plane.
    pub axes: [[f64; 3]; 2],
    /// Radius in m.
    pub radius_m: f64,
    /// Largest angle between path and normal that was allowed, in rad.
    pub incidence_max_rad: f64,
    /// The angle of this throw in rad.
    pub incidence_rad: f64,
    /// Clearance between the surface of the ball and the rim in m.
    pub rim_clearance_m: f64,
}

/// A box that arm and ball keep clear of.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ObstacleInfo {
    /// Name for messages.
    pub name: String,
    /// Centre and axes of the box in the world, row by row.
    pub x_wo: [[f64; 4]; 4],
    /// Half edge lengths in m.
    pub half_m: [f64; 3],
}

/// How a throw was found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Search {
    /// Form.
    pub form: Form,
    /// What was made small; in files before version 3 always the effort.
    #[serde(default)]
    pub goal: GoalName,
    /// Starts that were run.
    pub starts: usize,
    /// Starts that found a throw.
    pub solved: usize,
    /// Seed.
    pub seed: u64,
    /// Whether it was stopped early.
    pub interrupted: bool,
    /// Part of the speed limits that was available; missing in older files, which used all.
    #[serde(default = "whole")]
    pub speed_use: f64,
    /// Part of the acceleration limits that was available.
    pub acceleration_use: f64,
    /// Clearance that was kept in m; missing in files before version 4, which claim that bodies do not touch.
    #[serde(default)]
    pub clearance_m: f64,
    /// Clearance that the released ball kept from the hand in m; missing in files before version 9, which claim
    /// that they do not touch.
    #[serde(default)]
    pub hand_clearance_m: f64,
    /// True if the request allowed the released ball to touch the arm. New in version 10.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub touch_allowed: bool,
    /// Conclusion of the starts about throws that were not found; missing in files before version 5.
    #[serde(default)]
    pub confidence: Option<Confidence>,
    /// Stored throws that were available, by their source; missing in files before version 5.
    #[serde(default)]
    pub stored: Vec<String>,
}

fn whole() -> f64 {
    1.0
}

/// What a search made small.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum GoalName {
    /// The paper's objective (1).
    #[default]
    Effort,
    /// The electrical energy from the supplies.
    Energy,
    /// The root mean square distance of the landing from the target.
    Spread,
    /// The odds against a hit of the region.
    Miss,
}

/// State at the release.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Release {
    /// Joint angles in rad.
    pub q_rad: Vec<f64>,
    /// Joint speeds in rad/s.
    pub qd_rad_s: Vec<f64>,
    /// Joint accelerations in rad/s².
    pub qdd_rad_s2: Vec<f64>,
    /// Ball in m.
    pub position_m: [f64; 3],
    /// Ball in m/s.
    pub velocity_m_s: [f64; 3],
}

/// Objective with its terms.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Objective {
    /// Sum.
    pub value: f64,
    /// Weight of time times the duration.
    pub time: f64,
    /// Weight of the ratio times the ratio.
    pub braking: f64,
    /// Weight of jerk times its squared integral.
    pub jerk: f64,
    /// The weights.
    pub weights: Weights,
}

/// Flight and landing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LandingInfo {
    /// Gravity in m/s².
    pub gravity_m_s2: f64,
    /// Drag in 1/m.
    pub drag_per_m: f64,
    /// Magnus vector in 1/s.
    pub magnus_rad_s: [f64; 3],
    /// Time of flight in s.
    pub flight_s: f64,
    /// Where an exact throw lands, in m.
    pub position_m: [f64; 3],
    /// Velocity there in m/s.
    pub velocity_m_s: [f64; 3],
    /// Mean of the landing with the noise below: x and y in m, in an opening coordinates along its axes.
    pub mean_m: [f64; 2],
    /// Covariance of the landing in m², row by row.
    pub covariance_m2: [[f64; 2]; 2],
    /// `dL/dδ` for a gripper that opens δ late, in mm per ms.
    pub delay_sensitivity_mm_per_ms: [f64; 2],
    /// How far the landing moves for a late or early gripper; empty in files of version 1.
    #[serde(default)]
    pub delay_shifts: Vec<DelayShift>,
    /// Noise that the covariance is for.
    pub noise: Noise,
    /// Probability of a hit, if a region was given.
    pub hit_probability: Option<f64>,
    /// The same for a ball that leaves between fingers that open, if that was requested.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fingers: Option<FingerLandingInfo>,
}

/// Landing of a ball that leaves between fingers that open.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FingerLandingInfo {
    /// From the planned release to the last touch of a finger, in s.
    pub late_s: f64,
    /// Shift of the landing against a ball that is free at the planned release, in m; coordinates as `mean_m`.
    pub shift_m: [f64; 2],
    /// Mean of the landing with all noise, in m.
    pub mean_m: [f64; 2],
    /// Its covariance in m², row by row.
    pub covariance_m2: [[f64; 2]; 2],
    /// Probability of a hit, if a region was given.
    pub hit_probability: Option<f64>,
}

/// Shift of the landing when the gripper opens late or early.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DelayShift {
    /// Delay, and equally advance, of the release in s.
    pub delay_s: f64,
    /// Larger of the two shifts in m; `None` if the ball then does not come down on the plane of the target.
    pub shift_m: Option<f64>,
    /// Limit that the plan keeps in m, if there is one.
    pub limit_m: Option<f64>,
}

/// What is left of every limit: rad for positions, m for clearances, otherwise a share of the full limit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MarginsInfo {
    /// Positions.
    pub position_rad: Vec<f64>,
    /// Speeds.
    pub speed_share: Vec<f64>,
    /// Accelerations.
    pub acceleration_share: Vec<f64>,
    /// Jerks.
    pub jerk_share: Vec<f64>,
    /// Motor currents at the release.
    pub motor_current_share: Option<Vec<f64>>,
    /// Supply currents at the release.
    pub supply_current_share: Vec<f64>,
    /// Smallest clearance of the arm; bodies that are far apart are not measured.
    pub clearance_m: Option<f64>,
    /// Smallest clearance of the released ball.
    pub ball_clearance_m: f64,
}

/// Largest currents over the motion.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Currents {
    /// Motors at the release in A (with the paper's simplification τ(q, q̇, 0)).
    pub motor_release_a: Option<Vec<f64>>,
    /// Motors over the motion in A.
    pub motor_peak_a: Option<Vec<f64>>,
    /// Supplies over the motion.
    pub supply_peak: Vec<SupplyPeak>,
}

/// Largest current of a supply.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SupplyPeak {
    /// Name.
    pub name: String,
    /// Largest current over the motion in A.
    pub peak_a: f64,
    /// Limit in A.
    pub limit_a: f64,
}

/// One check.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CheckInfo {
    /// What.
    pub what: String,
    /// Whether it was part of the plan's constraints.
    pub enforced: bool,
    /// Tolerance with unit.
    pub tolerance: String,
}

//! A plan file of any kind, by its field `kind`; and the JSON schema of all of them, made from the types.

use std::path::Path;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use toml_reader::read_text;

use crate::follow::plan::FollowPlan;
use crate::plan::file::{
    FILE_MAX_BYTES, FORMAT, Kind, MotionInfo, PlanFile, PlanFileError, RobotId, VERSION, fields, parse,
    tagged_json,
};

/// A plan of any kind.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum PlanRecord {
    /// A throw.
    Throw(Box<PlanFile>),
    /// A throw whose hand follows the flight of the ball for a while.
    Follow(Box<FollowPlan>),
    /// A motion, without more about it.
    Move(Box<MovePlan>),
}

/// A motion from rest to rest that any program may have made. The controller checks it like every other.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MovePlan {
    /// Always [`FORMAT`].
    pub format: String,
    /// Version of the format.
    pub version: u32,
    /// Which robot.
    pub robot: RobotId,
    /// The motion.
    pub motion: MotionInfo,
}

impl MovePlan {
    /// The plan of a motion.
    #[must_use]
    pub fn new(robot: RobotId, motion: MotionInfo) -> Self {
        Self { format: FORMAT.to_owned(), version: VERSION, robot, motion }
    }

    /// As JSON.
    #[must_use]
    pub fn to_json(&self) -> String {
        tagged_json(Kind::Move, self)
    }
}

impl PlanRecord {
    /// Reads a plan file of any kind and of any version up to this program's.
    ///
    /// # Errors
    /// [`PlanFileError`].
    pub fn read(path: &Path) -> Result<Self, PlanFileError> {
        let text = read_text(path, FILE_MAX_BYTES)
            .map_err(|source| PlanFileError::Io { path: path.to_owned(), source })?;
        Self::from_json(path, &text)
    }

    /// Reads JSON; `path` is for messages.
    ///
    /// # Errors
    /// As [`PlanRecord::read`].
    pub fn from_json(path: &Path, text: &str) -> Result<Self, PlanFileError> {
        let damaged = |reason: String| PlanFileError::Damaged { path: path.to_owned(), reason };
        let (kind, value) = parse(path, text)?;
        Ok(match kind {
            Kind::Throw => Self::Throw(Box::new(PlanFile::from_value(path, value)?)),
            Kind::Follow => {
                let plan: FollowPlan = fields(path, value)?;
                plan.sound().map_err(|e| damaged(e.to_string()))?;
                Self::Follow(Box::new(plan))
            }
            Kind::Move => {
                let plan: MovePlan = fields(path, value)?;
                plan.motion.sound().map_err(damaged)?;
                Self::Move(Box::new(plan))
            }
        })
    }

    /// Its kind.
    #[must_use]
    pub const fn kind(&self) -> Kind {
        match self {
            Self::Throw(_) => Kind::Throw,
            Self::Follow(_) => Kind::Follow,
            Self::Move(_) => Kind::Move,
        }
    }

    /// The robot that it is for.
    #[must_use]
    pub fn robot(&self) -> &RobotId {
        match self {
            Self::Throw(plan) => &plan.robot,
            Self::Follow(plan) => &plan.robot,
            Self::Move(plan) => &plan.robot,
        }
    }
}

/// The JSON schema of every kind of plan file that this program writes.
#[must_use]
pub fn schema_json() -> String {
    // A schema is numbers, text and lists of them; writing those to a string cannot fail.
    serde_json::to_string_pretty(&schemars::schema_for!(PlanRecord)).unwrap_or_default() + "\n"
}

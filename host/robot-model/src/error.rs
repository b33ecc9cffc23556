//! What can be wrong with a robot file, with the data needed to put it right.

use std::fmt;

/// A robot file was refused: where, and why.
///
/// The text reads `file:line: key: reason`, so that an editor can jump to it.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub struct LoadError {
    /// File name as given by the caller, or `<builtin>/name.toml`.
    pub file: String,
    /// Line (from 1) the reason refers to; `None` if the file could not be read at all.
    pub line: Option<usize>,
    /// Key path, for example `joint[2].range_deg`; empty for the file as a whole.
    pub key: String,
    /// The reason.
    pub problem: Problem,
}

impl fmt::Display for LoadError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.file)?;
        if let Some(line) = self.line {
            write!(f, ":{line}")?;
        }
        if !self.key.is_empty() {
            write!(f, ": {}", self.key)?;
        }
        write!(f, ": {}", self.problem)
    }
}

/// Reason for refusing a robot file.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Problem {
    /// The file could not be read.
    #[error("cannot read the file: {0}")]
    Unreadable(String),
    /// There is no built-in robot of this name and no such file.
    #[error("no such file, and no built-in robot of this name (built in: {})", .known.join(", "))]
    UnknownRobot {
        /// Names of the built-in robots.
        known: Vec<&'static str>,
    },
    /// Not TOML.
    #[error("not valid TOML: {0}")]
    Syntax(String),
    /// The file was written for another schema version.
    #[error("schema version {found} is not supported (this program reads version {supported})")]
    Schema {
        /// Version in the file.
        found: i64,
        /// Version this program reads.
        supported: i64,
    },
    /// The key is not part of the schema here.
    #[error("unknown key{}", hint(.same_quantity, .expected))]
    UnknownKey {
        /// A known key for the same quantity in another unit.
        same_quantity: Option<&'static str>,
        /// All keys known here.
        expected: Vec<&'static str>,
    },
    /// The key must be there.
    #[error("missing")]
    Missing,
    /// The value has another type.
    #[error("expected {expected}, found {found}")]
    WrongType {
        /// What the schema asks for.
        expected: &'static str,
        /// What the file has.
        found: &'static str,
    },
    /// A list has another length.
    #[error("expected {expected} values, found {found}")]
    WrongLength {
        /// Number of values the schema asks for.
        expected: usize,
        /// Number of values in the file.
        found: usize,
    },
    /// NaN or infinite.
    #[error("{0} is not a finite number")]
    NotFinite(f64),
    /// Must be greater than zero.
    #[error("{0} must be greater than zero")]
    NotPositive(f64),
    /// Must not be negative.
    #[error("{0} must not be negative")]
    Negative(f64),
    /// Outside the range that makes sense for this quantity.
    #[error("{value} is outside {min} to {max}")]
    OutOfRange {
        /// Value in the file.
        value: f64,
        /// Smallest value accepted.
        min: f64,
        /// Largest value accepted.
        max: f64,
    },
    /// Lower limit at or above the upper one.
    #[error("limits reversed: {min} is not below {max}")]
    LimitsReversed {
        /// Lower limit in the file, in the file's unit.
        min: f64,
        /// Upper limit in the file, in the file's unit.
        max: f64,
    },
    /// The model was asked for with another number of joints.
    #[error("the robot has {found} joints, but {expected} are needed here")]
    JointCount {
        /// Number asked for by the caller.
        expected: usize,
        /// Number in the file.
        found: usize,
    },
    /// As many links as joints are needed.
    #[error("{links} links for {joints} joints; each joint moves one link")]
    LinkCount {
        /// Joints in the file.
        joints: usize,
        /// Links in the file.
        links: usize,
    },
    /// A name is used twice.
    #[error("`{0}` is used twice")]
    Duplicate(String),
    /// Two drives share one bus address.
    #[error("bus address {address} already belongs to {owner}")]
    DuplicateAddress {
        /// The address.
        address: i64,
        /// Joint that has it first.
        owner: String,
    },
    /// A supply names a joint that is not there.
    #[error("there is no joint `{0}`")]
    UnknownJoint(String),
    /// A joint hangs on two supplies.
    #[error("joint `{joint}` already belongs to supply `{owner}`")]
    JointInTwoSupplies {
        /// The joint.
        joint: String,
        /// The supply that has it first.
        owner: String,
    },
    /// A joint has a drive but no supply.
    #[error("joint `{0}` is on no supply")]
    JointWithoutSupply(String),
    /// Some joints have a drive and some have none.
    #[error("joint `{0}` has no drive, though others have: all or none")]
    DriveMissing(String),
    /// The name of the kinematic family is not known.
    #[error("unknown value `{found}` (known: {})", .known.join(", "))]
    UnknownChoice {
        /// Text in the file.
        found: String,
        /// Accepted texts.
        known: Vec<&'static str>,
    },
    /// The frames do not have the geometry of the declared family.
    #[error("the joint frames do not fit this family: {0}")]
    FamilyMismatch(FamilyMismatch),
    /// The three axes are not an orthonormal right-handed frame.
    #[error("the axes are not a right-handed orthonormal frame (error {0:.1e})")]
    NotARotation(f64),
    /// The joint axis has no direction.
    #[error("the axis has length zero")]
    ZeroAxis,
    /// Moments of inertia no body can have.
    #[error(
        "no body has these moments of inertia: {0:?} (principal moments must be positive, none above the sum of the others)"
    )]
    ImpossibleInertia([f64; 3]),
    /// The link has neither an inertial nor boxes that all have a mass.
    #[error("the link needs a mass on every box, or an `inertial` table")]
    NoMass,
    /// Both an inertial and box masses.
    #[error("give either `inertial` or box masses, not both")]
    MassTwice,
}

/// Geometric condition of a kinematic family that the frames violate.
///
/// Joints are counted from 1, as in the papers.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum FamilyMismatch {
    /// Other number of joints.
    #[error("it needs {needed} joints, the robot has {found}")]
    Joints {
        /// Joints of the family.
        needed: usize,
        /// Joints of the robot.
        found: usize,
    },
    /// Two axes must be parallel.
    #[error("axes {a} and {b} must be parallel (off by {off_rad:.2e} rad)")]
    NotParallel {
        /// First joint.
        a: usize,
        /// Second joint.
        b: usize,
        /// Angle between the axes.
        off_rad: f64,
    },
    /// Two axes must be perpendicular.
    #[error("axes {a} and {b} must be perpendicular (off by {off_rad:.2e} rad)")]
    NotPerpendicular {
        /// First joint.
        a: usize,
        /// Second joint.
        b: usize,
        /// Deviation from a right angle.
        off_rad: f64,
    },
    /// Two axes must meet.
    #[error("axes {a} and {b} must meet (they pass at {gap_m:.2e} m)")]
    NotMeeting {
        /// First joint.
        a: usize,
        /// Second joint.
        b: usize,
        /// Distance between the axes.
        gap_m: f64,
    },
    /// The three wrist axes must meet in one point.
    #[error("axes 4, 5 and 6 must meet in one point (they miss it by {gap_m:.2e} m)")]
    NoWristCentre {
        /// Distance between the intersections.
        gap_m: f64,
    },
    /// A link that must have length has none.
    #[error("the distance between axes {a} and {b} must not be zero")]
    NoLength {
        /// First joint.
        a: usize,
        /// Second joint.
        b: usize,
    },
    /// The end effector lies on the last axis, so the hand has no direction.
    #[error("the end effector must not lie on axis {joint}")]
    EndEffectorOnAxis {
        /// The last joint.
        joint: usize,
    },
}

fn hint(same_quantity: &Option<&'static str>, expected: &[&'static str]) -> String {
    match same_quantity {
        Some(key) => format!("; this file gives that quantity as `{key}` (mind the unit)"),
        None => format!(" (known here: {})", expected.join(", ")),
    }
}

//! What can be wrong with a robot file, with the data needed to put it right.

use std::borrow::Cow;

use toml_reader::DocumentError;

/// A robot file was refused: where, and why.
///
/// The text reads `file:line: key: reason`, so that an editor can jump to it; the file of a built-in robot is
/// `<builtin>/name.toml`.
pub type LoadError = DocumentError<Problem>;

/// Reason for refusing a robot file.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Problem {
    /// What can be wrong with any document.
    #[error(transparent)]
    Document(#[from] toml_reader::Problem),
    /// There is no built-in robot of this name and no such file.
    #[error("no such file, and no built-in robot of this name")]
    UnknownRobot {
        /// Names of the built-in robots.
        known: Vec<&'static str>,
    },
    /// Lower limit at or above the upper one.
    #[error("limits reversed: {min} is not below {max}")]
    LimitsReversed {
        /// Lower limit in the file, in the file's unit.
        min: f64,
        /// Upper limit in the file, in the file's unit.
        max: f64,
    },
    /// The arm is loaded for what works with another number of joints.
    #[error("the robot has {found} joints, but {needed} are needed here")]
    JointCount {
        /// Number that is needed.
        needed: usize,
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
    /// Generic drives beside others.
    #[error("generic drives stand for all drives: the file has {0} too; give one or the other")]
    GenericBeside(&'static str),
    /// A generic drive follows from the torque of its joint.
    #[error("joint `{0}` has no torque_max_nm, from which its generic drive follows")]
    GenericWithoutTorque(String),
    /// A pair of links names a link that does not exist.
    #[error("there is no link `{0}` (`base` is what does not move)")]
    UnknownLink(String),
    /// Some joints have a drive of this family and others do not.
    #[error("joint `{joint}` has no {what}, though others have: all or none")]
    FamilyMissing {
        /// The drive, for people.
        what: &'static str,
        /// A joint without one.
        joint: String,
    },
    /// A joint has two drives.
    #[error("joint `{0}` has another drive too; give one or the other")]
    TwoFamilies(String),
    /// A limit of a joint that its drive cannot be given.
    #[error("{value:.1} is more than {holder} hold ({max:.1})")]
    BeyondDrive {
        /// The limit, in the file's unit.
        value: f64,
        /// Largest value that fits.
        max: f64,
        /// What cannot hold it.
        holder: String,
    },
    /// Two drives have one number on the bus.
    #[error("{what} already belongs to {owner}")]
    NumberTaken {
        /// The number, with what it is called.
        what: String,
        /// Joint that has it first, or the gripper.
        owner: String,
    },
    /// What only this family of drives refuses.
    #[error("{0}")]
    OfFamily(Cow<'static, str>),
    /// The gripper has a drive of this family, but the joints do not.
    #[error("the gripper has an {0}, but the joints have none")]
    GripperAlone(&'static str),
    /// A gripper that does not move.
    #[error("open and closed are the same angle")]
    GripperStill,
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
    /// The link has no inertial, and not all of its boxes have a mass.
    #[error("the link needs a mass on every box, or an `inertial` table")]
    NoMass,
    /// Fingers that close along the throw: the ball could not leave.
    #[error(
        "the fingers close {off_deg:.0} deg from the direction of the throw; at least 45 are needed, the ball leaves between them"
    )]
    FingersAcrossThrow {
        /// Angle between closing axis and throw in degrees.
        off_deg: f64,
    },
    /// Fingers that never leave the ball.
    #[error("a travel of {travel_m} m does not free a ball that is pressed in by {give_m} m")]
    FingersTooShort {
        /// Travel of a finger in m.
        travel_m: f64,
        /// How far a pad is pressed in, in m.
        give_m: f64,
    },
    /// Pads that are too stiff to be integrated.
    #[error(
        "grip_m_s2 over give_m is {stiffness_1_s2:.1e} 1/s²; at most {max_1_s2:.0e}: a softer pad or less grip"
    )]
    PadsTooStiff {
        /// Stiffness of a pad over the mass of the ball in 1/s².
        stiffness_1_s2: f64,
        /// Largest one.
        max_1_s2: f64,
    },
    /// Both an inertial and box masses.
    #[error("give either `inertial` or box masses, not both")]
    MassTwice,
}

impl Problem {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        Some(match self {
            Self::UnknownRobot { known, .. } => {
                format!("name one of {}, or the path of a robot file", known.join(", "))
            }
            Self::Document(problem) => return problem.next(),
            _ => return None,
        })
    }
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
    /// A link of the family has zero length.
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

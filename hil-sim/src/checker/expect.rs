//! What must hold in a run, and which checker sees to it.

use protocol::Duration;

/// Names of the checkers, as in `trips`.
pub const CHECKS: [(&str, Check); 5] = [
    ("answers", Check::Answers),
    ("limits", Check::Limits),
    ("homing", Check::Homing),
    ("stop", Check::Stop),
    ("traffic", Check::Traffic),
];

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Check {
    /// Requests and answers match, in time.
    Answers,
    /// Commands stay within the limits of the robot.
    Limits,
    /// No motion before the reference is known.
    Homing,
    /// After a stop the axis rests within time.
    Stop,
    /// Frames and utilisation as expected.
    Traffic,
}

impl Check {
    /// Name as in scenario files.
    pub fn name(self) -> &'static str {
        CHECKS.iter().find(|(_, check)| *check == self).map_or("", |(name, _)| *name)
    }
}

/// Conditions to check. A checker that is not listed does not run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Expect {
    /// Every request is answered in this time, and every answer belongs to a request.
    pub answers_within: Option<Duration>,
    /// Targets, velocities and accelerations stay within the robot's limits.
    pub limits: bool,
    /// No motion command before the module has reported its reference.
    pub homing: bool,
    /// After a halt, reported positions rest after this time.
    pub stop_within: Option<Duration>,
    /// Least number of frames.
    pub frames_min: Option<u64>,
    /// Most of the bus's time that may be taken, 0 to 1.
    pub utilisation_max: Option<f64>,
    /// Checks that must break: a scenario that shows a fault is wrong if nothing notices.
    pub trips: Vec<Check>,
}

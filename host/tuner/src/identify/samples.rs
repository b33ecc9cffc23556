//! The samples that an experiment brings.

use super::current::SpeedSample;
use super::lag::StepSample;
use super::poses::Sweep;

/// Readings averaged for a holding current.
pub const HOLD_READINGS: usize = 300;

/// Steady speeds with their mean load.
#[derive(Clone, Debug, PartialEq)]
pub struct Speeds {
    /// One per run.
    pub samples: Vec<SpeedSample>,
    /// Fastest ordered speed, rad/s.
    pub top_rad_s: f64,
    /// Stretch over which the currents were averaged.
    pub stretch: Sweep,
}

/// Answers to steps of acceleration.
#[derive(Clone, Debug, PartialEq)]
pub struct Steps {
    /// All steps laid over each other, upwards.
    pub samples: Vec<StepSample>,
    /// Acceleration commanded, rad/s2.
    pub acceleration_rad_s2: f64,
    /// From the end of a question to the begin of its answer, s.
    pub answers_s: Vec<f64>,
}

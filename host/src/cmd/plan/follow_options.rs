//! Options of throws that follow the flight of the ball.

use planner::follow::limits::{AXES, Arm, LimitSource};

use super::options::FormName;
use crate::cmd::values::numbers;
use crate::error::ExpectedError;

#[derive(Debug, Clone, clap::Args, serde::Deserialize)]
#[command(next_help_heading = "Following the flight (industrial robots, or --follow)")]
pub struct FollowOptions {
    /// Follow the flight of the ball while the gripper opens, with any six-joint arm [industrial robots: always].
    #[arg(long, help_heading = "Throws that follow the flight")]
    pub follow: bool,
    /// Throw in the ordinary way, with the release at one instant, also with an industrial robot.
    #[arg(long, conflicts_with = "follow", help_heading = "Throws that follow the flight")]
    pub no_follow: bool,
    /// First-order lag of the controller in ms: the commands lead by it, and are what is limited.
    #[arg(long, value_name = "MS", help_heading = "Throws that follow the flight")]
    pub lag_ms: Option<f64>,
    /// Time between two set points in ms: the cycle of the robot's controller [default: 12].
    #[arg(long, alias = "period", value_name = "MS", help_heading = "Throws that follow the flight")]
    pub period_ms: Option<f64>,
    /// How far the hand may turn away from being across the flight, in degrees [best: 0].
    #[arg(long, value_name = "DEG", help_heading = "Throws that follow the flight")]
    pub tilt_max_deg: Option<f64>,
    /// Acceleration of the ramps in deg/s2 [default: that of the robot file].
    #[arg(long, value_name = "DEG_S2", help_heading = "Throws that follow the flight")]
    pub ramps_deg_s2: Option<f64>,
    /// Limits of acceleration and jerk [industrial robots and the paper form: controller, others: robot-file].
    #[arg(long, value_enum, help_heading = "Throws that follow the flight")]
    pub limits: Option<LimitsName>,
    /// Resolution of the grid of the paper form; the time grows with its fifth power [default: 1.3].
    #[arg(long, help_heading = "Throws that follow the flight")]
    pub resolution: Option<f64>,
    /// How often the paper form halves the steps of its grid around the best releases [default: 5 for points, 0 for j2].
    #[arg(long, value_name = "TIMES", help_heading = "Throws that follow the flight")]
    pub refine: Option<u32>,
    /// Timing of the ramps in the paper form.
    #[arg(long, value_enum, help_heading = "Throws that follow the flight")]
    pub ramps: Option<RampsName>,
    /// What the paper form makes best.
    #[arg(long, value_enum, help_heading = "Throws that follow the flight")]
    pub criterion: Option<CriterionName>,
    /// Diagonal of W in the first criterion.
    #[arg(long, value_name = "W1,...,W6", value_parser = numbers::<AXES>, help_heading = "Throws that follow the flight")]
    pub weights_w: Option<[f64; AXES]>,
    /// Diagonal of G in the second criterion.
    #[arg(long, value_name = "G1,G2", value_parser = numbers::<2>, help_heading = "Throws that follow the flight")]
    pub weights_g: Option<[f64; 2]>,
}

/// Name of a source of limits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LimitsName {
    /// Following acceleration of the robot file, at most 2000 deg/s2; jerk of the simulated controller, 150 000 deg/s3.
    Controller,
    /// Accelerations and jerk of the robot file.
    RobotFile,
}

/// Name of the timing of ramps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RampsName {
    /// All axes start and stop together.
    Synchronised,
    /// Every axis takes its own shortest time.
    Own,
}

/// Name of a criterion.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CriterionName {
    /// The smallest j2.
    J2,
    /// The most followed points.
    Points,
}

/// Longest lag that is a lag and not a mistake, in ms.
const LAG_MAX_MS: f64 = 200.0;
/// Halvings of the grid of the paper form where it is to follow the most points, and the most that can be asked for.
pub(crate) const REFINEMENTS: u32 = 5;
const REFINEMENTS_MAX: u32 = 12;

impl FollowOptions {
    /// Whether throws of this arm follow the flight: asked for, or an industrial robot for which nobody asks otherwise.
    pub fn apply_to(&self, arm: &Arm) -> bool {
        self.follow || (is_industrial(arm) && !self.no_follow)
    }

    /// The ramps of the paper begin and end with a leap, which the jerk of no robot file allows.
    pub(super) fn limit_source(&self, arm: &Arm, form: FormName) -> LimitSource {
        match self.limits {
            Some(LimitsName::Controller) => LimitSource::ControllerModel,
            Some(LimitsName::RobotFile) => LimitSource::RobotFile,
            None if is_industrial(arm) || form == FormName::Paper => LimitSource::ControllerModel,
            None => LimitSource::RobotFile,
        }
    }

    pub(super) fn checked(&self) -> Result<(), ExpectedError> {
        let within = |name: &str, value: Option<f64>, least: f64, most: f64| match value {
            Some(v) if !(least..=most).contains(&v) => {
                Err(ExpectedError::bad_input(&format!("{name} {v} is outside {least} to {most}")))
            }
            _ => Ok(()),
        };
        within("--lag-ms", self.lag_ms, 0.0, LAG_MAX_MS)?;
        within("--period-ms", self.period_ms, 1.0, 50.0)?;
        within("--tilt-max-deg", self.tilt_max_deg, 0.0, 60.0)?;
        within("--ramps-deg-s2", self.ramps_deg_s2, 1.0, 5000.0)?;
        within("--resolution", self.resolution, 0.2, 4.0)?;
        if let Some(refine) = self.refine.filter(|times| *times > REFINEMENTS_MAX) {
            return Err(ExpectedError::bad_input(&format!("--refine {refine} is above {REFINEMENTS_MAX}")));
        }
        let weights = self.weights_w.iter().flatten().chain(self.weights_g.iter().flatten());
        if let Some(w) = weights.into_iter().find(|w| !(**w >= 0.0 && w.is_finite())) {
            return Err(ExpectedError::bad_input(&format!("weight {w} is not zero or positive")));
        }
        Ok(())
    }
}

/// Whether the arm's own controller closes its loops (no drive modules) and its file has limits for following.
pub(crate) fn is_industrial(arm: &Arm) -> bool {
    arm.drives().is_none() && arm.joints().iter().any(|j| j.limits.a_follow_max_rad_s2.is_some())
}

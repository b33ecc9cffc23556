//! The request: form, goal, bounds, margins and limits of a throw, as plain data.

use std::ops::RangeInclusive;

use nalgebra::Vector3;
use robot_model::Pose;

use super::release_delays::ReleaseNodes;
use crate::flight::Course;

/// Which throws are allowed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Form {
    /// The paper's: the hand turns only about the throw, the joints do not accelerate at the release, currents are
    /// checked at the release, and the ball may be met by the hand again later.
    Paper,
    /// The best form: free spin of the hand, joint acceleration at the release such that a late gripper does not
    /// move the landing, currents over the whole motion, a clean release, and acceleration kept back for the
    /// controller.
    Best,
}

/// Weights of the objective (1): `J = k_t H_s + k_b d_r + k_j Σ ∫ q⃛² dt`.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize, schemars::JsonSchema)]
pub struct Weights {
    /// Per second of movement.
    pub k_t: f64,
    /// For the ratio of braking to the whole movement.
    pub k_b: f64,
    /// For the integral of squared jerk.
    pub k_j: f64,
}

impl Default for Weights {
    /// The paper's: 15, 20, 0.01.
    fn default() -> Self {
        Self { k_t: 15.0, k_b: 20.0, k_j: 0.01 }
    }
}

/// A box that the arm and the ball must not touch.
#[derive(Debug, Clone, PartialEq)]
pub struct Obstacle {
    /// Name for messages.
    pub name: String,
    /// Centre and axes in the world.
    pub x_wo: Pose,
    /// Half edge lengths in m.
    pub half_m: Vector3<f64>,
}

/// A range of arrival speeds or directions.
#[derive(Debug, Clone, PartialEq)]
pub struct Arrival {
    /// Speed at the target in m/s.
    pub speed_m_s: Option<RangeInclusive<f64>>,
    /// Steepness at the target in rad below the horizontal: π/2 is straight down.
    pub descent_rad: Option<RangeInclusive<f64>>,
}

/// A limit of the landing's shift for a release that is late or early.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DelayWindow {
    /// Delay, and equally advance, of the release in s.
    pub delay_s: f64,
    /// Largest shift of the landing in m.
    pub shift_m: f64,
}

/// Reserve of a plan in a [`DelayWindow`], in m: more than rounding moves the landing of a late release compared
/// with one on time. A controller has the knots of a plan in steps of 1 µs and in binary32, and a cubic between two
/// of them. A phase of h seconds that is ε shorter changes the acceleration at the release by the share ε/h, and
/// with it the shift by `δ F e ε / h`: 0.5 µm for a delay δ of 25 ms, a flight F of 0.8 s, 15 m/s² at the hand, and
/// 0.5 µs of 0.3 s. An angle of up to 4 rad has an error of 1.2e-7 rad, which changes the acceleration by `6 ·
/// 1.2e-7 / h²` and the shift, at 1 m, by 0.2 µm; 6 µm in the shortest phases of 0.05 s. Measured over the 1340
/// throws of the benchmark that keep the limits: at most 2.2 µm. The planner's tolerance is 1e-9 m. Two
/// integrations of a flight with drag were not compared.
pub const WINDOW_ROUNDING_M: f64 = 1e-5;

/// Clearance in m that the released ball keeps from the hand that threw it. The ball comes out of the hand, so 5 mm
/// are not possible; without any clearance, a tracking error of 0.2 mrad lets the ball touch the fingers.
pub const HAND_CLEARANCE_M: f64 = 2e-4;

/// What to plan besides the target.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// Which throws are allowed.
    pub form: Form,
    /// What the search makes small.
    pub goal: Goal,
    /// Weights of the paper's objective (1).
    pub weights: Weights,
    /// Bounds of the search space that replace those of the form and the robot.
    pub bounds: AskedBounds,
    /// Part of the speed limit a plan may use, in (0, 1].
    pub speed_use: f64,
    /// Part of the acceleration limit a plan may use, in (0, 1].
    pub acceleration_use: f64,
    /// Distance kept from both ends of every joint range, in rad.
    pub range_margin_rad: f64,
    /// Whether the hand may only turn about the throw (8 parameters) or freely (10).
    pub free_spin: bool,
    /// Whether the landing must not move, to first order, when the gripper opens late.
    pub null_delay: bool,
    /// How far the landing may move when the gripper opens late or early; needs `null_delay`, at most four.
    pub delay_windows: Vec<DelayWindow>,
    /// Whether currents are limited over the whole motion instead of at the release only.
    pub current_over_motion: bool,
    /// Whether arm and surroundings must stay clear of each other.
    pub avoid_collisions: bool,
    /// Whether the ball must stay clear of arm and obstacles after the release.
    pub clean_release: bool,
    /// True if a ball that touches the arm after the release may be thrown all the same: it must be requested.
    pub touch_allowed: bool,
    /// Clearance of arm, base, floor, obstacles and ball in m; from the hand that threw it the ball keeps [`HAND_CLEARANCE_M`].
    pub clearance_m: f64,
    /// Drag of the ball in 1/m; zero is vacuum.
    pub drag_per_m: f64,
    /// True if the landing is also predicted for a ball that leaves between fingers that open, as described in the robot file.
    pub finger_release: bool,
    /// Spin of the ball times its lift constant in 1/s.
    pub magnus_rad_s: Vector3<f64>,
    /// Boxes in the way.
    pub obstacles: Vec<Obstacle>,
    /// Limits at the target.
    pub arrival: Arrival,
    /// An opening with its centre at the target, through which the ball passes; without one it comes down on the target.
    pub opening: Option<Opening>,
    /// How the target moves from the planned release on.
    pub course: Course,
}

impl Options {
    /// The paper's form.
    #[must_use]
    pub fn paper() -> Self {
        Self {
            form: Form::Paper,
            goal: Goal::Effort,
            weights: Weights::default(),
            bounds: AskedBounds::default(),
            speed_use: 1.0,
            acceleration_use: 1.0,
            range_margin_rad: 0.0,
            free_spin: false,
            null_delay: false,
            delay_windows: Vec::new(),
            current_over_motion: false,
            avoid_collisions: true,
            clean_release: false,
            touch_allowed: false,
            clearance_m: 0.0,
            drag_per_m: 0.0,
            finger_release: false,
            magnus_rad_s: Vector3::zeros(),
            obstacles: Vec::new(),
            arrival: Arrival { speed_m_s: None, descent_rad: None },
            opening: None,
            course: Course::default(),
        }
    }

    /// The best form.
    ///
    /// 80 % of the acceleration: the controller needs the rest, and it may command a little less than the planner's
    /// table allows (eq. (11) of the paper). 98 % of the speed: arms whose masses and friction differ from the
    /// model overshoot it by up to 1.2 %. 0.02 rad to the ends of the ranges: tracking errors reach 17 mrad
    /// (robot-models 1.10), and a drive stops at the end of its range. 5 mm between bodies: the cheapest throws
    /// pass as near as they may, and neither the boxes nor a tracked motion are as exact as the plan.
    #[must_use]
    pub fn best() -> Self {
        Self {
            form: Form::Best,
            speed_use: 0.98,
            acceleration_use: 0.8,
            range_margin_rad: 0.02,
            free_spin: true,
            null_delay: true,
            delay_windows: vec![
                DelayWindow { delay_s: 0.010, shift_m: 0.002 },
                DelayWindow { delay_s: 0.025, shift_m: 0.010 },
            ],
            current_over_motion: true,
            clean_release: true,
            clearance_m: 0.005,
            ..Self::paper()
        }
    }

    /// The options of a form.
    #[must_use]
    pub fn of(form: Form) -> Self {
        match form {
            Form::Paper => Self::paper(),
            Form::Best => Self::best(),
        }
    }
}

/// Requested bounds; `None` leaves a bound to the form and the robot.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct AskedBounds {
    /// See [`super::bounds::Bounds::azimuth_rad`].
    pub azimuth_rad: Option<RangeInclusive<f64>>,
    /// See [`super::bounds::Bounds::elevation_rad`].
    pub elevation_rad: Option<RangeInclusive<f64>>,
    /// See [`super::bounds::Bounds::radius_m`].
    pub radius_m: Option<RangeInclusive<f64>>,
    /// See [`super::bounds::Bounds::spin_rad_s`].
    pub spin_rad_s: Option<RangeInclusive<f64>>,
    /// See [`super::bounds::Bounds::flight_s`].
    pub flight_s: Option<RangeInclusive<f64>>,
    /// See [`super::bounds::Bounds::duration_s`].
    pub duration_s: Option<RangeInclusive<f64>>,
    /// See [`super::bounds::Bounds::braking_ratio`].
    pub braking_ratio: Option<RangeInclusive<f64>>,
}

/// What a search makes small, under all constraints.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Goal {
    /// The paper's objective (1).
    #[default]
    Effort,
    /// Electrical energy from the supplies; needs current constants and supplies in the robot file.
    Energy,
    /// Root of the mean squared distance of the landing from the target.
    Spread(Noise),
    /// Logarithm of the odds against a hit of the region about the target.
    Miss(Noise, Region),
}

impl Goal {
    /// Noise of the landing; `None` for a goal that does not depend on it.
    #[must_use]
    pub fn noise(&self) -> Option<&Noise> {
        match self {
            Self::Effort | Self::Energy => None,
            Self::Spread(noise) | Self::Miss(noise, _) => Some(noise),
        }
    }
}

/// Standard deviations of what is not exact.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Noise {
    /// Time of the release in s.
    pub release_time_s: f64,
    /// Joint angles at the release in rad, each joint.
    pub position_rad: f64,
    /// Joint speeds at the release in rad/s, each joint.
    pub speed_rad_s: f64,
    /// Drag constant in 1/m; drag is never negative, so what would be counts with its absolute value.
    pub drag_per_m: f64,
    /// Measured release delays instead of a normal distribution; `release_time_s` is then their standard deviation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub release_nodes: Option<ReleaseNodes>,
}

impl Default for Noise {
    /// 2 ms of release jitter; tracking as in robot-models 1.10 (LQR with clipping, 17 ms); drag of a light ball unknown
    /// by 0.005 1/m.
    fn default() -> Self {
        Self {
            release_time_s: 2e-3,
            position_rad: 9e-4,
            speed_rad_s: 0.012,
            drag_per_m: 5e-3,
            release_nodes: None,
        }
    }
}

/// Region that counts as a hit, in the plane of the target.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case", tag = "shape")]
pub enum Region {
    /// Disc about the target.
    Disc {
        /// Radius in m.
        radius_m: f64,
    },
    /// Rectangle about the target with edges along x and y.
    Box {
        /// Half edge along x in m.
        half_x_m: f64,
        /// Half edge along y in m.
        half_y_m: f64,
    },
}

/// An opening at the target: a disc that the ball enters from the side of the normal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Opening {
    /// Direction out of the opening, towards the arm; any length but zero.
    pub normal: Vector3<f64>,
    /// Radius of the disc in m.
    pub radius_m: f64,
    /// Largest angle between the path of the ball and the axis of the opening, in rad, below π/2.
    pub incidence_max_rad: f64,
}

/// Largest angle of incidence that can be requested, in rad: beyond it a ball hardly enters.
pub(crate) const INCIDENCE_MAX_RAD: f64 = 1.4;

/// Most limits of the landing's shift, each for late and for early release.
pub(crate) const DELAY_WINDOWS_MAX: usize = 4;

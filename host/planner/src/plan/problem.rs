//! Statement of one planning problem, validated: what is thrown where, under which limits, and what counts as good.

use std::ops::RangeInclusive;

use nalgebra::Vector3;
use robot_model::{JointVec, RobotModel};

use super::bounds::Bounds;
use super::layout::{Numbers, Variables};
pub use super::options::{Arrival, DelayWindow, Form, Obstacle, Options, Weights};
use super::options::{DELAY_WINDOWS_MAX, Goal, INCIDENCE_MAX_RAD, Region};
use crate::flight::{Aim, FlightModel, FlightModelError};
use crate::throw::Throw;

/// A number for people: without hundreds of digits.
#[must_use]
pub fn short(value: f64) -> String {
    let plain = value == 0.0 || (1e-4..1e7).contains(&value.abs()) || !value.is_finite();
    if plain { value.to_string() } else { format!("{value:.3e}") }
}

/// Cuts keep a little more than the requested clearance, so that the proof of the motion has a margin for its tolerance.
pub(crate) const CLEARANCE_EXTRA_M: f64 = 2e-4;

/// A problem that cannot be stated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ProblemError {
    #[error("target ({}, {}, {}) m is not a point: every coordinate must be a finite number", short(*x), short(*y), short(*z))]
    TargetNotFinite { x: f64, y: f64, z: f64 },
    #[error(
        "target height {} m is below the floor at {floor_m} m: raise the target or move the floor in the robot file",
        short(*z_m)
    )]
    TargetBelowFloor { z_m: f64, floor_m: f64 },
    #[error("target is inside \"{part}\" of the arm's base: choose a target outside")]
    TargetInArm { part: String },
    #[error("target is inside obstacle \"{name}\": move one of the two")]
    TargetInObstacle { name: String },
    #[error("{option} = {} is outside {} to {}", short(*value), short(*min), short(*max))]
    Option { option: &'static str, value: f64, min: f64, max: f64 },
    #[error("range of {option} runs from {} to {}: the lower end must not be above the upper one", short(*min), short(*max))]
    Range { option: &'static str, min: f64, max: f64 },
    #[error(
        "{count} limits of the landing's shift: at most {DELAY_WINDOWS_MAX}, and only together with release-delay nulling"
    )]
    DelayWindows { count: usize },
    #[error("the normal of the opening has no direction: give one number that is not 0, and all finite")]
    OpeningNormal,
    #[error(
        "an opening of {} m radius is too narrow for the ball: {} m and the clearance of {} m on each side",
        short(*radius_m),
        short(*ball_m),
        short(*clearance_m)
    )]
    OpeningNarrow { radius_m: f64, ball_m: f64, clearance_m: f64 },
    #[error(transparent)]
    Flight(#[from] FlightModelError),
    #[error(
        "robot {robot} says nothing about its fingers: give its file a [fingers] table, or leave the finger release out"
    )]
    FingersUnknown { robot: String },
    #[error(
        "the energy of a throw needs k_b and k_m of every drive and a [[supply]] with its voltage; robot \"{robot}\" lacks them: choose another objective or complete the robot file"
    )]
    EnergyUnknown { robot: String },
    #[error(
        "form \"paper\" fixes pose and velocity of the hand, which takes six joints; robot \"{robot}\" has {joints}: use --form best"
    )]
    FormNeedsSixJoints { robot: String, joints: usize },
}

/// A planning problem: arm, target and options, checked.
#[derive(Debug, Clone)]
pub struct Problem<'a> {
    pub(crate) arm: &'a RobotModel,
    /// The same with the ball in the hand; `None` for a ball without mass.
    holding: Option<Box<RobotModel>>,
    pub(crate) target: Vector3<f64>,
    /// The target with its plane and its way.
    pub(crate) aim: Aim,
    pub(crate) options: Options,
    pub(crate) flight: FlightModel,
    /// Centre of the paper's spherical coordinates: where axis 2 passes axis 1.
    pub(crate) shoulder: Vector3<f64>,
    pub(crate) bounds: Bounds,
    pub(crate) limits: Limits,
    /// Share of the limits of the landing's shift that a throw may use.
    pub(crate) window_share: f64,
}

/// Limits as the solver uses them: rates scaled by the share a plan may use.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Limits {
    pub(crate) q_min: JointVec,
    pub(crate) q_max: JointVec,
    pub(crate) v: JointVec,
    pub(crate) a: JointVec,
    pub(crate) j: JointVec,
}

impl<'a> Problem<'a> {
    /// The arm before the release, with the ball in its hand.
    pub(crate) fn holding(&self) -> &RobotModel {
        self.holding.as_deref().unwrap_or(self.arm)
    }

    /// The arm as its dynamics are at phase `sigma` of a throw: the ball is in the hand up to the release at 0.
    pub(crate) fn arm_at(&self, sigma: f64) -> &RobotModel {
        if sigma <= 0.0 { self.holding() } else { self.arm }
    }

    /// States and checks a problem; `target` in m, world.
    ///
    /// # Errors
    /// [`ProblemError`] names what is wrong; a target that is merely out of reach is not an error here.
    pub fn new(arm: &'a RobotModel, target: Vector3<f64>, options: Options) -> Result<Self, ProblemError> {
        if !target.iter().all(|c| c.is_finite()) {
            return Err(ProblemError::TargetNotFinite { x: target.x, y: target.y, z: target.z });
        }
        if let Some(value) = target.iter().copied().find(|c| c.abs() > FAR) {
            let option = "coordinate of the target in m";
            return Err(ProblemError::Option { option, value, min: -FAR, max: FAR });
        }
        let floor_m = arm.world().floor_z_m;
        if target.z < floor_m - 1e-9 {
            return Err(ProblemError::TargetBelowFloor { z_m: target.z, floor_m });
        }
        for part in arm.collision().boxes().iter().filter(|b| b.link == 0) {
            let p = part.x_lb.inverse_transform_point(&target);
            if p.iter().zip(part.half_m.iter()).all(|(c, h)| c.abs() < *h) {
                return Err(ProblemError::TargetInArm { part: part.name.clone() });
            }
        }
        check_options(&options)?;
        for obstacle in &options.obstacles {
            let p = obstacle.x_wo.inverse_transform_point(&target);
            if p.iter().zip(obstacle.half_m.iter()).all(|(c, h)| c.abs() < *h) {
                return Err(ProblemError::TargetInObstacle { name: obstacle.name.clone() });
            }
        }
        let ball_m = arm.gripper().ball_radius_m;
        let aim = aim_of(&target, &options, ball_m)?;
        if arm.n() < 6 && !options.free_spin {
            return Err(ProblemError::FormNeedsSixJoints { robot: arm.name().to_owned(), joints: arm.n() });
        }
        let flight = FlightModel::vacuum(arm.world().gravity_m_s2)?
            .with_drag(options.drag_per_m)?
            .with_magnus(options.magnus_rad_s)?;
        let frames = arm.fk(&JointVec::zeros(arm.n()));
        let (axis, base, second) = (frames.axis(0), frames.origin(0), frames.origin(1));
        let shoulder = base + axis * axis.dot(&(second - base));
        let bounds = Bounds::of(options.form, arm, &shoulder).with(&options.bounds);
        check_bounds(&bounds)?;
        let of = |pick: fn(&robot_model::JointLimits) -> f64| arm.limit(pick);
        let mut limits = Limits {
            q_min: of(|l| l.q_min_rad),
            q_max: of(|l| l.q_max_rad),
            v: of(|l| l.v_max_rad_s),
            a: of(|l| l.a_max_rad_s2),
            j: of(|l| l.j_max_rad_s3),
        };
        limits.v *= options.speed_use;
        limits.a *= options.acceleration_use;
        for (min, max) in limits.q_min.iter_mut().zip(limits.q_max.iter_mut()) {
            // A range too narrow for the margin keeps its middle.
            let margin = options.range_margin_rad.min(0.5 * (*max - *min));
            *min += margin;
            *max -= margin;
        }
        let holding = arm.holding_ball().map(Box::new);
        let problem =
            Self { arm, holding, target, aim, options, flight, shoulder, bounds, limits, window_share: 1.0 };
        if problem.options.finger_release && arm.fingers().is_none() {
            return Err(ProblemError::FingersUnknown { robot: arm.name().to_owned() });
        }
        if problem.options.goal == Goal::Energy && !problem.has_energy() {
            return Err(ProblemError::EnergyUnknown { robot: arm.name().to_owned() });
        }
        Ok(problem)
    }

    /// Number of joints.
    #[inline]
    pub(crate) fn joints(&self) -> usize {
        self.arm.n()
    }

    /// Where the variables of a throw stand.
    #[inline]
    pub(crate) fn variables(&self) -> Variables {
        Variables::of(self.joints())
    }

    /// Where the inequalities of a throw stand.
    #[inline]
    pub(crate) fn numbers(&self) -> Numbers {
        Numbers::of(self.joints())
    }

    /// Whether the robot file says what the energy of a throw is: current constants and supplies.
    fn has_energy(&self) -> bool {
        self.arm.drives().is_some() && !self.arm.supplies().is_empty()
    }

    #[must_use]
    pub fn arm(&self) -> &'a RobotModel {
        self.arm
    }

    /// The target in m.
    #[must_use]
    pub fn target(&self) -> &Vector3<f64> {
        &self.target
    }

    /// The target with the plane in which misses are measured, and how it moves.
    #[must_use]
    pub fn aim(&self) -> &Aim {
        &self.aim
    }

    /// Distance that the centre of the ball keeps from the rim of an opening, in m.
    pub(crate) fn rim_clearance_m(&self) -> f64 {
        self.arm.gripper().ball_radius_m + self.options.clearance_m + CLEARANCE_EXTRA_M
    }

    #[must_use]
    pub fn options(&self) -> &Options {
        &self.options
    }

    /// Forces on the ball.
    #[must_use]
    pub fn flight(&self) -> &FlightModel {
        &self.flight
    }

    /// Objective (1) of a throw, as its three terms: time, braking ratio, jerk.
    #[must_use]
    pub(crate) fn objective_terms(&self, throw: &Throw) -> [f64; 3] {
        let w = &self.options.weights;
        let (ja, jb) = throw.jerk();
        let jerk = ja.norm_squared() * throw.ha_s + jb.norm_squared() * throw.hb_s;
        [w.k_t * throw.duration_s(), w.k_b * throw.braking_ratio(), w.k_j * jerk]
    }

    /// Objective (1) of a throw.
    #[must_use]
    pub fn objective(&self, throw: &Throw) -> f64 {
        self.objective_terms(throw).iter().sum()
    }
}

/// The target with its plane and its way.
fn aim_of(target: &Vector3<f64>, options: &Options, ball_m: f64) -> Result<Aim, ProblemError> {
    for (k, c) in options.course.coefficients_m().iter().enumerate() {
        let option =
            if k == 0 { "velocity of the target in m/s" } else { "coefficient of the target's course" };
        if let Some(value) = c.iter().copied().find(|c| c.abs() > COURSE_COEFFICIENT_MAX) {
            let max = COURSE_COEFFICIENT_MAX;
            return Err(ProblemError::Option { option, value, min: -max, max });
        }
    }
    let Some(opening) = &options.opening else {
        return Ok(Aim::new(*target, &Vector3::z(), options.course));
    };
    let long = opening.normal.norm();
    if !(long > 1e-9 && long.is_finite()) {
        return Err(ProblemError::OpeningNormal);
    }
    let scalar = |option, value: f64, min: f64, max: f64| {
        if value >= min && value <= max {
            Ok(())
        } else {
            Err(ProblemError::Option { option, value, min, max })
        }
    };
    scalar("radius of the opening in m", opening.radius_m, 1e-3, 10.0)?;
    scalar("largest angle of incidence in rad", opening.incidence_max_rad, 0.0, INCIDENCE_MAX_RAD)?;
    let clearance_m = options.clearance_m;
    if opening.radius_m <= ball_m + clearance_m + CLEARANCE_EXTRA_M {
        return Err(ProblemError::OpeningNarrow { radius_m: opening.radius_m, ball_m, clearance_m });
    }
    Ok(Aim::new(*target, &opening.normal, options.course))
}

/// No target of a throw is faster, in m/s, m/s², …
const COURSE_COEFFICIENT_MAX: f64 = 20.0;

fn check_goal(goal: &Goal) -> Result<(), ProblemError> {
    let scalar = |option, value: f64, min: f64, max: f64| {
        if value >= min && value <= max {
            Ok(())
        } else {
            Err(ProblemError::Option { option, value, min, max })
        }
    };
    if let Some(noise) = goal.noise() {
        scalar("standard deviation of the release time in s", noise.release_time_s, 0.0, 0.05)?;
        scalar("standard deviation of the joint angles in rad", noise.position_rad, 0.0, 0.1)?;
        scalar("standard deviation of the joint speeds in rad/s", noise.speed_rad_s, 0.0, 1.0)?;
        scalar("standard deviation of the drag in 1/m", noise.drag_per_m, 0.0, 1.0)?;
    }
    if let Goal::Miss(_, region) = goal {
        let sizes = match *region {
            Region::Disc { radius_m } => [radius_m; 2],
            Region::Box { half_x_m, half_y_m } => [half_x_m, half_y_m],
        };
        for size in sizes {
            scalar("size of the hit region in m", size, 1e-4, 100.0)?;
        }
    }
    Ok(())
}

fn range(option: &'static str, r: &RangeInclusive<f64>, least: f64, most: f64) -> Result<(), ProblemError> {
    let (min, max) = (*r.start(), *r.end());
    if min <= max && min >= least && max <= most {
        Ok(())
    } else if min <= max {
        let value = if min < least { min } else { max };
        Err(ProblemError::Option { option, value, min: least, max: most })
    } else {
        Err(ProblemError::Range { option, min, max })
    }
}

/// No length, time or speed of an arm is as large.
const FAR: f64 = 1e6;
/// Thinner boxes are no obstacles.
const HALF_EDGE_MIN_M: f64 = 1e-6;
/// Twice the drag of a toy balloon; lighter balls are not thrown.
const DRAG_MAX_PER_M: f64 = 10.0;
/// Turns the velocity once in 60 ms.
const MAGNUS_MAX_1_S: f64 = 100.0;

fn check_bounds(b: &Bounds) -> Result<(), ProblemError> {
    if let Some(r) = &b.azimuth_rad {
        range("the release azimuth", r, -FAR, FAR)?;
    }
    range("the release elevation", &b.elevation_rad, -FAR, FAR)?;
    range("the release radius", &b.radius_m, 0.0, FAR)?;
    range("the spin", &b.spin_rad_s, -FAR, FAR)?;
    range("the time of flight", &b.flight_s, 1e-3, FAR)?;
    range("the duration", &b.duration_s, 1e-2, FAR)?;
    range("the braking ratio", &b.braking_ratio, 1e-3, 0.999)
}

fn check_options(o: &Options) -> Result<(), ProblemError> {
    let scalar = |option, value: f64, min: f64, max: f64| {
        if value >= min && value <= max {
            Ok(())
        } else {
            Err(ProblemError::Option { option, value, min, max })
        }
    };
    scalar("speed use", o.speed_use, 0.01, 1.0)?;
    scalar("acceleration use", o.acceleration_use, 0.01, 1.0)?;
    scalar("clearance in m", o.clearance_m, 0.0, 1.0)?;
    scalar("drag of the ball in 1/m", o.drag_per_m, 0.0, DRAG_MAX_PER_M)?;
    for m in &o.magnus_rad_s {
        scalar("Magnus vector in 1/s", *m, -MAGNUS_MAX_1_S, MAGNUS_MAX_1_S)?;
    }
    scalar("range margin in rad", o.range_margin_rad, 0.0, 1.0)?;
    scalar("weight of time", o.weights.k_t, 0.0, 1e6)?;
    scalar("weight of the braking ratio", o.weights.k_b, 0.0, 1e6)?;
    scalar("weight of jerk", o.weights.k_j, 0.0, 1e6)?;
    if o.delay_windows.len() > DELAY_WINDOWS_MAX || !o.null_delay && !o.delay_windows.is_empty() {
        return Err(ProblemError::DelayWindows { count: o.delay_windows.len() });
    }
    for window in &o.delay_windows {
        scalar("delay of a shift limit in s", window.delay_s, 1e-3, 0.1)?;
        scalar("shift limit in m", window.shift_m, 5e-4, 1.0)?;
    }
    check_goal(&o.goal)?;
    if let Some(r) = &o.arrival.speed_m_s {
        range("the arrival speed", r, 0.0, FAR)?;
    }
    if let Some(r) = &o.arrival.descent_rad {
        range("the arrival steepness", r, -std::f64::consts::FRAC_PI_2, std::f64::consts::FRAC_PI_2)?;
    }
    for obstacle in &o.obstacles {
        for c in &obstacle.x_wo.pos {
            scalar("coordinate of an obstacle in m", *c, -FAR, FAR)?;
        }
        for h in &obstacle.half_m {
            scalar("half edge length of an obstacle in m", *h, HALF_EDGE_MIN_M, FAR)?;
        }
    }
    Ok(())
}

//! Motion of all joints, and the check of a whole motion.

use nalgebra::Vector3;
use robot_model::collision::{CollisionChecker, Obb};

use super::Joints;
use super::arm::CatchArm;
use super::forecast::Forecast;
use crate::motion_law::{Limits, Pieces, State};

/// Time between two postures that are checked for contact and currents, s. At the arm's largest speeds the hand moves 5 cm in it;
/// the boxes are checked with the ball's radius of room.
const CHECK_STEP_S: f64 = 0.016;
/// The ball is kept clear of the arm over this time before the catch, s.
const BALL_CLEAR_S: f64 = 0.5;
/// Room between the ball and the links or the wall of the cup before the catch, m.
const BALL_ROOM_M: f64 = 0.005;
/// In this last time before the catch the cup is looked at in smaller steps, s: the ball passes its rim, and between 16 ms a ball
/// that is 2 m/s faster than the hand would jump over the wall.
const RIM_S: f64 = 0.12;
const RIM_STEP_S: f64 = 0.004;
/// The ball is before the plane of the mouth until the catch, up to this, m.
const EARLY_MAX_M: f64 = 0.005;

/// Least height of the cup's axis, a unit vector, where the hand stops after a catch: 10 degrees above the horizon. From a cup that
/// looks lower the ball rolls out.
const AXIS_UP_MIN: f64 = 0.17;

/// A motion: every joint to its end at rest.
#[derive(Debug, Clone, PartialEq)]
pub struct CatchMotion {
    /// When it begins, s.
    pub start_s: f64,
    pub joints: [Pieces; 6],
}

impl CatchMotion {
    /// Standing still.
    #[must_use]
    pub fn rest(q: &Joints) -> Self {
        Self { start_s: 0.0, joints: std::array::from_fn(|i| Pieces::starting(State::rest(q[i]))) }
    }

    /// State of each joint at a time; at rest after the end.
    #[must_use]
    pub fn at(&self, t_s: f64) -> [State; 6] {
        std::array::from_fn(|i| self.joints[i].at(t_s - self.start_s))
    }

    /// Angles and speeds at a time.
    #[must_use]
    pub fn joints_at(&self, t_s: f64) -> (Joints, Joints) {
        let at = self.at(t_s);
        (Joints::from_fn(6, |i| at[i].q), Joints::from_fn(6, |i| at[i].v))
    }

    /// When all joints stand, s.
    #[must_use]
    pub fn end_s(&self) -> f64 {
        self.start_s + self.joints.iter().map(Pieces::duration_s).fold(0.0, f64::max)
    }
}

/// What a motion is not allowed to do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// A joint leaves its range.
    Range,
    /// A joint passes a limit of speed, acceleration or, where it is limited, jerk.
    Limit,
    /// The cup looks down where the hand stops after the catch.
    CupDown,
    /// The arm touches itself, the floor or the other arm.
    Contact,
    /// The ball touches the arm before it is at the cup.
    Ball,
    /// A motor or a supply gives more than its current.
    Current,
}

/// By how much the cup's axis, a unit vector, is too low at `q` for a ball to stay in the cup; zero or less if it stays.
pub(super) fn looks_down(arm: &CatchArm, q: &Joints) -> f64 {
    AXIS_UP_MIN - arm.mouth(q, &Joints::zeros(6)).1.z
}

/// Looks at a whole motion: ranges, speeds, accelerations and jerks exactly, contacts and currents every 16 ms; `ball` is the
/// flight and the time of the catch.
///
/// # Errors
/// The first thing that the motion must not do.
pub fn check(
    arm: &CatchArm,
    checker: &mut CollisionChecker<'_>,
    motion: &CatchMotion,
    ball: Option<(&Forecast, f64)>,
) -> Result<(), Fault> {
    for (pieces, limits) in motion.joints.iter().zip(arm.limits(true)) {
        let (low, high) = pieces.extremes();
        let inside = low >= limits.q_rad.0 - 1e-9 && high <= limits.q_rad.1 + 1e-9;
        if !inside {
            return Err(Fault::Range);
        }
    }
    let [speed, acceleration, jerk] = used(arm, motion);
    let jerk = if arm.law.limits_jerk() { jerk } else { 0.0 };
    let keeps = speed <= 1.0 && acceleration <= 1.0 && jerk <= 1.0;
    if !keeps {
        return Err(Fault::Limit);
    }
    if let Some((forecast, catch_s)) = ball {
        if looks_down(arm, &motion.joints_at(motion.end_s()).0) > 0.0 {
            return Err(Fault::CupDown);
        }
        if meets_cup_early(arm, motion, forecast, catch_s) {
            return Err(Fault::Ball);
        }
    }
    let steps = ((motion.end_s() - motion.start_s) / CHECK_STEP_S).ceil() as usize;
    for k in 0..=steps {
        let t_s = (motion.start_s + CHECK_STEP_S * k as f64).min(motion.end_s());
        let at = motion.at(t_s);
        let (q, qd) = (Joints::from_fn(6, |i| at[i].q), Joints::from_fn(6, |i| at[i].v));
        let frames = arm.model.fk(&q);
        if checker.collides(&frames) {
            return Err(Fault::Contact);
        }
        let qdd = Joints::from_fn(6, |i| at[i].a);
        if !currents_keep(arm, &q, &qd, &qdd) {
            return Err(Fault::Current);
        }
        if let Some((forecast, catch_s)) = ball
            && t_s < catch_s - 1e-3
            && t_s > catch_s - BALL_CLEAR_S
            && let Some(ball) = forecast.at(t_s)
        {
            let p_b = arm.x_wb.inverse_transform_point(&ball.p_m);
            let room = arm.ball_radius_m() + BALL_ROOM_M;
            let boxes = checker.placed_boxes();
            let near = |b: &Obb| (b.nearest_point(&p_b) - p_b).norm() < room;
            // The cup is the last box; it is looked at by itself.
            if boxes.split_last().is_some_and(|(_, links)| links.iter().any(near)) {
                return Err(Fault::Ball);
            }
        }
    }
    Ok(())
}

/// Whether the ball touches the wall of the cup, or is inside, before the catch.
fn meets_cup_early(arm: &CatchArm, motion: &CatchMotion, forecast: &Forecast, catch_s: f64) -> bool {
    let mut t_s = motion.start_s.max(catch_s - BALL_CLEAR_S);
    while t_s < catch_s - 1e-3 {
        if let Some(ball) = forecast.at(t_s) {
            let q = motion.joints_at(t_s).0;
            let frames = arm.model.fk(&q);
            let x_be = arm.model.ee(&frames);
            let p_e = x_be.inverse_transform_point(&arm.x_wb.inverse_transform_point(&ball.p_m));
            let at_mouth = p_e - Vector3::z() * arm.cup.mouth_m;
            let inner_m = arm.cup.inner_radius_m;
            let inside = at_mouth.z < -EARLY_MAX_M
                && at_mouth.z > -arm.cup.length_m()
                && at_mouth.x.hypot(at_mouth.y) < inner_m;
            if inside || wall_distance_m(arm, &at_mouth) < arm.ball_radius_m() + BALL_ROOM_M {
                return true;
            }
        }
        t_s += if t_s < catch_s - RIM_S { CHECK_STEP_S } else { RIM_STEP_S };
    }
    false
}

/// Distance of a point from the wall and the bottom of the cup, m; the point is given from the middle of the mouth, z along the
/// cup's axis.
fn wall_distance_m(arm: &CatchArm, at_mouth: &Vector3<f64>) -> f64 {
    let (inner_m, outer_m) = (arm.cup.inner_radius_m, arm.cup.outer_radius_m());
    let r = at_mouth.x.hypot(at_mouth.y);
    if at_mouth.z < -arm.cup.length_m() {
        return (r - outer_m).max(0.0).hypot(at_mouth.z + arm.cup.length_m());
    }
    (inner_m - r).max(r - outer_m).max(0.0).hypot(at_mouth.z.max(0.0))
}

/// Whether motors and supplies give the currents of a state.
#[must_use]
pub(crate) fn currents_keep(arm: &CatchArm, q: &Joints, qd: &Joints, qdd: &Joints) -> bool {
    let model = &arm.model;
    let tau = model.inverse_dynamics(q, qd, qdd);
    let (Some(drives), Some(motor_a)) = (model.drives(), model.motor_currents(qd, &tau)) else {
        return false;
    };
    let motors =
        drives.iter().zip(motor_a.iter()).all(|(d, a)| a.abs() <= d.current_max_a * arm.shares.current);
    let supplies = model.supplies().iter().zip(model.supply_currents(&motor_a));
    motors && supplies.into_iter().all(|(s, a)| a <= s.current_max_a * arm.shares.current)
}

/// Appends a stop to each joint.
pub(super) fn stopped(arm: &CatchArm, limits: &[Limits; 6], joints: &mut [Pieces; 6]) {
    for (pieces, limits) in joints.iter_mut().zip(limits) {
        arm.law.append_stop(limits, pieces);
    }
}

/// Largest use of speed, acceleration and jerk limits of the robot file over a motion, each as a share; 1 is the limit.
#[must_use]
pub fn used(arm: &CatchArm, motion: &CatchMotion) -> [f64; 3] {
    let mut used = [0.0_f64; 3];
    for (joint, pieces) in arm.model.joints().iter().zip(&motion.joints) {
        let l = &joint.limits;
        for (h, from, jerk) in pieces.iter() {
            let end_a = from.a + h * jerk;
            let inside = -from.a / jerk;
            let mut v = from.v.abs().max((from.v + h * (from.a + 0.5 * h * jerk)).abs());
            if inside > 0.0 && inside < h {
                v = v.max((from.v + inside * (from.a + 0.5 * inside * jerk)).abs());
            }
            used[0] = used[0].max(v / l.v_max_rad_s);
            used[1] = used[1].max(from.a.abs().max(end_a.abs()) / l.a_max_rad_s2);
            used[2] = used[2].max(jerk.abs() / l.j_max_rad_s3);
        }
    }
    used
}

/// Distance of a point from the nearest of some boxes, m.
#[must_use]
pub fn distance_m(boxes: &[Obb], p_m: &Vector3<f64>) -> f64 {
    boxes.iter().map(|b| (b.nearest_point(p_m) - p_m).norm()).fold(f64::INFINITY, f64::min)
}

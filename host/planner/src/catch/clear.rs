//! Getting out of the way of a ball that will not be caught.
//!
//! The arm looks where the ball passes it. Where the motion under way leaves too little room, moves of the first three joints
//! are tried from what the joints do now; the one with the most room that keeps every limit is taken. It ends at rest.

use nalgebra::Vector3;
use robot_model::collision::{CollisionChecker, Obb};

use super::arm::CatchArm;
use super::forecast::{Forecast, Foreseen};
use super::motion::{CatchMotion, check, distance_m};
use super::task::Start;
use crate::motion_law::{Limits, Pieces, State};

/// Links from this one on can get out of a ball's way: base and turntable stay where they are.
pub const CLEARS_FROM_LINK: usize = 2;
/// Room between ball and arm besides what the forecast does not know, m.
const ROOM_M: f64 = 0.03;
/// Standard deviations of the forecast that count as room, and up to which sum, m.
const SIGMAS: f64 = 2.0;
const VAGUE_MAX_M: f64 = 0.10;
/// A move is worth this much more room, m.
const WORTH_M: f64 = 0.01;
/// Times of the flight that are looked at: every second one of the forecast, 10 ms apart, at most this many.
const STRIDE: usize = 2;
const TIMES_MAX: usize = 48;
/// Directions of the first three joints, and how far they go, rad.
const DIRECTIONS: [[f64; 3]; 8] = [
    [1.0, 0.0, 0.0],
    [-1.0, 0.0, 0.0],
    [0.0, -1.0, 0.0],
    [0.0, 1.0, 0.0],
    [0.0, 0.0, 1.0],
    [0.0, 0.0, -1.0],
    [1.0, -1.0, 0.0],
    [-1.0, -1.0, 0.0],
];
const WAYS_RAD: [f64; 2] = [0.35, 0.9];
/// A move takes the shortest time of a joint from rest to rest times these: the law may need more from other states.
const LONGER: [f64; 4] = [1.02, 1.4, 2.0, 3.0];
/// Whole motions that are checked at most.
const CHECKS_MAX: usize = 3;

/// How near a ball passes an arm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Room {
    /// Smallest distance between ball and arm less two standard deviations of the forecast, m; infinite for a ball that stays out of
    /// reach.
    pub room_m: f64,
}

/// Room that a motion leaves for the ball from `from_s` on.
#[must_use]
pub fn room(arm: &CatchArm, motion: &CatchMotion, from_s: f64, forecast: &Forecast) -> Room {
    Room { room_m: least_room_m(arm, motion, &passing(arm, from_s, forecast), f64::NEG_INFINITY) }
}

/// A motion out of the ball's way; `None` if the motion under way leaves room enough, or no other one leaves more.
#[must_use]
pub(crate) fn move_clear(
    arm: &CatchArm,
    start: &Start<'_>,
    under_way: &CatchMotion,
    forecast: &Forecast,
) -> Option<CatchMotion> {
    let balls = passing(arm, start.at_s, forecast);
    let stays_m = least_room_m(arm, under_way, &balls, f64::NEG_INFINITY);
    if stays_m >= ROOM_M {
        return None;
    }
    let limits = arm.limits(true);
    let mut found: Vec<(f64, CatchMotion)> = Vec::with_capacity(DIRECTIONS.len() * WAYS_RAD.len());
    for direction in &DIRECTIONS {
        for way_rad in WAYS_RAD {
            let Some(motion) = moved(arm, limits, start, direction, way_rad) else { continue };
            let room_m = least_room_m(arm, &motion, &balls, stays_m + WORTH_M);
            if room_m > stays_m + WORTH_M {
                found.push((room_m, motion));
            }
        }
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut checker = CollisionChecker::new(&arm.model, &arm.scene);
    let keeps = |motion: &CatchMotion| check(arm, &mut checker, motion, None).is_ok();
    found.into_iter().map(|(_, motion)| motion).take(CHECKS_MAX).find(keeps)
}

/// The ball while it is within the arm's reach and above the floor.
fn passing(arm: &CatchArm, from_s: f64, forecast: &Forecast) -> Vec<Foreseen> {
    let shoulder = arm.shoulder_m();
    let floor_m = arm.x_wb.pos.z + arm.model.world().floor_z_m;
    let near_m = arm.reach_m() + arm.cup.outer_radius_m() + ROOM_M + VAGUE_MAX_M;
    let points = forecast.points.iter().step_by(STRIDE).filter(|ball| ball.t_s >= from_s);
    points
        .filter(|ball| ball.p_m.z > floor_m && (ball.p_m - shoulder).norm() < near_m)
        .take(TIMES_MAX)
        .copied()
        .collect()
}

/// Smallest room; what is below `enough_m` is not given exactly.
fn least_room_m(arm: &CatchArm, motion: &CatchMotion, balls: &[Foreseen], enough_m: f64) -> f64 {
    let radius_m = arm.ball_radius_m();
    let mut least = f64::INFINITY;
    for ball in balls {
        let boxes = moving_boxes(arm, motion, ball.t_s);
        let vague_m = (SIGMAS * ball.lateral_sigma_m()).min(VAGUE_MAX_M);
        let p: &Vector3<f64> = &ball.p_m;
        least = least.min(distance_m(&boxes, p) - radius_m - vague_m);
        if least < enough_m {
            break;
        }
    }
    least
}

/// Boxes that can get out of the way, in the world.
fn moving_boxes(arm: &CatchArm, motion: &CatchMotion, t_s: f64) -> Vec<Obb> {
    let boxes = arm.boxes(&motion.joints_at(t_s).0).into_iter().zip(arm.model.collision().boxes());
    boxes.filter(|(_, body)| body.link >= CLEARS_FROM_LINK).map(|(placed, _)| placed).collect()
}

/// The first three joints by `way_rad` along a direction, the others to rest.
fn moved(
    arm: &CatchArm,
    limits: &[Limits; 6],
    start: &Start<'_>,
    direction: &[f64; 3],
    way_rad: f64,
) -> Option<CatchMotion> {
    let joint = |i: usize| -> Option<Pieces> {
        let (limit, from) = (&limits[i], &start.state[i]);
        let mut pieces = Pieces::starting(*from);
        arm.law.append_stop(limit, &mut pieces);
        let by_rad = direction.get(i).map_or(0.0, |share| share * way_rad);
        if by_rad == 0.0 {
            return Some(pieces);
        }
        let q = (from.q + by_rad).clamp(limit.q_rad.0, limit.q_rad.1);
        let way = (q - from.q).abs();
        let jerk_s = if arm.law.limits_jerk() { limit.a_rad_s2 / limit.j_rad_s3 } else { 0.0 };
        let shortest_s = (2.0 * (way / limit.a_rad_s2).sqrt())
            .max(way / limit.v_rad_s + limit.v_rad_s / limit.a_rad_s2)
            + jerk_s;
        LONGER.iter().find_map(|factor| {
            let t_s = shortest_s.max(0.1) * factor;
            let fit = arm.law.fit(limit, from, q, 0.0, t_s)?;
            let mut pieces = Pieces::starting(*from);
            arm.law.append(&fit, t_s, &mut pieces);
            Some(pieces)
        })
    };
    let mut joints = [Pieces::starting(State::default()); 6];
    for (i, pieces) in joints.iter_mut().enumerate() {
        *pieces = joint(i)?;
    }
    Some(CatchMotion { start_s: start.at_s, joints })
}

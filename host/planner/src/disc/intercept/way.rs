//! The way of the disc into the gripper, and of the arm past itself and the floor.

use nalgebra::Vector3;
use robot_model::collision::{CollisionChecker, Scene};

use super::Settings;
use crate::disc::arm::DiscArm;
use crate::disc::flight::Path;
use crate::disc::motion::DiscMotion;
use crate::disc::witness::HALF_HEIGHT_M;

/// Radius about the middle line of a link that the disc keeps out of, m: half the diagonal of the boxes, and some.
const LINK_RADIUS_M: f64 = 0.035;

/// Steps in which the way is looked at, s.
pub(super) const WAY_STEP_S: f64 = 0.002;

/// Whether the disc comes between the fingers and stays there for the dwell without touching anything.
pub(super) fn way_is_free(
    arm: &DiscArm,
    path: &Path,
    motion: &DiscMotion,
    t_s: f64,
    settings: &Settings,
) -> bool {
    touches_before(arm, path, motion, t_s, settings).is_none()
}

/// How long before the end of the dwell the disc last touches something or is not between the fingers, s, by a
/// coarse disc and segments for the links: up to a step more if few of its points touch. `None` if it comes between
/// the fingers and stays there for the dwell without touching anything.
pub(super) fn touches_before(
    arm: &DiscArm,
    path: &Path,
    motion: &DiscMotion,
    t_s: f64,
    settings: &Settings,
) -> Option<f64> {
    let radius = arm.size.disc_radius_m;
    let gripper = &settings.gripper;
    let half_dwell = 0.5 * settings.rule.dwell_s + 0.002;
    let gap = gripper.half_gap_m - HALF_HEIGHT_M - settings.margin_m;
    let wide = gripper.half_width_m + settings.margin_m;
    let outer = gripper.outer_m + HALF_HEIGHT_M + settings.margin_m;
    let first = settings.now_s;
    let last = t_s + half_dwell;
    let steps = ((last - first) / WAY_STEP_S).ceil() as u32;
    for k in 0..=steps {
        let t = last - f64::from(k) * WAY_STEP_S;
        let disc = path.at(t);
        let q = motion.q(t);
        let chain = arm.chain(&q);
        let axes = arm.hand_axes(&q);
        let seen = axes.tr_mul(&(disc.p_m - chain[3]));
        let in_dwell = t >= t_s - half_dwell;
        if in_dwell {
            let half_chord = (radius * radius - seen.z * seen.z).max(0.0).sqrt();
            let depth = arm.size.gripper_m - (seen.x - half_chord);
            let ok = depth >= settings.rule.depth_min_m + settings.margin_m
                && seen.z.abs() <= settings.rule.lateral_max_m
                && seen.x - half_chord >= settings.margin_m;
            if !ok {
                return Some(last - t);
            }
        }
        // What the disc is too far from to touch.
        let link = LINK_RADIUS_M + HALF_HEIGHT_M;
        let near = |i: usize| to_segment(&disc.p_m, &chain[i], &chain[i + 1]) < radius + link;
        let near_link = [near(0), near(1), near(2)];
        let near_finger = seen.x < arm.size.touch_m() + settings.margin_m
            && seen.x > -radius
            && seen.y.abs() < radius + outer
            && seen.z.abs() < radius + wide;
        let near_base = disc.p_m.z < arm.size.base_m + 0.06 + radius && disc.p_m.xy().norm() < 0.12 + radius;
        if !near_finger && !near_base && !near_link.contains(&true) {
            continue;
        }
        let normal = axes.tr_mul(&disc.normal);
        let side = if normal.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
        let e1 = (side - normal * side.dot(&normal)).normalize();
        let e2 = normal.cross(&e1);
        let (mut points, mut touching) = (0, 0);
        for ring in [1.0, 0.8, 0.55, 0.3, 0.0] {
            let count = if ring > 0.9 { 48 } else { 24 };
            for k in 0..count {
                let (s, c) = (f64::from(k) * std::f64::consts::TAU / f64::from(count)).sin_cos();
                let p = seen + (e1 * c + e2 * s) * (radius * ring);
                points += 1;
                let in_finger = p.x > 0.0 && p.x < arm.size.gripper_m + settings.margin_m && p.z.abs() < wide;
                let world = chain[3] + axes * p;
                let in_hand = near_link[2]
                    && p.x < settings.margin_m
                    && to_segment(&world, &chain[2], &chain[3]) < link;
                let touches = in_finger && p.y.abs() > gap && p.y.abs() < outer
                    || in_hand
                    || (0..2).any(|i| near_link[i] && to_segment(&world, &chain[i], &chain[i + 1]) < link)
                    || world.z < arm.size.base_m + 0.06 && world.xy().norm() < 0.12;
                touching += u32::from(touches);
            }
        }
        if touching > 0 {
            return Some(last - t + WAY_STEP_S * (1.0 - f64::from(touching) / f64::from(points)));
        }
    }
    None
}

fn to_segment(p: &Vector3<f64>, a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    let ab = b - a;
    let u = ((p - a).dot(&ab) / ab.norm_squared()).clamp(0.0, 1.0);
    (p - a - ab * u).norm()
}

/// Distance that the arm keeps from itself and from the floor, m.
const CLEAR_M: f64 = 0.004;

/// Whether the arm keeps clear of itself and of the floor, every 5 ms to the end.
pub(super) fn stays_clear(arm: &DiscArm, motion: &DiscMotion) -> bool {
    too_near_m(arm, motion, 0.005) <= 0.0
}

/// By how much the arm is too near to itself or to the floor, mean of the whole motion, m; 0 if it keeps clear.
pub(super) fn too_near_m(arm: &DiscArm, motion: &DiscMotion, step_s: f64) -> f64 {
    let scene = Scene::default();
    let mut checker = CollisionChecker::new(&arm.model, &scene);
    let steps = ((motion.end_s() - motion.from_s) / step_s).ceil() as u32;
    let sum: f64 = (0..=steps)
        .map(|k| motion.q(motion.from_s + step_s * f64::from(k)))
        .map(|q| CLEAR_M - checker.distance_up_to(&arm.model.fk(&q.into()), CLEAR_M))
        .sum();
    sum / f64::from(steps + 1)
}

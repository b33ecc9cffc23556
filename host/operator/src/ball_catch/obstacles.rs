//! The thrower, as the catcher keeps clear of it.
//!
//! A partner knows the plan: it keeps clear of all places that the thrower takes on its way. Who knows no plan keeps out of the
//! thrower's reach. Boxes that the catcher cannot reach are left out.

use std::f64::consts::TAU;

use hil_sim::two_arms::ArmPlace;
use nalgebra::Vector3;
use planner::catch::arm::CatchArm;
use planner::throw::Throw;
use robot_model::Pose;
use robot_model::collision::{Obb, aligned_box};

/// The throw is cut into this many pieces, each looked at this often; each link gives one box per piece.
const PIECES: u32 = 6;
const LOOKS: u32 = 8;
/// Added to all sides of the boxes, m: what scatter of the throw and the steps between two looks move.
const MARGIN_M: f64 = 0.03;
/// Slabs through the thrower's axis that cover its reach.
const SLABS: u32 = 6;

/// Boxes that the thrower's links pass during a throw, in the world.
#[must_use]
pub fn swept(thrower: &ArmPlace, throw: &Throw) -> Vec<Obb> {
    let boxes = thrower.model.collision().boxes().len();
    let mut out = Vec::new();
    for piece in 0..PIECES {
        let mut corners = vec![(Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY)); boxes];
        for look in 0..=LOOKS {
            let share = f64::from(piece * LOOKS + look) / f64::from(PIECES * LOOKS);
            let q = throw.at_time(share * throw.duration_s()).q;
            for ((low, high), b) in corners.iter_mut().zip(thrower.model.boxes_at(&thrower.model.fk(&q))) {
                for corner in Obb::new(thrower.x_wb * b.pose, b.half_m).corners() {
                    *low = low.inf(&corner);
                    *high = high.sup(&corner);
                }
            }
        }
        let margin = Vector3::repeat(MARGIN_M);
        out.extend(corners.into_iter().map(|(low, high)| aligned_box(low - margin, high + margin)));
    }
    out
}

/// Boxes that cover all that the thrower can reach, in the world: slabs that stand on its axis, from the floor up.
#[must_use]
pub fn reach(thrower: &ArmPlace, reach_m: f64) -> Vec<Obb> {
    let shoulder = thrower.model.fk(&planner::catch::Joints::zeros(6)).origin(1);
    let (low_m, high_m) = (thrower.model.world().floor_z_m, shoulder.z + reach_m);
    let half = Vector3::new(reach_m, reach_m * (0.25 * TAU / f64::from(SLABS)).tan(), 0.5 * (high_m - low_m));
    let slab = |k: u32| {
        let turned = Pose::rot_z(0.5 * TAU * f64::from(k) / f64::from(SLABS));
        let middle = Vector3::new(shoulder.x, shoulder.y, 0.5 * (low_m + high_m));
        Obb::new(thrower.x_wb * Pose::new(turned.rot, middle), half)
    };
    (0..SLABS).map(slab).collect()
}

/// Those boxes that the catcher can reach.
#[must_use]
pub fn within_reach(catcher: &CatchArm, boxes: Vec<Obb>) -> Vec<Obb> {
    let shoulder = catcher.shoulder_m();
    let reach_m = catcher.reach_m() + catcher.cup().outer_radius_m();
    boxes.into_iter().filter(|b| (b.nearest_point(&shoulder) - shoulder).norm() < reach_m).collect()
}

/// Whether boxes of both arms overlap.
#[must_use]
pub fn touch(a: &[Obb], b: &[Obb]) -> bool {
    a.iter().any(|a| b.iter().any(|b| a.overlaps(b)))
}

#[cfg(test)]
mod tests {
    use hil_sim::two_arms::TwoArmOptions;
    use planner::catch::Joints;
    use planner::plan::rng::SplitMix64;

    use super::*;

    fn thrower() -> ArmPlace {
        TwoArmOptions::two_arms().unwrap().arms[0].clone()
    }

    #[test]
    fn the_slabs_cover_every_posture_of_the_thrower() {
        let thrower = thrower();
        let covered = |p: &Vector3<f64>, slabs: &[Obb]| {
            slabs.iter().any(|slab| (slab.nearest_point(p) - p).norm() < 1e-9)
        };
        let slabs = reach(&thrower, 1.2);
        let mut rng = SplitMix64::new(1);
        for _ in 0..300 {
            let q = Joints::from_fn(6, |_| 6.0 * rng.unit() - 3.0);
            let frames = thrower.model.fk(&q);
            let p = thrower.model.ee(&frames).pos;
            assert!((p - frames.origin(1)).norm() < 1.2, "{p}");
            // Through the floor no arm reaches.
            if p.z > thrower.model.world().floor_z_m {
                assert!(covered(&p, &slabs), "{p}");
            }
        }
    }

    #[test]
    fn the_swept_boxes_hold_the_thrower_at_any_time() {
        let thrower = thrower();
        let throw = Throw {
            q_rad: Joints::from([0.3, -0.8, -2.0, 0.1, -1.0, 0.0]),
            qd_rad_s: Joints::from([1.5, 1.0, -1.5, 0.5, 2.0, 0.0]),
            qdd_rad_s2: Joints::zeros(6),
            flight_s: 0.6,
            ha_s: 0.4,
            hb_s: 0.4,
        };
        let swept = swept(&thrower, &throw);
        for k in 0..=97 {
            let q = throw.at_time(throw.duration_s() * f64::from(k) / 97.0).q;
            for b in thrower.model.boxes_at(&thrower.model.fk(&q)) {
                let p = thrower.x_wb.transform_point(&b.pose.pos);
                assert!(swept.iter().any(|s| (s.nearest_point(&p) - p).norm() < 1e-9), "{p}");
            }
        }
    }
}

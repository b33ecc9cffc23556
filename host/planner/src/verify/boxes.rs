//! Distances of boxes by alternating projections between convex sets (von Neumann): from a point of one box to the
//! nearest point of the other and back. Converges to the distance from above, so overlap is never overlooked.

use nalgebra::Vector3;
use robot_model::Pose;

/// Rounds of projections; near-parallel faces converge slowly, but their distance is right from the first round.
const ROUNDS: usize = 400;

fn nearest(x: &Pose, half_m: &Vector3<f64>, p: &Vector3<f64>) -> Vector3<f64> {
    let local = x.rot.transpose() * (p - x.pos);
    let inside = Vector3::from_fn(|i, _| local[i].clamp(-half_m[i], half_m[i]));
    x.rot * inside + x.pos
}

/// Distance of two boxes in m; zero if they touch or overlap.
#[must_use]
pub fn distance_m(a: &Pose, half_a: &Vector3<f64>, b: &Pose, half_b: &Vector3<f64>) -> f64 {
    let mut on_b = b.pos;
    let mut last = f64::INFINITY;
    for _ in 0..ROUNDS {
        let on_a = nearest(a, half_a, &on_b);
        on_b = nearest(b, half_b, &on_a);
        let now = (on_a - on_b).norm();
        if last - now < 1e-12 {
            return now;
        }
        last = now;
    }
    last
}

/// Distance of a point from a box in m; zero inside.
#[must_use]
pub(crate) fn point_distance_m(x: &Pose, half_m: &Vector3<f64>, p: &Vector3<f64>) -> f64 {
    (nearest(x, half_m, p) - p).norm()
}

/// Lowest point of a box.
#[must_use]
pub(crate) fn lowest_m(x: &Pose, half_m: &Vector3<f64>) -> f64 {
    x.pos.z - (0..3).map(|i| x.rot[(2, i)].abs() * half_m[i]).sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_of_turned_boxes_match_hand_computation() {
        let half = Vector3::new(1.0, 1.0, 1.0);
        let a = Pose::identity();
        let mut b = Pose::rot_z(std::f64::consts::FRAC_PI_4);
        b.pos = Vector3::new(3.0, 0.0, 0.0);
        // An edge of the turned cube points at the face.
        assert!((distance_m(&a, &half, &b, &half) - (2.0 - 2.0_f64.sqrt())).abs() < 1e-9);
        b.pos.x = 2.3;
        assert_eq!(distance_m(&a, &half, &b, &half), 0.0);
        assert!((point_distance_m(&a, &half, &Vector3::new(2.0, 2.0, 0.0)) - 2.0_f64.sqrt()).abs() < 1e-12);
        assert!((lowest_m(&Pose::rot_x(std::f64::consts::FRAC_PI_4), &half) + 2.0_f64.sqrt()).abs() < 1e-12);
    }
}

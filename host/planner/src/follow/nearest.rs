//! The nearest target that can be planned, where the one asked for cannot.

use nalgebra::Vector3;

/// The edge is known to this, m.
const EDGE_M: f64 = 0.02;
/// Share of the way to the first axis, and metres downwards, at which a plan is looked for first.
const STEPS: [f64; 3] = [0.15, 0.35, 0.6];
/// Distance from the first axis at which a plan is looked for last, m.
const LAST_M: f64 = 2.0;

/// The feasible target nearest to `target` in two directions: closer to the first axis at the same height, and lower
/// at the same place (not below `floor_z_m`). Its coordinates that differ from `target` are whole centimetres.
///
/// `plans` says whether a target has a plan; it is asked at most 16 times for a target within 3 m, the result among them. What
/// it says is taken as monotonous along each direction, so the result is an upper bound of the distance. `None` if no plan is found in either
/// direction.
pub fn feasible_target(
    target: &Vector3<f64>,
    floor_z_m: f64,
    mut plans: impl FnMut(&Vector3<f64>) -> bool,
) -> Option<Vector3<f64>> {
    let round = |v: f64| (v * 100.0).round() / 100.0 + 0.0;
    let closer =
        |share: f64| Vector3::new(round(target.x * (1.0 - share)), round(target.y * (1.0 - share)), target.z);
    let lower = |way_m: f64| Vector3::new(target.x, target.y, round((target.z - way_m).max(floor_z_m)));
    let away_m = target.xy().norm();
    let last = 1.0 - LAST_M / away_m;
    let shares: Vec<f64> = STEPS.into_iter().chain((last > STEPS[2]).then_some(last)).collect();
    let found =
        [toward(closer, &shares, EDGE_M / away_m, &mut plans), toward(lower, &STEPS, EDGE_M, &mut plans)];
    let way = |p: &Vector3<f64>| (p - target).norm();
    found.into_iter().flatten().min_by(|a, b| way(a).total_cmp(&way(b)))
}

fn toward(
    at: impl Fn(f64) -> Vector3<f64>,
    steps: &[f64],
    edge: f64,
    plans: &mut impl FnMut(&Vector3<f64>) -> bool,
) -> Option<Vector3<f64>> {
    let mut without = 0.0;
    let mut with = None;
    for step in steps {
        if plans(&at(*step)) {
            with = Some(*step);
            break;
        }
        without = *step;
    }
    let mut with = with?;
    while with - without > edge {
        let middle = 0.5 * (without + with);
        if plans(&at(middle)) { with = middle } else { without = middle }
    }
    Some(at(with))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_edge_of_what_is_feasible_is_found_in_the_nearer_direction() {
        let target = Vector3::new(2.5, 0.0, 1.5);
        let mut asked = 0;
        let found = feasible_target(&target, 0.0, |p| {
            asked += 1;
            p.z <= 1.2 || p.x <= 1.6
        })
        .expect("lower");
        assert!(found.z <= 1.2 && found.z > 1.18 && found.x == 2.5, "{found}");
        assert!(asked <= 16, "{asked}");
        let closer = feasible_target(&target, 0.0, |p| p.x <= 2.4).expect("closer");
        assert!(closer.x <= 2.4 && closer.x > 2.38 && closer.z == 1.5, "{closer}");
        let far = feasible_target(&Vector3::new(600.0, 800.0, 0.5), 0.0, |p| p.xy().norm() <= 3.0);
        let far_m = far.expect("closer").xy().norm();
        assert!(far_m <= 3.0 && far_m > 2.9, "{far_m}");
        assert!(feasible_target(&target, 0.0, |_| false).is_none());
    }
}

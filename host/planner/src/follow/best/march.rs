//! Throws carried from one target to the next: to a target at the edge of the reach, and to the edge itself.
//!
//! Few of the releases drawn for such a target lead to a throw. A throw to an easier target is a better start: the
//! target is moved in steps, and the search for each begins with the throw before.

use nalgebra::Vector3;
use rayon::prelude::*;

use super::excess::Excess;
use super::seeds::{self, Seed, base};
use super::{BestOptions, Grown, feasible, shortest};
use crate::follow::clear::Scenes;
use crate::follow::posture::reach_m;
use crate::follow::setting::Setting;

/// Releases that are drawn for the easier target.
const DRAWS: usize = 4000;
/// Releases whose throws are carried.
const CARRIED: usize = 6;
/// Steps of the target, m: a shorter one is used after each failure. Long ones jump over places at which short ones end.
const STEPS_M: [f64; 3] = [0.5, 0.12, 0.03];
/// Throws are not carried farther, m.
const FARTHEST_M: f64 = 50.0;
/// Distances from the edge at which a target is proven in turn, m.
const BEFORE_EDGE_M: [f64; 2] = [0.0, 0.03];
/// Distances from the first axis from which throws are carried, in lengths of the arm.
const BEGINS: [f64; 2] = [1.5, 1.0];

/// A throw to the target of `setting`. Otherwise the nearest target, in whole centimetres, to which a throw is carried.
pub(super) fn toward(setting: &Setting<'_>, options: &BestOptions) -> Result<Grown, Option<Vector3<f64>>> {
    reach(setting, options).map_err(|mut ends| {
        ends.sort_by(|a, b| (a.edge - setting.target).norm().total_cmp(&(b.edge - setting.target).norm()));
        ends.iter().find_map(|end| {
            let inwards = (end.begin - end.edge).try_normalize(0.0)?;
            let before = BEFORE_EDGE_M.map(|way_m| centimetres(&(end.edge + inwards * way_m), &inwards));
            before.into_iter().find(|target| reach(&setting.at(*target), options).is_ok())
        })
    })
}

/// A target with a throw, and the last one to which it was carried.
struct End {
    begin: Vector3<f64>,
    edge: Vector3<f64>,
}

fn reach(setting: &Setting<'_>, options: &BestOptions) -> Result<Grown, Vec<End>> {
    let mut ends = Vec::new();
    for begin in easier(setting) {
        match carry(setting, options, &begin) {
            Carried::There(grown) => return Ok(grown),
            Carried::To(edge) => ends.push(End { begin, edge }),
            Carried::Nowhere => {}
        }
    }
    Err(ends)
}

/// Targets from which throws are carried: at the same height; and at the same place, lower than the base.
fn easier(setting: &Setting<'_>) -> Vec<Vector3<f64>> {
    let (target, reach_m) = (setting.target, reach_m(setting.arm));
    let low_m = (base(setting).z - 0.5 * reach_m).max(setting.arm.world().floor_z_m);
    let ahead = target.xy().try_normalize(0.0).unwrap_or(nalgebra::Vector2::x()) * reach_m;
    let mut easier = BEGINS.map(|share| Vector3::new(share * ahead.x, share * ahead.y, target.z)).to_vec();
    if target.z > low_m {
        easier.push(Vector3::new(target.x, target.y, low_m));
    }
    easier
}

/// What became of the throws to a target.
enum Carried {
    /// A throw to the target of the setting.
    There(Grown),
    /// The last target on the way.
    To(Vector3<f64>),
    /// There is no throw to carry.
    Nowhere,
}

fn carry(setting: &Setting<'_>, options: &BestOptions, begin: &Vector3<f64>) -> Carried {
    let Some(ahead) = (setting.target - begin).try_normalize(0.0) else { return Carried::Nowhere };
    let fewer = BestOptions { draws: options.draws.min(DRAWS), ..options.clone() };
    let (seeds, _) = seeds::draw(&setting.at(*begin), &fewer, CARRIED);
    let carried: Vec<(f64, Option<Grown>)> =
        seeds.par_iter().filter_map(|seed| outwards(setting, options, begin, &ahead, seed)).collect();
    let edge_m = carried.iter().map(|(edge_m, _)| *edge_m).max_by(f64::total_cmp);
    match (carried.into_iter().find_map(|(_, there)| there), edge_m) {
        (Some(there), _) => Carried::There(there),
        (None, Some(edge_m)) => Carried::To(begin + ahead * edge_m),
        (None, None) => Carried::Nowhere,
    }
}

/// Carries the throw of `seed` from `begin` in the direction `ahead`. Returns how far it came, in m, and the throw to the target of `setting`
/// if there is one.
///
/// The steps do not depend on the distance of the target: near a target before the edge there is a throw of the same sequence.
fn outwards(
    setting: &Setting<'_>,
    options: &BestOptions,
    begin: &Vector3<f64>,
    ahead: &Vector3<f64>,
    seed: &Seed,
) -> Option<(f64, Option<Grown>)> {
    let scenes = Scenes::new();
    let carried_to = |target: Vector3<f64>, grown: &Grown| {
        let there = setting.at(target);
        let mut excess = Excess::new(&there, options.hand, &scenes);
        feasible(&mut excess, options, &grown.x, &grown.q_center, 1)
    };
    let first = shortest(&mut Excess::new(&setting.at(*begin), options.hand, &scenes), options, seed)?;
    let mut way = vec![(0.0, first)];
    for step_m in STEPS_M {
        while let Some((at_m, grown)) = way.last()
            && *at_m < FARTHEST_M
            && let Some(next) = carried_to(begin + ahead * (at_m + step_m), grown)
        {
            way.push((at_m + step_m, next));
        }
    }
    let edge_m = way.last().map_or(0.0, |(at_m, _)| *at_m);
    let way_m = (setting.target - begin).norm();
    let (off_m, nearest) =
        way.iter().map(|(at_m, grown)| ((at_m - way_m).abs(), grown)).min_by(|a, b| a.0.total_cmp(&b.0))?;
    let there = if off_m <= STEPS_M[0] { carried_to(setting.target, nearest) } else { None };
    Some((edge_m, there))
}

/// The point in whole centimetres from `at` in the direction `inwards`; a coordinate in which `inwards` is zero stays.
fn centimetres(at: &Vector3<f64>, inwards: &Vector3<f64>) -> Vector3<f64> {
    at.zip_map(inwards, |at, inwards| match inwards {
        0.0 => at,
        _ if inwards > 0.0 => (at * 100.0).ceil() / 100.0,
        _ => (at * 100.0).floor() / 100.0,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_target_is_rounded_to_whole_centimetres_inwards_and_an_untouched_coordinate_stays() {
        let at = Vector3::new(4.03125, -2.747, 0.1234);
        let inwards = Vector3::new(-1.0, 1.0, 0.0);
        assert_eq!(centimetres(&at, &inwards), Vector3::new(4.03, -2.74, 0.1234));
    }
}

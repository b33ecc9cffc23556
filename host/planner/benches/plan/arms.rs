//! Arms without a closed form, and arms without six joints: how often the default search finds a throw if many
//! random starts find one.

use nalgebra::Vector3;
use planner::plan::problem::{Options, Problem};
use planner::plan::rng::SplitMix64;
use planner::plan::search::{Best, Budget, NoThrow, Planner, Watch};
use planner::store::Index;
use rayon::prelude::*;
use robot_model::RobotModel;

/// Robot files beside this package, and the ranges of their targets in m.
const ARMS: [(&str, f64); 4] = [
    ("../../robots/model/tests/data/ur5.toml", 2.5),
    ("tests/data/iiwa7.toml", 2.5),
    ("tests/data/youbot5.toml", 1.2),
    ("pincher4", 2.0),
];
const SEED: u64 = 91;

/// Prints one line per arm: `targets` random targets, a reference of `starts` random starts each.
pub(crate) fn arms(targets: u64, starts: usize) {
    println!("default form without nulling, {targets} random targets, reference: {starts} random starts");
    for (file, range_m) in ARMS {
        match RobotModel::load(file) {
            Ok(robot) => of_arm(&robot, range_m, targets, starts),
            Err(e) => println!("{e}"),
        }
    }
}

fn of_arm(arm: &RobotModel, range_m: f64, targets: u64, starts: usize) {
    let floor_m = arm.world().floor_z_m;
    let results: Vec<(Option<f64>, Option<f64>)> = (0..targets)
        .into_par_iter()
        .map(|k| {
            let mut rng = SplitMix64::stream(SEED, k);
            let azimuth = (rng.unit() * 2.0 - 1.0) * std::f64::consts::PI;
            let range = range_m * (0.2 + 0.8 * rng.unit());
            let z = floor_m + 0.8 * rng.unit();
            let target = Vector3::new(range * azimuth.cos(), range * azimuth.sin(), z);
            let options = Options { null_delay: false, delay_windows: Vec::new(), ..Options::best() };
            let Ok(problem) = Problem::new(arm, target, options) else { return (None, None) };
            let planner = Planner::new(&problem);
            let budget = Budget { starts: 96, all: false, time: None, seed: 1 };
            let found = planner.attempt(&Index::default(), &budget, &Watch::default());
            let budget = Budget { starts, all: true, time: None, seed: 1_000 };
            let reference = planner.attempt(&Index::default(), &budget, &Watch::default());
            let price = |b: Result<Best, NoThrow>| b.ok().map(|b| b.found.objective);
            (price(found), price(reference))
        })
        .collect();
    let reached = results.iter().filter(|r| r.1.is_some()).count();
    let also = results.iter().filter(|r| r.1.is_some() && r.0.is_some()).count();
    let only = results.iter().filter(|r| r.1.is_none() && r.0.is_some()).count();
    let mut gaps: Vec<f64> = results.iter().filter_map(|r| Some(100.0 * (r.0? / r.1? - 1.0))).collect();
    gaps.sort_by(f64::total_cmp);
    println!(
        "{:<10} {} joints: reference reaches {reached}, search finds {also} of them and {only} others; gap p50 {:.2} %, p90 {:.1} %, worst {:.1} %",
        arm.name(),
        arm.n(),
        super::quantile(&gaps, 0.5),
        super::quantile(&gaps, 0.9),
        super::quantile(&gaps, 1.0),
    );
}

//! The default search of the default form finds the best known throw, with every seed, for more arms than one.

use nalgebra::Vector3;
use planner::plan::file::PlanFile;
use planner::plan::problem::{Options, Problem};
use planner::plan::search::{Best, Budget, NoThrow, Planner, Watch};
use planner::plan::statistics::Noise;
use planner::plan::{Arm, Confidence, Found, Joints, Kept, Margins, Relaxation, Throw, seeds};
use planner::verify;
use robot_model::RobotModel;

fn arm() -> Arm {
    Arm::load("powercube6").expect("built in")
}

/// The default form, without limits of the shift, and without nulling.
fn levels() -> [Options; 3] {
    let nulled = Options { delay_windows: Vec::new(), ..Options::best() };
    [Options::best(), nulled.clone(), Options { null_delay: false, ..nulled }]
}

fn default_search(arm: &Arm, target: Vector3<f64>, options: &Options, seed: u64) -> Result<Best, NoThrow> {
    let problem = Problem::new(arm, target, options.clone()).expect("valid");
    let budget = Budget { seed, ..Budget::default() };
    Planner::new(&problem).attempt(&seeds::built_in(arm), &budget, &Watch::default())
}

/// The relaxation level at which the search ends, and the price there.
fn planned(arm: &Arm, target: [f64; 3], seed: u64) -> Option<(usize, f64)> {
    levels().iter().enumerate().find_map(|(level, options)| {
        let best = default_search(arm, Vector3::from(target), options, seed).ok()?;
        Some((level, best.found.objective))
    })
}

#[test]
fn targets_that_long_searches_reach_are_not_refused() {
    let arm = arm();
    for (target, known) in [
        ([3.5482, 0.8978, -0.6188], 33.335),
        ([1.4054, 2.9165, -0.2304], 32.711),
        ([0.9676, -3.5723, -0.6201], 33.549),
    ] {
        let (level, price) = planned(&arm, target, 1).expect("in reach");
        assert_eq!(level, 1, "{target:?}: the landing does not move to first order");
        assert!(price < known * 1.001 && price > known * 0.9, "{target:?}: {price}, known {known}");
    }
}

#[test]
fn every_seed_gives_the_same_price_with_nulling() {
    let arm = arm();
    let mut prices = Vec::new();
    for seed in [1, 6, 7, 8] {
        let (level, price) = planned(&arm, [1.5, 1.0, -1.0], seed).expect("in reach");
        assert_eq!(level, 0, "seed {seed}: all limits of the landing's shift hold");
        prices.push(price);
    }
    // 33.91 was the best of 1500 starts before; 47.89 was what the default search found.
    for price in &prices {
        assert!(*price < 31.4 && *price > 28.0, "{prices:?}");
        assert!((price / prices[0] - 1.0).abs() < 1e-3, "{prices:?}");
    }
}

#[test]
fn a_throw_is_found_again_at_another_azimuth() {
    let arm = arm();
    let range_m = 1.5_f64.hypot(1.0);
    let prices: Vec<f64> = [0.0_f64, 0.588, 2.0, -1.3]
        .iter()
        .map(|azimuth| {
            let target = [range_m * azimuth.cos(), range_m * azimuth.sin(), -1.0];
            let (level, price) = planned(&arm, target, 1).expect("in reach");
            assert_eq!(level, 0);
            price
        })
        .collect();
    let cheapest = prices.iter().copied().fold(f64::INFINITY, f64::min);
    assert!(prices.iter().all(|p| *p <= cheapest * 1.02), "{prices:?}");
}

#[test]
fn an_answer_from_stored_throws_is_not_better_than_the_search() {
    let arm = arm();
    let index = seeds::built_in(&arm);
    for target in [[1.5, 1.0, -1.0], [0.8, 0.3, 0.2], [-1.2, 1.9, -0.7], [0.4, -2.4, -1.0]] {
        for options in levels() {
            let problem = Problem::new(&arm, Vector3::from(target), options.clone()).expect("valid");
            let Some(fast) = Planner::new(&problem).from_index(&index, 6) else { continue };
            let full = default_search(&arm, Vector3::from(target), &options, 1).expect("in reach").found;
            assert!(full.objective <= fast.objective * (1.0 + 1e-6), "{target:?}: {fast:?} and {full:?}");
        }
    }
}

#[test]
fn random_starts_of_the_default_form_end_in_throws() {
    // Before the rows were scaled evenly 1 to 5 of 100 starts ended in a throw, at 46.6 and more.
    let arm = arm();
    let problem = Problem::new(&arm, Vector3::new(1.5, 1.0, -1.0), Options::best()).expect("valid");
    let planner = Planner::new(&problem);
    let found: Vec<_> = (0..60).filter_map(|k| planner.random_start(3, k)).collect();
    let best = found.iter().map(|f| f.objective).fold(f64::INFINITY, f64::min);
    assert!(found.len() >= 20, "{} of 60", found.len());
    assert!(best < 32.0, "{best}");
    for f in &found {
        let violation = Margins::of(&problem, &f.throw).violation();
        assert!(violation < 1e-6, "{violation}");
    }
}

#[test]
fn bounds_of_the_search_follow_the_robot() {
    let arm = Arm::load("kr16_2").expect("built in");
    let found =
        default_search(&arm, Vector3::new(1.5, 0.0, 0.1), &Options::best(), 1).expect("in reach").found;
    assert!(found.objective > 6.0 && found.objective < 7.2, "{}", found.objective);
    // The motion of a slow arm takes longer than the paper's two seconds if it has to.
    let radius = |throw: &Throw| (throw.ball_at_release(&arm).0 - Vector3::new(0.0, 0.0, 0.675)).norm();
    assert!(radius(&found.throw) > 1.0, "{}", radius(&found.throw));
}

#[test]
fn a_run_that_loses_the_times_of_its_motion_ends_without_a_throw_or_with_one_that_lands() {
    let arm = arm();
    let target = Vector3::new(1.5, 1.0, -1.0);
    let problem = Problem::new(&arm, target, Options::best()).expect("valid");
    let start = Throw {
        q_rad: Joints::repeat(6, 1e-3),
        qd_rad_s: Joints::repeat(6, 40.0),
        qdd_rad_s2: Joints::repeat(6, -4e3),
        flight_s: 2e-3,
        ha_s: 2e-3,
        hb_s: 2e-3,
    };
    if let Some(found) = Planner::new(&problem).from_throw(&start) {
        let Throw { flight_s, ha_s, hb_s, .. } = found.throw;
        let (p, v) = found.throw.ball_at_release(&arm);
        let lands = p + v * flight_s - Vector3::z() * (0.5 * 9.81 * flight_s * flight_s);
        assert!((lands - target).norm() < 1e-6 && ha_s > 0.1 && hb_s > 0.1, "{lands} {found:?}");
    }
}

#[test]
fn what_a_search_says_about_its_gap_follows_its_starts() {
    let arm = arm();
    let confidence = |starts| {
        let problem = Problem::new(&arm, Vector3::new(1.0, 1.0, -1.0), Options::best()).expect("valid");
        let budget = Budget { starts, all: true, ..Budget::default() };
        Planner::new(&problem)
            .attempt(&seeds::built_in(&arm), &budget, &Watch::default())
            .expect("in reach")
            .confidence
    };
    let (few, many) = (confidence(8), confidence(40));
    assert_eq!((few.random_starts, many.random_starts), (8, 40));
    assert!(few.since_best <= 8 && many.at_best >= few.at_best && many.at_best >= 4, "{few:?} {many:?}");
    assert!((few.better_chance - 1.0 / (few.since_best as f64 + 2.0)).abs() < 1e-12);
    assert!(many.better_chance < few.better_chance, "{few:?} {many:?}");
}

/// What the verifier refuses of the plan that the default search finds.
fn refused_of(robot: &str, target: [f64; 3]) -> Vec<String> {
    let arm = RobotModel::load(robot).expect("built in");
    let relaxation =
        Relaxation::new(&arm, Vector3::from(target), &Options::best(), Kept::default()).expect("valid");
    let settled = relaxation
        .search(&seeds::built_in(&arm), &Budget::default(), &Watch::default(), None)
        .unwrap_or_else(|none| panic!("{none}"));
    let plan = PlanFile::of(settled.problem, &settled.best, robot, 1, &Noise::default(), None);
    refused(&arm, &plan.expect("it lands"))
}

fn refused(arm: &RobotModel, plan: &PlanFile) -> Vec<String> {
    let findings = verify::check(arm, plan).findings;
    findings.into_iter().filter(|f| f.enforced && !f.ok).map(|f| format!("{}: {}", f.what, f.worst)).collect()
}

/// A ball released 25 ms early rose to the plane of the target and not above it.
#[test]
fn a_ball_that_is_released_early_comes_down_through_the_plane_and_does_not_graze_it() {
    assert_eq!(
        refused_of("powercube6", [0.547153718062688, -0.9089935350476135, 0.23347482640581774]),
        [""; 0]
    );
    assert_eq!(refused_of("kr16_2", [-1.3938405064065176, -1.0557594565364068, 1.032072862117285]), [""; 0]);
}

/// Foot and wrist of a KR 16 came 2.7 mm near between two instants of the scan, which checked between instants only
/// where a PowerCube arm could have come nearer.
#[test]
fn links_of_a_large_arm_that_come_near_between_two_instants_are_seen() {
    let arm = RobotModel::load("kr16_2").expect("built in");
    let throw = Throw {
        flight_s: 0.546181054,
        ha_s: 1.875583850,
        hb_s: 1.875583850,
        q_rad: Joints::from([
            -0.977858268,
            -0.735551428,
            0.539418804,
            2.353488076,
            -0.752695686,
            -4.793903000,
        ]),
        qd_rad_s: Joints::from([
            -1.571285452,
            -0.744104119,
            -1.571285452,
            -1.554232082,
            1.139695966,
            1.035477072,
        ]),
        qdd_rad_s2: Joints::zeros(6),
    };
    let target = Vector3::new(-0.5487208224105184, 2.1906126702537305, 1.3438069299049837);
    let [.., plain] = levels();
    let problem = Problem::new(&arm, target, plain).expect("valid");
    let found = Found { throw, objective: 0.0, iterations: 0, slope_per_m: Vector3::zeros(), touches: false };
    let confidence = Confidence::default();
    let best = Best { found, starts: 1, solved: 1, interrupted: false, confidence, others: vec![found] };
    let plan = PlanFile::of(&problem, &best, "kr16_2", 1, &Noise::default(), None).expect("it lands");
    let refused = refused(&arm, &plan);
    assert!(refused.iter().any(|r| r.contains("2.7 mm of 5.0 mm")), "{refused:?}");
    // The planner checks instants between those of the verifier.
    let reported_mm = 1e3 * plan.margins.clearance_m.expect("bodies that can meet");
    assert!((2.4..2.8).contains(&reported_mm), "{reported_mm} mm");
}

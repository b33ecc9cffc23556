//! The paper's form against the published optimum and the known best throws (robot-models 1.2, 1.6, 1.7).

use nalgebra::Vector3;
use planner::plan::problem::{Options, Problem};
use planner::plan::search::{Budget, Planner, Watch};
use planner::plan::{Arm, Margins, PaperParameters, seeds};
use planner::store::Index;

const PUBLISHED: [f64; 8] = [0.493, -0.465, 0.858, 0.583, -1.098, 0.586, 0.920, 0.391];

fn arm() -> Arm {
    Arm::load("powercube6").expect("built in")
}

fn problem<'a>(arm: &'a Arm, target: [f64; 3], options: Options) -> Problem<'a> {
    Problem::new(arm, Vector3::from(target), options).expect("a valid problem")
}

/// Stored throws and a few random ones.
fn best(problem: &Problem<'_>, starts: usize) -> Result<f64, String> {
    let index = seeds::built_in(problem.arm());
    let budget = Budget { starts, all: false, time: None, seed: 1 };
    Planner::new(problem)
        .search(&index, &budget, &Watch::default())
        .map(|b| b.found.objective)
        .map_err(|e| e.to_string())
}

/// Best or better, within 0.1 %, but not suspiciously better: constraints may not get lost.
#[track_caller]
fn assert_best(found: f64, known: f64) {
    assert!(found <= known * 1.001, "{found} is worse than {known}");
    assert!(
        found >= known * 0.999,
        "{found} is better than {known}: a constraint is missing, or the table is old"
    );
}

#[test]
fn published_optimum_keeps_every_limit_with_two_wrist_twins() {
    let arm = arm();
    let p = problem(&arm, [1.0, 1.0, -1.0], Options::paper());
    let throws = PaperParameters::from_array(PUBLISHED).throws(&p);
    assert_eq!(throws.len(), 8);
    let feasible: Vec<_> = throws.iter().filter(|t| t.violation == 0.0).collect();
    assert_eq!(feasible.len(), 2);
    for t in &feasible {
        assert!((p.objective(&t.throw) - 35.0447).abs() < 1e-4, "{}", p.objective(&t.throw));
    }
    let listed = [0.199_999, 0.125_428, -1.856_562, 1.004_064, 1.387_908, 1.654_417];
    let rates = [1.358_402, -1.675_786, 0.482_325, -0.010_697, -0.986_023, 2.548_397];
    let twin = feasible
        .iter()
        .find(|t| t.throw.q_rad.iter().zip(listed).all(|(q, l)| (q - l).abs() < 2e-6))
        .expect("the listed posture is one of the twins");
    assert!(twin.throw.qd_rad_s.iter().zip(rates).all(|(q, l)| (q - l).abs() < 2e-6));
    let margins = Margins::of(&p, &twin.throw);
    assert!((margins.speed.min() - 0.36).abs() < 0.005, "64 % of the speed");
    assert!((margins.acceleration.min() - 0.10).abs() < 0.005, "90 % of the acceleration");
    let currents = margins.release_currents_a.expect("drives");
    for (a, listed) in currents.iter().zip([4.392, 9.780, 3.008, 0.041, 0.487, 0.401]) {
        assert!((a - listed).abs() < 6e-4, "{a} A, listed {listed} A");
    }
}

#[test]
fn parameters_survive_the_way_through_the_throw() {
    let arm = arm();
    let p = problem(&arm, [1.0, 1.0, -1.0], Options::paper());
    let throw = PaperParameters::from_array(PUBLISHED).throws(&p)[0].throw;
    let shoulder = Vector3::new(0.0, 0.0, 0.27);
    let back = PaperParameters::of(&arm, &shoulder, &throw).to_array();
    for (a, b) in back.iter().zip(PUBLISHED) {
        assert!((a - b).abs() < 1e-9, "{back:?}");
    }
}

#[test]
fn local_solve_from_the_published_point_ends_at_the_known_optimum() {
    let arm = arm();
    let p = problem(&arm, [1.0, 1.0, -1.0], Options::paper());
    let throw = PaperParameters::from_array(PUBLISHED).throws(&p)[0].throw;
    let found = Planner::new(&p).from_throw(&throw).expect("feasible start");
    assert!((found.objective - 31.699).abs() < 2e-3, "{}", found.objective);
}

#[test]
fn best_known_throws_are_found_from_the_table() {
    let arm = arm();
    for (target, known) in
        [([1.0, 1.0, -1.0], 31.264), ([1.5, 0.0, -0.5], 34.698), ([2.0, 0.0, -1.0], 38.237)]
    {
        assert_best(best(&problem(&arm, target, Options::paper()), 0).expect("in reach"), known);
    }
}

#[test]
fn a_clean_release_costs_what_it_is_known_to_cost() {
    let arm = arm();
    let p = problem(&arm, [1.0, 1.0, -1.0], Options { clean_release: true, ..Options::paper() });
    assert_best(best(&p, 160).expect("in reach"), 31.338);
}

#[test]
fn random_starts_succeed_without_any_table() {
    let arm = arm();
    let p = problem(&arm, [1.0, 1.0, -1.0], Options::paper());
    let planner = Planner::new(&p);
    let solved = (0..100).filter(|k| planner.random_start(11, *k).is_some()).count();
    assert!(solved >= 70, "{solved} of 100");
}

#[test]
fn a_target_beyond_all_throws_has_a_nearest_one_in_both_forms() {
    let arm = arm();
    let index = seeds::built_in(&arm);
    let free = Options { delay_windows: Vec::new(), null_delay: false, ..Options::best() };
    for (options, away) in [(Options::paper(), 2.7..3.2), (free, 0.6..1.0)] {
        let problem = Problem::new(&arm, Vector3::new(5.0, 0.0, 0.0), options).expect("valid");
        let budget = Budget { starts: 0, all: false, time: None, seed: 1 };
        let none = Planner::new(&problem).search(&index, &budget, &Watch::default()).expect_err("too far");
        let nearest = none.nearest.expect("the arm throws somewhere");
        assert!(away.contains(&nearest.distance_m), "{nearest:?}");
        assert!(!nearest.constraint.is_empty());
    }
}

#[test]
fn unreachable_targets_are_refused_with_the_nearest_reachable_one() {
    let arm = arm();
    let text = best(&problem(&arm, [2.0, 0.0, 0.0], Options::paper()), 4).expect_err("out of reach");
    assert!(
        text.starts_with("no throw reaches (2.000, 0.000, 0.000) m; the nearest target found in reach is"),
        "{text}"
    );
    assert!(text.contains("blocked by: "), "{text}");
}

#[test]
fn the_farthest_floor_target_is_where_it_is_known_to_be() {
    let arm = arm();
    let azimuth = |deg: f64, r: f64| {
        let (s, c) = deg.to_radians().sin_cos();
        [r * c, r * s, -1.0]
    };
    for deg in [0.0, 90.0] {
        assert!(
            best(&problem(&arm, azimuth(deg, 2.18), Options::paper()), 0).is_ok(),
            "2.180 m at {deg} deg"
        );
        assert!(
            best(&problem(&arm, azimuth(deg, 2.19), Options::paper()), 0).is_err(),
            "2.190 m at {deg} deg"
        );
    }
    // From a throw to 2.18 m, the target is pulled outwards along x until something blocks.
    let near = problem(&arm, [2.18, 0.0, -1.0], Options::paper());
    let budget = Budget { starts: 0, all: false, time: None, seed: 1 };
    let throw = Planner::new(&near)
        .search(&seeds::built_in(&arm), &budget, &Watch::default())
        .expect("in reach")
        .found
        .throw;
    let far = problem(&arm, [2.3, 0.0, -1.0], Options::paper());
    let nearest =
        Planner::new(&far).nearest_from_throw(&throw, [true, false, false]).expect("a nearest target");
    let farthest_m = 2.3 + nearest.shift_m.x;
    assert!((farthest_m - 2.186).abs() < 2e-3, "{farthest_m}");
}

#[test]
fn the_same_seed_gives_the_same_throw_on_any_number_of_threads() {
    let arm = arm();
    let p = problem(&arm, [1.2, 0.4, -0.8], Options::paper());
    let run = |threads: usize| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("pool").install(|| {
            let budget = Budget { starts: 24, all: false, time: None, seed: 3 };
            Planner::new(&p).search(&Index::default(), &budget, &Watch::default()).expect("in reach")
        })
    };
    assert_eq!(run(1), run(3));
}

#[test]
fn bad_targets_are_refused_by_name() {
    let arm = arm();
    let refused = |t: [f64; 3]| {
        Problem::new(&arm, Vector3::from(t), Options::paper()).expect_err("refused").to_string()
    };
    assert!(refused([f64::NAN, 0.0, 0.0]).contains("finite"));
    assert!(refused([1.0, 0.0, -1.5]).contains("below the floor"));
    assert!(refused([0.0, 0.0, -0.5]).contains("inside \"column\""));
    let reversed = Options {
        bounds: planner::plan::AskedBounds { flight_s: Some(2.0..=1.0), ..Default::default() },
        ..Options::paper()
    };
    let e = Problem::new(&arm, Vector3::new(1.0, 0.0, 0.0), reversed).expect_err("refused");
    assert!(e.to_string().contains("the time of flight runs from 2 to 1"), "{e}");
}

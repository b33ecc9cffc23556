//! Stored throws around a target, solved locally to it, are what they claim.

use nalgebra::Vector3;
use planner::plan::file::PlanFile;
use planner::plan::relaxation::{Kept, levels};
use planner::plan::rng::SplitMix64;
use planner::plan::search::kind_of;
use planner::plan::statistics::Noise;
use planner::plan::{Arm, Best, Budget, Options, Planner, Problem, Watch, seeds};
use planner::request::Request;
use planner::verify;

/// Stored throws that are tried.
const TRIES: usize = 6;

#[test]
fn throws_from_stored_ones_pass_the_check_by_other_means_and_the_same_table_gives_the_same_throw() {
    let arm = Arm::load("powercube6").unwrap();
    let index = seeds::built_in(&arm);
    let (mut reached, mut rng) = (0, SplitMix64::new(5));
    for _ in 0..60 {
        let azimuth = std::f64::consts::TAU * rng.unit();
        let range = 0.8 + 0.9 * rng.unit();
        let at = Vector3::new(range * azimuth.cos(), range * azimuth.sin(), -1.0 + 0.8 * rng.unit());
        let problem = Problem::new(&arm, at, Options::paper()).unwrap();
        let planner = Planner::new(&problem);
        let Some(found) = planner.from_index_quickly(&index, TRIES) else { continue };
        assert_eq!(planner.from_index_quickly(&index, TRIES), Some(found));
        reached += 1;
        let plan =
            PlanFile::of(&problem, &Best::alone(found), "powercube6", 1, &Noise::default(), None).unwrap();
        let report = verify::check(&arm, &plan);
        assert!(
            report.ok(),
            "target {at}: {:?}",
            report.findings.iter().filter(|f| !f.ok).collect::<Vec<_>>()
        );
    }
    // Ranges from 0.8 to 1.7 m are in reach of this arm, nearly all in the paper's form.
    assert!(reached >= 50, "{reached} of 60 targets reached");
}

/// One throw of the table in this many is solved again.
const SOLVED_AGAIN: usize = 53;

/// A row for the ball beside the fingers required 0.2 mm right after the release, where the scan required nothing.
/// It made one stored throw in twelve up to 12 % more expensive at its own target.
#[test]
fn a_stored_throw_solved_again_to_its_own_target_costs_the_same() {
    let arm = Arm::load("powercube6").unwrap();
    let index = seeds::built_in(&arm);
    for (_, options) in levels(&Options::best(), Kept::default()) {
        let kind = kind_of(&options);
        let stored: Vec<_> =
            index.records().iter().filter(|r| r.kind == kind).step_by(SOLVED_AGAIN).collect();
        assert!(stored.len() >= 20, "{} throws of kind {kind}", stored.len());
        for record in &stored {
            let target = Vector3::new(record.range_m, 0.0, record.height_m);
            let problem = Problem::new(&arm, target, options.clone()).unwrap();
            let again = Planner::new(&problem).from_record(record);
            // Rows keep a little more than scans require: 0.2 mm to other bodies than the hand, a thousandth of a
            // current. A throw that is not the cheapest of its cell is at most 6 % more expensive, and may lead to
            // the cheapest.
            assert!(
                again.is_some_and(|found| (0.94..1.005).contains(&(found.objective / record.objective))),
                "kind {kind} to ({}, {}): {:?} instead of {}",
                record.range_m,
                record.height_m,
                again.map(|found| found.objective),
                record.objective
            );
        }
    }
}

const POWERCUBE6: &str = include_str!("../../../robots/powercube6.toml");

fn powercube6_with(now: &str, edited: &str) -> Arm {
    assert!(POWERCUBE6.contains(now));
    Arm::from_toml("edited.toml", &POWERCUBE6.replacen(now, edited, 1)).unwrap()
}

/// Targets that searches from random starts alone missed by 3 to 46 %, with prices that are known.
const MISSED: [([f64; 3], f64); 3] = [
    ([1.6999, 0.9977, -0.9811], 32.79),
    ([0.8912, -1.8064, -1.0], 32.83),
    ([1.4838, 0.7721, -0.5368], 31.80),
];

fn searched(arm: &Arm, target: [f64; 3], seed: u64) -> f64 {
    let request = Request {
        target: target.into(),
        options: &Options::best(),
        kept: Kept::default(),
        quick: None,
        budget: Budget { seed, ..Budget::default() },
    };
    request.search(arm, &seeds::built_in(arm), &Watch::default()).unwrap().best.found.objective
}

#[test]
fn a_robot_with_one_limit_or_mass_edited_starts_from_the_stored_throws_of_the_unedited_one() {
    let limit = powercube6_with("velocity_max_deg_s = 149", "velocity_max_deg_s = 148.9");
    let mass = powercube6_with("ball_mass_kg = 0", "ball_mass_kg = 0.3");
    let missed = MISSED.map(|(target, known)| (&limit, target, known));
    for (arm, target, known) in missed.into_iter().chain([(&mass, [1.8, 0.3, -0.8], 32.40)]) {
        let found = searched(arm, target, 1);
        assert!(found < 1.01 * known, "{target:?}: {found}, known {known}");
    }
}

#[test]
fn only_a_robot_with_the_same_frames_lends_its_stored_throws() {
    let lender = |arm: &Arm| seeds::built_in(arm).lender();
    assert_eq!(
        lender(&powercube6_with("range_deg = [-240, 60]", "range_deg = [-200, 60]")),
        Some("powercube6")
    );
    assert_eq!(lender(&powercube6_with("a_m = 0.29", "a_m = 0.30")), Some("powercube6"));
    assert_eq!(lender(&Arm::load("powercube6").unwrap()), None);
    for other in [
        powercube6_with("a_m = 0.29", "a_m = 0.40"),
        Arm::from_toml("x13.toml", include_str!("data/powercube6_x13.toml")).unwrap(),
        Arm::from_toml("ur5.toml", include_str!("../../../robots/model/tests/data/ur5.toml")).unwrap(),
    ] {
        let index = seeds::built_in(&other);
        assert!(index.lender().is_none() && index.records().is_empty(), "{}", other.name());
    }
}

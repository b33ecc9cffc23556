//! Stored throws around a target, solved locally to it, are what they claim.

use nalgebra::Vector3;
use planner::plan::file::PlanFile;
use planner::plan::ladder::{Kept, rungs};
use planner::plan::rng::SplitMix64;
use planner::plan::search::kind_of;
use planner::plan::statistics::Noise;
use planner::plan::{Arm, Best, Options, Planner, Problem, seeds};
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

/// One throw of the table in so many is solved again.
const SOLVED_AGAIN: usize = 53;

/// A row for the ball beside the fingers asked for 0.2 mm right after the release, where the look along the motion asked for
/// nothing. It made one stored throw in twelve up to 12 % dearer at its own target.
#[test]
fn a_stored_throw_solved_again_to_its_own_target_costs_the_same() {
    let arm = Arm::load("powercube6").unwrap();
    let index = seeds::built_in(&arm);
    for (_, options) in rungs(&Options::best(), Kept::default()) {
        let kind = kind_of(&options);
        let stored: Vec<_> =
            index.records().iter().filter(|r| r.kind == kind).step_by(SOLVED_AGAIN).collect();
        assert!(stored.len() >= 20, "{} throws of kind {kind}", stored.len());
        for record in &stored {
            let target = Vector3::new(record.range_m, 0.0, record.height_m);
            let problem = Problem::new(&arm, target, options.clone()).unwrap();
            let again = Planner::new(&problem).from_record(record);
            // Rows keep a little more than looks along the motion ask for: 0.2 mm to other bodies than the hand, a thousandth of a
            // current. A throw that is not the cheapest of its cell is at most 6 % dearer, and may lead to the cheapest.
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

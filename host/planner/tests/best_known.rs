//! The default search of arms of other sizes and kinds, without any table, against the best of 2 000 random starts.
//!
//! The example `best_known` makes the files, the example `search_quality` compares all their rows; here are the first.

use nalgebra::Vector3;
use planner::plan::problem::{Options, Problem};
use planner::plan::search::{Budget, Planner, Watch};
use planner::store::Index;
use robot_model::RobotModel;

/// Rows with a throw that are tried per arm.
const ROWS: usize = 2;
/// A price this much above the best known one is as good as that.
const GAP: f64 = 1.02;

/// Target, place in the ladder of options, and objective of the rows with a throw.
fn known(text: &str) -> Vec<(Vector3<f64>, usize, f64)> {
    let rows = text.lines().skip(1).map(|line| line.split(',').collect::<Vec<_>>());
    let number = |text: &str| text.parse::<f64>().expect("a number");
    rows.filter(|f| !f[4].is_empty())
        .map(|f| {
            let target = Vector3::new(number(f[1]), number(f[2]), number(f[3]));
            (target, f[4].parse().expect("0 to 2"), number(f[5]))
        })
        .collect()
}

/// The default form, without limits of the landing's shift, and without nulling: as `plan throw` goes down.
fn search<const N: usize>(arm: &RobotModel<N>, target: Vector3<f64>) -> Option<(usize, f64)> {
    let nulled = Options { delay_windows: Vec::new(), ..Options::best() };
    let ladder = [Options::best(), nulled.clone(), Options { null_delay: false, ..nulled }];
    ladder.into_iter().enumerate().find_map(|(rung, options)| {
        let problem = Problem::new(arm, target, options).expect("valid");
        let best = Planner::new(&problem).attempt(&Index::default(), &Budget::default(), &Watch::default());
        Some((rung, best.ok()?.found.objective))
    })
}

fn finds_what_long_searches_find<const N: usize>(arm: &RobotModel<N>, file: &str) {
    let known = known(file);
    assert!(known.len() >= ROWS, "{}: {} rows with a throw", arm.name(), known.len());
    for (target, rung, objective) in known.into_iter().take(ROWS) {
        let (found_rung, found) =
            search(arm, target).unwrap_or_else(|| panic!("{}: {target} refused", arm.name()));
        let told = format!(
            "{} to {target}: {found} in rung {found_rung}, known {objective} in rung {rung}",
            arm.name()
        );
        assert!(found_rung <= rung, "{told}");
        assert!(found_rung < rung || found <= objective * GAP, "{told}");
    }
}

fn fixture<const N: usize>(name: &str, text: &str) -> RobotModel<N> {
    RobotModel::from_toml(name, text).expect("the fixture loads")
}

#[test]
fn an_arm_of_larger_links_is_searched_within_its_own_bounds() {
    let arm = fixture::<6>("powercube6_x13", include_str!("data/powercube6_x13.toml"));
    finds_what_long_searches_find(&arm, include_str!("../benches/best_known/powercube6_x13.csv"));
}

#[test]
fn an_industrial_robot_is_searched_within_its_own_bounds() {
    let arm = RobotModel::<6>::load("kr16_2").expect("built in");
    finds_what_long_searches_find(&arm, include_str!("../benches/best_known/kr16_2.csv"));
}

#[test]
fn an_arm_without_closed_form_is_searched_as_well_as_by_many_starts() {
    let arm = fixture::<6>("ur5", include_str!("../../../robots/model/tests/data/ur5.toml"));
    finds_what_long_searches_find(&arm, include_str!("../benches/best_known/ur5.csv"));
}

#[test]
fn an_arm_of_seven_joints_is_searched_as_well_as_by_many_starts() {
    let arm = fixture::<7>("iiwa7", include_str!("data/iiwa7.toml"));
    finds_what_long_searches_find(&arm, include_str!("../benches/best_known/iiwa7.csv"));
}

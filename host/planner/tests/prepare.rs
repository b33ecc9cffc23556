//! Tables of stored throws: made in steps that can be interrupted, for any arm.

use planner::plan::prepare::{Grid, Preparation};
use planner::plan::problem::Options;
use planner::store::{Record, file, robot_fingerprint};
use robot_model::RobotModel;

const X13: &str = include_str!("data/powercube6_x13.toml");
const UR5: &str = include_str!("../../../robots/model/tests/data/ur5.toml");

const GRID: Grid =
    Grid { step_m: 0.4, range_max_m: 1.6, height_max_m: 0.3, starts: 3, keep: 2, sweeps: 1, trials: 4 };

fn stopped_and_continued(name: &str, text: &str) {
    let arm = RobotModel::from_toml(name, text).expect("the fixture loads");
    let plain = Options { null_delay: false, delay_windows: Vec::new(), ..Options::best() };
    let preparation = Preparation::new(&arm, vec![plain], GRID, 1);
    let at_once = (0..preparation.steps())
        .fold(Vec::new(), |records, step| preparation.step(step, records, &|| false).expect("not stopped"));
    assert!(at_once.len() >= 3, "{name}: {} throws", at_once.len());
    // Stopped in every step, saved as a file, read and continued.
    let robot = robot_fingerprint(&arm);
    let mut records: Vec<Record> = Vec::new();
    for step in 0..preparation.steps() {
        assert_eq!(preparation.step(step, records.clone(), &|| true), None);
        let bytes = file::to_bytes(robot, &records);
        let read = file::parse(&bytes, robot, arm.n()).expect("its own bytes");
        records = preparation.step(step, read, &|| false).expect("not stopped");
    }
    assert_eq!(records, at_once, "{name}");
}

#[test]
fn a_preparation_that_is_stopped_in_every_step_makes_the_same_table() {
    stopped_and_continued("powercube6_x13", X13);
    stopped_and_continued("ur5", UR5);
}

//! Throws of arms without a closed form, and of arms with other than six joints, checked by the independent verifier.

use nalgebra::Vector3;
use planner::plan::file::PlanFile;
use planner::plan::problem::{Options, Problem, ProblemError};
use planner::plan::search::{Budget, Planner, Watch};
use planner::plan::statistics::Noise;
use planner::store::Index;
use planner::verify;
use robot_model::RobotModel;

const UR5: &str = include_str!("../../../robots/model/tests/data/ur5.toml");
const IIWA7: &str = include_str!("data/iiwa7.toml");
const YOUBOT5: &str = include_str!("data/youbot5.toml");

/// Plans a throw without nulling (a small search finds those), writes and reads the file, and checks it.
fn throws_to(name: &str, text: &str, target: [f64; 3]) {
    let arm = RobotModel::from_toml(name, text).expect("the fixture loads");
    let options = Options { null_delay: false, delay_windows: Vec::new(), ..Options::best() };
    let problem = Problem::new(&arm, Vector3::from(target), options).expect("valid");
    let budget = Budget { starts: 48, all: false, time: None, seed: 1 };
    let best = Planner::new(&problem)
        .search(&Index::default(), &budget, &Watch::default())
        .unwrap_or_else(|e| panic!("{name} to {target:?}: {e}"));
    let plan = PlanFile::of(&problem, &best, name, 1, &Noise::default(), None).expect("it lands");
    assert_eq!(plan.motion.joints.len(), arm.n());
    let read = PlanFile::from_json(name.as_ref(), &plan.to_json()).expect("reads its own file");
    assert_eq!(read, plan);
    read.require_robot(name.as_ref(), &arm).expect("the same robot");
    let report = verify::check(&arm, &read);
    let failed: Vec<_> = report.findings.iter().filter(|f| f.enforced && !f.ok).collect();
    assert!(failed.is_empty(), "{name} to {target:?}: {failed:?}");
    // The check can fail: 1 mm beside the target is not a hit.
    let mut beside = read;
    beside.target.position_m[0] += 1e-3;
    assert!(!verify::check(&arm, &beside).ok());
}

#[test]
fn ur5_without_closed_form_throws_and_the_verifier_agrees() {
    throws_to("ur5", UR5, [1.4, 0.3, -0.7]);
    throws_to("ur5", UR5, [-0.5, 1.2, -0.4]);
}

#[test]
fn seven_joints_throw_and_the_verifier_agrees() {
    throws_to("iiwa7", IIWA7, [1.3, 0.2, -0.7]);
    throws_to("iiwa7", IIWA7, [-0.4, -1.2, -0.5]);
}

#[test]
fn five_joints_throw_and_the_verifier_agrees() {
    throws_to("youbot5", YOUBOT5, [0.8, 0.1, -0.7]);
}

#[test]
fn four_joints_throw_and_the_verifier_agrees() {
    let pincher = robot_model::built_in_text("pincher4").expect("built in");
    throws_to("pincher4", pincher, [1.2, 0.4, 0.1]);
}

#[test]
fn the_papers_form_is_refused_for_fewer_than_six_joints_with_a_form_that_works() {
    let arm = RobotModel::from_toml("youbot5", YOUBOT5).expect("loads");
    let refused = Problem::new(&arm, Vector3::new(0.8, 0.1, -0.7), Options::paper()).expect_err("refused");
    assert!(matches!(refused, ProblemError::FormNeedsSixJoints { joints: 5, .. }));
    assert!(refused.to_string().contains("use --form best"), "{refused}");
    assert!(Problem::new(&arm, Vector3::new(0.8, 0.1, -0.7), Options::best()).is_ok());
}

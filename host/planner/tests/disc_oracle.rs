//! Kinematics of paper 001 against Pinocchio: `oracle/disc.py` made the vectors, CI makes them again.

use nalgebra::{Matrix4, SMatrix};
use planner::disc::Joints;
use planner::disc::arm::DiscArm;
use planner::disc::screws;
use robot_model::RobotModel;
use serde_json::Value;

fn numbers(value: &Value) -> Vec<f64> {
    match value {
        Value::Array(items) => items.iter().flat_map(numbers).collect(),
        other => vec![other.as_f64().expect("a number")],
    }
}

fn matrix<const R: usize, const C: usize>(state: &Value, key: &str) -> SMatrix<f64, R, C> {
    SMatrix::from_row_slice(&numbers(&state[key]))
}

#[test]
fn dh_exponentials_and_both_jacobians_agree_with_pinocchio() {
    let arm = DiscArm::new(RobotModel::load("pincher4").expect("built in")).expect("the arm of paper 001");
    let golden: Value = serde_json::from_str(include_str!("data/disc_kinematics.json")).expect("JSON");
    let states = golden["states"].as_array().expect("a list");
    assert_eq!(states.len(), 8);
    for state in states {
        let q = Joints::from_vec(numbers(&state["q"]));
        let pose: Matrix4<f64> = matrix(state, "pose");
        let mut printed = Matrix4::identity();
        printed.fixed_view_mut::<3, 3>(0, 0).copy_from(&arm.hand_axes(&q));
        printed.fixed_view_mut::<3, 1>(0, 3).copy_from(&arm.terminal_point(&q));
        for (what, ours) in [
            ("DH table", arm.model.ee_at(&q.into()).to_matrix()),
            ("equation (3)", printed),
            ("exponentials", screws::pose(&arm.size, &q)),
        ] {
            assert!((ours - pose).amax() < 1e-12, "{what}: {:e}", (ours - pose).amax());
        }
        let jacobian: SMatrix<f64, 6, 4> = matrix(state, "jacobian");
        for (what, ours) in [("equation (5)", arm.jacobian(&q)), ("screws", screws::jacobian(&arm.size, &q))]
        {
            assert!((ours - jacobian).amax() < 1e-12, "{what}: {:e}", (ours - jacobian).amax());
        }
        let rpy_jacobian: SMatrix<f64, 6, 4> = matrix(state, "rpy_jacobian");
        let ours = arm.rpy_jacobian(&q).expect("away from ±90°");
        assert!((ours - rpy_jacobian).amax() < 1e-11, "{:e}", (ours - rpy_jacobian).amax());
    }
}

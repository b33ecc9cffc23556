//! Kinematics and dynamics against vectors from Pinocchio, checked by MuJoCo, made from our URDF export.
//!
//! `oracle/golden.py` made the files in `tests/data`; its text describes how to make them again.

use nalgebra::{DMatrix, SMatrix};
use robot_model::{JointVec, RobotModel};
use serde_json::Value;

/// Both sides work in double precision with other operation orders; entries are at most a few hundred.
const TOLERANCE: f64 = 1e-12;

fn numbers(value: &Value) -> Vec<f64> {
    match value {
        Value::Array(items) => items.iter().flat_map(numbers).collect(),
        other => vec![other.as_f64().expect("a number")],
    }
}

fn vector(state: &Value, key: &str) -> JointVec {
    JointVec::from_slice(&numbers(&state[key]))
}

fn fixed<const R: usize, const C: usize>(m: SMatrix<f64, R, C>) -> DMatrix<f64> {
    DMatrix::from_column_slice(R, C, m.as_slice())
}

fn column(v: &JointVec) -> DMatrix<f64> {
    DMatrix::from_column_slice(v.len(), 1, v)
}

/// Compares with the matrix of a key, given row by row.
#[track_caller]
fn agree(what: &str, ours: impl Into<DMatrix<f64>>, state: &Value, key: &str) {
    let ours: DMatrix<f64> = ours.into();
    let golden = numbers(&state[key]);
    assert_eq!(ours.len(), golden.len(), "{what}");
    let golden = DMatrix::from_row_slice(ours.nrows(), ours.ncols(), &golden);
    let off = (&ours - &golden).amax() / (1.0 + golden.amax());
    assert!(off < TOLERANCE, "{what} is off by {off:e}:\n{ours}{golden}");
}

fn check(name: &str, text: &str) {
    let robot: RobotModel = RobotModel::load(name).expect("built in");
    let golden: Value = serde_json::from_str(text).expect("JSON");
    let states = golden["states"].as_array().expect("a list");
    assert!(states.len() >= 5, "{} states", states.len());
    for state in states {
        let (q, qd, qdd) = (vector(state, "q"), vector(state, "qd"), vector(state, "qdd"));
        let frames = robot.fk(&q);
        agree("end effector", fixed(robot.ee(&frames).to_matrix()), state, "x_we");
        let ball = robot.ball(&frames);
        agree("release frame", fixed(ball.to_matrix()), state, "x_wb");
        let jacobian = frames.jacobian(&ball.pos);
        agree("Jacobian", jacobian, state, "jacobian");
        agree("J̇ q̇", fixed(frames.bias_acceleration(&jacobian, &qd)), state, "bias_acceleration");
        agree("torques", column(&robot.inverse_dynamics(&q, &qd, &qdd)), state, "tau");
        agree("gravity torques", column(&robot.gravity_torques(&q)), state, "gravity");
        agree("mass matrix", robot.mass_matrix(&q), state, "mass");
        let gradient = robot.inverse_dynamics_gradient(&q, &qd, &qdd);
        agree("torques of the gradient", column(&gradient.tau), state, "tau");
        agree("∂τ/∂q", gradient.by_q, state, "tau_by_q");
        agree("∂τ/∂q̇", gradient.by_qd, state, "tau_by_qd");
        agree("∂τ/∂q̈", gradient.by_qdd, state, "mass");
        let back = robot.forward_dynamics(&q, &qd, &vector(state, "tau"));
        // Solving with the mass matrix loses as many digits as it is badly conditioned.
        assert!((back - qdd).amax() < 1e-7, "forward dynamics: {}", back - qdd);
    }
}

#[test]
fn powercube6_agrees_with_pinocchio() {
    check("powercube6", include_str!("data/powercube6.json"));
}

#[test]
fn kr16_2_agrees_with_pinocchio() {
    check("kr16_2", include_str!("data/kr16_2.json"));
}

#[test]
fn pincher4_agrees_with_pinocchio() {
    check("pincher4", include_str!("data/pincher4.json"));
}

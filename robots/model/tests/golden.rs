//! Kinematics and dynamics against vectors from Pinocchio, checked by MuJoCo, made from our URDF export.
//!
//! `oracle/golden.py` made the files in `tests/data`; it says how to make them again.

use nalgebra::SMatrix;
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

fn vector<const N: usize>(state: &Value, key: &str) -> JointVec<N> {
    JointVec::from_vec(numbers(&state[key]))
}

fn matrix<const R: usize, const C: usize>(state: &Value, key: &str) -> SMatrix<f64, R, C> {
    SMatrix::from_row_slice(&numbers(&state[key]))
}

#[track_caller]
fn agree<const R: usize, const C: usize>(what: &str, ours: &SMatrix<f64, R, C>, golden: &SMatrix<f64, R, C>) {
    let off = (ours - golden).amax() / (1.0 + golden.amax());
    assert!(off < TOLERANCE, "{what} is off by {off:e}:\n{ours}{golden}");
}

fn check<const N: usize>(name: &str, text: &str) {
    let robot: RobotModel<N> = RobotModel::load(name).expect("built in");
    let golden: Value = serde_json::from_str(text).expect("JSON");
    let states = golden["states"].as_array().expect("a list");
    assert!(states.len() >= 5, "{} states", states.len());
    for state in states {
        let (q, qd, qdd) = (vector::<N>(state, "q"), vector::<N>(state, "qd"), vector::<N>(state, "qdd"));
        let frames = robot.fk(&q);
        agree("end effector", &robot.ee(&frames).to_matrix(), &matrix(state, "x_we"));
        let ball = robot.ball(&frames);
        agree("release frame", &ball.to_matrix(), &matrix(state, "x_wb"));
        let jacobian = frames.jacobian(&ball.pos);
        agree("Jacobian", &jacobian, &matrix(state, "jacobian"));
        agree("J̇ q̇", &frames.bias_acceleration(&jacobian, &qd), &matrix(state, "bias_acceleration"));
        agree("torques", &robot.inverse_dynamics(&q, &qd, &qdd), &vector(state, "tau"));
        agree("gravity torques", &robot.gravity_torques(&q), &vector(state, "gravity"));
        agree("mass matrix", &robot.mass_matrix(&q), &matrix(state, "mass"));
        let gradient = robot.inverse_dynamics_gradient(&q, &qd, &qdd);
        agree("torques of the gradient", &gradient.tau, &vector(state, "tau"));
        agree("∂τ/∂q", &gradient.by_q, &matrix(state, "tau_by_q"));
        agree("∂τ/∂q̇", &gradient.by_qd, &matrix(state, "tau_by_qd"));
        agree("∂τ/∂q̈", &gradient.by_qdd, &matrix(state, "mass"));
        let back = robot.forward_dynamics(&q, &qd, &vector(state, "tau"));
        // Solving with the mass matrix loses as many digits as it is badly conditioned.
        assert!((back - qdd).amax() < 1e-7, "forward dynamics: {}", back - qdd);
    }
}

#[test]
fn powercube6_agrees_with_pinocchio() {
    check::<6>("powercube6", include_str!("data/powercube6.json"));
}

#[test]
fn kr16_2_agrees_with_pinocchio() {
    check::<6>("kr16_2", include_str!("data/kr16_2.json"));
}

#[test]
fn pincher4_agrees_with_pinocchio() {
    check::<4>("pincher4", include_str!("data/pincher4.json"));
}

//! The Jacobian of the PowerCube arm and its derivatives against central differences of poses.

use std::sync::LazyLock;

use nalgebra::{DMatrix, DVector, Vector3, Vector6};
use proptest::prelude::*;
use robot_model::jacobian::{joint_rates, manipulability, singular_values};
use robot_model::{Jacobian, JointVec, RobotModel};

static ARM: LazyLock<RobotModel> =
    LazyLock::new(|| RobotModel::load("powercube6").expect("the built-in robot loads"));

fn arm() -> &'static RobotModel {
    &ARM
}

/// Twist of the ball from central differences of its pose along `q + t qd`.
fn numeric_twist(arm: &RobotModel, q: &JointVec, qd: &JointVec) -> Vector6<f64> {
    let h = 1e-6;
    let ball = |t: f64| arm.ball(&arm.fk(&(q + qd * t)));
    let (a, b) = (ball(-h), ball(h));
    let v = (b.pos - a.pos) / (2.0 * h);
    let spin = (b.rot - a.rot) / (2.0 * h) * ball(0.0).rot.transpose();
    let w =
        Vector3::new(spin[(2, 1)] - spin[(1, 2)], spin[(0, 2)] - spin[(2, 0)], spin[(1, 0)] - spin[(0, 1)])
            * 0.5;
    Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z)
}

fn ball_jacobian(arm: &RobotModel, q: &JointVec) -> Jacobian {
    let frames = arm.fk(q);
    frames.jacobian(&arm.ball(&frames).pos)
}

fn determinant(jacobian: &Jacobian) -> f64 {
    jacobian.lu().map_or(0.0, |lu| lu.determinant())
}

fn joint_angles() -> impl Strategy<Value = JointVec> {
    prop::array::uniform6(-3.0..3.0_f64).prop_map(JointVec::from)
}

proptest! {
    #[test]
    fn maps_joint_speeds_to_the_twist_of_the_ball(q in joint_angles(), qd in joint_angles()) {
        let arm = arm();
        let off = ball_jacobian(arm, &q) * qd - numeric_twist(arm, &q, &qd);
        prop_assert!(off.amax() < 1e-8, "{off}");
    }

    #[test]
    fn its_rate_is_the_derivative_along_the_motion(q in joint_angles(), qd in joint_angles()) {
        let arm = arm();
        let frames = arm.fk(&q);
        let jacobian = frames.jacobian(&arm.ball(&frames).pos);
        let h = 1e-6;
        let dense = |q: JointVec| DMatrix::from(ball_jacobian(arm, &q));
        let numeric = (dense(q + qd * h) - dense(q - qd * h)) / (2.0 * h);
        let rate = DMatrix::from(frames.jacobian_rate(&jacobian, &qd));
        prop_assert!((&rate - &numeric).amax() < 1e-8, "{}", rate - numeric);
        prop_assert!((DVector::from_column_slice(frames.bias_acceleration(&jacobian, &qd).as_slice()) - numeric * DVector::from_column_slice(&qd)).amax() < 1e-7);
    }

    #[test]
    fn its_gradient_is_the_derivative_joint_by_joint(q in joint_angles(), r in joint_angles()) {
        let arm = arm();
        let frames = arm.fk(&q);
        let jacobian = frames.jacobian(&arm.ball(&frames).pos);
        let gradient = frames.twist_gradient(&jacobian, &r);
        let h = 1e-6;
        for k in 0..6 {
            let mut step = JointVec::zeros(6);
            step[k] = h;
            let numeric = (ball_jacobian(arm, &(q + step)) * r - ball_jacobian(arm, &(q - step)) * r) / (2.0 * h);
            prop_assert!((Vector6::from_fn(|i, _| gradient[(i, k)]) - numeric).amax() < 1e-8, "joint {k}");
        }
    }

    #[test]
    fn joint_rates_give_the_twist_back(q in joint_angles(), twist in joint_angles()) {
        let arm = arm();
        let jacobian = ball_jacobian(arm, &q);
        prop_assume!(determinant(&jacobian).abs() > 1e-4);
        let twist = Vector6::from(twist.array());
        let qd = joint_rates(&jacobian, &twist).expect("regular");
        prop_assert!((jacobian * qd - twist).amax() < 1e-9);
    }
}

#[test]
fn determinant_at_the_ball_of_state_a() {
    let q = JointVec::from([30.0, -40.0, -110.0, 50.0, 70.0, -20.0].map(f64::to_radians));
    let jacobian = ball_jacobian(arm(), &q);
    assert!((determinant(&jacobian) - 0.0322486).abs() < 6e-8, "{}", determinant(&jacobian));
    assert!((manipulability(&jacobian) - 0.0322486).abs() < 6e-8);
    let values = singular_values(&jacobian);
    assert!(values.len() == 6 && values.is_sorted_by(|a, b| a >= b) && values[5] > 0.01);
}

#[test]
fn a_straight_wrist_has_no_inverse() {
    let q = JointVec::from([0.3, -1.0, -1.5, 0.4, 0.0, 0.2]);
    let jacobian = ball_jacobian(arm(), &q);
    assert!(joint_rates(&jacobian, &Vector6::new(0.0, 0.0, 0.0, 1.0, 0.0, 0.0)).is_none());
    assert!(manipulability(&jacobian) < 1e-15);
}

#[test]
fn later_joints_do_not_move_an_earlier_link() {
    let arm = arm();
    let frames = arm.fk(&JointVec::from([0.1, -0.8, -1.2, 0.4, 0.5, 0.6]));
    let jacobian = frames.jacobian_on_link(2, &Vector3::new(0.3, 0.2, 0.6));
    assert!(
        (3..6).all(|k| jacobian.linear(k) == Vector3::zeros() && jacobian.angular(k) == Vector3::zeros())
            && (0..3).all(|k| jacobian.angular(k).norm() > 0.1)
    );
}

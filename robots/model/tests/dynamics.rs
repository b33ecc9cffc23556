//! Identities of rigid-body dynamics, on the PowerCube arm.

use std::sync::LazyLock;

use nalgebra::{DMatrix, Vector3};
use proptest::prelude::*;
use robot_model::linalg::SquareMatrix;
use robot_model::{JointVec, RobotModel};

static ARM: LazyLock<RobotModel> =
    LazyLock::new(|| RobotModel::load("powercube6").expect("the built-in robot loads"));

fn arm() -> &'static RobotModel {
    &ARM
}

fn six(limit: f64) -> impl Strategy<Value = JointVec> {
    prop::array::uniform6(-limit..limit).prop_map(JointVec::from)
}

proptest! {
    #[test]
    fn torque_is_mass_times_acceleration_plus_bias(q in six(3.2), qd in six(4.0), qdd in six(20.0)) {
        let arm = arm();
        let sum = arm.mass_matrix(&q) * qdd + arm.bias_torques(&q, &qd);
        prop_assert!((arm.inverse_dynamics(&q, &qd, &qdd) - sum).amax() < 1e-11);
    }

    #[test]
    fn mass_matrix_is_symmetric_positive_definite(q in six(3.2)) {
        let mass = arm().mass_matrix(&q);
        let mass = DMatrix::from(mass);
        prop_assert!(mass == mass.transpose());
        let moments = mass.symmetric_eigenvalues();
        // The smallest is the spin of the hand about joint 6, the largest the stretched arm about joints 1 and 2.
        prop_assert!(moments.min() > 1e-5 && moments.max() < 10.0, "{moments}");
    }

    #[test]
    fn forward_dynamics_undoes_inverse_dynamics(q in six(3.2), qd in six(4.0), qdd in six(20.0)) {
        let arm = arm();
        let back = arm.forward_dynamics(&q, &qd, &arm.inverse_dynamics(&q, &qd, &qdd));
        prop_assert!((back - qdd).amax() < 1e-7, "{}", back - qdd);
    }

    #[test]
    fn power_of_the_torques_is_the_rate_of_energy(q in six(3.2), qd in six(3.0), qdd in six(10.0)) {
        let arm = arm();
        let h = 1e-5;
        // Along q + qd t + qdd t²/2, which has the state (q, qd, qdd) at t = 0.
        let energy = |t: f64| {
            let q_t = q + qd * t + qdd * (0.5 * t * t);
            let qd_t = qd + qdd * t;
            arm.kinetic_energy_j(&q_t, &qd_t) + arm.potential_energy_j(&q_t)
        };
        let rate = (energy(h) - energy(-h)) / (2.0 * h);
        let power = qd.dot(&arm.inverse_dynamics(&q, &qd, &qdd));
        prop_assert!((rate - power).abs() < 1e-5 * (1.0 + power.abs()), "{rate} {power}");
    }

    #[test]
    fn coriolis_forces_do_no_work(q in six(3.2), qd in six(3.0)) {
        // q̇ᵀ (Ṁ - 2C) q̇ = 0 holds for every factorisation of the Coriolis torque C q̇.
        let arm = arm();
        let h = 1e-6;
        let rate = (arm.mass_matrix(&(q + qd * h)) * qd - arm.mass_matrix(&(q - qd * h)) * qd) / (2.0 * h);
        let coriolis = arm.bias_torques(&q, &qd) - arm.gravity_torques(&q);
        let work = qd.dot(&(rate - coriolis * 2.0));
        prop_assert!(work.abs() < 1e-6, "{work:e}");
    }

    #[test]
    fn exact_derivatives_agree_with_central_differences(q in six(3.2), qd in six(3.0), qdd in six(10.0)) {
        let arm = arm();
        let exact = arm.inverse_dynamics_gradient(&q, &qd, &qdd);
        prop_assert!((exact.tau - arm.inverse_dynamics(&q, &qd, &qdd)).amax() < 1e-11);
        prop_assert!((DMatrix::from(exact.by_qdd) - DMatrix::from(arm.mass_matrix(&q))).amax() < 1e-12);
        let h = 1e-6;
        for j in 0..6 {
            let mut e = JointVec::zeros(6);
            e[j] = h;
            let by_q = (arm.inverse_dynamics(&(q + e), &qd, &qdd) - arm.inverse_dynamics(&(q - e), &qd, &qdd)) / (2.0 * h);
            let by_qd = (arm.inverse_dynamics(&q, &(qd + e), &qdd) - arm.inverse_dynamics(&q, &(qd - e), &qdd)) / (2.0 * h);
            let off = |column: &SquareMatrix, by: JointVec| (JointVec::from_fn(6, |i| column[(i, j)]) - by).amax();
            prop_assert!(off(&exact.by_q, by_q) < 2e-7, "q{j}: {}", off(&exact.by_q, by_q));
            prop_assert!(off(&exact.by_qd, by_qd) < 2e-7, "qd{j}: {}", off(&exact.by_qd, by_qd));
        }
    }

    #[test]
    fn a_held_ball_adds_its_weight(q in six(3.2), mass_kg in 0.01..2.0_f64) {
        let arm = arm();
        let at = arm.end_effector().transform_point(&arm.gripper().x_eb.pos);
        let loaded = arm.clone().with_inertias(|i, inertia| {
            if i == 5 { inertia.with_point_mass(mass_kg, &at).expect("positive mass") } else { *inertia }
        });
        let extra = loaded.gravity_torques(&q) - arm.gravity_torques(&q);
        let frames = arm.fk(&q);
        let weight = Vector3::new(0.0, 0.0, -9.81 * mass_kg);
        let jacobian = frames.jacobian(&arm.ball(&frames).pos);
        prop_assert!((extra + JointVec::from_fn(6, |k| jacobian.linear(k).dot(&weight))).amax() < 1e-12);
        let more = DMatrix::from(loaded.mass_matrix(&q)) - DMatrix::from(arm.mass_matrix(&q));
        let of_point = DMatrix::from_fn(6, 6, |i, k| jacobian.linear(i).dot(&jacobian.linear(k)) * mass_kg);
        prop_assert!((more - of_point).amax() < 1e-12);
    }
}

#[test]
fn a_free_swing_keeps_its_energy() {
    let arm = arm();
    let mut q = JointVec::from([0.3, -1.0, -1.5, 0.4, 0.7, 0.2]);
    let mut qd = JointVec::zeros(6);
    let energy = |q: &JointVec, qd: &JointVec| arm.kinetic_energy_j(q, qd) + arm.potential_energy_j(q);
    let start = energy(&q, &qd);
    let h = 2e-4;
    let accel = |q: &JointVec, qd: &JointVec| arm.forward_dynamics(q, qd, &JointVec::zeros(6));
    let mut fastest = 0.0_f64;
    for _ in 0..2500 {
        let (k1, l1) = (qd, accel(&q, &qd));
        let (k2, l2) = (qd + l1 * (h / 2.0), accel(&(q + k1 * (h / 2.0)), &(qd + l1 * (h / 2.0))));
        let (k3, l3) = (qd + l2 * (h / 2.0), accel(&(q + k2 * (h / 2.0)), &(qd + l2 * (h / 2.0))));
        let (k4, l4) = (qd + l3 * h, accel(&(q + k3 * h), &(qd + l3 * h)));
        q += (k1 + (k2 + k3) * 2.0 + k4) * (h / 6.0);
        qd += (l1 + (l2 + l3) * 2.0 + l4) * (h / 6.0);
        fastest = fastest.max(qd.amax());
    }
    let drift = (energy(&q, &qd) - start).abs();
    assert!(fastest > 5.0, "it swings: {fastest} rad/s");
    assert!(drift < 1e-6, "half a second of swing drifts by {drift:e} J");
}

#[test]
fn impossible_point_masses_are_refused() {
    let arm = arm();
    let hand = &arm.links()[5].inertia;
    assert!(hand.with_point_mass(-0.1, &Vector3::zeros()).is_none());
    assert!(hand.with_point_mass(f64::NAN, &Vector3::zeros()).is_none());
    assert!(hand.with_point_mass(0.0, &Vector3::zeros()).is_some());
}

/// The arm with a ball of this mass in its hand.
fn holding(mass_kg: f64) -> RobotModel {
    let text = robot_model::built_in_text("powercube6").expect("built in");
    let text = text.replacen("ball_mass_kg = 0", &format!("ball_mass_kg = {mass_kg}"), 1);
    RobotModel::from_toml("heavy.toml", &text)
        .expect("loads")
        .holding_ball()
        .expect("a ball that weighs something")
}

proptest! {
    /// A point mass m at the end of the linear Jacobian J adds `m Jᵀ (a - g)` to the torques, and `m Jᵀ J` to the mass matrix.
    #[test]
    fn a_ball_in_the_hand_adds_the_torque_of_a_point_mass(
        q in six(3.0), qd in six(2.0), qdd in six(10.0), mass_kg in 0.01..5.0_f64
    ) {
        let (bare, loaded) = (arm(), holding(mass_kg));
        let ball = |t: f64| bare.ball(&bare.fk(&(q + qd * t + qdd * (0.5 * t * t)))).pos;
        let h = 1e-4;
        let acceleration = (ball(h) - ball(0.0) * 2.0 + ball(-h)) / (h * h);
        let force = (acceleration + Vector3::new(0.0, 0.0, bare.world().gravity_m_s2)) * mass_kg;
        let frames = bare.fk(&q);
        let jacobian = frames.jacobian(&bare.ball(&frames).pos);
        let more = loaded.inverse_dynamics(&q, &qd, &qdd) - bare.inverse_dynamics(&q, &qd, &qdd);
        let expected = JointVec::from_fn(6, |k| jacobian.linear(k).dot(&force));
        prop_assert!((more - expected).amax() < 1e-5 * (1.0 + expected.amax()), "{more} against {expected}");
        let more = DMatrix::from(loaded.mass_matrix(&q)) - DMatrix::from(bare.mass_matrix(&q));
        let of_point = DMatrix::from_fn(6, 6, |i, k| jacobian.linear(i).dot(&jacobian.linear(k)) * mass_kg);
        prop_assert!((more - of_point).amax() < 1e-12 * (1.0 + mass_kg));
        let exact = loaded.inverse_dynamics_gradient(&q, &qd, &qdd).tau;
        prop_assert!((exact - loaded.inverse_dynamics(&q, &qd, &qdd)).amax() < 1e-10);
    }
}

#[test]
fn a_ball_without_mass_changes_nothing() {
    assert!(arm().holding_ball().is_none());
    // The published numbers are those of an empty hand, also for the machine whose ball weighs something.
    let kr16: RobotModel = RobotModel::load("kr16_2").expect("loads");
    assert_eq!(kr16.gripper().ball_mass_kg, 0.058);
    let q = JointVec::repeat(6, 0.3);
    assert!(
        kr16.holding_ball().expect("it weighs something").gravity_torques(&q) != kr16.gravity_torques(&q)
    );
}

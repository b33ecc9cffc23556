//! Joint rates of a hand that moves with the ball, against a search of all of them.

use nalgebra::{Matrix3, Matrix3x6, Vector3};
use planner::catch::Joints;
use planner::catch::arm::CatchArm;
use planner::catch::rates::Hand;
use planner::motion_law::stopping_angle;
use planner::plan::rng::SplitMix64;

use super::catch_rig::arm;

/// The velocity of the mouth per joint rate, by differences of the forward kinematics.
fn jacobian(arm: &CatchArm, q: &Joints) -> Matrix3x6<f64> {
    let mouth = |q: &Joints| arm.mouth(q, &Joints::zeros(6)).0;
    Matrix3x6::from_columns(&std::array::from_fn::<_, 6, _>(|i| {
        let mut by = Joints::zeros(6);
        by[i] = 1e-6;
        (mouth(&(q + by)) - mouth(&(q - by))) / 2e-6
    }))
}

fn keeps(arm: &CatchArm, q: &Joints, qd: &Joints) -> bool {
    let limits = arm.limits(false);
    (0..6).all(|i| {
        let stop = q[i] + stopping_angle(&limits[i], arm.law().limits_jerk(), qd[i]);
        qd[i].abs() <= limits[i].v_rad_s * (1.0 + 1e-9)
            && stop >= limits[i].q_rad.0
            && stop <= limits[i].q_rad.1
    })
}

/// Whether any rates keep the limits: joints 1 and 2 are tried in small steps, and joint 3; the other two follow.
fn any_rates(arm: &CatchArm, q: &Joints, hand: &Vector3<f64>) -> bool {
    let jacobian = jacobian(arm, q);
    let limits = arm.limits(false);
    let steps = 60;
    let share = |k: usize| 2.0 * k as f64 / steps as f64 - 1.0;
    (0..=steps).any(|a| {
        (0..=steps).any(|b| {
            let (first, second) = (share(a) * limits[0].v_rad_s, share(b) * limits[1].v_rad_s);
            let left = hand - jacobian.column(0) * first - jacobian.column(1) * second;
            let three = Matrix3::from_columns(&[jacobian.column(2), jacobian.column(3), jacobian.column(4)]);
            let Some(inverse) = three.try_inverse() else { return false };
            let rest = inverse * left;
            keeps(arm, q, &Joints::from([first, second, rest.x, rest.y, rest.z, 0.0]))
        })
    })
}

/// What is missed costs a catch at most; it is counted.
#[test]
fn rates_move_the_hand_as_asked_keep_all_limits_and_are_hardly_ever_missed() {
    for jerk in [false, true] {
        let arm = arm(jerk);
        let mut rng = SplitMix64::new(7);
        let (mut found, mut at_bound, mut none, mut missed) = (0, 0, 0, 0);
        for _ in 0..400 {
            let limits = arm.limits(false);
            let q = Joints::from_fn(6, |i| {
                let (low, high) = limits[i].q_rad;
                if i == 5 { 0.0 } else { low + (high - low) * rng.unit() }
            });
            let hand = Vector3::from_fn(|_, _| rng.normal()).normalize() * (0.5 + 3.0 * rng.unit());
            if let Some(qd) = Hand::at(&arm, limits, &q).rates(&hand) {
                found += 1;
                assert!((arm.mouth(&q, &qd).2 - hand).norm() < 1e-6);
                assert!(keeps(&arm, &q, &qd), "{qd}");
                at_bound += usize::from((0..5).any(|i| qd[i].abs() > limits[i].v_rad_s * (1.0 - 1e-9)));
            } else {
                none += 1;
                missed += usize::from(any_rates(&arm, &q, &hand));
            }
        }
        println!("jerk {jerk}: {found} found, {at_bound} at a speed limit, {none} none, {missed} missed");
        assert!(found > 100 && at_bound > 10 && none > 50);
        assert!(missed * 20 <= none, "{missed} of {none} are missed");
    }
}

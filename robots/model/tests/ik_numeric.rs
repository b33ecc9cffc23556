//! Inverse kinematics by iteration against forward kinematics and against the closed form.

use std::f64::consts::TAU;

use robot_model::{JointVec, RobotModel};

fn ur5() -> RobotModel {
    RobotModel::from_toml("ur5.toml", include_str!("data/ur5.toml")).expect("the fixture loads")
}

fn apart(a: &JointVec, b: &JointVec) -> f64 {
    a.iter()
        .zip(b.iter())
        .map(|(a, b)| (a - b) - TAU * ((a - b) / TAU).round())
        .fold(0.0, |m: f64, d| m.max(d.abs()))
}

/// Poses that the arm reaches, away from the starts of the search.
fn configurations(arm: &RobotModel, count: usize) -> impl Iterator<Item = JointVec> + '_ {
    (0..count).map(|k| arm.spread_configuration(10_007 + 31 * k))
}

/// Published zero pose of the UR5: stretched along -x, hand at (a2 + a3, -(d4 + d6), d1 - d5).
#[test]
fn the_fixture_has_the_zero_pose_of_the_maker() {
    let hand = ur5().ee_at(&JointVec::zeros(6));
    let want = [-0.425 - 0.39225, -0.10915 - 0.0823, 0.089159 - 0.09465];
    for (got, want) in hand.pos.iter().zip(want) {
        assert!((got - want).abs() < 1e-9, "{:?}", hand.pos);
    }
}

#[test]
fn every_solution_of_the_ur5_reaches_the_pose() {
    let arm = ur5();
    let mut most = 0;
    for q in configurations(&arm, 20) {
        let pose = arm.ee_at(&q);
        let found = arm.ik_search(&pose, 128);
        assert!(
            found.iter().any(|f| apart(f, &q) < 1e-5),
            "the posture of the pose itself is among them: {q:?}"
        );
        for f in &found {
            let hand = arm.ee_at(f);
            assert!((hand.pos - pose.pos).norm() < 1e-9 && (hand.rot - pose.rot).amax() < 1e-9, "{f:?}");
            assert!(arm.in_range(f, 1e-9));
        }
        assert!(found.len() <= 8, "a UR5 has at most eight postures, not {}", found.len());
        most = most.max(found.len());
    }
    assert_eq!(most, 8);
}

#[test]
fn the_search_finds_all_branches_of_the_closed_form() {
    for robot in ["kr16_2", "powercube6"] {
        let arm: RobotModel = RobotModel::load(robot).expect("built in");
        let (mut branches, mut missed) = (0, 0);
        for q in configurations(&arm, 40) {
            let pose = arm.ee_at(&q);
            let found = arm.ik_search(&pose, 192);
            let closed = arm.ik(&pose).expect("closed form");
            for solution in closed.in_range() {
                branches += 1;
                missed += usize::from(!found.iter().any(|f| apart(f, &solution.q) < 1e-5));
            }
            for f in &found {
                assert!(
                    closed.iter().any(|s| apart(f, &s.q) < 1e-4),
                    "{robot}: not a solution of the closed form {f:?}"
                );
            }
        }
        assert!(branches > 100, "{robot}: {branches}");
        assert_eq!(missed, 0, "{robot}: {missed} of {branches} branches missed");
    }
}

#[test]
fn a_path_is_followed_from_the_neighbouring_solution() {
    let arm = ur5();
    let from = JointVec::from([0.3, -1.2, 1.4, -0.9, 1.1, 0.2]);
    let mut q = from;
    for step in 1..=50 {
        let want = from + JointVec::from([0.5, 0.4, -0.6, 0.3, 0.7, 1.0]) * (f64::from(step) / 50.0);
        q = arm.ik_from(&arm.ee_at(&want), &q).expect("reached");
        assert!((q - want).amax() < 1e-8, "step {step}: {q:?}");
    }
}

#[test]
fn a_pose_out_of_reach_has_no_solution() {
    let arm = ur5();
    let mut pose = arm.ee_at(&JointVec::from([0.3, -1.2, 1.4, -0.9, 1.1, 0.2]));
    pose.pos.x += 3.0;
    assert!(arm.ik_search(&pose, 32).is_empty());
    assert!(arm.ik_from(&pose, &JointVec::zeros(6)).is_none());
}

//! The KUKA KR 16-2: known poses, dimensions, and all branches of its inverse kinematics.

use std::sync::LazyLock;

use nalgebra::Vector3;
use proptest::prelude::*;
use robot_model::{Family, JointVec, Pose, RobotModel};

static ARM: LazyLock<RobotModel> =
    LazyLock::new(|| RobotModel::load("kr16_2").expect("the built-in robot loads"));

fn arm() -> &'static RobotModel {
    &ARM
}

fn deg(q: [f64; 6]) -> JointVec {
    JointVec::from(q.map(f64::to_radians))
}

#[test]
fn flange_positions() {
    let table = [
        ([0.0, -90.0, 90.0, 0.0, 0.0, 0.0], [1.088, 0.0, 1.320]),
        ([20.0, -70.0, 80.0, 30.0, -40.0, 60.0], [1.220913, -0.390337, 1.228779]),
        ([-75.0, -120.0, 110.0, -150.0, 95.0, -200.0], [0.065988, 0.550341, 1.477622]),
    ];
    let arm = arm();
    for (q, want) in table {
        let flange = arm.ee_at(&deg(q));
        assert!((flange.pos - Vector3::from(want)).amax() < 6e-7, "{q:?}: {}", flange.pos);
    }
}

#[test]
fn dimensions_are_those_of_the_data_sheet() {
    let arm = arm();
    let Family::OrthoParallel(dim) = arm.family() else { panic!("{}", arm.family().name()) };
    let k = 0.67_f64.hypot(0.035);
    for (got, want) in [(dim.a1_m, 0.26), (dim.b_m, 0.0), (dim.c1_m, 0.0), (dim.c2_m, 0.68), (dim.k_m, k)] {
        assert!((got - want).abs() < 1e-12, "{got} {want}");
    }
}

#[test]
fn it_is_loaded_with_as_many_joints_as_its_file_has() {
    assert_eq!(arm().n(), 6);
    assert_eq!(RobotModel::load("pincher4").expect("built in").n(), 4);
}

fn pose_error(a: &Pose, b: &Pose) -> f64 {
    (a.pos - b.pos).amax().max((a.rot - b.rot).amax())
}

fn configuration(arm: &RobotModel, u: &[f64; 6]) -> JointVec {
    let (min, max) = (arm.q_min(), arm.q_max());
    JointVec::from_fn(6, |i| min[i] + u[i] * (max[i] - min[i]))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, ..ProptestConfig::default() })]

    #[test]
    fn every_branch_reaches_the_pose_and_one_is_the_start(u in prop::array::uniform6(0.0..1.0_f64)) {
        let arm = arm();
        let q = configuration(arm, &u);
        let pose = arm.ee_at(&q);
        // Ranges of A4 and A6 are wider than a turn: only the reference determines which turn is meant.
        let solutions = arm.ik_near(&pose, &q).expect("closed form");
        prop_assert!(solutions.len() == 8 || solutions.len() == 4, "{}", solutions.len());
        for s in solutions.iter() {
            let off = pose_error(&arm.ee_at(&s.q), &pose);
            prop_assert!(off < 1e-9, "branch {:?} misses by {off:e}", s.branch);
        }
        let own = solutions.get(arm.branch_of(&q).expect("closed form")).expect("reached");
        prop_assert!((own.q - q).amax() < 1e-6, "{} {q}", own.q);
        prop_assert!(own.in_range);
    }
}

//! Inverse kinematics of the PowerCube arm: every branch reaches the pose, and the set of branches is the known one.

use std::sync::LazyLock;

use nalgebra::{Matrix3, Vector3, Vector6};
use proptest::prelude::*;
use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use robot_model::{JointVec, Pose, RobotModel};

static ARM: LazyLock<RobotModel> =
    LazyLock::new(|| RobotModel::load("powercube6").expect("the built-in robot loads"));

fn arm() -> &'static RobotModel {
    &ARM
}

/// Configuration inside the joint ranges from six numbers in [0, 1].
fn configuration(arm: &RobotModel, u: &[f64; 6]) -> JointVec {
    let (min, max) = (arm.q_min(), arm.q_max());
    JointVec::from_fn(6, |i| min[i] + u[i] * (max[i] - min[i]))
}

fn pose_error(a: &Pose, b: &Pose) -> f64 {
    (a.pos - b.pos).amax().max((a.rot - b.rot).amax())
}

/// Distance of angles modulo whole turns.
fn turn_error(a: &JointVec, b: &JointVec) -> f64 {
    (a - b).map(|d| d.sin().hypot(1.0 - d.cos())).amax()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, ..ProptestConfig::default() })]

    #[test]
    fn every_branch_reaches_the_pose_and_one_is_the_start(u in prop::array::uniform6(0.0..1.0_f64)) {
        let arm = arm();
        let q = configuration(arm, &u);
        let pose = arm.ee_at(&q);
        let solutions = arm.ik(&pose).expect("closed form");
        prop_assert_eq!(solutions.len(), 8);
        for s in solutions.iter() {
            let off = pose_error(&arm.ee_at(&s.q), &pose);
            prop_assert!(off < 1e-10, "branch {:?} misses by {:e}", s.branch, off);
            if !s.singular {
                prop_assert_eq!(arm.branch_of(&s.q), Some(s.branch));
            }
        }
        let own = solutions.get(arm.branch_of(&q).expect("closed form")).expect("reached");
        // Next to a singularity the angle is as uncertain as the pose is divided by the distance to it.
        prop_assert!(turn_error(&own.q, &q) < 1e-6, "{} {}", own.q, q);
        prop_assert!(own.in_range);
    }

    #[test]
    fn the_next_solution_is_the_nearest_of_all_near_and_far_from_the_reference(
        u in prop::array::uniform6(0.0..1.0_f64),
        step in prop::array::uniform6(-1.0..1.0_f64),
        size_rad in prop::sample::select(vec![1e-3, 0.1, 0.5, 1.0, 3.0]),
    ) {
        let arm = arm();
        let q = configuration(arm, &u);
        let q_ref = q + JointVec::from(step) * size_rad;
        let pose = arm.ee_at(&q);
        let apart = |q: &JointVec| {
            let by = (q - q_ref).map(|d| d - std::f64::consts::TAU * (d / std::f64::consts::TAU).round());
            by.amax()
        };
        let next = arm.ik_next(&pose, &q_ref).expect("closed form").expect("reached");
        let nearest_rad = arm.ik(&pose).expect("closed form").iter().map(|s| apart(&s.q)).fold(f64::MAX, f64::min);
        prop_assert!((next - q_ref).amax() < nearest_rad + 1e-9, "{} {} {}", next, q_ref, nearest_rad);
        prop_assert!(pose_error(&arm.ee_at(&next), &pose) < 1e-9);
    }

    #[test]
    fn a_small_step_keeps_the_branches(
        u in prop::array::uniform6(0.0..1.0_f64),
        step in prop::array::uniform6(-1e-4..1e-4_f64),
    ) {
        let arm = arm();
        let q = configuration(arm, &u);
        let (here, there) = (arm.ee_at(&q), arm.ee_at(&(q + JointVec::from(step))));
        let (here, there) = (arm.ik(&here).expect("closed form"), arm.ik(&there).expect("closed form"));
        for (a, b) in here.iter().zip(there.iter()) {
            prop_assert_eq!(a.branch, b.branch);
            let frames = arm.fk(&a.q);
            let det = frames.jacobian(&arm.ee(&frames).pos).lu().map_or(0.0, |lu| lu.determinant());
            // Away from singularities the solutions move little: |δq| ≤ |J⁻¹| |δx|.
            if det.abs() > 5e-3 {
                prop_assert!(turn_error(&a.q, &b.q) < 0.05, "{:?}: {} {}", a.branch, a.q, b.q);
            }
        }
    }

    #[test]
    fn solutions_move_as_the_inverse_jacobian_says(
        u in prop::array::uniform6(0.0..1.0_f64),
        twist in prop::array::uniform6(-1.0..1.0_f64),
    ) {
        let arm = arm();
        let q = configuration(arm, &u);
        let pose = arm.ee_at(&q);
        let twist = Vector6::from(twist);
        let h = 1e-6;
        let step = |sign: f64| {
            let angle: Vector3<f64> = twist.fixed_rows::<3>(3) * (sign * h);
            let rot = nalgebra::Rotation3::new(angle).into_inner() * pose.rot;
            Pose::new(rot, pose.pos + twist.fixed_rows::<3>(0) * (sign * h))
        };
        let branch = arm.branch_of(&q).expect("closed form");
        let frames = arm.fk(&q);
        let jacobian = frames.jacobian(&pose.pos);
        prop_assume!(jacobian.lu().map_or(0.0, |lu| lu.determinant()).abs() > 5e-3);
        let solve = |sign: f64| arm.ik_near(&step(sign), &q).expect("closed form").get(branch).expect("reached").q;
        let numeric = (solve(1.0) - solve(-1.0)) / (2.0 * h);
        let analytic = robot_model::jacobian::joint_rates(&jacobian, &twist).expect("regular");
        prop_assert!((numeric - analytic).amax() < 1e-4 * (1.0 + analytic.amax()), "{} {}", numeric, analytic);
    }
}

#[test]
fn three_quarters_of_random_poses_have_eight_solutions_in_range_and_the_rest_four() {
    let arm = arm();
    let mut random = SplitMix64::seed_from_u64(7);
    let mut uniform = || random.next_u64() as f64 / u64::MAX as f64;
    let mut count = [0_usize; 9];
    let draws = 20_000;
    for _ in 0..draws {
        let q = configuration(arm, &std::array::from_fn(|_| uniform()));
        count[arm.ik(&arm.ee_at(&q)).expect("closed form").len_in_range()] += 1;
    }
    let share = |k: usize| count[k] as f64 / f64::from(draws);
    assert!((0.73..0.75).contains(&share(8)), "eight: {}", share(8));
    assert!((0.25..0.27).contains(&share(4)), "four: {}", share(4));
    assert_eq!(count[8] + count[4], draws as usize);
}

#[test]
fn out_of_reach_has_no_solution_and_says_by_how_much() {
    let arm = arm();
    // Straight up, 0.1 m above the highest pose: the wrist centre is 0.1 m too far.
    let up = arm.ee_at(&JointVec::from([0.0, -90.0, -90.0, 0.0, 0.0, 0.0].map(f64::to_radians)));
    let higher = Pose::new(up.rot, up.pos + Vector3::new(0.0, 0.0, 0.1));
    let solutions = arm.ik(&higher).expect("closed form");
    assert!(solutions.is_empty());
    for margin in solutions.reach_margin_m {
        assert!((margin + 0.1).abs() < 1e-12, "{margin}");
    }
    // Too close: c3 - c2 = 0.21 m around the shoulder stays free.
    let close = Pose::new(Matrix3::identity(), Vector3::new(0.0, 0.1, 0.27 + 0.217));
    let solutions = arm.ik(&close).expect("closed form");
    assert!(solutions.is_empty());
    assert!((solutions.reach_margin_m[0] + 0.11).abs() < 1e-12, "{:?}", solutions.reach_margin_m);
    // Garbage in, nothing out.
    let nan = Pose::new(Matrix3::identity() * f64::NAN, Vector3::zeros());
    assert!(arm.ik(&nan).expect("closed form").is_empty());
}

#[test]
fn singular_poses_take_the_free_angle_from_the_reference() {
    let arm = arm();
    // Straight wrist: joints 4 and 6 turn about one line.
    let q = JointVec::from([30.0, -60.0, -100.0, 25.0, 0.0, 40.0].map(f64::to_radians));
    let pose = arm.ee_at(&q);
    let solutions = arm.ik_near(&pose, &q).expect("closed form");
    let own = solutions.get(arm.branch_of(&q).expect("closed form")).expect("reached");
    assert!(own.singular && own.in_range);
    assert!(turn_error(&own.q, &q) < 1e-9);
    for s in solutions.iter() {
        assert!(pose_error(&arm.ee_at(&s.q), &pose) < 1e-9, "{:?}", s.branch);
    }
    // Upright: wrist centre on axis 1 and elbow stretched as well.
    let q = JointVec::from([17.0, -90.0, -90.0, 33.0, 0.0, 5.0].map(f64::to_radians));
    let pose = arm.ee_at(&q);
    let solutions = arm.ik_near(&pose, &q).expect("closed form");
    assert_eq!(solutions.len(), 8);
    for s in solutions.iter() {
        assert!(s.singular);
        assert!(pose_error(&arm.ee_at(&s.q), &pose) < 1e-7, "{:?}", s.branch);
    }
}

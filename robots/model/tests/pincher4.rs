//! The Pincher: DH table against the product of exponentials of its screws, printed equations, inverse kinematics.

use std::sync::LazyLock;

use nalgebra::{DMatrix, Matrix3, Matrix4, SMatrix, Vector3};
use proptest::prelude::*;
use robot_model::{Branch, Family, JointVec, RobotModel};

static ARM: LazyLock<RobotModel> =
    LazyLock::new(|| RobotModel::load("pincher4").expect("the built-in robot loads"));

fn arm() -> &'static RobotModel {
    &ARM
}

fn angles() -> impl Strategy<Value = JointVec> {
    prop::array::uniform4(-2.6..2.6_f64).prop_map(JointVec::from)
}

/// Rigid motion by an angle about a screw axis of pitch zero (Rodrigues).
fn exponential(w: Vector3<f64>, v: Vector3<f64>, angle_rad: f64) -> Matrix4<f64> {
    let (s, c) = angle_rad.sin_cos();
    let hat = w.cross_matrix();
    let rot = Matrix3::identity() + hat * s + hat * hat * (1.0 - c);
    let left = Matrix3::identity() * angle_rad + hat * (1.0 - c) + hat * hat * (angle_rad - s);
    let mut out = Matrix4::identity();
    out.fixed_view_mut::<3, 3>(0, 0).copy_from(&rot);
    out.fixed_view_mut::<3, 1>(0, 3).copy_from(&(left * v));
    out
}

proptest! {
    /// The report's screws (centimetres) bend about x; its DH table at q1 = 0 bends about -y.
    #[test]
    fn dh_table_equals_the_product_of_exponentials(q in angles()) {
        let arm = arm();
        let x = Vector3::x();
        let screw = |height_cm: f64, angle: f64| exponential(x, Vector3::new(0.0, height_cm, 0.0), angle);
        // Straight up at zero: last frame at 94.5 cm, x up (the DH frame's), y along -x of the screws' plane.
        let turn1 = q[0] - std::f64::consts::FRAC_PI_2;
        let rest = arm.ee_at(&JointVec::from([std::f64::consts::FRAC_PI_2, 0.0, 0.0, 0.0])).to_matrix();
        let mut rest_cm = rest;
        rest_cm.fixed_view_mut::<3, 1>(0, 3).scale_mut(100.0);
        prop_assert!((rest_cm[(2, 3)] - 94.5).abs() < 1e-12);
        let by_screws = exponential(Vector3::z(), Vector3::zeros(), turn1)
            * screw(12.0, q[1]) * screw(43.5, q[2]) * screw(75.0, q[3]) * rest_cm;
        let mut by_dh = arm.ee_at(&q).to_matrix();
        by_dh.fixed_view_mut::<3, 1>(0, 3).scale_mut(100.0);
        prop_assert!((by_screws - by_dh).amax() < 3e-13, "{:e}", (by_screws - by_dh).amax());
    }

    /// Eq. (3) with its two misprints put right: cosine in the y entry, sin(θ2 + π/2) in the z entry.
    #[test]
    fn printed_position(q in angles()) {
        let a2 = q[1] + std::f64::consts::FRAC_PI_2;
        let (a3, a4) = (a2 + q[2], a2 + q[2] + q[3]);
        let out = 31.5 * a2.cos() + 31.5 * a3.cos() + 19.5 * a4.cos();
        let up = 12.0 + 31.5 * a2.sin() + 31.5 * a3.sin() + 19.5 * a4.sin();
        let want = Vector3::new(q[0].cos() * out, q[0].sin() * out, up) / 100.0;
        prop_assert!((arm().ee_at(&q).pos - want).amax() < 1e-14);
    }

    /// Eq. (5) and (6), as printed.
    #[test]
    fn printed_jacobian(q in angles()) {
        let a2 = q[1] + std::f64::consts::FRAC_PI_2;
        let (a3, a4) = (a2 + q[2], a2 + q[2] + q[3]);
        let (c3, s3) = (0.195 * a4.cos(), 0.195 * a4.sin());
        let (c2, s2) = (0.315 * a3.cos() + c3, 0.315 * a3.sin() + s3);
        let (c1, s1) = (0.315 * a2.cos() + c2, 0.315 * a2.sin() + s2);
        let (s, c) = q[0].sin_cos();
        let want = SMatrix::<f64, 6, 4>::from_row_slice(&[
            -s * c1, -c * s1, -c * s2, -c * s3,
            c * c1, -s * s1, -s * s2, -s * s3,
            0.0, c1, c2, c3,
            0.0, s, s, s,
            0.0, -c, -c, -c,
            1.0, 0.0, 0.0, 0.0,
        ]);
        let arm = arm();
        let frames = arm.fk(&q);
        let jacobian = frames.jacobian(&arm.ee(&frames).pos);
        let off = DMatrix::from(jacobian) - DMatrix::from_column_slice(6, 4, want.as_slice());
        prop_assert!(off.amax() < 1e-14, "{off}");
    }

    #[test]
    fn both_elbows_reach_the_pose_and_one_is_the_start(q in angles()) {
        let arm = arm();
        let pose = arm.ee_at(&q);
        let solutions = arm.ik(&pose).expect("closed form");
        prop_assert_eq!(solutions.len(), 2);
        for s in solutions.iter() {
            let reached = arm.ee_at(&s.q);
            prop_assert!((reached.to_matrix() - pose.to_matrix()).amax() < 1e-10);
        }
        let own = solutions.get(arm.branch_of(&q).expect("closed form")).expect("reached");
        prop_assert!((own.q - q).amax() < 1e-6, "{} {q}", own.q);
    }

    #[test]
    fn aiming_at_a_point_gives_level_poses_on_both_sides(
        p in prop::array::uniform3(-0.4..0.4_f64), elevation in -1.5..1.5_f64,
    ) {
        let arm = arm();
        let Family::TurntablePlanar(plane) = arm.family() else { panic!("{}", arm.family().name()) };
        let point = Vector3::from(p);
        prop_assume!(point.xy().norm() > 0.01);
        for pose in plane.aim(&point, elevation) {
            let pose = pose.expect("off the axis");
            prop_assert!((pose.pos - point).amax() < 1e-15);
            // The hand is along x of the last DH frame: outwards and up by the elevation.
            let hand = pose.rot.column(0);
            prop_assert!((hand.z - elevation.sin()).abs() < 1e-12);
            let outwards = (hand.x * p[0] + hand.y * p[1]) / point.xy().norm();
            prop_assert!((outwards - elevation.cos()).abs() < 1e-12, "{outwards}");
            for s in arm.ik(&pose).expect("closed form").iter() {
                prop_assert!((arm.ee_at(&s.q).to_matrix() - pose.to_matrix()).amax() < 1e-10);
            }
        }
    }
}

#[test]
fn a_level_hand_needs_minus_ninety_degrees_of_bend() {
    // θ2 + θ3 + θ4 = -90° points the hand outwards.
    let arm = arm();
    let q = JointVec::from([0.4, -0.3, -0.5, 0.8 - std::f64::consts::FRAC_PI_2]);
    let hand = arm.ee_at(&q).rot.column(0).into_owned();
    assert!(hand.z.abs() < 1e-15 && (hand.y.atan2(hand.x) - 0.4).abs() < 1e-15, "{hand}");
}

#[test]
fn poses_off_the_arms_plane_have_no_solution() {
    let arm = arm();
    let q = JointVec::from([0.4, -0.3, -0.5, -0.8]);
    let mut pose = arm.ee_at(&q);
    assert_eq!(arm.ik(&pose).expect("closed form").len(), 2);
    assert_eq!(arm.branch_of(&q).map(Branch::shoulder_back), Some(false));
    pose.pos += pose.rot.column(2) * 0.01;
    let off = arm.ik(&pose).expect("closed form");
    assert!(off.is_empty());
    assert!((off.reach_margin_m[0] + 0.01).abs() < 1e-12, "{:?}", off.reach_margin_m);
}

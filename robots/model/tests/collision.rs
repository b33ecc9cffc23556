//! Collision of the PowerCube arm: known clearances, an independent geometry library as oracle, and proofs over motions.

use std::sync::LazyLock;

use nalgebra::{UnitQuaternion, Vector3};
use parry3d_f64::math::{Pose as ParryPose, Rotation as ParryRotation, Vector as ParryVector};
use parry3d_f64::query;
use parry3d_f64::shape::{Ball, Cuboid};
use proptest::prelude::*;
use robot_model::collision::{
    Body, CollisionChecker, MotionVerdict, Obb, Scene, StraightMove, Travel, aligned_box,
};
use robot_model::{JointVec, Pose, RobotModel};

static ARM: LazyLock<RobotModel> =
    LazyLock::new(|| RobotModel::load("powercube6").expect("the built-in robot loads"));

fn arm() -> &'static RobotModel {
    &ARM
}

fn deg(q: [f64; 6]) -> JointVec {
    JointVec::from(q.map(f64::to_radians))
}

#[track_caller]
fn nearest(q: JointVec) -> (f64, [String; 2]) {
    let (arm, scene) = (arm(), Scene::default());
    let mut checker = CollisionChecker::new(arm, &scene);
    let found = checker.clearance(&arm.fk(&q));
    assert_eq!(checker.collides(&arm.fk(&q)), found.distance_m <= 0.0);
    (found.distance_m, [checker.name(found.a).to_string(), checker.name(found.b).to_string()])
}

#[test]
fn clearances_of_state_a_and_b() {
    let (distance_m, bodies) = nearest(deg([30.0, -40.0, -110.0, 50.0, 70.0, -20.0]));
    assert!((distance_m - 0.040951).abs() < 6e-7, "{distance_m}");
    assert_eq!(bodies, ["PW-070 a", "hand"]);
    let (distance_m, _) = nearest(deg([-100.0, -150.0, -60.0, -120.0, -40.0, 135.0]));
    assert!((distance_m - 0.059823).abs() < 6e-7, "{distance_m}");
}

#[test]
fn the_forearm_in_the_column_is_found() {
    // Upper arm forward and down, elbow folded back under it.
    let (distance_m, bodies) = nearest(deg([0.0, 60.0, -150.0, 0.0, 0.0, 0.0]));
    assert!((-0.1..-0.01).contains(&distance_m), "{distance_m} {bodies:?}");
    assert_eq!(bodies[0], "column");
}

#[test]
fn seventy_pairs_are_tested_and_nine_boxes_against_the_floor() {
    let arm = arm();
    assert_eq!(arm.collision().pairs().len(), 70);
    assert!(arm.collision().pairs().iter().all(|&(a, b)| {
        let link = |k: u16| arm.collision().boxes()[usize::from(k)].link;
        link(a).abs_diff(link(b)) >= 2
    }));
}

fn parry_pose(x: &Pose) -> ParryPose {
    let q = UnitQuaternion::from_matrix(&x.rot);
    ParryPose::from_parts(
        ParryVector::new(x.pos.x, x.pos.y, x.pos.z),
        ParryRotation::from_xyzw(q.i, q.j, q.k, q.w),
    )
}

fn parry_cuboid(b: &Obb) -> Cuboid {
    Cuboid::new(ParryVector::new(b.half_m.x, b.half_m.y, b.half_m.z))
}

fn any_box() -> impl Strategy<Value = Obb> {
    let place = prop::array::uniform3(-0.5..0.5_f64);
    let turn = prop::array::uniform3(-3.0..3.0_f64);
    // Thin plates and long beams as well as cubes.
    let half = prop::array::uniform3(prop_oneof![Just(0.01), 0.02..0.3_f64]);
    // A third of the boxes are parallel to the axes: parallel edges are the hard case.
    (place, prop_oneof![2 => turn, 1 => Just([0.0; 3])], half)
        .prop_map(|(p, t, h)| Obb::new(Pose::from_rpy(t, p.into()), h.into()))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 4000, ..ProptestConfig::default() })]

    #[test]
    fn boxes_overlap_exactly_when_the_oracle_says_so(a in any_box(), b in any_box()) {
        let near = a.proximity(&b);
        let (pa, pb) = (parry_pose(&a.pose), parry_pose(&b.pose));
        let (ca, cb) = (parry_cuboid(&a), parry_cuboid(&b));
        // Within rounding of touching, either answer is right.
        if near.distance_m.abs() > 1e-9 {
            let oracle = query::intersection_test(&pa, &ca, &pb, &cb).expect("cuboids are supported").intersecting;
            prop_assert_eq!(a.overlaps(&b), oracle);
            prop_assert_eq!(near.distance_m <= 0.0, oracle);
        }
        prop_assert_eq!(a.overlaps(&b), b.overlaps(&a));
    }

    #[test]
    fn distances_agree_with_the_oracle(a in any_box(), b in any_box()) {
        let near = a.proximity(&b);
        let (pa, pb) = (parry_pose(&a.pose), parry_pose(&b.pose));
        let oracle = query::distance(&pa, &parry_cuboid(&a), &pb, &parry_cuboid(&b)).expect("cuboids are supported").distance;
        // The oracle iterates (GJK) and stops at about 1e-7.
        prop_assert!((near.distance_m.max(0.0) - oracle).abs() < 1e-6, "{} {}", near.distance_m, oracle);
        prop_assert!((near.distance_m - b.proximity(&a).distance_m).abs() < 1e-12);
        prop_assert!(a.separation(&b) <= near.distance_m + 1e-12);
        prop_assert_eq!(a.separation(&b) > 0.0, near.distance_m > 0.0);
        // The shortest way apart parts them, and a little less does not.
        if near.distance_m < -1e-6 {
            let moved = |by: f64| Obb::new(Pose::new(b.pose.rot, b.pose.pos + near.normal * by), b.half_m);
            prop_assert!(!a.overlaps(&moved(-near.distance_m + 1e-9)));
            prop_assert!(a.overlaps(&moved(-near.distance_m - 1e-7)));
        }
    }

    #[test]
    fn spheres_agree_with_the_oracle(b in any_box(), p in prop::array::uniform3(-1.0..1.0_f64), r in 0.01..0.2_f64) {
        let center = Vector3::from(p);
        let near = b.proximity_to_sphere(&center, r);
        let ball = ParryPose::from_parts(ParryVector::new(p[0], p[1], p[2]), ParryRotation::IDENTITY);
        let oracle = query::contact(&parry_pose(&b.pose), &parry_cuboid(&b), &ball, &Ball::new(r), 10.0)
            .expect("supported").expect("within ten metres");
        prop_assert!((near.distance_m - oracle.dist).abs() < 1e-9, "{} {}", near.distance_m, oracle.dist);
    }
}

fn obstacle() -> Vec<(String, Obb)> {
    vec![("crate".to_owned(), aligned_box(Vector3::new(0.5, 0.3, -1.0), Vector3::new(0.9, 0.7, -0.4)))]
}

fn configuration(arm: &RobotModel, u: &[f64; 6]) -> JointVec {
    let (min, max) = (arm.q_min(), arm.q_max());
    JointVec::from_fn(6, |i| min[i] + u[i] * (max[i] - min[i]))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 150, ..ProptestConfig::default() })]

    #[test]
    fn a_motion_is_free_exactly_when_fine_sampling_finds_nothing(
        u in prop::array::uniform6(0.0..1.0_f64),
        step in prop::array::uniform6(-0.6..0.6_f64),
        held in any::<bool>(),
    ) {
        let (arm, scene) = (arm(), Scene { obstacles: obstacle(), ball_held: held });
        let mut checker = CollisionChecker::new(arm, &scene);
        let from = configuration(arm, &u);
        let motion = StraightMove { from, to: from + JointVec::from(step) };
        let tolerance_m = 1e-4;
        let sampled = (0..=400)
            .map(|i| checker.clearance(&arm.fk(&motion.at(f64::from(i) / 400.0))).distance_m)
            .fold(f64::INFINITY, f64::min);
        match checker.check_motion(&motion, 0.0, 1.0, tolerance_m) {
            MotionVerdict::Free { evaluations } => {
                prop_assert!(sampled > 0.0, "proven free, but {sampled} was sampled");
                prop_assert!(evaluations < 4000, "{evaluations}");
            }
            MotionVerdict::Contact { s, clearance } => {
                prop_assert!((0.0..=1.0).contains(&s));
                prop_assert!(clearance.distance_m <= 2.0 * tolerance_m, "{clearance:?}");
                // Sampling at 1/400 of the motion misses no more than it moves between samples.
                prop_assert!(sampled < 0.01, "contact reported, but nothing nearer than {sampled} was sampled");
            }
        }
    }

    #[test]
    fn no_point_moves_farther_than_the_swing_bound(
        u in prop::array::uniform6(0.0..1.0_f64),
        step in prop::array::uniform6(-0.3..0.3_f64),
    ) {
        let arm = arm();
        let q = configuration(arm, &u);
        let step = JointVec::from(step);
        let (here, there) = (arm.boxes_at(&arm.fk(&q)), arm.boxes_at(&arm.fk(&(q + step))));
        for (k, body) in arm.collision().boxes().iter().enumerate() {
            let bound: f64 = (0..6).map(|j| arm.collision().swing_m(j, body.link) * step[j].abs()).sum();
            for (a, b) in here[k].corners().zip(there[k].corners()) {
                prop_assert!((a - b).norm() <= bound + 1e-12, "{}: {} > {bound}", body.name, (a - b).norm());
            }
        }
        // And it is not absurdly wide: the whole arm is 1.1 m long from the shoulder.
        let widest = arm.collision().swing_m(0, 6);
        prop_assert!((0.9..1.25).contains(&widest), "{widest}");
    }
}

#[test]
fn a_thin_wall_between_the_samples_is_found() {
    let arm = arm();
    // A plate 0.2 mm thick across the way of the hand.
    let wall = aligned_box(Vector3::new(0.3, 0.2999, -0.5), Vector3::new(1.2, 0.3001, 1.5));
    let scene = Scene { obstacles: vec![("plate".to_owned(), wall)], ball_held: false };
    let mut checker = CollisionChecker::new(arm, &scene);
    let motion = StraightMove {
        from: deg([-40.0, -20.0, -90.0, 0.0, 0.0, 0.0]),
        to: deg([90.0, -20.0, -90.0, 0.0, 0.0, 0.0]),
    };
    let MotionVerdict::Contact { clearance, .. } = checker.check_motion(&motion, 0.0, 1.0, 1e-4) else {
        panic!("the plate is in the way");
    };
    assert_eq!(clearance.a, Body::Obstacle(0));
    let short = StraightMove { to: deg([-10.0, -20.0, -90.0, 0.0, 0.0, 0.0]), ..motion };
    assert!(checker.check_motion(&short, 0.0, 1.0, 1e-4).is_free());
}

#[test]
fn a_motion_that_is_not_a_number_is_not_free() {
    let (arm, scene) = (arm(), Scene::default());
    let mut checker = CollisionChecker::new(arm, &scene);
    let motion = StraightMove { from: JointVec::repeat(6, f64::NAN), to: JointVec::zeros(6) };
    assert!(!checker.check_motion(&motion, 0.0, 1.0, 1e-4).is_free());
}

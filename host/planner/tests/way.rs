//! Ways of the whole arm: free at every instant, within the limits, at the requested place.

use nalgebra::Vector3;
use planner::motion::Motion;
use planner::plan::rng::SplitMix64;
use planner::plan::{Arm, Joints};
use planner::way::{
    Goal, LineBreak, LineError, Travel, WayError, along_places, is_straight, straight_to, way, way_to,
};
use robot_model::Pose;
use robot_model::collision::{CollisionChecker, Obb, Scene, StraightMove};

fn arm() -> Arm {
    Arm::load("powercube6").unwrap()
}

fn deg(q: [f64; 6]) -> Joints {
    Joints::from_slice(&q.map(f64::to_radians))
}

fn box_at(at: [f64; 3], half: [f64; 3]) -> (String, Obb) {
    ("box".to_owned(), Obb::new(Pose::translation(at[0], at[1], at[2]), Vector3::from(half)))
}

/// A table, a wall, a shelf.
fn scenes() -> [Scene; 3] {
    let scene = |obstacles| Scene { obstacles, ball_held: true };
    [
        scene(vec![box_at([0.7, 0.0, -0.05], [0.3, 0.6, 0.02])]),
        scene(vec![box_at([0.45, 0.0, 0.5], [0.25, 0.05, 0.6])]),
        scene(vec![box_at([0.8, 0.0, 0.35], [0.2, 0.5, 0.02]), box_at([0.8, 0.0, 0.8], [0.2, 0.5, 0.02])]),
    ]
}

/// Looks at the motion every millisecond.
fn require_free_and_within_limits(arm: &Arm, scene: &Scene, motion: &Motion, share: f64) {
    let mut checker = CollisionChecker::new(arm, scene);
    let within = |x: &Joints, limit: Joints, slack: f64| {
        x.iter().zip(limit.iter()).all(|(x, limit)| x.abs() <= limit * share * slack)
    };
    let steps = (motion.duration_s() / 1e-3) as usize;
    for i in 0..=steps {
        let at = motion.at(i as f64 * 1e-3);
        assert!(arm.in_range(&at.q, 1e-6), "{i} ms: {:?}", at.q);
        assert!(i % 5 != 0 || !checker.collides(&arm.fk(&at.q)), "contact after {i} ms");
        assert!(within(&at.qd, arm.limit(|l| l.v_max_rad_s), 1.000_01), "speed after {i} ms");
        assert!(within(&at.qdd, arm.limit(|l| l.a_max_rad_s2), 1.000_01), "acceleration after {i} ms");
        assert!(within(&at.jerk, arm.limit(|l| l.j_max_rad_s3), 1.000_01), "jerk after {i} ms");
    }
}

#[test]
fn ways_between_random_poses_are_free_within_limits_and_end_where_they_should() {
    let arm = arm();
    let mut rng = SplitMix64::new(3);
    let travel = Travel { share: 0.5, ..Travel::default() };
    let mut blocked = 0;
    for scene in scenes() {
        let (low, high) = (arm.q_min(), arm.q_max());
        let mut checker = CollisionChecker::new(&arm, &scene);
        let mut pose = || loop {
            let q = Joints::from_fn(6, |j| low[j] + (high[j] - low[j]) * (0.2 + 0.6 * rng.unit()));
            if !checker.collides(&arm.fk(&q)) {
                return q;
            }
        };
        let mut line = CollisionChecker::new(&arm, &scene);
        for _ in 0..3 {
            // Where something is in the way.
            let (from, to) = loop {
                let (from, to) = (pose(), pose());
                if !line.check_motion(&StraightMove { from, to }, 0.0, 1.0, 1e-3).is_free() {
                    break (from, to);
                }
            };
            match way(&arm, &scene, &travel, &from, &to) {
                Ok(Some(motion)) => {
                    require_free_and_within_limits(&arm, &scene, &motion, 0.5);
                    assert_eq!((motion.start_rad(), motion.stop_rad()), (from, to));
                }
                Ok(None) => panic!("poses differ"),
                Err(WayError::NoWay { .. }) => blocked += 1,
                Err(error) => panic!("{error}"),
            }
        }
    }
    // Two pairs have no way with five times as many tries either.
    assert!(blocked <= 2, "{blocked} of 9 without a way");
}

/// Moves of the comparison with RRT-Connect of OMPL (`.ci/motion`) that this search reported as impossible or made three times
/// as long.
#[test]
fn ways_that_another_planner_finds_are_found_and_not_much_longer() {
    let scene = |boxes: &[([f64; 3], [f64; 3])]| Scene {
        obstacles: boxes.iter().map(|(at, half)| box_at(*at, *half)).collect(),
        ball_held: false,
    };
    let window = scene(&[
        ([0.5, 0.625, 0.3], [0.02, 0.375, 0.8]),
        ([0.5, -0.625, 0.3], [0.02, 0.375, 0.8]),
        ([0.5, 0.0, 0.9], [0.02, 0.25, 0.2]),
        ([0.5, 0.0, -0.15], [0.02, 0.25, 0.35]),
    ]);
    let ceiling = scene(&[([0.0, 0.0, 0.95], [1.2, 1.2, 0.02])]);
    let arm = arm();
    // Durations of the other planner's ways with the same time law, s.
    for (scene, from, to, other_s) in [
        (
            &window,
            [2.955, -3.243, -2.244, 2.035, -0.898, 1.819],
            [-0.053, -2.354, -2.867, -2.73, -0.321, -0.097],
            13.25,
        ),
        (
            &window,
            [-1.61, -3.807, -2.979, -0.937, -0.738, -2.124],
            [2.96, -3.147, -1.738, -1.798, 1.083, -0.462],
            16.59,
        ),
        (
            &ceiling,
            [-0.351, 0.512, -1.167, 2.378, 1.338, 2.186],
            [-0.18, -0.333, 0.683, 1.009, -0.314, -1.143],
            5.84,
        ),
    ] {
        for seed in 1..=3 {
            let travel = Travel { share: 0.2, seed, range: None };
            let motion = way(&arm, scene, &travel, &from.into(), &to.into()).unwrap().unwrap();
            require_free_and_within_limits(&arm, scene, &motion, 0.2);
            assert!(motion.duration_s() < 1.4 * other_s, "seed {seed}: {} s, {other_s}", motion.duration_s());
        }
    }
}

#[test]
fn way_around_stays_inside_a_narrower_range() {
    let (arm, scene) = (arm(), &scenes()[1]);
    let (from, to) = (deg([-50.0, -20.0, -90.0, 0.0, 0.0, 0.0]), deg([50.0, -20.0, -90.0, 0.0, 0.0, 0.0]));
    let range =
        (deg([-60.0, -150.0, -120.0, -20.0, -40.0, -10.0]), deg([60.0, 0.0, -20.0, 20.0, 40.0, 10.0]));
    for seed in 1..4 {
        let travel = Travel { range: Some(range), seed, ..Travel::default() };
        let motion = way(&arm, scene, &travel, &from, &to).unwrap().unwrap();
        require_free_and_within_limits(&arm, scene, &motion, 0.3);
        assert!(!is_straight(&motion));
        for i in 0..=500 {
            let q = motion.at(motion.duration_s() * f64::from(i) / 500.0).q;
            assert!((0..6).all(|j| q[j] >= range.0[j] - 1e-9 && q[j] <= range.1[j] + 1e-9), "{i}: {q:?}");
        }
    }
}

#[test]
fn hand_comes_to_a_point_and_to_a_pose() {
    let (arm, scene) = (arm(), Scene::default());
    let from = deg([0.0, -20.0, -90.0, 0.0, 0.0, 0.0]);
    let travel = Travel::default();
    let wanted = arm.ee_at(&deg([40.0, -40.0, -60.0, 20.0, 30.0, 10.0]));
    let to_pose = way_to(&arm, &scene, &travel, &from, &Goal::Pose(wanted)).unwrap().unwrap();
    let reached = arm.ee_at(&to_pose.stop_rad());
    assert!((reached.pos - wanted.pos).norm() < 1e-8 && (reached.rot - wanted.rot).amax() < 1e-8);
    let to_point = way_to(&arm, &scene, &travel, &from, &Goal::Point(wanted.pos)).unwrap().unwrap();
    assert!((arm.ee_at(&to_point.stop_rad()).pos - wanted.pos).norm() < 1e-8);
    let ratio = to_point.duration_s() / to_pose.duration_s();
    assert!((0.2..1.2).contains(&ratio), "a point leaves more freedom than a pose: {ratio}");
    let far = way_to(&arm, &scene, &travel, &from, &Goal::Point(Vector3::new(9.0, 0.0, 0.0)));
    assert!(matches!(far, Err(WayError::Goal(_))), "{far:?}");
}

#[test]
fn straight_line_of_the_hand_stays_on_the_line_or_says_where_it_breaks() {
    let (arm, scene) = (arm(), Scene::default());
    let from = deg([10.0, -70.0, -110.0, 10.0, 40.0, 20.0]);
    let begin = arm.ee_at(&from);
    let goal = Goal::Point(begin.pos + Vector3::new(-0.1, 0.1, -0.2));
    let motion = straight_to(&arm, &scene, &Travel::default(), &from, &goal).unwrap().unwrap();
    require_free_and_within_limits(&arm, &scene, &motion, 0.3);
    let along = Vector3::new(-0.1, 0.1, -0.2).normalize();
    for i in 0..=500 {
        let hand = arm.ee_at(&motion.at(motion.duration_s() * f64::from(i) / 500.0).q);
        let off = hand.pos - begin.pos;
        assert!((off - along * off.dot(&along)).norm() < 5e-4, "{i}: {off:?}");
        assert!((hand.rot - begin.rot).amax() < 2e-3);
    }
    let beyond = straight_to(
        &arm,
        &scene,
        &Travel::default(),
        &from,
        &Goal::Point(begin.pos + Vector3::new(2.0, 0.0, 0.0)),
    );
    let Err(WayError::Line(LineError { after_m, of_m, what, .. })) = beyond else { panic!("{beyond:?}") };
    assert!(after_m > 0.01 && after_m < 1.5 && (of_m - 2.0).abs() < 1e-9);
    assert!(!matches!(what, LineBreak::Contact { .. }), "{what}");
    let post = Scene {
        obstacles: vec![box_at((begin.pos + Vector3::new(-0.1, 0.1, -0.2)).into(), [0.05; 3])],
        ball_held: false,
    };
    let hit = straight_to(
        &arm,
        &post,
        &Travel::default(),
        &from,
        &Goal::Point(begin.pos + Vector3::new(-0.1, 0.1, -0.2)),
    );
    assert!(
        matches!(&hit, Err(WayError::Line(LineError { what: LineBreak::Contact { .. }, .. }))),
        "{hit:?}"
    );
}

#[test]
fn hand_draws_a_square_on_its_sides_rests_at_its_corners_and_a_controller_has_room_for_it() {
    let (arm, scene) = (arm(), Scene::default());
    let near = deg([0.0, -60.0, -80.0, 0.0, 30.0, 0.0]);
    let corners =
        [[0.5, 0.15, 0.45], [0.5, -0.15, 0.45], [0.5, -0.15, 0.75], [0.5, 0.15, 0.75], [0.5, 0.15, 0.45]]
            .map(Vector3::from);
    let places = corners.map(Goal::Point);
    let motion = along_places(&arm, &scene, &Travel::default(), &near, &places).unwrap();
    require_free_and_within_limits(&arm, &scene, &motion, 0.3);
    assert!((9..=256).contains(&motion.knots.len()), "{} knots", motion.knots.len());
    let hand = |t_s: f64| arm.ee_at(&motion.at(t_s).q).pos;
    let mut ahead = corners.iter().peekable();
    for i in 0..=4_000 {
        let p = hand(motion.duration_s() * f64::from(i) / 4_000.0);
        let beside = corners.windows(2).map(|side| {
            let along = (side[1] - side[0]).normalize();
            let s = (p - side[0]).dot(&along).clamp(0.0, (side[1] - side[0]).norm());
            (p - side[0] - along * s).norm()
        });
        let beside_m = beside.fold(f64::INFINITY, f64::min);
        assert!(beside_m < 5e-4, "{i}: {beside_m} m beside the sides");
        ahead.next_if(|corner| (*corner - p).norm() < 1e-4);
    }
    assert_eq!(ahead.next(), None, "each corner is passed, in order");
    let rests = motion.knots.iter().filter(|knot| knot.qd_rad_s.amax() < 1e-9).count();
    assert_eq!(rests, 5);
    let far = [corners[0], Vector3::new(9.0, 0.0, 0.0)].map(Goal::Point);
    let refused = along_places(&arm, &scene, &Travel::default(), &near, &far).unwrap_err();
    assert!(matches!(refused, (2, WayError::Line(_))), "{refused:?}");
}

#[test]
fn blocked_ends_are_named() {
    let arm = arm();
    let good = deg([0.0, -90.0, -90.0, 0.0, 0.0, 0.0]);
    let outside = deg([0.0, -90.0, -90.0, 0.0, 0.0, 900.0]);
    let refused = way(&arm, &Scene::default(), &Travel::default(), &good, &outside).unwrap_err().to_string();
    assert!(refused.contains("joint 6 at 900.0 deg"), "{refused}");
    let hand = arm.ee_at(&good).pos;
    let scene = Scene { obstacles: vec![box_at(hand.into(), [0.05; 3])], ball_held: false };
    let other = deg([60.0, -60.0, -80.0, 10.0, 20.0, 0.0]);
    let refused = way(&arm, &scene, &Travel::default(), &good, &other).unwrap_err().to_string();
    assert!(
        refused.starts_with("at its present pose the arm touches something") && refused.contains("box"),
        "{refused}"
    );
    let travel = Travel { share: 1.5, ..Travel::default() };
    assert!(matches!(way(&arm, &scene, &travel, &good, &other), Err(WayError::Share { .. })));
}

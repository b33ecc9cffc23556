//! Plan files: the written file is the plan, bad files are named, and the second opinion agrees or objects.

use std::path::Path;

use nalgebra::Vector3;
use planner::motion::GripperEvent;
use planner::plan::file::{EventInfo, MotionInfo, PlanFile, PlanFileError, VERSION};
use planner::plan::options::HAND_CLEARANCE_M;
use planner::plan::problem::{Obstacle, Options, Problem};
use planner::plan::release_delays::ReleaseNodes;
use planner::plan::search::{Budget, Planner, Watch};
use planner::plan::statistics::{Noise, Region};
use planner::plan::{Arm, seeds};
use planner::record::{MovePlan, PlanRecord};
use planner::verify;
use robot_model::Pose;

fn plan(options: Options) -> (Arm, PlanFile) {
    plan_to(Vector3::new(1.0, 1.0, -1.0), options)
}

fn plan_to(target: Vector3<f64>, options: Options) -> (Arm, PlanFile) {
    let arm = Arm::load("powercube6").expect("built in");
    let file = {
        let problem = Problem::new(&arm, target, options).expect("valid");
        let budget = Budget { starts: 6, all: false, time: None, seed: 1 };
        let best = Planner::new(&problem)
            .search(&seeds::built_in(&arm), &budget, &Watch::default())
            .expect("in reach");
        PlanFile::of(
            &problem,
            &best,
            "powercube6",
            1,
            &Noise::default(),
            Some(Region::Disc { radius_m: 0.05 }),
        )
        .expect("lands")
    };
    (arm, file)
}

#[test]
fn a_plan_reads_back_to_the_same_bits() {
    let (_, file) = plan(Options::paper());
    let back = PlanFile::from_json(Path::new("p.json"), &file.to_json()).expect("reads");
    assert_eq!(file, back);
}

/// As version 5 of the format had it: polynomials in absolute time. Written by the program of that time.
const VERSION_5: &str = include_str!("data/throw_version_5.json");
/// As the first version of plans that follow a flight had it; most steps are cut.
const FOLLOW_VERSION_1: &str = include_str!("data/follow_version_1.json");

#[test]
fn plans_of_older_versions_are_read_with_the_same_motion() {
    let arm = Arm::load("powercube6").expect("built in");
    let path = Path::new("p.json");
    let newest = PlanFile::from_json(path, VERSION_5).expect("reads");
    assert_eq!((newest.version, newest.motion.knots.len(), newest.motion.joints.len()), (VERSION, 3, 6));
    assert!(verify::check(&arm, &newest).ok());
    // Joint 2 before its release: -1.9957.. t³ + 2.5290.. t² - 3.9580.. of the file.
    let t = 0.3_f64;
    let q = (-1.9957200674360418 * t + 2.529025961803713) * t * t - 3.958061369935754;
    assert!((newest.motion.to_motion().at(t).q[1] - q).abs() < 1e-13);
    assert_eq!(newest.motion.events, [EventInfo { t_s: newest.release_time_s, event: GripperEvent::Open }]);
    // Written and read again it is a file of this version.
    assert_eq!(PlanFile::from_json(path, &newest.to_json()).expect("reads"), newest);
    for (version, younger) in [
        (4, &["stored"][..]),
        (3, &["stored", "obstacles", "clearance_m"]),
        (2, &["stored", "obstacles", "clearance_m", "speed_use", "goal"]),
    ] {
        let mut value: serde_json::Value = serde_json::from_str(VERSION_5).expect("JSON");
        value["version"] = version.into();
        value["search"].as_object_mut().unwrap().retain(|key, _| !younger.contains(&key.as_str()));
        value.as_object_mut().unwrap().retain(|key, _| !younger.contains(&key.as_str()));
        let back = PlanFile::from_json(path, &value.to_string()).expect("reads");
        assert_eq!((back.version, &back.motion), (VERSION, &newest.motion));
        assert!(verify::check(&arm, &back).ok());
    }
}

#[test]
fn a_plan_of_version_10_is_read_for_a_ball_and_refused_for_a_thing_with_an_attitude() {
    let (arm, plan) = plan(Options::paper());
    let path = Path::new("p.json");
    let mut older = serde_json::from_str::<serde_json::Value>(&plan.to_json()).expect("JSON");
    older["version"] = 10.into();
    let read = PlanFile::from_json(path, &older.to_string()).expect("reads");
    assert_eq!((&read.motion, read.version), (&plan.motion, 10));
    assert!(verify::check(&arm, &read).ok());
    older["target"]["attitude"] = serde_json::json!({ "axis_e": [0, 0, 1], "inertia_ratio": 1.8 });
    for refused in [
        PlanFile::from_json(path, &older.to_string()).expect_err("not a ball"),
        PlanRecord::from_json(path, &older.to_string()).expect_err("not a ball"),
    ] {
        assert!(refused.to_string().contains("target.attitude"), "{refused}");
        assert!(refused.next().unwrap().starts_with("plan again"), "{refused}");
    }
}

#[test]
fn a_plan_of_each_kind_is_read_as_what_it_is_and_refused_as_what_it_is_not() {
    let (_, throw) = plan(Options::paper());
    let path = Path::new("p.json");
    let record = PlanRecord::from_json(path, &throw.to_json()).expect("reads");
    assert_eq!(record, PlanRecord::Throw(Box::new(throw.clone())));
    assert_eq!(serde_json::to_value(&record).unwrap()["kind"], "throw");
    let record = PlanRecord::from_json(path, FOLLOW_VERSION_1).expect("reads");
    let PlanRecord::Follow(follow) = &record else { panic!("{record:?}") };
    assert_eq!((follow.version, follow.format.as_str()), (VERSION, "cubectl-plan"));
    assert_eq!(PlanRecord::from_json(path, &follow.to_json()).expect("reads"), record);
    let moved = MovePlan::new(throw.robot.clone(), throw.motion.clone());
    let record = PlanRecord::from_json(path, &moved.to_json()).expect("reads");
    assert_eq!(record, PlanRecord::Move(Box::new(moved.clone())));

    let e = PlanFile::from_json(path, FOLLOW_VERSION_1).expect_err("another kind");
    assert!(e.to_string().contains("is of kind \"follow\", here one of kind \"throw\""), "{e}");
    assert!(e.next().is_some(), "{e}");
    let juggle = throw.to_json().replacen("\"kind\": \"throw\"", "\"kind\": \"juggle\"", 1);
    let e = PlanRecord::from_json(path, &juggle).expect_err("unknown").to_string();
    assert!(e.contains("its kind is \"juggle\"; this program knows throw, follow, move"), "{e}");
}

#[test]
fn an_invalid_motion_is_refused_with_its_place() {
    let (_, throw) = plan(Options::paper());
    let path = Path::new("p.json");
    type Spoil = fn(&mut MotionInfo);
    let table: [(Spoil, &str); 7] = [
        (|m| m.knots[1].t_s = 0.0, "knot 1 at 0 s does not follow"),
        (|m| m.knots[0].t_s = 0.1, "knot 0 at 0.1 s does not follow"),
        (|m| _ = m.knots[2].q_rad.pop(), "knot 2: q_rad has 5 numbers, expected 6"),
        (|m| m.knots.truncate(1), "motion.knots has 1 knots"),
        (|m| m.events[0].t_s = 9.0, "an event at 9 s is not within the motion"),
        (|m| m.joints.clear(), "motion.joints has 0 names"),
        (|m| m.knots[2].qd_rad_s.push(0.0), "knot 2: qd_rad_s has 7 numbers"),
    ];
    for (spoil, what) in table {
        let mut moved = MovePlan::new(throw.robot.clone(), throw.motion.clone());
        spoil(&mut moved.motion);
        let e = PlanRecord::from_json(path, &moved.to_json()).expect_err(what).to_string();
        assert!(e.contains(what), "{what}: {e}");
    }
    let mut late = throw.clone();
    late.motion.events[0].t_s += 0.01;
    let e = PlanFile::from_json(path, &late.to_json()).expect_err("two releases").to_string();
    assert!(e.contains("its gripper opens at"), "{e}");
}

#[test]
fn a_stated_release_or_landing_that_is_not_the_motions_is_refused() {
    let (arm, throw) = plan(Options::best());
    assert!(verify::check(&arm, &throw).ok());
    type Spoil = fn(&mut PlanFile);
    let table: [(Spoil, &str); 8] = [
        (|f| f.release.q_rad[1] += 2e-4, "angle at the release, joint 2"),
        (|f| f.release.qd_rad_s[5] -= 2e-4, "speed at the release, joint 6"),
        (|f| f.release.qdd_rad_s2[0] = f64::NAN, "acceleration at the release, joint 1"),
        (|f| f.release.position_m[2] += 2e-4, "ball at the release, axis 3"),
        (|f| f.release.velocity_m_s[0] += 0.01, "velocity of the ball at the release, axis 1"),
        (|f| f.landing.flight_s += 2e-4, "time of flight"),
        (|f| f.landing.position_m[1] += 2e-4, "landing, axis 2"),
        (|f| f.landing.velocity_m_s[2] *= 0.999, "velocity at the landing, axis 3"),
    ];
    for (spoil, what) in table {
        let mut other = throw.clone();
        spoil(&mut other);
        let refused: Vec<_> =
            verify::check(&arm, &other).findings.into_iter().filter(|f| f.enforced && !f.ok).collect();
        assert_eq!(refused.len(), 1, "{what}: {refused:?}");
        assert!(refused[0].worst.contains(what), "{what}: {refused:?}");
    }
}

#[test]
fn the_committed_schema_is_the_one_of_the_types() {
    let committed = include_str!("../schemas/plan.schema.json");
    let differs = "run `cargo run -p planner --example plan_schema > host/planner/schemas/plan.schema.json`";
    assert!(planner::record::schema_json() == committed, "{differs}");
    // It knows every kind and every key of the motion.
    for word in ["\"throw\"", "\"follow\"", "\"move\"", "\"qd_rad_s\"", "\"events\"", "\"steps\""] {
        assert!(committed.contains(word), "{word}");
    }
}

#[test]
fn the_second_opinion_agrees_with_both_forms() {
    for options in [Options::paper(), Options::best()] {
        let (arm, file) = plan(options);
        let report = verify::check(&arm, &file);
        assert!(report.ok(), "{:#?}", report.findings);
        assert!(report.findings.len() >= 10);
    }
}

#[test]
fn obstacles_are_in_the_file_and_the_second_opinion_sees_them() {
    let wall = Obstacle {
        name: "wall".to_owned(),
        x_wo: Pose::translation(0.9, 0.0, -0.8),
        half_m: Vector3::new(0.3, 0.02, 0.2),
    };
    let (arm, good) = plan(Options { obstacles: vec![wall], clearance_m: 0.01, ..Options::best() });
    let good = PlanFile::from_json(Path::new("p.json"), &good.to_json()).expect("reads");
    let report = verify::check(&arm, &good);
    assert!(report.ok(), "{:#?}", report.findings);
    // Moved into the flight, and into the arm.
    for (to, what) in [
        ([0.97, 0.97, -0.85], "released ball clear of the obstacles"),
        ([0.3, 0.2, 0.0], "arm and held ball"),
    ] {
        let mut file = good.clone();
        for (row, value) in file.obstacles[0].x_wo.iter_mut().zip(to) {
            row[3] = value;
        }
        let failed = verify::check(&arm, &file).findings.into_iter().find(|f| !f.ok && f.enforced);
        let failed = failed.expect("an obstacle in the way");
        assert!(failed.what.starts_with(what), "{failed:?}");
    }
    let mut file = good;
    file.obstacles[0].half_m[1] = 0.0;
    let e = PlanFile::from_json(Path::new("p.json"), &file.to_json()).expect_err("flat");
    assert!(e.to_string().contains("obstacle \"wall\" is not a box"), "{e}");
}

#[test]
fn our_form_keeps_bodies_apart_and_the_second_opinion_holds_it_to_that() {
    // Without a clearance the best throw to this target passes the column at 0.2 mm.
    let (arm, good) = plan_to(Vector3::new(1.5, 0.0, -0.5), Options::best());
    assert!(verify::check(&arm, &good).ok());
    let kept_m = good.margins.clearance_m.expect("measured");
    assert!((0.005..0.006).contains(&kept_m), "{kept_m}");
    let mut file = good;
    file.search.clearance_m = 0.006;
    let failed = verify::check(&arm, &file).findings.into_iter().find(|f| !f.ok && f.enforced);
    let failed = failed.expect("a clearance that is claimed and not kept");
    assert!(failed.worst.contains(" of 6.0 mm"), "{failed:?}");
}

#[test]
fn the_released_ball_keeps_its_clearance_from_the_hand_and_the_second_opinion_holds_it_to_that() {
    // The cheapest throw to this target leaves the ball beside the fingers for as long as it may.
    let (arm, good) = plan_to(Vector3::new(1.37, 1.35, -0.57), Options::best());
    assert!(verify::check(&arm, &good).ok());
    assert_eq!(good.search.hand_clearance_m, HAND_CLEARANCE_M);
    let kept_m = good.margins.ball_clearance_m;
    assert!((HAND_CLEARANCE_M..1.1 * HAND_CLEARANCE_M).contains(&kept_m), "{kept_m}");
    let mut file = good;
    file.search.hand_clearance_m = 2.2e-4;
    let failed = verify::check(&arm, &file).findings.into_iter().find(|f| !f.ok && f.enforced);
    let failed = failed.expect("a clearance that is claimed and not kept");
    assert!(failed.worst.contains("0.20 mm of 0.22 mm"), "{failed:?}");
}

#[test]
fn the_second_opinion_objects_to_a_tampered_plan() {
    let (arm, good) = plan(Options::paper());
    let failing = |file: &PlanFile| -> Vec<String> {
        verify::check(&arm, file)
            .findings
            .into_iter()
            .filter(|f| !f.ok && f.enforced)
            .map(|f| f.what)
            .collect()
    };
    // The ball goes elsewhere when joint 1 starts a hundredth of a radian off.
    let mut file = good.clone();
    for knot in &mut file.motion.knots {
        knot.q_rad[0] += 0.01;
    }
    let reported = "stated release and landing are those of the motion";
    assert_eq!(failing(&file), ["landing on the target", reported]);
    // The end alone: the acceleration jumps at the release.
    let mut file = good.clone();
    file.motion.knots[2].q_rad[2] += 0.01;
    assert!(failing(&file).iter().any(|f| f.starts_with("segments meet")));
    // Ten times as fast: speed, acceleration and jerk.
    let mut file = good;
    for knot in &mut file.motion.knots {
        knot.q_rad[1] *= 10.0;
        knot.qd_rad_s[1] *= 10.0;
    }
    let failed = failing(&file);
    for what in ["joint ranges", "joint speeds", "joint accelerations", "joint jerks"] {
        assert!(failed.iter().any(|f| f == what), "{what}: {failed:?}");
    }
}

#[test]
fn bad_files_are_refused_with_the_reason() {
    let (arm, file) = plan(Options::paper());
    let path = Path::new("p.json");
    let text = file.to_json();
    let (this, next) = (VERSION, VERSION + 1);
    let newer = text.replacen(&format!("\"version\": {this}"), &format!("\"version\": {next}"), 1);
    let e = PlanFile::from_json(path, &newer).expect_err("newer");
    assert!(matches!(e, PlanFileError::Newer { found, .. } if found == u64::from(next)));
    assert_eq!(
        e.to_string(),
        format!(
            "plan p.json has version {next}, this program reads up to {this}: update cubectl or plan again"
        )
    );
    for broken in [&text[..text.len() / 2], "", "[]", "{\"format\": \"something\"}"] {
        assert!(matches!(PlanFile::from_json(path, broken), Err(PlanFileError::Damaged { .. })), "{broken}");
    }
    let unknown = text.replacen("\"release_time_s\"", "\"release_time_ms\"", 1);
    let e = PlanFile::from_json(path, &unknown).expect_err("wrong unit");
    assert!(e.to_string().contains("release_time_ms"), "{e}");
    let gap = VERSION_5.replacen("\"t_start_s\": 0.4968147129153438", "\"t_start_s\": 0.5968147129153438", 1);
    let e = PlanFile::from_json(path, &gap).expect_err("gap");
    assert!(e.to_string().contains("does not follow"), "{e}");
    let mut heavy = file.clone();
    let (_, nodes) = ReleaseNodes::of(&[0.019, 0.02, 0.021, 0.019, 0.02, 0.021, 0.02, 0.02]).expect("delays");
    heavy.landing.noise.release_nodes = Some(nodes);
    let mut heavy: serde_json::Value = serde_json::from_str(&heavy.to_json()).expect("JSON");
    assert!(PlanFile::from_json(path, &heavy.to_string()).is_ok());
    heavy["landing"]["noise"]["release_nodes"]["weight"][0] = 1.5.into();
    let e = PlanFile::from_json(path, &heavy.to_string()).expect_err("weights");
    assert!(e.to_string().contains("weights that add up to one"), "{e}");
    let mut other = file;
    other.robot.fingerprint = "0".repeat(16);
    assert!(matches!(other.require_robot(path, &arm), Err(PlanFileError::OtherRobot { .. })));
    let missing = PlanFile::read(Path::new("/nonexistent/p.json")).expect_err("missing");
    assert!(missing.to_string().contains("/nonexistent/p.json"));
}

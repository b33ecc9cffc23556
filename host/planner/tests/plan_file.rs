//! Plan files: what is written is what was planned, bad files are named, and the second opinion agrees or objects.

use std::path::Path;

use nalgebra::Vector3;
use planner::plan::file::{PlanFile, PlanFileError};
use planner::plan::problem::{Obstacle, Options, Problem};
use planner::plan::search::{Budget, Planner, Watch};
use planner::plan::statistics::{Noise, Region};
use planner::plan::{Arm, seeds};
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

#[test]
fn plans_of_older_versions_are_read() {
    let (arm, file) = plan(Options::paper());
    for (version, younger) in [
        (4, &["stored"][..]),
        (3, &["stored", "obstacles", "clearance_m"]),
        (2, &["stored", "obstacles", "clearance_m", "speed_use", "goal"]),
    ] {
        let text = file.to_json().replacen("\"version\": 5", &format!("\"version\": {version}"), 1);
        // A field that was the last of its list leaves a comma behind.
        let keep = |l: &&str| !younger.iter().any(|key| l.trim_start().starts_with(&format!("\"{key}\"")));
        let lines: Vec<&str> = text.lines().filter(keep).collect();
        let older = lines.join("").replace(",  }", "  }");
        let back = PlanFile::from_json(Path::new("p.json"), &older).expect("reads");
        assert_eq!((back.version, &back.search), (version, &file.search));
        assert!(verify::check(&arm, &back).ok());
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
    for segment in &mut file.joints[0].segments {
        segment.coefficients_rad[3] += 0.01;
    }
    assert_eq!(failing(&file), ["landing on the target"]);
    // One segment alone: the motion jumps.
    let mut file = good.clone();
    file.joints[2].segments[1].coefficients_rad[3] += 0.01;
    assert!(failing(&file).iter().any(|f| f.starts_with("segments meet")));
    // Ten times as fast: speed, acceleration and jerk.
    let mut file = good;
    for segment in &mut file.joints[1].segments {
        for c in &mut segment.coefficients_rad {
            *c *= 10.0;
        }
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
    let newer = text.replacen("\"version\": 5", "\"version\": 6", 1);
    let e = PlanFile::from_json(path, &newer).expect_err("newer");
    assert!(matches!(e, PlanFileError::Newer { found: 6, .. }));
    assert_eq!(
        e.to_string(),
        "plan p.json has version 6, this program reads up to 5: update cubectl or plan again"
    );
    for broken in [&text[..text.len() / 2], "", "[]", "{\"format\": \"something\"}"] {
        assert!(matches!(PlanFile::from_json(path, broken), Err(PlanFileError::Damaged { .. })), "{broken}");
    }
    let unknown = text.replacen("\"release_time_s\"", "\"release_time_ms\"", 1);
    let e = PlanFile::from_json(path, &unknown).expect_err("wrong unit");
    assert!(e.to_string().contains("release_time_ms"), "{e}");
    let mut gap = file.clone();
    gap.joints[3].segments[1].t_start_s += 0.1;
    let e = PlanFile::from_json(path, &gap.to_json()).expect_err("gap");
    assert!(e.to_string().contains("does not follow"), "{e}");
    let mut other = file;
    other.robot.fingerprint = "0".repeat(16);
    assert!(matches!(other.require_robot(path, &arm), Err(PlanFileError::OtherRobot { .. })));
    let missing = PlanFile::read(Path::new("/nonexistent/p.json")).expect_err("missing");
    assert!(missing.to_string().contains("/nonexistent/p.json"));
}

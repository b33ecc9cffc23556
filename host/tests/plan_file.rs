//! Plan files: what is written is what was planned, bad files are named, and the second opinion agrees or objects.

use std::path::Path;

use host::plan::file::{PlanFile, PlanFileError};
use host::plan::problem::{Options, Problem};
use host::plan::search::{Budget, Planner, Watch};
use host::plan::statistics::{Noise, Region};
use host::plan::{Arm, seeds};
use host::verify;
use nalgebra::Vector3;

fn plan(options: Options) -> (Arm, PlanFile) {
    let arm = Arm::load("powercube6").expect("built in");
    let file = {
        let problem = Problem::new(&arm, Vector3::new(1.0, 1.0, -1.0), options).expect("valid");
        let budget = Budget { starts: 6, time: None, seed: 1 };
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
    let (_, file) = plan(Options::paper());
    let text = file.to_json().replacen("\"version\": 3", "\"version\": 2", 1);
    let older: String = text.lines().filter(|l| !l.contains("\"goal\"")).collect();
    let back = PlanFile::from_json(Path::new("p.json"), &older).expect("reads");
    assert_eq!((back.version, back.search), (2, file.search));
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
    let newer = text.replacen("\"version\": 3", "\"version\": 4", 1);
    let e = PlanFile::from_json(path, &newer).expect_err("newer");
    assert!(matches!(e, PlanFileError::Newer { found: 4, .. }));
    assert_eq!(
        e.to_string(),
        "plan p.json has version 4, this program reads up to 3: update cubectl or plan again"
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

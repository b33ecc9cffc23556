//! What `cubectl throw` says about the ball, against what the simulated cell does with it.

use crate::bus_common::{Folder, code, cubectl, err, out};
use host::cmd::log::report;
use operator::job::throw::computed_landing;
use operator::job::verdict::judge;
use operator::job::{BallOutcome, Order, Outcome, Record};
use planner::plan::file::PlanFile;
use planner::way::Travel;
use serde_json::Value;

/// A throw in the simulated cell with `faults`; its exit code, what it printed, and its summary.
fn throw(folder: &Folder, name: &str, faults: &str, words: &[&str]) -> (i32, String, Value) {
    let scenario = folder.file(&format!("{name}.toml"));
    std::fs::write(
        &scenario,
        format!("schema_version = 1\nname = \"f\"\nseed = 1\nduration_s = 60.0\n{faults}"),
    )
    .unwrap();
    let dir = folder.file(name);
    let mut all = vec!["throw", "--target", "1,1,-1", "--yes", "--scenario", &scenario];
    all.extend(["--out", &dir]);
    all.extend(words);
    let output = cubectl(&all);
    let printed = format!("{}{}", out(&output), err(&output));
    println!("--- {name}: exit {}\n{printed}", code(&output));
    let text = std::fs::read_to_string(folder.0.join(name).join("summary.json")).unwrap();
    let summary: Value = serde_json::from_str(&text).unwrap();
    // Three places report the same.
    assert_eq!(summary["exit_code"], code(&output));
    assert!(printed.contains(&dir), "the folder is named");
    let report = std::fs::read_to_string(folder.0.join(name).join("report.html")).unwrap();
    let words = match summary["outcome"].as_str().unwrap() {
        "not_released" => "not released",
        "not_thrown" => "not thrown",
        other => other,
    };
    assert!(report.contains(words), "{words} in the report");
    (code(&output), printed, summary)
}

/// When the throw begins in virtual time: the sum of the steps before it in an undisturbed run of the same seed.
fn begin_s(folder: &Folder) -> f64 {
    let (code, _, summary) = throw(folder, "undisturbed", "", &[]);
    assert_eq!((code, &summary["outcome"]), (0, &Value::from("landed")));
    let steps = summary["steps"].as_array().unwrap().iter();
    steps.take_while(|step| step["step"] != "throw").map(|step| step["bus_time_s"].as_f64().unwrap()).sum()
}

#[test]
fn a_stuck_gripper_is_not_released_with_its_own_exit_code() {
    let folder = Folder::new("outcome-gripper");
    let (code, printed, summary) =
        throw(&folder, "gripper", "[[fault]]\nkind = \"stuck-gripper\"\nstart_s = 0.0\n", &["--back"]);
    assert_eq!(code, 12, "{printed}");
    assert_eq!((&summary["outcome"], &summary["ball"]), (&"not_released".into(), &"in_hand".into()));
    assert!(
        printed.contains("not released: the gripper was ordered to open at") && printed.contains("next: ")
    );
    assert!(!printed.contains("landed"), "{printed}");
    assert_eq!(summary["landing"], Value::Null);
}

#[test]
fn a_late_release_is_missed_with_its_own_exit_code_and_tolerance_decides() {
    let folder = Folder::new("outcome-late");
    let fault = "[[fault]]\nkind = \"late-release\"\nby_s = 0.3\nstart_s = 0.0\n";
    let (code, printed, summary) = throw(&folder, "late", fault, &[]);
    assert_eq!((code, &summary["outcome"]), (11, &"missed".into()), "{printed}");
    let error_m = summary["landing_error_m"].as_f64().unwrap();
    assert!((0.40..0.55).contains(&error_m), "{error_m}");
    // Twice three standard deviations of the plan's spread: some centimetres.
    let tolerance_m = summary["tolerance_m"].as_f64().unwrap();
    assert!((0.010..0.060).contains(&tolerance_m), "{tolerance_m}");
    assert!(printed.contains("missed: the ball landed ") && printed.contains("next: "), "{printed}");
    let (code, _, summary) = throw(&folder, "wide", fault, &["--tolerance-m", "0.6"]);
    assert_eq!((code, &summary["outcome"], &summary["tolerance_m"]), (0, &"landed".into(), &0.6.into()));
    let (code, _, summary) = throw(&folder, "narrow", "", &["--tolerance-m", "0.0001"]);
    assert_eq!((code, &summary["outcome"]), (11, &"missed".into()));
}

#[test]
fn counts_lost_in_mid_throw_end_as_missed() {
    let folder = Folder::new("outcome-counts");
    // The sum leaves out the time between the steps, some 30 ms.
    let start_s = begin_s(&folder) + 0.15;
    let fault = format!(
        "[[fault]]\nkind = \"encoder-error\"\ntarget = \"module 1\"\noffset_deg = 5\nstart_s = {start_s}\n"
    );
    let (code, printed, summary) = throw(&folder, "counts", &fault, &[]);
    assert_eq!((code, &summary["outcome"]), (11, &"missed".into()), "{printed}");
    let error_m = summary["landing_error_m"].as_f64().unwrap();
    assert!((0.08..0.16).contains(&error_m), "{error_m}");
}

#[test]
fn a_throw_that_is_stopped_names_cause_and_folder_and_leaves_a_report() {
    let folder = Folder::new("outcome-stopped");
    let begin_s = begin_s(&folder);
    for (name, at_s, step) in
        [("mid-throw", begin_s + 0.3, "throw"), ("approach", begin_s - 2.0, "to the start")]
    {
        let fault = format!("[[fault]]\nkind = \"silent\"\ntarget = \"module 2\"\nstart_s = {at_s}\n");
        let (code, printed, summary) = throw(&folder, name, &fault, &[]);
        assert_eq!((code, &summary["outcome"]), (13, &"stopped".into()), "{printed}");
        assert!(printed.contains("joint 2: a drive missed more replies"), "{printed}");
        assert!(printed.contains("(fault 101)") && printed.contains("next: "), "{printed}");
        assert_eq!((&summary["ended_in_step"], &summary["ball"]), (&step.into(), &"in_hand".into()));
        assert!(summary["cause"].as_str().unwrap().contains("fault 101"));
        // `cubectl log report` makes the same page again.
        let again = cubectl(&["log", "report", &folder.file(name)]);
        assert_eq!(crate::bus_common::code(&again), 0, "{}", err(&again));
    }
}

#[test]
fn a_throw_that_never_began_is_not_thrown_with_the_exit_code_of_its_cause() {
    let folder = Folder::new("outcome-not-thrown");
    let fault = "[[fault]]\nkind = \"silent\"\ntarget = \"module 3\"\n";
    let (code, printed, summary) = throw(&folder, "silent", fault, &[]);
    assert_eq!((code, &summary["outcome"]), (8, &"not_thrown".into()), "{printed}");
    assert!(printed.contains("module 3: no answer"), "{printed}");
}

/// What a host on a real bus would say of the throw in a folder: it has the log, but does not see the ball.
fn unobserved(folder: &Folder, name: &str) -> (Outcome, String, Record) {
    let dir = folder.0.join(name);
    let [plan, log, summary] = ["plan.json", "bus.log", "summary.json"].map(|file| dir.join(file));
    let recorded = report::read(&plan, &log, Some(&summary), None, None).unwrap();
    let plan = recorded.ran.throw.as_ref().unwrap();
    let order = Order::throw(&recorded.arm, plan, Travel::default());
    let analysis = recorded.analysis.unwrap();
    let landing = computed_landing(plan, &analysis);
    let record =
        Record { ball: BallOutcome::NotObserved, landing, analysis: Some(analysis), ..Record::default() };
    let verdict = judge(&order, &record);
    println!("{name} unobserved: {}", verdict.text);
    (verdict.outcome, verdict.text, record)
}

#[test]
fn without_a_witness_nothing_is_called_landed_and_the_measured_motion_says_where_the_ball_should_be() {
    let folder = Folder::new("outcome-unobserved");
    for (name, faults) in [
        ("good", ""),
        // Both look the same to a host that does not see the ball.
        ("stuck", "[[fault]]\nkind = \"stuck-gripper\"\nstart_s = 0.0\n"),
    ] {
        let (_, _, summary) = throw(&folder, name, faults, &[]);
        let (outcome, text, record) = unobserved(&folder, name);
        let release_s = PlanFile::read(&folder.0.join(name).join("plan.json")).unwrap().release_time_s;
        assert_eq!(outcome, Outcome::NotObserved, "{text}");
        assert!(text.contains("nobody watched the ball") && !text.contains("landed"), "{text}");
        // The gripper takes 20 ms to open, and its order waits for a place among the frames of a cycle of 3 ms.
        let ordered_s: f64 = text.split_once("ordered to open at ").unwrap().1[..5].parse().unwrap();
        assert!((0.015..0.025).contains(&(release_s - ordered_s)), "{text}");
        let landing = record.landing.unwrap();
        let uncertainty_m = landing.uncertainty_m.unwrap();
        assert!((0.001..0.020).contains(&uncertainty_m), "{uncertainty_m}");
        if name == "good" {
            let seen: Vec<f64> = summary["landing"]["position_m"]
                .as_array()
                .unwrap()
                .iter()
                .map(|x| x.as_f64().unwrap())
                .collect();
            let off_m = (landing.position_m.x - seen[0]).hypot(landing.position_m.y - seen[1]);
            assert!((1e-6..uncertainty_m).contains(&off_m), "{off_m} against {uncertainty_m}");
        }
    }
}

/// The paper's form allows the ball to touch the hand on its way. The simulated cell says what becomes of such a throw.
#[test]
fn a_throw_whose_ball_would_touch_the_arm_is_refused_unless_it_is_asked_for() {
    let folder = Folder::new("outcome-touch");
    let run = |name: &str, words: &[&str]| {
        let (dir, plan) = (folder.file(name), folder.file(&format!("{name}.json")));
        let mut all = vec!["plan", "throw", "--form", "paper", "--target", "0.9,0,0.2", "--starts", "2"];
        all.extend(["--out", &plan]);
        all.extend(words);
        let planned = cubectl(&all);
        assert_eq!(code(&planned), 0, "{}", err(&planned));
        let output = cubectl(&["throw", "--plan", &plan, "--yes", "--out", &dir]);
        (code(&output), format!("{}{}", out(&output), err(&output)))
    };
    let (refused, printed) = run("refused", &[]);
    assert_eq!(refused, 4, "{printed}");
    assert!(printed.contains("would touch the arm") && printed.contains("next: "), "{printed}");
    let (missed, printed) = run("asked", &["--clean-release", "false"]);
    assert_eq!(missed, 11, "{printed}");
    assert!(printed.contains("the ball touched the arm"), "{printed}");
    let (landed, printed) = run("clean", &["--clean-release", "true"]);
    assert_eq!(landed, 0, "{printed}");
    let plan = cubectl(&["plan", "throw", "--form", "paper", "--target", "0.9,0,0.2", "--starts", "2"]);
    assert!(out(&plan).contains("the released ball touches the arm"), "{}", out(&plan));
}

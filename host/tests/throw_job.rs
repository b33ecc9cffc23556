//! `cubectl throw` in the simulated cell: the whole job, as people run it.

mod bus_common;

use bus_common::{Folder, code, cubectl, err, out};

fn summary(folder: &Folder, name: &str) -> serde_json::Value {
    let text = std::fs::read_to_string(folder.0.join(name).join("summary.json")).unwrap();
    serde_json::from_str(&text).unwrap()
}

#[test]
fn one_command_plans_homes_uploads_throws_and_tells_where_the_ball_landed() {
    let folder = Folder::new("throw");
    let output = cubectl(&["throw", "--target", "1.0,1.0,-1.0", "--no-store", "--out", &folder.file("a")]);
    assert_eq!(code(&output), 0, "{}", err(&output));
    assert!(out(&output).contains("mm from the target"), "{}", out(&output));
    for step in ["plan", "drives, watchdogs", "home", "to the start", "upload", "arm", "throw"] {
        assert!(err(&output).lines().any(|line| line.starts_with(step)), "{step}: {}", err(&output));
    }
    let report = summary(&folder, "a");
    let landing_error_m = report["landing_error_m"].as_f64().unwrap();
    assert!((1e-6..0.005).contains(&landing_error_m), "{landing_error_m}");
    assert_eq!(report["outcome"], "landed");
    for error in report["tracking"]["error_max_rad"].as_array().unwrap() {
        assert!((1e-5..5e-3).contains(&error.as_f64().unwrap()), "{report:#}");
    }
    assert_eq!(report["cycle"]["late"], 0, "{report:#}");
    assert_eq!(report["cycle"]["replies_missed"], 0);
    for name in ["plan.json", "gains.toml", "log.candump", "log.mcap"] {
        assert!(folder.0.join("a").join(name).metadata().unwrap().len() > 100, "{name}");
    }
    // The recording holds all that the controller did: it is repeated from it, bit for bit.
    let log = folder.file("a/log.candump");
    let replayed = cubectl(&["replay", &log]);
    assert_eq!(code(&replayed), 0, "{}{}", out(&replayed), err(&replayed));
    // The same seed is the same run.
    let again = cubectl(&["throw", "--target", "1.0,1.0,-1.0", "--no-store", "--out", &folder.file("b")]);
    assert_eq!(code(&again), 0, "{}", err(&again));
    assert_eq!(std::fs::read(&log).unwrap(), std::fs::read(folder.file("b/log.candump")).unwrap());
}

#[test]
fn a_throw_at_another_period_is_repeated_from_its_folder_bit_for_bit() {
    let folder = Folder::new("throw-replay");
    let thrown = folder.file("a");
    let target = ["throw", "--target", "1.0,1.0,-1.0", "--no-store", "--period", "10", "--out", &thrown];
    assert_eq!(code(&cubectl(&target)), 0);
    let replayed = cubectl(&["replay", &thrown]);
    assert_eq!(code(&replayed), 0, "{}{}", out(&replayed), err(&replayed));
    // Without its gains it is another controller, and that is seen.
    std::fs::remove_file(folder.file("a/gains.toml")).unwrap();
    let replayed = cubectl(&["replay", &thrown]);
    assert_eq!(code(&replayed), 9, "{}{}", out(&replayed), err(&replayed));
}

#[test]
fn a_stored_plan_is_thrown_and_the_arm_goes_back_if_asked() {
    let folder = Folder::new("throw-plan");
    let plan = folder.file("plan.json");
    let planned = cubectl(&["plan", "throw", "--target", "2,0,0", "--fast", "--no-store", "--out", &plan]);
    assert_eq!(code(&planned), 0, "{}", err(&planned));
    let output = cubectl(&["throw", "--plan", &plan, "--back", "--json", "--out", &folder.file("a")]);
    assert_eq!(code(&output), 0, "{}", err(&output));
    let report: serde_json::Value = serde_json::from_str(&out(&output)).unwrap();
    // Within the predicted spread of this plan, whatever the phase of the drives at the start.
    let (error_m, tolerance_m) = (report["landing_error_m"].as_f64(), report["tolerance_m"].as_f64());
    let within = 1e-6..tolerance_m.unwrap();
    assert!(within.contains(&error_m.unwrap()) && within.end < 0.05, "{report:#}");
    let steps: Vec<&str> =
        report["steps"].as_array().unwrap().iter().map(|step| step["step"].as_str().unwrap()).collect();
    assert_eq!(steps.last(), Some(&"back"), "{steps:?}");
}

#[test]
fn upload_and_run_take_plans_too_and_run_refuses_an_arm_that_stands_elsewhere() {
    let folder = Folder::new("throw-upload");
    let plan = folder.file("plan.json");
    assert_eq!(
        code(&cubectl(&["plan", "throw", "--target", "1,1,-1", "--fast", "--no-store", "--out", &plan])),
        0
    );
    let uploaded = cubectl(&["upload", &plan]);
    assert_eq!(code(&uploaded), 0, "{}", err(&uploaded));
    assert!(out(&uploaded).contains("184 bytes stored and committed"), "{}", out(&uploaded));
    let run = cubectl(&["run", &plan, "--home"]);
    assert_eq!(code(&run), 8, "{}", out(&run));
    assert!(err(&run).contains("is not where the plan begins"), "{}", err(&run));
    std::fs::write(&plan, "nonsense").unwrap();
    let refused = cubectl(&["run", &plan]);
    assert_eq!(code(&refused), 4);
    assert!(err(&refused).contains("neither a plan (JSON) nor a trajectory file"), "{}", err(&refused));
}

//! `cubectl throw` in the simulated cell: the whole job, as people run it.

use crate::bus_common::{Folder, code, cubectl, err, out};

fn summary(folder: &Folder, name: &str) -> serde_json::Value {
    let text = std::fs::read_to_string(folder.0.join(name).join("summary.json")).unwrap();
    serde_json::from_str(&text).unwrap()
}

#[test]
fn one_command_plans_homes_uploads_throws_and_tells_where_the_ball_landed() {
    let folder = Folder::new("throw");
    let output = cubectl(&["throw", "--target", "1.0,1.0,-1.0", "--out", &folder.file("a")]);
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
    // A cycle is late if the answer to its last motion comes after the period of 3 ms. One parameter and one motion per drive, with
    // their answers, are 24 frames, 2.3 ms. In 30 throws every late cycle had another frame on the bus: the read of a drive, whose
    // answer can go before the last one, or a frame of the host link of 0.14 ms. Most answers were late by less than 0.1 ms.
    // Cycles in which two drives got two parameters each were not late.
    assert!(report["cycle"]["late"].as_u64().unwrap() <= 3, "{report:#}");
    assert_eq!(report["cycle"]["replies_missed"], 0);
    for name in ["plan.json", "gains.toml", "bus.log", "bus.mcap"] {
        assert!(folder.0.join("a").join(name).metadata().unwrap().len() > 100, "{name}");
    }
    // The recording holds all that the controller did: it is repeated from it, bit for bit.
    let log = folder.file("a/bus.log");
    let replayed = cubectl(&["log", "replay", &log]);
    assert_eq!(code(&replayed), 0, "{}{}", out(&replayed), err(&replayed));
    // The same seed is the same run.
    let again = cubectl(&["throw", "--target", "1.0,1.0,-1.0", "--out", &folder.file("b")]);
    assert_eq!(code(&again), 0, "{}", err(&again));
    assert_eq!(std::fs::read(&log).unwrap(), std::fs::read(folder.file("b/bus.log")).unwrap());
}

#[test]
fn a_throw_at_another_period_is_repeated_from_its_folder_bit_for_bit() {
    let folder = Folder::new("throw-replay");
    let thrown = folder.file("a");
    let target = ["throw", "--target", "1.0,1.0,-1.0", "--period-ms", "10", "--out", &thrown];
    assert_eq!(code(&cubectl(&target)), 0);
    let replayed = cubectl(&["log", "replay", &thrown]);
    assert_eq!(code(&replayed), 0, "{}{}", out(&replayed), err(&replayed));
    // Without its gains it is another controller, and that is seen.
    std::fs::remove_file(folder.file("a/gains.toml")).unwrap();
    let replayed = cubectl(&["log", "replay", &thrown]);
    assert_eq!(code(&replayed), 9, "{}{}", out(&replayed), err(&replayed));
}

#[test]
fn a_stored_plan_is_thrown_and_the_arm_goes_back_if_asked() {
    let folder = Folder::new("throw-plan");
    let plan = folder.file("plan.json");
    let planned = cubectl(&["plan", "throw", "--target", "2,0,0", "--fast", "--out", &plan]);
    assert_eq!(code(&planned), 0, "{}", err(&planned));
    let output = cubectl(&["throw", "--plan", &plan, "--back", "--json", "--out", &folder.file("a")]);
    assert_eq!(code(&output), 0, "{}", err(&output));
    let report: serde_json::Value = serde_json::from_str(&out(&output)).unwrap();
    // The plan is insensitive to the time of release (0.001 mm for each millisecond), so what remains are the steps of the
    // encoders: 1.0 mm root mean square over 200 arms (`tests/suites/throw`). Five times that is no chance.
    let error_m = report["landing_error_m"].as_f64().unwrap();
    assert!((1e-6..0.005).contains(&error_m), "{report:#}");
    let steps: Vec<&str> =
        report["steps"].as_array().unwrap().iter().map(|step| step["step"].as_str().unwrap()).collect();
    assert_eq!(steps.last(), Some(&"back"), "{steps:?}");
}

#[test]
fn upload_and_run_take_plans_too_and_run_refuses_an_arm_that_stands_elsewhere() {
    let folder = Folder::new("throw-upload");
    let plan = folder.file("plan.json");
    assert_eq!(code(&cubectl(&["plan", "throw", "--target", "1,1,-1", "--fast", "--out", &plan])), 0);
    let uploaded = cubectl(&["controller", "upload", &plan]);
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

#[test]
fn a_plan_of_kind_move_runs_from_where_the_arm_stands_at_the_time_that_was_asked_for() {
    let folder = Folder::new("run-move");
    let (plan, moved) = (folder.file("plan.json"), folder.file("move.json"));
    assert_eq!(code(&cubectl(&["plan", "throw", "--target", "1,1,-1", "--fast", "--out", &plan])), 0);
    let throw: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(&plan).unwrap()).unwrap();
    // Where the arm stands once it is homed.
    let quarter_rad = std::f64::consts::FRAC_PI_2;
    let stands_rad = [0.0, -quarter_rad, -quarter_rad, 0.0, 0.0, 0.0];
    let knot = |t_s: f64, way_rad: f64| serde_json::json!({ "t_s": t_s, "q_rad": stands_rad.map(|q| q + way_rad), "qd_rad_s": vec![0.0; 6] });
    let text = serde_json::json!({
        "format": "cubectl-plan",
        "version": 6,
        "kind": "move",
        "robot": throw["robot"],
        "motion": { "joints": throw["motion"]["joints"], "knots": [knot(0.0, 0.0), knot(0.8, 0.1)], "events": [] },
    });
    std::fs::write(&moved, text.to_string()).unwrap();
    let run = cubectl(&["run", &moved, "--home", "--start-in-s", "1.5", "--json"]);
    assert_eq!(code(&run), 0, "{}", err(&run));
    let report: serde_json::Value = serde_json::from_str(&out(&run)).unwrap();
    let took_s = report["took_s"].as_f64().unwrap();
    assert!((2.3..3.5).contains(&took_s), "waits 1.5 s and moves for 0.8 s: {report:#}");
    assert!(report["start_known_to_s"].as_f64().unwrap() < 0.002, "{report:#}");
    assert_eq!(code(&cubectl(&["run", &moved, "--home", "--start-in-s", "31"])), 2);
    let checked = cubectl(&["plan", "check", &moved]);
    assert!(err(&checked).contains("kind \"move\""), "{}", err(&checked));
}

/// Longest frame of a drive, 111 bits and all stuff bits, s at 1 Mbit/s.
const FRAME_S: f64 = 133e-6;

/// The frames on the bus are the witness: a command waits for the frame that occupies the bus at its slot and for answers of
/// the other drives in flight, four in all. At 17 ms drives do not meet; a frame of the host link may, and one answer.
#[test]
fn commands_to_a_drive_keep_their_slots_and_the_certificate_covers_them() {
    for (period, period_s, frames) in [("3", 0.003, 4.0), ("17", 0.017, 2.0)] {
        let folder = Folder::new("throw-slots");
        let thrown = folder.file("a");
        let target = ["throw", "--target", "1.0,1.0,-1.0", "--period-ms", period, "--out", &thrown];
        let output = cubectl(&target);
        assert_eq!(code(&output), 0, "{}", err(&output));
        assert!(out(&output).contains("timing inside the certificate"), "{}", out(&output));
        let report = summary(&folder, "a");
        assert_eq!(report["timing"]["verdict"], "inside the certificate", "{:#}", report["timing"]);
        let coverage = &report["analysis"]["coverage"];
        let number = |value: &serde_json::Value| value.as_f64().unwrap();
        println!(
            "{period} ms: {} intervals, beyond 2, 5, 10 %: {}, landing error {} m",
            coverage["intervals"], coverage["beyond_2_5_10_percent"], report["landing_error_m"]
        );
        let mut largest_s = 0.0f64;
        for joint in coverage["joints"].as_array().unwrap() {
            println!(
                "  commands {} measurements {}",
                joint["command_interval_s"], joint["measurement_interval_s"]
            );
            let range = &joint["command_interval_s"];
            let off_s = (number(&range["max_s"]) - period_s).max(period_s - number(&range["min_s"]));
            assert!(off_s <= frames * FRAME_S, "{off_s}: {joint:#}");
            largest_s = largest_s.max(off_s);
        }
        assert!(largest_s > 5e-6, "no frame ever met another: {largest_s}");
        let beyond_ten_percent = number(&coverage["beyond_2_5_10_percent"][2]);
        let share = beyond_ten_percent / number(&coverage["intervals"]);
        assert!(share <= 0.01, "{share} of the commands more than 10 % off");
    }
}

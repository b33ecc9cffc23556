//! `cubectl move`, `pose` and `run` of waypoints in the simulated cell, which judges where the arm stands.

use crate::bus_common::{Folder, code, cubectl, err, out};
use serde_json::Value;

fn dry(words: &[&str]) -> (i32, Value, String) {
    let output = cubectl(&[&["move", "--home", "--dry-run", "--json"], words].concat());
    (code(&output), serde_json::from_str(&out(&output)).unwrap_or_default(), err(&output))
}

fn angles(found: &Value) -> Vec<f64> {
    found["to_rad"].as_array().unwrap().iter().map(|q| q.as_f64().unwrap()).collect()
}

#[test]
fn arm_moves_to_angles_by_a_difference_and_to_a_named_pose_and_stands_there() {
    let folder = Folder::new("move");
    let poses = folder.file("poses.toml");
    let joints = "0,-60deg,-80deg,0,30deg,0";
    let moved = cubectl(&["move", "--joints", joints, "--home"]);
    assert_eq!(code(&moved), 0, "{}", err(&moved));
    assert!(out(&moved).starts_with("reached: ") && out(&moved).contains("-60.00 -80.00"), "{}", out(&moved));

    let saved = cubectl(&["arm", "pose", "save", "ready", "--joints", joints, "--poses", &poses]);
    assert_eq!(code(&saved), 0, "{}", err(&saved));
    assert!(out(&cubectl(&["arm", "pose", "list", "--poses", &poses])).contains("ready"));
    let (status, found, reported) = dry(&["--pose", "ready", "--poses", &poses]);
    assert_eq!(status, 0, "{reported}");
    assert!((angles(&found)[1] + 60_f64.to_radians()).abs() < 1e-9, "{found}");
    assert_eq!(code(&cubectl(&["arm", "pose", "remove", "ready", "--poses", &poses])), 0);
    let gone = cubectl(&["move", "--pose", "ready", "--poses", &poses, "--home"]);
    assert_eq!(code(&gone), 4);
    assert!(err(&gone).contains("no pose \"ready\" of powercube6; known: none"), "{}", err(&gone));

    let (status, found, reported) = dry(&["--by", "1=+20deg,5=-0.1"]);
    assert_eq!(status, 0, "{reported}");
    let from: Vec<f64> = found["from_rad"].as_array().unwrap().iter().map(|q| q.as_f64().unwrap()).collect();
    let by: Vec<f64> = angles(&found).iter().zip(&from).map(|(to, from)| to - from).collect();
    let wanted = [20_f64.to_radians(), 0.0, 0.0, 0.0, -0.1, 0.0];
    assert!(by.iter().zip(wanted).all(|(by, wanted)| (by - wanted).abs() < 1e-9), "{by:?}");
}

#[test]
fn places_that_cannot_be_reached_are_refused_with_a_next_step_and_nothing_moves() {
    for (words, status, part) in [
        (&["--to", "9,0,0"][..], 3, "does not reach that place"),
        (&["--to", "900,0,0"], 2, "millimetres"),
        (&["--joints", "0,0,0"], 4, "3 angles for an arm of 6 joints"),
        (&["--joints", "0,0,0,0,0,99"], 3, "joint 6 at"),
        (&["--by", "7=0.1"], 4, "joint 7 of an arm of 6 joints"),
        (&["--to", "0.5,0.2,0.6", "--straight"], 3, "the straight line breaks after"),
        (
            &["--joints", "0,-1,-1,0,0,0", "--obstacle", "0,0,1,9,9,0.5"],
            3,
            "its present pose the arm touches something",
        ),
        (&["--to", "0.5,0.2,0.6", "--calibration", "none.toml"], 4, "none.toml"),
        (&["--joints", "0,-1,-1,0,0,0", "--poses", "x.toml"], 4, "--poses is for --pose"),
    ] {
        let (found, _, reported) = dry(words);
        assert_eq!(found, status, "{words:?}: {reported}");
        assert!(reported.contains(part), "{words:?}: {reported}");
        assert!(status == 2 || reported.contains("next: "), "{words:?}: {reported}");
    }
}

#[test]
fn waypoints_are_followed_through_the_run_of_a_move_that_was_written() {
    let folder = Folder::new("waypoints");
    let (moved, plan, table) =
        (folder.file("moved"), folder.file("moved/plan.json"), folder.file("path.csv"));
    let written =
        cubectl(&["move", "--joints", "0,-1.2,-1.4,0,0.4,0", "--home", "--dry-run", "--out", &moved]);
    assert_eq!(code(&written), 0, "{}", err(&written));
    let run = cubectl(&["run", &plan, "--home"]);
    assert_eq!(code(&run), 0, "{}", err(&run));
    assert!(out(&run).starts_with("reached: "), "{}", out(&run));

    let head = "joint1,joint2,joint3,joint4,joint5,joint6\n";
    std::fs::write(&table, format!("{head}0,-1,-1.4,0,0.5,0\n0.4,-1,-1.4,0,0.5,0\n0.4,-1.3,-1.2,0,0.5,0\n"))
        .unwrap();
    let run = cubectl(&["run", &table, "--home"]);
    assert_eq!(code(&run), 0, "{}", err(&run));
    assert!(out(&run).starts_with("reached: "), "{}", out(&run));

    std::fs::write(&table, format!("t_s,{head}0,0,-1,-1.4,0,0.5,0\n0.1,1.5,-1,-1.4,0,0.5,0\n")).unwrap();
    let fast = cubectl(&["run", &table, "--home"]);
    assert_eq!(code(&fast), 4, "{}", out(&fast));
    assert!(err(&fast).contains("joint 1: speed") && err(&fast).contains("--retime"), "{}", err(&fast));
    assert_eq!(code(&cubectl(&["run", &table, "--home", "--retime"])), 0);
}

#[test]
fn hand_draws_a_square_and_the_folder_holds_what_was_measured() {
    let folder = Folder::new("square");
    let (table, results) = (folder.file("square.csv"), folder.file("square"));
    let corners = "0.5,0.15,0.45\n0.5,-0.15,0.45\n0.5,-0.15,0.75\n0.5,0.15,0.75\n0.5,0.15,0.45\n";
    std::fs::write(&table, format!("x_m,y_m,z_m\n{corners}")).unwrap();
    let run = cubectl(&["run", &table, "--home", "--out", &results]);
    assert_eq!(code(&run), 0, "{}", err(&run));
    assert!(out(&run).contains(&format!("results in {results}")), "{}", out(&run));
    let read = |name: &str| std::fs::read_to_string(format!("{results}/{name}")).unwrap();
    let summary: Value = serde_json::from_str(&read("summary.json")).unwrap();
    assert_eq!((&summary["outcome"], &summary["seed"]), (&"reached".into(), &Value::Null));
    let errors = summary["tracking"]["error_max_rad"].as_array().unwrap();
    assert!(errors.iter().all(|e| (1e-5..5e-3).contains(&e.as_f64().unwrap())), "{errors:?}");
    assert!(read("report.html").contains("Path of the hand"));
    // The same report can be made again from the files, and the results are not overwritten.
    let again = cubectl(&["log", "report", &results, "--out", &folder.file("again.html")]);
    assert_eq!(code(&again), 0, "{}", err(&again));
    let twice = cubectl(&["run", &table, "--home", "--out", &results]);
    assert_eq!(code(&twice), 10, "{}", out(&twice));
    let moved = folder.file("moved");
    let by = cubectl(&["move", "--by", "1=10deg", "--home", "--out", &moved]);
    assert_eq!(code(&by), 0, "{}", err(&by));
    assert!(std::path::Path::new(&moved).join("report.html").is_file());
}

#[test]
fn places_that_the_hand_cannot_reach_are_refused_by_number_before_anything_moves() {
    let folder = Folder::new("places");
    let table = folder.file("far.csv");
    std::fs::write(&table, "x_m,y_m,z_m\n0.5,0,0.5\n5,0,0.5\n").unwrap();
    let far = cubectl(&["run", &table, "--home"]);
    assert_eq!(code(&far), 3, "{}", out(&far));
    assert!(err(&far).contains("place 2") && err(&far).contains("nothing has moved"), "{}", err(&far));
    let blended = cubectl(&["run", &table, "--home", "--blend-rad", "0.1"]);
    assert_eq!(code(&blended), 4, "{}", err(&blended));
}

#[test]
fn run_is_judged_per_joint_by_the_tolerances_that_are_given() {
    let folder = Folder::new("tolerances");
    let path = folder.file("path.csv");
    let names: Vec<String> = (1..=6).map(|k| format!("joint{k}_deg")).collect();
    std::fs::write(&path, format!("{}\n0,-60,-80,0,30,0\n30,-70,-70,0,20,0\n", names.join(","))).unwrap();
    let run = |words: &[&str], out: &str| {
        let output = cubectl(&[&["run", &path, "--home", "--out", out], words].concat());
        let text = std::fs::read_to_string(format!("{out}/summary.json")).unwrap_or_default();
        (code(&output), serde_json::from_str::<Value>(&text).unwrap_or_default(), err(&output))
    };
    let (status, summary, reported) = run(&[], &folder.file("usual"));
    assert_eq!(status, 0, "{reported}");
    let joints = summary["reached"]["joints"].as_array().unwrap();
    assert_eq!((joints.len(), &joints[0]["path_tolerance_rad"]), (6, &0.05.into()));
    let number = |joint: &Value, key: &str| joint[key].as_f64().unwrap();
    let off: Vec<f64> = joints.iter().map(|joint| number(joint, "off_rad")).collect();
    assert!(off.iter().all(|off| (1e-6..5e-3).contains(off)), "{off:?}");

    // The first joint may be half as far from the motion as it was.
    let half = format!("{},1,1,1,1,1", 0.5 * off[0]);
    let (status, summary, reported) =
        run(&["--path-tolerance-rad", &half, "--goal-time-s", "1"], &folder.file("path"));
    assert_eq!((status, &summary["outcome"]), (8, &"not_reached".into()), "{reported}");
    assert!(
        reported.contains("not reached: joint1 was ") && reported.contains(" mrad from the motion at "),
        "{reported}"
    );
    assert!(!reported.contains("joint2"), "{reported}");
    assert_eq!(summary["reached"]["goal_time_s"], 1.0);
    let report = std::fs::read_to_string(folder.file("path/report.html")).unwrap();
    assert!(report.contains("Tolerances"));

    let (status, summary, reported) = run(&["--goal-tolerance-rad", "1e-9"], &folder.file("goal"));
    assert_eq!((status, &summary["outcome"]), (8, &"not_reached".into()), "{reported}");
    assert!(
        reported.contains(" stood ") && reported.contains(" mrad from the end (tolerance 0.00)"),
        "{reported}"
    );

    let (status, _, reported) = run(&["--goal-tolerance-rad", "0.1,0.2"], &folder.file("wrong"));
    assert_eq!(status, 4);
    assert!(reported.contains("2 numbers for an arm of 6 joints"), "{reported}");
}

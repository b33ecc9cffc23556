//! `cubectl run` of a program in the simulated cell.

use crate::bus_common::{Folder, code, cubectl, err, out};
use serde_json::Value;

const PICK_AND_PLACE: &str = r#"
schema_version = 1
robot = "powercube6"
speed_share = 0.5

[[step]]
joints = "38.5deg,-89.7deg,-186.1deg,64.2deg,-96.5deg,124.6deg"

[[step]]
to = "0.5,0.15,0.45"
straight = true

[[step]]
gripper = "close"

[[step]]
wait_s = 0.2

[[step]]
to = "0.5,0.15,0.6"
straight = true

[[step]]
to = "0.5,-0.15,0.6"
straight = true
speed_share = 0.3

[[step]]
gripper = "open"
"#;

fn written(folder: &Folder, text: &str) -> String {
    let path = folder.file("program.toml");
    std::fs::write(&path, text).unwrap();
    path
}

fn summary(output: &std::process::Output) -> Value {
    serde_json::from_str(&out(output)).unwrap_or_else(|_| panic!("{}\n{}", out(output), err(output)))
}

#[test]
fn program_is_done_as_often_as_asked_and_each_cycle_ends_where_the_first_did() {
    let folder = Folder::new("program");
    let (path, results) = (written(&folder, PICK_AND_PLACE), folder.file("out"));
    let output = cubectl(&["run", &path, "--home", "--repeat", "3", "--json", "--out", &results]);
    let found = summary(&output);
    assert_eq!((code(&output), &found["outcome"], &found["cycles_done"]), (0, &"done".into(), &3.into()));
    assert_eq!(found["steps_done"], 21);
    let (off, drift) = (found["off_rad"].as_f64().unwrap(), found["drift_rad"].as_f64().unwrap());
    assert!(off > 1e-5 && off < 3e-3 && drift < 2e-3, "{found}");

    let table = std::fs::read_to_string(format!("{results}/cycles.csv")).unwrap();
    let rows: Vec<Vec<&str>> = table.lines().skip(1).map(|line| line.split(',').collect()).collect();
    assert_eq!(rows.len(), 21);
    let begun = |row: &Vec<&str>| row[3].parse::<f64>().unwrap();
    assert!(
        rows.windows(2)
            .all(|two| begun(&two[1]) >= begun(&two[0]) + two[0][4].parse::<f64>().unwrap() - 1e-3)
    );
    // Steps 3 and 7 work the gripper, step 4 waits.
    assert_eq!((rows[2][2], rows[3][2], rows[6][2]), ("gripper close", "wait", "gripper open"));
    assert!((rows[3][4].parse::<f64>().unwrap() - 0.2).abs() < 0.03, "{:?}", rows[3]);
    let kept: Value =
        serde_json::from_str(&std::fs::read_to_string(format!("{results}/summary.json")).unwrap()).unwrap();
    assert_eq!(kept, found);
}

/// Of what the recorded bus says: the table and the report hold what another reading of the recording finds.
#[test]
fn each_step_of_a_program_has_error_and_current_of_every_joint_as_the_bus_recorded_them() {
    let folder = Folder::new("program-record");
    let (path, results) = (written(&folder, PICK_AND_PLACE), folder.file("out"));
    let output = cubectl(&["run", &path, "--home", "--repeat", "2", "--json", "--out", &results]);
    assert_eq!(code(&output), 0, "{}", err(&output));
    let table = std::fs::read_to_string(format!("{results}/cycles.csv")).unwrap();
    let mut lines = table.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let names = lines.next().unwrap();
    let rows: Vec<_> = lines.collect();
    let column = |name: &str| names.iter().position(|found| *found == name).unwrap();
    let value = |row: &[&str], name: &str| row[column(name)].parse::<f64>().ok();
    // Currents on the wire: answers to requests for parameter 0x4D, float, little endian.
    let log = std::fs::read_to_string(format!("{results}/bus.log")).unwrap();
    let frames: Vec<(f64, &str, &str)> = log
        .lines()
        .filter_map(|line| {
            let mut words = line.split_whitespace();
            let at = words.next()?.trim_matches(['(', ')']).parse().ok()?;
            let (id, data) = words.nth(1)?.split_once('#')?;
            Some((at, id, data))
        })
        .collect();
    let mut compared = 0;
    for row in &rows {
        for joint in 1..=6 {
            let read = |what: &str| value(row, &format!("{what}_{joint}"));
            assert_eq!(read("temperature_peak_c"), None, "the modules are not asked for it");
            if row[2] != "move" {
                assert_eq!((read("off_rad"), read("current_peak_a")), (None, None), "{row:?}");
                continue;
            }
            let off_rad = read("off_rad").unwrap();
            assert!(off_rad > 1e-5 && off_rad <= value(row, "off_rad").unwrap() + 1e-9, "{row:?}");
            let reply = format!("{:03X}", 0x0A0 + joint);
            let currents = frames.iter().filter(|(_, id, data)| *id == reply && data.starts_with("0A4D"));
            let peak = read("current_peak_a").unwrap();
            let of_frame = |data: &str| {
                let bytes: Vec<u8> =
                    (4..12).step_by(2).map(|k| u8::from_str_radix(&data[k..k + 2], 16).unwrap()).collect();
                f64::from(f32::from_le_bytes(bytes.try_into().unwrap())).abs()
            };
            assert!(
                currents.clone().any(|(.., data)| (of_frame(data) - peak).abs() < 6e-4),
                "{joint}: {peak}"
            );
            compared += 1;
        }
        if row[2] == "move" {
            let largest = (1..=6).filter_map(|j| value(row, &format!("off_rad_{j}"))).fold(0.0_f64, f64::max);
            assert!((largest - value(row, "off_rad").unwrap()).abs() < 1e-9, "{row:?}");
        }
    }
    assert_eq!(compared, 2 * 4 * 6);
    let report = std::fs::read_to_string(format!("{results}/report.html")).unwrap();
    let beside = report.split("Path of the hand, at most ").nth(1).unwrap();
    let beside_mm: f64 = beside.split(' ').next().unwrap().parse().unwrap();
    assert!(
        (0.01..2.0).contains(&beside_mm),
        "{beside_mm} mm, in both cycles and from their first instant on"
    );
    for text in [
        "done: 2 of 2 cycles",
        "cycle 1",
        "cycle 2",
        "joint6: position error",
        "Change since the first cycle",
    ] {
        assert!(report.contains(text), "{text}");
    }
}

#[test]
fn program_that_cannot_be_done_is_refused_with_the_step_before_anything_moves() {
    let folder = Folder::new("program-refused");
    for (change, status, why) in [
        (("0.5,-0.15,0.6", "2.5,-0.15,0.6"), 3, "step 6: "),
        (("wait_s = 0.2", "wait_s = -1"), 4, "step 4: wait_s is from 0 to 3600"),
        (("wait_s = 0.2", "wait_s = 0.2\ngripper = \"open\""), 4, "step 4: it has one of"),
        (("wait_s = 0.2", "pause_s = 0.2"), 4, "unknown field `pause_s`"),
        (("wait_s = 0.2", "pose = \"ready\""), 4, "step 4: name the file of poses"),
        (("wait_s = 0.2", "path = \"none.csv\""), 4, "none.csv"),
        (("gripper = \"close\"", "gripper = \"close\"\nstraight = true"), 4, "step 3: straight is for to"),
        (("schema_version = 1", "schema_version = 2"), 4, "schema_version is 2"),
        (("robot = \"powercube6\"", "robot = \"kr16_2\""), 4, "38.5"),
        ((",64.2deg", ""), 4, "step 1: 5 angles"),
    ] {
        let text = PICK_AND_PLACE.replacen(change.0, change.1, 1);
        assert_ne!(text, PICK_AND_PLACE);
        let robot = if why == "38.5" { &["--robot", "powercube6"][..] } else { &[] };
        let why = if why == "38.5" { "it is for kr16_2, not for powercube6" } else { why };
        let output = cubectl(&[&["run", &written(&folder, &text), "--home"], robot].concat());
        assert_eq!(code(&output), status, "{why}: {}", err(&output));
        assert!(err(&output).contains(why) && err(&output).contains("next: "), "{why}: {}", err(&output));
    }
    let once = cubectl(&["run", &written(&folder, PICK_AND_PLACE), "--start-in-s", "1"]);
    assert!(code(&once) == 4 && err(&once).contains("--start-in-s is for one motion"), "{}", err(&once));
}

#[test]
fn program_that_ends_early_says_at_which_step_and_keeps_what_was_done() {
    let folder = Folder::new("program-fault");
    let scenario = folder.file("silent.toml");
    let fault = "schema_version = 1\nname = \"silent\"\nseed = 3\nduration_s = 1.0\n\n[[fault]]\nkind = \"silent\"\n\
                 target = \"module 3\"\nstart_s = 14.0\nlength_s = 5.0\n";
    std::fs::write(&scenario, fault).unwrap();
    let (path, results) = (written(&folder, PICK_AND_PLACE), folder.file("out"));
    let words =
        ["run", &path, "--home", "--repeat", "3", "--json", "--out", &results, "--scenario", &scenario];
    let output = cubectl(&words);
    let found = summary(&output);
    assert!(matches!(code(&output), 8 | 13), "{}", err(&output));
    assert_eq!(
        (&found["outcome"], found["code"].as_i64()),
        (&"ended_early".into(), Some(code(&output).into()))
    );
    let (cycle, step) = (found["at"]["cycle"].as_u64().unwrap(), found["at"]["step"].as_u64().unwrap());
    assert!(err(&output).contains(&format!("cycle {cycle}, step {step}: ")), "{}", err(&output));
    let table = std::fs::read_to_string(format!("{results}/cycles.csv")).unwrap();
    let done = (cycle - 1) * 7 + step - 1;
    assert_eq!(table.lines().count() as u64, 1 + done, "{table}");
    assert!(done > 0, "the fault comes after some steps");
    let report = std::fs::read_to_string(format!("{results}/report.html")).unwrap();
    assert!(
        report.contains("ended early: 0 of 3 cycles") && report.contains("In space"),
        "the steps that were done"
    );
}

#[test]
fn program_whose_cycles_begin_elsewhere_each_time_goes_on_by_its_own_ways() {
    let folder = Folder::new("program-by");
    let by = "schema_version = 1\nspeed_share = 0.5\n\n[[step]]\nby = \"1=+5deg\"\n\n[[step]]\ngripper = \"close\"\n";
    let results = folder.file("out");
    let output =
        cubectl(&["run", &written(&folder, by), "--home", "--repeat", "4", "--json", "--out", &results]);
    let found = summary(&output);
    assert_eq!((code(&output), &found["cycles_done"]), (0, &4.into()), "{}", err(&output));
    assert!(found["drift_rad"].as_f64().unwrap() < 2e-3, "{found}");
    let table = std::fs::read_to_string(format!("{results}/cycles.csv")).unwrap();
    let ends: Vec<f64> = table
        .lines()
        .filter(|line| line.contains(",1,move,"))
        .map(|line| line.split(',').nth(8).unwrap().parse().unwrap())
        .collect();
    assert_eq!(ends.len(), 4);
    let five = 5_f64.to_radians();
    assert!(ends.windows(2).all(|two| (two[1] - two[0] - five).abs() < 2e-3), "{ends:?}");
    // Until there is no way, which is said before the first motion.
    let far = cubectl(&["run", &written(&folder, by), "--home", "--repeat", "100"]);
    assert_eq!(code(&far), 3);
    let reported = err(&far);
    assert!(
        reported.contains("cycle 3") && reported.contains("step 1: ") && reported.contains("the arm stands"),
        "{reported}"
    );
    assert!(out(&far).starts_with("0 of 100 cycles, 0 steps"), "{}", out(&far));
}

#[test]
fn steps_keep_their_numbers_where_a_path_needs_a_way_to_its_begin() {
    let folder = Folder::new("program-path");
    let path = "joint1_deg,joint2_deg,joint3_deg,joint4_deg,joint5_deg,joint6_deg\n0,-60,-80,0,30,0\n10,-60,-80,0,30,0\n\
                0,-60,-80,0,30,0\n";
    std::fs::write(folder.file("path.csv"), path).unwrap();
    let text = "schema_version = 1\nspeed_share = 0.5\nobstacles = [[0.5, 0.0, 0.1, 0.05, 0.05, 0.05]]\n\n[[step]]\npath = \"path.csv\"\n\n\
                [[step]]\ngripper = \"close\"\n";
    let results = folder.file("out");
    let output =
        cubectl(&["run", &written(&folder, text), "--home", "--repeat", "2", "--json", "--out", &results]);
    let found = summary(&output);
    assert_eq!((code(&output), &found["cycles_done"]), (0, &2.into()), "{}", err(&output));
    assert!(found["drift_rad"].as_f64().unwrap() < 2e-3, "{found}");
    let table = std::fs::read_to_string(format!("{results}/cycles.csv")).unwrap();
    let steps: Vec<String> =
        table.lines().skip(1).map(|line| line.split(',').take(3).collect::<Vec<_>>().join(" ")).collect();
    let expected = ["1 1 move", "1 1 move", "1 2 gripper close", "2 1 move", "2 2 gripper close"];
    assert_eq!(steps, expected);
}

#[test]
fn path_on_which_two_bodies_touch_between_its_points_is_refused_with_the_time_and_both() {
    let folder = Folder::new("program-contact");
    let path = "joint1_deg,joint2_deg,joint3_deg,joint4_deg,joint5_deg,joint6_deg\n0,-60,-80,0,30,0\n50,-60,-80,0,30,0\n";
    std::fs::write(folder.file("path.csv"), path).unwrap();
    // The hand passes (0.44, 0.20, 1.13) m at 25 degrees.
    let text = "schema_version = 1\nobstacles = [[0.44, 0.2, 1.13, 0.02, 0.02, 0.02]]\n\n[[step]]\npath = \"path.csv\"\n";
    let refused = cubectl(&["run", &written(&folder, text), "--home"]);
    assert_eq!(code(&refused), 3, "{}", err(&refused));
    let why = err(&refused);
    assert!(why.contains("step 1: after ") && why.contains("obstacle 1") && why.contains("touch"), "{why}");
    let free = text.replace("0.44, 0.2, 1.13", "0.44, 0.2, 0.2");
    let done = cubectl(&["run", &written(&folder, &free), "--home"]);
    assert_eq!(code(&done), 0, "{}", err(&done));
}

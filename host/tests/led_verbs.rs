//! Verbs of every day with an industrial robot: inside the program, and over a socket in step with its time. Where the arm was is read from
//! the table of the robot's true axes.

use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};

use crate::bus_common::{Folder, code, cubectl, err, out};
use crate::robot_link::{free_port, robot};
use serde_json::Value;

const PLACE: &str = "20deg,-80deg,100deg,0,60deg,0";
const PROGRAM: &str = "schema_version = 1\nrobot = \"kr16_2\"\nspeed_share = 0.4\n\n[[step]]\njoints = \
                       \"20deg,-80deg,100deg,0,60deg,0\"\n\n[[step]]\ngripper = \"close\"\n\n[[step]]\nwait_s = 0.2\n\n[[step]]\njoints = \
                       \"0,-90deg,90deg,0,90deg,0\"\n";

fn words<'a>(verb: &'a [&'a str], more: &'a [&'a str]) -> Vec<&'a str> {
    [verb, &["--robot", "kr16_2"], more].concat()
}

/// Last row of the table of axes in the folder, deg.
fn stands_deg(folder: &str) -> Vec<f64> {
    let table = std::fs::read_to_string(format!("{folder}/motion.csv")).unwrap();
    let last = table.lines().last().unwrap().split(',');
    last.skip(8).take(6).map(|number| number.parse().unwrap()).collect()
}

fn near(a: &[f64], b: &[f64]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 0.02)
}

#[test]
fn robot_inside_the_program_moves_and_its_folder_is_reported_and_replayed_again() {
    let folder = Folder::new("led-move");
    let to = folder.file("move");
    let moved = cubectl(&words(&["move", "--joints", PLACE, "--out", &to], &[]));
    assert_eq!(code(&moved), 0, "{}", err(&moved));
    assert!(out(&moved).starts_with("reached: "), "{}", out(&moved));
    assert!(near(&stands_deg(&to), &[20.0, -80.0, 100.0, 0.0, 60.0, 0.0]), "{:?}", stands_deg(&to));
    let report = std::fs::read(format!("{to}/report.html")).unwrap();
    assert_eq!(code(&cubectl(&["log", "report", &to])), 0);
    assert_eq!(std::fs::read(format!("{to}/report.html")).unwrap(), report);
    let replayed = cubectl(&["log", "replay", &to]);
    assert!(out(&replayed).starts_with("identical: "), "{} {}", out(&replayed), err(&replayed));
    let summary: Value =
        serde_json::from_str(&std::fs::read_to_string(format!("{to}/summary.json")).unwrap()).unwrap();
    assert_eq!((&summary["outcome"], &summary["link"]), (&"reached".into(), &"RSI".into()));
    assert_eq!(summary["late_answers"], 0);
    // What was moved can be run again, and only by this robot.
    let plan = format!("{to}/plan.json");
    let again = cubectl(&words(&["run", &plan], &[]));
    assert_eq!(code(&again), 0, "{}", err(&again));
    assert_ne!(code(&cubectl(&["run", &plan, "--robot", "powercube6", "--home"])), 0);
}

#[test]
fn robot_inside_the_program_follows_waypoints_a_program_and_a_stream() {
    let folder = Folder::new("led-paths");
    let (path, program, stream) = (folder.file("p.csv"), folder.file("p.toml"), folder.file("s.jsonl"));
    std::fs::write(&path, "A1,A2,A3,A4,A5,A6\n0,-1.5708,1.5708,0,1.5708,0\n0.3,-1.4,1.5,0.1,1.2,0\n")
        .unwrap();
    let to = folder.file("path");
    let ran = cubectl(&words(&["run", &path, "--out", &to], &[]));
    assert_eq!(code(&ran), 0, "{}", err(&ran));
    let end: Vec<f64> = [0.3, -1.4, 1.5, 0.1, 1.2, 0.0_f64].iter().map(|q| q.to_degrees()).collect();
    assert!(near(&stands_deg(&to), &end), "{:?}", stands_deg(&to));

    std::fs::write(&program, PROGRAM).unwrap();
    let to = folder.file("program");
    let ran = cubectl(&["run", &program, "--repeat", "2", "--out", &to]);
    assert_eq!(code(&ran), 0, "{}", err(&ran));
    assert!(out(&ran).contains("2 of 2 cycles, 8 steps"), "{}", out(&ran));
    assert!(near(&stands_deg(&to), &[0.0, -90.0, 90.0, 0.0, 90.0, 0.0]), "{:?}", stands_deg(&to));
    let report = std::fs::read(format!("{to}/report.html")).unwrap();
    assert_eq!(code(&cubectl(&["log", "report", &to])), 0);
    assert_eq!(std::fs::read(format!("{to}/report.html")).unwrap(), report);

    let line = |k: u32| format!("{{\"t_s\": {}, \"qd_rad_s\": [0.2, 0, 0, 0, 0, 0]}}\n", 0.02 * f64::from(k));
    std::fs::write(&stream, (0..50).map(line).collect::<String>()).unwrap();
    let led = cubectl(&words(&["servo", &stream, "--json"], &[]));
    assert_eq!(code(&led), 0, "{}", err(&led));
    let found: Value = serde_json::from_str(&out(&led)).unwrap();
    let a1 = found["measured_rad"][0].as_f64().unwrap();
    assert!((0.15..0.3).contains(&a1), "{found}");
    assert!(found["end_off_rad"].as_f64().unwrap() < 1e-3, "{found}");
}

#[test]
fn verbs_lead_a_robot_behind_a_socket_one_after_the_other_and_an_interrupt_stops_it() {
    let folder = Folder::new("led-socket");
    let spec = format!("udp://127.0.0.1:{}?lockstep", free_port(false));
    let bus = format!("rsi:{spec}");
    let child = robot(&["--rsi", &spec, "--runs", "3"]);
    let program = folder.file("p.toml");
    std::fs::write(&program, PROGRAM).unwrap();
    let [moved_to, ran_to] = ["move", "program"].map(|name| folder.file(name));
    let moved = cubectl(&["move", "--joints", PLACE, "--bus", &bus, "--yes", "--out", &moved_to]);
    assert_eq!(code(&moved), 0, "{}", err(&moved));
    assert!(near(&stands_deg(&moved_to), &[20.0, -80.0, 100.0, 0.0, 60.0, 0.0]));
    let ran = cubectl(&["run", &program, "--bus", &bus, "--yes", "--out", &ran_to]);
    assert_eq!(code(&ran), 0, "{}", err(&ran));
    // Commands that never end: only the signal ends them.
    let mut led = Command::new(env!("CARGO_BIN_EXE_cubectl"))
        .args(["servo", "--bus", &bus, "--yes", "--hold-s", "60"])
        .stdin(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut reported = BufReader::new(led.stderr.take().unwrap()).lines();
    assert!(reported.any(|line| line.unwrap().contains("drives answer")));
    let signal = Command::new("kill").args(["-INT", &led.id().to_string()]).status().unwrap();
    assert!(signal.success());
    assert_eq!(led.wait().unwrap().code(), Some(6));
    // Each run of the robot's program came to its end: no axis was stopped by the robot itself.
    let played = child.wait_with_output().unwrap();
    let reported = String::from_utf8_lossy(&played.stdout);
    assert_eq!(reported.matches("robot: program ended").count(), 3, "{reported}");
}

#[test]
fn what_means_nothing_for_such_a_robot_is_refused_by_name() {
    for (words, part) in [
        (&["move", "--joints", PLACE, "--robot", "kr16_2", "--bus", "can0", "--yes"][..], "is a CAN bus"),
        (&["move", "--joints", PLACE, "--robot", "kr16_2", "--record", "x"], "--record"),
        (
            &["move", "--joints", PLACE, "--robot", "powercube6", "--bus", "rsi:udp://127.0.0.1:1", "--yes"],
            "no controller of its own",
        ),
        (&["servo", "--bus", "rsi:udp://127.0.0.1:1", "--yes", "--controller", "7"], "--controller"),
        (&["move", "--joints", "0,0,9,0,0,0", "--robot", "kr16_2", "--dry-run"], "joint"),
    ] {
        let refused = cubectl(words);
        assert_ne!(code(&refused), 0, "{words:?}");
        assert!(err(&refused).contains(part), "{words:?}: {}", err(&refused));
    }
}

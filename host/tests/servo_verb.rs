//! `cubectl servo`: commands from a file and from a pipe, in the simulated cell.

use std::io::Write;
use std::process::{Command, Stdio};

use crate::bus_common::{Folder, code, cubectl, err, out};
use serde_json::Value;

fn commands(folder: &Folder, lines: &[String]) -> String {
    let path = folder.file("commands.jsonl");
    std::fs::write(&path, lines.join("\n")).unwrap();
    path
}

/// Fifty commands a second for a time: joint 1 and joint 3 by angles from where the arm stands after homing.
fn turned(from: &[f64], [first_rad, third_rad]: [f64; 2], seconds: f64) -> Vec<String> {
    let mut goal = from.to_vec();
    (goal[0], goal[2]) = (goal[0] + first_rad, goal[2] + third_rad);
    let line = |i: u32| format!("{{\"t_s\": {}, \"q_rad\": {goal:?}}}", f64::from(i) * 0.02);
    (0..(seconds / 0.02) as u32).map(line).collect()
}

fn numbers(found: &Value, key: &str) -> Vec<f64> {
    found[key].as_array().unwrap().iter().map(|q| q.as_f64().unwrap()).collect()
}

fn served(words: &[&str]) -> Value {
    let output = cubectl(&[&["servo", "--home", "--json"], words].concat());
    assert_eq!(code(&output), 0, "{}", err(&output));
    serde_json::from_str(&out(&output)).unwrap()
}

/// Where the arm stands after homing.
fn home_rad(folder: &Folder) -> Vec<f64> {
    numbers(&served(&[&commands(folder, &[])]), "measured_rad")
}

#[test]
fn arm_goes_where_the_file_says_and_each_option_changes_what_it_does() {
    let folder = Folder::new("servo");
    let from = home_rad(&folder);
    let file = commands(&folder, &turned(&from, [0.3, 0.0], 3.0));
    let states = folder.file("states.csv");
    let found = served(&[&file, "--states", &states]);
    let measured = numbers(&found, "measured_rad");
    assert!((measured[0] - from[0] - 0.3).abs() < 3e-3, "{found}");
    assert_eq!(found["commands_taken"], 150);
    assert_eq!(
        (&found["outcome"], &found["restarts"], &found["ticks_limited"]),
        (&"at_rest".into(), &0.into(), &0.into())
    );
    let table = std::fs::read_to_string(&states).unwrap();
    let last: Vec<f64> =
        table.lines().last().unwrap().split(',').take(7).map(|n| n.parse().unwrap()).collect();
    assert!((last[1] - measured[0]).abs() < 3e-3, "{last:?}");
    assert!(table.starts_with("t_s,q_rad_1,") && table.lines().count() > 150);

    // Slower; and silent for longer than it may be, it stops on the way.
    let slow = numbers(&served(&[&file, "--speed-share", "0.02"]), "measured_rad");
    assert!(slow[0] - from[0] < 0.25 && slow[0] - from[0] > 0.02, "{slow:?}");
    let mut gap = turned(&from, [0.3, 0.0], 0.2);
    gap.push(format!("{{\"t_s\": 4.0, \"qd_rad_s\": {:?}}}", vec![0.0; 6]));
    let gap = commands(&folder, &gap);
    let short = numbers(&served(&[&gap, "--hold", "0.05"]), "measured_rad");
    let long = numbers(&served(&[&gap, "--hold", "3"]), "measured_rad");
    assert!(short[0] - from[0] < 0.2 && (long[0] - from[0] - 0.3).abs() < 3e-3, "{short:?} {long:?}");

    // A box beside the hand: the arm stops before it, and the table names it.
    let up = commands(&folder, &turned(&from, [0.0, 0.9], 6.0));
    let free = served(&[&up]);
    let boxed = served(&[&up, "--obstacle", "-0.6,0,1.0,0.1,0.3,0.2", "--states", &states]);
    assert!(boxed["ticks_limited"].as_u64() > free["ticks_limited"].as_u64(), "{boxed}");
    assert!(std::fs::read_to_string(&states).unwrap().contains("obstacle 1"), "{boxed}");
    assert!(numbers(&boxed, "measured_rad")[2] < numbers(&free, "measured_rad")[2] - 0.1);
}

#[test]
fn what_is_no_command_is_refused_with_the_reason_and_the_rest_is_followed() {
    let folder = Folder::new("servo-refused");
    let from = home_rad(&folder);
    let mut lines = turned(&from, [0.1, 0.0], 2.0);
    lines.insert(3, "{\"q_rad\": [NaN]}".to_owned());
    lines.insert(5, "{\"q_rad\": [0,0,0,0,0,0]}".to_owned());
    lines.insert(7, "{\"t_s\": 0.1, \"q_rad\": [0,0,0]}".to_owned());
    lines.insert(9, "{\"t_s\": 0.1, \"point_m\": [9,9,9]}".to_owned());
    let output = cubectl(&["servo", "--home", "--json", &commands(&folder, &lines)]);
    let found: Value = serde_json::from_str(&out(&output)).unwrap();
    assert_eq!(
        (code(&output), &found["commands_refused"], &found["commands_taken"]),
        (0, &4.into(), &100.into())
    );
    for why in ["expected value", "needs t_s", "3 numbers for 6 joints", "does not come there"] {
        assert!(err(&output).contains(why), "{why}: {}", err(&output));
    }
    assert!((numbers(&found, "measured_rad")[0] - from[0] - 0.1).abs() < 3e-3);
    let missing = cubectl(&["servo", "none.jsonl"]);
    assert_eq!(code(&missing), 4);
    assert!(err(&missing).contains("none.jsonl"), "{}", err(&missing));
}

#[test]
fn commands_come_through_a_pipe_and_a_bus_with_metal_asks_for_a_terminal_or_yes() {
    let folder = Folder::new("servo-pipe");
    let from = home_rad(&folder);
    let mut child = Command::new(env!("CARGO_BIN_EXE_cubectl"))
        .args(["servo", "--home"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut pipe = child.stdin.take().unwrap();
    pipe.write_all(turned(&from, [0.2, 0.0], 2.0).join("\n").as_bytes()).unwrap();
    drop(pipe);
    let output = child.wait_with_output().unwrap();
    assert_eq!(code(&output), 0);
    assert!(
        out(&output).contains("100 commands in ") && out(&output).contains("the arm stands"),
        "{}",
        out(&output)
    );
    let asked = cubectl(&["servo", "none.jsonl", "--bus", "socketcand://127.0.0.1:1/can0"]);
    assert_eq!(code(&asked), 2);
    assert!(err(&asked).contains("--yes"), "{}", err(&asked));
}

//! An industrial robot over sockets in step with its time: two programs, one plays the robot and the tracker, the other measures
//! the target, throws, looks and records. The witness is the simulated robot's ball, which only the first program sees.

use std::io::{BufRead, BufReader, Read};
use std::net::{TcpListener, UdpSocket};
use std::path::Path;
use std::process::{Child, ChildStderr, Command, Stdio};
use std::sync::atomic::{AtomicU16, Ordering};

use serde_json::Value;

use crate::program::{cubectl, cubectl_line, folder, text};

/// A port that is free. No two tests get the same one.
///
/// It lies below those that Linux gives to sockets which name none. One of those could be given to another socket of these tests
/// before a program takes it.
pub(crate) fn free_port(tcp: bool) -> u16 {
    static NEXT: AtomicU16 = AtomicU16::new(0);
    let first = (std::process::id() % 8_000) as u16;
    std::iter::repeat_with(|| 20_000 + (first + NEXT.fetch_add(1, Ordering::Relaxed)) % 10_000)
        .take(1_000)
        .find(|port| {
            let at = ("127.0.0.1", *port);
            if tcp { TcpListener::bind(at).is_ok() } else { UdpSocket::bind(at).is_ok() }
        })
        .expect("a free port")
}

pub(crate) fn robot(words: &[&str]) -> Child {
    Command::new(env!("CARGO_BIN_EXE_cubectl"))
        .args(["sim", "--robot", "kr16_2"])
        .args(words)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("runs")
}

fn json(path: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(path).expect("written")).expect("JSON")
}

/// The millimetres of "…, 1.2 mm from it: bottle hit".
fn off_mm(reported: &str) -> f64 {
    let before = reported.split(" mm from it").next().expect("a landing");
    before.rsplit(' ').next().and_then(|number| number.parse().ok()).unwrap_or_else(|| panic!("{reported}"))
}

#[test]
fn every_generation_and_transport_throws_at_a_tracked_target_and_the_bottle_is_hit() {
    // The plan is for where the tracker will see the bottle, so that it is made once.
    let work = folder("robot-link");
    std::fs::create_dir_all(&work).expect("writable");
    let planned = |period_ms: &str, starts: &str| {
        let plan = work.join(format!("plan-{period_ms}.json")).to_string_lossy().into_owned();
        let line = "plan throw --robot kr16_2 --target 2.5,0,0.6 --lag-ms 24";
        let out = cubectl_line(line, &["--out", &plan, "--starts", starts, "--period-ms", period_ms]);
        assert_eq!(out.status.code(), Some(0), "{}", text(&out.stderr));
        plan
    };
    let (slow, fast) = (planned("12", "8"), planned("4", "2"));
    let robots = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/kr16_2");
    for (name, tcp) in [("kr_c2", false), ("kr_c2_tcp", true), ("kr_c4", false), ("kr_c4_12ms", false)] {
        let spec = format!("{}://127.0.0.1:{}?lockstep", if tcp { "tcp" } else { "udp" }, free_port(tcp));
        let file = robots.join(format!("{name}.toml")).to_string_lossy().into_owned();
        let child = robot(&["--rsi", &spec, "--scenario", &file, "--seed", "7", "--runs", "1"]);
        let plan = if name == "kr_c4" { &fast } else { &slow };
        let results = work.join(name).to_string_lossy().into_owned();
        let bus = format!("rsi:{spec}");
        let out = cubectl(&[
            "throw", "--robot", "kr16_2", "--plan", plan, "--bus", &bus, "--rsi", &file, "--out", &results,
            "--yes",
        ]);
        assert_eq!(out.status.code(), Some(0), "{name}: {}", text(&out.stderr));
        assert!(text(&out.stdout).contains("thrown, not observed"), "{name}: {}", text(&out.stdout));
        let sim = child.wait_with_output().expect("ends");
        let reported = text(&sim.stdout);
        println!("{name}: {reported}");
        assert!(
            reported.contains("bottle hit") && reported.contains("program ended"),
            "{name}: {reported} {}",
            text(&sim.stderr)
        );
        assert!(reported.contains("0 late answers, 0 refused"), "{name}: {reported}");
        // What the client concludes from the measured axes is what the ball did.
        let summary = json(&Path::new(&results).join("summary.json"));
        let predicted = summary["outcome_text"].as_str().expect("text").to_owned();
        assert!(off_mm(&reported) < 10.0, "{name}: {reported}; {predicted}");
        // The recorded exchange gives the same answers again, and makes a report.
        let out = cubectl(&["log", "replay", &results]);
        assert!(
            text(&out.stdout).starts_with("identical: "),
            "{name}: {} {}",
            text(&out.stdout),
            text(&out.stderr)
        );
        let out = cubectl(&["log", "report", &results]);
        assert_eq!(out.status.code(), Some(0), "{name}: {}", text(&out.stderr));
        let html = std::fs::read_to_string(Path::new(&results).join("report.html")).expect("written");
        assert!(html.contains("Commanded against actual") && html.contains("\"scene\":"), "{name}");
    }
}

#[test]
fn tracked_target_is_measured_calibrated_and_thrown_at_and_a_missing_body_is_refused() {
    let work = folder("robot-tracker");
    std::fs::create_dir_all(&work).expect("writable");
    let room = work.join("room.toml").to_string_lossy().into_owned();
    // The room is turned and shifted; the same four points are seen by tracker and robot.
    let at = ["1.1,0.4,0.9", "0.9,-0.5,1.2", "1.4,0.1,0.5", "0.6,0.3,0.4"];
    for (k, place) in at.iter().enumerate() {
        let data = format!("127.0.0.1:{}", free_port(false));
        let spec = format!("udp://127.0.0.1:{}?lockstep", free_port(false));
        let room_place = ["--bottle", place, "--room", "0.3,-0.2,0.1,30", "--for-s", "60"];
        let mut child = robot(&[&["--rsi", &spec, "--tracker", &data][..], &room_place].concat());
        let out = cubectl(&["tracker", "calibrate", "--tracker", &data, "--file", &room, "--tool-at", place]);
        let expected = if k < 3 { Some(9) } else { Some(0) };
        child.kill().expect("runs");
        let _ = child.wait();
        assert_eq!(out.status.code(), expected, "{place}: {}", text(&out.stderr));
    }
    // The target, in the frame of the robot.
    let (data, port) = (format!("127.0.0.1:{}", free_port(false)), free_port(false));
    let spec = format!("udp://127.0.0.1:{port}?lockstep");
    let bottle = ["--bottle", "2.4,0.3,0.6", "--room", "0.3,-0.2,0.1,30"];
    let mut words = vec!["--rsi", &spec, "--tracker", &data];
    words.extend(bottle);
    let child = robot(&words);
    let shown = cubectl(&["tracker", "show", "--tracker", &data, "--calibration", &room, "--json"]);
    assert_eq!(shown.status.code(), Some(0), "{}", text(&shown.stderr));
    let value: Value = serde_json::from_slice(&shown.stdout).expect("JSON");
    for (seen, true_m) in value["position_m"].as_array().expect("three").iter().zip([2.4, 0.3, 0.6]) {
        assert!((seen.as_f64().expect("a number") - true_m).abs() < 1e-3, "{value}");
    }
    let missing = cubectl(&["tracker", "show", "--tracker", &data, "--tracker-body", "3"]);
    assert_eq!(missing.status.code(), Some(9));
    assert!(text(&missing.stderr).contains("body 3 was not seen"), "{}", text(&missing.stderr));
    let (bus, out_folder) = (format!("rsi:{spec}"), work.join("throw").to_string_lossy().into_owned());
    let places = ["--tracker", &data, "--calibration", &room, "--bus", &bus, "--out", &out_folder];
    let out = cubectl_line("throw --robot kr16_2 --target tracker --starts 16 --yes", &places);
    assert_eq!(out.status.code(), Some(0), "{}", text(&out.stderr));
    // Ctrl-C ends the robot; the tracker was still there for a look after the throw.
    let pid = child.id().to_string();
    assert!(Command::new("kill").args(["-INT", &pid]).status().expect("runs").success());
    let sim = child.wait_with_output().expect("ends");
    let reported = text(&sim.stdout);
    println!("{reported}");
    assert!(reported.contains("bottle hit"), "{reported}");
    let summary = json(&Path::new(&out_folder).join("summary.json"));
    assert!(
        summary["target"]["moved_during_throw_m"].as_f64().expect("looked") < 1e-3,
        "{}",
        summary["target"]
    );
}

/// Waits until a program has written `words` to standard error, and returns what it wrote until then.
fn wait_for_words(child: &mut Child, words: &str) -> (String, BufReader<ChildStderr>) {
    let mut lines = BufReader::new(child.stderr.take().expect("piped"));
    let mut reported = String::new();
    while !reported.contains(words) {
        let read = lines.read_line(&mut reported).expect("readable");
        assert!(read > 0, "it ended before \"{words}\": {reported}");
    }
    (reported, lines)
}

#[test]
fn target_that_moved_while_the_robot_was_waited_for_is_not_thrown_at() {
    let work = folder("robot-target-moved");
    std::fs::create_dir_all(&work).expect("writable");
    let data = format!("127.0.0.1:{}", free_port(false));
    let spec = format!("udp://127.0.0.1:{}?lockstep", free_port(false));
    let nobody = format!("udp://127.0.0.1:{}?lockstep", free_port(false));
    let sees = |bottle: &str, rsi: &str| {
        robot(&["--rsi", rsi, "--tracker", &data, "--bottle", bottle, "--runs", "1"])
    };
    let mut before = sees("2.5,0,0.6", &nobody);
    let results = work.join("results");
    let mut client = Command::new(env!("CARGO_BIN_EXE_cubectl"))
        .args(["throw", "--robot", "kr16_2", "--target", "tracker", "--tracker", &data, "--starts", "2"])
        .args(["--bus", &format!("rsi:{spec}"), "--yes", "--out", &results.to_string_lossy()])
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .expect("runs");
    let (_, mut rest) = wait_for_words(&mut client, "waiting for the robot");
    before.kill().expect("runs");
    let _ = before.wait();
    // 20 mm to the side.
    let mut after = sees("2.5,0.02,0.6", &spec);
    let mut reported = String::new();
    rest.read_to_string(&mut reported).expect("readable");
    let status = client.wait().expect("ends");
    assert!(Command::new("kill").args(["-INT", &after.id().to_string()]).status().expect("runs").success());
    let _ = after.wait();
    assert_eq!(status.code(), Some(9), "{reported}");
    assert!(reported.contains("moved by 20.0 mm") && reported.contains("nothing was thrown"), "{reported}");
    // The recorded exchange runs again with the same answers, so the throw is held there too.
    let again = cubectl(&["log", "replay", &results.to_string_lossy()]);
    assert!(
        text(&again.stdout).starts_with("identical: "),
        "{} {}",
        text(&again.stdout),
        text(&again.stderr)
    );
}

#[test]
fn doctor_status_record_and_replay_look_at_a_robot_that_is_held() {
    let work = folder("robot-look");
    std::fs::create_dir_all(&work).expect("writable");
    let spec = format!("udp://127.0.0.1:{}?lockstep", free_port(false));
    let bus = format!("rsi:{spec}");
    let mut child = robot(&["--rsi", &spec, "--for-s", "120"]);
    let out = cubectl(&["doctor", "--bus", &bus]);
    assert_eq!(out.status.code(), Some(0), "{} {}", text(&out.stdout), text(&out.stderr));
    assert!(text(&out.stdout).contains("each telegram counts 1 more"), "{}", text(&out.stdout));
    // The robot runs another program than the description says.
    let out = cubectl(&["doctor", "--bus", &bus, "--rsi", "kr-c4-12ms"]);
    assert_eq!(out.status.code(), Some(9), "{}", text(&out.stdout));
    assert!(text(&out.stdout).contains("PROBLEM  numbers"), "{}", text(&out.stdout));
    let out = cubectl(&["status", "--bus", &bus, "--json"]);
    let value: Value = serde_json::from_slice(&out.stdout).expect("JSON");
    assert!((value["actual_deg"][1].as_f64().expect("a number") + 90.0).abs() < 0.01, "{value}");
    let recording = work.join("held").to_string_lossy().into_owned();
    let out = cubectl(&["log", "record", &recording, "--bus", &bus, "--for-s", "1"]);
    assert_eq!(out.status.code(), Some(0), "{}", text(&out.stderr));
    let out = cubectl(&["log", "replay", &recording]);
    assert!(text(&out.stdout).starts_with("identical: "), "{} {}", text(&out.stdout), text(&out.stderr));
    // One changed digit of an answer is found.
    let log = Path::new(&recording).join("log.rsi");
    let exchange = std::fs::read_to_string(&log).expect("written");
    std::fs::write(&log, exchange.replacen("A3=\"0.000000\"", "A3=\"0.000001\"", 1)).expect("writable");
    assert_eq!(cubectl(&["log", "replay", &recording]).status.code(), Some(9));
    child.kill().expect("runs");
    let _ = child.wait();
    // A CAN verb says what it wants instead.
    let out = cubectl(&["controller", "clear", "--bus", &bus]);
    assert_eq!(out.status.code(), Some(7), "{}", text(&out.stderr));
    assert!(text(&out.stderr).contains("not to a CAN bus"), "{}", text(&out.stderr));
}

//! What a newcomer sees in the first hours, and must be able to believe.

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};

use crate::bus_common::{Folder, Served, code, cubectl, err, out};
use hil_sim::scenario::fault_from_line;
use hil_sim::{Cell, CellOptions};
use robot_model::RobotModel;
use serde_json::Value;

/// The program with these words in the background, its lines to be read; killed when dropped.
struct Running {
    child: Child,
    lines: Receiver<String>,
}

impl Running {
    fn start(words: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_cubectl"));
        command.args(words).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let (stdout, (put, lines)) = (child.stdout.take().unwrap(), channel());
        // In lock step time stands while a program waits for its reader.
        std::thread::spawn(move || {
            BufReader::new(stdout).lines().map_while(Result::ok).for_each(|line| drop(put.send(line)));
        });
        Self { child, lines }
    }

    /// Ends it; what it said beside its lines.
    fn end(mut self) -> String {
        let _ = self.child.kill();
        std::io::read_to_string(self.child.stderr.take().unwrap()).unwrap()
    }

    /// The first line that is as wanted.
    fn until(&mut self, what: &str, mut wanted: impl FnMut(&str) -> bool) -> String {
        loop {
            let line = self.lines.recv().unwrap_or_else(|_| panic!("ended before {what}"));
            if wanted(&line) {
                return line;
            }
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // SIGKILL; it may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn homed_arm() -> Served {
    let mut options = CellOptions::default();
    options.drive.starts_homed = true;
    Served::arm(options)
}

#[test]
fn after_kill_9_of_the_controller_nothing_is_shown_as_if_it_were_so_now() {
    let served = homed_arm();
    let controller = Running::start(&["controller", "run", "--bus", &served.spec]);
    let words = ["arm", "monitor", "--bus", &served.spec, "--listen", "--for", "120"];
    let mut plain = Running::start(&words);
    let mut json = Running::start(&[&words[..], &["--json"]].concat());
    let seen = |line: &str| -> Value { serde_json::from_str(line).unwrap() };
    plain.until("the controller is ready", |line| line.contains("state=\"ready\""));
    let before = json.until("the controller is ready", |line| seen(line)["controller"]["state"] == "ready");
    assert_eq!(
        (&seen(&before)["link"]["text"], &seen(&before)["controller"]["tone"]),
        (&"live".into(), &"good".into())
    );
    assert!(seen(&before)["joints"][2]["error_rad"].is_number(), "{before}");
    drop(controller);
    let old = json.until("all is old", |line| seen(line)["age_s"].as_f64() > Some(3.0));
    let old = seen(&old);
    let state = old["controller"]["state"].as_str().unwrap();
    assert!(state.starts_with("not heard for ") && old["controller"]["tone"] == "bad", "{old}");
    assert!(
        old["link"]["text"].as_str().unwrap().contains("not heard for ") && old["link"]["tone"] == "warn",
        "{old}"
    );
    for joint in old["joints"].as_array().unwrap() {
        assert!(joint["q_rad"].is_number() && joint["old"] == true, "the angle is marked: {joint}");
        assert!(joint["state"].as_str().unwrap().starts_with("not heard for "), "{joint}");
        for value in ["qd_rad_s", "error_rad", "current_a", "state_bits"] {
            assert!(joint[value].is_null(), "{value}: {joint}");
        }
    }
    plain.until("its state is old", |line| line.contains("controller=") && line.contains("not heard for "));
    let joint =
        plain.until("a joint", |line| line.contains("joint=3 ") && line.contains("not heard for 3 s"));
    for part in ["qd_rad_s=- error_mrad=- current_a=- age_ms=", "state=\"not heard for "] {
        assert!(joint.contains(part), "{part}: {joint}");
    }
}

/// A jog of joint 3 in the background, to be watched meanwhile: in lock step time stands while nobody reads the monitor.
fn jog_3(served: &Served, more: &[&str]) -> Child {
    let mut jog = Command::new(env!("CARGO_BIN_EXE_cubectl"));
    jog.args(["jog", "3", "--bus", &served.spec]).args(more);
    jog.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

#[test]
fn while_joint_3_is_jogged_joint_3_is_shown_and_recorded() {
    let served = homed_arm();
    let folder = Folder::new("jog3");
    let record = folder.file("jog");
    let mut monitor =
        Running::start(&["arm", "monitor", "--bus", &served.spec, "--listen", "--for", "6000", "--json"]);
    monitor.until("it listens", |_| true);
    let jog = jog_3(&served, &["--for", "1.5", "--record", &record]);
    let mut jogs = 0;
    let line = monitor.until("a joint that moves", |line| {
        jogs += line.matches("orders: jog").count();
        let seen: Value = serde_json::from_str(line).unwrap();
        seen["controller"]["state"] == "jogging" && seen["joints"].to_string().contains("\"q_rad\":-1.4")
    });
    monitor.until("how often it was ordered", |line| {
        jogs += line.matches("orders: jog").count();
        line.contains("orders: jog: ")
    });
    assert_eq!(jogs, 2, "first order and count");
    drop(monitor);
    let jog = jog.wait_with_output().unwrap();
    assert_eq!(code(&jog), 0, "{}", err(&jog));
    let seen: Value = serde_json::from_str(&line).unwrap();
    for (joint, number) in seen["joints"].as_array().unwrap().iter().zip(1..) {
        assert_eq!(joint["error_rad"].is_number(), number == 3, "{joint}");
        assert_eq!(joint["q_rad"].is_number(), number == 3, "{joint}");
    }
    // The recording has a topic for each joint that was heard.
    let log = std::fs::read(format!("{record}.mcap")).unwrap();
    let summary = mcap::Summary::read(&log).unwrap().unwrap();
    let topics: Vec<&str> = summary.channels.values().map(|channel| channel.topic.as_str()).collect();
    assert!(topics.contains(&"/joint/3") && !topics.contains(&"/joint/1"), "{topics:?}");
}

#[test]
fn a_fault_of_module_3_is_never_one_of_joint_1() {
    let held = "kind = \"tow-error\", target = \"module 3\"";
    let make = || {
        let mut options = CellOptions::default();
        options.drive.starts_homed = true;
        Cell::new(&RobotModel::load("powercube6").unwrap(), &options, 1).unwrap()
    };
    let served = Served::with_faults(make, vec![fault_from_line(held, 0).unwrap()]);
    let mut monitor =
        Running::start(&["arm", "monitor", "--bus", &served.spec, "--listen", "--for", "6000", "--json"]);
    monitor.until("it listens", |_| true);
    let jog = jog_3(&served, &["--for", "60"]);
    let line =
        monitor.until("a fault", |line| line.contains("\"severity\":\"error\",\"source\":\"controller"));
    drop(monitor);
    let jog = jog.wait_with_output().unwrap();
    assert_ne!(code(&jog), 0, "{}", out(&jog));
    assert!(err(&jog).contains("joint 3: ") && !err(&jog).contains("joint 1"), "{}", err(&jog));
    assert!(line.contains("joint 3: "), "{line}");
}

#[test]
fn a_stop_says_who_stands_and_after_how_long_and_who_sent_it_until_it_is_over() {
    let served = Served::with_controller();
    let bus = ["--bus", &served.spec];
    let mut monitor =
        Running::start(&["arm", "monitor", bus[0], bus[1], "--listen", "--for-s", "6000", "--json"]);
    let seen = |line: &str| -> Value { serde_json::from_str(line).unwrap() };
    let mut jog = Command::new(env!("CARGO_BIN_EXE_cubectl"));
    let jog =
        jog.args(["jog", "6", "--for-s", "600", bus[0], bus[1]]).stderr(Stdio::piped()).spawn().unwrap();
    monitor.until("the jog", |line| seen(line)["controller"]["state"] == "jogging");
    let stop = cubectl(&["stop", bus[0], bus[1]]);
    assert_eq!(code(&stop), 0, "{}", err(&stop));
    assert!(
        out(&stop).contains("stopped by this program: joints 1, 2, 3, 4, 5, 6 stand after 0."),
        "{}",
        out(&stop)
    );
    let line = monitor.until("the end of the stop", |line| seen(line)["stop"]["settled"] == true);
    let text = &seen(&line)["stop"]["text"];
    let jog = jog.wait_with_output().unwrap();
    assert_ne!(code(&jog), 0, "{}", out(&jog));
    assert!(text.as_str().unwrap().contains("joints 1, 2, 3, 4, 5, 6 stand after 0."), "{text}");
    assert!(text.as_str().unwrap().starts_with("stopped by node "), "{text}");
    assert_eq!(seen(&line)["controller"]["state"], "stopped", "a stop is no fault: {line}");
    let clear = cubectl(&["controller", "clear", bus[0], bus[1]]);
    assert_eq!(code(&clear), 0, "{}", err(&clear));
    assert!(out(&clear).contains("the next motion ends the stop"), "{}", out(&clear));
    let jog = cubectl(&["jog", "6", "--for-s", "0.2", bus[0], bus[1]]);
    assert_eq!(code(&jog), 0, "{}", err(&jog));
    monitor.until("no stop any more", |line| seen(line)["stop"].is_null());
}

#[test]
fn a_monitor_that_asks_gives_way_to_who_moves_the_arm() {
    let served = homed_arm();
    let bus = ["--bus", &served.spec];
    let mut monitor = Running::start(&["arm", "monitor", bus[0], bus[1], "--for-s", "6000"]);
    monitor.until("it asks", |line| line.contains("joint=6 ") && line.contains("homed"));
    let jog = cubectl(&["jog", "6", "--for-s", "0.3", bus[0], bus[1]]);
    assert_eq!(code(&jog), 0, "{}", err(&jog));
    monitor.until("the jog", |line| line.contains("jogging"));
    let said = monitor.end();
    assert_eq!(said.matches("gives way").count(), 1, "{said}");
    // One that was asked not to does not, and the advice is no circle.
    let mut beside = Running::start(&["arm", "monitor", bus[0], bus[1], "--for-s", "6000", "--beside"]);
    beside.until("it asks", |line| line.contains("joint=6 ") && line.contains("homed"));
    let jog = cubectl(&["jog", "6", "--for-s", "0.3", bus[0], bus[1]]);
    assert_eq!(code(&jog), 7, "{}", out(&jog));
    assert!(err(&jog).contains("end the other program, which did not give way"), "{}", err(&jog));
}

#[test]
fn a_target_out_of_reach_is_refused_at_once_and_the_named_one_is_thrown_at() {
    let seen = |output: &std::process::Output| -> Value { serde_json::from_str(&out(output)).unwrap() };
    let mut named = 0;
    let out_of_reach = "0,0,-1 6,0,0 9,0,-1 0,0,3 0,5,2 0,0,0 4.9,0,-0.95 3,0,2 30,0,0 -6,1,-1 \
        0,-6,0.5 -2.1,4.1,0.96 -3.4,2.7,1.85 1.03,0,2.44 -3.6,-0.3,2 5.1,1.1,-0.83 0.5,-4.95,0 0.85,4.1,0.96 2.9,2.4,0.8 4.6,-0.5,1.4";
    for target in out_of_reach.split(' ') {
        let began = std::time::Instant::now();
        let refused = cubectl(&["plan", "throw", &format!("--target={target}"), "--json"]);
        let took_s = began.elapsed().as_secs_f64();
        assert_eq!(code(&refused), 3, "{target}: {}", err(&refused));
        let what = seen(&refused)["what"].as_str().unwrap().to_owned();
        println!("{target}: {took_s:.2} s: {what}");
        // Less than a second where it is optimised and alone.
        assert!(took_s < 6.0, "{target}: {took_s} s");
        let point = what.split("the nearest target found in reach is (").nth(1).expect(&what);
        let point = point.split(')').next().unwrap().replace(' ', "");
        let planned = cubectl(&["plan", "throw", &format!("--target={point}"), "--fast"]);
        assert_eq!(code(&planned), 0, "{target}: {point}: {}", err(&planned));
        named += 1;
    }
    assert_eq!(named, 20);
}

#[test]
fn a_target_in_millimetres_is_asked_about_before_anything_is_looked_for() {
    for robot in ["powercube6", "kr16_2"] {
        let output = cubectl(&["throw", "--robot", robot, "--target", "1000,1000,-1000"]);
        assert_eq!(code(&output), 4, "{}", err(&output));
        for text in ["metres?", "next: ", "--target 1,1,-1"] {
            assert!(err(&output).contains(text), "{robot}: {}", err(&output));
        }
    }
}

#[test]
fn every_verb_reports_a_failure_as_one_object_with_json() {
    let folder = Folder::new("json-errors");
    let none = folder.file("none");
    let dir = folder.0.display().to_string();
    for (words, expected) in [
        (&["throw", "--target", "1,1,-1", "--robot", &none][..], 4),
        (&["throw", "--target", "here"], 2),
        (&["plan", "check", &none], 4),
        (&["plan", "export", &none], 4),
        (&["robot", "check", &none], 4),
        (&["log", "report", &none], 4),
        (&["jog", "9", "--for-s", "1"], 4),
        (&["status", "--bus", "nosuchcan7"], 7),
        (&["controller", "run", "--bus", "nosuchcan7"], 7),
        (&["log", "record", &none, "--bus", "nosuchcan7"], 7),
        (&["log", "replay", &none], 4),
        (&["explain", "9999"], 4),
        (&["man", &dir, "--of", "nothing"], 2),
        (&["modules", "restore", &none], 4),
    ] {
        let output = cubectl(&[words, &["--json"]].concat());
        let text = out(&output);
        let seen: Value = serde_json::from_str(&text).unwrap_or_else(|e| panic!("{words:?}: {e}: {text}"));
        assert_eq!(code(&output), expected, "{words:?}: {text}");
        assert_eq!(seen["code"], expected, "{words:?}: {text}");
        let (what, next) = (seen["what"].as_str().unwrap(), seen["next"].as_array().unwrap());
        assert!(!what.is_empty() && !what.contains("next: "), "{words:?}: {text}");
        assert!(!next.is_empty() || !err(&output).contains("next: "), "{words:?}: {text}");
        assert!(err(&output).contains(what.lines().next().unwrap()), "{words:?}: the text is there too");
    }
}

#[test]
fn a_plan_is_exported_in_the_one_format_there_is() {
    let folder = Folder::new("export");
    let plan = folder.file("plan.json");
    let planned = cubectl(&["plan", "throw", "--target", "1,1,-1", "--fast", "--out", &plan]);
    assert_eq!(code(&planned), 0, "{}", err(&planned));
    let table = cubectl(&["plan", "export", &plan]);
    assert_eq!(code(&table), 0, "{}", err(&table));
    assert!(out(&table).starts_with("t_s,q_"), "{}", out(&table));
}

#[test]
fn a_setting_that_is_refused_beside_a_motion_says_that_another_program_works() {
    let served = Served::with_controller();
    let bus = ["--bus", &served.spec];
    let mut monitor =
        Running::start(&["arm", "monitor", bus[0], bus[1], "--listen", "--for-s", "6000", "--json"]);
    monitor.until("it listens", |_| true);
    let mut jog = Command::new(env!("CARGO_BIN_EXE_cubectl"));
    let mut jog =
        jog.args(["jog", "6", "--for-s", "600", bus[0], bus[1]]).stderr(Stdio::piped()).spawn().unwrap();
    monitor.until("the jog", |line| line.contains("jogging"));
    let output =
        cubectl(&["controller", "registers", "set", "cycle.period_us=4000", "--beside", bus[0], bus[1]]);
    let _ = jog.kill();
    let _ = jog.wait();
    assert_ne!(code(&output), 0, "{}", out(&output));
    let reported = err(&output);
    assert!(
        reported.contains("another program")
            && reported.contains("next: ")
            && !reported.contains("does not take"),
        "{reported}"
    );
}

#[test]
fn a_result_that_cannot_be_written_leaves_no_empty_file() {
    let folder = Folder::new("full-disk");
    std::fs::create_dir_all(folder.file("out")).unwrap();
    // The temporary file of the summary cannot be made: as on a full disk, there is no summary then.
    std::os::unix::fs::symlink("/dev/full", folder.file("out/summary.json.part")).unwrap();
    let output = cubectl(&["throw", "--target", "1,1,-1", "--out", &folder.file("out")]);
    assert_eq!(code(&output), 10, "{}", err(&output));
    assert!(!std::path::Path::new(&folder.file("out/summary.json")).exists());
}

#[test]
fn a_throw_with_a_page_runs_in_real_time_on_the_default_bus() {
    let folder = Folder::new("web-sim");
    let began = std::time::Instant::now();
    let output = cubectl(&["throw", "--target", "1,1,-1", "--web", "0", "--out", &folder.file("out")]);
    let took_s = began.elapsed().as_secs_f64();
    assert_eq!(code(&output), 0, "{}", err(&output));
    assert!(err(&output).contains("live view at http://127.0.0.1:"), "{}", err(&output));
    let summary = std::fs::read_to_string(folder.file("out/summary.json")).unwrap();
    let summary: Value = serde_json::from_str(&summary).unwrap();
    let steps = summary["steps"].as_array().unwrap().iter();
    let bus_s: f64 = steps.map(|step| step["bus_time_s"].as_f64().unwrap()).sum();
    assert!(bus_s > 5.0 && took_s > 0.95 * bus_s, "{bus_s} s of the arm in {took_s} s");
}

//! What people read when a throw cannot be: each failure with its message and exit code.

use std::cell;
use std::io;
use std::process::{Child, Command, Stdio};
use std::rc::Rc;

use crate::bus_common::{Folder, Served, code, cubectl, err, out};
use firmware::fault::Cause;
use hil_sim::participants::Solo;
use hil_sim::scenario::ScriptedHost;
use hil_sim::{Cell, CellOptions};
use operator::bus::{BusArgs, Session};
use operator::log::facts::{Decoder, Fact};
use operator::tap::{Tap, Way};
use protocol::cyphal::cubecell::group_state::{GroupState, State};
use protocol::cyphal::cubecell::stop::Reason;
use protocol::{Duration, Frame, Instant};
use robot_model::RobotModel;

/// A throw to a near target; more words may be added.
fn throw(folder: &Folder, words: &[&str]) -> std::process::Output {
    let out = folder.file("out");
    // What an earlier throw of the same test left.
    let _ = std::fs::remove_file(folder.file("out/summary.json"));
    if folder.0.join("out/bus.log").is_file() {
        std::fs::remove_dir_all(&out).unwrap();
    }
    let mut all = vec!["throw", "--yes", "--out", &out];
    if !words.contains(&"--plan") && !words.contains(&"--target") {
        all.extend(["--target", "1,1,-1"]);
    }
    all.extend(words);
    let output = cubectl(&all);
    println!("--- throw {}: exit {}\n{}", words.join(" "), code(&output), err(&output));
    output
}

fn refused(output: &std::process::Output, expected: i32, texts: &[&str]) {
    assert_eq!(code(output), expected, "{}{}", out(output), err(output));
    for text in texts.iter().chain(&["next: "]) {
        assert!(err(output).contains(text), "{text}: {}", err(output));
    }
}

fn scenario(folder: &Folder, text: &str) -> String {
    let path = folder.file("scenario.toml");
    std::fs::write(&path, format!("schema_version = 1\nduration_s = 1.0\n{text}")).unwrap();
    path
}

#[test]
fn buses_that_are_not_there() {
    let folder = Folder::new("fail-bus");
    refused(&throw(&folder, &["--bus", "nosuchcan7"]), 7, &["nosuchcan7"]);
    let nobody = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    refused(&throw(&folder, &["--bus", &format!("socketcand://{nobody}/can0")]), 7, &["cannot connect"]);
}

#[test]
fn drives_that_are_missing_double_or_too_old() {
    let folder = Folder::new("fail-drives");
    // Somebody listens, or no frame would be acknowledged.
    let empty = Served::new(|| Solo::new("listener", ScriptedHost::new(&[])));
    refused(&throw(&folder, &["--bus", &empty.spec]), 8, &["no module answers"]);
    drop(empty);
    let silent = scenario(&folder, "[[fault]]\nkind = \"silent\"\ntarget = \"module 3\"\n");
    refused(&throw(&folder, &["--scenario", &silent]), 8, &["module 3: no answer"]);
    let twins = Served::new(|| {
        let robot = RobotModel::load("powercube6").unwrap();
        let (options, mut other) = (CellOptions::default(), CellOptions::default());
        other.drive.processing_delay = Duration::from_micros(900);
        (Cell::new(&robot, &options, 1).unwrap(), Cell::bench(1, 0x4614, &other, 2).unwrap())
    });
    refused(&throw(&folder, &["--bus", &twins.spec]), 8, &["two modules answer at address 1"]);
    drop(twins);
    let text = robot_model::built_in_text("powercube6").unwrap().replacen(
        "firmware = 0x3519",
        "firmware = 0x3500",
        1,
    );
    std::fs::write(folder.file("old.toml"), text).unwrap();
    refused(&throw(&folder, &["--robot", &folder.file("old.toml")]), 8, &["module 5: firmware 3500"]);
}

/// Answers after up to 0.4 ms, and a second host that asks: each needs a longer period than the nominal cell. In the two others somebody
/// else moves the arm.
#[test]
fn shipped_scenarios_show_in_a_throw_what_their_name_says() {
    let folder = Folder::new("shipped-scenarios");
    let file = |name: &str| format!("{}/../hil-sim/scenarios/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    let summary = || -> serde_json::Value {
        let text = std::fs::read_to_string(folder.file("out/summary.json")).unwrap();
        serde_json::from_str(&text).unwrap()
    };
    let mut landed_m = Vec::new();
    for words in [&["perturbed_plant"][..], &["perturbed_plant", "--seed", "17"], &["poll"]] {
        let output = throw(&folder, &[&["--scenario", &file(words[0])], &words[1..]].concat());
        assert_eq!(code(&output), 0, "{words:?}: {}", err(&output));
        assert!(out(&output).contains("certified 3.75 to 6.25 ms"), "{words:?}: {}", out(&output));
        landed_m.push(summary()["landing"]["position_m"].to_string());
    }
    assert_ne!(landed_m[0], landed_m[1], "another plant, another landing");
    let log = std::fs::read_to_string(folder.file("out/bus.log")).unwrap();
    assert!(log.matches(" 0C3#0A62").count() > 500, "the other host polls during the throw");
    // It falls silent in the throw, 0.1 s before the release.
    let output = throw(&folder, &["--scenario", &file("silent_joint")]);
    refused(&output, 13, &["throw: ", "joint 3: a drive missed more replies", "(fault 101)"]);
    let seen = summary();
    assert_eq!((&seen["ended_in_step"], &seen["ball"]), (&"throw".into(), &"in_hand".into()));
    let silent_s = seen["plan"]["release_s"].as_f64().unwrap() - 0.1;
    let fault_s = seen["fault"]["plan_time_s"].as_f64().unwrap();
    assert!((silent_s..silent_s + 0.03).contains(&fault_s), "silent at {silent_s} s, fault at {fault_s} s");
    for name in ["cycle", "all_faults"] {
        refused(
            &throw(&folder, &["--scenario", &file(name)]),
            8,
            &["fault 108", "look for another controller"],
        );
    }
}

#[test]
fn targets_plans_and_gains_that_do_not_fit() {
    let folder = Folder::new("fail-plans");
    refused(&throw(&folder, &["--target", "9,0,-1", "--starts", "4"]), 3, &["9"]);
    let plan = folder.file("plan.json");
    let planned = cubectl(&["plan", "throw", "--target", "1,1,-1", "--fast", "--out", &plan]);
    assert_eq!(code(&planned), 0);
    let longer = robot_model::built_in_text("powercube6").unwrap().replacen("d_m = 0.27", "d_m = 0.28", 1);
    std::fs::write(folder.file("longer.toml"), longer).unwrap();
    let output = throw(&folder, &["--plan", &plan, "--robot", &folder.file("longer.toml")]);
    assert_eq!(code(&output), 4);
    let reported = err(&output);
    assert!(
        reported.contains("is for robot \"powercube6\"") && reported.contains("plan again"),
        "{reported}"
    );
    std::fs::write(folder.file("gains.toml"), "format = 99").unwrap();
    let output = throw(&folder, &["--gains", &folder.file("gains.toml")]);
    assert_eq!(code(&output), 4);
    assert!(err(&output).contains("gains.toml: "), "{}", err(&output));
}

#[test]
fn a_homing_that_fails_and_a_drive_lost_in_mid_throw_stop_the_arm() {
    let folder = Folder::new("fail-moving");
    // Counts that get lost while the drive holds its joint make it move: nobody ordered that.
    let lost =
        scenario(&folder, "[[fault]]\nkind = \"encoder-error\"\ntarget = \"module 6\"\noffset_deg = 30.0\n");
    refused(&throw(&folder, &["--scenario", &lost]), 8, &["joint 6", "(fault 108)"]);
    let held = scenario(&folder, "[[fault]]\nkind = \"tow-error\"\ntarget = \"module 6\"\nstart_s = 0.7\n");
    refused(&throw(&folder, &["--scenario", &held]), 13, &["home: ", "joint 6", "(fault 502)"]);
    // When the throw begins in virtual time, from an undisturbed run of the same seed.
    let good = throw(&folder, &["--json"]);
    let report: serde_json::Value = serde_json::from_str(&out(&good)).unwrap();
    let steps = report["steps"].as_array().unwrap().iter();
    let begin_s: f64 = steps
        .take_while(|step| step["step"] != "throw")
        .map(|step| step["bus_time_s"].as_f64().unwrap())
        .sum();
    let text = format!("[[fault]]\nkind = \"silent\"\ntarget = \"module 2\"\nstart_s = {}\n", begin_s + 0.4);
    let output = throw(&folder, &["--scenario", &scenario(&folder, &text)]);
    refused(&output, 13, &["throw: ", "joint 2: a drive missed more replies", "(fault 101)"]);
    let text = std::fs::read_to_string(folder.file("out/summary.json")).unwrap();
    let report: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(
        (&report["ended_in_step"], &report["fault"]["name"]),
        (&"throw".into(), &"DriveSilent".into())
    );
}

#[test]
fn a_disk_that_is_full_ends_the_throw_before_anything_is_lost_unseen() {
    let folder = Folder::new("fail-disk");
    std::fs::create_dir_all(folder.file("out")).unwrap();
    std::os::unix::fs::symlink("/dev/full", folder.file("out/bus.log")).unwrap();
    refused(&throw(&folder, &[]), 10, &["recording cannot be written", "free space"]);
}

/// A served cell with a controller of its own, as another machine would have it, and somebody who looks on.
///
/// Whoever looks on takes part in lock step: while it does nothing, time stands.
struct Lab {
    served: Served,
    watch: Session,
}

/// Counts how often the group began to run. It sees every frame: the stand at the start of the throw may be short.
#[derive(Clone, Default)]
struct Starts {
    decoder: Decoder,
    running: bool,
    count: Rc<cell::Cell<u32>>,
}

impl Tap for Starts {
    fn frame(&mut self, at: Instant, _: Way, frame: &Frame) -> io::Result<()> {
        if let Some(Fact::Group { state, .. }) = self.decoder.take(at, frame) {
            let running = state.state == State::Running;
            if running && !self.running {
                self.count.set(self.count.get() + 1);
            }
            self.running = running;
        }
        Ok(())
    }
}

impl Lab {
    fn new() -> Self {
        let served = Served::new(|| {
            let robot = RobotModel::load("powercube6").unwrap();
            let arm = &robot;
            let mut options = CellOptions::default();
            options.drive.starts_homed = true;
            options.start_q_rad = Some(((arm.q_min() + arm.q_max()) * 0.5).to_vec());
            (Cell::new(&robot, &options, 1).unwrap(), operator::bus::sim::soft_controller_node())
        });
        let mut watch = BusArgs { bus: served.spec.parse().unwrap(), ..BusArgs::default() }.open().unwrap();
        watch.host_node().listen_only();
        Self { served, watch }
    }

    /// Starts a throw and waits until the arm has followed the plan for a quarter of a second.
    fn throwing(&mut self, folder: &Folder) -> Child {
        let out = folder.file("out");
        // As started by a terminal, also if these tests are run under `nohup`.
        let mut child = Command::new("env")
            .args([
                "--default-signal=HUP",
                env!("CARGO_BIN_EXE_cubectl"),
                "throw",
                "--yes",
                "--target",
                "1,1,-1",
                "--bus",
                &self.served.spec,
                "--controller",
                "10",
            ])
            .args(["--out", &out])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        // The arm goes to the start, stands there, and throws.
        let starts = Starts::default();
        self.watch.add_tap(Box::new(starts.clone()));
        while starts.count.get() < 2 {
            self.watch.pass(Duration::from_millis(20)).unwrap();
            if child.try_wait().unwrap().is_some() {
                let output = child.wait_with_output().unwrap();
                panic!("ended after {} starts: {}", starts.count.get(), err(&output));
            }
        }
        self.watch.pass(Duration::from_millis(250)).unwrap();
        child
    }

    fn group(&mut self) -> GroupState {
        self.watch.group().expect("the controller is heard")
    }
}

fn signal(child: &Child, name: &str) {
    let status = Command::new("sh").args(["-c", &format!("kill -{name} {}", child.id())]).status();
    assert!(status.unwrap().success());
}

#[test]
fn a_host_that_is_killed_in_mid_throw_leaves_a_standing_arm_and_a_fault_with_that_name() {
    let folder = Folder::new("fail-killed");
    let mut lab = Lab::new();
    let mut killed = lab.throwing(&folder);
    signal(&killed, "KILL");
    killed.wait().unwrap();
    assert_eq!(lab.group().state, State::Running, "time stood while the host died");
    lab.watch.pass(Duration::from_millis(800)).unwrap();
    let group = lab.group();
    assert_eq!((group.state, group.fault_cause), (State::Fault, Cause::HostLost.code()), "{group:?}");
}

#[test]
fn a_host_that_is_reported_to_end_in_mid_throw_stops_the_arm_before_it_ends() {
    for name in ["INT", "TERM", "HUP"] {
        let folder = Folder::new(&format!("fail-{name}"));
        let mut lab = Lab::new();
        let mut reported = lab.throwing(&folder);
        signal(&reported, name);
        // A throw that goes on ends with another exit code.
        let status = loop {
            lab.watch.pass(Duration::from_millis(20)).unwrap();
            if let Some(status) = reported.try_wait().unwrap() {
                break status;
            }
        };
        assert_eq!(status.code(), Some(6), "SIG{name}");
        assert_eq!(lab.group().state, State::Stopped, "SIG{name}");
    }
}

#[test]
fn a_signal_half_a_second_after_the_first_ends_a_host_that_waits_for_its_arm() {
    let folder = Folder::new("fail-insists");
    let mut lab = Lab::new();
    let mut reported = lab.throwing(&folder);
    // Simulated time does not advance in this loop, so the host never sees the arm stop. Only a later signal ends the host.
    let status = loop {
        let _ =
            Command::new("kill").args(["-INT", &reported.id().to_string()]).stderr(Stdio::null()).status();
        if let Some(status) = reported.try_wait().unwrap() {
            break status;
        }
        std::thread::sleep(std::time::Duration::from_millis(20));
    };
    assert_eq!(status.code(), Some(6));
    assert_eq!(lab.group().state, State::Running, "the host ended before its arm stood");
}

#[test]
fn a_stop_after_the_release_says_where_the_ball_goes_also_where_nobody_watches_it() {
    let folder = Folder::new("fail-released");
    let mut lab = Lab::new();
    let mut throw = lab.throwing(&folder);
    let plan = std::fs::read_to_string(folder.file("out/plan.json")).unwrap();
    let plan: serde_json::Value = serde_json::from_str(&plan).unwrap();
    let release_s = plan["release_time_s"].as_f64().unwrap();
    // It has run for a quarter of a second, and a message of its state later.
    lab.watch.pass(Duration::from_secs_f64(release_s + 0.05 - 0.25)).unwrap();
    lab.watch.halt(Reason::OPERATOR).unwrap();
    while throw.try_wait().unwrap().is_none() {
        lab.watch.pass(Duration::from_millis(20)).unwrap();
    }
    let output = throw.wait_with_output().unwrap();
    assert_eq!(code(&output), 13, "{}", err(&output));
    let text = std::fs::read_to_string(folder.file("out/summary.json")).unwrap();
    let report: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(report["outcome"], "stopped", "{report:#}");
    let verdict = report["outcome_text"].as_str().unwrap();
    assert!(verdict.contains("with the measured motion the ball lands at"), "{verdict}");
}

#[test]
fn a_throw_that_another_host_stops_names_its_folder_and_the_clear_that_then_works() {
    let folder = Folder::new("fail-stopped");
    let mut lab = Lab::new();
    let mut throw = lab.throwing(&folder);
    let stop = Command::new(env!("CARGO_BIN_EXE_cubectl"))
        .args(["stop", "--bus", &lab.served.spec])
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    for child in [&mut { stop }, &mut throw] {
        while child.try_wait().unwrap().is_none() {
            lab.watch.pass(Duration::from_millis(20)).unwrap();
        }
    }
    let output = throw.wait_with_output().unwrap();
    assert_eq!(code(&output), 13, "{}", err(&output));
    let clear = format!("`cubectl controller clear --bus {}`", lab.served.spec);
    assert!(err(&output).contains("next: ") && err(&output).contains(&clear), "{}", err(&output));
    assert!(err(&output).contains(&format!("results in {}", folder.file("out"))), "{}", err(&output));
    for name in ["report.html", "summary.json", "bus.log"] {
        assert!(folder.0.join("out").join(name).metadata().unwrap().len() > 100, "{name}");
    }
    drop(lab.watch);
    let cleared = cubectl(&["controller", "clear", "--bus", &lab.served.spec]);
    assert_eq!(code(&cleared), 0, "{}{}", out(&cleared), err(&cleared));
}

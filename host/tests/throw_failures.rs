//! What people read when a throw cannot be: each failure with its message and exit code.

mod bus_common;

use std::io::Write;
use std::process::{Child, Command, Stdio};

use bus_common::{Folder, Served, code, cubectl, err, in_real_time, out};
use hil_sim::{Cell, CellOptions};
use robot_model::AnyRobot;

/// A throw to a near target; more words may be added.
fn throw(folder: &Folder, words: &[&str]) -> std::process::Output {
    let out = folder.file("out");
    // What an earlier throw of the same test left.
    let _ = std::fs::remove_file(folder.file("out/summary.json"));
    if folder.0.join("out/log.candump").is_file() {
        std::fs::remove_dir_all(&out).unwrap();
    }
    let mut all = vec!["throw", "--no-store", "--out", &out];
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
    in_real_time(|| {
        let folder = Folder::new("fail-drives");
        let empty = Served::new(Vec::<hil_sim::crew::Solo<hil_sim::scenario::ScriptedHost>>::new);
        refused(&throw(&folder, &["--bus", &empty.spec]), 8, &["no module answers"]);
        drop(empty);
        let silent = scenario(&folder, "[[fault]]\nkind = \"silent\"\ntarget = \"module 3\"\n");
        refused(&throw(&folder, &["--scenario", &silent]), 8, &["module 3 does not answer"]);
        let twins = Served::new(|| {
            let robot = AnyRobot::load("powercube6").unwrap();
            let (options, mut other) = (CellOptions::default(), CellOptions::default());
            other.drive.processing_delay = protocol::Duration::from_micros(900);
            (Cell::new(&robot, &options, 1).unwrap(), Cell::bench::<1>(0x4614, &other, 2).unwrap())
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
    });
}

#[test]
fn targets_plans_and_gains_that_do_not_fit() {
    let folder = Folder::new("fail-plans");
    refused(&throw(&folder, &["--target", "9,0,-1", "--starts", "4"]), 3, &["9"]);
    let plan = folder.file("plan.json");
    let planned = cubectl(&["plan", "throw", "--target", "1,1,-1", "--fast", "--no-store", "--out", &plan]);
    assert_eq!(code(&planned), 0);
    let longer = robot_model::built_in_text("powercube6").unwrap().replacen("d_m = 0.27", "d_m = 0.28", 1);
    std::fs::write(folder.file("longer.toml"), longer).unwrap();
    let output = throw(&folder, &["--plan", &plan, "--robot", &folder.file("longer.toml")]);
    assert_eq!(code(&output), 4);
    assert!(err(&output).contains("is for robot \"powercube6\"") && err(&output).contains("plan again"));
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
    std::os::unix::fs::symlink("/dev/full", folder.file("out/log.candump")).unwrap();
    refused(&throw(&folder, &[]), 10, &["recording cannot be written", "free space"]);
}

/// A served cell with a controller of its own, as another machine would have it.
struct Lab {
    child: Child,
    spec: String,
}

impl Lab {
    fn new(folder: &Folder) -> Self {
        let robot = AnyRobot::load("powercube6").unwrap();
        let middle: Vec<String> = match &robot {
            AnyRobot::Six(arm) => {
                ((arm.q_min() + arm.q_max()) * 0.5).iter().map(ToString::to_string).collect()
            }
            _ => unreachable!("six joints"),
        };
        let text = format!("[drive]\nstarts_homed = true\n[cell]\nstart_q_rad = [{}]\n", middle.join(", "));
        let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let spec = format!("socketcand://127.0.0.1:{port}/can0");
        let child = Command::new(env!("CARGO_BIN_EXE_cubectl"))
            .args(["sim", "--controller", "--bus", &spec, "--scenario", &scenario(folder, &text)])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        for _ in 0..100 {
            if std::net::TcpStream::connect(("127.0.0.1", port)).is_ok() {
                break;
            }
            std::thread::sleep(std::time::Duration::from_millis(50));
        }
        Self { child, spec }
    }

    /// Starts a throw and waits until the arm follows the plan.
    fn throwing(&self, folder: &Folder) -> Child {
        let out = folder.file("out");
        let mut child = Command::new(env!("CARGO_BIN_EXE_cubectl"))
            .args(["throw", "--target", "1,1,-1", "--no-store", "--bus", &self.spec, "--controller", "10"])
            .args(["--out", &out])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut errors = std::io::BufReader::new(child.stderr.take().unwrap());
        let mut line = String::new();
        while !line.starts_with("arm ") {
            line.clear();
            let n = std::io::BufRead::read_line(&mut errors, &mut line).unwrap();
            assert_ne!(n, 0, "the throw ended before it began");
        }
        std::thread::sleep(std::time::Duration::from_millis(250));
        child.stderr = Some(errors.into_inner());
        child
    }

    /// What the controller says for a second.
    fn state(&self) -> String {
        out(&cubectl(&[
            "monitor", "--listen", "--plain", "--for", "1", "--period", "0.5", "--bus", &self.spec,
        ]))
    }
}

impl Drop for Lab {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn signal(child: &Child, name: &str) {
    let status = Command::new("sh").args(["-c", &format!("kill -{name} {}", child.id())]).status();
    assert!(status.unwrap().success());
}

#[test]
fn a_host_that_dies_or_is_interrupted_in_mid_throw_leaves_a_standing_arm() {
    in_real_time(|| {
        let folder = Folder::new("fail-host");
        let lab = Lab::new(&folder);
        let mut killed = lab.throwing(&folder);
        signal(&killed, "KILL");
        killed.wait().unwrap();
        std::thread::sleep(std::time::Duration::from_millis(800));
        let text = lab.state();
        std::io::stderr().write_all(text.as_bytes()).unwrap();
        assert!(text.contains("state=Fault") && text.contains("HostLost"), "{text}");
        drop(lab);
        let lab = Lab::new(&folder);
        std::fs::remove_dir_all(folder.file("out")).unwrap();
        let mut interrupted = lab.throwing(&folder);
        signal(&interrupted, "INT");
        assert_eq!(interrupted.wait().unwrap().code(), Some(6));
        let text = lab.state();
        assert!(text.contains("state=Stopped"), "{text}");
    });
}

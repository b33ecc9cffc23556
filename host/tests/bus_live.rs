//! The verbs over a socket, and what people see when the bus is not as it should be.

use crate::bus_common::{Served, code, cubectl, err, out};
use hil_sim::{Cell, CellOptions};
use operator::bus::{BusArgs, Ended};
use operator::node::host_node::HostNode;
use protocol::{Duration, ModuleId};

#[test]
fn scan_home_jog_and_stop_work_over_a_socket() {
    let mut options = CellOptions::default();
    options.drive.starts_homed = true;
    let served = Served::arm(options);
    let bus = ["--bus", &served.spec];
    let scan = cubectl(&["status", bus[0], bus[1]]);
    assert_eq!(code(&scan), 0, "{}", err(&scan));
    assert!(out(&scan).contains("6 modules"), "{}", out(&scan));
    let jog = cubectl(&["jog", "6", "--for-s", "0.3", bus[0], bus[1], "--json"]);
    assert_eq!(code(&jog), 0, "{}", err(&jog));
    let report: serde_json::Value = serde_json::from_str(&out(&jog)).unwrap();
    let moved = report["to_rad"].as_f64().unwrap() - report["from_rad"].as_f64().unwrap();
    assert!((0.005..0.08).contains(&moved), "{moved}");
    let home = cubectl(&["home", bus[0], bus[1]]);
    assert_eq!(code(&home), 0, "{}", err(&home));
    assert_eq!(out(&home).matches("homed already").count(), 6, "{}", out(&home));
    let stop = cubectl(&["stop", bus[0], bus[1]]);
    assert_eq!(code(&stop), 0, "{}", err(&stop));
    assert!(out(&stop).contains("6 of them halted"), "{}", out(&stop));
}

#[test]
fn a_stop_is_sent_although_the_robot_file_or_the_recording_cannot_be_opened() {
    let mut options = CellOptions::default();
    options.drive.starts_homed = true;
    let served = Served::arm(options);
    for (option, file, expected) in
        [("--robot", "no-such-robot.toml", 4), ("--record", "no-such-folder/a", 10)]
    {
        let stop = cubectl(&["stop", "--bus", &served.spec, option, file]);
        assert!(out(&stop).contains("6 of them halted"), "{}", out(&stop));
        assert_eq!(code(&stop), expected, "{}", err(&stop));
        assert!(err(&stop).contains(file), "{}", err(&stop));
    }
}

#[test]
fn ctrl_c_in_a_jog_stops_the_module_before_the_program_ends() {
    let mut options = CellOptions::default();
    options.drive.starts_homed = true;
    let served = Served::arm(options);
    // Whoever looks on takes part in lock step: while it does nothing, time stands.
    let mut watch = BusArgs { bus: served.spec.parse().unwrap(), ..BusArgs::default() }.open().unwrap();
    let mut jog = std::process::Command::new(env!("CARGO_BIN_EXE_cubectl"))
        .args(["jog", "6", "--for", "60", "--bus", &served.spec])
        .stdout(std::process::Stdio::null())
        .spawn()
        .unwrap();
    let six = ModuleId::new(6).unwrap();
    let position = |host_node: &HostNode| host_node.heard().get(&six).and_then(|heard| heard.position_rad);
    let until = watch.now() + Duration::from_secs(600);
    let mut start = None;
    let moves = watch.run(until, &mut |host_node| {
        let now = position(host_node);
        start = start.or(now);
        now.zip(start).is_some_and(|(now, start)| (now - start).abs() > 0.01)
    });
    assert_eq!(moves.unwrap(), Ended::Done, "the jog never began");
    let killed = std::process::Command::new("sh").args(["-c", &format!("kill -INT {}", jog.id())]).status();
    assert!(killed.unwrap().success());
    // How much virtual time passes until a process has ended is the machine's affair: a jog of 60 s that goes on is reported by
    // its exit code.
    let status = loop {
        watch.pass(Duration::from_millis(20)).unwrap();
        if let Some(status) = jog.try_wait().unwrap() {
            break status;
        }
    };
    assert_eq!(status.code(), Some(6));
    drop(watch);
    let position = || -> f64 {
        let status = cubectl(&["status", "--modules", "6", "--json", "--bus", &served.spec]);
        let report: serde_json::Value = serde_json::from_str(&out(&status)).unwrap();
        report["modules"][0]["position_rad"].as_f64().unwrap()
    };
    let (first, second) = (position(), position());
    assert!((first - second).abs() < 1e-3, "still moving: {first} -> {second}");
}

#[test]
fn home_and_jog_go_through_the_controller_on_the_bus_and_leave_its_settings_as_they_were() {
    let served = Served::with_controller();
    let bus = ["--bus", &served.spec];
    let soft = cubectl(&["home", bus[0], bus[1], "--controller", "soft"]);
    assert_eq!(code(&soft), 7, "{}", out(&soft));
    assert!(err(&soft).contains("controller 10 is on this bus already"), "{}", err(&soft));

    let speed = || {
        let output =
            cubectl(&["controller", "registers", "get", "joint.home_v_rad_s", bus[0], bus[1], "--json"]);
        serde_json::from_str::<serde_json::Value>(&out(&output)).unwrap()
    };
    let before = speed();
    let home =
        cubectl(&["home", bus[0], bus[1], "--modules", "6", "--force", "--speed-rad-s", "0.2", "--json"]);
    assert_eq!(code(&home), 0, "{}", err(&home));
    let report: serde_json::Value = serde_json::from_str(&out(&home)).unwrap();
    assert!(report["modules"][0]["took_s"].as_f64().unwrap() > 0.05, "{report:#}");
    assert_eq!(speed(), before);

    let jog = cubectl(&["jog", "6", "--for-s", "0.3", bus[0], bus[1], "--json"]);
    assert_eq!(code(&jog), 0, "{}", err(&jog));
    let report: serde_json::Value = serde_json::from_str(&out(&jog)).unwrap();
    let moved = report["to_rad"].as_f64().unwrap() - report["from_rad"].as_f64().unwrap();
    assert!((0.005..0.08).contains(&moved), "{moved}");
}

#[test]
fn a_controller_of_this_program_leaves_drives_that_are_not_halted() {
    let mut options = CellOptions::default();
    options.drive.starts_homed = true;
    let served = Served::arm(options);
    let jog = cubectl(&["jog", "6", "--for", "0.3", "--bus", &served.spec]);
    assert_eq!(code(&jog), 0, "{}", err(&jog));
    let status = cubectl(&["status", "--json", "--bus", &served.spec]);
    assert_eq!(code(&status), 0, "{}", err(&status));
    let report: serde_json::Value = serde_json::from_str(&out(&status)).unwrap();
    let modules = report["modules"].as_array().unwrap();
    assert_eq!(modules.len(), 6);
    for module in modules {
        let state = module["state"].as_str().unwrap();
        assert!(!state.contains("HALTED") && !state.contains("ERROR"), "{module}");
    }
}

#[test]
fn modules_that_a_controller_speaks_to_are_not_disturbed() {
    let served = Served::with_controller();
    let output = cubectl(&["status", "--bus", &served.spec, "--json"]);
    assert_eq!(code(&output), 0, "{}", err(&output));
    let report: serde_json::Value = serde_json::from_str(&out(&output)).unwrap();
    assert_eq!((&report["asked"], &report["controller"]["node_id"]), (&false.into(), &10.into()));
    assert_eq!(report["controller"]["host_alive"], false, "{report:#}");
    let modules = report["modules"].as_array().unwrap();
    assert_eq!(modules.len(), 6, "{report:#}");
    for module in modules {
        assert!(module["position_rad"].is_number() && module["homed"] == true, "{report:#}");
    }
    let text = out(&cubectl(&["status", "--bus", &served.spec]));
    assert!(text.contains("controller 10: ready") && text.contains("nothing was sent"), "{text}");
    let named = cubectl(&["status", "--bus", &served.spec, "--modules", "6-7"]);
    assert_eq!(code(&named), 8, "{}", out(&named));
    assert!(err(&named).contains("module 7 is not heard"), "{}", err(&named));
    let output = cubectl(&["arm", "monitor", "--bus", &served.spec, "--for", "0.5"]);
    assert_eq!(code(&output), 0, "{}", err(&output));
    assert!(out(&output).contains("controller=10") && out(&output).contains("module=6"), "{}", out(&output));
    assert!(err(&output).contains("nothing is sent"), "{}", err(&output));
    let output = cubectl(&["doctor", "--bus", &served.spec]);
    let text = out(&output);
    assert_eq!(code(&output), 0, "{text}");
    for part in [
        "requests to modules",
        "ok       controller: controller 10: ready, no fault",
        "6 heard: 1, 2, 3, 4, 5, 6",
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }
    let output = cubectl(&["stop", "--bus", &served.spec]);
    assert_eq!(code(&output), 0, "{}", err(&output));
    assert!(out(&output).contains("was not disturbed further"), "{}", out(&output));
}

#[test]
fn a_control_period_that_does_not_hold_is_refused_before_anything_moves() {
    let mut options = CellOptions::default();
    options.drive.starts_homed = true;
    // Whatever the machine does: a cycle of 3 ms waits 2 ms for an answer.
    options.drive.processing_delay = Duration::from_millis(4);
    let served = Served::arm(options);
    let folder = crate::bus_common::Folder::new("period");
    let throw = ["throw", "--yes", "--target", "1,1,-1", "--controller", "soft", "--bus", &served.spec];
    let output = cubectl(&[&throw[..], &["--period-ms", "3", "--out", &folder.file("a")]].concat());
    assert_eq!(code(&output), 7, "{}", err(&output));
    for part in
        ["a control period of 3 ms does not hold here", "at worst", "ms would hold", "nothing has moved"]
    {
        assert!(err(&output).contains(part), "{part}: {}", err(&output));
    }
    assert!(!folder.0.join("a").exists(), "refused before anything was written");
    let doctor = cubectl(&["doctor", "--bus", &served.spec]);
    assert!(out(&doctor).contains("control period: a controller in this program needs"), "{}", out(&doctor));
    assert!(out(&doctor).contains("real time: "), "{}", out(&doctor));
    let clear = cubectl(&["controller", "clear", "--bus", &served.spec]);
    assert_eq!(code(&clear), 0, "{}", err(&clear));
    assert!(
        out(&clear).contains("no controller is heard; 6 modules answer, 0 of them reset"),
        "{}",
        out(&clear)
    );
}

#[test]
fn drives_too_slow_for_every_period_are_reported_without_a_period_that_cannot_be_set() {
    let mut options = CellOptions::default();
    // Two thirds of the longest period, 40 ms, are 27 ms.
    options.drive.processing_delay = Duration::from_millis(30);
    let served = Served::arm(options);
    let doctor = cubectl(&["doctor", "--bus", &served.spec]);
    let text = out(&doctor);
    assert!(
        text.contains("control period: no controller in this program holds one here, the longest is 40 ms"),
        "{text}"
    );
    assert!(!text.contains("needs "), "{text}");
}

#[test]
fn two_modules_with_one_address_are_found_by_doctor() {
    let served = Served::new(|| {
        let options = CellOptions::default();
        let other = CellOptions {
            drive: hil_sim::drive::DriveOptions {
                processing_delay: Duration::from_micros(900),
                ..options.drive.clone()
            },
            ..options.clone()
        };
        (Cell::bench(2, 0x4614, &options, 1).unwrap(), Cell::bench(1, 0x4614, &other, 2).unwrap())
    });
    let output = cubectl(&["doctor", "--bus", &served.spec]);
    assert_eq!(code(&output), 9, "{}{}", out(&output), err(&output));
    assert!(out(&output).contains("two modules answer at address 1"), "{}", out(&output));
}

#[test]
fn firmware_without_position_and_state_in_one_answer_is_a_finding() {
    let served = Served::new(|| Cell::bench(1, 0x3500, &CellOptions::default(), 1).unwrap());
    let output = cubectl(&["doctor", "--bus", &served.spec]);
    assert_eq!(code(&output), 9, "{}", out(&output));
    assert!(out(&output).contains("firmware 3500 does not report position"), "{}", out(&output));
}

#[test]
fn a_bus_without_drives_and_a_missing_drive_are_reported_apart() {
    let empty = Served::new(Vec::<hil_sim::participants::Solo<protocol_node::Silent>>::new);
    let output = cubectl(&["status", "--bus", &empty.spec]);
    assert_eq!(code(&output), 8);
    assert!(err(&output).contains("no module answers"), "{}", err(&output));
    let two = Served::new(|| Cell::bench(2, 0x4614, &CellOptions::default(), 1).unwrap());
    let output = cubectl(&["doctor", "--bus", &two.spec, "--modules", "1-3"]);
    assert_eq!(code(&output), 9);
    assert!(out(&output).contains("module 3: no answer"), "{}", out(&output));
    // Without a name the robot is a guess: two modules on a bench are no arm with four missing.
    for (robot, ends) in [(&[][..], 0), (&["--robot", "powercube6"][..], 8)] {
        let output = cubectl(&[&["status", "--bus", &two.spec], robot].concat());
        assert_eq!(code(&output), ends, "{}", err(&output));
        assert!(err(&output).contains("modules 3, 4, 5, 6 do not answer"), "{}", err(&output));
    }
}

#[test]
fn buses_that_cannot_be_had_say_what_where_and_what_next() {
    let nobody = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let closed = format!("socketcand://{nobody}/can0");
    for spec in [closed.as_str(), "nosuchcan7", "slcan:/dev/no-such-adapter"] {
        let output = cubectl(&["status", "--bus", spec]);
        assert_eq!(code(&output), 7, "{spec}: {}", err(&output));
        assert!(err(&output).contains("next: "), "{spec}: {}", err(&output));
    }
    let output = cubectl(&["status", "--bus", "socketcand://"]);
    assert!(matches!(code(&output), 2 | 7), "{}", err(&output));
    let output = cubectl(&["status", "--robot", "no-such-robot"]);
    assert_eq!(code(&output), 4);
    assert!(err(&output).contains("powercube6"), "{}", err(&output));
}

/// A node that sends nothing.
mod protocol_node {
    use protocol::{Frame, Instant, Node};

    pub(crate) struct Silent;

    impl Node for Silent {
        fn handle_frame(&mut self, _: Instant, _: &Frame) {}
        fn handle_timeout(&mut self, _: Instant) {}
        fn poll_frame(&mut self) -> Option<Frame> {
            None
        }
        fn poll_timeout(&self) -> Option<Instant> {
            None
        }
    }
}

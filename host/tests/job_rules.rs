//! What every verb that moves metal keeps to: it asks first, it puts back what it changed, and its exit code is what happened.

use std::process::{Command, Stdio};

use operator::bus::BusArgs;
use operator::node::host_node::HostNode;
use protocol::Duration;
use protocol::cyphal::cubecell::group_state::State;

use crate::bus_common::{Folder, Served, code, cubectl, err, out};
use crate::program::cubectl_line;

#[test]
fn without_a_terminal_and_without_yes_no_verb_moves_a_real_arm() {
    // The bus does not exist: it is refused before the bus is opened.
    for words in [
        "throw --target 1,1,-1 --bus nosuchcan7",
        "throw --target 1,1,-1 --bus nosuchcan7 --json",
        "throw --robot kr16_2 --target 2.5,0,0.6 --starts 1 --bus rsi:udp://127.0.0.1:0",
        "throw --robot kr16_2 --target 2.5,0,0.6 --starts 1 --json --bus rsi:udp://127.0.0.1:0",
        "arm identify --joint 2 --bus nosuchcan7",
        "arm identify --bus rsi:udp://127.0.0.1:0",
    ] {
        let refused = cubectl_line(words, &[]);
        assert_eq!(code(&refused), 2, "{words:?}: {}{}", out(&refused), err(&refused));
        assert!(
            err(&refused).contains("nothing has moved") && err(&refused).contains("--yes"),
            "{}",
            err(&refused)
        );
    }
    for (words, next) in [(["jog", "3"], "--for-s"), (["teach", "none.toml"], "in a terminal")] {
        let refused = cubectl(&words);
        assert_eq!(code(&refused), 2, "{}{}", out(&refused), err(&refused));
        let why = err(&refused);
        assert!(why.contains("nothing has moved") && why.contains(next), "{why}");
    }
}

#[test]
fn a_restore_with_save_stores_also_what_is_in_force_already() {
    let folder = Folder::new("rules-save");
    let file = folder.file("arm.toml");
    assert_eq!(code(&cubectl(&["modules", "dump", &file])), 0);
    let recording = folder.file("restore");
    let restored = cubectl(&["modules", "restore", &file, "--save", "--record", &recording]);
    assert_eq!(code(&restored), 0, "{}", err(&restored));
    // The bus is the witness: SAVE_PARAMETERS is 0x10.
    let log = std::fs::read_to_string(folder.file("restore.log")).unwrap();
    let saved =
        (1..=6).filter(|module| log.lines().any(|line| line.contains(&format!(" 0E{module}#10")))).count();
    assert_eq!(saved, 6, "{}", out(&restored));
    assert!(out(&restored).contains("6 modules saved"), "{}", out(&restored));
}

#[test]
fn a_homing_that_ctrl_c_ends_leaves_the_settings_of_the_controller_as_they_were() {
    let served = Served::with_controller();
    let bus = ["--bus", &served.spec];
    let names = ["joint.home_v_rad_s", "home.timeout_us", "cycle.monitor_us"];
    let held = || -> Vec<serde_json::Value> {
        let get = |name| out(&cubectl(&["controller", "registers", "get", name, bus[0], bus[1], "--json"]));
        names.iter().map(|name| serde_json::from_str(&get(*name)).unwrap()).collect()
    };
    let before = held();
    let mut watch = BusArgs { bus: served.spec.parse().unwrap(), ..BusArgs::default() }.open().unwrap();
    let mut home = Command::new(env!("CARGO_BIN_EXE_cubectl"))
        .args(["home", "--verify", "--speed-rad-s", "0.02", "--timeout-s", "50", bus[0], bus[1]])
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    watch.host_node().listen_only();
    let homes = |host_node: &mut HostNode| {
        host_node
            .inbox()
            .and_then(|inbox| inbox.group)
            .is_some_and(|(_, _, group)| group.state == State::Homing)
    };
    let until = watch.now() + Duration::from_secs(600);
    watch.run(until, &mut |host_node| homes(host_node)).unwrap();
    watch.pass(Duration::from_millis(100)).unwrap();
    let killed = Command::new("sh").args(["-c", &format!("kill -INT {}", home.id())]).status();
    assert!(killed.unwrap().success());
    while home.try_wait().unwrap().is_none() {
        watch.pass(Duration::from_millis(20)).unwrap();
    }
    let ended = home.wait_with_output().unwrap();
    assert_eq!(code(&ended), 6, "{}", err(&ended));
    drop(watch);
    assert_eq!(held(), before, "{}", err(&ended));
}

#[test]
fn a_fault_of_a_controller_for_one_module_names_the_joint_of_the_robot() {
    let output = cubectl(&["home", "--modules", "3", "--timeout-s", "1", "--speed-rad-s", "0.01", "--force"]);
    assert_eq!(code(&output), 8, "{}{}", out(&output), err(&output));
    assert!(err(&output).contains("joint 3: ") && !err(&output).contains("joint 1: "), "{}", err(&output));
}

#[test]
fn a_speed_at_which_nothing_can_be_identified_is_refused_and_no_joint_is_called_blocked() {
    let refused = cubectl(&["arm", "identify", "--joint", "2", "--speed-share", "1e-6"]);
    assert_eq!(code(&refused), 2, "{}", err(&refused));
    assert!(err(&refused).contains("must be from 0.02 to 1"), "{}", err(&refused));
}

#[test]
fn the_exit_code_of_a_catch_is_that_of_the_ball() {
    for seed in ["1", "2", "3", "4"] {
        let line = "catch --ball=2.0,0.1,0.2,-2.3,-0.1,3.4 --fault bias:-30 --json --seed";
        let ended = cubectl_line(line, &[seed]);
        let stated: serde_json::Value = serde_json::from_str(&out(&ended)).unwrap();
        // Whoever uses the ball next must know that it is there.
        let known = stated["caught"] == true && stated["reported"] == "caught";
        assert_eq!(code(&ended) == 0, known, "seed {seed}: {}", err(&ended));
        assert_eq!(
            err(&ended).contains("the ball was not caught"),
            stated["caught"] == false,
            "{}",
            err(&ended)
        );
    }
}

#[test]
fn a_scenario_with_a_supply_that_is_not_there_is_refused_before_anything_runs() {
    let folder = Folder::new("rules-supply");
    let scenario = folder.file("scenario.toml");
    let fault = "[[fault]]\nkind = \"supply-loss\"\ntarget = \"supply 200\"\nstart_s = 0.05\n";
    std::fs::write(&scenario, format!("schema_version = 1\nduration_s = 1.0\n{fault}")).unwrap();
    let refused = cubectl(&["home", "--scenario", &scenario]);
    assert_eq!(code(&refused), 4, "{}{}", out(&refused), err(&refused));
    assert!(err(&refused).contains("the robot has no such supply"), "{}", err(&refused));
}

#[test]
fn a_stop_by_another_node_ends_a_throw_with_its_own_code_before_the_ball_is_thrown() {
    let folder = Folder::new("rules-stop");
    let first = folder.file("first");
    let good = cubectl(&["throw", "--target", "1,1,-1", "--starts", "2", "--out", &first]);
    assert_eq!(code(&good), 0, "{}", err(&good));
    let plan = folder.file("first/plan.json");
    // The stop message of node 99, and the halt broadcast: in the start-up, while the drives are found, after homing.
    for (at_s, send) in [
        (0.03, "0063E863#01040000E0"),
        (0.03, "100#02"),
        (0.2, "100#02"),
        (7.36, "0063E863#01040000E0"),
        (7.39, "100#02"),
    ] {
        let scenario = folder.file("stop.toml");
        let action = format!("[[action]]\nat_s = {at_s}\nsend = [\"{send}\"]\n");
        std::fs::write(&scenario, format!("schema_version = 1\nduration_s = 60.0\n{action}")).unwrap();
        let results = folder.file(&format!("stop-{at_s}-{}", send.len()));
        let stopped =
            cubectl(&["throw", "--plan", &plan, "--scenario", &scenario, "--out", &results, "--json"]);
        assert_eq!(code(&stopped), 13, "{send} at {at_s} s: {}", err(&stopped));
        let report: serde_json::Value = serde_json::from_str(&out(&stopped)).unwrap();
        assert_eq!(
            (&report["outcome"], &report["ball"], &report["exit_code"]),
            (&"stopped".into(), &"in_hand".into(), &13.into()),
            "{send} at {at_s} s"
        );
    }
}

#[test]
fn a_recording_of_a_controller_with_another_node_id_is_replayed_bit_for_bit() {
    let folder = Folder::new("rules-replay");
    let bus = BusArgs { record: Some(folder.0.join("boot")), ..BusArgs::default() };
    let cell = bus.cell.load().unwrap();
    let mut settings = operator::bus::period::settings_with_gains(&cell.robot, &cell.setup).unwrap();
    settings.node_id = 12;
    let mut session = bus.open_cell(&cell, Some(&settings)).unwrap();
    session.pass(Duration::from_millis(1_500)).unwrap();
    session.finish().unwrap();
    let replayed = cubectl(&["log", "replay", &folder.file("boot.log"), "--json"]);
    assert_eq!(code(&replayed), 0, "{}{}", out(&replayed), err(&replayed));
}

//! Every verb that touches a bus, on the embedded cell, as people run it.

use crate::bus_common::{Folder, Served, code, cubectl, err, out};
use hil_sim::CellOptions;

fn json(text: &str) -> serde_json::Value {
    serde_json::from_str(text).unwrap()
}

#[test]
fn status_finds_the_six_modules_with_serial_firmware_and_state() {
    let output = cubectl(&["status", "--json"]);
    assert_eq!(code(&output), 0, "{}", err(&output));
    let report = json(&out(&output));
    let modules = report["modules"].as_array().unwrap();
    assert_eq!(modules.len(), 6);
    let mut serials: Vec<u64> = modules.iter().map(|module| module["serial"].as_u64().unwrap()).collect();
    serials.dedup();
    assert_eq!(serials.len(), 6, "serial numbers are different");
    for module in modules {
        assert!(module["unanswered"].as_array().unwrap().is_empty());
        assert!(module["position_rad"].as_f64().unwrap().abs() < 3.2);
    }
    let table = out(&cubectl(&["status"]));
    assert_eq!(table.lines().count(), 8, "{table}");
}

#[test]
fn the_same_seed_gives_the_same_bytes() {
    assert_eq!(cubectl(&["status", "--seed", "7"]).stdout, cubectl(&["status", "--seed", "7"]).stdout);
}

#[test]
fn a_module_that_was_named_but_is_silent_is_an_error_with_the_next_step() {
    let output = cubectl(&["status", "--modules", "1-7"]);
    assert_eq!(code(&output), 8);
    let text = err(&output);
    assert!(text.contains("module 7 does not answer") && text.contains("next: "), "{text}");
}

#[test]
fn a_module_of_the_robot_that_is_silent_is_an_error_after_the_others_are_shown() {
    let folder = Folder::new("silent");
    let scenario = folder.file("silent.toml");
    let silent = "kind = \"silent\"\ntarget = \"module 4\"\nstart_s = 0.0\nlength_s = 100.0\n";
    let text = format!("schema_version = 1\nname = \"silent\"\nduration_s = 1.0\n\n[[fault]]\n{silent}");
    std::fs::write(&scenario, text).unwrap();
    let output = cubectl(&["status", "--scenario", &scenario]);
    assert_eq!(code(&output), 8, "{}", err(&output));
    assert!(out(&output).contains(" 5  ") && !out(&output).contains(" 4  "), "{}", out(&output));
    let text = err(&output);
    assert!(text.contains("module 4 does not answer") && text.contains("robot powercube6 has it"), "{text}");
    assert_eq!(text.matches("next: ").count(), 1, "{text}");
    let reported = json(&out(&cubectl(&["status", "--scenario", &scenario, "--json"])));
    assert_eq!(reported["missing"], serde_json::json!([4]), "{reported:#}");
    let whole = cubectl(&["status", "--json"]);
    assert_eq!(json(&out(&whole))["missing"], serde_json::json!([]));
    assert_eq!((code(&whole), err(&whole)), (0, String::new()));
    let others = cubectl(&["status", "--scenario", &scenario, "--modules", "1-3"]);
    assert_eq!((code(&others), err(&others)), (0, String::new()), "named modules are there");
}

#[test]
fn an_address_where_nobody_is_gives_no_module() {
    let output = cubectl(&["status", "--modules", "20-22"]);
    assert_eq!(code(&output), 8);
    assert!(err(&output).contains("no module answers"), "{}", err(&output));
}

#[test]
fn home_finds_all_zeros_at_reduced_speed_and_leaves_homed_ones_alone() {
    let output = cubectl(&["home", "--json"]);
    assert_eq!(code(&output), 0, "{}", err(&output));
    let report = json(&out(&output));
    let modules = report["modules"].as_array().unwrap();
    assert_eq!(modules.len(), 6);
    for module in modules {
        if module["skipped"].is_null() {
            let took_s = module["took_s"].as_f64().unwrap();
            assert!((0.05..40.0).contains(&took_s), "{module}");
        }
    }
}

#[test]
fn a_homing_that_takes_too_long_is_halted_and_says_so() {
    let output = cubectl(&["home", "--modules", "1", "--timeout-s", "1", "--speed-rad-s", "0.01", "--force"]);
    assert_eq!(code(&output), 8, "{}{}", out(&output), err(&output));
    assert!(err(&output).contains("did not find its zero") && err(&output).contains("halted"));
}

#[test]
fn jog_moves_as_far_as_speed_and_time_say_and_stands_still() {
    let output = cubectl(&["jog", "3", "--for-s", "0.5", "--speed-rad-s", "-0.1", "--json"]);
    assert_eq!(code(&output), 0, "{}", err(&output));
    let report = json(&out(&output));
    let moved = report["to_rad"].as_f64().unwrap() - report["from_rad"].as_f64().unwrap();
    // 0.5 s at 0.1 rad/s, with the ramps: neither nothing nor beyond the horizon.
    assert!((-0.075..-0.035).contains(&moved), "{moved}");
}

#[test]
fn a_module_that_no_joint_of_the_robot_has_is_refused() {
    for words in [&["home", "--modules", "9"][..], &["jog", "9", "--for-s", "1"]] {
        let output = cubectl(words);
        assert_eq!(code(&output), 4, "{}", out(&output));
        assert!(err(&output).contains("module 9 is the drive of no joint"), "{}", err(&output));
    }
}

#[test]
fn a_jog_faster_than_walking_pace_is_refused_by_the_command_line() {
    let output = cubectl(&["jog", "3", "--for-s", "1", "--speed-rad-s", "1.0"]);
    assert_eq!(code(&output), 2);
    assert!(err(&output).contains("at most 0.25 rad/s"), "{}", err(&output));
}

#[test]
fn stop_halts_all_modules() {
    let output = cubectl(&["stop"]);
    assert_eq!(code(&output), 0, "{}", err(&output));
    assert!(out(&output).contains("6 modules answer, 6 of them halted, none moves"), "{}", out(&output));
}

#[test]
fn doctor_finds_nothing_wrong_with_the_nominal_cell() {
    let output = cubectl(&["doctor", "--modules", "1-6", "--probe-29-bit", "--json"]);
    let report = json(&out(&output));
    assert_eq!(code(&output), 0, "{report:#}");
    let findings = report["findings"].as_array().unwrap();
    let checks: Vec<&str> = findings.iter().map(|finding| finding["check"].as_str().unwrap()).collect();
    for check in ["traffic", "modules", "bus errors", "addresses", "29-bit probe", "homing", "watchdog"] {
        assert!(checks.contains(&check), "{check} is missing in {checks:?}");
    }
}

#[test]
fn a_recorded_run_of_the_controller_is_replayed_bit_for_bit_and_a_changed_one_is_not() {
    let folder = Folder::new("replay");
    let path = folder.file("boot");
    let output = cubectl(&["log", "record", &path, "--controller", "--for-s", "1.5"]);
    assert_eq!(code(&output), 0, "{}", err(&output));
    let log = format!("{path}.log");
    let output = cubectl(&["log", "replay", &log, "--json"]);
    assert_eq!(code(&output), 0, "{}{}", out(&output), err(&output));
    let report = json(&out(&output));
    assert!(report["same"].as_u64().unwrap() > 100 && report["identical"] == true, "{report}");
    // One bit of one request of the controller.
    let text = std::fs::read_to_string(&log).unwrap();
    let changed = text.replacen("#0A3C", "#0A3D", 1).replacen("#0A62", "#0A63", 1);
    assert_ne!(text, changed);
    std::fs::write(folder.file("changed.log"), changed).unwrap();
    let output = cubectl(&["log", "replay", &folder.file("changed.log")]);
    assert_eq!(code(&output), 9);
    assert!(err(&output).contains("line ") && err(&output).contains("recorded"), "{}", err(&output));
}

#[test]
fn recordings_are_not_overwritten_and_open_as_mcap() {
    let folder = Folder::new("mcap");
    let path = folder.file("scan");
    assert_eq!(code(&cubectl(&["status", "--record", &path])), 0);
    let again = cubectl(&["status", "--record", &path]);
    assert_eq!(code(&again), 10);
    assert!(err(&again).contains("scan.log"), "{}", err(&again));
    let bytes = std::fs::read(format!("{path}.mcap")).unwrap();
    let mut topics = std::collections::BTreeMap::new();
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        *topics.entry(message.unwrap().channel.topic.clone()).or_insert(0) += 1;
    }
    let lines = std::fs::read_to_string(format!("{path}.log")).unwrap().lines().count();
    let frames_and_errors = topics.get("/bus/frames").unwrap_or(&0) + topics.get("/bus/errors").unwrap_or(&0);
    assert_eq!(frames_and_errors, lines, "{topics:?}");
    assert_eq!(topics.keys().filter(|topic| topic.starts_with("/module/")).count(), 6);
}

#[test]
fn config_is_dumped_compared_and_restored() {
    let folder = Folder::new("config");
    let file = folder.file("arm.toml");
    assert_eq!(code(&cubectl(&["modules", "dump", &file])), 0);
    let same = cubectl(&["modules", "diff", &file]);
    assert_eq!(code(&same), 0, "{}{}", out(&same), err(&same));
    let text = std::fs::read_to_string(&file).unwrap();
    let line = text.lines().find(|line| line.starts_with("MaxVel_rad_per_s")).unwrap();
    std::fs::write(&file, text.replacen(line, "MaxVel_rad_per_s = 0.5", 1)).unwrap();
    let differs = cubectl(&["modules", "diff", &file]);
    assert_eq!(code(&differs), 9);
    assert!(out(&differs).contains("MaxVel_rad_per_s"), "{}", out(&differs));
    let restored = cubectl(&["modules", "restore", &file, "--save"]);
    assert_eq!(code(&restored), 0, "{}", err(&restored));
    assert!(out(&restored).starts_with("1 setting written to 1 module,"), "{}", out(&restored));
    let foreign = folder.file("foreign.toml");
    let serial = text.lines().find(|line| line.starts_with("serial")).unwrap();
    std::fs::write(&foreign, text.replacen(serial, "serial = 1", 1)).unwrap();
    let refused = cubectl(&["modules", "restore", &foreign]);
    assert_eq!(code(&refused), 4);
    assert!(err(&refused).contains("nothing was written"), "{}", err(&refused));
    std::fs::write(&foreign, "schema_version = 1\nmodule = 3\n").unwrap();
    let bad = cubectl(&["modules", "diff", &foreign]);
    assert_eq!(code(&bad), 4);
    assert!(err(&bad).contains("foreign.toml"), "{}", err(&bad));
}

#[test]
fn a_setting_written_as_a_short_decimal_is_restored_read_back_and_equal() {
    let served = Served::arm(CellOptions::default());
    let folder = Folder::new("config-short");
    let (first, second) = (folder.file("first.toml"), folder.file("second.toml"));
    let bus = ["--bus", &served.spec];
    assert_eq!(code(&cubectl(&["modules", "dump", &first, bus[0], bus[1]])), 0);
    let text = std::fs::read_to_string(&first).unwrap();
    let line = text.lines().find(|line| line.starts_with("MaxVel_rad_per_s")).unwrap();
    // 2.1 is not a number of single precision: the module keeps 2.0999999046325684.
    std::fs::write(&first, text.replacen(line, "MaxVel_rad_per_s = 2.1", 1)).unwrap();
    for settings in ["1 setting written to 1 module,", "0 settings written to 0 modules"] {
        let restored = cubectl(&["modules", "restore", &first, bus[0], bus[1]]);
        assert_eq!(code(&restored), 0, "{}", err(&restored));
        assert!(out(&restored).starts_with(settings), "{}", out(&restored));
    }
    let same = cubectl(&["modules", "diff", &first, bus[0], bus[1]]);
    assert_eq!(code(&same), 0, "{}{}", out(&same), err(&same));
    assert_eq!(code(&cubectl(&["modules", "dump", &second, bus[0], bus[1]])), 0);
    let dumped = std::fs::read_to_string(&second).unwrap();
    assert!(dumped.lines().any(|line| line == "MaxVel_rad_per_s = 2.1"), "{dumped}");
    for (key, value) in [("MaxVel_rad_per_s", "nan"), ("MaxVel_rad_per_s", "1e39")] {
        std::fs::write(&second, text.replacen(line, &format!("{key} = {value}"), 1)).unwrap();
        let refused = cubectl(&["modules", "restore", &second, bus[0], bus[1]]);
        assert_eq!(code(&refused), 4, "{value}: {}", err(&refused));
        assert!(err(&refused).contains("is no value of this setting"), "{}", err(&refused));
    }
}

#[test]
fn monitor_in_a_pipe_prints_one_line_per_module_and_period() {
    let output = cubectl(&["arm", "monitor", "--for-s", "0.4", "--period-ms", "200"]);
    assert_eq!(code(&output), 0, "{}", err(&output));
    let text = out(&output);
    assert_eq!(text.lines().count(), 12, "{text}");
    assert!(text.lines().all(|line| line.contains(" q_rad=") && !line.contains('\x1b')));
}

#[test]
fn explain_knows_faults_and_exit_codes() {
    let text = out(&cubectl(&["explain", "502"]));
    assert!(text.contains("HomingFailed") && text.contains("next:"), "{text}");
    assert!(out(&cubectl(&["explain", "exit", "7"])).contains("bus cannot be reached"));
    assert_eq!(code(&cubectl(&["explain", "12345"])), 4);
}

/// With watchdogs that do not stop their drives within the time that the controller waits for it.
#[test]
fn controller_that_ends_with_a_fault_says_so_in_its_exit_code() {
    let run = |options: CellOptions| {
        let served = Served::arm(options);
        cubectl(&["controller", "run", "--bus", &served.spec, "--for", "3"])
    };
    let sound = run(CellOptions::default());
    assert_eq!(code(&sound), 0, "{}{}", out(&sound), err(&sound));
    let mut options = CellOptions::default();
    options.drive.watchdog_timeout = protocol::Duration::from_secs(600);
    let unproven = run(options);
    assert_eq!(code(&unproven), 9, "{}{}", out(&unproven), err(&unproven));
    assert!(
        err(&unproven).contains("ended in the state Fault: WatchdogUnproven (500)"),
        "{}",
        err(&unproven)
    );
}

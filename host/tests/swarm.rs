//! `cubectl swarm`: its exit codes, and what it prints.

use crate::bus_common::{Folder, code, cubectl, err, out};
use serde_json::Value;

#[test]
fn seeds_that_break_no_rule_end_with_code_0_and_leave_no_folder() {
    let folder = Folder::new("swarm-ok");
    let found = folder.file("found");
    let output = cubectl(&["swarm", "--seeds", "4", "--json", "--out", &found]);
    assert_eq!(code(&output), 0, "{}{}", out(&output), err(&output));
    let summary: Value = serde_json::from_str(&out(&output)).unwrap();
    assert_eq!((&summary["seeds"], &summary["wrong"]), (&4.into(), &0.into()), "{summary}");
    assert!(!std::path::Path::new(&found).exists());
}

#[test]
fn one_scenario_is_run_and_judged() {
    let folder = Folder::new("swarm-one");
    let file = folder.file("gripper.toml");
    let text = "schema_version = 1\nname = \"gripper\"\nseed = 1\nduration_s = 60.0\n\n[drive]\nstarts_homed = true\n\n\
                [[fault]]\nkind = \"stuck-gripper\"\nstart_s = 0.0\n";
    std::fs::write(&file, text).unwrap();
    let output = cubectl(&["swarm", "--scenario", &file]);
    let printed = out(&output);
    assert!(printed.contains("told: not released"), "{printed}{}", err(&output));
}

#[test]
fn a_scenario_that_cannot_be_read_and_a_time_without_sense_are_refused() {
    let output = cubectl(&["swarm", "--scenario", "no-such-file.toml"]);
    assert_eq!(code(&output), 4, "{}", err(&output));
    assert_eq!(code(&cubectl(&["swarm", "--for", "10x"])), 2);
}

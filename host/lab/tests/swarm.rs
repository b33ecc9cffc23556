//! `cubelab swarm`: its exit codes, and what it prints.

use serde_json::Value;

use crate::{cubelab, empty_folder};

#[test]
fn seeds_that_break_no_rule_end_with_code_0_and_leave_no_folder() {
    let found = empty_folder("swarm-ok").join("found");
    let output = cubelab(&format!("swarm --seeds 4 --json --out {}", found.display()));
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let summary: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((&summary["seeds"], &summary["wrong"]), (&4.into(), &0.into()), "{summary}");
    assert!(!found.exists());
}

#[test]
fn one_scenario_is_run_and_judged() {
    let file = empty_folder("swarm-one").join("gripper.toml");
    let text = "schema_version = 1\nname = \"gripper\"\nseed = 1\nduration_s = 60.0\n\n[drive]\nstarts_homed = true\n\n\
                [[fault]]\nkind = \"stuck-gripper\"\nstart_s = 0.0\n";
    std::fs::write(&file, text).unwrap();
    let output = cubelab(&format!("swarm --scenario {}", file.display()));
    let printed = String::from_utf8_lossy(&output.stdout);
    assert!(printed.contains("reported: not released"), "{output:?}");
}

#[test]
fn a_scenario_that_cannot_be_read_and_a_time_without_sense_are_refused() {
    for (words, code) in [("swarm --scenario no-such-file.toml", 4), ("swarm --for 10x", 2)] {
        let output = cubelab(words);
        assert_eq!(output.status.code(), Some(code), "{output:?}");
    }
}

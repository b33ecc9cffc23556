//! `cubectl controller registers`: the settings of a controller on a bus. The same controller is asked by another process each time, so
//! what is read was kept.

use crate::bus_common::{Folder, Served, code, cubectl, err, out};
use protocol::cyphal::cubecell::group_state;

fn get(served: &Served, name: &str) -> serde_json::Value {
    let output = cubectl(&["controller", "registers", "get", name, "--bus", &served.spec, "--json"]);
    assert_eq!(code(&output), 0, "{}", err(&output));
    serde_json::from_str::<serde_json::Value>(&out(&output)).unwrap()[name].clone()
}

fn set(served: &Served, words: &[&str]) -> std::process::Output {
    cubectl(&[&["controller", "registers", "set", "--bus", &served.spec], words].concat())
}

#[test]
fn registers_are_listed_read_and_written_with_their_types_and_ranges() {
    let served = Served::with_controller();
    let list = cubectl(&["controller", "registers", "list", "--bus", &served.spec, "--json"]);
    assert_eq!(code(&list), 0, "{}", err(&list));
    let list: serde_json::Value = serde_json::from_str(&out(&list)).unwrap();
    let rows = list["registers"].as_array().unwrap();
    let row = |name: &str| rows.iter().find(|row| row["name"] == name).unwrap();
    for info in firmware::registers::TABLE {
        let row = row(info.name);
        assert_eq!(row["per_joint"], info.per_joint, "{row}");
        assert_eq!(row["value"].is_array(), info.per_joint, "{row}");
        assert!(!row["meaning"].as_str().unwrap().is_empty());
    }
    assert_eq!(row("uavcan.pub.group_state.type")["value"], group_state::TYPE);
    assert_eq!(
        (row("security.key")["value"].as_str(), row("security.keyed")["value"].as_bool()),
        (Some(""), Some(false))
    );
    let text = out(&cubectl(&["controller", "registers", "list", "host.", "--bus", &served.spec]));
    assert!(text.contains("host.timeout_us = 100000") && text.contains("20000 to 500000"), "{text}");

    let written = set(&served, &["telemetry.period_us=50000", "joint.jog_v_rad_s=0.1"]);
    assert_eq!(code(&written), 0, "{}", err(&written));
    assert!(out(&written).contains("2 registers as wanted, 2 of them changed"), "{}", out(&written));
    assert_eq!(get(&served, "telemetry.period_us"), 50_000);
    assert_eq!(get(&served, "joint.jog_v_rad_s"), serde_json::json!([0.1, 0.1, 0.1, 0.1, 0.1, 0.1]));
    let again = set(&served, &["telemetry.period_us=50000"]);
    assert!(out(&again).contains("1 registers as wanted, 0 of them changed"), "{}", out(&again));
}

#[test]
fn a_refused_register_is_named_and_a_malformed_value_changes_nothing() {
    let served = Served::with_controller();
    for (words, exit, part) in [
        // Beyond the limits that the controller was started with.
        (&["joint.v_max_rad_s=9"][..], 8, "joint.v_max_rad_s = [9.0, 9.0, 9.0, 9.0, 9.0, 9.0], it keeps"),
        // A host that is missed later than before needs an unlock.
        (&["host.timeout_us=300000"], 8, "host.timeout_us = 300000, it keeps [100000]"),
        (&["telemetry.period_us=5"], 8, "telemetry.period_us = 5, it keeps [100000]"),
        (&["limits.robot_crc32=1"], 8, "limits.robot_crc32"),
        (&["no.such=1"], 8, "no register no.such"),
        (&["telemetry.period_us=50000", "joint.v_max_rad_s=1,2"], 4, "2 values; it has 6"),
        (&["telemetry.period_us=50000", "host.timeout_us=fast"], 4, "'fast' is no natural number"),
        (&["security.key=1"], 4, "it cannot be written here"),
    ] {
        let output = set(&served, words);
        assert_eq!(code(&output), exit, "{words:?}: {}{}", out(&output), err(&output));
        assert!(err(&output).contains(part), "{words:?}: {}", err(&output));
        assert_eq!(get(&served, "telemetry.period_us"), 100_000, "{words:?}");
    }
}

#[test]
fn an_exported_file_puts_everything_back_in_any_order() {
    let served = Served::with_controller();
    let folder = Folder::new("registers");
    let file = folder.file("arm.toml");
    let export = cubectl(&["controller", "registers", "export", "--bus", &served.spec, "--out", &file]);
    assert_eq!(code(&export), 0, "{}", err(&export));
    let text = std::fs::read_to_string(&file).unwrap();
    assert!(
        text.contains("\"joint.q_min_rad\" = [") && !text.contains("security") && !text.contains("limits."),
        "{text}"
    );
    // Gains void their certificate, limits depend on each other.
    let certificate = get(&served, "gains.certificate_crc32");
    assert_ne!(certificate, 0);
    let other = [
        "joint.k_error_1_s2=-1",
        "joint.jog_v_rad_s=0.05",
        "joint.v_max_rad_s=0.1",
        "cycle.monitor_us=20000",
        "joint.home_v_rad_s=-0.05",
    ];
    let changed = set(&served, &other);
    assert_eq!(code(&changed), 0, "{}", err(&changed));
    assert_eq!(get(&served, "gains.certificate_crc32"), 0);
    assert_ne!(out(&cubectl(&["controller", "registers", "export", "--bus", &served.spec])), text);
    let back = set(&served, &["--file", &file]);
    assert_eq!(code(&back), 0, "{}", err(&back));
    assert_eq!(get(&served, "gains.certificate_crc32"), certificate);
    assert_eq!(out(&cubectl(&["controller", "registers", "export", "--bus", &served.spec])), text);

    for (text, part) in [
        ("schema_version = 2\n[registers]\n", "schema_version is not 1"),
        ("schema_version = 1\n", "no table [registers]"),
        ("schema_version = 1\n[registers]\n\"cycle.period_us\" = \"3\"\n", "must be numbers"),
        ("schema_version = 1\n[registers", "TOML parse error"),
    ] {
        std::fs::write(&file, text).unwrap();
        let refused = set(&served, &["--file", &file]);
        assert_eq!(code(&refused), 4, "{}", out(&refused));
        assert!(err(&refused).contains(part), "{part}: {}", err(&refused));
    }
}

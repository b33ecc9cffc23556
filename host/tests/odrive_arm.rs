//! An arm of six ODrives, driven by the verbs.

use crate::bus_common::{Folder, code, cubectl, err, out};
use serde_json::Value;

const ARM: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../robots/odrive6.toml");

#[test]
fn it_homes_jogs_and_goes_to_a_pose() {
    let homed = cubectl(&["home", "--robot", ARM]);
    assert_eq!(code(&homed), 0, "{}{}", out(&homed), err(&homed));
    let jogged = cubectl(&["jog", "12", "--for-s", "0.5", "--robot", ARM]);
    assert_eq!(code(&jogged), 0, "{}{}", out(&jogged), err(&jogged));
    assert!(out(&jogged).contains("module 12: 0.1000 rad -> 0.1500 rad"), "{}", out(&jogged));
    let moved =
        cubectl(&["move", "--joints", "0.3,0.4,0.5,0,0.2,0", "--home", "--yes", "--json", "--robot", ARM]);
    assert_eq!(code(&moved), 0, "{}{}", out(&moved), err(&moved));
}

#[test]
fn it_follows_the_points_of_a_table() {
    let folder = Folder::new("odrive-run");
    let table = folder.file("way.csv");
    let rows = "t_s,turntable,shoulder,elbow,forearm,wrist,hand rotation\n0,0.1,0.1,0.1,0.1,0.1,0.1\n1,0.3,0.3,0.4,0.1,0.2,0\n2,0.1,0.5,0.2,0,0,0.3\n";
    std::fs::write(&table, rows).unwrap();
    let dir = folder.file("run");
    let ran = cubectl(&["run", &table, "--home", "--yes", "--out", &dir, "--robot", ARM]);
    assert_eq!(code(&ran), 0, "{}{}", out(&ran), err(&ran));
    let text = std::fs::read_to_string(folder.0.join("run/summary.json")).unwrap();
    let summary: Value = serde_json::from_str(&text).unwrap();
    assert_eq!(summary["outcome"], "reached", "{text}");
}

#[test]
fn a_throw_is_refused_because_nothing_opens_the_hand_and_verbs_for_powercubes_say_who_answers() {
    let thrown = cubectl(&["throw", "--target", "0.8,0,0.1", "--robot", ARM]);
    assert_eq!(code(&thrown), 4, "{}{}", out(&thrown), err(&thrown));
    let said = err(&thrown);
    assert!(said.contains("nothing opens the hand of robot odrive6"), "{said}");
    assert!(said.contains("--joints 0,0,0,0,0,0 --home"), "{said}");
    let scanned = cubectl(&["status", "--robot", ARM]);
    assert_eq!(code(&scanned), 8, "{}{}", out(&scanned), err(&scanned));
    assert!(err(&scanned).contains("ODrives"), "{}", err(&scanned));
}

//! Arms of six CANopen servos and of six ODrives, driven by the verbs.

use crate::bus_common::{Folder, code, cubectl, err, out};
use serde_json::Value;

struct Arm {
    name: &'static str,
    file: &'static str,
    /// Address of the fourth drive.
    address: &'static str,
    /// Most that a jog may end beside its order, rad. Without an integral the loop of an ODrive leaves what friction holds: 0.2 mrad.
    jog_off_rad: f64,
    drives: &'static str,
}

const ARMS: [Arm; 2] = [
    Arm {
        name: "canopen6",
        file: concat!(env!("CARGO_MANIFEST_DIR"), "/../robots/canopen6.toml"),
        address: "4",
        jog_off_rad: 4e-5,
        drives: "CANopen servos",
    },
    Arm {
        name: "odrive6",
        file: concat!(env!("CARGO_MANIFEST_DIR"), "/../robots/odrive6.toml"),
        address: "12",
        jog_off_rad: 5e-4,
        drives: "ODrives",
    },
];

#[test]
fn it_homes_jogs_and_goes_to_a_pose() {
    for Arm { file, address, jog_off_rad, .. } in ARMS {
        let homed = cubectl(&["home", "--robot", file]);
        assert_eq!(code(&homed), 0, "{}{}", out(&homed), err(&homed));
        let jogged = cubectl(&["jog", address, "--for-s", "0.5", "--robot", file]);
        assert_eq!(code(&jogged), 0, "{}{}", out(&jogged), err(&jogged));
        let said = out(&jogged);
        let end = said
            .split(&format!("module {address}: 0.1000 rad -> "))
            .nth(1)
            .and_then(|rest| rest.split(' ').next());
        let end_rad: f64 = end.and_then(|text| text.parse().ok()).unwrap_or_else(|| panic!("{said}"));
        assert!((end_rad - 0.15).abs() < jog_off_rad, "{said}");
        let moved = cubectl(&[
            "move",
            "--joints",
            "0.3,0.4,0.5,0,0.2,0",
            "--home",
            "--yes",
            "--json",
            "--robot",
            file,
        ]);
        assert_eq!(code(&moved), 0, "{}{}", out(&moved), err(&moved));
    }
}

#[test]
fn it_follows_the_points_of_a_table() {
    for Arm { name, file, .. } in ARMS {
        let folder = Folder::new(&format!("{name}-run"));
        let table = folder.file("way.csv");
        let rows = "t_s,turntable,shoulder,elbow,forearm,wrist,hand rotation\n0,0.1,0.1,0.1,0.1,0.1,0.1\n1,0.3,0.3,0.4,0.1,0.2,0\n2,0.1,0.5,0.2,0,0,0.3\n";
        std::fs::write(&table, rows).unwrap();
        let dir = folder.file("run");
        let ran = cubectl(&["run", &table, "--home", "--yes", "--out", &dir, "--robot", file]);
        assert_eq!(code(&ran), 0, "{}{}", out(&ran), err(&ran));
        let text = std::fs::read_to_string(folder.0.join("run/summary.json")).unwrap();
        let summary: Value = serde_json::from_str(&text).unwrap();
        assert_eq!(summary["outcome"], "reached", "{text}");
    }
}

#[test]
fn a_throw_is_refused_because_nothing_opens_the_hand_and_verbs_for_powercubes_say_who_answers() {
    for Arm { name, file, drives, .. } in ARMS {
        let thrown = cubectl(&["throw", "--target", "0.8,0,0.1", "--robot", file]);
        assert_eq!(code(&thrown), 4, "{}{}", out(&thrown), err(&thrown));
        let said = err(&thrown);
        assert!(said.contains(&format!("nothing opens the hand of robot {name}")), "{said}");
        assert!(said.contains("--joints 0,0,0,0,0,0 --home"), "{said}");
        let scanned = cubectl(&["status", "--robot", file]);
        assert_eq!(code(&scanned), 8, "{}{}", out(&scanned), err(&scanned));
        assert!(err(&scanned).contains(drives), "{}", err(&scanned));
    }
}

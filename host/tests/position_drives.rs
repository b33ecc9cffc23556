//! Arms of six CANopen servos and of six ODrives, driven by the verbs.

use crate::bus_common::{Folder, Served, code, cubectl, err, out};
use crate::program::cubectl_line;
use crate::side_by_side::interpolating;
use hil_sim::{Cell, CellOptions};
use robot_model::RobotModel;
use serde_json::Value;

struct Arm {
    name: &'static str,
    file: &'static str,
    /// Address of the fourth drive.
    address: &'static str,
    /// Most that a jog may end beside its order, rad. Without an integral the loop of an ODrive leaves what friction holds: 0.2 mrad.
    jog_off_rad: f64,
    drives: &'static str,
    /// Beginning of the line of its file that describes what opens the hand.
    hand: &'static str,
}

const TARGET: &str = "0.75,0.2,0.02";

const ARMS: [Arm; 2] = [
    Arm {
        name: "canopen6",
        file: concat!(env!("CARGO_MANIFEST_DIR"), "/../robots/canopen6.toml"),
        address: "4",
        jog_off_rad: 4e-5,
        drives: "CANopen servos",
        hand: "cia402 = { output_of",
    },
    Arm {
        name: "odrive6",
        file: concat!(env!("CARGO_MANIFEST_DIR"), "/../robots/odrive6.toml"),
        address: "12",
        jog_off_rad: 5e-4,
        drives: "ODrives",
        hand: "odrive = { node = 15",
    },
];

#[test]
fn it_homes_jogs_and_goes_to_a_pose() {
    for Arm { file, address, jog_off_rad, .. } in ARMS {
        let homed = cubectl(&["home", "--robot", file]);
        assert_eq!(code(&homed), 0, "{}{}", out(&homed), err(&homed));
        assert!(!err(&homed).contains("rad/s"), "nothing moves: {}", err(&homed));
        for option in [&["--verify"][..], &["--speed-rad-s", "0.05"], &["--current-share", "0.2"]] {
            let refused = cubectl(&[&["home", "--robot", file], option].concat());
            assert_eq!(code(&refused), 4, "{}{}", out(&refused), err(&refused));
            assert!(err(&refused).contains("do not move to find their zero"), "{}", err(&refused));
        }
        let jogged = cubectl(&["jog", address, "--for-s", "0.5", "--robot", file]);
        assert_eq!(code(&jogged), 0, "{}{}", out(&jogged), err(&jogged));
        let said = out(&jogged);
        let end = said
            .split(&format!("module {address}: 0.1000 rad -> "))
            .nth(1)
            .and_then(|rest| rest.split(' ').next());
        let end_rad: f64 = end.and_then(|text| text.parse().ok()).unwrap_or_else(|| panic!("{said}"));
        assert!((end_rad - 0.15).abs() < jog_off_rad, "{said}");
        let moved = cubectl_line("move --joints 0.3,0.4,0.5,0,0.2,0 --home --yes --json --robot", &[file]);
        assert_eq!(code(&moved), 0, "{}{}", out(&moved), err(&moved));
    }
}

/// The simulated drives are those of the built-in robot file. The program gets a copy of that file with one change.
#[test]
fn each_verb_names_what_in_a_drive_is_not_as_the_robot_file_says() {
    let openarm = concat!(env!("CARGO_MANIFEST_DIR"), "/../robots/openarm7.toml");
    for (file, first, from, to, said) in [
        (
            ARMS[0].file,
            "3",
            "node = 5, counts_per_turn = 655360",
            "node = 5, counts_per_turn = 65536",
            "joint 3: by objects 608F and 6091 the servo counts 655360 in a turn, the settings need 65536 (fault 209)",
        ),
        (
            openarm,
            "1",
            "motor = \"4310\", id = 5",
            "motor = \"4340\", id = 5",
            "joint 5: register 22 of the motor holds 30, the settings need 10 (fault 209)",
        ),
        (
            ARMS[1].file,
            "9",
            "node = 13, version = \"0.6\"",
            "node = 13, version = \"0.5\"",
            "joint 5: the axis has firmware 0.6.10, the settings say 0.5 (fault 209)",
        ),
    ] {
        let robot = RobotModel::load(file).unwrap();
        let folder = Folder::new(&format!("differs-{}", robot.name()));
        let other = folder.file("other.toml");
        let text = std::fs::read_to_string(file).unwrap();
        assert!(text.contains(from));
        std::fs::write(&other, text.replacen(from, to, 1)).unwrap();
        for verb in [&["home"][..], &["jog", first, "--for-s", "0.5"]] {
            let robot = robot.clone();
            let served = Served::new(move || Cell::new(&robot, &CellOptions::default(), 1).unwrap());
            let refused = cubectl(&[verb, &["--robot", &other, "--bus", &served.spec]].concat());
            assert_eq!(code(&refused), 8, "{verb:?}: {}{}", out(&refused), err(&refused));
            assert!(err(&refused).contains(said), "{verb:?}: {}", err(&refused));
        }
    }
}

/// The search for the commutation takes 5 s of the cell's time.
#[test]
fn modules_that_interpolate_go_to_a_pose_and_throw() {
    let folder = Folder::new("canopen6-mode-7");
    let file = interpolating(ARMS[0].file, &folder);
    let moved =
        cubectl(&["move", "--joints", "0.3,0.4,0.5,0,0.2,0", "--home", "--yes", "--json", "--robot", &file]);
    assert_eq!(code(&moved), 0, "{}{}", out(&moved), err(&moved));
    let to = folder.file("throw");
    let words = ["throw", "--target", TARGET, "--period-ms", "3", "--json", "--out", &to, "--robot", &file];
    let thrown = cubectl(&words);
    assert_eq!(code(&thrown), 0, "{}{}", out(&thrown), err(&thrown));
    let summary: Value = serde_json::from_str(&out(&thrown)).unwrap();
    assert_eq!(summary["outcome"], "landed", "{summary}");
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

/// The simulated world says where the ball came down; the largest distance is five times what is measured.
#[test]
fn a_throw_lands_where_the_simulated_ball_comes_down() {
    for Arm { name, file, .. } in ARMS {
        let folder = Folder::new(&format!("{name}-throw"));
        let dir = folder.file("throw");
        let thrown = cubectl(&["throw", "--target", TARGET, "--yes", "--out", &dir, "--robot", file]);
        assert_eq!(code(&thrown), 0, "{}{}", out(&thrown), err(&thrown));
        let text = std::fs::read_to_string(folder.0.join("throw/summary.json")).unwrap();
        let summary: Value = serde_json::from_str(&text).unwrap();
        assert_eq!(summary["outcome"], "landed", "{text}");
        let error_m = summary["landing_error_m"].as_f64().unwrap();
        assert!(error_m < 5e-3, "{name}: {error_m} m");
    }
}

#[test]
fn a_hand_that_sticks_is_not_reported_as_a_throw() {
    for Arm { name, file, .. } in ARMS {
        let folder = Folder::new(&format!("{name}-stuck"));
        let scenario = folder.file("stuck.toml");
        let text = format!(
            "schema_version = 1\nrobot = \"{file}\"\nduration_s = 60\n\n[[fault]]\nkind = \"stuck-gripper\"\ntarget = \"gripper\"\nstart_s = 0\n"
        );
        std::fs::write(&scenario, text).unwrap();
        let dir = folder.file("throw");
        let target = ["throw", "--target", TARGET, "--yes", "--out", &dir, "--robot", file];
        let thrown = cubectl(&[&target[..], &["--scenario", &scenario]].concat());
        assert_eq!(code(&thrown), 12, "{}{}", out(&thrown), err(&thrown));
    }
}

#[test]
fn a_throw_of_an_arm_whose_hand_nothing_opens_is_refused() {
    for Arm { name, file, hand, .. } in ARMS {
        let folder = Folder::new(&format!("{name}-bare"));
        let text = std::fs::read_to_string(file).unwrap();
        let bare: Vec<&str> = text.lines().filter(|line| !line.starts_with(hand)).collect();
        assert_eq!(bare.len() + 1, text.lines().count());
        let bare_file = folder.file("bare.toml");
        std::fs::write(&bare_file, bare.join("\n")).unwrap();
        let thrown = cubectl(&["throw", "--target", TARGET, "--robot", &bare_file]);
        assert_eq!(code(&thrown), 4, "{}{}", out(&thrown), err(&thrown));
        let said = err(&thrown);
        assert!(said.contains(&format!("nothing opens the hand of robot {name}")), "{said}");
        assert!(said.contains("--joints 0,0,0,0,0,0 --home"), "{said}");
    }
}

#[test]
fn verbs_that_ask_powercubes_say_who_answers_and_what_finds_the_drives() {
    let openarm = (concat!(env!("CARGO_MANIFEST_DIR"), "/../robots/openarm7.toml"), "motors with MIT frames");
    let arms = ARMS.iter().map(|arm| (arm.file, arm.drives)).chain([openarm]);
    for (file, drives) in arms {
        for verb in [
            &["arm", "status"][..],
            &["arm", "doctor"],
            &["arm", "monitor"],
            &["arm", "identify", "--joint", "1", "--yes"],
            &["controller", "clear"],
            &["modules", "dump", "-"],
        ] {
            // It asks Damiao motors itself.
            if file == openarm.0 && verb[1] == "doctor" {
                continue;
            }
            let asked = cubectl(&[verb, &["--robot", file]].concat());
            let (text, said) = (out(&asked), err(&asked));
            assert_eq!(code(&asked), 8, "{verb:?}: {text}{said}");
            assert!(said.contains(drives) && said.contains("answer a controller only"), "{verb:?}: {said}");
            assert!(said.contains(&format!("`cubectl home --robot {file}`")), "{verb:?}: {said}");
            assert_eq!(text, "", "{verb:?}: nothing was asked");
        }
        // The next step works.
        let homed = cubectl(&["home", "--robot", file]);
        assert_eq!(code(&homed), 0, "{}{}", out(&homed), err(&homed));
    }
}

#[test]
fn a_recorded_motion_is_replayed_bit_for_bit() {
    let openarm = concat!(env!("CARGO_MANIFEST_DIR"), "/../robots/openarm7.toml");
    let arms = ARMS.map(|arm| (arm.file, "0.3,0.4,0.5,0,0.2,0"));
    for (k, (file, joints)) in arms.into_iter().chain([(openarm, "0.3,0.4,0,0.5,0,0.2,0")]).enumerate() {
        let folder = Folder::new(&format!("position-replay-{k}"));
        let dir = folder.file("a");
        let moved = cubectl(&["move", "--joints", joints, "--home", "--yes", "--robot", file, "--out", &dir]);
        assert_eq!(code(&moved), 0, "{}{}", out(&moved), err(&moved));
        // The robot is that of the plan in the folder.
        let replayed = cubectl(&["log", "replay", &dir]);
        assert_eq!(code(&replayed), 0, "{file}: {}{}", out(&replayed), err(&replayed));
        let same: usize = out(&replayed).split(' ').nth(1).and_then(|word| word.parse().ok()).unwrap();
        assert!((3_000..60_000).contains(&same), "{}", out(&replayed));
    }
}

//! A plan says what a throw does: the way to its start, the cell, the tolerance and the refusals follow from it.

use serde_json::Value;

use crate::bus_common::{Folder, code, cubectl, err, out};

const TARGET: [&str; 2] = ["--target", "1.0,1.0,-1.0"];
/// In the way from the zeros of the joints to the start of the throw; the throw itself passes it.
const POST: [&str; 2] = ["--obstacle", "0.3,0.0,0.6,0.05,0.05,0.05"];

/// A plan with these options, in a file of the folder.
fn planned(folder: &Folder, options: &[&str]) -> String {
    let file = folder.file("plan.json");
    let output = cubectl(&[&["plan", "throw", "--fast", "--out", &file], &TARGET[..], options].concat());
    assert_eq!(code(&output), 0, "{}", err(&output));
    file
}

fn thrown(folder: &Folder, name: &str, words: &[&str]) -> (Value, std::process::Output) {
    let output = cubectl(&[&["throw", "--out", &folder.file(name)], words].concat());
    let summary = std::fs::read_to_string(folder.0.join(name).join("summary.json"));
    (summary.map_or(Value::Null, |text| serde_json::from_str(&text).unwrap()), output)
}

#[test]
fn the_obstacles_of_a_plan_file_bound_the_way_to_its_start_and_back() {
    let folder = Folder::new("plan-obstacles");
    let plan = planned(&folder, &POST);
    let (summary, output) = thrown(&folder, "a", &["--plan", &plan, "--back"]);
    assert_eq!((code(&output), &summary["outcome"]), (0, &Value::from("landed")), "{}", err(&output));
    assert!(
        err(&output)
            .lines()
            .any(|l| l.starts_with("to the start") && l.contains("around what is in the way")),
        "{}",
        err(&output)
    );
}

#[test]
fn the_ball_of_the_cell_flies_through_the_air_of_the_plan() {
    for (name, air) in [("drag", ["--drag-per-m", "0.3"]), ("spin", ["--magnus-rad-s", "0,2,0"])] {
        let folder = Folder::new(name);
        let (summary, output) = thrown(&folder, "a", &["--plan", &planned(&folder, &air)]);
        assert_eq!(code(&output), 0, "{name}: {}", err(&output));
        assert!(summary["landing_error_m"].as_f64().unwrap() < 0.005, "{name}: {summary:#}");
    }
}

#[test]
fn air_that_a_scenario_names_counts_more_than_that_of_the_plan() {
    let folder = Folder::new("scenario-air");
    let scenario = folder.file("air.toml");
    std::fs::write(
        &scenario,
        "schema_version = 1\nname = \"vacuum\"\nduration_s = 60.0\n\n[gripper]\ndrag_1_m = 0.0\n",
    )
    .unwrap();
    let plan = planned(&folder, &["--drag-per-m", "0.3"]);
    assert_eq!(code(&thrown(&folder, "a", &["--plan", &plan, "--scenario", &scenario]).1), 11);
}

#[test]
fn fingers_of_a_plan_file_open_in_the_cell_as_well() {
    let folder = Folder::new("plan-fingers");
    let plan = planned(&folder, &["--finger-release"]);
    let landing = |name: &str, words: &[&str]| {
        let (summary, output) = thrown(&folder, name, words);
        assert_eq!(code(&output), 0, "{}", err(&output));
        summary["landing_error_m"].as_f64().unwrap()
    };
    let with = landing("with", &["--plan", &plan]);
    assert_ne!(with, landing("without", &["--plan", &planned(&folder, &[])]));
}

#[test]
fn a_throw_that_may_touch_the_arm_is_known_from_its_plan_file() {
    let folder = Folder::new("plan-touch");
    let plan = |allowed: &[&str]| {
        let file = folder.file("touch.json");
        let words = ["plan", "throw", "--form", "paper", "--target", "1.0,1.0,-1.0", "--out", &file];
        assert_eq!(code(&cubectl(&[&words[..], allowed].concat())), 0);
        file
    };
    let refused = thrown(&folder, "a", &["--plan", &plan(&[])]).1;
    assert_eq!(code(&refused), 4, "{}", err(&refused));
    assert!(err(&refused).contains("--clean-release false"), "{}", err(&refused));
    let tried = thrown(&folder, "b", &["--plan", &plan(&["--clean-release", "false"])]).1;
    assert_eq!(code(&tried), 11, "{}", err(&tried));
}

#[test]
fn options_of_the_planner_beside_a_plan_file_are_refused_by_name() {
    let folder = Folder::new("plan-and-options");
    let plan = planned(&folder, &[]);
    for words in [&POST[..], &["--starts", "5"], &["--thorough"]] {
        let output = thrown(&folder, "a", &[&["--plan", &plan], words].concat()).1;
        assert_eq!(code(&output), 4, "{words:?}: {}", err(&output));
        assert!(err(&output).contains(words[0]), "{words:?}: {}", err(&output));
    }
}

#[test]
fn a_robot_that_is_led_refuses_what_its_throw_does_not_have() {
    let folder = Folder::new("led-options");
    for words in [
        &["--obstacle", "1,1,1,0.1,0.1,0.1"][..],
        &["--thorough"],
        &["--key-file", "no-such-file"],
        &["--gains", "no-such-file"],
        &["--back"],
    ] {
        let robot = ["--robot", "kr16_2", "--target", "2.5,0,0.6"];
        let output = thrown(&folder, "a", &[&robot[..], words].concat()).1;
        assert_eq!(code(&output), 4, "{words:?}: {}{}", err(&output), out(&output));
        assert!(err(&output).contains(words[0]), "{words:?}: {}", err(&output));
    }
}

#[test]
fn a_false_spread_in_a_plan_file_is_refused_and_widens_no_tolerance() {
    let folder = Folder::new("false-spread");
    let plan = planned(&folder, &[]);
    let whole: Value = serde_json::from_str(&std::fs::read_to_string(&plan).unwrap()).unwrap();
    for (field, value) in [
        ("/landing/covariance_m2/0/0", 1.0),
        ("/landing/mean_m/0", 4.0),
        ("/landing/noise/position_rad", 1.0),
        ("/currents/motor_peak_a/0", -1e9),
        ("/landing/flight_s", -1e9),
    ] {
        let mut reported = whole.clone();
        *reported.pointer_mut(field).unwrap() = value.into();
        std::fs::write(&plan, reported.to_string()).unwrap();
        let checked = cubectl(&["plan", "check", &plan]);
        assert!(matches!(code(&checked), 4 | 5), "{field}: {} {}", code(&checked), out(&checked));
        let (summary, output) = thrown(&folder, "a", &["--plan", &plan]);
        assert!(matches!(code(&output), 4 | 5), "{field}: {} {}", code(&output), summary["text"]);
    }
}

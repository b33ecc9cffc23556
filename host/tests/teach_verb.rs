//! `cubectl teach`: a person types keys at a terminal.

use crate::bus_common::{Folder, Served, code, cubectl, err, out};
use crate::terminal::AtTerminal;

/// What the status line shows.
struct Status {
    joints_deg: Vec<f64>,
    hand_m: Vec<f64>,
}

impl Status {
    fn of(text: &str) -> Self {
        let (before, after) = text.split_once(" deg  hand ").unwrap_or_else(|| panic!("{text}"));
        let numbers = |text: &str| text.split(' ').map(|n| n.parse().unwrap()).collect();
        let joints_deg = numbers(before.rsplit_once("  ").unwrap().1);
        Self { joints_deg, hand_m: numbers(after.split_once(" m  ").unwrap().0) }
    }
}

/// Types a key again and again, once for each status line, until one shows what is wanted.
fn hold(person: &mut AtTerminal, key: &str, wanted: &dyn Fn(&Status) -> bool) {
    loop {
        person.types(key);
        person.sees("\x1b[?7l");
        let line = person.sees("\x1b[?7h");
        if wanted(&Status::of(line.strip_suffix("\x1b[?7h").unwrap())) {
            return;
        }
    }
}

/// The steps of a program that was written: each as its key and its value.
fn steps(path: &str) -> Vec<(String, String)> {
    let file: toml::Table = std::fs::read_to_string(path).unwrap().parse().unwrap();
    let step = |step: &toml::Value| {
        let step = step.as_table().unwrap();
        assert_eq!(step.len(), 1, "{step:?}");
        let (key, value) = step.iter().next().unwrap();
        (key.clone(), value.as_str().map_or_else(|| value.to_string(), str::to_owned))
    };
    file["step"].as_array().unwrap().iter().map(step).collect()
}

fn degrees(step: &(String, String)) -> Vec<f64> {
    assert_eq!(step.0, "joints");
    step.1.split(',').map(|angle| angle.strip_suffix("deg").unwrap().parse().unwrap()).collect()
}

/// A person whose arm in the simulated cell is ready.
fn at_work(words: &[&str]) -> AtTerminal {
    let mut person = AtTerminal::run(&[&["teach"], words].concat());
    person.sees("q end");
    person
}

#[test]
fn steps_that_a_person_saved_with_keys_are_a_program_that_the_arm_does() {
    let folder = Folder::new("teach");
    let path = folder.file("taught.toml");
    let mut person = at_work(&[&path, "--home"]);
    person.types("s");
    person.sees("step 1: move");
    person.types("3");
    hold(&mut person, "+", &|status| status.joints_deg[2] > -85.0);
    person.types("s");
    person.sees("step 2: move");
    assert_eq!(steps(&path).len(), 2, "on the disk as soon as it is saved");
    person.types("cwwu");
    person.sees("step 5 removed");
    // Up with the key for down: the other way round it would stop at the end of its reach.
    person.types("z");
    hold(&mut person, "-", &|status| status.hand_m[2] < 1.27);
    person.types("so");
    person.sees("step 6: gripper open");
    person.types("q");
    let (code_of_it, said, _) = person.ends();
    assert_eq!(code_of_it, 0, "{said}");
    assert!(said.contains("6 steps in ") && said.contains("`cubectl run "), "{said}");

    let steps = steps(&path);
    let names: Vec<&str> = steps.iter().map(|(key, _)| key.as_str()).collect();
    assert_eq!(names, ["joints", "joints", "gripper", "wait_s", "joints", "gripper"]);
    assert_eq!((&*steps[2].1, &*steps[3].1, &*steps[5].1), ("close", "1.0", "open"));
    let [first, second] = [0, 1].map(|k| degrees(&steps[k]));
    for (joint, (from, to)) in first.iter().zip(&second).enumerate() {
        assert!(
            if joint == 2 { *to > -85.0 && *from < -89.0 } else { (from - to).abs() < 0.002 },
            "{second:?}"
        );
    }

    let results = folder.file("out");
    let output = cubectl(&["run", &path, "--home", "--repeat", "2", "--json", "--out", &results]);
    assert_eq!(code(&output), 0, "{}", err(&output));
    let table = std::fs::read_to_string(format!("{results}/cycles.csv")).unwrap();
    let rows: Vec<Vec<&str>> = table.lines().skip(1).map(|line| line.split(',').collect()).collect();
    assert_eq!(rows.len(), 12);
    for row in rows.iter().filter(|row| row[2] == "move") {
        let wanted = degrees(&steps[row[1].parse::<usize>().unwrap() - 1]);
        for (measured, wanted) in row[8..].iter().zip(wanted) {
            assert!((measured.parse::<f64>().unwrap() - wanted.to_radians()).abs() < 3e-3, "{row:?}");
        }
    }
}

#[test]
fn an_industrial_robot_is_led_with_keys_and_does_what_was_saved() {
    let folder = Folder::new("teach-led");
    let path = folder.file("taught.toml");
    let mut person = at_work(&[&path, "--robot", "kr16_2"]);
    person.types("1");
    hold(&mut person, "+", &|status| status.joints_deg[0] > 4.0);
    person.types("s");
    person.sees("step 1: move");
    person.types("z");
    hold(&mut person, "-", &|status| status.joints_deg[1].abs() < 89.0);
    person.types("cs");
    person.sees("step 3: move");
    person.types("q");
    let (code_of_it, said, _) = person.ends();
    assert_eq!(code_of_it, 0, "{said}");
    let steps = steps(&path);
    assert!(degrees(&steps[0])[0] > 4.0, "{steps:?}");
    let results = folder.file("out");
    let output = cubectl(&["run", &path, "--json", "--out", &results]);
    assert_eq!(code(&output), 0, "{}", err(&output));
    let table = std::fs::read_to_string(format!("{results}/cycles.csv")).unwrap();
    let last: Vec<f64> =
        table.lines().last().unwrap().split(',').skip(8).take(6).map(|q| q.parse().unwrap()).collect();
    for (measured, wanted) in last.iter().zip(degrees(&steps[2])) {
        assert!((measured - wanted.to_radians()).abs() < 1e-4, "{last:?}");
    }
}

/// Holds a key until the arm has moved more than `least` from one status line to the next, 0.1 s of the arm's time later.
/// It never moves more than `most`.
fn hold_until_fast(
    person: &mut AtTerminal,
    key: &str,
    [least, most]: [f64; 2],
    place: impl Fn(&Status) -> f64,
) {
    let before = std::cell::Cell::new(None);
    hold(person, key, &|status| {
        let now = place(status);
        let moved = before.replace(Some(now)).map_or(0.0, |before: f64| (now - before).abs());
        assert!(moved < most, "{moved}");
        assert!(now.abs() < 90.0, "so far without being as fast as it is to be");
        moved > least
    });
}

#[test]
fn arm_moves_as_fast_as_the_options_say_and_the_obstacles_are_in_the_program() {
    let folder = Folder::new("teach-fast");
    let path = folder.file("taught.toml");
    let obstacle = "0.5,0,0.1,0.05,0.05,0.05";
    let words = [&path, "--home", "--speed-rad-s", "0.2", "--hand-speed-m-s", "0.1", "--obstacle", obstacle];
    let mut person = at_work(&words);
    // 0.2 rad/s are 1.15 degrees in 0.1 s; the usual speed is half of that.
    hold_until_fast(&mut person, "+", [0.8, 1.3], |status| status.joints_deg[0]);
    person.types("3");
    hold(&mut person, "+", &|status| status.joints_deg[2] > -60.0);
    person.types("z");
    hold_until_fast(&mut person, "-", [0.0065, 0.0115], |status| status.hand_m[2]);
    person.types("sq");
    let (code_of_it, said, shown) = person.ends();
    assert_eq!(code_of_it, 0, "{said}{shown}");
    assert!(
        std::fs::read_to_string(&path).unwrap().contains("obstacles = [[0.5, 0.0, 0.1, 0.05, 0.05, 0.05]]")
    );
}

#[test]
fn ctrl_c_while_a_key_is_held_brings_the_arm_to_rest_and_keeps_what_was_saved() {
    let folder = Folder::new("teach-ctrl-c");
    let path = folder.file("taught.toml");
    let served = Served::with_controller();
    let mut person = at_work(&[&path, "--bus", &served.spec, "--yes"]);
    person.types("s");
    person.sees("step 1: move");
    person.types("6");
    hold(&mut person, "l", &|status| status.joints_deg[5] > 5.0);
    person.interrupts();
    let (code_of_it, said, shown) = person.ends();
    assert_eq!(code_of_it, 6, "{said}{shown}");
    assert!(shown.contains("interrupted; the arm stands") && said.contains("1 step in "), "{said}{shown}");
    assert!(said.contains(&format!("`cubectl run --bus {}", served.spec)), "{said}");
    assert_eq!(steps(&path).len(), 1);

    let seen = || out(&cubectl(&["status", "--bus", &served.spec, "--json"]));
    let positions = |text: &str| -> Vec<f64> {
        let found: serde_json::Value = serde_json::from_str(text).unwrap();
        let modules = found["modules"].as_array().unwrap_or_else(|| panic!("{text}")).clone();
        modules
            .iter()
            .map(|module| module["position_rad"].as_f64().unwrap_or_else(|| panic!("{module}")))
            .collect()
    };
    let (before, after) = (positions(&seen()), positions(&seen()));
    assert!(before[5].to_degrees() > 5.0 && before.len() == 6, "{before:?}");
    assert!(before.iter().zip(&after).all(|(a, b)| (a - b).abs() < 1e-4), "{before:?} {after:?}");
    let moved = cubectl(&["move", "--by", "6=-2deg", "--bus", &served.spec, "--yes"]);
    assert_eq!(code(&moved), 0, "no fault is left: {}", err(&moved));
}

#[test]
fn stop_that_somebody_else_gives_ends_it_while_the_arm_is_led_and_while_it_stands() {
    for led in [true, false] {
        let folder = Folder::new("teach-stop");
        let path = folder.file("taught.toml");
        let served = Served::with_controller();
        let mut person = at_work(&[&path, "--bus", &served.spec, "--yes"]);
        person.types("s");
        person.sees("step 1: move");
        if led {
            hold(&mut person, "+", &|status| status.joints_deg[0] > 2.0);
        }
        assert_eq!(code(&cubectl(&["stop", "--bus", &served.spec])), 0);
        let (code_of_it, said, shown) = person.ends();
        assert_eq!(code_of_it, 13, "{led}: {said}{shown}");
        assert!(said.contains("1 step in ") && shown.contains("next: "), "{said}{shown}");
        assert_eq!(steps(&path).len(), 1);
    }
}

#[test]
fn person_is_asked_before_a_real_arm_is_led() {
    let folder = Folder::new("teach-asks");
    let path = folder.file("taught.toml");
    let served = Served::with_controller();
    for (answer, status) in [("n\n", 6), ("\n", 0)] {
        let mut person = AtTerminal::run(&["teach", &path, "--bus", &served.spec]);
        person.sees("Nobody near?");
        person.types(answer);
        if status == 0 {
            person.sees("q end");
            person.types("sq");
        }
        let (code_of_it, said, shown) = person.ends();
        assert_eq!((code_of_it, said.contains("1 step in ")), (status, status == 0), "{said}{shown}");
    }
}

#[test]
fn step_that_run_would_refuse_is_not_saved_and_the_reason_is_shown() {
    let folder = Folder::new("teach-refused");
    let path = folder.file("taught.toml");
    // Around the hand where it stands after homing.
    let words = [&path, "--home", "--obstacle", "0,0,1.3,0.05,0.05,0.05"];
    let mut person = at_work(&words);
    person.types("suq");
    let (code_of_it, said, shown) = person.ends();
    assert_eq!((code_of_it, said.trim_end()), (0, "no step was saved"), "{shown}");
    let why = shown.split_once("not saved: ").unwrap_or_else(|| panic!("{shown}")).1;
    assert!(
        why.contains("step 1: ") && why.contains("touches something") && why.contains("obstacle 1"),
        "{why}"
    );
    assert!(why.contains("there is no step") && !std::path::Path::new(&path).exists());
    let mut person = at_work(&words);
    person.types("+");
    person.sees("no motion from here: ");
    person.types("q");
    assert_eq!(person.ends().0, 0);
}

#[test]
fn file_that_is_there_or_could_not_be_written_is_refused_before_anything_moves() {
    let folder = Folder::new("teach-there");
    let path = folder.file("taught.toml");
    std::fs::write(&path, "kept").unwrap();
    let other = folder.file("other.toml");
    for (words, status, next) in [
        (&[&*path, "--home"][..], 10, "--force overwrites it"),
        (&[&folder.file("taught.json")], 4, "name it so"),
        (&[&folder.file("none/taught.toml")], 4, "make the folder"),
        (&[&other, "--key-file", &folder.file("none.key")], 4, "none.key"),
        (&[&other, "--controller", "77", "--home"], 8, "no controller is heard"),
        (&[&other, "--speed-rad-s", "0.3"], 2, "at most 0.25 rad/s"),
        (&[&other, "--hand-speed-m-s", "0.3"], 2, "at most 0.25 m/s"),
        (&[&other], 8, "--home"),
    ] {
        let (code_of_it, said, shown) = AtTerminal::run(&[&["teach"], words].concat()).ends();
        assert_eq!(code_of_it, status, "{words:?}: {said}{shown}");
        assert!(shown.contains(next) && !said.contains("steps"), "{said}{shown}");
    }
    assert_eq!(std::fs::read_to_string(&path).unwrap(), "kept");
    let mut person = at_work(&[&path, "--home", "--force", "--speed-share", "0.3"]);
    person.types("sq");
    assert_eq!(person.ends().0, 0);
    assert_eq!(steps(&path).len(), 1);
    assert!(std::fs::read_to_string(&path).unwrap().contains("speed_share = 0.3"));

    // It goes away on the way: what is not in the file is an error at the end.
    std::fs::create_dir(folder.file("gone")).unwrap();
    let mut person = at_work(&[&folder.file("gone/taught.toml"), "--home"]);
    std::fs::remove_dir(folder.file("gone")).unwrap();
    person.types("s");
    person.sees("the file is not written: ");
    person.types("q");
    assert_eq!(person.ends().0, 10);
}

#[test]
fn key_that_moves_nothing_ends_a_jog() {
    let mut person = AtTerminal::run(&["jog", "3"]);
    person.sees("any other key ends");
    person.types("+");
    let said = person.says();
    assert!(said.starts_with("module 3: ") && said.contains(" -> "), "{said}");
    person.types("q");
    let (code_of_it, _, shown) = person.ends();
    assert_eq!(code_of_it, 0, "{shown}");
}

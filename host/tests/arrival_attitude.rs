//! Things that are no balls, from the command line: planned, checked, thrown in the simulated cell, listed, refused.

use serde_json::Value;

use crate::program::{cubectl, empty_folder as folder, text};

/// A throw without nulling from a small search, to a target near the arm.
const QUICK: [&str; 4] = ["--null-delay", "false", "--starts", "8"];
const DISC: [&str; 4] = ["--thing-inertia", "1.8", "--arrival-axis-max-deg", "30"];

#[test]
fn a_disc_with_an_arrival_axis_is_planned_checked_and_seen_to_arrive_so() {
    let folder = folder("arrival-attitude");
    let (out, thrown) = (folder.join("p.json").display().to_string(), folder.join("thrown"));
    let mut words =
        vec!["plan", "throw", "--target", "1.2,0.3,-0.8", "--arrival-axis=0.3,0.1,-1", "--out", &out];
    words.extend(QUICK);
    words.extend(DISC);
    let ended = cubectl(&words);
    assert!(ended.status.success(), "{}", text(&ended.stderr));
    let told = text(&ended.stdout);
    assert!(told.contains("arrives with its axis along") && told.contains("of 30.0 deg off"), "{told}");
    assert!(told.contains("a release 25 ms late or early turns the axis by"), "{told}");
    let checked = cubectl(&["check", &out]);
    assert!(checked.status.success(), "{}", text(&checked.stdout));
    assert!(text(&checked.stdout).contains("arrival axis near its direction"), "{}", text(&checked.stdout));

    // The simulated arm is not the planned one to the last bit: its angle differs, by less than a few degrees.
    let at = thrown.display().to_string();
    let ended = cubectl(&["throw", "--plan", &out, "--yes", "--out", &at]);
    let printed = text(&ended.stdout);
    assert!(printed.contains("it arrived with its axis"), "{printed}{}", text(&ended.stderr));
    let summary = std::fs::read_to_string(thrown.join("summary.json")).expect("reads");
    let summary: Value = serde_json::from_str(&summary).expect("is JSON");
    let seen = &summary["landing"]["attitude"];
    let off_plan = seen["axis_off_plan_deg"].as_f64().expect("it was seen");
    assert!(off_plan > 1e-4 && off_plan < 8.0, "{seen}");
    assert_eq!(seen["axis"]["max_deg"].as_f64().map(f64::round), Some(30.0));
    let report = std::fs::read_to_string(thrown.join("report.html")).expect("reads");
    assert!(report.contains("axis at the arrival, off its direction, observed"));
}

#[test]
fn a_list_may_tell_the_direction_of_each_row() {
    let folder = folder("attitude-list");
    let (list, out) =
        (folder.join("t.csv").display().to_string(), folder.join("r.csv").display().to_string());
    let rows =
        "x_m,y_m,z_m,axis_x,axis_y,axis_z,axis_max_deg\n1.2,0.3,-0.8,0.3,0.1,-1,60\n1.2,0.3,-0.8,0,0,0,60\n";
    std::fs::write(&list, rows).expect("writes");
    let run = |thing: &[&str]| {
        let mut words = vec!["plan", "throw", "--targets", &list, "--out", &out];
        words.extend(QUICK);
        words.extend(thing);
        let ended = cubectl(&words);
        assert!(ended.status.success(), "{}", text(&ended.stderr));
        std::fs::read_to_string(&out).expect("reads")
    };
    let table = run(&["--thing-inertia", "0.02", "--thing-axis", "1,0,0"]);
    let rows: Vec<&str> = table.lines().collect();
    assert!(rows[1].starts_with("1,1.2,0.3,-0.8,thrown"), "{table}");
    assert!(rows[2].contains("refused") && rows[2].contains("arrival axis has no direction"), "{table}");
    std::fs::remove_file(&out).expect("removed");
    let table = run(&[]);
    assert!(table.contains("say with --thing-inertia which"), "{table}");
}

#[test]
fn wishes_that_cannot_be_are_refused_by_name() {
    let refused = |code: u8, words: &[&str], told: &str| {
        let mut all = vec!["plan", "throw", "--target", "1.2,0.3,-0.8"];
        all.extend(words);
        let ended = cubectl(&all);
        let said = text(&ended.stderr);
        assert_eq!(ended.status.code(), Some(i32::from(code)), "{words:?}: {said}");
        assert!(said.contains(told), "{words:?}: {said}");
    };
    let bad = host::exit::BAD_INPUT;
    refused(bad, &["--arrival-axis", "0,0,-1"], "say with --thing-inertia which");
    let disc = ["--thing-inertia", "1.8"];
    refused(bad, &[&disc[..], &["--arrival-axis=0,0,-1", "--form", "paper"]].concat(), "form \"paper\"");
    refused(bad, &[&disc[..], &["--arrival-axis=nan,0,1"]].concat(), "has no direction");
    refused(bad, &["--thing-inertia", "2.5"], "outside 0 to 2");
    let narrow = ["--spin-axis=0,1,0", "--spin-axis-max-deg=-3"];
    refused(bad, &[&disc[..], &narrow].concat(), "largest angle to the spin axis");
    let fast = ["--spin-axis=0,1,0", "--spin-min-rad-s", "60"];
    let quick = [&disc[..], &fast, &QUICK].concat();
    refused(host::exit::NO_THROW, &quick, "with the attitude asked for");
}

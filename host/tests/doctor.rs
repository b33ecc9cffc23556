//! What `cubectl doctor` says of a cell with a fault that the scenario knows.

use crate::bus_common::{Folder, code, cubectl, err, out};

/// Exit code and findings of a doctor in a cell with this fault.
fn doctor(folder: &Folder, fault: &str) -> (i32, Vec<serde_json::Value>, String) {
    let scenario = folder.file("scenario.toml");
    std::fs::write(&scenario, format!("schema_version = 1\nname = \"f\"\nduration_s = 60.0\n{fault}"))
        .unwrap();
    let text = cubectl(&["doctor", "--scenario", &scenario]);
    let output = cubectl(&["doctor", "--scenario", &scenario, "--json"]);
    println!("{}{}", out(&text), err(&text));
    assert_eq!(code(&output), code(&text));
    let report: serde_json::Value = serde_json::from_str(&out(&output)).unwrap();
    (code(&output), report["findings"].as_array().unwrap().clone(), out(&text))
}

fn problems<'a>(findings: &'a [serde_json::Value], check: &str) -> Vec<&'a serde_json::Value> {
    findings.iter().filter(|f| f["level"] == "PROBLEM" && f["check"] == check).collect()
}

#[test]
fn a_silent_module_of_the_robot_is_a_problem_without_naming_it() {
    let folder = Folder::new("doctor-silent");
    let (code, findings, text) = doctor(&folder, "[[fault]]\nkind = \"silent\"\ntarget = \"module 3\"\n");
    assert_eq!(code, 9);
    let found = problems(&findings, "modules");
    assert_eq!(found.len(), 1, "{findings:#?}");
    assert_eq!(found[0]["modules"], serde_json::json!([3]));
    assert!(text.contains("module 3: no answer") && text.contains("robot powercube6 has it"), "{text}");
}

#[test]
fn a_fifth_of_all_frames_lost_is_a_problem_of_every_module_with_its_share() {
    let folder = Folder::new("doctor-loss");
    let fault = "[[fault]]\nkind = \"drop\"\ntarget = \"bus\"\nprobability = 0.2\n";
    let (code, findings, _) = doctor(&folder, fault);
    assert_eq!(code, 9);
    // One whose three first answers are lost by chance is told as silent.
    let named: Vec<u64> = ["lost answers", "modules"]
        .iter()
        .flat_map(|check| problems(&findings, check))
        .flat_map(|f| f["modules"].as_array().unwrap().iter().map(|m| m.as_u64().unwrap()))
        .collect();
    assert!((1..=6).all(|module| named.contains(&module)), "{findings:#?}");
    let [found] = problems(&findings, "lost answers")[..] else { panic!("one finding: {findings:#?}") };
    let (counts, _) = found["what"].as_str().unwrap().split_once(" of 200 ").unwrap();
    let counts: Vec<f64> = counts.split(", ").map(|count| count.parse().unwrap()).collect();
    assert!(counts.len() >= 4 && counts.len() == found["modules"].as_array().unwrap().len(), "{found}");
    for lost in counts {
        // Question or answer is lost: 36 % of 200, with six standard deviations of 6.8.
        assert!((72.0 - 41.0..72.0 + 41.0).contains(&lost), "{found}");
    }
}

#[test]
fn a_plug_that_loses_contact_now_and_then_is_a_problem_of_its_module_alone() {
    let folder = Folder::new("doctor-plug");
    let fault =
        "[[fault]]\nkind = \"intermittent\"\ntarget = \"module 4\"\non_mean_s = 0.3\noff_mean_s = 0.03\n";
    let (code, findings, _) = doctor(&folder, fault);
    assert_eq!(code, 9);
    let found = problems(&findings, "lost answers");
    assert_eq!(found.len(), 1, "{findings:#?}");
    assert_eq!(found[0]["modules"], serde_json::json!([4]));
}

#[test]
fn equal_findings_of_the_six_modules_are_one_line() {
    let folder = Folder::new("doctor-grouped");
    let (code, findings, text) = doctor(&folder, "");
    assert_eq!(code, 0, "{text}");
    let homing: Vec<_> = findings.iter().filter(|f| f["check"] == "homing").collect();
    assert_eq!(homing.len(), 1, "{findings:#?}");
    assert_eq!(homing[0]["modules"], serde_json::json!([1, 2, 3, 4, 5, 6]));
    assert!(text.contains("homing: modules 1-6: not homed"), "{text}");
}

#[test]
fn words_of_a_state_are_explained_and_the_clear_that_is_advised_resets_the_module() {
    let folder = Folder::new("doctor-error");
    let fault = "[[fault]]\nkind = \"over-current\"\ntarget = \"module 2\"\nlength_s = 0.1\n";
    let (code, findings, text) = doctor(&folder, fault);
    assert_eq!(code, 9, "{text}");
    let found = problems(&findings, "state");
    assert_eq!(found[0]["modules"], serde_json::json!([2]), "{findings:#?}");
    for word in found[0]["what"].as_str().unwrap().split('|') {
        let explained = cubectl(&["explain", word]);
        assert_eq!(crate::bus_common::code(&explained), 0, "{word}: {}", err(&explained));
        assert!(out(&explained).contains("next: "), "{}", out(&explained));
    }
    // Halted modules: what doctor advises works.
    let served = crate::bus_common::Served::arm(hil_sim::CellOptions::default());
    let bus = ["--bus", &served.spec];
    assert_eq!(crate::bus_common::code(&cubectl(&["stop", bus[0], bus[1]])), 0);
    let halted = cubectl(&["doctor", bus[0], bus[1]]);
    assert!(
        out(&halted).contains("modules 1-6: halted") && out(&halted).contains("`cubectl clear`"),
        "{}",
        out(&halted)
    );
    let cleared = cubectl(&["clear", bus[0], bus[1]]);
    assert!(out(&cleared).contains("6 of them reset"), "{}{}", out(&cleared), err(&cleared));
    assert!(!out(&cubectl(&["doctor", bus[0], bus[1]])).contains("halted"));
}

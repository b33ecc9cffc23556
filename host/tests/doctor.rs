//! What `cubectl doctor` says of a cell with a fault that the scenario knows.

use crate::bus_common::{Folder, Served, code, cubectl, err, out};
use hil_sim::scenario::fault_from_line;

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
    // One whose first answers are lost is there all the same.
    assert_eq!(problems(&findings, "modules"), Vec::<&serde_json::Value>::new());
    let [found] = problems(&findings, "lost answers")[..] else { panic!("one finding: {findings:#?}") };
    let (counts, _) = found["what"].as_str().unwrap().split_once(" of 200 ").unwrap();
    let counts: Vec<f64> = counts.split(", ").map(|count| count.parse().unwrap()).collect();
    assert_eq!((counts.len(), &found["modules"]), (6, &serde_json::json!([1, 2, 3, 4, 5, 6])), "{found}");
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
    let served = Served::arm(hil_sim::CellOptions::default());
    let bus = ["--bus", &served.spec];
    assert_eq!(crate::bus_common::code(&cubectl(&["stop", bus[0], bus[1]])), 0);
    let halted = cubectl(&["doctor", bus[0], bus[1]]);
    assert!(
        out(&halted).contains("modules 1-6: halted")
            && out(&halted).contains(&format!("`cubectl controller clear --bus {}`", served.spec)),
        "{}",
        out(&halted)
    );
    let cleared = cubectl(&["controller", "clear", bus[0], bus[1]]);
    assert!(out(&cleared).contains("6 of them reset"), "{}{}", out(&cleared), err(&cleared));
    assert!(!out(&cubectl(&["doctor", bus[0], bus[1]])).contains("halted"));
}

#[test]
fn beside_a_controller_the_doctor_tells_its_fault_and_the_modules_that_are_not_heard() {
    let silent = "kind = \"silent\", target = \"module 3\", start_s = 1.0, length_s = 3.0";
    let served = Served::with_controller_and_faults(vec![fault_from_line(silent, 0).unwrap()]);
    let bus = ["--bus", &served.spec];
    assert_eq!(code(&cubectl(&["arm", "monitor", "--for-s", "2", bus[0], bus[1]])), 0);
    let ill = cubectl(&["doctor", bus[0], bus[1]]);
    let text = out(&ill);
    assert_eq!(code(&ill), 9, "{text}");
    for part in ["PROBLEM  controller: controller 10: fault, ", "PROBLEM  modules: module 3: not heard"] {
        assert!(text.contains(part), "{part}: {text}");
    }
    let clear = format!("`cubectl controller clear --bus {}`", served.spec);
    assert!(text.contains(&clear), "{text}");
    // With the plug in again, what is advised works.
    assert_eq!(code(&cubectl(&["arm", "monitor", "--for-s", "2", bus[0], bus[1]])), 0);
    let cleared = cubectl(&["controller", "clear", bus[0], bus[1]]);
    assert_eq!(code(&cleared), 0, "{}{}", out(&cleared), err(&cleared));
    let well = cubectl(&["doctor", bus[0], bus[1]]);
    assert_eq!(code(&well), 0, "{}", out(&well));
    assert!(out(&well).contains("6 heard: 1, 2, 3, 4, 5, 6"), "{}", out(&well));
}

#[test]
fn questions_that_collide_with_those_of_a_controller_are_no_fault_of_the_cable() {
    let served = Served::with_controller();
    let asked = cubectl(&["doctor", "--beside", "--bus", &served.spec]);
    let text = out(&asked);
    assert!(!text.contains("PROBLEM  bus errors") && !text.contains("PROBLEM  addresses"), "{text}");
    assert!(text.contains("addresses: not looked at"), "{text}");
}

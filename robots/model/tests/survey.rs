//! What is missing, assumed or implausible in a robot file is named with its line.

use robot_model::survey::{Finding, Weight, survey};
use robot_model::urdf::{UrdfOptions, robot_file_from_urdf};
use robot_model::{built_in_robots, built_in_text};

fn of(text: &str) -> Vec<Finding> {
    survey("x.toml", text).expect("TOML")
}

fn powercube6() -> String {
    built_in_text("powercube6").expect("built in").to_owned()
}

/// The text with the first occurrence replaced, and the line at which the replacement stands.
fn changed(text: &str, from: &str, to: &str) -> (String, usize) {
    let at = text.find(from).expect("it is there");
    (text.replacen(from, to, 1), text[..at].lines().count() + usize::from(text[..at].ends_with('\n')))
}

#[test]
fn nothing_is_found_in_the_built_in_robots_but_what_their_papers_print() {
    for name in built_in_robots() {
        let findings = of(built_in_text(name).expect("built in"));
        assert!(findings.iter().all(|f| f.weight != Weight::Error), "{name}: {findings:#?}");
    }
    assert_eq!(of(&powercube6()), []);
}

#[test]
fn every_missing_key_is_named_with_the_line_of_its_table_and_a_source() {
    let text = powercube6()
        .replace("velocity_max_deg_s = 149\n", "")
        .replace("ball_radius_m", "# ball_radius_m")
        .replace("floor_z_m = -1.0\n", "");
    let findings = of(&text);
    let missing: Vec<(&str, &str)> = findings.iter().map(|f| (f.key.as_str(), f.what.as_str())).collect();
    for key in ["world.floor_z_m", "joint[0].velocity_max_deg_s", "gripper.ball_radius_m"] {
        assert!(missing.contains(&(key, "missing")), "{key} in {missing:?}");
    }
    assert!(findings.iter().all(|f| f.weight == Weight::Error && f.line.is_some() && !f.next.is_empty()));
    let table = text.lines().position(|line| line == "[world]").expect("a table") + 1;
    let world = findings.iter().find(|f| f.key == "world.floor_z_m").expect("found");
    assert_eq!(world.line, Some(table));
}

#[test]
fn values_in_a_wrong_unit_are_implausible_at_their_line() {
    let table = [
        (
            "acceleration_max_deg_s2 = 596",
            "acceleration_max_deg_s2 = 10.4",
            "acceleration_max_deg_s2",
            "top speed after",
        ),
        ("jerk_max_deg_s3 = 5960", "jerk_max_deg_s3 = 104", "jerk_max_deg_s3", "full acceleration after"),
        (
            "torque_max_nm = 206\n\n[joint.drive]\nmodule = \"PR-090\"\naddress = 2",
            "torque_max_nm = 2.06\n\n[joint.drive]\nmodule = \"PR-090\"\naddress = 2",
            "torque_max_nm",
            "do not hold the arm up",
        ),
        ("gravity_m_s2 = 9.81", "gravity_m_s2 = 981", "gravity_m_s2", "not the gravity"),
    ];
    for (from, to, key, what) in table {
        let (text, line) = changed(&powercube6(), from, to);
        let found = of(&text);
        let hit = found.iter().find(|f| f.key.ends_with(key)).unwrap_or_else(|| panic!("{key}: {found:#?}"));
        assert_eq!((hit.weight, hit.line), (Weight::Implausible, Some(line)), "{found:#?}");
        assert!(hit.what.contains(what), "{}", hit.what);
    }
}

#[test]
fn boxes_that_touch_at_zero_are_named() {
    let (text, line) = changed(&powercube6(), "link_distance_min = 2", "link_distance_min = 1");
    let found = of(&text);
    let hit = found.iter().find(|f| f.key == "collision.link_distance_min").expect("neighbours overlap");
    assert_eq!((hit.weight, hit.line), (Weight::Implausible, Some(line)));
    assert!(hit.what.contains(" touches "), "{}", hit.what);
}

#[test]
fn a_value_the_loader_refuses_is_an_error_with_its_line() {
    let (text, line) = changed(&powercube6(), "range_deg = [-180, 180]", "range_deg = [180, -180]");
    let found = of(&text);
    assert_eq!((found.len(), found[0].weight, found[0].line), (1, Weight::Error, Some(line)), "{found:?}");
    assert!(found[0].what.contains("limits reversed"), "{}", found[0].what);
}

#[test]
fn what_urdf_does_not_say_is_marked_in_the_imported_file_until_the_mark_is_removed() {
    let urdf = include_str!("../../../docs/robots/arm.urdf");
    let options =
        UrdfOptions { end_effector: Some("tool".to_owned()), floor_z_m: Some(-0.8), ..UrdfOptions::default() };
    let made = robot_file_from_urdf("arm.urdf", urdf, &options).expect("a serial arm");
    let found = of(&made.toml);
    let assumed: Vec<&str> =
        found.iter().filter(|f| f.weight == Weight::Assumed).map(|f| f.key.as_str()).collect();
    assert_eq!(assumed.iter().filter(|key| **key == "acceleration_max_deg_s2").count(), 6);
    assert_eq!(assumed.iter().filter(|key| **key == "jerk_max_deg_s3").count(), 6);
    for key in ["release_z_axis", "release_origin_m", "ball_radius_m", "ball_mass_kg"] {
        assert!(assumed.contains(&key), "{key} in {assumed:?}");
    }
    assert!(found.iter().all(|f| f.weight == Weight::Assumed), "{found:#?}");
    assert_eq!(of(&made.toml.replace("# assumed:", "# looked up:")), []);
}

#[test]
fn the_robot_file_of_the_tutorial_has_nothing_left_to_look_at() {
    assert_eq!(of(include_str!("../../../docs/robots/arm.toml")), []);
}

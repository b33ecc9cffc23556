//! What is missing, assumed or implausible in a robot file is named with its line.

use robot_model::survey::{Finding, Weight, survey};
use robot_model::urdf::{UrdfOptions, robot_file_from_urdf};
use robot_model::uses::{Use, missing};
use robot_model::{RobotModel, built_in_robots, built_in_text};

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
fn a_first_joint_that_does_not_hold_the_arm_up_is_named_where_its_axis_is_level() {
    let upright = include_str!("../../../docs/robots/arm.toml");
    let weak = upright.replacen("torque_max_nm = 150.0", "torque_max_nm = 20.0", 1);
    let held = |text: &str| {
        !of(text).iter().any(|f| f.key.starts_with("joint[0]") && f.what.contains("hold the arm up"))
    };
    assert!(held(&weak), "gravity does not turn an upright axis");
    // The whole arm hangs from the axis where it is at zero, and stands out at a right angle.
    let level = weak.replacen("rpy_deg = [0.0, 0.0, 0.0]", "rpy_deg = [0.0, 90.0, 0.0]", 1);
    assert!(!held(&level));
    assert!(held(&level.replacen("torque_max_nm = 20.0", "torque_max_nm = 150.0", 1)));
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
    let options = UrdfOptions {
        end_effector: Some("tool".to_owned()),
        floor_z_m: Some(-0.8),
        ..UrdfOptions::default()
    };
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

const ARM: &str = include_str!("../../../docs/robots/arm.toml");

/// By hand from the page of robot files: 150 Nm at 180 °/s from 48 V are 9.8 A.
#[test]
fn generic_drives_follow_from_speed_and_torque_and_stand_alone() {
    let arm = RobotModel::from_toml("arm.toml", ARM).expect("the tutorial's arm");
    let drives = arm.drives().expect("generic ones");
    for (joint, drive) in arm.joints().iter().zip(drives) {
        let (v, nm) = (joint.limits.v_max_rad_s, joint.limits.torque_max_nm.expect("given"));
        assert!((drive.current_max_a - (v * nm / 48.0).max(1.0)).abs() < 1e-9, "{drive:?}");
        assert!((drive.k_m_a_nm * nm - drive.current_max_a).abs() < 1e-9, "at rest all of the torque");
        assert!((drive.k_b_a_s_rad * v - 0.25 * drive.current_max_a).abs() < 1e-9, "0.8 at top speed");
        assert!((drive.gear_ratio * v - 314.0).abs() < 1e-9);
    }
    assert!((drives[0].current_max_a - 9.8).abs() < 0.05);
    let [supply] = arm.supplies() else { panic!("{:?}", arm.supplies()) };
    assert!(supply.feeds.iter().all(|fed| *fed) && supply.voltage_v == 48.0);
    let refused = |text: &str| RobotModel::from_toml("arm.toml", text).expect_err("refused").to_string();
    let supply = "[[supply]]\nname = \"s\"\nvoltage_v = 24\ncurrent_max_a = 9\njoints = []\n\n[end_effector]";
    assert!(refused(&ARM.replace("[end_effector]", supply)).contains("[[supply]]"));
    let bare = ARM.replacen("torque_max_nm", "# torque_max_nm", 1);
    assert!(refused(&bare).contains("no torque_max_nm"), "{}", refused(&bare));
}

#[test]
fn links_are_left_out_of_the_tests_by_name() {
    let with =
        |pairs: &str| ARM.replace("floor_from_link = 2", &format!("floor_from_link = 2\nuntested = {pairs}"));
    let model = |text: &str| RobotModel::from_toml("arm.toml", text);
    let (all, fewer) =
        (model(ARM).unwrap(), model(&with("[[\"base\", \"hand\"], [\"hand\", \"forearm\"]]")).unwrap());
    assert_eq!(all.collision().pairs().len(), fewer.collision().pairs().len() + 2);
    let rule = fewer.collision().rule();
    assert!(
        !rule.tests(0, 6) && !rule.tests(6, 0) && !rule.tests(3, 6) && rule.tests(2, 6) && !rule.tests(2, 3)
    );
    assert!(model(&with("[[\"base\", \"foot\"]]")).unwrap_err().to_string().contains("no link `foot`"));
    assert!(model(&with("[[\"base\"]]")).unwrap_err().to_string().contains("the names of two links"));
}

#[test]
fn each_use_names_what_it_lacks() {
    let lacks =
        |text: &str| missing(&RobotModel::from_toml("x.toml", text).unwrap(), "x.toml", text).unwrap();
    assert_eq!(lacks(&powercube6()), []);
    let of_arm = lacks(ARM);
    assert!(of_arm.iter().all(|m| m.purpose == Use::RealBus), "{of_arm:#?}");
    assert_eq!(of_arm.len(), 7, "six drives and a supply");
}

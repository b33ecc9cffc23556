//! An arm of ODrives.

use robot_model::survey::{Weight, survey};
use robot_model::uses::missing;
use robot_model::{LoadError, OdriveEndpoints, Problem, RobotModel};

const TEXT: &str = include_str!("../../odrive6.toml");

fn arm() -> RobotModel {
    RobotModel::from_toml("odrive6.toml", TEXT).expect("the file is read")
}

/// The error of the file with the first occurrence of `from` replaced.
fn refused(from: &str, to: &str) -> LoadError {
    assert!(TEXT.contains(from), "`{from}` is not in the file");
    RobotModel::from_toml("arm.toml", &TEXT.replacen(from, to, 1)).expect_err(to)
}

#[test]
fn nothing_is_implausible_or_missing_to_plan_to_simulate_or_on_a_real_bus() {
    let findings = survey("odrive6.toml", TEXT).expect("TOML");
    let wrong: Vec<_> = findings.iter().filter(|f| f.weight != Weight::Assumed).collect();
    assert!(wrong.is_empty(), "{wrong:#?}");
    let missing = missing(&arm(), "odrive6.toml", TEXT).expect("TOML");
    assert!(missing.is_empty(), "{missing:?}");
}

#[test]
fn the_arm_weighs_6_kg_and_holds_itself_with_half_of_its_currents() {
    let arm = arm();
    let mass_kg: f64 = arm.links().iter().map(|link| link.inertia.mass_kg()).sum();
    assert!((mass_kg - 6.0).abs() < 0.01, "{mass_kg}");
    let axes = &arm.odrive_axes().expect("axes").axes;
    for (held_nm, axis) in arm.holding_torques().iter().zip(axes) {
        assert!(*held_nm <= 0.5 * axis.torque_max_nm(), "{held_nm} {axis:?}");
    }
    assert_eq!(arm.addresses(), Some(vec![9, 10, 11, 12, 13, 14]));
}

#[test]
fn every_mistake_in_an_axis_is_named_with_its_key() {
    for (from, to, key, message) in [
        ("node = 11", "node = 10", "joint[2].odrive.node", "node 10 already belongs to shoulder"),
        ("node = 9", "node = 32", "joint[0].odrive.node", "32"),
        ("version = \"0.6\"", "version = \"0.4\"", "joint[0].odrive.version", "0.5"),
        ("encoder = \"joint\"", "encoder = \"none\"", "joint[0].odrive.encoder", "motor"),
        ("velocity_gain_nm_s = 12.6, ", "", "joint[0].odrive.velocity_gain_nm_s", "missing"),
        ("position_gain_1_s = 30", "position_gain_1_s = 0", "joint[0].odrive.position_gain_1_s", "0"),
        ("brake = true, ", "", "joint[0].odrive.brake", "missing"),
    ] {
        let error = refused(from, to);
        assert_eq!(error.key, key, "{error}");
        assert!(error.to_string().contains(message), "{error}");
    }
}

#[test]
fn every_mistake_in_the_axis_of_the_hand_is_named_with_its_key() {
    let fingers = "closed_deg = 0 }";
    for (from, to, key, message) in [
        ("node = 15", "node = 12", "gripper.odrive.node", "node 12 already belongs to forearm"),
        (
            "gear_ratio = 8, encoder = \"joint\"",
            "gear_ratio = 8, encoder = \"motor\"",
            "gripper.odrive.encoder",
            "forgets its turns",
        ),
        ("rotor_kg_m2 = 0.003", "rotor_kg_m2 = 0", "gripper.odrive.rotor_kg_m2", "0"),
        (fingers, "closed_deg = -60 }", "gripper.odrive.open_deg", "same angle"),
        (fingers, "}", "gripper.odrive.closed_deg", "missing"),
    ] {
        let error = refused(from, to);
        assert_eq!(error.key, key, "{error}");
        assert!(error.to_string().contains(message), "{error}");
    }
}

#[test]
fn endpoints_belong_to_one_firmware_and_every_mistake_in_them_is_named_with_its_key() {
    let table = "[odrive_endpoints]\nfirmware = \"0.6.10\"\nencoder_msg_rate_ms = 210\ninput_vel_scale = 211\ninput_torque_scale = 212\n\
                 watchdog_timeout = 300\nenable_watchdog = 301\ncontrol_mode = 402\ninput_mode = 403\n\n[gripper]\n";
    let read = |from: &str, to: &str| {
        let text = TEXT.replacen("[gripper]\n", table, 1);
        assert!(text.contains(from), "`{from}` is not in the file");
        RobotModel::from_toml("arm.toml", &text.replacen(from, to, 1))
    };
    let endpoints = read("210", "65535").expect("it is read").odrive_axes().expect("axes").endpoints;
    let OdriveEndpoints { firmware, numbers } = endpoints.expect("endpoints");
    assert_eq!((firmware, numbers), ([0, 6, 10], [65_535, 211, 212, 300, 301, 402, 403]));
    assert_eq!(arm().odrive_axes().expect("axes").endpoints, None);
    assert_eq!(
        arm().motors_text(),
        read("210", "220").expect("it is read").motors_text(),
        "no motion changes"
    );
    for (from, to, key, message) in [
        ("0.6.10", "0.5.6", "odrive_endpoints.firmware", "0.6.10"),
        ("0.6.10", "0.6", "odrive_endpoints.firmware", "0.6.10"),
        ("= 211", "= 0", "odrive_endpoints.input_vel_scale", "65535"),
        (
            "= 212",
            "= 211",
            "odrive_endpoints.input_torque_scale",
            "endpoint 211 already belongs to input_vel_scale",
        ),
        ("control_mode = 402\n", "", "odrive_endpoints.control_mode", "missing"),
        ("input_mode = 403", "input_mode = 403\nvel_limit = 404", "odrive_endpoints.vel_limit", "unknown"),
        ("version = \"0.6\"", "version = \"0.5\"", "odrive_endpoints", "leave the table out"),
    ] {
        let error = read(from, to).expect_err(to);
        assert_eq!(error.key, key, "{error}");
        assert!(error.to_string().contains(message), "{error}");
    }
    let elsewhere = table.replace("[gripper]\n", "[world]\n");
    let text = include_str!("../../canopen6.toml").replacen("[world]\n", &elsewhere, 1);
    assert_eq!(RobotModel::from_toml("arm.toml", &text).expect_err("servos").key, "odrive_endpoints");
}

#[test]
fn the_hand_opens_within_the_time_that_its_current_and_its_gains_allow() {
    let arm = arm();
    let gripper = arm.odrive_axes().expect("axes").gripper.expect("a hand");
    let (axis, way_rad) = (gripper.axis, 60_f64.to_radians());
    let at_constant_s = |torque_nm: f64| (2.0 * 0.1 * way_rad * axis.rotor_kg_m2 / torque_nm).sqrt();
    let opening_s = gripper.opening_s();
    assert!(opening_s > at_constant_s(axis.torque_max_nm()) && opening_s < 0.03, "{opening_s}");
    assert_eq!(arm.opening_s(), Some(opening_s));
    assert!(arm.opens_its_hand());
}

/// 72 deg/s are 0.2 turns/s of the joint, and 32.8 turns/s of a motor behind a gear of 164: the field ends at 32.767.
#[test]
fn a_speed_or_a_torque_that_the_set_points_cannot_hold_is_refused_when_the_file_is_read() {
    const AT_JOINT: &str = r#"gear_ratio = 50, encoder = "joint""#;
    for (gear, fits) in [(163, true), (164, false)] {
        let text = TEXT.replacen(AT_JOINT, &format!(r#"gear_ratio = {gear}, encoder = "motor""#), 1);
        match RobotModel::from_toml("arm.toml", &text) {
            Ok(_) => assert!(fits, "{gear}"),
            Err(error) => {
                assert!(!fits && error.key == "joint[0].velocity_max_deg_s", "{error}");
                assert!(matches!(error.problem, Problem::BeyondDrive { .. }), "{error}");
            }
        }
    }
    assert_eq!(refused("current_max_a = 40", "current_max_a = 39").key, "joint[0].torque_max_nm");
}

#[test]
fn axes_on_some_joints_only_or_beside_other_drives_are_refused() {
    let first = TEXT.lines().find(|line| line.starts_with("odrive =")).unwrap();
    let error = refused(first, "");
    let joint = "turntable".to_owned();
    assert_eq!(error.problem, Problem::FamilyMissing { what: "ODrive axis", joint });
    let error = refused(first, &format!("{first}\ndrive = {{ address = 1 }}"));
    assert_eq!(error.problem, Problem::TwoFamilies("turntable".to_owned()));
    let error = refused("[drive_loop]", "[generic_drives]\nvoltage_v = 48\n\n[drive_loop]");
    assert_eq!(error.problem, Problem::GenericBeside("[joint.odrive]"));
}

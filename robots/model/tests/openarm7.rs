//! One arm of an OpenArm: figures of its public description.

use robot_model::survey::{Weight, survey};
use robot_model::uses::missing;
use robot_model::{JointVec, LoadError, Problem, RobotModel};

const TEXT: &str = include_str!("../../openarm7.toml");

fn arm() -> RobotModel {
    RobotModel::from_toml("openarm7.toml", TEXT).expect("the file is read")
}

#[test]
fn values_that_are_not_from_the_description_are_marked_and_all_are_plausible() {
    let findings = survey("openarm7.toml", TEXT).expect("TOML");
    let wrong: Vec<_> = findings.iter().filter(|f| f.weight != Weight::Assumed).collect();
    assert!(wrong.is_empty(), "{wrong:#?}");
    assert!(findings.iter().any(|f| f.key.contains("velocity_max")), "speeds are assumed");
}

#[test]
fn its_limits_are_those_of_motors_that_the_mit_group_leads() {
    // Ranges of the motors and what the controller takes: 10 rad/s, 100 rad/s2, 9.5 rad.
    for (joint, no_load_rad_s) in arm().joints().iter().zip([16.8, 16.8, 5.4, 5.4, 20.9, 20.9, 20.9]) {
        let limits = &joint.limits;
        assert!(limits.v_max_rad_s <= 0.61 * no_load_rad_s && limits.v_max_rad_s <= 10.0, "{}", joint.name);
        // Absolute within a turn: the angle of the shaft determines the joint position only if the range is less than a turn.
        assert!(limits.q_max_rad - limits.q_min_rad < std::f64::consts::TAU, "{}", joint.name);
    }
}

#[test]
fn the_arm_weighs_5_kg_hangs_at_zero_and_holds_itself_level_with_the_torque_of_its_description() {
    let arm = arm();
    let mass_kg: f64 = arm.links().iter().map(|link| link.inertia.mass_kg()).sum();
    assert!((mass_kg - 5.0).abs() < 0.05, "{mass_kg}");
    let hanging = arm.fk(&JointVec::zeros(7));
    // Shoulder to the axes of the wrist 0.436 m.
    let hand = arm.ee(&hanging).pos;
    assert!((hand.z + 0.436).abs() < 1e-9 && hand.x.abs() < 1e-9, "{hand}");
    assert!((arm.ball(&hanging).pos.z + 0.581).abs() < 1e-9);
    // A positive angle of the first joint lifts the arm forwards, of the second one sideways, of the fourth one bends it forwards.
    for (joint, ahead) in [(0, [1.0, 0.0]), (1, [0.0, -1.0]), (3, [1.0, 0.0])] {
        let mut q = JointVec::zeros(7);
        q[joint] = 0.5;
        let moved = arm.ee(&arm.fk(&q)).pos - hand;
        assert!(moved.x * ahead[0] + moved.y * ahead[1] > 0.05 && moved.z > 0.0, "{joint}: {moved}");
    }
    // J1 needs 12 N m to hold the arm level.
    let torques = arm.holding_torques();
    assert!((11.0..13.5).contains(&torques[0]), "{torques}");
}

/// The error of the file with the first occurrence of `from` replaced.
fn refused(from: &str, to: &str) -> LoadError {
    assert!(TEXT.contains(from), "`{from}` is not in the file");
    RobotModel::from_toml("arm.toml", &TEXT.replacen(from, to, 1)).expect_err(to)
}

const FIRST: &str = r#"mit = { motor = "8009", id = 1, answers_on = 17, kp_nm_rad = 240, kd_nm_s_rad = 5, rotor_kg_m2 = 0.0081 }"#;
const GRIPPER: &str = r#"mit = { motor = "4310", id = 8, answers_on = 24, kp_nm_rad = 5, kd_nm_s_rad = 0.1, rotor_kg_m2 = 0.01, open_deg = -60, closed_deg = 0 }"#;

#[test]
fn each_joint_has_its_motor_with_ids_ranges_and_gains() {
    let arm = arm();
    let motors = arm.mit_motors().expect("motors");
    let ids: Vec<(u8, u16)> = motors.all().map(|m| (m.id.get(), m.answers_on.get())).collect();
    let expected: Vec<(u8, u16)> = (1..=8).map(|id| (id, 0x10 + u16::from(id))).collect();
    assert_eq!(ids, expected);
    let v_max: Vec<f32> = motors.joints.iter().map(|m| m.motor.ranges.v_max_rad_s()).collect();
    assert_eq!(v_max, [45.0, 45.0, 10.0, 10.0, 30.0, 30.0, 30.0]);
    assert_eq!((motors.joints[2].kp_nm_rad, motors.joints[2].kd_nm_s_rad), (240.0, 3.0));
}

#[test]
fn the_motor_of_a_gripper_comes_last_with_its_angles() {
    let arm = arm();
    let motors = arm.mit_motors().expect("motors");
    assert_eq!(motors.all().last().expect("the gripper").id.get(), 8);
    let gripper = motors.gripper.expect("the gripper");
    assert!(
        (gripper.travel.open_rad + 60_f64.to_radians()).abs() < 1e-12 && gripper.travel.closed_rad == 0.0
    );
}

#[test]
fn every_mistake_in_a_motor_is_named_with_its_key() {
    // (from, to, key path, part of the message)
    let rows = [
        ("motor = \"8009\"", "motor = \"8008\"".to_owned(), "joint[0].mit.motor", "8009"),
        ("id = 3,", "id = 2,".to_owned(), "joint[2].mit.id", "id 0x2 already belongs to shoulder abduction"),
        (
            "answers_on = 19",
            "answers_on = 18".to_owned(),
            "joint[2].mit.answers_on",
            "id 0x12 already belongs",
        ),
        ("answers_on = 19", "answers_on = 1".to_owned(), "joint[2].mit.answers_on", "id 0x1 already belongs"),
        ("answers_on = 17, ", String::new(), "joint[0].mit.answers_on", "missing"),
        ("answers_on = 17", "answers_on = 0x7FF".to_owned(), "joint[0].mit.answers_on", "2047"),
        ("id = 1,", "id = 128,".to_owned(), "joint[0].mit.id", "128"),
        (
            "kp_nm_rad = 240",
            "kp_nm_rad = 501".to_owned(),
            "joint[0].mit.kp_nm_rad",
            "501 is outside 0 to 500",
        ),
        (
            "kd_nm_s_rad = 5",
            "kd_nm_s_rad = 5.1".to_owned(),
            "joint[0].mit.kd_nm_s_rad",
            "5.1 is outside 0 to 5",
        ),
        (
            "velocity_max_deg_s = 180",
            "velocity_max_deg_s = 580".to_owned(),
            "joint[2].velocity_max_deg_s",
            "580.0 is more",
        ),
        (
            "torque_max_nm = 40",
            "torque_max_nm = 55".to_owned(),
            "joint[0].torque_max_nm",
            "motor 8009 hold (54.0)",
        ),
        ("id = 8", "id = 7".to_owned(), "gripper.mit.id", "already belongs to wrist flexion"),
        ("open_deg = -60", "open_deg = 0".to_owned(), "gripper.mit.open_deg", "the same angle"),
    ];
    for (from, to, key, message) in rows {
        let error = refused(from, &to);
        assert_eq!(error.key, key, "{error}");
        assert!(error.to_string().contains(message), "{error}");
    }
}

#[test]
fn motors_on_some_joints_only_or_beside_drives_are_refused() {
    let error = refused(FIRST, "");
    assert_eq!(
        (error.key.as_str(), &error.problem),
        ("joint[0].mit", &Problem::FamilyMissing { what: "MIT motor", joint: "shoulder flexion".to_owned() })
    );
    let error = refused(FIRST, &format!("{FIRST}\ndrive = {{ address = 1 }}"));
    assert_eq!(error.problem, Problem::TwoFamilies("shoulder flexion".to_owned()));
    let bare: String =
        TEXT.lines().filter(|line| !line.starts_with("mit =")).map(|line| format!("{line}\n")).collect();
    assert!(RobotModel::from_toml("arm.toml", &bare).expect("no motors").mit_motors().is_none());
    let error =
        RobotModel::from_toml("arm.toml", &bare.replacen("[gripper]", &format!("[gripper]\n{GRIPPER}"), 1))
            .expect_err("a lone gripper");
    assert_eq!(error.problem, Problem::GripperAlone("MIT motor"));
}

#[test]
fn nothing_is_missing_to_plan_to_simulate_or_on_a_real_bus() {
    let missing = missing(&arm(), "openarm7.toml", TEXT).expect("TOML");
    assert!(missing.is_empty(), "{missing:?}");
}

//! An arm of CANopen servos of the size of a SCHUNK LWA 4P.

use robot_model::survey::{Weight, survey};
use robot_model::uses::missing;
use robot_model::{JointVec, LoadError, Problem, RobotModel};

const TEXT: &str = include_str!("../../canopen6.toml");

fn arm() -> RobotModel {
    RobotModel::from_toml("canopen6.toml", TEXT).expect("the file is read")
}

/// The error of the file with the first occurrence of `from` replaced.
fn refused(from: &str, to: &str) -> LoadError {
    assert!(TEXT.contains(from), "`{from}` is not in the file");
    RobotModel::from_toml("arm.toml", &TEXT.replacen(from, to, 1)).expect_err(to)
}

#[test]
fn nothing_is_implausible_or_missing_to_plan_to_simulate_or_on_a_real_bus() {
    let findings = survey("canopen6.toml", TEXT).expect("TOML");
    let wrong: Vec<_> = findings.iter().filter(|f| f.weight != Weight::Assumed).collect();
    assert!(wrong.is_empty(), "{wrong:#?}");
    let missing = missing(&arm(), "canopen6.toml", TEXT).expect("TOML");
    assert!(missing.is_empty(), "{missing:?}");
}

#[test]
fn the_arm_weighs_12_kg_stands_upright_at_zero_and_holds_itself_within_its_rated_torques() {
    let arm = arm();
    let mass_kg: f64 = arm.links().iter().map(|link| link.inertia.mass_kg()).sum();
    assert!((mass_kg - 12.0).abs() < 0.01, "{mass_kg}");
    // Shoulder 0.11 m, upper arm 0.35 m, forearm 0.305 m.
    let hand = arm.ee(&arm.fk(&JointVec::zeros(6))).pos;
    assert!((hand.z - 0.765).abs() < 1e-9 && hand.x.abs() < 0.01 && hand.y.abs() < 0.01, "{hand}");
    // Shoulder and elbow bend it in the same plane, in opposite directions.
    let along = |joint: usize| {
        let mut q = JointVec::zeros(6);
        q[joint] = 0.3;
        arm.ee(&arm.fk(&q)).pos - hand
    };
    let (shoulder, elbow) = (along(1), along(2));
    assert!(shoulder.norm() > elbow.norm() && elbow.norm() > 0.05, "{shoulder} {elbow}");
    assert!(shoulder.x * elbow.x + shoulder.y * elbow.y < 0.0, "{shoulder} {elbow}");
    let rated = arm.cia402_servos().expect("servos").servos.iter().map(|servo| servo.rated_nm);
    assert!(arm.holding_torques().iter().zip(rated).all(|(held, rated)| *held <= rated));
}

#[test]
fn each_joint_has_its_servo_and_every_mistake_in_one_is_named_with_its_key() {
    let servos = arm();
    let nodes: Vec<u8> =
        servos.cia402_servos().expect("servos").servos.iter().map(|s| s.node.get()).collect();
    assert_eq!(nodes, [3, 4, 5, 6, 7, 8]);
    for (from, to, key, message) in [
        ("node = 5", "node = 4", "joint[2].cia402.node", "node 4 already belongs to shoulder"),
        ("node = 3", "node = 127", "joint[0].cia402.node", "127"),
        ("counts_per_turn = 655360, ", "", "joint[0].cia402.counts_per_turn", "missing"),
        ("rated_nm = 120", "rated_nm = 0", "joint[0].cia402.rated_nm", "0"),
        (
            "encoder = \"absolute\"",
            "mode = \"velocity\", encoder = \"absolute\"",
            "joint[0].cia402.mode",
            "interpolated_position",
        ),
        (
            "encoder = \"absolute\"",
            "mode = \"interpolated_position\", encoder = \"incremental\"",
            "joint[0].cia402.encoder",
            "absolute",
        ),
        ("encoder = \"absolute\"", "encoder = \"none\"", "joint[0].cia402.encoder", "incremental"),
    ] {
        let error = refused(from, to);
        assert_eq!(error.key, key, "{error}");
        assert!(error.to_string().contains(message), "{error}");
    }
}

#[test]
fn servos_on_some_joints_only_or_beside_other_drives_are_refused() {
    const FIRST: &str = r#"cia402 = { node = 3, counts_per_turn = 655360, rated_nm = 120, rotor_kg_m2 = 1.0, encoder = "absolute" }"#;
    let error = refused(FIRST, "");
    assert_eq!(
        error.problem,
        Problem::FamilyMissing { what: "CANopen servo", joint: "turntable".to_owned() }
    );
    let error = refused(FIRST, &format!("{FIRST}\ndrive = {{ address = 1 }}"));
    assert_eq!(error.problem, Problem::TwoFamilies("turntable".to_owned()));
    let error = refused("[drive_loop]", "[generic_drives]\nvoltage_v = 48\n\n[drive_loop]");
    assert_eq!(error.problem, Problem::GenericBeside("[joint.cia402]"));
}

#[test]
fn every_mistake_in_the_output_of_the_hand_is_named_with_its_key() {
    assert_eq!(
        arm().cia402_servos().expect("servos").output.map(|output| (output.joint, output.bit)),
        Some((5, 16))
    );
    for (from, to, key, message) in [
        ("output_of = 8", "output_of = 9", "gripper.cia402.output_of", "node 9 is the servo of no joint"),
        ("bit = 16", "bit = 15", "gripper.cia402.bit", "15"),
        ("bit = 16", "bit = 32", "gripper.cia402.bit", "32"),
        (", bit = 16", "", "gripper.cia402.bit", "missing"),
    ] {
        let error = refused(from, to);
        assert_eq!(error.key, key, "{error}");
        assert!(error.to_string().contains(message), "{error}");
    }
}

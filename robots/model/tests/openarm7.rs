//! One arm of an OpenArm: figures of its public description.

use robot_model::survey::{Weight, survey};
use robot_model::{JointVec, RobotModel};

const TEXT: &str = include_str!("../../openarm7.toml");

fn arm() -> RobotModel {
    RobotModel::from_toml("openarm7.toml", TEXT).expect("the file is read")
}

#[test]
fn values_that_are_not_of_the_description_are_marked_and_none_is_implausible() {
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
        // Absolute within a turn: the shaft says where the joint is only if its range is less.
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

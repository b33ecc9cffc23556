//! The arm as the torques ahead of a group see it.

use firmware::groups::dynamics::{ArmModel, Body};
use nalgebra::{Matrix3, Vector3};
use robot_model::RobotModel;

/// With the ball in the hand.
pub(super) fn model_of(robot: &RobotModel) -> ArmModel {
    let robot = &robot.holding_ball().unwrap_or_else(|| robot.clone());
    let rotor_kg_m2 = |joint: usize| robot.rotor_kg_m2(joint).unwrap_or(0.0);
    let vector = |v: &Vector3<f64>| v.map(|x| x as f32).into();
    let rows = |m: &Matrix3<f64>| m.transpose().map(|x| x as f32).into();
    let bodies = robot.joints().iter().zip(robot.links()).enumerate().map(|(index, (joint, link))| Body {
        rotation: rows(&joint.x_pj.rot),
        origin_m: vector(&joint.x_pj.pos),
        mass_kg: link.inertia.mass_kg() as f32,
        first_moment_kg_m: vector(link.inertia.first_moment_kg_m()),
        inertia_kg_m2: rows(link.inertia.about_origin_kg_m2()),
        rotor_kg_m2: rotor_kg_m2(index) as f32,
    });
    ArmModel { bodies: bodies.collect(), gravity_m_s2: robot.world().gravity_m_s2 as f32 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use firmware::groups::dynamics::Motion;
    use firmware::joints::PerJoint;
    use protocol::JointIndex;
    use robot_model::JointVec;

    #[test]
    fn torques_ahead_are_those_of_the_model_of_the_robot_and_its_rotors() {
        let robot = format!("{}/../../robots/openarm7.toml", env!("CARGO_MANIFEST_DIR"));
        let robot = RobotModel::load(&robot).unwrap();
        let (arm, holding) = (model_of(&robot), robot.holding_ball().unwrap());
        let rotors = &robot.mit_motors().unwrap().joints;
        for k in 0..200 {
            let wave = |scale: f64, f: f64| {
                JointVec::from_fn(robot.n(), |i| scale * (f64::from(k) * f + 1.7 * i as f64).sin())
            };
            let (q, qd, qdd) = (wave(2.0, 0.71), wave(4.0, 1.13), wave(30.0, 1.57));
            let wanted = holding.inverse_dynamics(&q, &qd, &qdd);
            let mut motion = PerJoint::default();
            for joint in JointIndex::first(robot.n()) {
                let i = joint.get();
                motion.set(
                    joint,
                    Motion { q_rad: q[i] as f32, qd_rad_s: qd[i] as f32, qdd_rad_s2: qdd[i] as f32 },
                );
            }
            let found = arm.torques_nm(&motion);
            for joint in JointIndex::first(robot.n()) {
                let i = joint.get();
                let wanted_nm = wanted[i] + rotors[i].rotor_kg_m2 * qdd[i];
                let off_nm = (f64::from(found.get(joint)) - wanted_nm).abs();
                assert!(off_nm < 2e-4, "joint {}: {off_nm} N·m beside {wanted_nm}", i + 1);
            }
        }
    }
}

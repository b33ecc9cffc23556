//! What every family of drives has in common.

use crate::RobotModel;

impl RobotModel {
    /// Number of the drive of each joint on its bus, base first; `None` if the robot file describes no drives.
    #[must_use]
    pub fn addresses(&self) -> Option<Vec<u8>> {
        let drives = self.drives().map(|all| all.iter().map(|drive| drive.address).collect());
        let motors = self.mit_motors().map(|all| all.joints.iter().map(|motor| motor.id.get()).collect());
        let servos = self.cia402_servos().map(|all| all.iter().map(|servo| servo.node.get()).collect());
        let axes = self.odrive_axes().map(|all| all.iter().map(|axis| axis.node.get()).collect());
        drives.or(motors).or(servos).or(axes)
    }

    /// Inertia that the rotor of a joint adds, kg·m²; `None` if the tables of its drives do not say it.
    #[must_use]
    pub fn rotor_kg_m2(&self, joint: usize) -> Option<f64> {
        let motors = self.mit_motors().map(|all| all.joints[joint].rotor_kg_m2);
        let servos = self.cia402_servos().map(|all| all[joint].rotor_kg_m2);
        motors.or(servos).or(self.odrive_axes().map(|all| all[joint].rotor_kg_m2))
    }

    /// The drives as text, for a fingerprint; empty if there are none but PowerCubes.
    #[must_use]
    pub fn motors_text(&self) -> String {
        let motors = self.mit_motors().map(|all| format!("{all:?}"));
        let servos = self.cia402_servos().map(|all| format!("{all:?}"));
        motors.or(servos).or(self.odrive_axes().map(|all| format!("{all:?}"))).unwrap_or_default()
    }

    /// Whether something opens the hand: CANopen servos and ODrives have no output for a gripper, and a robot file describes none beside
    /// them.
    #[must_use]
    pub fn opens_its_hand(&self) -> bool {
        self.cia402_servos().is_none() && self.odrive_axes().is_none()
    }
}

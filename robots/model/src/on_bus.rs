//! What every family of drives has in common.

use crate::{MitGripper, OdriveGripper, RobotModel};

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
        // Without the rate of the bus, which changes no motion.
        let motors = self
            .mit_motors()
            .map(|all| format!("MitMotors {{ joints: {:?}, gripper: {:?} }}", all.joints, all.gripper));
        let servos = self.cia402_servos().map(|all| format!("{all:?} {:?}", self.cia402_output()));
        let axes = self.odrive_axes().map(|all| format!("{all:?} {:?}", self.odrive_gripper()));
        motors.or(servos).or(axes).unwrap_or_default()
    }

    /// What the drives are, if they answer a controller only; `None` of PowerCubes, which any host may ask, and without drives.
    #[must_use]
    pub fn drives_of_controller(&self) -> Option<&'static str> {
        let motors = self.mit_motors().map(|_| "motors with MIT frames");
        let servos = self.cia402_servos().map(|_| "CANopen servos");
        motors.or(servos).or(self.odrive_axes().map(|_| "ODrives"))
    }

    /// Whether something opens the hand: a CANopen servo with an output for it, or an ODrive of its own. A PowerCube has an output
    /// always, and beside MIT motors the board of the controller may have one.
    #[must_use]
    pub fn opens_its_hand(&self) -> bool {
        (self.cia402_servos().is_none() || self.cia402_output().is_some())
            && (self.odrive_axes().is_none() || self.odrive_gripper().is_some())
    }

    /// From the order to open to the free ball, s, if a motor opens the hand.
    #[must_use]
    pub fn opening_s(&self) -> Option<f64> {
        let motor = self.mit_motors().and_then(|all| all.gripper.as_ref()).map(MitGripper::opening_s);
        motor.or(self.odrive_gripper().map(OdriveGripper::opening_s))
    }
}

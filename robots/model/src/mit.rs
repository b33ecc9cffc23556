//! Damiao motors that take MIT frames, as a robot file describes them.

use mit_protocol::{MotorId, MotorType};
use protocol::StandardId;

use crate::travel::FingerTravel;

/// The motors of an arm: one for each joint, and perhaps one for the gripper.
#[derive(Debug, Clone, PartialEq)]
pub struct MitMotors {
    /// Of the joints, base first.
    pub joints: Vec<MitMotor>,
    /// Of the gripper.
    pub gripper: Option<MitGripper>,
    /// Data rate of CAN FD that all of them are set to (register 35), bits per second, with 1 Mbit/s in arbitration; `None`: classical
    /// CAN.
    pub data_bit_rate_bit_s: Option<u32>,
}

/// A motor with its gear; all values at the shaft behind it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MitMotor {
    /// Type, with the ranges of its frames.
    pub motor: MotorType,
    /// Id of its commands (register 8).
    pub id: MotorId,
    /// Id of its answers (register 7).
    pub answers_on: StandardId,
    /// Position gain of each command, N·m/rad.
    pub kp_nm_rad: f64,
    /// Velocity gain of each command, N·m·s/rad.
    pub kd_nm_s_rad: f64,
    /// Inertia that the rotor adds, kg·m².
    pub rotor_kg_m2: f64,
}

/// The motor that moves the fingers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MitGripper {
    /// The motor.
    pub motor: MitMotor,
    /// How far it turns.
    pub travel: FingerTravel,
}

impl MitMotors {
    /// All motors: the joints, base first, then the gripper.
    pub fn all(&self) -> impl Iterator<Item = &MitMotor> {
        self.joints.iter().chain(self.gripper.as_ref().map(|gripper| &gripper.motor))
    }
}

impl MitGripper {
    /// From the order to open to the free ball, s: the rotor under the position gain alone.
    #[must_use]
    pub fn opening_s(&self) -> f64 {
        (2.0 * FingerTravel::FREE_SHARE * self.motor.rotor_kg_m2 / self.motor.kp_nm_rad).sqrt()
    }
}

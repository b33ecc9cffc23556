//! ODrives that speak CANSimple, as a robot file describes them.

use std::f64::consts::TAU;

use odrive_protocol::{NodeId, Version};

use crate::travel::FingerTravel;

/// The axis of a joint. Turns are those of the shaft that the axis counts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OdriveAxis {
    /// Node on the bus.
    pub node: NodeId,
    /// What it speaks.
    pub version: Version,
    /// Turns of the motor in a turn of the joint.
    pub gear_ratio: f64,
    /// The axis counts the shaft of the joint, absolute within a turn; else that of the motor.
    pub is_at_joint: bool,
    /// Torque of the motor per current, N·m/A.
    pub torque_nm_a: f64,
    /// Largest current, A.
    pub current_max_a: f64,
    /// Gain of the position loop, 1/s.
    pub position_gain_1_s: f64,
    /// Gain of the velocity loop, N·m of the motor per turn/s.
    pub velocity_gain_nm_s: f64,
    /// Gain of its integral, N·m of the motor per turn.
    pub integral_gain_nm: f64,
    /// It closes a brake when it gives no torque.
    pub brake: bool,
    /// Inertia that the rotor adds behind the gear, kg·m².
    pub rotor_kg_m2: f64,
}

/// The axis that moves the fingers, which it counts itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OdriveGripper {
    /// The axis.
    pub axis: OdriveAxis,
    /// How far it turns.
    pub travel: FingerTravel,
}

impl OdriveGripper {
    /// From the order to open to the free ball, s: the loops of the axis move its rotor, within the current. Integrated with steps of 10 us,
    /// for at most a second.
    #[must_use]
    pub fn opening_s(&self) -> f64 {
        const STEP_S: f64 = 1e-5;
        let (axis, FingerTravel { open_rad, closed_rad }) = (&self.axis, self.travel);
        let damping_nms_rad = axis.gear_ratio * axis.velocity_gain_nm_s * axis.counted() / TAU;
        let (mut q_rad, mut v_rad_s, mut t_s) = (closed_rad, 0.0, 0.0);
        while self.travel.open_share(q_rad) < FingerTravel::FREE_SHARE && t_s < 1.0 {
            let wanted_rad_s = axis.position_gain_1_s * (open_rad - q_rad);
            let torque_nm = (damping_nms_rad * (wanted_rad_s - v_rad_s))
                .clamp(-axis.torque_max_nm(), axis.torque_max_nm());
            v_rad_s += torque_nm / axis.rotor_kg_m2 * STEP_S;
            q_rad += v_rad_s * STEP_S;
            t_s += STEP_S;
        }
        t_s
    }
}

impl OdriveAxis {
    /// Largest velocity and torque that a set point feeds forward, turns/s and N·m of the motor: 16 bits in steps of a thousandth.
    pub const FIELD_MAX: f64 = 32.767;

    /// Turns that are counted in a turn of the joint.
    #[must_use]
    pub fn counted(&self) -> f64 {
        if self.is_at_joint { 1.0 } else { self.gear_ratio }
    }

    /// Largest torque at the joint, N·m.
    #[must_use]
    pub fn torque_max_nm(&self) -> f64 {
        self.gear_ratio * self.torque_nm_a * self.current_max_a
    }
}

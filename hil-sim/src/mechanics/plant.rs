//! Data between drives and mechanics, once per step and axis.

use nalgebra::Vector3;
use robot_model::release::HandMotion;

/// Output of the power stage of one drive during one step. All values at the joint.
///
/// Torque: `τ = clamp(torque + stiffness (reference - q) - damping q̇, ± torque_max)`; the plant solves for it
/// together with the motion, so a stiff loop needs no small steps.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AxisInput {
    /// Set-point in the middle of the step, rad.
    pub reference_rad: f64,
    /// Stiffness of the position loop, N·m/rad; zero while it is open.
    pub stiffness_nm_rad: f64,
    /// Damping of the position loop, N·m·s/rad.
    pub damping_nms_rad: f64,
    /// Torque besides the loop, N·m.
    pub torque_nm: f64,
    /// Largest torque, N·m; zero with the power stage off.
    pub torque_max_nm: f64,
    /// Torque against the motion may be larger by this, N·m: the induced voltage then helps the supply.
    pub braking_more_nm: f64,
    pub brake: bool,
}

impl AxisInput {
    /// Largest amount of a torque of this sign at this velocity, N·m.
    pub fn limit_nm(&self, wanted_nm: f64, v_rad_s: f64) -> f64 {
        self.torque_max_nm + if wanted_nm * v_rad_s < 0.0 { self.braking_more_nm } else { 0.0 }
    }
}

/// One axis after a step. Motor side, at the joint: without elasticity this is the joint itself.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AxisState {
    /// True position, rad.
    pub q_rad: f64,
    /// True velocity, rad/s.
    pub v_rad_s: f64,
    /// Torque the drive gave in the step, N·m.
    pub drive_torque_nm: f64,
    /// Torque that arrived at the links, `M q̈ + C q̇ + g`, N·m.
    pub link_torque_nm: f64,
    /// Torque behind the gear: that of the links and that taken by brake, end stop or an obstacle, N·m.
    /// Without the friction of the gear and the rotor.
    pub output_torque_nm: f64,
    /// The drive wanted more torque than it had.
    pub saturated: bool,
}

/// Kinetic and potential energy, J.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Energy {
    /// Links, rotors.
    pub kinetic_j: f64,
    /// Gravity, elastic gears.
    pub potential_j: f64,
}

impl Energy {
    /// Sum, J.
    pub fn total_j(&self) -> f64 {
        self.kinetic_j + self.potential_j
    }
}

/// The ball's place in the hand, in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandPoint {
    pub p_m: Vector3<f64>,
    pub v_m_s: Vector3<f64>,
}

/// A sphere touched a box of the arm.
#[derive(Clone, Debug, PartialEq)]
pub struct Touch {
    /// Name of the box in the robot file.
    pub part: String,
    /// How deep the sphere is in it, m.
    pub depth_m: f64,
}

/// The state left the range of numbers; the plant stands still at its last good state from then on.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("the simulated mechanics left their range at axis {axis}: q = {q_rad} rad, v = {v_rad_s} rad/s")]
pub struct PlantFault {
    /// Axis, from 0.
    pub axis: usize,
    /// Refused position, rad.
    pub q_rad: f64,
    /// Refused velocity, rad/s.
    pub v_rad_s: f64,
}

/// Mechanics behind any number of drives.
///
/// # Contract
///
/// * [`Plant::step`] takes one input per axis and moves everything by the same time.
/// * Nothing here knows the bus or wall time; equal calls give equal bits.
/// * After a [`PlantFault`] all numbers stay finite and the state stays as it was.
pub trait Plant {
    fn axes(&self) -> usize;

    /// Moves on by `dt_s` (0 to 10 ms); `inputs` has [`Plant::axes`] entries.
    fn step(&mut self, dt_s: f64, inputs: &[AxisInput]);

    /// Axis `index`, below [`Plant::axes`].
    fn axis(&self, index: usize) -> AxisState;

    /// Joint angle on the link side of the gear, rad.
    fn link_q_rad(&self, index: usize) -> f64;

    /// Clamps the axis from outside, or lets it go.
    fn set_blocked(&mut self, index: usize, blocked: bool);

    /// Takes the ball into the hand or out of it: its mass moves with the last link while it is there.
    fn set_ball_held(&mut self, held: bool) {
        let _ = held;
    }

    /// Motion of the hand at the ball's place `ahead_s` seconds after the last step (negative: before); `None` without a
    /// hand.
    fn hand_motion(&self, ahead_s: f64) -> Option<HandMotion>;

    /// The ball's place in the hand, as [`Plant::hand_motion`].
    fn hand(&self, ahead_s: f64) -> Option<HandPoint> {
        self.hand_motion(ahead_s).map(|hand| HandPoint { p_m: hand.p_m, v_m_s: hand.v_m_s })
    }

    /// The part of the arm that a sphere touches most deeply, if any.
    fn touch(&self, center_m: &Vector3<f64>, radius_m: f64) -> Option<Touch>;

    /// Energies; rotors included.
    fn energy(&self) -> Energy;

    fn fault(&self) -> Option<PlantFault>;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_motor_gives_more_against_its_motion_than_along_it() {
        let input = AxisInput { torque_max_nm: 2.0, braking_more_nm: 5.0, ..AxisInput::default() };
        for (wanted_nm, v_rad_s, most_nm) in
            [(9.0, 3.0, 2.0), (-9.0, -3.0, 2.0), (-9.0, 3.0, 7.0), (9.0, -3.0, 7.0), (9.0, 0.0, 2.0)]
        {
            assert_eq!(input.limit_nm(wanted_nm, v_rad_s), most_nm, "{wanted_nm} N·m at {v_rad_s} rad/s");
        }
    }
}

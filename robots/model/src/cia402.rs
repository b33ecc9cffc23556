//! CANopen servos of profile CiA 402, as a robot file describes them.

use canopen_protocol::NodeId;

/// The digital output of a servo that opens the hand (object 60FE).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cia402Output {
    /// Joint whose servo has it, base first.
    pub joint: usize,
    /// Bit of the object, 16 to 31: 1 opens.
    pub bit: u8,
}

/// The servo of a joint; all values at the joint, behind the gear.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cia402Servo {
    /// Node on the bus.
    pub node: NodeId,
    /// Counts per turn of the joint (objects 608F and 6091).
    pub counts_per_turn: u32,
    /// Rated torque, N·m (object 6076).
    pub rated_nm: f64,
    /// Inertia that the rotor adds, kg·m².
    pub rotor_kg_m2: f64,
    /// True if the encoder knows the joint position at power-on; otherwise a person moves the joint to its zero, which is set
    /// there.
    pub is_absolute: bool,
}

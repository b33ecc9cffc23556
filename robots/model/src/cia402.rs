//! CANopen servos of profile CiA 402, as a robot file describes them.

use std::fmt;

use canopen_protocol::NodeId;

/// The digital output of a servo that opens the hand (object 60FE).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cia402Output {
    /// Joint whose servo has it, base first.
    pub joint: usize,
    /// Bit of the object, 16 to 31: 1 opens.
    pub bit: u8,
}

/// Mode in which a servo follows positions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cia402Mode {
    /// Mode 8.
    CyclicPosition,
    /// Mode 7: modules that have no mode 8, as SCHUNK's.
    InterpolatedPosition,
}

/// The servo of a joint; all values at the joint, behind the gear.
#[derive(Clone, Copy, PartialEq)]
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
    /// See [`Cia402Mode`].
    pub mode: Cia402Mode,
}

/// Part of the fingerprint of the robot: the usual mode is left out, so that plans from before there were two stay valid.
impl fmt::Debug for Cia402Servo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { node, counts_per_turn, rated_nm, rotor_kg_m2, is_absolute, mode } = self;
        let mut text = f.debug_struct("Cia402Servo");
        text.field("node", node).field("counts_per_turn", counts_per_turn).field("rated_nm", rated_nm);
        text.field("rotor_kg_m2", rotor_kg_m2).field("is_absolute", is_absolute);
        if *mode != Cia402Mode::CyclicPosition {
            text.field("mode", mode);
        }
        text.finish()
    }
}

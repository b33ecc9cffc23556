//! Everything about the group at the moment of the first fault, kept until the fault is cleared.

use protocol::Instant;

use crate::fault::Fault;
use crate::joints::PerJoint;
use crate::state::StateKind;

/// One joint in a freeze frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FrozenJoint {
    /// Position, rad.
    pub q_rad: f32,
    /// Following error, rad.
    pub e_rad: f32,
    /// Its rate, rad/s.
    pub de_rad_s: f32,
    /// Reference velocity, rad/s.
    pub qd_ref_rad_s: f32,
    /// Last commanded acceleration, rad/s².
    pub qdd_command_rad_s2: f32,
    /// Last current read, A.
    pub current_a: Option<f32>,
    /// State of the drive that comes with each position, in the encoding of its family.
    pub short_state: u8,
    /// State of the drive as last read, in the encoding of its family.
    pub state: Option<u32>,
    /// Missed replies in a row.
    pub missed_in_row: u32,
    /// Age of the last position, µs; `u32::MAX`: no position, or older.
    pub age_us: u32,
}

/// The group in a freeze frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FreezeFrame {
    /// Time of the fault.
    pub at: Instant,
    /// The first fault.
    pub fault: Fault,
    /// State in which the fault occurred.
    pub state: StateKind,
    /// Time along the plan, µs; 0 outside a motion.
    pub path_us: i64,
    /// Per joint.
    pub joints: PerJoint<FrozenJoint>,
}

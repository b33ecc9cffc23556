//! What a host sees: samples of the joints and of the group, ready to be put on the wire by whoever links the
//! controller to a host.

use protocol::powercube::ShortState;
use protocol::{Duration, Instant};

use crate::fault::Fault;
use crate::joints::PerJoint;
use crate::state::StateKind;
use crate::store::FileName;

/// One joint at the end of a control cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct JointSample {
    /// Measured position, rad.
    pub q_rad: f32,
    /// Velocity from the reference and the change of the error, rad/s.
    pub qd_rad_s: f32,
    /// Reference minus measured position, rad.
    pub error_q_rad: f32,
    /// Reference velocity minus velocity, rad/s.
    pub error_qd_rad_s: f32,
    /// Commanded acceleration after clipping, rad/s².
    pub qdd_command_rad_s2: f32,
    /// Current as last read, A.
    pub current_a: Option<f32>,
    /// Short state as it came.
    pub short_state: ShortState,
    /// The acceleration was clipped in this cycle.
    pub saturated: bool,
    /// The speed limit acted.
    pub speed_limited: bool,
    /// A soft limit acted.
    pub position_limited: bool,
    /// No reply in this cycle.
    pub reply_missed: bool,
    /// Has found its zero.
    pub homed: bool,
    /// Reports an error.
    pub drive_error: bool,
    /// Is halted.
    pub halted: bool,
}

/// Counts since start-up; they stay at their largest value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Control cycles.
    pub cycles: u32,
    /// Control cycles that began late or before the last one was done.
    pub cycles_late: u16,
    /// Replies missed.
    pub replies_missed: u16,
    /// Control cycles in which a joint was saturated.
    pub cycles_saturated: u16,
    /// Frames of other hosts to the drives.
    pub foreign_requests: u16,
    /// Motion commands sent.
    pub motions: u32,
    /// Halt broadcasts sent.
    pub halts: u16,
}

/// The group as a whole.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroupSample {
    /// Time of the sample.
    pub at: Instant,
    /// State.
    pub state: StateKind,
    /// Latched fault.
    pub fault: Option<Fault>,
    /// Bit n: joint n has found its zero.
    pub homed_mask: u8,
    /// File in the upload bank.
    pub uploaded: Option<FileName>,
    /// Trajectory that may run.
    pub committed: Option<FileName>,
    /// The host's heartbeat is fresh.
    pub host_alive: bool,
    /// Gripper output set to open.
    pub gripper_open: bool,
    /// Control period.
    pub cycle: Duration,
    /// Largest lateness of a cycle since the last sample was taken.
    pub jitter: Duration,
    /// Counts.
    pub counters: Counters,
    /// Nominal bits of all frames seen and sent (without stuff bits), since start-up, modulo 2^32.
    pub bus_bits: u32,
    /// Time along the plan, µs.
    pub path_us: u32,
    /// Time until the arming or the offer expires.
    pub arming_left: Duration,
    /// Joints.
    pub joints: PerJoint<JointSample>,
}

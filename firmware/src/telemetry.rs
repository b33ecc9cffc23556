//! Samples of the joints and of the group for a host; the host link puts them on the wire. A joint's sample has the
//! type of the wire, so that nothing is copied twice.

use protocol::cyphal::cubecell::group_state::DriveDifference;
/// One joint at the end of a control cycle, as it goes over the wire.
pub use protocol::cyphal::cubecell::joint_state::{JointFlags, JointSample};
use protocol::{Duration, Instant};

use crate::fault::Fault;
use crate::state::StateKind;
use crate::store::FileName;

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
    /// Limits may be, or are, wider than those of the robot.
    pub limits_unlocked: bool,
    /// Orders that can move the arm need a code.
    pub keyed: bool,
    /// Control period.
    pub cycle: Duration,
    /// Largest lateness of a cycle since the last sample was taken.
    pub jitter: Duration,
    /// Counts.
    pub counters: Counters,
    /// Nominal bits of all frames seen and sent (without stuff bits), since start-up, modulo 2^32.
    pub bus_bits: u32,
    /// Time along the plan, µs modulo 2^32.
    pub path_us: u32,
    /// Time until the arming or the offer expires.
    pub arming_left: Duration,
    /// Time until an ordered run begins.
    pub start_left: Option<Duration>,
    /// New end states taken in this run; 0: the plan as committed is followed.
    pub targets_taken: u16,
    /// What in the drive of the latched fault differs from the settings; all zero: nothing.
    pub differs: DriveDifference,
}

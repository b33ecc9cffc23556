//! `cubecell.GroupState.1.2`: the joint group as a whole.

use core::fmt;

use super::super::bits::{Decode, DecodeError, Encode, Reader, Writer};
use super::super::id::SubjectId;

/// Default subject.
pub const SUBJECT: SubjectId = SubjectId::from_low_bits(1001);
/// Bytes of the message known here.
pub const EXTENT: u16 = 59;
/// Full type name for the register `uavcan.pub.group_state.type`.
pub const TYPE: &str = "cubecell.GroupState.1.2";

/// State of the group; the numbers are on the wire, also as vendor status of the heartbeat.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum State {
    /// Starting up; nothing is known yet.
    #[default]
    Boot = 0,
    /// Drives found, not all homed.
    Idle = 1,
    /// At least one joint is looking for its zero.
    Homing = 2,
    /// Homed and at rest.
    Ready = 3,
    /// A run may begin until the arming expires.
    Armed = 4,
    /// A trajectory is being tracked.
    Running = 5,
    /// Ramping down.
    Stopping = 6,
    /// At rest after a stop; needs a new arming.
    Stopped = 7,
    /// At rest because of a latched fault.
    Fault = 8,
    /// A joint moves while a person holds a key.
    Jogging = 9,
}

impl State {
    /// All of them.
    pub const ALL: [Self; 10] = [
        Self::Boot,
        Self::Idle,
        Self::Homing,
        Self::Ready,
        Self::Armed,
        Self::Running,
        Self::Stopping,
        Self::Stopped,
        Self::Fault,
        Self::Jogging,
    ];

    /// True if the controller may have motion commands on the bus.
    pub const fn may_move(self) -> bool {
        matches!(self, Self::Homing | Self::Running | Self::Stopping | Self::Jogging)
    }

    /// State of a number.
    pub const fn from_number(number: u8) -> Option<Self> {
        Some(match number {
            0 => Self::Boot,
            1 => Self::Idle,
            2 => Self::Homing,
            3 => Self::Ready,
            4 => Self::Armed,
            5 => Self::Running,
            6 => Self::Stopping,
            7 => Self::Stopped,
            8 => Self::Fault,
            9 => Self::Jogging,
            _ => return None,
        })
    }
}

impl fmt::Display for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Boot => "boot",
            Self::Idle => "idle",
            Self::Homing => "homing",
            Self::Ready => "ready",
            Self::Armed => "armed",
            Self::Running => "running",
            Self::Stopping => "stopping",
            Self::Stopped => "stopped",
            Self::Fault => "fault",
            Self::Jogging => "jogging",
        })
    }
}

/// What in a drive differs from the settings. All zero: nothing, or it is not known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DriveDifference {
    /// The object, register or parameter. The first byte says which family of drives it is of, and what kind it is.
    pub what: u32,
    /// What the drive holds.
    pub found: u32,
    /// What it should hold.
    pub expected: u32,
}

/// The message; see the `.dsdl` file for each field.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GroupState {
    /// Time of this message since the controller started, µs, 56 bits.
    pub uptime_us: u64,
    /// Number of this message, modulo 65536.
    pub sequence: u16,
    /// State of the group.
    pub state: State,
    /// Joint of the latched fault counted from 1; 0 = the group, or no fault.
    pub fault_joint: u8,
    /// Number of the first fault since the last clear; 0 = none.
    pub fault_cause: u16,
    /// Bit n: joint n (from 0) has found its zero.
    pub homed_mask: u8,
    /// A whole file is in the upload bank.
    pub trajectory_stored: bool,
    /// The file named by `trajectory_crc64` passed all checks.
    pub trajectory_committed: bool,
    /// The heartbeat of the host that armed the group is fresh.
    pub host_alive: bool,
    /// The gripper output is set to open.
    pub gripper_open: bool,
    /// The CAN controller is error-passive or was bus-off since the last message.
    pub bus_warning: bool,
    /// Limits beyond those of the robot may be set, or are set.
    pub limits_unlocked: bool,
    /// Orders that can move the arm need an authentication code.
    pub keyed: bool,
    /// Nominal control period, µs.
    pub cycle_us: u16,
    /// Largest deviation from it since the last message, µs; stays at 65535.
    pub cycle_jitter_us: u16,
    /// Cycles that began late, since start; stays at 65535.
    pub cycles_late: u16,
    /// Drive replies that did not come in time, since start; stays at 65535.
    pub replies_missed: u16,
    /// Cycles in which a joint's acceleration was clipped, since start; stays at 65535.
    pub cycles_saturated: u16,
    /// Bus time taken since the last message, in thousandths.
    pub bus_load_permille: u16,
    /// CRC-64/WE of the committed trajectory file; 0 if there is none.
    pub trajectory_crc64: u64,
    /// Time along the plan, µs modulo 2^32; 0 unless running or stopping.
    pub trajectory_time_us: u32,
    /// Time until the arming expires, ms; 0 unless armed or offered.
    pub arming_left_ms: u16,
    /// Time until an ordered run begins, µs; 0 = none is ordered.
    pub start_in_us: u32,
    /// Target states taken in this run or the last one; 0 = the trajectory is followed as committed.
    pub targets_taken: u16,
    /// What in the drive of `fault_joint` differs from the settings.
    pub differs: DriveDifference,
}

impl Encode for GroupState {
    fn encode(&self, out: &mut Writer<'_>) {
        out.uint(self.uptime_us, 56);
        out.u16(self.sequence);
        out.u8(self.state as u8);
        out.u8(self.fault_joint);
        out.u16(self.fault_cause);
        out.u8(self.homed_mask);
        for flag in [
            self.trajectory_stored,
            self.trajectory_committed,
            self.host_alive,
            self.gripper_open,
            self.bus_warning,
            self.limits_unlocked,
            self.keyed,
        ] {
            out.bool(flag);
        }
        out.void(1);
        for number in [
            self.cycle_us,
            self.cycle_jitter_us,
            self.cycles_late,
            self.replies_missed,
            self.cycles_saturated,
            self.bus_load_permille,
        ] {
            out.u16(number);
        }
        out.uint(self.trajectory_crc64, 64);
        out.u32(self.trajectory_time_us);
        out.u16(self.arming_left_ms);
        out.u32(self.start_in_us);
        out.u16(self.targets_taken);
        // Zeros are not sent: a receiver reads missing bytes as zeros, and the message stays short.
        let DriveDifference { what, found, expected } = self.differs;
        if what != 0 {
            for number in [what, found, expected] {
                out.u32(number);
            }
        }
    }
}

impl Decode<'_> for GroupState {
    /// An undefined state number is [`DecodeError::UnknownValue`]: a monitor must not show a state of a newer
    /// controller as another state.
    fn decode(input: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let (uptime_us, sequence) = (input.uint(56), input.u16());
        let number = input.u8();
        let state = State::from_number(number).ok_or(DecodeError::UnknownValue(u32::from(number)))?;
        let (fault_joint, fault_cause, homed_mask) = (input.u8(), input.u16(), input.u8());
        let [
            trajectory_stored,
            trajectory_committed,
            host_alive,
            gripper_open,
            bus_warning,
            limits_unlocked,
            keyed,
        ] = [(); 7].map(|()| input.bool());
        input.void(1);
        Ok(Self {
            uptime_us,
            sequence,
            state,
            fault_joint,
            fault_cause,
            homed_mask,
            trajectory_stored,
            trajectory_committed,
            host_alive,
            gripper_open,
            bus_warning,
            limits_unlocked,
            keyed,
            cycle_us: input.u16(),
            cycle_jitter_us: input.u16(),
            cycles_late: input.u16(),
            replies_missed: input.u16(),
            cycles_saturated: input.u16(),
            bus_load_permille: input.u16(),
            trajectory_crc64: input.uint(64),
            trajectory_time_us: input.u32(),
            arming_left_ms: input.u16(),
            // Zeros from a controller of version 1.0.
            start_in_us: input.u32(),
            targets_taken: input.u16(),
            differs: DriveDifference { what: input.u32(), found: input.u32(), expected: input.u32() },
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_state_has_its_number_and_no_other_number_is_a_state() {
        for (number, state) in (0..).zip(State::ALL) {
            assert_eq!((state as u8, State::from_number(number)), (number, Some(state)));
        }
        assert_eq!(State::from_number(State::ALL.len() as u8), None);
    }
}

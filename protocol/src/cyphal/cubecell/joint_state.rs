//! `cubecell.JointState.1.0`: what each joint did in one control cycle.

use super::super::bits::{Decode, DecodeError, Encode, Reader, Writer};
use super::super::id::SubjectId;
use crate::module::{JOINTS_MAX, JointIndex};

/// Default subject.
pub const SUBJECT: SubjectId = SubjectId::from_low_bits(1002);
/// Bytes of the longest message known here.
pub const EXTENT: u16 = 10 + 16 * JOINTS_MAX as u16;
/// Full type name for the register `uavcan.pub.joint_state.type`.
pub const TYPE: &str = "cubecell.JointState.1.0";

const _: () = assert!(JOINTS_MAX == 8, "JointState.CAPACITY");

/// One joint (`cubecell.JointSample.1.0`); joint side of the gear.
///
/// Fields that travel as binary16 keep 11 significant bits and at most ±65504.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct JointSample {
    /// Measured position.
    pub q_rad: f32,
    /// Velocity; binary16.
    pub qd_rad_s: f32,
    /// Reference minus measured position; binary16.
    pub error_q_rad: f32,
    /// Reference minus actual velocity; binary16.
    pub error_qd_rad_s: f32,
    /// Commanded acceleration after clipping; binary16.
    pub qdd_command_rad_s2: f32,
    /// Motor current as last read, NaN if never; binary16.
    pub current_a: f32,
    /// State byte of the drive as last received, in the code of its family. PowerCube: the short state, byte 6 of an extended
    /// reply. 0 if the family has no such byte.
    pub drive_state_byte: u8,
    /// What acted or failed in this cycle.
    pub flags: JointFlags,
}

/// Flags of a joint, one bit each; bit 7 is void.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct JointFlags(u8);

impl JointFlags {
    /// No flag.
    pub const NONE: Self = Self(0);
    /// The commanded acceleration was clipped.
    pub const ACCELERATION_CLIPPED: Self = Self(1);
    /// The velocity cap acted.
    pub const SPEED_LIMITED: Self = Self(1 << 1);
    /// The target was moved back to a soft limit.
    pub const POSITION_LIMITED: Self = Self(1 << 2);
    /// The drive did not answer in this cycle.
    pub const REPLY_MISSED: Self = Self(1 << 3);
    /// The drive has found its zero.
    pub const HOMED: Self = Self(1 << 4);
    /// The drive reports an error.
    pub const DRIVE_ERROR: Self = Self(1 << 5);
    /// The drive is in its stop state.
    pub const HALTED: Self = Self(1 << 6);

    const MASK: u8 = 0x7F;

    /// These and those.
    #[must_use]
    pub const fn with(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// True if all flags of `other` are set.
    pub const fn has(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }
}

/// `cubecell.JointState.1.0`: all joints at the end of a control cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointState {
    /// Time of the measurement since the controller started, µs, 56 bits.
    pub uptime_us: u64,
    /// Number of the control cycle, modulo 65536.
    pub cycle: u16,
    count: u8,
    joints: [JointSample; JOINTS_MAX],
}

impl JointState {
    /// Message of the first joints, base first; more than [`JOINTS_MAX`] are left out.
    pub fn new(uptime_us: u64, cycle: u16, joints: &[JointSample]) -> Self {
        let mut this = Self {
            uptime_us,
            cycle,
            count: joints.len().min(JOINTS_MAX) as u8,
            joints: [JointSample::default(); JOINTS_MAX],
        };
        for (to, from) in this.joints.iter_mut().zip(joints) {
            *to = *from;
        }
        this
    }

    /// The joints, base first.
    pub fn joints(&self) -> &[JointSample] {
        self.joints.get(..usize::from(self.count)).unwrap_or(&self.joints)
    }

    /// One joint, if the message has it.
    pub fn joint(&self, index: JointIndex) -> Option<&JointSample> {
        self.joints().get(index.get())
    }
}

impl Encode for JointSample {
    fn encode(&self, out: &mut Writer<'_>) {
        out.f32(self.q_rad);
        for value in
            [self.qd_rad_s, self.error_q_rad, self.error_qd_rad_s, self.qdd_command_rad_s2, self.current_a]
        {
            out.f16(value);
        }
        out.u8(self.drive_state_byte);
        out.u8(self.flags.0);
    }
}

impl Decode<'_> for JointSample {
    fn decode(input: &mut Reader<'_>) -> Result<Self, DecodeError> {
        Ok(Self {
            q_rad: input.f32(),
            qd_rad_s: input.f16(),
            error_q_rad: input.f16(),
            error_qd_rad_s: input.f16(),
            qdd_command_rad_s2: input.f16(),
            current_a: input.f16(),
            drive_state_byte: input.u8(),
            flags: JointFlags(input.u8() & JointFlags::MASK),
        })
    }
}

impl Encode for JointState {
    fn encode(&self, out: &mut Writer<'_>) {
        out.uint(self.uptime_us, 56);
        out.u16(self.cycle);
        out.u8(self.count);
        for joint in self.joints() {
            joint.encode(out);
        }
    }
}

impl Decode<'_> for JointState {
    fn decode(input: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let (uptime_us, cycle) = (input.uint(56), input.u16());
        let count = input.array_len(8, JOINTS_MAX)?;
        let mut joints = [JointSample::default(); JOINTS_MAX];
        for joint in joints.iter_mut().take(count) {
            *joint = JointSample::decode(input)?;
        }
        Ok(Self { uptime_us, cycle, count: count as u8, joints })
    }
}

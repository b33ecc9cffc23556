//! `cubecell.TargetState.1.0` and `cubecell.TargetAnswer.1.0`: a new end state in flight, and the answer to it.
//!
//! # Load
//!
//! Six joints without events are 40 bytes, so 6 frames of 0.13 ms at 1 Mbit/s; the answer is one frame. 120 end states a
//! second take 0.11 of the bus, 2.5 frames in each control cycle of 3 ms.
//!
//! # Use
//!
//! The subjects are set by the registers `uavcan.sub.target.id` and `uavcan.pub.target_answer.id`. The times are by
//! the controller's clock, which [`CLOCK`](super::command::CLOCK) reads. An end state acts two control periods and
//! the lag of the drives after its message has come (8 to 12 ms with PowerCubes at 3 ms). It must be reached at
//! least 20 ms after that.

use super::super::bits::{Decode, DecodeError, Encode, Reader, Writer};
use super::super::id::SubjectId;
use super::super::rx::Port;
use crate::module::JOINTS_MAX;

/// Default subject of [`TargetState`].
pub const SUBJECT: SubjectId = SubjectId::from_low_bits(1003);
/// Default subject of [`TargetAnswer`].
pub const ANSWER_SUBJECT: SubjectId = SubjectId::from_low_bits(1004);
/// Most events of an end state.
pub const EVENTS_MAX: usize = 2;
/// Bytes of the longest [`TargetState`] known here.
pub const EXTENT: u16 = 10 + 5 * JOINTS_MAX as u16 + 4 * EVENTS_MAX as u16;
/// Bytes of a [`TargetAnswer`] known here; its DSDL extent limits it to one frame.
pub const ANSWER_EXTENT: u16 = 6;
/// Full type name for the register `uavcan.sub.target.type`.
pub const TYPE: &str = "cubecell.TargetState.1.0";
/// Full type name for the register `uavcan.pub.target_answer.type`.
pub const ANSWER_TYPE: &str = "cubecell.TargetAnswer.1.0";

const _: () = assert!(JOINTS_MAX == 8, "TargetState.JOINTS_MAX");

/// The port on which to listen for end states.
pub const fn port(subject: SubjectId) -> Port {
    Port::message(subject, EXTENT)
}

/// End state of one joint (`cubecell.TargetJoint.1.0`); joint side of the gear.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TargetJoint {
    /// Position, µrad, 24 bits: within ±8.38 rad.
    pub q_urad: i32,
    /// Velocity; binary16.
    pub qd_rad_s: f32,
}

/// What happens to an output at a time (`cubecell.TargetEvent.1.0`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TargetEvent {
    /// 0 opens the gripper, 1 closes it.
    pub action: u8,
    /// Time since the arrival, µs, 24 bits; negative before it.
    pub offset_us: i32,
}

/// `cubecell.TargetState`: a new end state for a motion under way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TargetState {
    /// When the end state is reached, in the time of the controller, µs, 56 bits.
    pub arrive_us: u64,
    /// Number of this message, modulo 256.
    pub sequence: u8,
    joint_count: u8,
    joints: [TargetJoint; JOINTS_MAX],
    event_count: u8,
    events: [TargetEvent; EVENTS_MAX],
}

impl TargetState {
    /// Message of the first joints, base first, and the first events; more than fit are left out.
    pub fn new(arrive_us: u64, sequence: u8, joints: &[TargetJoint], events: &[TargetEvent]) -> Self {
        let mut this = Self {
            arrive_us,
            sequence,
            joint_count: joints.len().min(JOINTS_MAX) as u8,
            joints: [TargetJoint::default(); JOINTS_MAX],
            event_count: events.len().min(EVENTS_MAX) as u8,
            events: [TargetEvent::default(); EVENTS_MAX],
        };
        for (to, from) in this.joints.iter_mut().zip(joints) {
            *to = *from;
        }
        for (to, from) in this.events.iter_mut().zip(events) {
            *to = *from;
        }
        this
    }

    /// The joints, base first.
    pub fn joints(&self) -> &[TargetJoint] {
        self.joints.get(..usize::from(self.joint_count)).unwrap_or(&self.joints)
    }

    /// The events.
    pub fn events(&self) -> &[TargetEvent] {
        self.events.get(..usize::from(self.event_count)).unwrap_or(&self.events)
    }
}

impl Encode for TargetState {
    fn encode(&self, out: &mut Writer<'_>) {
        out.u56(self.arrive_us);
        out.u8(self.sequence);
        out.u8(self.joint_count);
        for joint in self.joints() {
            out.i24(joint.q_urad);
            out.f16(joint.qd_rad_s);
        }
        out.u8(self.event_count);
        for event in self.events() {
            out.u8(event.action);
            out.i24(event.offset_us);
        }
    }
}

impl Decode<'_> for TargetState {
    fn decode(input: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let (arrive_us, sequence) = (input.u56(), input.u8());
        let joint_count = input.array_len(8, JOINTS_MAX)?;
        let mut joints = [TargetJoint::default(); JOINTS_MAX];
        for joint in joints.iter_mut().take(joint_count) {
            *joint = TargetJoint { q_urad: input.i24(), qd_rad_s: input.f16() };
        }
        let event_count = input.array_len(8, EVENTS_MAX)?;
        let mut events = [TargetEvent::default(); EVENTS_MAX];
        for event in events.iter_mut().take(event_count) {
            *event = TargetEvent { action: input.u8(), offset_us: input.i24() };
        }
        Ok(Self {
            arrive_us,
            sequence,
            joint_count: joint_count as u8,
            joints,
            event_count: event_count as u8,
            events,
        })
    }
}

/// What became of an end state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TargetAnswer {
    /// That of the [`TargetState`].
    pub sequence: u8,
    /// 0 = taken; else the number of the refusal.
    pub cause: u16,
    /// Joint concerned, counted from 1; 0 = none.
    pub joint: u8,
    /// Event or other place, depending on the cause.
    pub index: u16,
}

impl Encode for TargetAnswer {
    fn encode(&self, out: &mut Writer<'_>) {
        out.u8(self.sequence);
        out.u16(self.cause);
        out.u8(self.joint);
        out.u16(self.index);
    }
}

impl Decode<'_> for TargetAnswer {
    fn decode(input: &mut Reader<'_>) -> Result<Self, DecodeError> {
        Ok(Self { sequence: input.u8(), cause: input.u16(), joint: input.u8(), index: input.u16() })
    }
}

//! Past events of a controller: two files for `uavcan.file.Read`. Numbers are little endian.
//!
//! | path | holds | bytes |
//! |---|---|---|
//! | [`FREEZE_PATH`] | the group at the moment of the latched fault: a [`FrozenHead`], then one [`FrozenJoint`] per joint; empty without a fault | 24 + 36 per joint |
//! | [`TRACE_PATH`] | the last events: a [`TraceHead`], then [`TraceHead::places`] places of a [`TraceEntry`] each | 8 + 16 per place |
//!
//! An event stays at its place until a newer one replaces it, so pieces that were read one after the other fit
//! together: sort by [`TraceEntry::sequence`], and leave out places with sequence 0.

use super::super::bits::{Decode, DecodeError, Encode, Reader, Writer};

/// The group at the moment of the latched fault.
pub const FREEZE_PATH: &[u8] = b"freeze";
/// The last events.
pub const TRACE_PATH: &[u8] = b"trace";
/// Version of both files.
pub const VERSION: u8 = 1;

/// Begins the freeze frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrozenHead {
    /// [`VERSION`].
    pub version: u8,
    /// Joints that follow.
    pub joints: u8,
    /// Number of the state in which the fault came.
    pub state: u8,
    /// Joint of the fault, from 1; 0: the group.
    pub fault_joint: u8,
    /// Number of the fault.
    pub fault_cause: u16,
    /// When, µs since the start of the controller.
    pub at_us: u64,
    /// Time along the plan, µs; 0 outside a motion.
    pub path_us: i64,
}

/// One joint of the freeze frame.
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
    /// Last current read, A; NaN: no reading.
    pub current_a: f32,
    /// Last state word of the drive; all bits set: no reading.
    pub drive_state: u32,
    /// Age of the last position, µs; all bits set: no position, or older.
    pub age_us: u32,
    /// Last short state of the drive.
    pub drive_state_byte: u8,
    /// Missed replies in a row; 255: that or more.
    pub missed_in_row: u8,
}

/// Begins the trace.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TraceHead {
    /// [`VERSION`].
    pub version: u8,
    /// Places that follow.
    pub places: u16,
    /// Events since the start of the controller, modulo 2^32; the newest entry has this sequence number.
    pub total: u32,
}

/// One event.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TraceEntry {
    /// Number of the event since the start of the controller, from 1; 0: nothing at this place yet.
    pub sequence: u32,
    /// When, µs since the start of the controller, 56 bits.
    pub at_us: u64,
    /// Joint, from 1; 0: none.
    pub joint: u8,
    /// What happened: [`kind`].
    pub kind: u8,
    /// Meaning depends on the kind.
    pub detail: u8,
    /// Number of a fault or refusal; 0: none.
    pub cause: u16,
}

/// Kinds of events.
#[allow(missing_docs)]
pub mod kind {
    /// Detail: old state × 16 + new state.
    pub const STATE: u8 = 1;
    pub const FURTHER_FAULT: u8 = 2;
    /// Detail: number of the order ([`super::order_name`]).
    pub const ORDER: u8 = 3;
    /// Detail: number of the order.
    pub const REFUSED: u8 = 4;
    pub const REPLY_MISSED: u8 = 5;
    pub const IMPLAUSIBLE: u8 = 6;
    pub const LATE_CYCLE: u8 = 7;
    /// Detail: 1 = open.
    pub const GRIPPER: u8 = 8;
    pub const HALT: u8 = 9;
    /// Detail: node that unlocked the limits.
    pub const UNLOCKED: u8 = 10;
    pub const LIMITS_PUT_BACK: u8 = 11;
    pub const LIMITS_CHANGED: u8 = 12;
    /// Detail: 1 = set, 0 = removed.
    pub const KEY: u8 = 13;
    /// Detail: number of the register in the list of registers.
    pub const REGISTER_REFUSED: u8 = 14;
    /// Detail: node that wrote to the upload of another node.
    pub const UPLOAD_VOIDED: u8 = 15;
}

/// Orders by the number in a [`TraceEntry`]. New ones are added at the end.
pub const ORDER_NAMES: [&str; 15] = [
    "arm prepare",
    "arm confirm",
    "disarm",
    "run",
    "stop",
    "clear fault",
    "home",
    "jog",
    "commit",
    "gripper",
    "save settings",
    "challenge",
    "authorize",
    "unlock",
    "retarget",
];

/// Name of an order.
pub fn order_name(number: u8) -> &'static str {
    ORDER_NAMES.get(usize::from(number)).copied().unwrap_or("unknown order")
}

/// Bytes of each record.
impl FrozenHead {
    /// Length in the file, bytes.
    pub const LEN: usize = 24;
}
impl FrozenJoint {
    /// Length in the file, bytes.
    pub const LEN: usize = 36;
}
impl TraceHead {
    /// Length in the file, bytes.
    pub const LEN: usize = 8;
}
impl TraceEntry {
    /// Length in the file, bytes.
    pub const LEN: usize = 16;
}

impl Encode for FrozenHead {
    fn encode(&self, out: &mut Writer<'_>) {
        for byte in [self.version, self.joints, self.state, self.fault_joint] {
            out.u8(byte);
        }
        out.u16(self.fault_cause);
        out.void(16);
        out.u64(self.at_us);
        out.u64(self.path_us as u64);
    }
}

impl Decode<'_> for FrozenHead {
    fn decode(input: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let [version, joints, state, fault_joint] = input.array();
        let fault_cause = input.u16();
        input.void(16);
        let (at_us, path_us) = (input.u64(), input.u64() as i64);
        Ok(Self { version, joints, state, fault_joint, fault_cause, at_us, path_us })
    }
}

impl Encode for FrozenJoint {
    fn encode(&self, out: &mut Writer<'_>) {
        for number in [
            self.q_rad,
            self.e_rad,
            self.de_rad_s,
            self.qd_ref_rad_s,
            self.qdd_command_rad_s2,
            self.current_a,
        ] {
            out.f32(number);
        }
        out.u32(self.drive_state);
        out.u32(self.age_us);
        out.u8(self.drive_state_byte);
        out.u8(self.missed_in_row);
        out.void(16);
    }
}

impl Decode<'_> for FrozenJoint {
    fn decode(input: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let [q_rad, e_rad, de_rad_s, qd_ref_rad_s, qdd_command_rad_s2, current_a] =
            [(); 6].map(|()| input.f32());
        let (drive_state, age_us) = (input.u32(), input.u32());
        let [drive_state_byte, missed_in_row] = input.array();
        input.void(16);
        Ok(Self {
            q_rad,
            e_rad,
            de_rad_s,
            qd_ref_rad_s,
            qdd_command_rad_s2,
            current_a,
            drive_state,
            age_us,
            drive_state_byte,
            missed_in_row,
        })
    }
}

impl Encode for TraceHead {
    fn encode(&self, out: &mut Writer<'_>) {
        out.u8(self.version);
        out.void(8);
        out.u16(self.places);
        out.u32(self.total);
    }
}

impl Decode<'_> for TraceHead {
    fn decode(input: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let version = input.u8();
        input.void(8);
        Ok(Self { version, places: input.u16(), total: input.u32() })
    }
}

impl Encode for TraceEntry {
    fn encode(&self, out: &mut Writer<'_>) {
        out.u32(self.sequence);
        out.uint(self.at_us, 56);
        out.u8(self.joint);
        out.u8(self.kind);
        out.u8(self.detail);
        out.u16(self.cause);
    }
}

impl Decode<'_> for TraceEntry {
    fn decode(input: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let (sequence, at_us) = (input.u32(), input.uint(56));
        let [joint, kind, detail] = input.array();
        Ok(Self { sequence, at_us, joint, kind, detail, cause: input.u16() })
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::bits::to_bytes;
    use super::*;

    #[test]
    fn records_have_their_length_and_come_back() {
        let head = FrozenHead {
            version: 1,
            joints: 6,
            state: 5,
            fault_joint: 3,
            fault_cause: 201,
            at_us: 1,
            path_us: -7,
        };
        let joint =
            FrozenJoint { q_rad: 0.5, current_a: 3.0, drive_state: 9, age_us: 8, ..Default::default() };
        let trace = TraceHead { version: 1, places: 64, total: 77 };
        let entry = TraceEntry { sequence: 5, at_us: 1 << 55, joint: 2, kind: 4, detail: 13, cause: 720 };
        let mut bytes = [0; 64];
        assert_eq!(to_bytes(&head, &mut bytes), Ok(FrozenHead::LEN));
        assert_eq!(FrozenHead::from_bytes(&bytes), Ok(head));
        assert_eq!(to_bytes(&joint, &mut bytes), Ok(FrozenJoint::LEN));
        assert_eq!(FrozenJoint::from_bytes(&bytes), Ok(joint));
        assert_eq!(to_bytes(&trace, &mut bytes), Ok(TraceHead::LEN));
        assert_eq!(TraceHead::from_bytes(&bytes), Ok(trace));
        assert_eq!(to_bytes(&entry, &mut bytes), Ok(TraceEntry::LEN));
        assert_eq!(TraceEntry::from_bytes(&bytes), Ok(entry));
    }
}

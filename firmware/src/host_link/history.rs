//! Freeze frame and trace as the files of [`protocol::cyphal::cubecell::history`], made piece by piece at each read.

use core::borrow::BorrowMut;

use protocol::JointIndex;
use protocol::cyphal::bits::{Encode, to_bytes};
use protocol::cyphal::cubecell::history::{FrozenHead, FrozenJoint, TraceEntry, TraceHead, VERSION, kind};

use crate::controller::Controller;
use crate::fault::Fault;
use crate::group::DriveGroup;
use crate::spline::Spline;
use crate::store::Storage;
use crate::trace::{TRACE_LEN, TraceEvent};

/// The requested part of a file, and how much of it is filled.
struct Piece<'a> {
    /// Where the next record begins, from the start of the file.
    at: usize,
    offset: usize,
    out: &'a mut [u8],
    filled: usize,
}

impl<'a> Piece<'a> {
    fn new(offset: usize, out: &'a mut [u8]) -> Self {
        Self { at: 0, offset, out, filled: 0 }
    }

    /// Adds the next record of the file, of `len` bytes.
    fn push(&mut self, len: usize, record: &dyn Encode) {
        let begin = self.at;
        self.at += len;
        let wanted = self.offset.saturating_add(self.filled);
        if self.at <= wanted || self.filled == self.out.len() {
            return;
        }
        let mut bytes = [0; 48];
        if to_bytes(record, &mut bytes) != Ok(len) {
            return;
        }
        let part = bytes.get(wanted.saturating_sub(begin)..len).unwrap_or(&[]);
        let room = self.out.get_mut(self.filled..).unwrap_or(&mut []);
        self.filled += part.len().min(room.len());
        for (to, from) in room.iter_mut().zip(part) {
            *to = *from;
        }
    }
}

fn joint_number(joint: Option<JointIndex>) -> u8 {
    joint.map_or(0, |joint| joint.get() as u8 + 1)
}

/// Reads the freeze frame from byte `offset` on; returns the bytes filled, 0 without a fault.
pub fn read_freeze<S: Storage, M: BorrowMut<Spline>, G: DriveGroup>(
    controller: &Controller<S, M, G>,
    offset: usize,
    out: &mut [u8],
) -> usize {
    let Some(frame) = controller.freeze_frame() else { return 0 };
    let mut piece = Piece::new(offset, out);
    let head = FrozenHead {
        version: VERSION,
        joints: controller.settings().joints as u8,
        state: frame.state as u8,
        fault_joint: joint_number(frame.fault.joint),
        fault_cause: frame.fault.cause.code(),
        at_us: frame.at.as_micros(),
        path_us: frame.path_us,
    };
    piece.push(FrozenHead::LEN, &head);
    for joint in controller.joints() {
        let joint = frame.joints.at(joint);
        let record = FrozenJoint {
            q_rad: joint.q_rad,
            e_rad: joint.e_rad,
            de_rad_s: joint.de_rad_s,
            qd_ref_rad_s: joint.qd_ref_rad_s,
            qdd_command_rad_s2: joint.qdd_command_rad_s2,
            current_a: joint.current_a.unwrap_or(f32::NAN),
            drive_state: joint.state.unwrap_or(u32::MAX),
            age_us: joint.age_us,
            drive_state_byte: joint.short_state,
            missed_in_row: u8::try_from(joint.missed_in_row).unwrap_or(u8::MAX),
        };
        piece.push(FrozenJoint::LEN, &record);
    }
    piece.filled
}

/// Reads the trace from byte `offset` on; returns the bytes filled.
pub fn read_trace<S: Storage, M: BorrowMut<Spline>, G: DriveGroup>(
    controller: &Controller<S, M, G>,
    offset: usize,
    out: &mut [u8],
) -> usize {
    let trace = controller.trace();
    let mut piece = Piece::new(offset, out);
    let head = TraceHead { version: VERSION, places: TRACE_LEN as u16, total: trace.total() };
    piece.push(TraceHead::LEN, &head);
    for place in trace.places() {
        let entry = place.map_or(TraceEntry::default(), |(sequence, at, event)| TraceEntry {
            sequence,
            at_us: at.as_micros(),
            ..entry_of(event)
        });
        piece.push(TraceEntry::LEN, &entry);
    }
    piece.filled
}

fn entry_of(event: TraceEvent) -> TraceEntry {
    let of = |kind, detail| TraceEntry { kind, detail, ..TraceEntry::default() };
    let fault = |kind, detail, fault: Option<Fault>| TraceEntry {
        joint: joint_number(fault.and_then(|fault| fault.joint)),
        cause: fault.map_or(0, |fault| fault.cause.code()),
        ..of(kind, detail)
    };
    let at = |kind, joint| TraceEntry { joint: joint_number(Some(joint)), ..of(kind, 0) };
    match event {
        TraceEvent::State { from, to, fault: why } => fault(kind::STATE, (from as u8) << 4 | to as u8, why),
        TraceEvent::FurtherFault(why) => fault(kind::FURTHER_FAULT, 0, Some(why)),
        TraceEvent::Order(order) => of(kind::ORDER, order as u8),
        TraceEvent::Refused(order, cause) => {
            TraceEntry { cause: cause.code(), ..of(kind::REFUSED, order as u8) }
        }
        TraceEvent::Missed(joint) => at(kind::REPLY_MISSED, joint),
        TraceEvent::Implausible(joint) => at(kind::IMPLAUSIBLE, joint),
        TraceEvent::LateCycle => of(kind::LATE_CYCLE, 0),
        TraceEvent::Gripper(open) => of(kind::GRIPPER, u8::from(open)),
        TraceEvent::Halt => of(kind::HALT, 0),
        TraceEvent::Unlocked(peer) => of(kind::UNLOCKED, peer.number()),
        TraceEvent::LimitsPutBack => of(kind::LIMITS_PUT_BACK, 0),
        TraceEvent::LimitsChanged => of(kind::LIMITS_CHANGED, 0),
        TraceEvent::Key(set) => of(kind::KEY, u8::from(set)),
        TraceEvent::UploadVoided(peer) => of(kind::UPLOAD_VOIDED, peer.number()),
        TraceEvent::RegisterRefused(register, cause) => {
            TraceEntry { cause: cause.code(), ..of(kind::REGISTER_REFUSED, register) }
        }
    }
}

#[cfg(test)]
mod tests {
    use protocol::cyphal::cubecell::history::ORDER_NAMES;

    use crate::orders::OrderKind;

    #[test]
    fn every_order_has_its_name_at_its_number() {
        assert_eq!(OrderKind::ALL.len(), ORDER_NAMES.len());
        for (index, kind) in OrderKind::ALL.into_iter().enumerate() {
            assert_eq!(kind as usize, index);
            let name: String = format!("{kind:?}").to_lowercase();
            assert_eq!(name, ORDER_NAMES[index].replace(' ', ""));
        }
    }
}

//! Past events of a controller: freeze frame and trace, read over the wire, as text.

use std::fmt::Write as _;

use firmware::fault::Cause;
use protocol::cyphal::bits::Decode;
use protocol::cyphal::client::Policy;
use protocol::cyphal::cubecell::group_state::State;
use protocol::cyphal::cubecell::history::{
    FREEZE_PATH, FrozenHead, FrozenJoint, TRACE_PATH, TraceEntry, TraceHead, VERSION, kind, order_name,
};
use protocol::cyphal::id::NodeId;
use protocol::cyphal::uavcan::file::{self, PIECE_LEN_MAX, ReadRequest, ReadResponse};

use super::operator::OperatorError;
use super::registers::name_of;
use crate::bus::session::Session;

/// Longest file that is read: more than any controller has.
const FILE_LEN_MAX: usize = 64 * 1024;

/// The group at the moment of the latched fault.
#[derive(Clone, Debug, PartialEq)]
pub struct Frozen {
    /// The group.
    pub head: FrozenHead,
    /// Its joints, base first.
    pub joints: Vec<FrozenJoint>,
}

impl Session {
    /// A file of the controller, whole.
    ///
    /// # Errors
    /// [`OperatorError::Unreadable`] if there is no such file; or another [`OperatorError`].
    pub fn read_file(&mut self, node: NodeId, path: &[u8]) -> Result<Vec<u8>, OperatorError> {
        let mut bytes = Vec::new();
        while bytes.len() <= FILE_LEN_MAX {
            let request = ReadRequest { offset: bytes.len() as u64, path };
            let payload = self.request(node, file::READ, Policy::FILE, &request)?;
            let response =
                ReadResponse::from_bytes(&payload).map_err(|_| OperatorError::Unreadable { node })?;
            response.result.map_err(|_| OperatorError::Unreadable { node })?;
            bytes.extend_from_slice(response.data);
            if response.data.len() < PIECE_LEN_MAX {
                return Ok(bytes);
            }
        }
        Err(OperatorError::Unreadable { node })
    }

    /// The freeze frame; `None` without a fault.
    pub fn freeze_frame(&mut self, node: NodeId) -> Result<Option<Frozen>, OperatorError> {
        let bytes = self.read_file(node, FREEZE_PATH)?;
        if bytes.is_empty() {
            return Ok(None);
        }
        Frozen::read(&bytes).map(Some).ok_or(OperatorError::Unreadable { node })
    }

    /// The last events, oldest first.
    pub fn trace(&mut self, node: NodeId) -> Result<Vec<TraceEntry>, OperatorError> {
        let bytes = self.read_file(node, TRACE_PATH)?;
        events(&bytes).ok_or(OperatorError::Unreadable { node })
    }
}

impl Frozen {
    /// From the file of a controller; `None` if it is not a freeze frame.
    #[must_use]
    pub fn read(bytes: &[u8]) -> Option<Self> {
        let head = FrozenHead::from_bytes(bytes).ok()?;
        let records = bytes.get(FrozenHead::LEN..).unwrap_or_default();
        let whole = records.len() == usize::from(head.joints) * FrozenJoint::LEN;
        let joints: Result<_, _> = records.chunks(FrozenJoint::LEN).map(FrozenJoint::from_bytes).collect();
        (head.version == VERSION && whole).then_some(Self { head, joints: joints.ok()? })
    }
}

/// The events of the file of a controller, oldest first; `None` if it is not a trace.
#[must_use]
pub fn events(bytes: &[u8]) -> Option<Vec<TraceEntry>> {
    let head = TraceHead::from_bytes(bytes).ok()?;
    let places = bytes.get(TraceHead::LEN..).unwrap_or_default();
    if head.version != VERSION || places.len() != usize::from(head.places) * TraceEntry::LEN {
        return None;
    }
    let entries: Result<Vec<_>, _> = places.chunks(TraceEntry::LEN).map(TraceEntry::from_bytes).collect();
    let mut entries = entries.ok()?;
    entries.retain(|entry| entry.sequence != 0);
    entries.sort_unstable_by_key(|entry| entry.sequence);
    Some(entries)
}

fn cause(number: u16) -> String {
    Cause::from_code(number)
        .map_or_else(|| format!("cause {number}"), |cause| format!("{} ({number})", cause.name()))
}

fn state(number: u8) -> String {
    State::from_number(number).map_or_else(|| format!("state {number}"), |state| state.to_string())
}

/// One event as text.
#[must_use]
pub fn describe(entry: &TraceEntry) -> String {
    let mut text = match entry.kind {
        kind::STATE => format!("{} -> {}", state(entry.detail >> 4), state(entry.detail & 15)),
        kind::FURTHER_FAULT => "further fault".to_owned(),
        kind::ORDER => format!("order taken: {}", order_name(entry.detail)),
        kind::REFUSED => format!("order refused: {}", order_name(entry.detail)),
        kind::REPLY_MISSED => "a reply was missed".to_owned(),
        kind::IMPLAUSIBLE => "a position that cannot be".to_owned(),
        kind::LATE_CYCLE => "a late control cycle".to_owned(),
        kind::GRIPPER => format!("gripper {}", if entry.detail == 1 { "open" } else { "closed" }),
        kind::HALT => "halt broadcast".to_owned(),
        kind::UNLOCKED => format!("limits unlocked by node {}", entry.detail),
        kind::LIMITS_PUT_BACK => "the limits of the robot hold again".to_owned(),
        kind::LIMITS_CHANGED => "a limit was changed; the commit is void".to_owned(),
        kind::KEY => format!("key {}", if entry.detail == 1 { "set" } else { "removed" }),
        kind::UPLOAD_VOIDED => {
            format!("node {} wrote to the upload of another one, which is void", entry.detail)
        }
        kind::REGISTER_REFUSED => {
            let name = name_of(entry.detail.into()).unwrap_or("?");
            format!("register write refused: {name}")
        }
        other => format!("event {other}"),
    };
    if entry.joint != 0 {
        let _ = write!(text, ", joint {}", entry.joint);
    }
    if entry.cause != 0 {
        let _ = write!(text, ": {}", cause(entry.cause));
    }
    text
}

/// The freeze frame as a table.
#[must_use]
pub fn table(frozen: &Frozen) -> String {
    let head = &frozen.head;
    let place = if head.fault_joint == 0 { String::new() } else { format!(" at joint {}", head.fault_joint) };
    let mut text = format!(
        "fault {}{place}, in state {}, {:.6} s after the start of the controller, {:.6} s into the plan\n\
         joint    q_rad    e_rad  de_rad_s  qd_ref_rad_s  qdd_rad_s2  current_a  age_us  missed  drive state\n",
        cause(head.fault_cause),
        state(head.state),
        head.at_us as f64 * 1e-6,
        head.path_us as f64 * 1e-6,
    );
    for (number, joint) in (1..).zip(&frozen.joints) {
        let age = if joint.age_us == u32::MAX { "-".to_owned() } else { joint.age_us.to_string() };
        let drive =
            if joint.drive_state == u32::MAX { "-".to_owned() } else { format!("{:08x}", joint.drive_state) };
        let current =
            if joint.current_a.is_nan() { "-".to_owned() } else { format!("{:.2}", joint.current_a) };
        let _ = writeln!(
            text,
            "{number:>5} {:>8.4} {:>8.5} {:>9.4} {:>13.4} {:>11.3} {current:>10} {age:>7} {:>7}  {drive}",
            joint.q_rad,
            joint.e_rad,
            joint.de_rad_s,
            joint.qd_ref_rad_s,
            joint.qdd_command_rad_s2,
            joint.missed_in_row,
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_freeze_frame_is_a_table_with_its_cause_and_a_row_per_joint() {
        let head = FrozenHead {
            version: VERSION,
            joints: 2,
            state: State::Running as u8,
            fault_joint: 2,
            fault_cause: Cause::DriveSilent.code(),
            at_us: 12_500_000,
            path_us: 250_000,
        };
        let unread = FrozenJoint {
            current_a: f32::NAN,
            drive_state: u32::MAX,
            age_us: u32::MAX,
            ..FrozenJoint::default()
        };
        let joints = vec![FrozenJoint { q_rad: 0.5, drive_state: 0x11, ..FrozenJoint::default() }, unread];
        let text = table(&Frozen { head, joints });
        for part in
            ["DriveSilent (101) at joint 2", "in state running", "12.500000 s", "0.250000 s", "00000011"]
        {
            assert!(text.contains(part), "{part}: {text}");
        }
        assert_eq!(text.lines().count(), 4);
        assert!(text.lines().last().unwrap().ends_with('-'), "what was never read is not a number: {text}");
    }

    #[test]
    fn every_kind_of_event_has_words() {
        for number in kind::STATE..=kind::UPLOAD_VOIDED {
            let text = describe(&TraceEntry { kind: number, joint: 3, cause: 101, ..TraceEntry::default() });
            assert!(!text.starts_with("event") && text.contains("joint 3: DriveSilent (101)"), "{text}");
        }
        assert_eq!(describe(&TraceEntry { kind: 200, ..TraceEntry::default() }), "event 200");
    }
}

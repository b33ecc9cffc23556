//! The host as a Cyphal node: its heartbeat, and what arrives for it.

use std::collections::VecDeque;

use protocol::cyphal::bits::Decode;
use protocol::cyphal::client::{NoAnswer, Ticket};
use protocol::cyphal::cubecell::group_state::{self, GroupState};
use protocol::cyphal::cubecell::joint_state::{self, JointState};
use protocol::cyphal::cubecell::target::{self, TargetAnswer};
use protocol::cyphal::host::{CyphalHost, Listener, RESPONSES};
use protocol::cyphal::id::{NodeId, Route};
use protocol::cyphal::rx::{Port, Transfer};
use protocol::cyphal::uavcan::diagnostic::{self, Record, Severity};
use protocol::cyphal::uavcan::info::{NodeInfo, Version};
use protocol::{Duration, Instant};

/// Cyphal node-ID of the first host tool on a bus; the highest ones are customary for tools.
pub const NODE_ID: NodeId = NodeId::from_low_bits(126);
/// Lowest node-ID of a host tool. Each further tool takes the highest one that is free. If a node began with the
/// node-ID of another, it would look like the other one started again, and a controller would stop its motion.
pub const NODE_ID_MIN: NodeId = NodeId::from_low_bits(111);

/// Time between two heartbeats of the host: a third of the time-out that controllers have by default.
pub const HEARTBEAT: Duration = Duration::from_millis(30);
/// Answers to end states that wait to be fetched: two seconds of them. Older ones are dropped.
pub const ANSWERS_MAX: usize = 256;
/// Lines of text that wait to be fetched. Older ones are dropped; a recording has all.
pub const RECORDS_MAX: usize = 64;

/// A line of text for people (`uavcan.diagnostic.Record`).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Said {
    pub from: NodeId,
    /// How much it matters.
    pub severity: Severity,
    pub text: String,
}

/// The host node's Cyphal half.
pub(super) type CyphalLink = CyphalHost<Inbox>;

/// What arrived.
#[derive(Clone, Debug)]
pub struct Inbox {
    ports: Vec<Port>,
    pub(crate) answers: VecDeque<(Ticket, Result<Vec<u8>, NoAnswer>)>,
    /// Last reported state of the controller, with time and sender.
    pub group: Option<(Instant, NodeId, GroupState)>,
    /// Last reported state of its joints, with time and sender.
    pub joints: Option<(Instant, NodeId, JointState)>,
    /// Lines of text for people, oldest first, with the time of their arrival; at most [`RECORDS_MAX`].
    pub(crate) records: VecDeque<(Instant, Said)>,
    /// Answers to end states, oldest first, with the time of their arrival and their sender; at most [`ANSWERS_MAX`].
    pub(crate) target_answers: VecDeque<(Instant, NodeId, TargetAnswer)>,
}

impl Listener for Inbox {
    fn info(&self) -> NodeInfo<'_> {
        let version = |major, minor| Version { major, minor };
        NodeInfo {
            protocol: version(1, 0),
            hardware: version(0, 0),
            software: version(0, 1),
            software_vcs_revision: 0,
            unique_id: [0; 16],
            name: b"cubecell.cubectl",
            software_image_crc: None,
            certificate: &[],
        }
    }

    fn ports(&self) -> &[Port] {
        &self.ports
    }

    fn message(&mut self, now: Instant, transfer: &Transfer<'_>) {
        let Route::Message { subject, source } = transfer.route else { return };
        if subject == diagnostic::SUBJECT
            && let Ok(record) = Record::from_bytes(transfer.payload)
        {
            if self.records.len() == RECORDS_MAX {
                self.records.pop_front();
            }
            let text = String::from_utf8_lossy(record.text).into_owned();
            self.records.push_back((now, Said { from: source, severity: record.severity, text }));
        }
        if subject == group_state::SUBJECT
            && let Ok(state) = GroupState::from_bytes(transfer.payload)
        {
            self.group = Some((now, source, state));
        }
        if subject == joint_state::SUBJECT
            && let Ok(state) = JointState::from_bytes(transfer.payload)
        {
            self.joints = Some((now, source, state));
        }
        if subject == target::ANSWER_SUBJECT
            && let Ok(answer) = TargetAnswer::from_bytes(transfer.payload)
        {
            self.target_answers.push_back((now, source, answer));
            if self.target_answers.len() > ANSWERS_MAX {
                self.target_answers.pop_front();
            }
        }
    }

    fn answer(&mut self, _: Instant, ticket: Ticket, answer: Result<&Transfer<'_>, NoAnswer>) {
        let answer = answer.map(|transfer| transfer.payload.get(..transfer.len).unwrap_or_default().to_vec());
        self.answers.push_back((ticket, answer));
    }
}

pub(super) fn link(now: Instant, node_id: NodeId) -> CyphalLink {
    let mut ports = RESPONSES.to_vec();
    ports.push(Port::message(group_state::SUBJECT, group_state::EXTENT));
    ports.push(Port::message(joint_state::SUBJECT, joint_state::EXTENT));
    ports.push(Port::message(target::ANSWER_SUBJECT, target::ANSWER_EXTENT));
    ports.push(Port::message(diagnostic::SUBJECT, diagnostic::EXTENT));
    let inbox = Inbox {
        ports,
        answers: VecDeque::new(),
        group: None,
        joints: None,
        records: VecDeque::new(),
        target_answers: VecDeque::new(),
    };
    let mut link = CyphalHost::new(now, node_id, inbox);
    link.set_heartbeat_period(HEARTBEAT);
    link
}

//! Content of frames: requests and answers of drives, messages and orders of the host link.
//!
//! The decoder follows a bus from outside. No frame is addressed to it, it sends nothing, and it takes each frame
//! once, in the order of the log. Subjects are the defaults of the controller's registers.

use std::collections::BTreeMap;

use protocol::cyphal::bits::Decode;
use protocol::cyphal::cubecell::command::{self, Refusal};
use protocol::cyphal::cubecell::group_state::{self, GroupState};
use protocol::cyphal::cubecell::joint_state::{self, JointSample, JointState};
use protocol::cyphal::cubecell::stop::{self, Stop};
use protocol::cyphal::id::{NodeId, Route, TransferId};
use protocol::cyphal::rx::{Port, Receiver};
use protocol::cyphal::uavcan::command::{self as execute, CommandRequest, CommandResponse, Status, standard};
use protocol::cyphal::uavcan::diagnostic::{self, Record, Severity};
use protocol::powercube::{
    AddressedRequest, Broadcast, MotionPosition, Parameter, Reply, Request, ShortState, Value,
};
use protocol::{Frame, Id, Instant, ModuleId};

/// Content of a frame, or of the transfer that it ends.
#[derive(Clone, Debug, PartialEq)]
pub enum Fact {
    /// Another node sends a request or an order to a drive.
    Request {
        /// Addressee.
        module: ModuleId,
        request: Request,
    },
    /// A message of a drive.
    Reply { module: ModuleId, reply: Reply },
    /// To all drives.
    Broadcast(Broadcast),
    /// State of a joint group.
    Group {
        /// Its controller.
        from: NodeId,
        /// End of the first frame of the transfer.
        first_at: Instant,
        /// The message.
        state: GroupState,
    },
    /// State of all joints of a group.
    Joints {
        /// Its controller.
        from: NodeId,
        /// Number of each joint from 1, and its sample. A decoder counts as the controller does; a [`super::watch::Watch`]
        /// as the robot.
        joints: Vec<(u8, JointSample)>,
    },
    /// A line of text for people.
    Record {
        from: NodeId,
        /// How much it matters.
        severity: Severity,
        text: String,
    },
    /// A command to a controller.
    Order {
        /// Who orders.
        from: NodeId,
        /// Receiver.
        to: NodeId,
        /// Number of the command.
        number: u16,
    },
    Answer {
        from: NodeId,
        /// Number of the command, if it was seen.
        number: Option<u16>,
        status: Status,
        /// Reason, if it is given.
        refusal: Option<Refusal>,
    },
    /// The message that stops a group.
    Stop {
        /// Sender; `None` for a node without address.
        from: Option<NodeId>,
        stop: Stop,
    },
}

/// Extent of the longest message that is read.
const BYTES: usize = 300;

const PORTS: [Port; 6] = [
    Port::message(group_state::SUBJECT, group_state::EXTENT),
    Port::message(joint_state::SUBJECT, joint_state::EXTENT),
    Port::message(diagnostic::SUBJECT, diagnostic::EXTENT),
    stop::port(stop::SUBJECT),
    Port::request(execute::SERVICE, execute::REQUEST_EXTENT),
    Port::response(execute::SERVICE, execute::RESPONSE_EXTENT),
];

#[derive(Clone, Debug, Default)]
pub struct Decoder {
    rx: Box<Receiver<64, 16, BYTES>>,
    /// Commands without an answer: client, server and number of the transfer.
    asked: BTreeMap<(u8, u8, u8), u16>,
}

impl Decoder {
    /// Takes the next frame; `None` if it has no content by itself.
    pub fn take(&mut self, at: Instant, frame: &Frame) -> Option<Fact> {
        let Id::Extended(id) = frame.id() else { return drive_fact(frame) };
        // The decoder takes services for every receiver.
        let local = match Route::parse(id).ok()?.1 {
            Route::Request { destination, .. } | Route::Response { destination, .. } => Some(destination),
            Route::Message { .. } | Route::Anonymous { .. } => None,
        };
        let transfer = self.rx.accept(at, local, frame, &[&PORTS])?;
        let data = transfer.payload;
        match transfer.route {
            Route::Message { subject, source } if subject == group_state::SUBJECT => {
                let state = GroupState::from_bytes(data).ok()?;
                Some(Fact::Group { from: source, first_at: transfer.at, state })
            }
            Route::Message { subject, source } if subject == joint_state::SUBJECT => {
                let state = JointState::from_bytes(data).ok()?;
                Some(Fact::Joints {
                    from: source,
                    joints: (1..).zip(state.joints().iter().copied()).collect(),
                })
            }
            Route::Message { subject, source } if subject == diagnostic::SUBJECT => {
                let record = Record::from_bytes(data).ok()?;
                let text = String::from_utf8_lossy(record.text).into_owned();
                Some(Fact::Record { from: source, severity: record.severity, text })
            }
            Route::Message { .. } | Route::Anonymous { .. } => {
                Some(Fact::Stop { from: transfer.route.source(), stop: Stop::from_bytes(data).ok()? })
            }
            Route::Request { source: client, destination: server, .. } => {
                let number = CommandRequest::from_bytes(data).ok()?.command;
                self.asked.insert(key(client, server, transfer.transfer_id), number);
                Some(Fact::Order { from: client, to: server, number })
            }
            Route::Response { source: server, destination: client, .. } => {
                let response = CommandResponse::from_bytes(data).ok()?;
                let refused = response.status != Status::SUCCESS && !response.output.is_empty();
                let refusal = refused.then(|| Refusal::from_bytes(response.output).ok()).flatten();
                let number = self.asked.remove(&key(client, server, transfer.transfer_id));
                Some(Fact::Answer { from: server, number, status: response.status, refusal })
            }
        }
    }
}

fn key(client: NodeId, server: NodeId, transfer: TransferId) -> (u8, u8, u8) {
    (client.get(), server.get(), transfer.get())
}

fn drive_fact(frame: &Frame) -> Option<Fact> {
    if let Ok((module, reply)) = Reply::decode(frame) {
        return Some(Fact::Reply { module, reply });
    }
    if let Ok(AddressedRequest { module, request, .. }) = AddressedRequest::decode(frame) {
        return Some(Fact::Request { module, request });
    }
    Broadcast::decode(frame).ok().map(Fact::Broadcast)
}

/// Position in rad and short state of an answer that carries a position; the state is missing in a plain reading.
#[must_use]
pub fn position(reply: &Reply) -> Option<(f64, Option<ShortState>)> {
    match *reply {
        Reply::MotionExtended { position: MotionPosition::Radians(q), short_state, .. } => {
            Some((q.get().into(), Some(short_state)))
        }
        Reply::Value(_, Value::PosStateDio(all)) => Some((all.position_rad.into(), Some(all.short_state))),
        Reply::Value(Parameter::ActPos, Value::F32(q)) => Some((q.into(), None)),
        _ => None,
    }
}

/// A command as text.
pub const fn order_name(number: u16) -> &'static str {
    match number {
        command::ARM_PREPARE => "prepare to arm",
        command::ARM_CONFIRM => "arm",
        command::DISARM => "disarm",
        command::RUN => "run",
        command::STOP => "stop",
        command::CLEAR_FAULT => "clear the fault",
        command::HOME => "home",
        command::JOG => "jog",
        command::COMMIT_TRAJECTORY => "commit the trajectory",
        command::GRIPPER => "set the gripper",
        standard::EMERGENCY_STOP => "emergency stop",
        standard::STORE_PERSISTENT_STATES => "save the settings",
        _ => "another command",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::cyphal::id::{Priority, ServiceId};
    use protocol::cyphal::tx::{TxMeta, TxQueue};
    use protocol::powercube::{MotionCommand, MotionRequest};
    use protocol::units::Radians;

    #[test]
    fn frames_of_drives_are_understood_by_their_ids() {
        let mut decoder = Decoder::default();
        let module = ModuleId::new(5).unwrap();
        let request =
            Request::Move(MotionRequest::extended(MotionCommand::Ramp { target: Radians::new(1.0) }));
        // Bytes of the reference: moveRampExtended of module 5 to 1 rad.
        let frame =
            Frame::new(protocol::StandardId::from_low_bits(0x0E5), &[0x0B, 0x0E, 0, 0, 0x80, 0x3F]).unwrap();
        assert_eq!(decoder.take(Instant::ZERO, &frame), Some(Fact::Request { module, request }));
        assert_eq!(
            decoder.take(Instant::ZERO, &Broadcast::Halt.encode()),
            Some(Fact::Broadcast(Broadcast::Halt))
        );
        let stranger = Frame::from_array(protocol::StandardId::from_low_bits(0x7FF), [1]);
        assert_eq!(decoder.take(Instant::ZERO, &stranger), None);
    }

    #[test]
    fn an_answer_is_brought_together_with_the_order_it_is_for() {
        let (host, controller) = (NodeId::from_low_bits(126), NodeId::from_low_bits(10));
        let service: ServiceId = execute::SERVICE;
        let mut tx = TxQueue::<16, 300>::default();
        let mut decoder = Decoder::default();
        let mut send = |route, message: &dyn protocol::cyphal::bits::Encode| {
            let meta = TxMeta {
                route,
                priority: Priority::Nominal,
                transfer_id: TransferId::ZERO,
                deadline: Instant::from_micros(1_000_000),
            };
            tx.push(&meta, message).unwrap();
            let mut facts = Vec::new();
            while let Some(frame) = tx.pop() {
                facts.extend(decoder.take(Instant::ZERO, &frame));
            }
            facts
        };
        let run = CommandRequest { command: command::RUN, parameter: &[0; 12] };
        let facts = send(Route::Request { service, source: host, destination: controller }, &run);
        assert_eq!(facts, [Fact::Order { from: host, to: controller, number: command::RUN }]);
        let output = [0xC1, 0x02, 0, 0, 0];
        let refused = CommandResponse { status: Status::FAILURE, output: &output };
        let facts = send(Route::Response { service, source: controller, destination: host }, &refused);
        let refusal = Some(Refusal { cause: 705, joint: 0, index: 0 });
        let number = Some(command::RUN);
        assert_eq!(facts, [Fact::Answer { from: controller, number, status: Status::FAILURE, refusal }]);
    }
}

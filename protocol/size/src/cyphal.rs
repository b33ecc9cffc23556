//! Cyphal: a node that listens to everything, answers everything, and sends every message.

use core::hint::black_box;

use protocol::cyphal::bits::{Decode, DecodeError, Encode, Reader, Writer};
use protocol::cyphal::crc::Crc64;
use protocol::cyphal::cubecell::stop;
use protocol::cyphal::id::{NodeId, ServiceId, SubjectId};
use protocol::cyphal::rx::{Port, Receiver, Transfer};
use protocol::cyphal::tx::{TxMeta, TxQueue};
use protocol::cyphal::uavcan::value::Value;
use protocol::{Duration, Frame, Instant};

/// Largest payload kept: a `GetInfo` response.
const BYTES: usize = 320;

type Queue = TxQueue<4, BYTES>;

/// What a node keeps between frames.
pub struct Station {
    receiver: Receiver<8, 2, BYTES>,
    queue: Queue,
}

impl Station {
    pub const fn new() -> Self {
        Self { receiver: Receiver::new(), queue: TxQueue::new() }
    }

    /// Receives `frame`, understands what it completes, and sends the same back.
    #[inline(never)]
    pub fn exercise(&mut self, now: Instant, frame: &Frame) {
        let subject = SubjectId::from_low_bits(black_box(0));
        let service = ServiceId::from_low_bits(black_box(0));
        let ports = [
            Port::message(subject, BYTES as u16),
            stop::port(subject),
            Port::request(service, BYTES as u16),
            Port::response(service, BYTES as u16),
        ];
        let local = Some(NodeId::from_low_bits(black_box(1)));
        let Self { receiver, queue } = self;
        if let Some(transfer) = part::accept(receiver, now, local, frame, &[&ports]) {
            let meta = TxMeta {
                route: transfer.route,
                priority: transfer.priority,
                transfer_id: transfer.transfer_id.next(),
                deadline: now + Duration::from_millis(100),
            };
            messages(&meta, transfer.payload, queue);
        }
        black_box(self.receiver.counters());
        part::expire(&mut self.queue, now);
        while let Some(frame) = part::pop(&mut self.queue) {
            black_box(frame);
        }
        black_box(part::crc64(black_box(&[0; 8])));
    }
}

/// What belongs to the protocol and not to this program, kept in functions of its own so that the
/// symbols of the linked program can be added up.
mod part {
    use super::*;

    #[inline(never)]
    pub fn accept<'a>(
        receiver: &'a mut Receiver<8, 2, BYTES>,
        now: Instant,
        local: Option<NodeId>,
        frame: &Frame,
        ports: &[&[Port]],
    ) -> Option<Transfer<'a>> {
        receiver.accept(now, local, frame, ports)
    }

    #[inline(never)]
    pub fn pop(queue: &mut Queue) -> Option<Frame> {
        queue.pop()
    }

    #[inline(never)]
    pub fn expire(queue: &mut Queue, now: Instant) -> Option<Instant> {
        queue.expire(now);
        queue.next_deadline()
    }

    #[inline(never)]
    pub fn crc64(data: &[u8]) -> u64 {
        Crc64::of(data)
    }
}

/// Decodes a message and sends it again.
#[cfg(feature = "cyphal")]
#[inline(never)]
fn messages(meta: &TxMeta, payload: &[u8], queue: &mut Queue) {
    macro_rules! turn_around {
        ($($message:ty),* $(,)?) => {
            // As a table: what is measured is the protocol, not a chain of comparisons.
            [$(|meta, payload, queue| {
                if let Ok(message) = <$message>::from_bytes(payload) {
                    black_box(queue.push(meta, &message).is_ok());
                }
            }),*]
        };
    }
    /// Every message and both halves of every service.
    static TYPES: &[fn(&TxMeta, &[u8], &mut Queue)] = &protocol::for_every_cyphal_type!(turn_around);
    if let Some(turn_around) = TYPES.get(black_box(0_usize)) {
        turn_around(meta, payload, queue);
    }
    black_box(Values::from_bytes(payload).is_ok_and(|values| queue.push(meta, &values).is_ok()));
}

/// What a controller needs: it publishes, and it serves requests.
#[cfg(not(feature = "cyphal"))]
#[inline(never)]
fn messages(meta: &TxMeta, payload: &[u8], queue: &mut Queue) {
    use protocol::cyphal::cubecell::{command as cell, group_state, joint_state};
    use protocol::cyphal::uavcan::{command, diagnostic, file, heartbeat, info, port_list, register};

    macro_rules! take {
        ($($message:ty),* $(,)?) => {
            [$(|payload| {
                black_box(<$message>::from_bytes(payload).is_ok_and(|message| {
                    black_box(&message);
                    true
                }));
            }),*]
        };
    }
    static REQUESTS: [fn(&[u8]); 15] = take![
        heartbeat::Heartbeat,
        stop::Stop,
        register::AccessRequest<'_>,
        register::ListRequest,
        command::CommandRequest<'_>,
        file::ReadRequest<'_>,
        file::WriteRequest<'_>,
        cell::ArmPrepare,
        cell::ArmConfirm,
        cell::Trajectory,
        cell::ClearFault,
        cell::Home,
        cell::Jog,
        cell::Gripper,
        Values<'_>,
    ];
    if let Some(take) = REQUESTS.get(black_box(0)) {
        take(payload);
    }
    let value = Values::from_bytes(payload).map_or(Value::EMPTY, |values| values.0);
    let ports = port_list::SubjectIds::Total;
    let services = port_list::ServiceIds(payload);
    let answers: [&dyn Encode; 13] = [
        &black_box(heartbeat::Heartbeat::default()),
        &diagnostic::Record {
            timestamp_us: black_box(0),
            severity: black_box(diagnostic::Severity::Info),
            text: payload,
        },
        &port_list::PortList { publishers: ports, subscribers: ports, clients: services, servers: services },
        &info::NodeInfo { name: payload, ..info::NodeInfo::default() },
        &register::AccessResponse { timestamp_us: black_box(0), mutable: true, persistent: true, value },
        &register::ListResponse { name: payload },
        &command::CommandResponse { status: command::Status(black_box(0)), output: payload },
        &file::ReadResponse { result: black_box(Ok(())), data: payload },
        &file::WriteResponse { result: black_box(Ok(())) },
        &black_box(group_state::GroupState::default()),
        &black_box(joint_state::JointState::new(0, 0, &[])),
        &black_box(cell::ArmOffer::default()),
        &black_box(cell::Refusal::default()),
    ];
    if let Some(answer) = answers.get(black_box(0_usize)) {
        black_box(queue.push(meta, *answer).is_ok());
    }
}

/// A register value, looked at as every type.
struct Values<'a>(Value<'a>);

impl<'a> Decode<'a> for Values<'a> {
    fn decode(input: &mut Reader<'a>) -> Result<Self, DecodeError> {
        let value = Value::decode(input)?;
        black_box((value.bool(0), value.u64(0), value.i64(0), value.f32(0), value.text()));
        Ok(Self(value))
    }
}

impl Encode for Values<'_> {
    fn encode(&self, out: &mut Writer<'_>) {
        self.0.encode(out);
    }
}

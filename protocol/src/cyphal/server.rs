//! The node core: the functions of every Cyphal node, over an application.
//!
//! [`NodeCore`] sends the heartbeat and the port list, answers `GetInfo`, `register.Access`, `register.List`,
//! `ExecuteCommand`, `file.List`, `file.Read` and `file.Write`, and passes messages and responses on.
//! [`Application`] is the one interface: a controller, a host tool and a test implement it. Together they are a
//! [`Node`] ([`Server`]).
//!
//! Must not: know the effect of a register or command; execute a request that it could not answer. A request that
//! finds the transmit queue full is ignored *before* it has an effect, and the client repeats it.

use super::bits::{Decode, Encode, Writer};
use super::id::{NodeId, Priority, Route, ServiceId, SubjectId, TransferId};
use super::rx::{Port, PortKind, Receiver, RxCounters, Transfer};
use super::tx::{SendError, TxMeta, TxQueue};
use super::uavcan::command::{self, CommandRequest, CommandResponse, Status};
use super::uavcan::diagnostic::{self, Record, Severity};
use super::uavcan::file::{self, FileError, ReadRequest, ReadResponse, WriteRequest, WriteResponse};
use super::uavcan::heartbeat::{self, Health, Heartbeat, Mode};
use super::uavcan::info::{self, NodeInfo};
use super::uavcan::port_list::{self, encode_services, encode_subjects};
use super::uavcan::register::{self, AccessRequest, AccessResponse, ListRequest, ListResponse};
use super::uavcan::value::{Value, ValueBuf, ValueType};
use crate::frame::Frame;
use crate::node::Node;
use crate::time::{Duration, Instant};

/// Time between two port lists; at most [`port_list::PERIOD_MAX`].
pub const PORT_LIST_PERIOD: Duration = Duration::from_secs(5);
/// How long an answer is worth sending: the usual time-out of clients.
pub const RESPONSE_VALID: Duration = Duration::from_secs(1);

/// The services that every node here provides.
pub const SERVICES: [Port; 7] = [
    Port::request(info::SERVICE, info::REQUEST_EXTENT),
    Port::request(register::ACCESS, register::ACCESS_REQUEST_EXTENT),
    Port::request(register::LIST, register::LIST_REQUEST_EXTENT),
    Port::request(command::SERVICE, command::REQUEST_EXTENT).with_repeats(),
    Port::request(file::LIST, file::LIST_REQUEST_EXTENT),
    Port::request(file::READ, file::READ_REQUEST_EXTENT),
    Port::request(file::WRITE, file::WRITE_REQUEST_EXTENT),
];

/// How a node is and what it does, for the heartbeat.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NodeStatus {
    /// Health for the heartbeat.
    pub health: Health,
    /// Mode for the heartbeat.
    pub mode: Mode,
    /// Free number.
    pub vendor_status: u8,
}

/// A register as it is read.
#[derive(Clone, Debug, PartialEq)]
pub struct Register {
    /// It can be written.
    pub mutable: bool,
    /// It survives a restart.
    pub persistent: bool,
    /// Present value; never empty for a register that exists.
    pub value: ValueBuf,
}

/// The application behind the Cyphal services of a node.
///
/// Calls come from [`NodeCore`] in the order of the frames; each must be short and bounded.
pub trait Application {
    /// Answer to `uavcan.node.GetInfo`.
    fn info(&self) -> NodeInfo<'_>;

    /// How it is now.
    fn status(&self) -> NodeStatus;

    /// Messages to listen to, and responses if the node is also a client. The extents set how much of a transfer is
    /// kept.
    fn subscriptions(&self) -> &[Port] {
        &[]
    }

    /// Subjects it sends, for the port list; heartbeat, port list and record are added.
    fn publications(&self) -> &[SubjectId] {
        &[]
    }

    /// Number of registers; their indices run from 0 without gaps.
    fn register_count(&self) -> u16 {
        0
    }

    /// Name of a register; empty past the last one.
    fn register_name(&self, index: u16) -> &[u8] {
        let _ = index;
        &[]
    }

    /// Reads a register; only called with an index below [`Self::register_count`].
    fn register_read(&self, index: u16) -> Option<Register> {
        let _ = index;
        None
    }

    /// Writes a register whose answer says that it is mutable. A value that does not fit (type, number of elements,
    /// range, state) changes nothing; the client sees the old value in the answer.
    fn register_write(&mut self, now: Instant, client: NodeId, index: u16, value: &Value<'_>) {
        let _ = (now, client, index, value);
    }

    /// True for a command that is carried out even if there is no room for its answer: one that ends a motion. Any
    /// other request waits for its repetition.
    fn is_urgent(&self, command: u16) -> bool {
        let _ = command;
        false
    }

    /// Carries out a command; `output` has [`command::OUTPUT_LEN_MAX`] bytes.
    ///
    /// The same command may come twice when an answer is lost.
    fn execute(
        &mut self,
        now: Instant,
        client: NodeId,
        command: u16,
        parameter: &[u8],
        output: &mut Writer<'_>,
    ) -> Status {
        let _ = (now, client, command, parameter, output);
        Status::BAD_COMMAND
    }

    /// Name of a file in the root, which is the only folder; empty past the last one.
    fn file_name(&self, index: u32) -> &[u8] {
        let _ = index;
        &[]
    }

    /// Stores a piece of a file; no data = the file ends at `offset`. The same piece may come twice.
    fn file_write(
        &mut self,
        now: Instant,
        client: NodeId,
        path: &[u8],
        offset: u64,
        data: &[u8],
    ) -> Result<(), FileError> {
        let _ = (now, client, path, offset, data);
        Err(FileError::NOT_SUPPORTED)
    }

    /// Copies a piece of a file into `data` and returns its length; shorter than `data` = the end.
    fn file_read(&mut self, path: &[u8], offset: u64, data: &mut [u8]) -> Result<usize, FileError> {
        let _ = (path, offset, data);
        Err(FileError::NOT_SUPPORTED)
    }

    /// Takes a message of a subscription.
    fn message(&mut self, now: Instant, transfer: &Transfer<'_>) {
        let _ = (now, transfer);
    }

    /// Takes a response to a request of this node.
    fn response(&mut self, now: Instant, transfer: &Transfer<'_>) {
        let _ = (now, transfer);
    }
}

/// A subject that this node sends: its counter of transfers, and how long a message may wait in the queue.
#[derive(Clone, Copy, Debug)]
pub struct Publication {
    /// Subject.
    pub subject: SubjectId,
    /// Urgency.
    pub priority: Priority,
    /// A message not sent within this time is dropped.
    pub valid: Duration,
    next: TransferId,
}

impl Publication {
    /// Begins with transfer 0.
    pub const fn new(subject: SubjectId, priority: Priority, valid: Duration) -> Self {
        Self { subject, priority, valid, next: TransferId::ZERO }
    }
}

/// Server side of a node with address `address`.
///
/// Capacities: `SESSIONS` and `BUFFERS` of `RX` bytes for reception ([`Receiver`]), `SLOTS` of `TX`
/// bytes for transmission ([`TxQueue`]). `TX` must hold the longest answer: 313 bytes of `GetInfo`.
#[derive(Clone, Debug)]
pub struct NodeCore<
    const SESSIONS: usize,
    const BUFFERS: usize,
    const RX: usize,
    const SLOTS: usize,
    const TX: usize,
> {
    address: NodeId,
    uptime_s: u32,
    /// When `uptime_s` was reached.
    uptime_at: Instant,
    heartbeat_due: Instant,
    heartbeat_period: Duration,
    port_list_due: Instant,
    heartbeat: Publication,
    port_list: Publication,
    record: Publication,
    rx: Receiver<SESSIONS, BUFFERS, RX>,
    tx: TxQueue<SLOTS, TX>,
    undecodable: u32,
    unanswered: u32,
}

/// Core for a controller: about 4.5 KiB of RAM; two clients may upload and browse at the same time.
pub type ControllerCore = NodeCore<8, 3, 520, 6, 320>;

impl<const SESSIONS: usize, const BUFFERS: usize, const RX: usize, const SLOTS: usize, const TX: usize>
    NodeCore<SESSIONS, BUFFERS, RX, SLOTS, TX>
{
    /// Node that starts at `now`; the first heartbeat is due at once.
    pub const fn new(now: Instant, address: NodeId) -> Self {
        const {
            assert!(RX >= file::WRITE_REQUEST_EXTENT as usize, "a file.Write request must fit");
            assert!(TX >= info::RESPONSE_EXTENT as usize, "a GetInfo response must fit");
        };
        let second = Duration::from_secs(1);
        Self {
            address,
            uptime_s: 0,
            uptime_at: now,
            heartbeat_due: now,
            heartbeat_period: heartbeat::PERIOD,
            port_list_due: now,
            heartbeat: Publication::new(heartbeat::SUBJECT, Priority::Nominal, second),
            port_list: Publication::new(port_list::SUBJECT, Priority::Optional, second),
            record: Publication::new(diagnostic::SUBJECT, Priority::Slow, second),
            rx: Receiver::new(),
            tx: TxQueue::new(),
            undecodable: 0,
            unanswered: 0,
        }
    }

    // ---- getters ---------------------------------------------------------------------------------

    /// Address of this node.
    pub const fn address(&self) -> NodeId {
        self.address
    }

    /// Gives the node another address; before the first frame.
    pub const fn set_address(&mut self, address: NodeId) {
        self.address = address;
    }

    /// What the receiver dropped, and why.
    pub const fn rx_counters(&self) -> &RxCounters {
        self.rx.counters()
    }

    /// Requests whose bytes were not a value of their type.
    pub const fn undecodable(&self) -> u32 {
        self.undecodable
    }

    /// Requests that were not answered because there was no room. Only urgent commands were still carried out.
    pub const fn unanswered(&self) -> u32 {
        self.unanswered
    }

    /// Transfers dropped because they waited too long.
    pub const fn expired(&self) -> u32 {
        self.tx.expired()
    }

    /// Number of transfers of this priority that can be queued now.
    pub fn room(&self, priority: Priority) -> usize {
        self.tx.room(priority)
    }

    // ---- inputs ----------------------------------------------------------------------------------

    /// Takes one frame of the bus.
    pub fn handle_frame(&mut self, now: Instant, frame: &Frame, app: &mut dyn Application) {
        let Self { rx, tx, .. } = self;
        let Some(transfer) = rx.accept(now, Some(self.address), frame, &[&SERVICES, app.subscriptions()])
        else {
            return;
        };
        match transfer.route {
            Route::Message { .. } | Route::Anonymous { .. } => app.message(now, &transfer),
            Route::Response { .. } => app.response(now, &transfer),
            Route::Request { service, source, destination } => {
                let meta = TxMeta {
                    route: Route::Response { service, source: destination, destination: source },
                    // As the request (section 4.1.1.3), but never in the drives' way.
                    priority: transfer.priority.max(Priority::Immediate),
                    transfer_id: transfer.transfer_id,
                    deadline: now + RESPONSE_VALID,
                };
                let urgent = is_urgent(service, transfer.payload, app);
                // A stop from a program that was restarted has the number of an older one.
                if transfer.repeated && !urgent {
                    return;
                }
                if tx.room(meta.priority) == 0 && !urgent {
                    self.unanswered = self.unanswered.saturating_add(1);
                    return;
                }
                let mut reply = |message: &dyn Encode| tx.push(&meta, message).is_ok();
                match serve(now, service, source, transfer.payload, app, &mut reply) {
                    Some(true) => {}
                    Some(false) => self.unanswered = self.unanswered.saturating_add(1),
                    None => self.undecodable = self.undecodable.saturating_add(1),
                }
            }
        }
    }

    /// Sends what is due and drops what is late.
    pub fn handle_timeout(&mut self, now: Instant, app: &dyn Application) {
        self.tx.expire(now);
        if self.heartbeat_due <= now {
            self.heartbeat_due = next_due(self.heartbeat_due, now, self.heartbeat_period);
            let NodeStatus { health, mode, vendor_status } = app.status();
            let message = Heartbeat { uptime_s: self.uptime(now), health, mode, vendor_status };
            let _ = publish(&mut self.tx, self.address, now, &mut self.heartbeat, &message);
        }
        if self.port_list_due <= now {
            self.port_list_due = next_due(self.port_list_due, now, PORT_LIST_PERIOD);
            let _ = publish(&mut self.tx, self.address, now, &mut self.port_list, &OwnPorts { app });
        }
    }

    /// Seconds since the start, counted up: a 64-bit division would cost 850 bytes of code. After a gap of more
    /// than an hour between two calls, the next calls catch up.
    fn uptime(&mut self, now: Instant) -> u32 {
        let us = now.saturating_since(self.uptime_at).as_micros().min(u64::from(u32::MAX)) as u32;
        let whole = us / 1_000_000;
        self.uptime_s = self.uptime_s.saturating_add(whole);
        self.uptime_at += Duration::from_micros(u64::from(whole * 1_000_000));
        self.uptime_s
    }

    // ---- application commands --------------------------------------------------------------------

    /// Sends the heartbeat more often than once a second, for a peer that monitors it; clamped to 1
    /// ms..=[`heartbeat::PERIOD`]. The time of the next one does not change.
    pub fn set_heartbeat_period(&mut self, period: Duration) {
        self.heartbeat_period = period.clamp(Duration::from_millis(1), heartbeat::PERIOD);
    }

    /// Queues a message; its number is used up even if it is refused, so that the gap is seen.
    pub fn publish(
        &mut self,
        now: Instant,
        publication: &mut Publication,
        message: &dyn Encode,
    ) -> Result<(), SendError> {
        publish(&mut self.tx, self.address, now, publication, message)
    }

    /// Queues a line of text for people; dropped when there is no room.
    pub fn log(&mut self, now: Instant, severity: Severity, text: &str) {
        // The network time is not known here: 0.
        let record = Record { timestamp_us: 0, severity, text: text.as_bytes() };
        let _ = publish(&mut self.tx, self.address, now, &mut self.record, &record);
    }

    /// Queues any transfer of this node; clients send their requests with it.
    pub fn send(&mut self, meta: &TxMeta, message: &dyn Encode) -> Result<(), SendError> {
        self.tx.push(meta, message)
    }

    // ---- outputs ---------------------------------------------------------------------------------

    /// Next frame to transmit: the most urgent.
    pub fn poll_frame(&mut self) -> Option<Frame> {
        self.tx.pop()
    }

    /// When [`Self::handle_timeout`] wants to be called.
    pub fn poll_timeout(&self) -> Instant {
        let due = self.heartbeat_due.min(self.port_list_due);
        self.tx.next_deadline().map_or(due, |deadline| deadline.min(due))
    }
}

/// The next due time on the grid of `period`; a late call does not cause a burst.
fn next_due(due: Instant, now: Instant, period: Duration) -> Instant {
    let next = due + period;
    if next > now { next } else { now + period }
}

fn is_urgent(service: ServiceId, payload: &[u8], app: &dyn Application) -> bool {
    service == command::SERVICE
        && CommandRequest::from_bytes(payload).is_ok_and(|request| app.is_urgent(request.command))
}

/// Queues a message under the next number of its subject. For periodic messages a refusal is ignored: the next
/// period sends a new one.
#[inline(never)]
fn publish<const SLOTS: usize, const TX: usize>(
    tx: &mut TxQueue<SLOTS, TX>,
    address: NodeId,
    now: Instant,
    publication: &mut Publication,
    message: &dyn Encode,
) -> Result<(), SendError> {
    let transfer_id = publication.next;
    publication.next = transfer_id.next();
    let meta = TxMeta {
        route: Route::Message { subject: publication.subject, source: address },
        priority: publication.priority,
        transfer_id,
        deadline: now + publication.valid,
    };
    tx.push(&meta, message)
}

/// Answers one request. `None`: not a request of that service; `Some(false)`: no room.
fn serve(
    now: Instant,
    service: ServiceId,
    client: NodeId,
    payload: &[u8],
    app: &mut dyn Application,
    reply: &mut dyn FnMut(&dyn Encode) -> bool,
) -> Option<bool> {
    if service == info::SERVICE {
        Some(reply(&app.info()))
    } else if service == register::ACCESS {
        let request = AccessRequest::from_bytes(payload).ok()?;
        let register = access(now, client, &request, app);
        let (mutable, persistent) = register.as_ref().map_or((false, false), |r| (r.mutable, r.persistent));
        let value = register.as_ref().map_or(Value::EMPTY, |r| r.value.as_value());
        Some(reply(&AccessResponse { timestamp_us: 0, mutable, persistent, value }))
    } else if service == register::LIST {
        let request = ListRequest::from_bytes(payload).ok()?;
        Some(reply(&ListResponse { name: app.register_name(request.index) }))
    } else if service == command::SERVICE {
        let request = CommandRequest::from_bytes(payload).ok()?;
        let mut buffer = [0; command::OUTPUT_LEN_MAX];
        let mut output = Writer::new(&mut buffer);
        let status = app.execute(now, client, request.command, request.parameter, &mut output);
        // An output that did not fit is sent empty rather than cut.
        let len = output.finish().unwrap_or(0);
        let output = buffer.get(..len).unwrap_or(&[]);
        Some(reply(&CommandResponse { status, output }))
    } else if service == file::LIST {
        let request = file::ListRequest::from_bytes(payload).ok()?;
        let is_root = matches!(request.folder, b"" | b"/");
        Some(reply(&file::ListResponse { name: if is_root { app.file_name(request.index) } else { &[] } }))
    } else if service == file::READ {
        let request = ReadRequest::from_bytes(payload).ok()?;
        let mut buffer = [0; file::PIECE_LEN_MAX];
        let read = app.file_read(request.path, request.offset, &mut buffer);
        let data = buffer.get(..read.unwrap_or(0)).unwrap_or(&[]);
        Some(reply(&ReadResponse { result: read.map(|_| ()), data }))
    } else if service == file::WRITE {
        let request = WriteRequest::from_bytes(payload).ok()?;
        let result = app.file_write(now, client, request.path, request.offset, request.data);
        Some(reply(&WriteResponse { result }))
    } else {
        None
    }
}

/// Writes if there is something to write, then reads.
fn access(
    now: Instant,
    client: NodeId,
    request: &AccessRequest<'_>,
    app: &mut dyn Application,
) -> Option<Register> {
    let index = (0..app.register_count()).find(|index| app.register_name(*index) == request.name)?;
    let register = app.register_read(index)?;
    if request.value.kind() == ValueType::Empty || !register.mutable {
        return Some(register);
    }
    app.register_write(now, client, index, &request.value);
    app.register_read(index)
}

/// Ports on which this node sends, listens, requests and answers.
struct OwnPorts<'a> {
    app: &'a dyn Application,
}

impl Encode for OwnPorts<'_> {
    fn encode(&self, out: &mut Writer<'_>) {
        let own = [heartbeat::SUBJECT, port_list::SUBJECT, diagnostic::SUBJECT];
        encode_subjects(out, &mut own.iter().chain(self.app.publications()).copied());
        let heard = self.app.subscriptions().iter().filter(|port| port.kind == PortKind::Message);
        encode_subjects(out, &mut heard.map(|port| SubjectId::from_low_bits(port.id)));
        let mut services = |kind, list: &[Port]| {
            encode_services(out, &|service| {
                list.iter().any(|port| port.kind == kind && port.id == service.get())
            });
        };
        services(PortKind::Response, self.app.subscriptions());
        services(PortKind::Request, &SERVICES);
    }
}

/// A [`NodeCore`] and its application as one [`Node`].
#[derive(Clone, Debug)]
pub struct Server<
    A,
    const SESSIONS: usize,
    const BUFFERS: usize,
    const RX: usize,
    const SLOTS: usize,
    const TX: usize,
> {
    /// The standard part.
    pub core: NodeCore<SESSIONS, BUFFERS, RX, SLOTS, TX>,
    /// The other part.
    pub app: A,
}

/// A controller's core and its application as one [`Node`].
pub type ControllerServer<A> = Server<A, 8, 3, 520, 6, 320>;

impl<
    A: Application,
    const SESSIONS: usize,
    const BUFFERS: usize,
    const RX: usize,
    const SLOTS: usize,
    const TX: usize,
> Node for Server<A, SESSIONS, BUFFERS, RX, SLOTS, TX>
{
    fn handle_frame(&mut self, now: Instant, frame: &Frame) {
        self.core.handle_frame(now, frame, &mut self.app);
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.core.handle_timeout(now, &self.app);
    }

    fn poll_frame(&mut self) -> Option<Frame> {
        self.core.poll_frame()
    }

    fn poll_timeout(&self) -> Option<Instant> {
        Some(self.core.poll_timeout())
    }
}

//! Whole Cyphal nodes: a controller's with an application of which nothing is known, and a host's.

use core::hint::black_box;

use protocol::cyphal::bits::Writer;
use protocol::cyphal::client::{NoAnswer, Policy, Ticket};
use protocol::cyphal::host::{CyphalHost, Listener};
use protocol::cyphal::id::{NodeId, Priority, ServiceId, SubjectId};
use protocol::cyphal::rx::{Port, Transfer};
use protocol::cyphal::server::{
    Application, ControllerCore, ControllerServer, NodeStatus, Publication, Register, Server,
};
use protocol::cyphal::uavcan::command::Status;
use protocol::cyphal::uavcan::diagnostic::Severity;
use protocol::cyphal::uavcan::file::FileError;
use protocol::cyphal::uavcan::heartbeat::Heartbeat;
use protocol::cyphal::uavcan::info::NodeInfo;
use protocol::cyphal::uavcan::value::{Value, ValueBuf};
use protocol::cyphal::upload::{Upload, UploadBank};
use protocol::{Duration, Frame, Instant, Node};

/// Both nodes, and the memory that an upload fills.
pub struct Nodes {
    server: ControllerServer<App>,
    host: CyphalHost<Tool>,
}

impl Nodes {
    pub const fn new() -> Self {
        let address = NodeId::from_low_bits(42);
        Self {
            server: Server {
                core: ControllerCore::new(Instant::ZERO, address),
                app: App { bank: UploadBank::new() },
            },
            host: CyphalHost::new(Instant::ZERO, NodeId::from_low_bits(1), Tool),
        }
    }

    /// Every input of both nodes.
    #[inline(never)]
    pub fn exercise(&mut self, now: Instant, frame: &Frame) {
        let Self { server, host } = self;
        turn(server, now, frame);
        server.core.log(now, black_box(Severity::Info), black_box("text"));
        server.core.set_heartbeat_period(black_box(Duration::from_millis(10)));
        let subject = SubjectId::from_low_bits(black_box(0));
        let mut publication =
            Publication::new(subject, black_box(Priority::Nominal), black_box(Duration::ZERO));
        let _ = black_box(server.core.publish(now, &mut publication, &black_box(Heartbeat::default())));

        turn(host, now, frame);
        let mut upload = Upload::new(black_box(b"file"), black_box(&[0; 64]));
        if let Some(piece) = upload.request() {
            let (server, service) =
                (NodeId::from_low_bits(black_box(0)), ServiceId::from_low_bits(black_box(0)));
            if let Ok(ticket) = black_box(host.request(now, server, service, Policy::FILE, &piece)) {
                host.cancel(ticket);
            }
        }
        black_box(upload.answered(black_box(Err(FileError::IO_ERROR))).is_ok());
    }
}

#[inline(never)]
fn turn(node: &mut dyn Node, now: Instant, frame: &Frame) {
    node.handle_frame(now, frame);
    node.handle_timeout(now);
    black_box((node.poll_frame(), node.poll_timeout()));
}

/// A controller of which nothing is known.
struct App {
    bank: UploadBank<512>,
}

impl Application for App {
    fn info(&self) -> NodeInfo<'_> {
        black_box(NodeInfo::default())
    }
    fn status(&self) -> NodeStatus {
        black_box(NodeStatus::default())
    }
    fn subscriptions(&self) -> &[Port] {
        black_box(&[])
    }
    fn publications(&self) -> &[SubjectId] {
        black_box(&[])
    }
    fn register_count(&self) -> u16 {
        black_box(0)
    }
    fn register_name(&self, index: u16) -> &[u8] {
        black_box(index);
        black_box(b"name")
    }
    fn register_read(&self, index: u16) -> Option<Register> {
        black_box(index);
        let value = ValueBuf::bits(black_box(&[true])).ok()?;
        black_box(Some(Register { mutable: true, persistent: true, value }))
    }
    fn register_write(&mut self, now: Instant, _: NodeId, index: u16, value: &Value<'_>) {
        black_box((now, index, value));
    }
    fn execute(
        &mut self,
        now: Instant,
        client: NodeId,
        command: u16,
        parameter: &[u8],
        output: &mut Writer<'_>,
    ) -> Status {
        output.bytes(black_box(parameter));
        black_box((now, client));
        Status(black_box(command) as u8)
    }
    fn file_write(&mut self, _: Instant, _: NodeId, path: &[u8], offset: u64, data: &[u8]) -> Result<(), FileError> {
        black_box(path);
        self.bank.write(offset, data)
    }
    fn file_read(&mut self, path: &[u8], offset: u64, data: &mut [u8]) -> Result<usize, FileError> {
        black_box(path);
        Ok(self.bank.read(offset, data))
    }
    fn message(&mut self, now: Instant, transfer: &Transfer<'_>) {
        black_box((now, transfer.payload));
    }
}

/// A host that only looks.
struct Tool;

impl Listener for Tool {
    fn info(&self) -> NodeInfo<'_> {
        black_box(NodeInfo::default())
    }
    fn message(&mut self, now: Instant, transfer: &Transfer<'_>) {
        black_box((now, transfer.payload));
    }
    fn answer(&mut self, now: Instant, ticket: Ticket, answer: Result<&Transfer<'_>, NoAnswer>) {
        black_box((now, ticket, answer.is_ok()));
    }
}

//! A host on the bus: a Cyphal node that sends requests, listens and uploads.
//!
//! [`CyphalHost`] is [`NodeCore`] with a [`Client`]; received messages go to a [`Listener`]. So the host sends a
//! heartbeat, which the controller monitors, and answers `GetInfo`. It is a [`Node`], so the same host runs in
//! virtual time and on a real bus.
//!
//! Must not: decide what to do; the tool decides, through [`CyphalHost::request`].

use super::bits::Encode;
use super::client::{Client, NoAnswer, Policy, Polled, StartError, Ticket};
use super::id::{NodeId, ServiceId};
use super::rx::{Port, Transfer};
use super::server::{Application, NodeCore, NodeStatus, Publication};
use super::tx::SendError;
use super::uavcan::info::NodeInfo;
use super::uavcan::{command, file, info, register};
use crate::frame::Frame;
use crate::node::Node;
use crate::time::{Duration, Instant};

/// Requests a host may have in flight.
pub const REQUESTS_MAX: usize = 16;

type Core = NodeCore<48, 8, 2240, 20, 560>;
type Requests = Client<REQUESTS_MAX, 560>;

/// The responses a host listens to; messages are added by the listener.
pub const RESPONSES: [Port; 7] = [
    Port::response(info::SERVICE, info::RESPONSE_EXTENT),
    Port::response(register::ACCESS, register::ACCESS_RESPONSE_EXTENT),
    Port::response(register::LIST, register::LIST_RESPONSE_EXTENT),
    Port::response(command::SERVICE, command::RESPONSE_EXTENT),
    Port::response(file::READ, file::READ_RESPONSE_EXTENT),
    Port::response(file::LIST, file::LIST_RESPONSE_EXTENT),
    Port::response(file::WRITE, file::WRITE_RESPONSE_EXTENT),
];

/// Reaction of a tool to received messages.
pub trait Listener {
    /// What this host is, for `GetInfo`.
    fn info(&self) -> NodeInfo<'_>;

    /// How it is, for the heartbeat.
    fn status(&self) -> NodeStatus {
        NodeStatus::default()
    }

    /// Ports to listen to: [`RESPONSES`] (required for answers to requests) and messages.
    fn ports(&self) -> &[Port] {
        &RESPONSES
    }

    /// Takes a message of one of the ports.
    fn message(&mut self, now: Instant, transfer: &Transfer<'_>) {
        let _ = (now, transfer);
    }

    /// Takes the end of a request: its answer, or the fact that there is no answer.
    fn answer(&mut self, now: Instant, ticket: Ticket, answer: Result<&Transfer<'_>, NoAnswer>);
}

/// Gives [`NodeCore`] the application of a host.
struct HostApp<'a, L> {
    listener: &'a mut L,
    client: &'a mut Requests,
}

impl<L: Listener> Application for HostApp<'_, L> {
    fn info(&self) -> NodeInfo<'_> {
        self.listener.info()
    }

    fn status(&self) -> NodeStatus {
        self.listener.status()
    }

    fn subscriptions(&self) -> &[Port] {
        self.listener.ports()
    }

    fn message(&mut self, now: Instant, transfer: &Transfer<'_>) {
        self.listener.message(now, transfer);
    }

    fn response(&mut self, now: Instant, transfer: &Transfer<'_>) {
        if let Some(ticket) = self.client.answered(transfer) {
            self.listener.answer(now, ticket, Ok(transfer));
        }
    }
}

/// Host node; about 60 KiB, so not for a small controller.
#[derive(Clone, Debug)]
pub struct CyphalHost<L> {
    core: Core,
    client: Requests,
    /// Receives what arrives.
    pub listener: L,
}

impl<L: Listener> CyphalHost<L> {
    /// Host with this address, started at `now`.
    pub const fn new(now: Instant, address: NodeId, listener: L) -> Self {
        Self { core: Core::new(now, address), client: Requests::new(address), listener }
    }

    /// Gives the node another address. Call it before the first frame.
    pub const fn set_address(&mut self, address: NodeId) {
        self.core.set_address(address);
        self.client.set_address(address);
    }

    /// The standard part, for its counters.
    pub const fn core(&self) -> &Core {
        &self.core
    }

    /// The table of requests, for its counters.
    pub const fn client(&self) -> &Requests {
        &self.client
    }

    /// Sends a request to a server; its end comes through [`Listener::answer`].
    ///
    /// The runner must afterwards drain [`Node::poll_frame`] as after any input.
    pub fn request(
        &mut self,
        now: Instant,
        server: NodeId,
        service: ServiceId,
        policy: Policy,
        request: &dyn Encode,
    ) -> Result<Ticket, StartError> {
        let ticket = self.client.start(now, server, service, policy, request)?;
        self.drive(now);
        Ok(ticket)
    }

    /// Forgets a request.
    pub fn cancel(&mut self, ticket: Ticket) {
        self.client.cancel(ticket);
    }

    /// Sends the heartbeat more often than once a second; see [`NodeCore::set_heartbeat_period`]. A
    /// controller that is armed stops when the heartbeat of its host is older than its limit (100 ms
    /// by default).
    pub fn set_heartbeat_period(&mut self, period: Duration) {
        self.core.set_heartbeat_period(period);
    }

    /// Sends a message.
    pub fn publish(
        &mut self,
        now: Instant,
        publication: &mut Publication,
        message: &dyn Encode,
    ) -> Result<(), SendError> {
        self.core.publish(now, publication, message)
    }

    /// Sends or gives up requests that are due. Bounded: each request is due at most twice in a row, once to be
    /// given up or sent, never again at the same time.
    fn drive(&mut self, now: Instant) {
        let Self { core, client, listener } = self;
        for _ in 0..2 * REQUESTS_MAX {
            match client.poll(now, &mut |meta, request| core.send(meta, request)) {
                Polled::Idle => return,
                Polled::Sent => {}
                Polled::GaveUp(ticket, failed) => listener.answer(now, ticket, Err(failed)),
            }
        }
    }
}

impl<L: Listener> Node for CyphalHost<L> {
    fn handle_frame(&mut self, now: Instant, frame: &Frame) {
        let Self { core, client, listener } = self;
        core.handle_frame(now, frame, &mut HostApp { listener, client });
    }

    fn handle_timeout(&mut self, now: Instant) {
        let Self { core, client, listener } = self;
        core.handle_timeout(now, &HostApp { listener, client });
        self.drive(now);
    }

    fn poll_frame(&mut self) -> Option<Frame> {
        self.core.poll_frame()
    }

    fn poll_timeout(&self) -> Option<Instant> {
        let core = self.core.poll_timeout();
        Some(self.client.poll_timeout().map_or(core, |client| client.min(core)))
    }
}

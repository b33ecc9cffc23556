//! Where clients come from, and the node that stands for them on the simulated bus.

use std::collections::VecDeque;

use can_link::{BusServer, BusSpec, CanLink, ClientId, Clock, LinkError, LinkEvent, OpenError};
use can_link::{Relay, ServerEvent, ServerOptions};
use protocol::powercube::{Address, Channel};
use protocol::{Duration, Frame, Instant, ModuleId, Node};

/// A request without answer is forgotten after this.
const REQUEST_AGE_MAX: Duration = Duration::from_secs(1);

/// Frames of one client that can wait in the gateway; beyond that nothing more is read from the client.
pub(super) const CLIENT_BACKLOG_MAX: usize = 64;
/// Frames of the gateway at the simulated bus: the one that is sent, or waits for its arbitration. The next one is
/// chosen when it has been sent, and follows without a gap.
pub(super) const AT_BUS_MAX: usize = 1;

/// The node for all clients of one endpoint (the port of a link).
///
/// Each client has a queue of its own, as with an adapter of its own: the first frames of all queues arbitrate, and
/// those of one id are sent in rotation. A client that floods delays frames of higher priority by at most the frame
/// that is being sent.
#[derive(Clone, Debug, Default)]
pub struct Gateway {
    lanes: Vec<Lane>,
    next_lane: usize,
    /// Who sent the frames that wait at the simulated bus, in order.
    at_bus: VecDeque<(Option<ClientId>, Frame)>,
    pub(super) received: Vec<(Instant, Frame)>,
}

/// Frames of one client; `None`: all nodes of a bus that was joined.
#[derive(Clone, Debug)]
struct Lane {
    client: Option<ClientId>,
    frames: VecDeque<Frame>,
}

impl Gateway {
    pub(super) fn take(&mut self, client: Option<ClientId>, frame: Frame) {
        match self.lanes.iter_mut().find(|lane| lane.client == client) {
            Some(lane) => lane.frames.push_back(frame),
            None => self.lanes.push(Lane { client, frames: VecDeque::from([frame]) }),
        }
    }

    pub(super) fn waiting(&self) -> Vec<(Option<ClientId>, usize)> {
        self.lanes.iter().map(|lane| (lane.client, lane.frames.len())).collect()
    }

    /// Who sent `frame`, which was on the bus just now.
    pub(super) fn sender_of(&mut self, frame: &Frame) -> Option<ClientId> {
        let index = self.at_bus.iter().position(|(_, sent)| sent == frame)?;
        self.at_bus.remove(index).and_then(|(client, _)| client)
    }

    /// Nothing waits at the bus: what is still listed there was thrown away by a fault.
    pub(super) fn forget_lost(&mut self) {
        self.at_bus.clear();
    }
}

impl Node for Gateway {
    fn handle_frame(&mut self, now: Instant, frame: &Frame) {
        self.received.push((now, *frame));
    }

    fn handle_timeout(&mut self, _: Instant) {}

    fn poll_frame(&mut self) -> Option<Frame> {
        // A client without frames leaves the rotation; it comes back at its end.
        self.lanes.retain(|lane| !lane.frames.is_empty());
        if self.next_lane >= self.lanes.len() {
            self.next_lane = 0;
        }
        let count = self.lanes.len();
        let turns = (0..count).map(|step| (self.next_lane + step) % count);
        // The first of equal keys.
        let first =
            turns.min_by_key(|index| self.lanes[*index].frames.front().map(Frame::arbitration_key))?;
        let lane = self.lanes.get_mut(first)?;
        let frame = lane.frames.pop_front()?;
        self.at_bus.push_back((lane.client, frame));
        self.next_lane = first + 1;
        Some(frame)
    }

    fn poll_timeout(&self) -> Option<Instant> {
        None
    }
}

/// Where the clients are.
pub enum Endpoint {
    /// We are the bus: clients come and go.
    Server(Box<dyn BusServer + Send>),
    /// We join a bus that exists.
    Member(Box<dyn CanLink + Send>),
}

impl Endpoint {
    /// Joins the interface that `spec` names; serves everything else.
    ///
    /// # Errors
    ///
    /// The interface or the place is not available.
    pub fn open(spec: &BusSpec, clock: Clock) -> Result<Self, OpenError> {
        match spec {
            BusSpec::SocketCan { .. } => can_link::open(spec, clock).map(Self::Member),
            _ => {
                let options = ServerOptions { relay: Relay::ByOwner, ..ServerOptions::default() };
                can_link::serve(spec, clock, options).map(Self::Server)
            }
        }
    }

    /// The link as a person would name it.
    pub fn name(&self) -> &str {
        self.link().name()
    }

    /// Connected clients; one for a bus that was joined.
    pub fn clients(&self) -> usize {
        match self {
            Self::Server(server) => server.client_count(),
            Self::Member(_) => 1,
        }
    }

    pub(super) fn link(&self) -> &dyn CanLink {
        match self {
            Self::Server(server) => server,
            Self::Member(link) => link,
        }
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Visit {
    /// A client came.
    Joined(String),
    /// A client asked for lock step. The number is its place in the order of turns, from 1.
    InStep(usize),
    /// A client went, and why.
    Left(&'static str),
}

/// How many frames each client may still queue in the gateway.
pub(super) struct Room {
    /// Clients that have frames there already.
    taken: Vec<(Option<ClientId>, usize)>,
}

impl Room {
    pub(super) const fn beside(taken: Vec<(Option<ClientId>, usize)>) -> Self {
        Self { taken }
    }

    pub(super) fn is_for(&self, client: Option<ClientId>) -> bool {
        self.taken.iter().all(|(other, waiting)| *other != client || *waiting < CLIENT_BACKLOG_MAX)
    }

    pub(super) fn use_one(&mut self, client: Option<ClientId>) {
        match self.taken.iter_mut().find(|(other, _)| *other == client) {
            Some((_, waiting)) => *waiting += 1,
            None => self.taken.push((client, 1)),
        }
    }
}

/// An endpoint (the port of a link) with its frames in progress.
pub(super) struct Port {
    pub(super) endpoint: Endpoint,
    /// Frames of this endpoint's clients that were on the bus, for its other clients.
    pub(super) own: Vec<(Instant, Option<ClientId>, Frame)>,
    /// What clients beside lock step sent.
    pub(super) unasked: Vec<(ClientId, Frame)>,
    /// A bus that was joined brings more than the simulated one carries.
    pub(super) is_full: bool,
    /// When each module got its requests through this endpoint, by address.
    requests: Vec<VecDeque<Instant>>,
    pub(super) visits: Vec<Visit>,
    /// Frames that the link did not take.
    pub(super) lost: u64,
}

impl Port {
    pub(super) fn new(endpoint: Endpoint) -> Self {
        Self {
            endpoint,
            own: Vec::new(),
            unasked: Vec::new(),
            is_full: false,
            requests: vec![VecDeque::new(); usize::from(ModuleId::MAX.get()) + 1],
            visits: Vec::new(),
            lost: 0,
        }
    }

    /// Next frame of a client that has room for it in the gateway; joins and leaves are kept as visits.
    pub(super) fn next_frame(&mut self, room: &Room) -> Result<Option<(Option<ClientId>, Frame)>, LinkError> {
        loop {
            match &mut self.endpoint {
                Endpoint::Server(server) => match server
                    .next_event_from(&mut |client| room.is_for(Some(client)))
                {
                    None => return Ok(None),
                    Some(ServerEvent::Joined { peer, .. }) => self.visits.push(Visit::Joined(peer)),
                    Some(ServerEvent::Left { reason, .. }) => self.visits.push(Visit::Left(reason)),
                    Some(ServerEvent::Frame { client, frame, .. }) => return Ok(Some((Some(client), frame))),
                    // Refused in real time.
                    Some(ServerEvent::InStep { .. } | ServerEvent::Waits { .. }) => {}
                },
                Endpoint::Member(_) if !room.is_for(None) => return Ok(None),
                Endpoint::Member(link) => match link.receive()? {
                    None => return Ok(None),
                    Some(LinkEvent::BusError { .. }) => {}
                    Some(LinkEvent::Frame { frame, .. }) => return Ok(Some((None, frame))),
                },
            }
        }
    }

    /// The link, if something that arrives there now can be accepted: waiting for other input would only end the
    /// sleep again and again. A server separates its clients by itself.
    pub(super) fn waits_for(&self) -> Option<&dyn CanLink> {
        match &self.endpoint {
            Endpoint::Member(_) if self.is_full => None,
            endpoint => Some(endpoint.link()),
        }
    }

    /// Notes that a client's frame was queued at the simulated bus.
    pub(super) fn note_request(&mut self, frame: &Frame, now: Instant) {
        if let Some(Address::Module(Channel::Get | Channel::Put, module)) = Address::of(frame.id()) {
            let open = &mut self.requests[usize::from(module.get())];
            open.push_back(now);
            while open.front().is_some_and(|at| now.saturating_since(*at) > REQUEST_AGE_MAX) {
                open.pop_front();
            }
        }
    }

    /// When the request that `frame` answers was queued, if it came through this endpoint.
    pub(super) fn asked_at(&mut self, frame: &Frame) -> Option<Instant> {
        match Address::of(frame.id()) {
            Some(Address::Module(Channel::Ack, module)) => {
                self.requests[usize::from(module.get())].pop_front()
            }
            _ => None,
        }
    }

    /// A frame of another node was on the bus at `at`.
    pub(super) fn put(&mut self, at: Instant, frame: &Frame) {
        match &mut self.endpoint {
            Endpoint::Server(server) => server.broadcast(at, frame, None),
            Endpoint::Member(link) => self.lost += u64::from(link.send(frame).is_err()),
        }
    }

    /// A client's frame has been on the bus: the other clients of this endpoint see it now.
    pub(super) fn put_own(&mut self, at: Instant, client: Option<ClientId>, frame: &Frame) {
        if let Endpoint::Server(server) = &mut self.endpoint {
            server.broadcast(at, frame, client);
        }
    }

    /// An error of the bus, by its class of Linux `can/error.h`.
    pub(super) fn put_error(&mut self, at: Instant, class: u32) {
        if let Endpoint::Server(server) = &mut self.endpoint {
            server.broadcast_bus_error(at, class);
        }
    }
}

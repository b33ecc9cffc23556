//! Where clients come from, and the node that stands for them on the simulated bus.

use std::collections::VecDeque;

use can_link::{BusServer, BusSpec, ClientId, Clock, Event, Link, LinkError, OpenError};
use can_link::{Relay, ServerEvent, ServerOptions};
use protocol::powercube::{Address, Channel};
use protocol::{Duration, Frame, Instant, ModuleId, Node};

/// A request without answer is forgotten after this.
const REQUEST_AGE_MAX: Duration = Duration::from_secs(1);

/// The node that stands for everybody behind one door.
#[derive(Clone, Debug, Default)]
pub struct Gateway {
    pub(super) out: VecDeque<Frame>,
    pub(super) received: Vec<(Instant, Frame)>,
}

impl Node for Gateway {
    fn handle_frame(&mut self, now: Instant, frame: &Frame) {
        self.received.push((now, *frame));
    }

    fn handle_timeout(&mut self, _: Instant) {}

    fn poll_frame(&mut self) -> Option<Frame> {
        self.out.pop_front()
    }

    fn poll_timeout(&self) -> Option<Instant> {
        None
    }
}

/// Where the clients are.
pub enum Door {
    /// We are the bus: clients come and go.
    Server(Box<dyn BusServer + Send>),
    /// We join a bus that exists.
    Member(Box<dyn Link + Send>),
}

impl Door {
    /// Joins the interface that `spec` names; serves everything else.
    ///
    /// # Errors
    ///
    /// The interface or the place cannot be had.
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

    pub(super) fn link(&self) -> &dyn Link {
        match self {
            Self::Server(server) => server,
            Self::Member(link) => link,
        }
    }
}

/// What comes in through a door.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Visit {
    /// A client came.
    Joined(String),
    /// A client went, and why.
    Left(&'static str),
}

/// A door with what is under way through it.
pub(super) struct Port {
    pub(super) door: Door,
    /// Who sent the frames that wait at the simulated bus, in order.
    senders: VecDeque<(Option<ClientId>, Frame)>,
    /// Frames of this door's clients that were on the bus, for its other clients.
    pub(super) own: Vec<(Instant, Frame)>,
    /// When each module was asked through this door, by address.
    requests: Vec<VecDeque<Instant>>,
    pub(super) visits: Vec<Visit>,
    /// Frames that the link did not take.
    pub(super) lost: u64,
}

impl Port {
    pub(super) fn new(door: Door) -> Self {
        Self {
            door,
            senders: VecDeque::new(),
            own: Vec::new(),
            requests: vec![VecDeque::new(); usize::from(ModuleId::MAX.get()) + 1],
            visits: Vec::new(),
            lost: 0,
        }
    }

    /// Frames of clients that have not been on the simulated bus yet.
    pub(super) fn backlog(&self) -> usize {
        self.senders.len()
    }

    /// What is still listed was thrown away by a fault.
    pub(super) fn forget_backlog(&mut self) {
        self.senders.clear();
    }

    /// Next frame of a client; comings and goings are kept as visits.
    pub(super) fn next_frame(&mut self) -> Result<Option<Frame>, LinkError> {
        loop {
            let (client, frame) = match &mut self.door {
                Door::Server(server) => match server.next_event() {
                    None => return Ok(None),
                    Some(ServerEvent::Joined { peer, .. }) => {
                        self.visits.push(Visit::Joined(peer));
                        continue;
                    }
                    Some(ServerEvent::Left { reason, .. }) => {
                        self.visits.push(Visit::Left(reason));
                        continue;
                    }
                    Some(ServerEvent::Frame { client, frame, .. }) => (Some(client), frame),
                },
                Door::Member(link) => match link.receive()? {
                    None => return Ok(None),
                    Some(Event::BusError { .. }) => continue,
                    Some(Event::Frame { frame, .. }) => (None, frame),
                },
            };
            self.senders.push_back((client, frame));
            return Ok(Some(frame));
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

    /// When the request that `frame` answers was queued, if it came through this door.
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
        match &mut self.door {
            Door::Server(server) => server.broadcast(at, frame, None),
            Door::Member(link) => self.lost += u64::from(link.send(frame).is_err()),
        }
    }

    /// A client's frame has been on the bus: the other clients of this door see it now.
    pub(super) fn put_own(&mut self, at: Instant, frame: &Frame) {
        let sender = self.senders.iter().position(|(_, sent)| sent == frame);
        let client = sender.and_then(|index| self.senders.remove(index)).and_then(|(client, _)| client);
        if let Door::Server(server) = &mut self.door {
            server.broadcast(at, frame, client);
        }
    }

    /// An error of the bus, by its class of Linux `can/error.h`.
    pub(super) fn put_error(&mut self, at: Instant, class: u32) {
        if let Door::Server(server) = &mut self.door {
            server.broadcast_bus_error(at, class);
        }
    }
}

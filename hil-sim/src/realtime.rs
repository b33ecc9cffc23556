//! The same world in real time, with a link of the operating system as one more node.
//!
//! ```text
//!   clients ── link ──▶ Gateway ──▶ simulated bus ──▶ drives
//!           ◀── link ── Gateway ◀── (bit times, arbitration, faults) ◀──
//! ```
//!
//! The world's clock follows the machine's: each turn runs it up to the present. A frame of a client is queued at
//! the simulated bus when it arrives, wins its arbitration, takes its bits, and is then seen by the drives and by
//! all other clients; answers come back the same way, after the drive's processing time. What the machine adds is
//! measured: how late frames leave ([`Realtime::lateness`]), and how long clients wait for answers.

use std::collections::VecDeque;
use std::io;

use can_link::{BusServer, ClientId, Clock, Event, Lateness, Link, LinkError, ServerEvent};
use protocol::powercube::{Address, Channel};
use protocol::{Duration, Frame, Instant, ModuleId, Node};

use crate::bus::ErrorKind;
use crate::crew::{Crew, Solo};
use crate::world::{Observer, RunError, World};

/// Frames of clients that can wait for the simulated bus; beyond it nothing more is read from the link.
const BACKLOG_MAX: usize = 1_024;
/// Longest sleep, so that the owner looks at its own business now and then.
const NAP_MAX: Duration = Duration::from_millis(50);
/// A request without answer is forgotten after this.
const REQUEST_AGE_MAX: Duration = Duration::from_secs(1);
/// Error classes of Linux `can/error.h`: protocol violation, no acknowledge, bus-off.
const CLASS_PROTOCOL: u32 = 0x08;
const CLASS_ACK: u32 = 0x20;
const CLASS_BUS_OFF: u32 = 0x40;

/// Why real time ended.
#[derive(Debug, thiserror::Error)]
pub enum RealtimeError {
    /// A node broke its contract.
    #[error(transparent)]
    Run(#[from] RunError),
    /// The link is gone.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// Waiting failed.
    #[error("cannot wait for the link: {0}")]
    Wait(#[from] io::Error),
}

/// The node that stands for everybody behind the link.
#[derive(Clone, Debug, Default)]
pub struct Gateway {
    out: VecDeque<Frame>,
    received: Vec<(Instant, Frame)>,
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
    /// The link as a person would name it.
    pub fn name(&self) -> &str {
        match self {
            Self::Server(server) => server.name(),
            Self::Member(link) => link.name(),
        }
    }

    /// Connected clients; one for a bus that was joined.
    pub fn clients(&self) -> usize {
        match self {
            Self::Server(server) => server.client_count(),
            Self::Member(_) => 1,
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

/// Frames that the gateway itself put on the bus, for the other clients; errors for all.
#[derive(Debug, Default)]
struct Seen {
    gateway: usize,
    own: Vec<(Instant, Frame)>,
    errors: Vec<(Instant, u32)>,
}

impl Observer for Seen {
    fn on_frame(&mut self, at: Instant, from: Option<usize>, frame: &Frame) {
        if from == Some(self.gateway) {
            self.own.push((at, *frame));
        }
    }

    fn on_error(&mut self, at: Instant, _: usize, kind: ErrorKind) {
        self.errors.push((at, if kind == ErrorKind::Ack { CLASS_ACK } else { CLASS_PROTOCOL }));
    }

    fn on_bus_off(&mut self, at: Instant, _: usize, off: bool) {
        if off {
            self.errors.push((at, CLASS_BUS_OFF));
        }
    }
}

/// A world that keeps up with the machine's clock.
pub struct Realtime<A> {
    world: World<(A, Solo<Gateway>)>,
    door: Door,
    clock: Clock,
    /// Who sent the frames that wait at the simulated bus, in order.
    senders: VecDeque<(Option<ClientId>, Frame)>,
    seen: Seen,
    requests: Vec<VecDeque<Instant>>,
    visits: Vec<Visit>,
    latency: Lateness,
    lateness: Lateness,
    lost: u64,
}

impl<A: Crew> Realtime<A> {
    /// Puts a world behind a door. The world must be new: its time 0 is the clock's.
    pub fn new(mut world: World<(A, Solo<Gateway>)>, door: Door, clock: Clock) -> Self {
        let gateway = world.crew().0.len();
        world.set_queue_depth(gateway, BACKLOG_MAX);
        Self {
            world,
            door,
            clock,
            senders: VecDeque::new(),
            seen: Seen { gateway, ..Seen::default() },
            requests: vec![VecDeque::new(); usize::from(ModuleId::MAX.get()) + 1],
            visits: Vec::new(),
            latency: Lateness::default(),
            lateness: Lateness::default(),
            lost: 0,
        }
    }

    /// The world, for reports and faults.
    pub fn world(&self) -> &World<(A, Solo<Gateway>)> {
        &self.world
    }

    /// The world, to add faults.
    pub fn world_mut(&mut self) -> &mut World<(A, Solo<Gateway>)> {
        &mut self.world
    }

    /// The door.
    pub fn door(&self) -> &Door {
        &self.door
    }

    /// Time from a client's request to the answer's leaving through the link.
    pub fn latency(&self) -> &Lateness {
        &self.latency
    }

    /// How late frames leave, against the time they had on the simulated bus: what the machine adds.
    pub fn lateness(&self) -> &Lateness {
        &self.lateness
    }

    /// Frames that the link did not take.
    pub fn lost(&self) -> u64 {
        self.lost
    }

    /// Clients that came and went since the last call.
    pub fn visits(&mut self) -> Vec<Visit> {
        std::mem::take(&mut self.visits)
    }

    /// One turn: take what came in, run up to the present, hand out, then sleep until something is due, `until` or
    /// 50 ms.
    pub fn turn(&mut self, until: Instant, observer: &mut impl Observer) -> Result<(), RealtimeError> {
        self.take_in(observer)?;
        let now = self.clock.now().max(self.world.now());
        self.world.run_until(now, &mut (&mut self.seen, &mut *observer))?;
        self.hand_out()?;
        let mut wake = until.min(self.clock.now() + NAP_MAX);
        if let Some(due) = self.world.next_wake() {
            wake = wake.min(due);
        }
        match &self.door {
            Door::Server(server) => can_link::wait(&[server as &dyn Link], &self.clock, Some(wake))?,
            Door::Member(link) => can_link::wait(&[link as &dyn Link], &self.clock, Some(wake))?,
        }
        Ok(())
    }

    fn take_in(&mut self, observer: &mut impl Observer) -> Result<(), RealtimeError> {
        while self.senders.len() < BACKLOG_MAX {
            let (client, frame) = match &mut self.door {
                Door::Server(server) => match server.next_event() {
                    None => return Ok(()),
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
                    None => return Ok(()),
                    Some(Event::BusError { .. }) => continue,
                    Some(Event::Frame { frame, .. }) => (None, frame),
                },
            };
            let now = self.clock.now().max(self.world.now());
            self.world.run_until(now, &mut (&mut self.seen, &mut *observer))?;
            self.world.with_crew(|crew, _| crew.1.node.out.push_back(frame))?;
            self.senders.push_back((client, frame));
            if let Some(Address::Module(Channel::Get | Channel::Put, module)) = Address::of(frame.id()) {
                let open = &mut self.requests[usize::from(module.get())];
                open.push_back(now);
                while open.front().is_some_and(|at| now.saturating_since(*at) > REQUEST_AGE_MAX) {
                    open.pop_front();
                }
            }
        }
        Ok(())
    }

    /// Passes on what happened on the simulated bus, in the order of its times.
    fn hand_out(&mut self) -> Result<(), RealtimeError> {
        let received = self.world.with_crew(|crew, _| std::mem::take(&mut crew.1.node.received))?;
        let mut own = std::mem::take(&mut self.seen.own).into_iter().peekable();
        let now = self.clock.now();
        for (at, frame) in received {
            while let Some((own_at, own_frame)) = own.next_if(|(own_at, _)| *own_at <= at) {
                self.pass_own(own_at, &own_frame);
            }
            self.note_answer(&frame, now);
            self.lateness.record(now.saturating_since(at));
            self.put(at, &frame, None);
        }
        for (at, frame) in own {
            self.pass_own(at, &frame);
        }
        for (at, class) in std::mem::take(&mut self.seen.errors) {
            if let Door::Server(server) = &mut self.door {
                server.broadcast_bus_error(at, class);
            }
        }
        if self.world.bus().queue(self.seen.gateway).is_empty() && self.world.bus().quiet_until_ns().is_none()
        {
            // Nothing of ours is under way: what is still listed was thrown away by a fault.
            self.senders.clear();
        }
        Ok(())
    }

    /// A client's frame has been on the bus: the other clients see it now.
    fn pass_own(&mut self, at: Instant, frame: &Frame) {
        let sender = self.senders.iter().position(|(_, sent)| sent == frame);
        let client = sender.and_then(|index| self.senders.remove(index)).and_then(|(client, _)| client);
        if let Door::Server(server) = &mut self.door {
            server.broadcast(at, frame, client);
        }
    }

    fn put(&mut self, at: Instant, frame: &Frame, except: Option<ClientId>) {
        match &mut self.door {
            Door::Server(server) => server.broadcast(at, frame, except),
            Door::Member(link) => self.lost += u64::from(link.send(frame).is_err()),
        }
    }

    fn note_answer(&mut self, frame: &Frame, now: Instant) {
        if let Some(Address::Module(Channel::Ack, module)) = Address::of(frame.id())
            && let Some(asked) = self.requests[usize::from(module.get())].pop_front()
        {
            self.latency.record(now.saturating_since(asked));
        }
    }
}

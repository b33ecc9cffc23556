//! The same world in real time, with links of the operating system as further nodes.
//!
//! ```text
//!   clients ── endpoint ──▶ Gateway ──▶ simulated bus ──▶ drives, gateways of the other endpoints
//!           ◀── endpoint ── Gateway ◀── (bit times, arbitration, faults) ◀──
//! ```
//!
//! The world's clock follows the machine's: each turn runs it up to the present. A frame of a client is queued at
//! the simulated bus when it arrives, wins its arbitration, takes its bits, and is then seen by the drives and by
//! all other clients; answers come back the same way, after the drive's processing time. Every endpoint (the port of a
//! link) is a node of its own, as an adapter on a real bus is. Endpoints arbitrate against each other, and so do the
//! clients of one endpoint. Each can have 64 frames queued, so a client that floods delays frames of higher priority by
//! one frame at most. Two delays of the machine are measured: how late frames leave ([`Realtime::lateness`]), and
//! how long clients wait for answers.

mod endpoint;
mod lockstep;

use std::io;

use can_link::{Clock, Lateness, LinkError};
use protocol::{Duration, Frame, Instant};

pub use endpoint::{Endpoint, Gateway, Visit};
pub use lockstep::{MixedTime, shared_time};

use crate::bus::{BusConfig, ErrorKind};
use crate::fault::Fault;
use crate::participants::{Participants, Solo};
use crate::world::{BuildError, Observer, RunError, World};
use endpoint::{AT_BUS_MAX, Port, Room};

/// Longest sleep, so that the owner can do its own work in between.
const NAP_MAX: Duration = Duration::from_millis(50);
/// A turn that begins this long after its time is counted as late: drives answer a third of that earlier or later anyway.
const LATE: Duration = Duration::from_millis(1);
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
    /// The link of a joined bus has failed.
    #[error(transparent)]
    Link(#[from] LinkError),
    #[error("cannot wait for the link: {0}")]
    Wait(#[from] io::Error),
}

impl RealtimeError {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        match self {
            Self::Link(error) => error.next(),
            Self::Run(_) | Self::Wait(_) => None,
        }
    }
}

/// Data for the endpoints: frames of gateways, for the other clients of the same endpoint; errors, for all.
#[derive(Debug, Default)]
struct Seen {
    /// Node of the first gateway; all further ones follow.
    first_gateway: usize,
    own: Vec<(usize, Instant, Frame)>,
    errors: Vec<(Instant, u32)>,
}

impl Observer for Seen {
    fn on_frame(&mut self, at: Instant, from: Option<usize>, frame: &Frame) {
        if let Some(port) = from.and_then(|node| node.checked_sub(self.first_gateway)) {
            self.own.push((port, at, *frame));
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
    world: World<(A, Vec<Solo<Gateway>>)>,
    ports: Vec<Port>,
    clock: Clock,
    seen: Seen,
    latency: Lateness,
    lateness: Lateness,
    /// When the next turn should begin.
    wake_at: Option<Instant>,
    lag: Lag,
    turns: u64,
    /// The world goes no further.
    end: Instant,
    /// An endpoint cannot carry the CAN FD frames of this bus: nothing runs.
    classical: Option<LinkError>,
    /// The clients share virtual time.
    lock_step: Option<lockstep::LockStep>,
}

/// How far the simulation fell behind the machine's clock: each turn begins when something is due, and what is due waits
/// until the machine lets the program run.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Lag {
    /// How late turns began that had something due.
    pub turns: Lateness,
    /// Those that were more than 1 ms late.
    pub late: u64,
    /// The worst since [`Realtime::take_worst_lag`] was last called.
    worst: Duration,
}

impl Lag {
    fn record(&mut self, late: Duration) {
        self.turns.record(late);
        self.late += u64::from(late > LATE);
        self.worst = self.worst.max(late);
    }
}

/// `0.3 ms at worst, 0 of 2000 turns more than 1 ms late`
impl std::fmt::Display for Lag {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let worst_ms = 1e3 * self.turns.max().unwrap_or_default().as_secs_f64();
        write!(
            f,
            "{worst_ms:.1} ms at worst, {} of {} turns more than 1 ms late",
            self.late,
            self.turns.count()
        )
    }
}

impl<A: Participants> Realtime<A> {
    /// Connects `participants` to a bus whose time 0 is that of `clock`, with a gateway behind each of `endpoints`.
    /// `seed` feeds the faults' random streams.
    pub fn new(
        participants: A,
        config: BusConfig,
        seed: u64,
        plan: Vec<Fault>,
        endpoints: Vec<Endpoint>,
        clock: Clock,
    ) -> Result<Self, BuildError> {
        let first_gateway = participants.len();
        let gateways =
            endpoints.iter().map(|endpoint| Solo::new(endpoint.name(), Gateway::default())).collect();
        let mut world = World::new((participants, gateways), config, seed, plan)?;
        for port in 0..endpoints.len() {
            world.keep_queue_short(first_gateway + port, AT_BUS_MAX);
        }
        let has_fd = world.bus().data_bit_rate_bit_s().is_some();
        let classical = endpoints.iter().filter(|_| has_fd).find_map(|own| own.link().takes_fd().err());
        Ok(Self {
            world,
            classical,
            ports: endpoints.into_iter().map(Port::new).collect(),
            clock,
            seen: Seen { first_gateway, ..Seen::default() },
            latency: Lateness::default(),
            lateness: Lateness::default(),
            wake_at: None,
            lag: Lag::default(),
            turns: 0,
            end: Instant::FAR_FUTURE,
            lock_step: None,
        })
    }

    /// The same in virtual time that all clients share; it stands while fewer than `clients_min` are connected. The
    /// clock is manual, and clients are at servers only.
    #[must_use]
    pub fn in_lock_step(self, clients_min: usize) -> Self {
        Self { lock_step: Some(lockstep::LockStep::new(clients_min)), ..self }
    }

    /// The same, of which the world stands from `end` on, however late the machine is.
    #[must_use]
    pub fn ending_at(self, end: Instant) -> Self {
        Self { end, ..self }
    }

    /// The world, for reports and faults.
    pub fn world(&self) -> &World<(A, Vec<Solo<Gateway>>)> {
        &self.world
    }

    /// The world, to add faults.
    pub fn world_mut(&mut self) -> &mut World<(A, Vec<Solo<Gateway>>)> {
        &mut self.world
    }

    pub fn endpoints(&self) -> impl Iterator<Item = &Endpoint> {
        self.ports.iter().map(|port| &port.endpoint)
    }

    /// Time from a client's request until the answer leaves through its endpoint. If two endpoints send a request to the
    /// same module at once, each may count the other's answer.
    pub fn latency(&self) -> &Lateness {
        &self.latency
    }

    /// How late frames leave, compared with their time on the simulated bus: the delay of the machine.
    pub fn lateness(&self) -> &Lateness {
        &self.lateness
    }

    /// How far the simulation fell behind the clock. It shows whether a missed answer of a drive was caused by the machine.
    pub const fn lag(&self) -> &Lag {
        &self.lag
    }

    /// Turns so far: how often the system was called to wait, or a client in lock step got its turn.
    pub const fn turns(&self) -> u64 {
        self.turns
    }

    /// The worst lag since the last call of this.
    pub const fn take_worst_lag(&mut self) -> Duration {
        std::mem::replace(&mut self.lag.worst, Duration::ZERO)
    }

    /// Frames that a joined bus did not take.
    pub fn lost(&self) -> u64 {
        self.ports.iter().map(|port| port.lost).sum()
    }

    /// Clients that joined and left since the last call, endpoint by endpoint.
    pub fn visits(&mut self) -> Vec<Visit> {
        self.ports.iter_mut().flat_map(|port| std::mem::take(&mut port.visits)).collect()
    }

    /// One turn: read the input, run up to the present, send the output, then sleep until something is due, `until`
    /// or 50 ms.
    ///
    /// # Errors
    ///
    /// A node broke its contract, the link of a joined bus has failed, or an endpoint cannot carry the CAN FD frames of this bus. A client
    /// that leaves is not an error.
    pub fn turn(&mut self, until: Instant, observer: &mut impl Observer) -> Result<(), RealtimeError> {
        if let Some(error) = &self.classical {
            return Err(error.clone().into());
        }
        if let Some(mut step) = self.lock_step.take() {
            let result = self.take_turns(&mut step, until.min(self.end), observer);
            self.lock_step = Some(step);
            return result;
        }
        self.turns += 1;
        let now = self.clock.now();
        // Woken by a client before the time, it is not late.
        if let Some(late) = self.wake_at.filter(|due| *due <= now).map(|due| now.saturating_since(due)) {
            self.lag.record(late);
        }
        for index in 0..self.ports.len() {
            self.take_in(index, observer)?;
        }
        self.catch_up(observer)?;
        self.hand_out()?;
        let mut wake = until.min(self.clock.now() + NAP_MAX);
        if let Some(due) = self.world.next_wake() {
            wake = wake.min(due);
        }
        self.wake_at = Some(wake);
        let links: Vec<_> = self.ports.iter().filter_map(Port::waits_for).collect();
        can_link::wait(&links, &self.clock, Some(wake))?;
        Ok(())
    }

    /// Runs the world up to the present and returns that.
    fn catch_up(&mut self, observer: &mut impl Observer) -> Result<Instant, RunError> {
        let now = self.clock.now().max(self.world.now()).min(self.end);
        self.world.run_until(now, &mut (&mut self.seen, &mut *observer))?;
        Ok(now)
    }

    /// Takes the frames that the clients of an endpoint have sent, as far as each has room in the gateway.
    fn take_in(&mut self, index: usize, observer: &mut impl Observer) -> Result<(), RealtimeError> {
        let gateway = |participants: &(A, Vec<Solo<Gateway>>)| participants.1[index].node.waiting();
        let mut room = Room::beside(gateway(self.world.participants()));
        while let Some((client, frame)) = self.ports[index].next_frame(&room)? {
            room.use_one(client);
            let now = self.catch_up(observer)?;
            self.world.with_participants(|participants, _| participants.1[index].node.take(client, frame))?;
            self.ports[index].note_request(&frame, now);
        }
        self.ports[index].is_full = !room.is_for(None);
        Ok(())
    }

    /// Passes on what happened on the simulated bus, in the order of its times.
    fn hand_out(&mut self) -> Result<(), RealtimeError> {
        let (own, ports) = (&mut self.seen.own, &mut self.ports);
        if !own.is_empty() {
            self.world.with_participants(|participants, _| {
                for (port, at, frame) in own.drain(..) {
                    let client = participants.1[port].node.sender_of(&frame);
                    ports[port].own.push((at, client, frame));
                }
            })?;
        }
        for index in 0..self.ports.len() {
            let received = self.world.with_participants(|participants, _| {
                std::mem::take(&mut participants.1[index].node.received)
            })?;
            let port = &mut self.ports[index];
            let mut own = std::mem::take(&mut port.own).into_iter().peekable();
            let now = self.clock.now();
            for (at, frame) in received {
                while let Some((own_at, client, own_frame)) = own.next_if(|(own_at, ..)| *own_at <= at) {
                    port.put_own(own_at, client, &own_frame);
                }
                if let Some(asked) = port.asked_at(&frame) {
                    self.latency.record(now.saturating_since(asked));
                }
                self.lateness.record(now.saturating_since(at));
                port.put(at, &frame);
            }
            for (at, client, frame) in own {
                port.put_own(at, client, &frame);
            }
        }
        for (at, class) in self.seen.errors.drain(..) {
            self.ports.iter_mut().for_each(|port| port.put_error(at, class));
        }
        self.forget_lost()
    }

    /// If the bus is idle, a frame that a gateway still counts as waiting was removed by a fault.
    fn forget_lost(&mut self) -> Result<(), RealtimeError> {
        let first = self.seen.first_gateway;
        let bus = self.world.bus();
        let waiting = (0..self.ports.len()).any(|index| !bus.queue(first + index).is_empty());
        if bus.quiet_until_ns().is_none() && !waiting {
            self.world.with_participants(|participants, _| {
                participants.1.iter_mut().for_each(|gateway| gateway.node.forget_lost());
            })?;
        }
        Ok(())
    }
}

//! Virtual time: joins bus, participants and faults into one deterministic run.
//!
//! # Order of events
//!
//! 1. Time, in microseconds. A bus event inside a microsecond is seen at its end.
//! 2. At one time: bus events, then faults, then delayed frames, then timers; among equals by the order in
//!    which they were put in, or by node index.
//! 3. A frame queued at time t takes part in the arbitration at t.
//!
//! Before anything of time t happens, the participants' physics is advanced to t.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use protocol::{Frame, Instant};

use crate::bus::{BitRateError, Bus, BusConfig, BusEvent, ErrorKind};
use crate::fault::{Action, Delivery, Engine, Fault, FaultKind, NotApplicable, Target, WireFault};
use crate::participants::{BusConnection, Participants};

/// Frames out of one event after which a node is flooding: far beyond any queue.
const FRAMES_PER_EVENT_MAX: u32 = 1_024;
/// Frames under delay at once.
const DELAYED_MAX: usize = 65_536;
const NANOS_PER_MICRO: u64 = 1_000;

/// Why a world could not be built.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BuildError {
    /// The bus refuses its options.
    #[error(transparent)]
    BitRate(#[from] BitRateError),
    /// More nodes than a bus has ports.
    #[error("{nodes} nodes (babbling ones included) on one bus, at most {max}")]
    TooManyNodes {
        nodes: usize,
        /// Ports of a bus.
        max: usize,
    },
    /// A fault names a module that is not there.
    #[error("fault {label}: no module {module} on this bus")]
    NoSuchModule { label: String, module: protocol::ModuleId },
    /// A fault names a place that is not there.
    #[error("fault {label}: {error}")]
    NoSuchPlace { label: String, error: NotApplicable },
}

/// Why a run stopped early: a node broke the contract of [`protocol::Node`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RunError {
    /// The deadline of a node has still come although it was served.
    #[error("{node} asks for a time-out at {deadline} s although it was served at {now} s")]
    Livelock {
        node: String,
        now: Instant,
        /// The deadline that does not move.
        deadline: Instant,
    },
    /// A node produces frames without end in one event.
    #[error("{node} sent more than {FRAMES_PER_EVENT_MAX} frames in one event at {now} s")]
    Flood { node: String, now: Instant },
    /// The cell refused a fault of the plan.
    #[error("at {now} s: {error}")]
    Fault {
        now: Instant,
        /// Reason that the cell gives.
        error: NotApplicable,
    },
}

/// Sees what happens on the bus, in order; times are those at which nodes see it.
pub trait Observer {
    /// A good frame; `from` is the node's index, `None` if the node has left the bus.
    fn on_frame(&mut self, at: Instant, from: Option<usize>, frame: &Frame);

    /// A node began an error flag.
    fn on_error(&mut self, at: Instant, node: usize, kind: ErrorKind) {
        let _ = (at, node, kind);
    }

    /// A node left the bus (true) or came back.
    fn on_bus_off(&mut self, at: Instant, node: usize, off: bool) {
        let _ = (at, node, off);
    }
}

/// An observer that does nothing.
impl Observer for () {
    fn on_frame(&mut self, _: Instant, _: Option<usize>, _: &Frame) {}
}

/// One after the other.
impl<A: Observer, B: Observer> Observer for (A, B) {
    fn on_frame(&mut self, at: Instant, from: Option<usize>, frame: &Frame) {
        self.0.on_frame(at, from, frame);
        self.1.on_frame(at, from, frame);
    }

    fn on_error(&mut self, at: Instant, node: usize, kind: ErrorKind) {
        self.0.on_error(at, node, kind);
        self.1.on_error(at, node, kind);
    }

    fn on_bus_off(&mut self, at: Instant, node: usize, off: bool) {
        self.0.on_bus_off(at, node, off);
        self.1.on_bus_off(at, node, off);
    }
}

impl<O: Observer + ?Sized> Observer for &mut O {
    fn on_frame(&mut self, at: Instant, from: Option<usize>, frame: &Frame) {
        (**self).on_frame(at, from, frame);
    }

    fn on_error(&mut self, at: Instant, node: usize, kind: ErrorKind) {
        (**self).on_error(at, node, kind);
    }

    fn on_bus_off(&mut self, at: Instant, node: usize, off: bool) {
        (**self).on_bus_off(at, node, off);
    }
}

/// A frame held back by a `delay` fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Delayed {
    at: Instant,
    sequence: u64,
    port: usize,
    frame: Frame,
}

impl Ord for Delayed {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        (self.at, self.sequence).cmp(&(other.at, other.sequence))
    }
}

impl PartialOrd for Delayed {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

/// How much was done, for benchmarks and reports.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct WorldStats {
    /// Frames that became valid on the bus.
    pub frames: u64,
    /// Frames handed to nodes.
    pub deliveries: u64,
    /// Deliveries lost to `drop` faults or because too many were under delay.
    pub lost: u64,
    /// Deliveries that came late because of `delay` faults.
    pub delayed: u64,
    /// Time-outs served.
    pub timeouts: u64,
}

/// A bus with its participants, its faults and a clock of its own.
///
/// # Calling order
///
/// [`World::run_until`] as often as needed, with times that never decrease; between two calls
/// [`World::with_participants`] lets a program act on its own nodes, and then takes all frames that they want to
/// send. The result depends on the times of these calls only as far as they change something.
#[derive(Debug)]
pub struct World<C> {
    participants: C,
    bus: Bus,
    faults: Engine,
    now: Instant,
    /// Microseconds, `u64::MAX` for no deadline; one per participant.
    deadlines: Vec<u64>,
    links: Vec<BusConnection>,
    /// A node may give its next frame only while fewer of its own wait at the bus.
    asked_below: Vec<usize>,
    /// Ports cut off by an intermittent contact, in addition to those that the participants report as disconnected.
    unplugged: u64,
    delayed: BinaryHeap<Reverse<Delayed>>,
    sequence: u64,
    actions: Vec<Action>,
    stats: WorldStats,
    started: bool,
    /// Port of the spare babbler for faults added during the run.
    spare_babbler: usize,
}

impl<C: Participants> World<C> {
    /// A world at time 0 in which nothing has happened. `seed` feeds the faults' random streams.
    pub fn new(
        mut participants: C,
        config: BusConfig,
        seed: u64,
        plan: Vec<Fault>,
    ) -> Result<Self, BuildError> {
        let babblers = plan.iter().filter(|fault| is_babble(fault)).count();
        // One port more, so that a fault given during the run can babble too.
        let ports = participants.len() + babblers + 1;
        if ports > crate::bus::medium::PORTS_MAX {
            return Err(BuildError::TooManyNodes { nodes: ports, max: crate::bus::medium::PORTS_MAX });
        }
        plan.iter().try_for_each(|fault| place_of(&mut participants, fault).map(drop))?;
        let data_bit_rate_bit_s = config.data_bit_rate_bit_s.or(participants.data_bit_rate_bit_s());
        let mut bus = Bus::new(BusConfig { data_bit_rate_bit_s, ..config }, ports)?;
        let own = |port| Some((port, participants.tx_order(port)?));
        (0..participants.len()).filter_map(own).for_each(|(port, order)| bus.set_tx_order(port, order));
        (participants.len()..ports).for_each(|port| bus.set_attached(port, false, 0));
        let mut faults = Engine::new(seed, plan);
        let mut babbler = participants.len();
        faults.bind(|fault| {
            if is_babble(fault) {
                babbler += 1;
                return Some(babbler - 1);
            }
            match fault.target {
                Target::Module(module) => port_of(&participants, module),
                _ => None,
            }
        });
        Ok(Self {
            deadlines: vec![u64::MAX; participants.len()],
            links: vec![BusConnection::On; participants.len()],
            asked_below: vec![usize::MAX; participants.len()],
            participants,
            bus,
            faults,
            now: Instant::ZERO,
            unplugged: 0,
            delayed: BinaryHeap::new(),
            sequence: 0,
            actions: Vec::new(),
            stats: WorldStats::default(),
            started: false,
            spare_babbler: ports - 1,
        })
    }

    // Getters.

    pub fn now(&self) -> Instant {
        self.now
    }

    pub fn bus(&self) -> &Bus {
        &self.bus
    }

    pub fn participants(&self) -> &C {
        &self.participants
    }

    pub fn faults(&self) -> &Engine {
        &self.faults
    }

    /// What was done so far.
    pub fn stats(&self) -> WorldStats {
        self.stats
    }

    /// What people call the node at a port, babblers included.
    pub fn name(&self, port: usize) -> std::borrow::Cow<'_, str> {
        if port < self.participants.len() {
            self.participants.name(port)
        } else {
            format!("babbler {}", port - self.participants.len() + 1).into()
        }
    }

    /// Figures of the bus, with the names of the nodes; babblers only if they ever sent.
    pub fn bus_report(&self) -> crate::bus::report::BusReport {
        let mut report = crate::bus::report::BusReport::new(&self.bus, |port| self.name(port));
        let participants = self.participants.len();
        let mut index = 0;
        report.nodes.retain(|row| {
            index += 1;
            index <= participants || row.sent + row.dropped > 0
        });
        report
    }

    /// Earliest due time, apart from frames in flight; for real-time runners.
    pub fn next_due(&self) -> Option<Instant> {
        let mut next = Instant::FAR_FUTURE.min(self.next_deadline());
        if let Some(change) = self.faults.next_change() {
            next = next.min(change);
        }
        if let Some(Reverse(first)) = self.delayed.peek() {
            next = next.min(first.at);
        }
        (next != Instant::FAR_FUTURE).then_some(next)
    }

    /// As [`World::next_due`], with frames under way: when to call [`World::run_until`] next in real time.
    pub fn next_wake(&self) -> Option<Instant> {
        let bus = self.bus.quiet_until_ns().map(|ns| Instant::from_micros(ns.div_ceil(NANOS_PER_MICRO)));
        match (self.next_due(), bus) {
            (Some(a), Some(b)) => Some(a.min(b)),
            (a, b) => a.or(b),
        }
    }

    // Inputs.

    /// Changes how many frames can wait in one node.
    pub fn set_queue_depth(&mut self, node: usize, depth: usize) {
        self.bus.set_queue_depth(node, depth);
    }

    /// From now on the node keeps its frames itself: it may give the next one only while fewer than `waiting_max`
    /// of them wait at the bus, and again when one has been sent.
    pub fn keep_queue_short(&mut self, node: usize, waiting_max: usize) {
        self.asked_below[node] = waiting_max.max(1);
    }

    /// Acts on the participants at the present time, then takes what its nodes want to send.
    pub fn with_participants<R>(&mut self, act: impl FnOnce(&mut C, Instant) -> R) -> Result<R, RunError> {
        self.participants.advance(self.now);
        let result = act(&mut self.participants, self.now);
        self.settle_all()?;
        Ok(result)
    }

    /// The participants, for a program that acts on a node of its own between two runs. What the node wants to send then is taken by
    /// [`World::take_from`].
    pub fn participants_mut(&mut self) -> &mut C {
        &mut self.participants
    }

    /// Takes the frames and the deadline of one node that was changed through [`World::participants_mut`].
    pub fn take_from(&mut self, node: usize) -> Result<(), RunError> {
        self.settle(node)
    }

    /// Adds a fault from now on.
    pub fn add_fault(&mut self, fault: Fault) -> Result<(), BuildError> {
        let place = place_of(&mut self.participants, &fault)?;
        let port = if is_babble(&fault) { Some(self.spare_babbler) } else { place };
        self.faults.add(fault, self.now, port);
        Ok(())
    }

    /// The faults, to time them by a throw.
    pub fn faults_mut(&mut self) -> &mut Engine {
        &mut self.faults
    }

    /// Lets a node in bus-off begin to recover, for buses that recover on request.
    pub fn request_recovery(&mut self, node: usize) {
        self.bus.request_recovery(node, self.now.as_micros() * NANOS_PER_MICRO);
    }

    /// Runs to `end` and does everything due at or before it.
    pub fn run_until(&mut self, end: Instant, observer: &mut impl Observer) -> Result<(), RunError> {
        if !self.started {
            self.started = true;
            self.settle_all()?;
        }
        loop {
            let due = self.next_due().unwrap_or(Instant::FAR_FUTURE).max(self.now);
            let limit = due.min(end);
            let limit_ns = limit.as_micros().saturating_mul(NANOS_PER_MICRO);
            if let Some(event) = self.bus.run_until(limit_ns, &mut self.faults) {
                let at = Instant::from_micros(event.at_ns().div_ceil(NANOS_PER_MICRO));
                self.now = self.now.max(at);
                self.handle_bus_event(event, observer)?;
                continue;
            }
            self.now = self.now.max(limit);
            if due > end {
                return Ok(());
            }
            self.participants.advance(self.now);
            self.serve_faults()?;
            self.serve_delayed()?;
            self.serve_timers()?;
        }
    }

    // Private.

    fn next_deadline(&self) -> Instant {
        Instant::from_micros(self.deadlines.iter().copied().min().unwrap_or(u64::MAX))
    }

    fn handle_bus_event(&mut self, event: BusEvent, observer: &mut impl Observer) -> Result<(), RunError> {
        match event {
            BusEvent::Frame { from, frame, receivers, .. } => {
                self.stats.frames += 1;
                let from = from.filter(|port| *port < self.participants.len());
                observer.on_frame(self.now, from, &frame);
                self.participants.advance(self.now);
                if let Some(sender) = from.filter(|sender| self.asked_below[*sender] < usize::MAX) {
                    // This frame stays in the queue until its last bit; the next one must be there before the intermission ends.
                    let most = (self.asked_below[sender] + 1).min(self.bus.queue(sender).depth());
                    self.settle_below(sender, most)?;
                }
                self.deliver(&frame, receivers)
            }
            BusEvent::Error { port, kind, .. } => {
                observer.on_error(self.now, port, kind);
                Ok(())
            }
            BusEvent::BusOff { port, .. } => {
                observer.on_bus_off(self.now, port, true);
                Ok(())
            }
            BusEvent::Joined { port, .. } => {
                observer.on_bus_off(self.now, port, false);
                Ok(())
            }
        }
    }

    fn deliver(&mut self, frame: &Frame, receivers: u64) -> Result<(), RunError> {
        let mut receivers = receivers & (u64::MAX >> (64 - self.participants.len().max(1)));
        if self.participants.is_empty() {
            return Ok(());
        }
        if self.faults.acts_on_delivery() {
            receivers = self.sift(frame, receivers);
        }
        while receivers != 0 {
            let port = receivers.trailing_zeros() as usize;
            receivers &= receivers - 1;
            self.hand_over(port, frame)?;
        }
        Ok(())
    }

    /// Takes out the receivers that get the frame late or never.
    fn sift(&mut self, frame: &Frame, receivers: u64) -> u64 {
        let mut now_set = 0;
        let (now, stats) = (self.now, &mut self.stats);
        let (delayed, sequence) = (&mut self.delayed, &mut self.sequence);
        self.faults.deliveries(frame, receivers, |port, delivery| match delivery {
            Delivery::Now => now_set |= 1 << port,
            Delivery::Later(by) if delayed.len() < DELAYED_MAX => {
                *sequence += 1;
                delayed.push(Reverse(Delayed { at: now + by, sequence: *sequence, port, frame: *frame }));
                stats.delayed += 1;
            }
            Delivery::Later(_) | Delivery::Never => stats.lost += 1,
        });
        now_set
    }

    fn hand_over(&mut self, port: usize, frame: &Frame) -> Result<(), RunError> {
        if !self.participants.accepts(port, frame) {
            return Ok(());
        }
        self.stats.deliveries += 1;
        self.participants.node(port).handle_frame(self.now, frame);
        self.settle(port)
    }

    fn serve_faults(&mut self) -> Result<(), RunError> {
        if self.faults.next_change().is_none_or(|change| change > self.now) {
            return Ok(());
        }
        let now_ns = self.now.as_micros() * NANOS_PER_MICRO;
        let mut actions = std::mem::take(&mut self.actions);
        self.faults.step(self.now, &mut actions);
        let mut physical = false;
        for action in actions.drain(..) {
            match action {
                Action::Attach { port, attached } => {
                    self.unplugged = self.unplugged & !(1 << port) | u64::from(!attached) << port;
                    let powered = self.links.get(port).is_none_or(|link| *link == BusConnection::On);
                    self.bus.set_attached(port, attached && powered, now_ns);
                }
                Action::BusOff { port } => self.bus.force_bus_off(port, now_ns),
                Action::HoldDominant(held) => self.bus.hold_dominant(held),
                Action::Send { port, frame } => {
                    self.bus.send(port, frame, now_ns);
                }
                Action::Begin(place, fault) => {
                    physical = true;
                    let begun = match self.participants.physics() {
                        Some(target) => target.begin_fault(self.now, place, &fault),
                        None => Err(NotApplicable {
                            what: fault.name(),
                            place,
                            why: "no drive or arm is simulated",
                        }),
                    };
                    begun.map_err(|error| RunError::Fault { now: self.now, error })?;
                }
                Action::End(place, fault) => {
                    physical = true;
                    if let Some(target) = self.participants.physics() {
                        target.end_fault(self.now, place, &fault);
                    }
                }
            }
        }
        self.actions = actions;
        if physical { self.settle_all() } else { Ok(()) }
    }

    fn serve_delayed(&mut self) -> Result<(), RunError> {
        while let Some(Reverse(first)) = self.delayed.peek()
            && first.at <= self.now
        {
            let Some(Reverse(Delayed { port, frame, .. })) = self.delayed.pop() else { break };
            self.hand_over(port, &frame)?;
        }
        Ok(())
    }

    fn serve_timers(&mut self) -> Result<(), RunError> {
        for index in 0..self.deadlines.len() {
            if self.deadlines[index] > self.now.as_micros() {
                continue;
            }
            self.stats.timeouts += 1;
            self.participants.node(index).handle_timeout(self.now);
            self.settle(index)?;
            // As in the loop of a live bus: one call serves everything that is due.
            if self.deadlines[index] <= self.now.as_micros() {
                return Err(RunError::Livelock {
                    node: self.participants.name(index).into_owned(),
                    now: self.now,
                    deadline: Instant::from_micros(self.deadlines[index]),
                });
            }
        }
        Ok(())
    }

    fn settle_all(&mut self) -> Result<(), RunError> {
        (0..self.participants.len()).try_for_each(|index| self.settle(index))
    }

    /// After each event of a node: takes its frames, its deadline and its connection.
    fn settle(&mut self, index: usize) -> Result<(), RunError> {
        self.settle_below(index, self.asked_below[index])
    }

    fn settle_below(&mut self, index: usize, waiting_max: usize) -> Result<(), RunError> {
        let now_ns = self.now.as_micros() * NANOS_PER_MICRO;
        let node = self.participants.node(index);
        let mut count = 0;
        while self.bus.queue(index).len() < waiting_max
            && let Some(frame) = node.poll_frame()
        {
            count += 1;
            if count > FRAMES_PER_EVENT_MAX {
                return Err(RunError::Flood {
                    node: self.participants.name(index).into_owned(),
                    now: self.now,
                });
            }
            if let Some(frame) = self.faults.outgoing(index, frame) {
                self.bus.send(index, frame, now_ns);
            }
        }
        self.deadlines[index] = node.poll_timeout().map_or(u64::MAX, Instant::as_micros);
        let link = self.participants.connection(index);
        if link != self.links[index] {
            self.links[index] = link;
            let attached = link == BusConnection::On && self.unplugged >> index & 1 == 0;
            self.bus.set_attached(index, attached, now_ns);
        }
        Ok(())
    }
}

fn is_babble(fault: &Fault) -> bool {
    matches!(fault.kind, FaultKind::Wire(WireFault::Babble { .. }))
}

/// The port of the module that a fault is for, if it is for one; an error if there is no such module, supply or gripper.
fn place_of(participants: &mut impl Participants, fault: &Fault) -> Result<Option<usize>, BuildError> {
    if let Target::Module(module) = fault.target {
        let port = port_of(participants, module);
        return port.map(Some).ok_or_else(|| BuildError::NoSuchModule { label: fault.label.clone(), module });
    }
    if let FaultKind::Physical(place, physical) = &fault.kind
        && let Some(why) = participants.physics().and_then(|cell| cell.lacks(*place))
    {
        let error = NotApplicable { what: physical.name(), place: *place, why };
        return Err(BuildError::NoSuchPlace { label: fault.label.clone(), error });
    }
    Ok(None)
}

fn port_of(participants: &impl Participants, module: protocol::ModuleId) -> Option<usize> {
    (0..participants.len()).find(|index| participants.module(*index) == Some(module))
}

//! Executes a plan: starts and ends faults, and decides for each frame whether it is changed, lost or delayed.

use std::mem::discriminant;

use protocol::powercube::{Address, Channel};
use protocol::{Duration, Frame, Instant};

use super::physical::{PhysicalFault, Place};
use super::plan::{Fault, FaultKind, Target, WireFault, WrongPart};
use crate::bus::{Disturbance, Wire};
use crate::rng::Rng;

/// Shortest time of an intermittent contact in one position: below this it would change within a bit.
const DWELL_MIN: Duration = Duration::from_micros(10);

/// What the world has to do because a fault started or ended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Action {
    /// Connect or disconnect a port.
    Attach { port: usize, attached: bool },
    /// Put a port into bus-off.
    BusOff { port: usize },
    /// Hold the line dominant, or let go.
    HoldDominant(bool),
    /// Queue a frame at a port.
    Send { port: usize, frame: Frame },
    /// Hand a fault to the cell.
    Begin(Place, PhysicalFault),
    /// End a fault of the cell.
    End(Place, PhysicalFault),
}

/// What becomes of a frame at one receiver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Delivery {
    Now,
    Later(Duration),
    Never,
}

/// One fault of the plan with its state.
#[derive(Clone, Debug)]
struct Entry {
    fault: Fault,
    rng: Rng,
    /// Port of the target, or of the babbler.
    port: Option<usize>,
    active: bool,
    /// Next start, end, toggle or transmission.
    next: Option<Instant>,
    /// When the present occurrence began.
    since: Instant,
    until: Option<Instant>,
    /// Contact of an intermittent plug.
    contact: bool,
    occurrences: u64,
    hits: u64,
}

/// How often a fault happened, for the report.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct FaultCount {
    pub label: String,
    pub occurrences: u64,
    /// Frames it acted on.
    pub frames: u64,
}

#[derive(Clone, Debug, Default)]
pub struct Engine {
    entries: Vec<Entry>,
    seed: u64,
    /// Any fault active that acts on frames at their start, at sending, at delivery.
    on_wire: bool,
    on_send: bool,
    on_delivery: bool,
    /// Number of current begins of each (place, variant), to merge overlaps.
    begun: Vec<(Place, PhysicalFault, u32)>,
}

impl Engine {
    /// A plan without ports; [`Engine::bind`] gives them.
    pub fn new(seed: u64, plan: Vec<Fault>) -> Self {
        let mut engine = Self { seed, ..Self::default() };
        for fault in plan {
            engine.push(fault);
        }
        engine
    }

    fn push(&mut self, fault: Fault) {
        let rng = Rng::stream(self.seed, &fault.label);
        self.entries.push(Entry {
            rng,
            port: None,
            active: false,
            next: Some(fault.start),
            since: fault.start,
            until: None,
            contact: true,
            occurrences: 0,
            hits: 0,
            fault,
        });
    }

    /// Adds a fault during the run. A start in the past becomes now.
    pub fn add(&mut self, mut fault: Fault, now: Instant, port: Option<usize>) {
        fault.start = fault.start.max(now);
        self.push(fault);
        if let Some(entry) = self.entries.last_mut() {
            entry.port = port;
        }
    }

    /// Faults with a time of the throw wait for [`Engine::throw_begins`].
    pub fn await_throw(&mut self) {
        for entry in self.entries.iter_mut().filter(|entry| entry.fault.at.is_some()) {
            entry.next = None;
        }
    }

    /// Gives the faults with a time of the throw their start. One in the past is now.
    pub fn throw_begins(&mut self, now: Instant, start: Instant, release: Instant) {
        for entry in self.entries.iter_mut().filter(|entry| !entry.active) {
            if let Some(at) = entry.fault.at {
                entry.fault.start = at.at(start, release).max(now);
                entry.next = Some(entry.fault.start);
            }
        }
    }

    /// Sets the port of each fault: `of(fault)` for the target module or the babbler.
    pub fn bind(&mut self, mut of: impl FnMut(&Fault) -> Option<usize>) {
        for entry in &mut self.entries {
            entry.port = of(&entry.fault);
        }
    }

    /// Earliest time at which [`Engine::step`] has something to do.
    pub fn next_change(&self) -> Option<Instant> {
        self.entries.iter().filter_map(|entry| entry.next).min()
    }

    /// Labels of the active faults.
    pub fn active(&self) -> impl Iterator<Item = &str> {
        self.entries.iter().filter(|entry| entry.active).map(|entry| entry.fault.label.as_str())
    }

    /// How often each fault happened.
    pub fn counts(&self) -> Vec<FaultCount> {
        self.entries
            .iter()
            .map(|entry| FaultCount {
                label: entry.fault.label.clone(),
                occurrences: entry.occurrences,
                frames: entry.hits,
            })
            .collect()
    }

    /// Does what is due at or before `now`; pushes what the world has to do.
    pub fn step(&mut self, now: Instant, actions: &mut Vec<Action>) {
        for index in 0..self.entries.len() {
            while let Some(entry) = self.entries.get_mut(index)
                && entry.next.is_some_and(|next| next <= now)
            {
                let physical = entry.step(now, actions);
                match physical {
                    Some((true, place, fault)) => self.begin(place, fault, actions),
                    Some((false, place, fault)) => self.end(place, fault, actions),
                    None => {}
                }
            }
        }
        let active = |test: fn(&WireFault) -> bool| {
            self.entries
                .iter()
                .any(|entry| matches!(&entry.fault.kind, FaultKind::Wire(wire) if entry.active && test(wire)))
        };
        self.on_wire = active(|wire| matches!(wire, WireFault::Corrupt | WireFault::Duplicate));
        self.on_send = active(|wire| matches!(wire, WireFault::WrongAnswer(_) | WireFault::Silent));
        self.on_delivery = active(|wire| matches!(wire, WireFault::Drop | WireFault::Delay(_)));
    }

    fn begin(&mut self, place: Place, fault: PhysicalFault, actions: &mut Vec<Action>) {
        actions.push(Action::Begin(place, fault));
        if fault == PhysicalFault::Restart {
            return;
        }
        match self.begun.iter_mut().find(|(p, f, _)| *p == place && discriminant(f) == discriminant(&fault)) {
            Some((_, parameters, count)) => {
                // The contract requires begin and end to alternate: end the earlier one first.
                let earlier = std::mem::replace(parameters, fault);
                *count += 1;
                actions.insert(actions.len() - 1, Action::End(place, earlier));
            }
            None => self.begun.push((place, fault, 1)),
        }
    }

    fn end(&mut self, place: Place, fault: PhysicalFault, actions: &mut Vec<Action>) {
        let same =
            |(p, f, _): &(Place, PhysicalFault, u32)| *p == place && discriminant(f) == discriminant(&fault);
        if let Some(at) = self.begun.iter().position(same) {
            self.begun[at].2 -= 1;
            if self.begun[at].2 == 0 {
                let (place, fault, _) = self.begun.swap_remove(at);
                actions.push(Action::End(place, fault));
            }
        }
    }

    /// The frame that the node at `port` wants to send: unchanged, changed, or `None` if it is lost.
    pub fn outgoing(&mut self, port: usize, frame: Frame) -> Option<Frame> {
        if !self.on_send {
            return Some(frame);
        }
        let mut frame = frame;
        for entry in &mut self.entries {
            let FaultKind::Wire(wire) = entry.fault.kind else { continue };
            if !entry.active || !entry.concerns(port) || !entry.matches(&frame) {
                continue;
            }
            match wire {
                WireFault::Silent if entry.hit() => return None,
                WireFault::WrongAnswer(part) if is_answer(&frame) && entry.hit() => {
                    frame = wrong(&frame, part, &mut entry.rng);
                }
                _ => {}
            }
        }
        Some(frame)
    }

    /// True if [`Engine::deliveries`] is needed for each frame on the bus.
    pub fn acts_on_delivery(&self) -> bool {
        self.on_delivery
    }

    /// Draws what becomes of a frame at each of `receivers` (a set of ports).
    pub fn deliveries(&mut self, frame: &Frame, receivers: u64, mut each: impl FnMut(usize, Delivery)) {
        // On the bus one draw counts for all nodes.
        let mut common = Delivery::Now;
        let mut own = [Delivery::Now; crate::bus::medium::PORTS_MAX];
        for entry in &mut self.entries {
            let FaultKind::Wire(wire) = entry.fault.kind else { continue };
            let verdict = match wire {
                WireFault::Drop => Delivery::Never,
                WireFault::Delay(by) => Delivery::Later(by),
                _ => continue,
            };
            if !entry.active || !entry.matches(frame) {
                continue;
            }
            match entry.fault.target {
                Target::Module(_) => {
                    if let Some(port) = entry.port
                        && receivers >> port & 1 == 1
                        && entry.hit()
                    {
                        own[port] = worse(own[port], verdict);
                    }
                }
                _ => {
                    if entry.hit() {
                        common = worse(common, verdict);
                    }
                }
            }
        }
        for (port, own) in own.iter().enumerate() {
            if receivers >> port & 1 == 1 {
                each(port, worse(common, *own));
            }
        }
    }
}

fn is_answer(frame: &Frame) -> bool {
    matches!(Address::of(frame.id()), Some(Address::Module(Channel::Ack, _)))
}

/// A loss beats a delay, delays add up.
fn worse(a: Delivery, b: Delivery) -> Delivery {
    match (a, b) {
        (Delivery::Never, _) | (_, Delivery::Never) => Delivery::Never,
        (Delivery::Later(a), Delivery::Later(b)) => Delivery::Later(a + b),
        (Delivery::Later(by), Delivery::Now) | (Delivery::Now, Delivery::Later(by)) => Delivery::Later(by),
        (Delivery::Now, Delivery::Now) => Delivery::Now,
    }
}

/// An answer with one part wrong; frames too short for that part stay as they are.
fn wrong(frame: &Frame, part: WrongPart, rng: &mut Rng) -> Frame {
    let mut data = [0; protocol::frame::CAPACITY];
    let len = frame.data().len();
    data[..len].copy_from_slice(frame.data());
    let mut out = len;
    let flip = |byte: &mut u8, rng: &mut Rng| *byte ^= 1 << rng.below(8);
    match part {
        WrongPart::Command if len > 0 => flip(&mut data[0], rng),
        WrongPart::Parameter if len > 1 => flip(&mut data[1], rng),
        WrongPart::Value if len > 2 => {
            let at = 2 + rng.below(len as u64 - 2) as usize;
            flip(&mut data[at], rng);
        }
        WrongPart::Length if len > 0 => out = len - 1,
        _ => {}
    }
    let (id, data) = (frame.id(), &data[..out]);
    frame.fd().map_or_else(|| Frame::new(id, data), |flags| Frame::new_fd(id, flags, data)).unwrap_or(*frame)
}

impl Entry {
    fn matches(&self, frame: &Frame) -> bool {
        self.fault.filter.is_none_or(|filter| filter.matches(frame))
    }

    /// True if a fault of the sending side means the node at `port`.
    fn concerns(&self, port: usize) -> bool {
        self.fault.target == Target::Bus || self.port == Some(port)
    }

    /// Draws for one frame and counts.
    fn hit(&mut self) -> bool {
        let hit = self.rng.chance(self.fault.probability);
        self.hits += u64::from(hit);
        hit
    }

    /// One start, end, toggle or transmission. Returns a physical fault to begin (true) or end.
    fn step(&mut self, now: Instant, actions: &mut Vec<Action>) -> Option<(bool, Place, PhysicalFault)> {
        if !self.active {
            return self.start(now, actions);
        }
        if self.until.is_some_and(|until| until <= now) {
            return self.finish(now, actions);
        }
        match self.fault.kind {
            FaultKind::Wire(WireFault::Intermittent { on_mean, off_mean }) => {
                self.contact = !self.contact;
                if let Some(port) = self.port {
                    actions.push(Action::Attach { port, attached: self.contact });
                }
                self.hits += u64::from(!self.contact);
                let mean = if self.contact { on_mean } else { off_mean };
                let dwell = Duration::from_secs_f64(self.rng.exponential(mean.as_secs_f64()));
                self.schedule(Some(now + dwell.max(DWELL_MIN)));
            }
            FaultKind::Wire(WireFault::Babble { frame, period }) => {
                if let Some(port) = self.port {
                    actions.push(Action::Send { port, frame });
                    self.hits += 1;
                }
                self.schedule(Some(now + period.max(Duration::from_micros(1))));
            }
            _ => self.schedule(None),
        }
        None
    }

    /// Next step at `at`, but not after the end of the occurrence.
    fn schedule(&mut self, at: Option<Instant>) {
        self.next = match (at, self.until) {
            (Some(at), Some(until)) => Some(at.min(until)),
            (at, until) => at.or(until),
        };
    }

    fn start(&mut self, now: Instant, actions: &mut Vec<Action>) -> Option<(bool, Place, PhysicalFault)> {
        self.since = now;
        let per_frame = matches!(&self.fault.kind, FaultKind::Wire(wire) if wire.is_per_frame());
        if !per_frame && !self.rng.chance(self.fault.probability) {
            self.repeat();
            return None;
        }
        self.occurrences += 1;
        self.active = true;
        self.until = self.fault.length.map(|length| now + length);
        self.schedule(None);
        match self.fault.kind {
            FaultKind::Wire(WireFault::Intermittent { .. }) => {
                // The first toggle, in this very step, opens the contact.
                self.contact = true;
                self.schedule(Some(now));
            }
            FaultKind::Wire(WireFault::Babble { .. }) => {
                if let Some(port) = self.port {
                    actions.push(Action::Attach { port, attached: true });
                }
                self.schedule(Some(now));
            }
            FaultKind::Wire(WireFault::BusOff) => {
                if let Some(port) = self.port {
                    actions.push(Action::BusOff { port });
                }
                self.active = false;
                self.repeat();
            }
            FaultKind::Wire(WireFault::StuckDominant) => actions.push(Action::HoldDominant(true)),
            FaultKind::Physical(place, fault) => {
                if fault == PhysicalFault::Restart {
                    self.active = false;
                    self.repeat();
                }
                return Some((true, place, fault));
            }
            FaultKind::Wire(_) => {}
        }
        None
    }

    fn finish(&mut self, _now: Instant, actions: &mut Vec<Action>) -> Option<(bool, Place, PhysicalFault)> {
        self.active = false;
        self.repeat();
        match self.fault.kind {
            FaultKind::Wire(WireFault::Intermittent { .. }) => {
                if let Some(port) = self.port
                    && !self.contact
                {
                    actions.push(Action::Attach { port, attached: true });
                }
                self.contact = true;
            }
            FaultKind::Wire(WireFault::Babble { .. }) => {
                if let Some(port) = self.port {
                    actions.push(Action::Attach { port, attached: false });
                }
            }
            FaultKind::Wire(WireFault::StuckDominant) => actions.push(Action::HoldDominant(false)),
            FaultKind::Physical(place, fault) => return Some((false, place, fault)),
            FaultKind::Wire(_) => {}
        }
        None
    }

    /// Plans the next occurrence, if there is one.
    fn repeat(&mut self) {
        self.next = match self.fault.every {
            Some(every) if !every.is_zero() => {
                let next = self.since + every;
                // An occurrence longer than the period is followed at once by the next.
                Some(self.until.map_or(next, |until| next.max(until)))
            }
            _ => None,
        };
    }
}

impl Wire for Engine {
    fn disturb(&mut self, _now_ns: u64, from: usize, frame: &Frame, bits: u32) -> Option<Disturbance> {
        if !self.on_wire {
            return None;
        }
        let mut disturbance = None;
        for entry in &mut self.entries {
            let FaultKind::Wire(wire) = entry.fault.kind else { continue };
            if !entry.active || !entry.matches(frame) {
                continue;
            }
            match wire {
                WireFault::Corrupt if entry.hit() => {
                    // The start of frame itself is not changed: if all nodes missed a dominant bit, there would be no frame.
                    let bit = 1 + entry.rng.below(u64::from(bits) - 1) as u32;
                    let seen_by = match (entry.fault.target, entry.port) {
                        (Target::Module(_), Some(port)) => 1 << port,
                        (Target::Module(_), None) => 0,
                        _ => u64::MAX,
                    };
                    disturbance = Some(Disturbance { bit, seen_by });
                }
                WireFault::Duplicate if entry.concerns(from) && entry.hit() => {
                    disturbance = Some(Disturbance { bit: bits - 1, seen_by: 1 << from });
                }
                _ => {}
            }
        }
        disturbance
    }
}

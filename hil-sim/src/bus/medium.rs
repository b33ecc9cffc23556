//! The bus itself: arbitration, the two gears, events in order of time.

use std::collections::VecDeque;

use protocol::{Frame, Id};
use serde::Deserialize;

use super::controller::{Controller, Outcome};
use super::counters::{Confinement, SEQUENCE_BITS};
use super::encode::{DOMINANT, RECESSIVE, frame_bits};
use super::queue::{TxOrder, TxQueue};
use super::stats::{ErrorKind, IdTable, PortStats};
use protocol::bits::INTERFRAME_SPACE as INTERMISSION_BITS;

/// Most nodes on one bus: ports are sets of bits in a `u64`.
pub const PORTS_MAX: usize = 64;

/// Recessive bits at the end of a good frame: acknowledge delimiter and end of frame.
const TRAILING_RECESSIVE: u8 = 8;

/// What ends bus-off.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Recovery {
    /// The controller counts 128 sequences of eleven recessive bits at once.
    #[default]
    Automatic,
    /// It begins to count when its software asks ([`Bus::request_recovery`]).
    OnRequest,
}

/// Bit rate that the model cannot represent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{bit_rate_bit_s} bit/s: a bit must last a whole number of nanoseconds, from 1 us (1 Mbit/s) to 100 us"
)]
pub struct BitRateError {
    /// The refused rate.
    pub bit_rate_bit_s: u32,
}

/// Options of a bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BusConfig {
    /// Bits per second, 10 000 to 1 000 000, such that a bit is a whole number of nanoseconds.
    pub bit_rate_bit_s: u32,
    /// Frames that can wait in each node.
    pub queue_depth: usize,
    /// Order in which each node offers them.
    pub tx_order: TxOrder,
    /// What ends bus-off.
    pub recovery: Recovery,
    /// Never change to the frame-by-frame gear. Slower, same events; for cross-checks.
    pub bit_by_bit: bool,
}

impl Default for BusConfig {
    fn default() -> Self {
        Self {
            bit_rate_bit_s: 1_000_000,
            queue_depth: 32,
            tx_order: TxOrder::Fifo,
            recovery: Recovery::Automatic,
            bit_by_bit: false,
        }
    }
}

/// Levels read wrongly during one frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Disturbance {
    /// First wrong bit, counted from start of frame (0), stuff bits included.
    pub first_bit: u32,
    /// Number of wrong bits in a row.
    pub bits: u32,
    /// Ports that read the inverted level; all ones: everybody, the sender too.
    pub seen_by: u64,
}

/// Decides at each start of frame whether the line disturbs it.
pub trait Wire {
    /// `from` has won the right to send `frame`, `bits` long up to the end of frame.
    fn disturb(&mut self, now_ns: u64, from: usize, frame: &Frame, bits: u32) -> Option<Disturbance>;
}

/// A line without disturbances.
#[derive(Clone, Copy, Debug, Default)]
pub struct QuietWire;

impl Wire for QuietWire {
    fn disturb(&mut self, _: u64, _: usize, _: &Frame, _: u32) -> Option<Disturbance> {
        None
    }
}

/// Something that happened on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BusEvent {
    /// A frame became valid for its receivers.
    Frame {
        /// When, nanoseconds.
        at_ns: u64,
        /// Port of the transmitter; `None` if it was disconnected in the last bits.
        from: Option<usize>,
        /// The frame.
        frame: Frame,
        /// Ports that accepted it.
        receivers: u64,
    },
    /// A node began an error flag.
    Error {
        /// When, nanoseconds.
        at_ns: u64,
        /// Which node.
        port: usize,
        /// Why.
        kind: ErrorKind,
    },
    /// A node counted itself out.
    BusOff {
        /// When, nanoseconds.
        at_ns: u64,
        /// Which node.
        port: usize,
    },
    /// A node came (back) on the bus.
    Joined {
        /// When, nanoseconds.
        at_ns: u64,
        /// Which node.
        port: usize,
    },
}

impl BusEvent {
    /// When it happened, nanoseconds.
    pub const fn at_ns(&self) -> u64 {
        match self {
            Self::Frame { at_ns, .. }
            | Self::Error { at_ns, .. }
            | Self::BusOff { at_ns, .. }
            | Self::Joined { at_ns, .. } => *at_ns,
        }
    }
}

#[derive(Clone, Debug)]
struct Port {
    queue: TxQueue,
    controller: Controller,
    stats: PortStats,
    /// Frame-by-frame gear: not before this time, because error-passive.
    suspend_until_ns: u64,
    /// Frame-by-frame gear: the count of recessive bits in the controller is valid at this time.
    waiting_since_ns: u64,
    /// Place in the queue of the frame being sent.
    sending: usize,
}

/// Frame under way in the frame-by-frame gear.
#[derive(Clone, Copy, Debug)]
struct InFlight {
    from: usize,
    frame: Frame,
    start_ns: u64,
    bits: u32,
    /// Nodes that lost the arbitration for it.
    losers: u64,
    /// Receivers have been told.
    delivered: bool,
}

#[derive(Clone, Copy, Debug)]
struct BitGear {
    /// Start of the next bit.
    next_ns: u64,
    /// Bits since the last start of frame.
    index: u32,
    start_ns: u64,
    disturbance: Option<Disturbance>,
    /// Whose frame is (or was last) on the bus, for the figures.
    id: Option<Id>,
}

#[derive(Clone, Copy, Debug)]
enum Gear {
    /// Nothing on the bus; the intermission is over at `ready_ns`.
    Quiet {
        ready_ns: u64,
    },
    Frame(InFlight),
    Bits(BitGear),
}

/// A classical CAN bus with its controllers and queues. See [`super`] for the model.
///
/// # Calling order
///
/// [`Bus::send`] with times that never decrease; [`Bus::run_until`] until it returns `None`; then the
/// bus has reached that time. A frame queued at time t takes part in every arbitration that starts at
/// t or later.
#[derive(Debug)]
pub struct Bus {
    bit_ns: u64,
    config: BusConfig,
    ports: Vec<Port>,
    gear: Gear,
    now_ns: u64,
    held_dominant: bool,
    /// Ports with frames waiting, ports that follow the bus, ports on their way back.
    pending: u64,
    attached: u64,
    online: u64,
    waiting: u64,
    out: VecDeque<BusEvent>,
    ids: IdTable,
    busy_ns: u64,
    good_ns: u64,
}

fn indices(set: u64) -> impl Iterator<Item = usize> {
    let mut rest = set;
    std::iter::from_fn(move || {
        if rest == 0 {
            return None;
        }
        let index = rest.trailing_zeros() as usize;
        rest &= rest - 1;
        Some(index)
    })
}

impl Bus {
    /// A bus with `ports` nodes, all connected, error-active and silent, at time 0.
    ///
    /// Panics for more than [`PORTS_MAX`] ports.
    pub fn new(config: BusConfig, ports: usize) -> Result<Self, BitRateError> {
        assert!(ports <= PORTS_MAX, "{ports} nodes on one bus, at most {PORTS_MAX}");
        let rate = config.bit_rate_bit_s;
        if !(10_000..=1_000_000).contains(&rate) || 1_000_000_000 % rate != 0 {
            return Err(BitRateError { bit_rate_bit_s: rate });
        }
        let automatic = config.recovery == Recovery::Automatic;
        let port = Port {
            queue: TxQueue::new(config.queue_depth, config.tx_order),
            controller: Controller::new(automatic),
            stats: PortStats::default(),
            suspend_until_ns: 0,
            waiting_since_ns: 0,
            sending: 0,
        };
        let online = if ports == 0 { 0 } else { u64::MAX >> (PORTS_MAX - ports) };
        Ok(Self {
            bit_ns: u64::from(1_000_000_000 / rate),
            config,
            ports: vec![port; ports],
            gear: Gear::Quiet { ready_ns: 0 },
            now_ns: 0,
            held_dominant: false,
            pending: 0,
            attached: online,
            online,
            waiting: 0,
            out: VecDeque::new(),
            ids: IdTable::default(),
            busy_ns: 0,
            good_ns: 0,
        })
    }

    // Getters.

    /// Length of a bit, nanoseconds.
    pub fn bit_ns(&self) -> u64 {
        self.bit_ns
    }

    /// Bits per second.
    pub fn bit_rate_bit_s(&self) -> u32 {
        self.config.bit_rate_bit_s
    }

    /// Number of nodes.
    pub fn ports(&self) -> usize {
        self.ports.len()
    }

    /// Time reached, nanoseconds.
    pub fn now_ns(&self) -> u64 {
        self.now_ns
    }

    /// Fault confinement state of a node.
    pub fn confinement(&self, port: usize) -> Confinement {
        self.ports[port].controller.counters.state()
    }

    /// Transmit and receive error counter of a node.
    pub fn error_counters(&self, port: usize) -> (u16, u16) {
        let counters = &self.ports[port].controller.counters;
        (counters.tec(), counters.rec())
    }

    /// Largest transmit and receive error counter a node ever had.
    pub fn error_counter_peaks(&self, port: usize) -> (u16, u16) {
        let counters = &self.ports[port].controller.counters;
        (counters.tec_peak(), counters.rec_peak())
    }

    /// True if the node follows the bus (connected and not bus-off).
    pub fn is_online(&self, port: usize) -> bool {
        self.online >> port & 1 == 1
    }

    /// Figures of a node.
    pub fn port_stats(&self, port: usize) -> &PortStats {
        &self.ports[port].stats
    }

    /// Queue of a node.
    pub fn queue(&self, port: usize) -> &TxQueue {
        &self.ports[port].queue
    }

    /// Changes how many frames can wait in one node.
    pub fn set_queue_depth(&mut self, port: usize, depth: usize) {
        self.ports[port].queue.set_depth(depth);
    }

    /// A time up to which [`Bus::run_until`] has nothing to tell unless something is sent; `None` while nothing is
    /// under way. For runners that sleep in between.
    pub fn quiet_until_ns(&self) -> Option<u64> {
        match self.gear {
            Gear::Frame(flight) => {
                let end_ns = flight.start_ns + u64::from(flight.bits) * self.bit_ns;
                Some(if flight.delivered { end_ns } else { end_ns - self.bit_ns })
            }
            // Error frames last at least this long; looking more often would only cost time.
            Gear::Bits(gear) => Some(gear.next_ns + 20 * self.bit_ns),
            Gear::Quiet { ready_ns } => {
                let starts =
                    indices(self.pending & self.online).map(|port| self.ready_to_send_ns(port, ready_ns));
                let joins = (self.waiting != 0).then(|| self.next_join().0);
                // One bit more, because a frame starts only once its time has passed.
                starts.map(|start_ns| start_ns + self.bit_ns).chain(joins).min()
            }
        }
    }

    /// Figures per id.
    pub fn ids(&self) -> &IdTable {
        &self.ids
    }

    /// Time during which the bus was taken: frames with their intermission, error and overload frames.
    pub fn busy_ns(&self) -> u64 {
        self.busy_ns
    }

    /// Part of [`Bus::busy_ns`] that carried no good frame; exact while the bus is idle.
    pub fn error_ns(&self) -> u64 {
        self.busy_ns.saturating_sub(self.good_ns)
    }

    // Inputs.

    /// Queues a frame at `now_ns`; false if the node's queue was full and the frame was dropped.
    pub fn send(&mut self, port: usize, frame: Frame, now_ns: u64) -> bool {
        let taken = self.ports[port].queue.push(frame, now_ns);
        if taken {
            self.pending |= 1 << port;
        }
        taken
    }

    /// Connects or disconnects a node at `now_ns`. A disconnected node loses what waits in its queue; a
    /// frame it was sending is finished by nobody and ends in a stuff error for the others.
    pub fn set_attached(&mut self, port: usize, attached: bool, now_ns: u64) {
        if attached == (self.attached >> port & 1 == 1) {
            return;
        }
        self.attached ^= 1 << port;
        if attached {
            self.ports[port].controller.attach();
            self.begin_waiting(port, now_ns);
            return;
        }
        self.leave_frame_gear_without(port, now_ns);
        let node = &mut self.ports[port];
        node.controller.detach();
        node.stats.flushed += node.queue.clear() as u64;
        self.pending &= !(1 << port);
        self.online &= !(1 << port);
        self.waiting &= !(1 << port);
    }

    /// Puts a node into bus-off at `now_ns`, as if its transmit counter had reached 256.
    pub fn force_bus_off(&mut self, port: usize, now_ns: u64) {
        if !self.is_online(port) {
            return;
        }
        self.leave_frame_gear_without(port, now_ns);
        self.ports[port].controller.force_bus_off();
        self.went_off(port, now_ns);
    }

    /// Lets a node in bus-off start to recover; nothing if it is not bus-off or recovers by itself.
    pub fn request_recovery(&mut self, port: usize, now_ns: u64) {
        if self.ports[port].controller.request_recovery() {
            self.begin_waiting(port, now_ns);
        }
    }

    /// Holds the line dominant from the next idle time on, or lets it go.
    pub fn hold_dominant(&mut self, held: bool) {
        self.held_dominant = held;
    }

    fn begin_waiting(&mut self, port: usize, now_ns: u64) {
        if self.ports[port].controller.waiting().is_some() {
            self.ports[port].waiting_since_ns = now_ns;
            self.waiting |= 1 << port;
        }
    }

    fn went_off(&mut self, port: usize, at_ns: u64) {
        self.online &= !(1 << port);
        self.ports[port].stats.became_bus_off += 1;
        self.begin_waiting(port, at_ns);
        self.out.push_back(BusEvent::BusOff { at_ns, port });
    }

    // Outputs.

    /// Moves the bus on, at most to `limit_ns`; returns the first event on the way.
    ///
    /// Frames that could start exactly at `limit_ns` wait for the next call, so that everything queued
    /// at that time takes part in the arbitration.
    pub fn run_until(&mut self, limit_ns: u64, wire: &mut impl Wire) -> Option<BusEvent> {
        loop {
            if let Some(event) = self.out.pop_front() {
                return Some(event);
            }
            let go_on = match self.gear {
                Gear::Quiet { ready_ns } => self.run_quiet(ready_ns, limit_ns, wire),
                Gear::Frame(flight) => self.run_frame(flight, limit_ns),
                Gear::Bits(_) => self.run_bits(limit_ns, wire),
            };
            if !go_on && self.out.is_empty() {
                self.now_ns = self.now_ns.max(limit_ns);
                return None;
            }
        }
    }

    /// False if nothing more happens before the limit.
    fn run_quiet(&mut self, ready_ns: u64, limit_ns: u64, wire: &mut impl Wire) -> bool {
        let mut start_ns = u64::MAX;
        let candidates = self.pending & self.online;
        for port in indices(candidates) {
            start_ns = start_ns.min(self.ready_to_send_ns(port, ready_ns));
        }
        if self.held_dominant {
            start_ns = start_ns.min(ready_ns.max(self.now_ns));
        }
        if self.waiting != 0 {
            let (join_ns, port) = self.next_join();
            if join_ns <= start_ns && join_ns <= limit_ns {
                self.now_ns = self.now_ns.max(join_ns);
                self.join(port, join_ns);
                return true;
            }
        }
        if start_ns >= limit_ns {
            return false;
        }
        self.now_ns = self.now_ns.max(start_ns);
        let (mut best, mut best_key, mut ties) = (usize::MAX, u32::MAX, 0);
        let mut starters = 0_u64;
        for port in indices(candidates) {
            if self.ready_to_send_ns(port, ready_ns) > start_ns {
                continue;
            }
            starters |= 1 << port;
            let node = &mut self.ports[port];
            let Some(head) = node.queue.head() else { continue };
            node.sending = head;
            let Some(waiting) = node.queue.get(head) else { continue };
            if waiting.key < best_key {
                (best, best_key, ties) = (port, waiting.key, 1);
            } else if waiting.key == best_key {
                ties += 1;
            }
        }
        if ties != 1 || self.held_dominant || self.config.bit_by_bit || self.online.count_ones() < 2 {
            self.enter_bits(start_ns);
            return true;
        }
        let Some(frame) = self.ports[best].queue.get(self.ports[best].sending).map(|w| w.frame) else {
            return false;
        };
        let bits = frame_bits(&frame);
        let disturbance = wire.disturb(start_ns, best, &frame, bits);
        if disturbance.is_some() {
            self.enter_bits(start_ns);
            if let Gear::Bits(gear) = &mut self.gear {
                gear.disturbance = disturbance;
            }
            return true;
        }
        for port in indices(self.waiting) {
            self.settle_waiting(port, start_ns);
        }
        self.gear = Gear::Frame(InFlight {
            from: best,
            frame,
            start_ns,
            bits,
            losers: starters & !(1 << best),
            delivered: false,
        });
        true
    }

    fn ready_to_send_ns(&self, port: usize, ready_ns: u64) -> u64 {
        let node = &self.ports[port];
        // Whatever waits longest decides when the node may start; in both orders it is the first.
        let queued_ns = node.queue.get(0).map_or(0, |waiting| waiting.since_ns);
        queued_ns.max(ready_ns).max(node.suspend_until_ns)
    }

    fn lost_arbitration(&mut self, port: usize) {
        let node = &mut self.ports[port];
        node.stats.arbitrations_lost += 1;
        if let Some(waiting) = node.queue.get(node.sending)
            && let Some(row) = self.ids.row(waiting.frame.id())
        {
            row.arbitrations_lost += 1;
        }
    }

    fn run_frame(&mut self, flight: InFlight, limit_ns: u64) -> bool {
        let end_ns = flight.start_ns + u64::from(flight.bits) * self.bit_ns;
        if !flight.delivered {
            let valid_ns = end_ns - self.bit_ns;
            if valid_ns > limit_ns {
                return false;
            }
            self.now_ns = self.now_ns.max(valid_ns);
            let receivers = self.online & !(1 << flight.from);
            for port in indices(flight.losers) {
                self.lost_arbitration(port);
            }
            for port in indices(receivers) {
                self.ports[port].controller.received_in_one();
                self.ports[port].stats.received += 1;
            }
            self.gear = Gear::Frame(InFlight { delivered: true, ..flight });
            self.out.push_back(BusEvent::Frame {
                at_ns: valid_ns,
                from: Some(flight.from),
                frame: flight.frame,
                receivers,
            });
            return true;
        }
        if end_ns > limit_ns {
            return false;
        }
        self.now_ns = self.now_ns.max(end_ns);
        let ready_ns = end_ns + u64::from(INTERMISSION_BITS) * self.bit_ns;
        let suspend = self.ports[flight.from].controller.transmitted_in_one();
        if suspend > 0 {
            self.ports[flight.from].suspend_until_ns = ready_ns + u64::from(suspend) * self.bit_ns;
        }
        self.finish_transmission(flight.from, flight.start_ns, flight.bits, end_ns);
        self.busy_ns += ready_ns - flight.start_ns;
        for port in indices(self.waiting) {
            let node = &mut self.ports[port];
            if let Some((left, _)) = node.controller.waiting() {
                node.controller.set_waiting(left, TRAILING_RECESSIVE);
                node.waiting_since_ns = end_ns;
            }
        }
        self.gear = Gear::Quiet { ready_ns };
        true
    }

    fn finish_transmission(&mut self, port: usize, start_ns: u64, bits: u32, end_ns: u64) {
        let node = &mut self.ports[port];
        node.stats.sent += 1;
        let Some(done) = node.queue.remove(node.sending) else { return };
        if node.queue.is_empty() {
            self.pending &= !(1 << port);
        }
        self.good_ns += u64::from(bits + INTERMISSION_BITS) * self.bit_ns;
        if let Some(row) = self.ids.row(done.frame.id()) {
            let wait_ns = start_ns.saturating_sub(done.since_ns);
            row.frames += 1;
            row.bits += u64::from(bits + INTERMISSION_BITS);
            row.failed_attempts += u64::from(done.failed);
            row.wait_sum_ns += wait_ns;
            row.wait_max_ns = row.wait_max_ns.max(wait_ns);
            row.response_max_ns = row.response_max_ns.max(end_ns.saturating_sub(done.since_ns));
        }
    }

    // Waiting for recessive sequences in the frame-by-frame gear.

    /// Brings the count of recessive bits of a waiting node up to `now_ns`.
    fn settle_waiting(&mut self, port: usize, now_ns: u64) {
        let node = &mut self.ports[port];
        if let Some((left, run)) = node.controller.waiting() {
            let total = u64::from(run) + now_ns.saturating_sub(node.waiting_since_ns) / self.bit_ns;
            let sequences = total / u64::from(SEQUENCE_BITS);
            // Joining itself is an event of its own; here at least one sequence stays.
            let left = u64::from(left).saturating_sub(sequences).max(1) as u16;
            node.controller.set_waiting(left, (total % u64::from(SEQUENCE_BITS)) as u8);
            node.waiting_since_ns = now_ns;
        }
    }

    fn next_join(&self) -> (u64, usize) {
        let mut first = (u64::MAX, usize::MAX);
        for port in indices(self.waiting) {
            let node = &self.ports[port];
            if let Some((left, run)) = node.controller.waiting() {
                let bits = u64::from(left) * u64::from(SEQUENCE_BITS) - u64::from(run);
                first = first.min((node.waiting_since_ns + bits * self.bit_ns, port));
            }
        }
        first
    }

    fn join(&mut self, port: usize, at_ns: u64) {
        self.ports[port].controller.set_waiting(0, 0);
        self.joined(port, at_ns);
    }

    fn joined(&mut self, port: usize, at_ns: u64) {
        self.waiting &= !(1 << port);
        self.online |= 1 << port;
        self.ports[port].suspend_until_ns = 0;
        self.out.push_back(BusEvent::Joined { at_ns, port });
    }

    // The bit-by-bit gear.

    fn enter_bits(&mut self, start_ns: u64) {
        for port in 0..self.ports.len() {
            self.settle_waiting(port, start_ns);
            let node = &mut self.ports[port];
            let left_ns = node.suspend_until_ns.saturating_sub(start_ns);
            node.controller.resume_suspend(left_ns.div_ceil(self.bit_ns) as u8);
        }
        self.gear =
            Gear::Bits(BitGear { next_ns: start_ns, index: 0, start_ns, disturbance: None, id: None });
    }

    fn leave_bits(&mut self, now_ns: u64) {
        for node in &mut self.ports {
            node.suspend_until_ns = now_ns + u64::from(node.controller.suspend_left()) * self.bit_ns;
            node.controller.leave_suspend();
            node.waiting_since_ns = now_ns;
        }
        self.gear = Gear::Quiet { ready_ns: now_ns };
    }

    /// Before a node vanishes in the middle of a frame: if it is the sender, or the only one to
    /// acknowledge, replays the frame's bits so far, so that the rest happens bit by bit.
    fn leave_frame_gear_without(&mut self, port: usize, now_ns: u64) {
        let Gear::Frame(flight) = self.gear else { return };
        let others = self.online & !(1 << flight.from) & !(1 << port);
        if flight.delivered || (flight.from != port && others != 0) {
            return;
        }
        self.enter_bits(flight.start_ns);
        let mut wire = QuietWire;
        let replay_until_ns = now_ns.min(flight.start_ns + u64::from(flight.bits - 2) * self.bit_ns);
        while let Gear::Bits(gear) = self.gear
            && gear.next_ns + self.bit_ns <= replay_until_ns
        {
            self.step_bit(gear, &mut wire);
        }
    }

    fn run_bits(&mut self, limit_ns: u64, wire: &mut impl Wire) -> bool {
        while let Gear::Bits(gear) = self.gear {
            if gear.next_ns + self.bit_ns > limit_ns {
                return false;
            }
            self.step_bit(gear, wire);
            if !self.out.is_empty() {
                return true;
            }
        }
        true
    }

    fn step_bit(&mut self, mut gear: BitGear, wire: &mut impl Wire) {
        let (start_ns, end_ns) = (gear.next_ns, gear.next_ns + self.bit_ns);
        let offers = self.offers(start_ns);
        self.start_of_frame(&mut gear, offers, wire);
        let disturbed = match gear.disturbance {
            Some(d) if gear.index >= d.first_bit && gear.index - d.first_bit < d.bits => d.seen_by,
            _ => 0,
        };
        let was_quiet = self.all_quiet() && offers & self.idle_ports() == 0;

        let mut level = if self.held_dominant { DOMINANT } else { RECESSIVE };
        for (port, node) in self.ports.iter_mut().enumerate() {
            let offer = offer(node, offers >> port & 1 == 1);
            level &= node.controller.output(offer.as_ref());
        }
        let (mut received, mut receivers) = (None, 0);
        let mut went_off = 0;
        for port in 0..self.ports.len() {
            let seen = level ^ (disturbed >> port & 1 == 1);
            let node = &mut self.ports[port];
            let offer = offer(node, offers >> port & 1 == 1);
            let before = node.controller.counters.state();
            let was_sending = node.controller.is_sending();
            let outcome = node.controller.sample(seen, offer.as_ref());
            if before == Confinement::Active && node.controller.counters.state() == Confinement::Passive {
                node.stats.became_passive += 1;
            }
            if node.controller.took_offer() {
                node.sending = node.queue.head().unwrap_or(0);
            }
            match outcome {
                None => {}
                Some(Outcome::Received(frame)) => {
                    node.stats.received += 1;
                    received = Some(frame);
                    receivers |= 1 << port;
                }
                Some(Outcome::Transmitted) => {
                    let bits = gear.index + 1;
                    self.finish_transmission(port, gear.start_ns, bits, end_ns);
                }
                Some(Outcome::LostArbitration) => self.lost_arbitration(port),
                Some(Outcome::Error(kind)) => self.count_error(port, was_sending, kind, &gear, end_ns),
                Some(Outcome::Overload) => node.stats.overloads += 1,
                Some(Outcome::BusOff(cause)) => {
                    if let Some(kind) = cause {
                        self.count_error(port, was_sending, kind, &gear, end_ns);
                    }
                    went_off |= 1 << port;
                }
                Some(Outcome::Joined) => self.joined(port, end_ns),
            }
        }
        for port in indices(went_off) {
            self.went_off(port, end_ns);
        }
        if let Some(frame) = received {
            let from = (0..self.ports.len()).find(|p| self.ports[*p].controller.is_transmitter());
            self.out.push_back(BusEvent::Frame { at_ns: end_ns, from, frame, receivers });
        }
        self.now_ns = self.now_ns.max(end_ns);
        gear.next_ns = end_ns;
        gear.index += 1;
        self.gear = Gear::Bits(gear);
        let is_quiet = self.all_quiet();
        if !(was_quiet && is_quiet) || level == DOMINANT {
            self.busy_ns += self.bit_ns;
        }
        if is_quiet && !self.held_dominant {
            self.leave_bits(end_ns);
        }
    }

    fn offers(&self, now_ns: u64) -> u64 {
        let mut offers = 0;
        for port in indices(self.pending & self.online) {
            if self.ports[port].queue.get(0).is_some_and(|w| w.since_ns <= now_ns) {
                offers |= 1 << port;
            }
        }
        offers
    }

    fn idle_ports(&self) -> u64 {
        let mut idle = 0;
        for (port, node) in self.ports.iter().enumerate() {
            idle |= u64::from(node.controller.is_idle()) << port;
        }
        idle
    }

    fn all_quiet(&self) -> bool {
        self.ports.iter().all(|node| node.controller.is_quiet())
    }

    /// Notes a start of frame in this bit and asks the wire whether it disturbs it.
    fn start_of_frame(&mut self, gear: &mut BitGear, offers: u64, wire: &mut impl Wire) {
        let starters = offers & self.idle_ports();
        if starters == 0 {
            return;
        }
        let mut best: Option<(u32, usize, Frame)> = None;
        for port in indices(starters) {
            let node = &self.ports[port];
            if let Some(waiting) = node.queue.head().and_then(|head| node.queue.get(head))
                && best.is_none_or(|(key, ..)| waiting.key < key)
            {
                best = Some((waiting.key, port, waiting.frame));
            }
        }
        if let Some((_, port, frame)) = best {
            let first_of_gear = gear.index == 0 && gear.disturbance.is_some();
            if !first_of_gear {
                gear.disturbance = wire.disturb(gear.next_ns, port, &frame, frame_bits(&frame));
            }
            gear.index = 0;
            gear.start_ns = gear.next_ns;
            gear.id = Some(frame.id());
        }
    }

    fn count_error(&mut self, port: usize, was_sending: bool, kind: ErrorKind, gear: &BitGear, at_ns: u64) {
        let node = &mut self.ports[port];
        node.stats.errors.add(kind);
        if was_sending && let Some(waiting) = node.queue.get_mut(node.sending) {
            waiting.failed += 1;
            node.stats.failed_attempts += 1;
        }
        if let Some(row) = gear.id.and_then(|id| self.ids.row(id)) {
            row.errors.add(kind);
        }
        self.out.push_back(BusEvent::Error { at_ns, port, kind });
    }
}

/// The frame a node would start with.
fn offer(node: &Port, offered: bool) -> Option<Frame> {
    if !offered {
        return None;
    }
    node.queue.head().and_then(|head| node.queue.get(head)).map(|waiting| waiting.frame)
}

//! The bus itself: its stages, calls of its owner, events in order of time.

mod attempt;
mod errors;

use std::collections::VecDeque;

use protocol::Frame;

use super::config::{BitRateError, BusConfig, Recovery};
use super::controller::Controller;
use super::counters::Confinement;
use super::event::{BusEvent, Wire};
use super::queue::{TxOrder, TxQueue};
use super::stats::{IdTable, PortStats};
use attempt::Attempt;
use errors::Held;

/// Most nodes on one bus: ports are sets of bits in a `u64`.
pub const PORTS_MAX: usize = 64;

/// No frame is valid sooner after its start: one without data and stuff bits, up to the last bit but one of its end.
const CLASSICAL_BITS_MIN: u64 = 43;

/// The same of CAN FD with bit rate switch: bits at the nominal rate, and at the data rate.
const FD_BITS_MIN: [u64; 2] = [26, 32];

#[derive(Clone, Debug)]
struct Port {
    queue: TxQueue,
    controller: Controller,
    stats: PortStats,
    /// Not before this time, because error-passive.
    suspend_until_ns: u64,
    /// The count of recessive bits in the controller is valid at this time.
    waiting_since_ns: u64,
    /// Place in the queue of the frame being sent.
    sending: usize,
}

#[derive(Clone, Copy, Debug)]
enum Stage {
    /// Nothing on the bus; the intermission is over at `ready_ns`.
    Quiet {
        ready_ns: u64,
    },
    Attempt(Attempt),
    /// The line is held dominant.
    Held(Held),
}

/// A CAN bus with its controllers and queues. See [`super`] for the model.
///
/// # Calling order
///
/// [`Bus::send`] with times that never decrease; [`Bus::run_until`] until it returns `None`; then the
/// bus has reached that time. A frame queued at time t takes part in every arbitration that starts at
/// t or later.
#[derive(Debug)]
pub struct Bus {
    bit_ns: u64,
    /// Of the data phase; 0 on a classical bus.
    fast_bit_ns: u64,
    config: BusConfig,
    ports: Vec<Port>,
    stage: Stage,
    now_ns: u64,
    held_dominant: bool,
    /// Ports with frames waiting, ports that follow the bus, ports on their way back.
    pending: u64,
    /// Ports with a controller that does not know CAN FD.
    classical: u64,
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
        let fast_rate = config.data_bit_rate_bit_s;
        if let Some(rate) =
            fast_rate.filter(|fast| !(rate..=10_000_000).contains(fast) || 1_000_000_000 % fast != 0)
        {
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
            fast_bit_ns: fast_rate.map_or(0, |rate| u64::from(1_000_000_000 / rate)),
            config,
            ports: vec![port; ports],
            stage: Stage::Quiet { ready_ns: 0 },
            now_ns: 0,
            held_dominant: false,
            pending: 0,
            classical: if fast_rate.is_some() { 0 } else { online },
            attached: online,
            online,
            waiting: 0,
            out: VecDeque::new(),
            ids: IdTable::default(),
            busy_ns: 0,
            good_ns: 0,
        })
    }

    /// A node with mailboxes of its own kind; before it has queued a frame.
    pub fn set_tx_order(&mut self, port: usize, order: TxOrder) {
        self.ports[port].queue = TxQueue::new(self.config.queue_depth, order);
    }

    /// A node whose controller does not know CAN FD: it takes such frames for errors, and sends none.
    pub fn set_classical(&mut self, port: usize) {
        self.classical |= 1 << port;
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

    /// Bits per second of the data phase of CAN FD; `None` on a classical bus.
    pub fn data_bit_rate_bit_s(&self) -> Option<u32> {
        self.config.data_bit_rate_bit_s
    }

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

    pub fn queue(&self, port: usize) -> &TxQueue {
        &self.ports[port].queue
    }

    /// Changes how many frames can wait in one node.
    pub fn set_queue_depth(&mut self, port: usize, depth: usize) {
        self.ports[port].queue.set_depth(depth);
    }

    /// A time up to which [`Bus::run_until`] reports only errors, unless something is sent; `None` while no frame
    /// is on the bus. For runners that sleep in between: one wake-up per frame.
    pub fn quiet_until_ns(&self) -> Option<u64> {
        match self.stage {
            Stage::Attempt(attempt) => {
                if let Some(failure) = attempt.failure {
                    return Some(attempt.at_bit_ns(failure.flag_bit, self.bit_ns));
                }
                let end_ns = attempt.at_bit_ns(attempt.bits, self.bit_ns);
                if !attempt.delivered {
                    return Some(end_ns - self.bit_ns);
                }
                let next = (self.pending & self.online != 0).then(|| end_ns + self.frame_min_ns());
                next.or_else(|| (self.waiting != 0).then_some(end_ns))
            }
            Stage::Held(held) => Some(held.next_count_ns(self.bit_ns)),
            Stage::Quiet { ready_ns } => {
                let starts =
                    indices(self.pending & self.online).map(|port| self.ready_to_send_ns(port, ready_ns));
                let joins = (self.waiting != 0).then(|| self.next_join().0);
                starts.map(|start_ns| start_ns + self.frame_min_ns()).chain(joins).min()
            }
        }
    }

    fn frame_min_ns(&self) -> u64 {
        let classical_ns = CLASSICAL_BITS_MIN * self.bit_ns;
        let [nominal, fast] = FD_BITS_MIN;
        if self.fast_bit_ns == 0 { classical_ns } else { nominal * self.bit_ns + fast * self.fast_bit_ns }
    }

    pub fn ids(&self) -> &IdTable {
        &self.ids
    }

    /// Time during which the bus was taken: frames with their intermission, and error frames.
    pub fn busy_ns(&self) -> u64 {
        self.busy_ns
    }

    /// Part of [`Bus::busy_ns`] that carried no good frame; exact while the bus is idle.
    pub fn error_ns(&self) -> u64 {
        self.busy_ns.saturating_sub(self.good_ns)
    }

    // Inputs.

    /// Queues a frame at `now_ns`; false if it was dropped: the node's queue was full, or its controller does not know CAN FD.
    pub fn send(&mut self, port: usize, frame: Frame, now_ns: u64) -> bool {
        let queue = &mut self.ports[port].queue;
        let is_foreign = frame.fd().is_some() && self.classical >> port & 1 == 1;
        let taken = if is_foreign { queue.refuse() } else { queue.push(frame, now_ns) };
        if taken {
            self.pending |= 1 << port;
        }
        taken
    }

    /// Connects or disconnects a node at `now_ns`. A disconnected node loses the frames in its queue; a frame that
    /// it was sending breaks off and ends in a stuff error for the others.
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
        self.leave_attempt(port, now_ns);
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
        self.leave_attempt(port, now_ns);
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
        self.ports[port].controller.enter_bus_off();
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
            let go_on = match self.stage {
                Stage::Quiet { ready_ns } => self.run_quiet(ready_ns, limit_ns, wire),
                Stage::Attempt(attempt) => self.run_attempt(attempt, limit_ns),
                Stage::Held(held) => self.run_held(held, limit_ns),
            };
            if !go_on && self.out.is_empty() {
                self.now_ns = self.now_ns.max(limit_ns);
                return None;
            }
        }
    }
}

//! The world around the board: a simulated arm, its bus, and a pendant.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::error::Error;
use std::rc::Rc;

use hil_sim::bus::BusConfig;
use hil_sim::participants::Solo;
use hil_sim::world::RunError;
use hil_sim::{Cell, CellOptions, World};
use protocol::cyphal::bits::{Encode, Writer};
use protocol::cyphal::cubecell::command::{self, Jog};
use protocol::cyphal::id::{NodeId, Priority, Route, TransferId};
use protocol::cyphal::tx::{TxMeta, TxQueue};
use protocol::cyphal::uavcan::command::{self as commands, CommandRequest};
use protocol::cyphal::uavcan::heartbeat::{self, Health, Heartbeat, Mode};
use protocol::{Duration, Frame, Instant, Node};
use robot_model::RobotModel;

/// Mailboxes of the board's CAN controller.
const MAILBOXES: usize = 3;
/// Index of the board among the nodes, after the six drives.
const BOARD: usize = 6;
/// Node-ID of the controller in its built-in settings, and one for the pendant.
const CONTROLLER: NodeId = NodeId::from_low_bits(10);
const PENDANT: NodeId = NodeId::from_low_bits(100);

type Members = (Cell, (Solo<Port>, Solo<Pendant>));

/// The connector of the board.
pub(crate) struct Lab {
    world: World<Members>,
}

impl Lab {
    /// Six drives that stand at their zeros, a board and a pendant on one bus of 1 Mbit/s.
    pub(crate) fn start() -> Result<Rc<RefCell<Self>>, Box<dyn Error>> {
        let mut options = CellOptions::default();
        options.drive.starts_homed = true;
        let cell = Cell::new(&RobotModel::load("powercube6")?, &options, 1)?;
        let nodes = (Solo::new("board", Port::default()), Solo::new("pendant", Pendant::default()));
        let mut world = World::new((cell, nodes), BusConfig::default(), 1, Vec::new())?;
        world.keep_queue_short(BOARD, MAILBOXES);
        Ok(Rc::new(RefCell::new(Self { world })))
    }

    /// Virtual time.
    pub(crate) fn now(&self) -> Instant {
        self.world.now()
    }

    /// Where joint 6 is, rad.
    pub(crate) fn joint_6_rad(&self) -> f64 {
        self.world.participants().0.plant().axis(5).q_rad
    }

    /// Most frames that waited for the board.
    pub(crate) fn waiting_max(&self) -> usize {
        self.port().waiting_max
    }

    /// Puts a frame into a mailbox; false if all are full.
    pub(crate) fn send(&mut self, frame: Frame) -> bool {
        let room = self.port().mailboxes.is_empty();
        if room {
            let sent = self
                .world
                .with_participants(|participants, _| participants.1.0.node.mailboxes.push_back(frame));
            return sent.is_ok();
        }
        room
    }

    /// Next received frame.
    pub(crate) fn receive(&mut self) -> Option<Frame> {
        self.world.with_participants(|participants, _| participants.1.0.node.received.pop_front()).ok()?
    }

    /// Lets time pass until `until`, or until a frame has been received.
    pub(crate) fn sleep_until(&mut self, until: Instant) -> Result<(), RunError> {
        while self.now() < until && self.port().received.is_empty() {
            let soon = self.now() + Duration::from_micros(1);
            let next = self.world.next_wake().unwrap_or(until).max(soon).min(until);
            self.world.run_until(next, &mut ())?;
        }
        Ok(())
    }

    fn port(&self) -> &Port {
        &self.world.participants().1.0.node
    }
}

/// Registers of the board's CAN controller: the bus on one side, the driver on the other.
#[derive(Default)]
struct Port {
    received: VecDeque<Frame>,
    mailboxes: VecDeque<Frame>,
    waiting_max: usize,
}

impl Node for Port {
    fn handle_frame(&mut self, _: Instant, frame: &Frame) {
        self.received.push_back(*frame);
        self.waiting_max = self.waiting_max.max(self.received.len());
    }

    fn handle_timeout(&mut self, _: Instant) {}

    fn poll_frame(&mut self) -> Option<Frame> {
        self.mailboxes.pop_front()
    }

    fn poll_timeout(&self) -> Option<Instant> {
        None
    }
}

/// A pendant: heartbeats all the time, and from 1.5 s on a jog of joint 6 at 0.2 rad/s for one second.
struct Pendant {
    next: Instant,
    transfer: TransferId,
    queue: TxQueue<4, 64>,
}

impl Default for Pendant {
    fn default() -> Self {
        Self { next: Instant::ZERO, transfer: TransferId::ZERO, queue: TxQueue::new() }
    }
}

impl Pendant {
    fn send(&mut self, now: Instant, route: Route, message: &dyn Encode) {
        self.transfer = self.transfer.next();
        let deadline = now + Duration::from_millis(100);
        let meta = TxMeta { route, priority: Priority::Nominal, transfer_id: self.transfer, deadline };
        // If the queue is full, its messages go first; the next message comes 50 ms later anyway.
        let _ = self.queue.push(&meta, message);
    }
}

impl Node for Pendant {
    fn handle_frame(&mut self, _: Instant, _: &Frame) {}

    fn handle_timeout(&mut self, now: Instant) {
        if now < self.next {
            return;
        }
        self.next = now + Duration::from_millis(50);
        let uptime_s = (now.as_micros() / 1_000_000) as u32;
        let (health, mode) = (Health::Nominal, Mode::OPERATIONAL);
        let beat = Heartbeat { uptime_s, health, mode, vendor_status: 0 };
        self.send(now, Route::Message { subject: heartbeat::SUBJECT, source: PENDANT }, &beat);
        if (1_500_000..2_500_000).contains(&now.as_micros()) {
            let jog = Jog { joint: 5, qd_rad_s: 0.2, hold_ms: 100 };
            let mut bytes = [0; 16];
            let mut writer = Writer::new(&mut bytes);
            jog.encode(&mut writer);
            let parameter = writer.finish().ok().and_then(|len| bytes.get(..len)).unwrap_or(&[]);
            let route =
                Route::Request { service: commands::SERVICE, source: PENDANT, destination: CONTROLLER };
            self.send(now, route, &CommandRequest { command: command::JOG, parameter });
        }
    }

    fn poll_frame(&mut self) -> Option<Frame> {
        self.queue.pop()
    }

    fn poll_timeout(&self) -> Option<Instant> {
        Some(self.next)
    }
}

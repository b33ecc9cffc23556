//! Controller, network and a client in virtual time: same seed, same log.

use protocol::{Duration, Instant};

use super::controller::Krc;
use super::event::KrcEvent;
use super::link::{DatagramLink, Direction};

/// An answer on its way into the network.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Reply {
    /// How long the client took.
    pub after: Duration,
    pub bytes: Vec<u8>,
}

/// What is led by the controller's telegrams.
pub trait Client {
    /// Bytes that arrived; gives the answers.
    fn handle(&mut self, now: Instant, bytes: &[u8]) -> Vec<Reply>;
}

impl<F: FnMut(Instant, &[u8]) -> Vec<Reply>> Client for F {
    fn handle(&mut self, now: Instant, bytes: &[u8]) -> Vec<Reply> {
        self(now, bytes)
    }
}

/// What befalls the robot itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RobotFault {
    /// The drives cut out.
    CutOut { at: Instant },
    /// The program is reset and started again after a pause, once the arm stands.
    Restart {
        /// When it is reset.
        at: Instant,
        /// Pause before the new start.
        pause: Duration,
    },
}

impl RobotFault {
    fn at(self) -> Instant {
        match self {
            Self::CutOut { at } | Self::Restart { at, .. } => at,
        }
    }
}

/// Faults of the robot in time order, and starts that are due.
#[derive(Clone, Debug, Default)]
pub struct RobotFaults {
    waiting: Vec<RobotFault>,
    start_at: Option<Instant>,
}

impl RobotFaults {
    pub fn new(faults: &[RobotFault]) -> Self {
        let mut waiting = faults.to_vec();
        waiting.sort_by_key(|fault| std::cmp::Reverse(fault.at()));
        Self { waiting, start_at: None }
    }

    /// When the next one strikes.
    pub fn poll_timeout(&self) -> Option<Instant> {
        let fault = self.waiting.last().map(|fault| fault.at());
        fault.into_iter().chain(self.start_at).min()
    }

    /// Lets those due strike; true if the program starts again and needs a new connection.
    pub fn strike(&mut self, now: Instant, krc: &mut Krc) -> bool {
        while let Some(fault) = self.waiting.pop_if(|fault| fault.at() <= now) {
            match fault {
                RobotFault::CutOut { .. } => krc.cut_out(now),
                RobotFault::Restart { pause, .. } => {
                    krc.stop(now);
                    self.start_at = Some(now + pause);
                }
            }
        }
        if self.start_at.is_none_or(|at| at > now) {
            return false;
        }
        // While the arm brakes the start is refused; it is tried again one cycle later.
        let started = krc.start().is_ok();
        self.start_at = (!started).then(|| now + krc.options().cycle);
        started
    }
}

/// A run in virtual time.
#[derive(Debug)]
pub struct Bench<C> {
    pub krc: Krc,
    pub link: DatagramLink,
    pub client: C,
    /// Everything that happened, in order.
    pub events: Vec<KrcEvent>,
    faults: RobotFaults,
    now: Instant,
}

impl<C: Client> Bench<C> {
    /// Controller off, at time zero.
    pub fn new(krc: Krc, link: DatagramLink, faults: &[RobotFault], client: C) -> Self {
        Self { krc, link, client, events: Vec::new(), faults: RobotFaults::new(faults), now: Instant::ZERO }
    }

    /// Starts the program at the present time.
    pub fn start(&mut self) {
        if self.krc.start().is_ok() {
            self.krc.connected(self.now);
            self.exchange();
        }
    }

    pub fn now(&self) -> Instant {
        self.now
    }

    pub fn run(&mut self, until: Instant) {
        while let Some(due) = self.next().filter(|due| *due <= until) {
            self.now = due;
            // Arrived telegrams are handled before the controller's own deadlines of the same time.
            self.exchange();
            if self.faults.poll_timeout().is_some_and(|at| at <= due)
                && self.faults.strike(due, &mut self.krc)
            {
                // A new program run has a new socket.
                self.link.clear();
                self.krc.connected(due);
            } else {
                self.krc.handle_timeout(due);
            }
            self.exchange();
        }
        self.now = until;
    }

    pub fn run_cycles(&mut self, cycles: u64) {
        let until = self.now + self.krc.options().cycle * cycles;
        self.run(until);
    }

    fn next(&self) -> Option<Instant> {
        let all = [self.krc.poll_timeout(), self.link.poll_timeout(), self.faults.poll_timeout()];
        all.into_iter().flatten().min()
    }

    /// Moves telegrams between controller, network and client.
    fn exchange(&mut self) {
        while let Some(bytes) = self.krc.poll_packet() {
            self.link.send(self.now, Direction::ToClient, bytes);
        }
        while let Some((direction, bytes)) = self.link.poll(self.now) {
            match direction {
                Direction::ToRobot => self.krc.handle_bytes(self.now, &bytes),
                Direction::ToClient => {
                    for reply in self.client.handle(self.now, &bytes) {
                        self.link.send(self.now + reply.after, Direction::ToRobot, reply.bytes);
                    }
                }
            }
        }
        while let Some(event) = self.krc.poll_event() {
            self.events.push(event);
        }
    }

    /// All events as lines.
    pub fn log(&self) -> String {
        self.events.iter().map(|event| format!("{event}\n")).collect()
    }
}

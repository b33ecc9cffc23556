//! The robot inside this program, in virtual time: the witness that tells where the ball landed.

use hil_sim::krc::bench::RobotFaults;
use hil_sim::krc::{CycleRecord, DatagramLink, Direction, FaultCause, Krc, KrcError, KrcEvent, KrcScenario};
use hil_sim::mechanics::{HandPoint, Landing};
use protocol::{Duration, Instant};
use rsi_protocol::{Framer, Protocol, StreamItem};

use super::station::Station;

/// A run that takes longer has no end.
const LONGEST: Duration = Duration::from_secs(120);
/// After the end of the throw the robot is watched until it stands and the ball lies.
const AFTER: Duration = Duration::from_secs(3);

/// What the simulated robot did.
#[derive(Clone, Debug, Default)]
pub struct Seen {
    /// When each run of the robot's program began.
    pub started: Vec<Instant>,
    /// When the client ended the robot's program.
    pub ended: Option<Instant>,
    /// Every cycle: set and actual axes.
    pub cycles: Vec<CycleRecord>,
    /// When and how the ball left the hand.
    pub released: Option<(Instant, HandPoint)>,
    /// Where the ball landed.
    pub landing: Option<Landing>,
    /// What stopped the robot.
    pub fault: Option<FaultCause>,
    /// Late answers.
    pub late: u64,
    /// Answers that were refused.
    pub refused: u64,
    /// The time ran out before the throw had an end.
    pub endless: bool,
}

/// Runs a station against the robot of a scenario until the throw has ended.
///
/// # Errors
/// The scenario makes no robot.
pub fn run(scenario: &KrcScenario, station: &mut Station) -> Result<Seen, KrcError> {
    run_with(scenario, station, &mut |_, station| !station.stage().is_end())
}

/// As [`run`]; `each` is called at every step, and the run ends some time after it says no.
///
/// # Errors
/// The scenario makes no robot.
pub fn run_with(
    scenario: &KrcScenario,
    station: &mut Station,
    each: &mut dyn FnMut(Instant, &mut Station) -> bool,
) -> Result<Seen, KrcError> {
    let mut krc = scenario.controller()?;
    krc.start()?;
    krc.connected(Instant::ZERO);
    let faults = RobotFaults::new(&scenario.robot_faults);
    let (now, seen) = (Instant::ZERO, Seen::default());
    let mut cell = Cell { krc, link: scenario.link(), stream: Framer::new(), faults, now, seen };
    cell.exchange(station, false);
    let mut ends_at = Instant::ZERO + LONGEST;
    let mut ended = false;
    while let Some(due) = cell.next(station).filter(|due| *due <= ends_at) {
        cell.step(due, station);
        if !ended && !each(cell.now, station) {
            ended = true;
            ends_at = cell.now + AFTER;
        }
    }
    cell.seen.endless = !ended;
    cell.seen.released = cell.krc.released();
    cell.seen.landing = cell.krc.landing();
    cell.seen.late = cell.krc.late();
    Ok(cell.seen)
}

struct Cell {
    krc: Krc,
    link: DatagramLink,
    /// What the client has read of a TCP stream.
    stream: Framer,
    faults: RobotFaults,
    now: Instant,
    seen: Seen,
}

impl Cell {
    fn next(&self, station: &Station) -> Option<Instant> {
        let all = [
            self.krc.poll_timeout(),
            self.link.poll_timeout(),
            self.faults.poll_timeout(),
            station.poll_timeout(),
        ];
        all.into_iter().flatten().min()
    }

    fn step(&mut self, due: Instant, station: &mut Station) {
        self.now = self.now.max(due);
        self.exchange(station, false);
        if station.poll_timeout().is_some_and(|at| at <= self.now) {
            station.handle_timeout(self.now);
        }
        let new_run = self.faults.poll_timeout().is_some_and(|at| at <= self.now)
            && self.faults.strike(self.now, &mut self.krc);
        if new_run {
            self.link.clear();
            self.stream = Framer::new();
            self.krc.connected(self.now);
        } else {
            self.krc.handle_timeout(self.now);
        }
        self.exchange(station, new_run);
    }

    fn exchange(&mut self, station: &mut Station, new_connection: bool) {
        while let Some(bytes) = self.krc.poll_packet() {
            self.link.send(self.now, Direction::ToClient, bytes);
        }
        let mut waiting = Vec::new();
        while let Some((direction, bytes)) = self.link.poll(self.now) {
            match direction {
                Direction::ToRobot => self.krc.handle_bytes(self.now, &bytes),
                Direction::ToClient if self.krc.config().protocol == Protocol::Tcp => {
                    waiting.extend(self.stream.push(&bytes).into_iter().filter_map(|item| match item {
                        StreamItem::Document(document) => Some(document),
                        StreamItem::Dropped(_) => None,
                    }));
                }
                Direction::ToClient => waiting.push(bytes),
            }
        }
        if !waiting.is_empty()
            && let Some(answer) = station.handle(self.now, &waiting, new_connection)
        {
            self.link.send(self.now, Direction::ToRobot, answer);
            // A network without delay hands it over at once.
            while let Some((direction, bytes)) = self.link.poll(self.now) {
                if direction == Direction::ToRobot {
                    self.krc.handle_bytes(self.now, &bytes);
                }
            }
        }
        while let Some(event) = self.krc.poll_event() {
            match event {
                KrcEvent::Started { at } => self.seen.started.push(at),
                KrcEvent::Stopped { at } => self.seen.ended = Some(at),
                KrcEvent::Cycle(cycle) => self.seen.cycles.push(cycle),
                KrcEvent::Fault { cause, .. } => self.seen.fault = self.seen.fault.or(Some(cause)),
                KrcEvent::Refused { .. } => self.seen.refused += 1,
                _ => {}
            }
        }
    }
}

//! The robot inside this program, in virtual time. It knows where the ball landed.

use hil_sim::krc::bench::RobotFaults;
use hil_sim::krc::{CycleRecord, DatagramLink, Direction, FaultCause, Krc, KrcError, KrcEvent, KrcScenario};
use hil_sim::mechanics::{HandPoint, Landing};
use protocol::{Duration, Instant};
use rsi_protocol::{Framer, Protocol, StreamItem};

use super::station::Station;
use crate::port::BallSeen;

/// A run that takes longer has no end.
const LONGEST: Duration = Duration::from_secs(120);
/// Time after the end of the throw in which the robot is observed until it stands and the ball lies.
pub(super) const AFTER: Duration = Duration::from_secs(3);

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
    pub late: u64,
    /// Answers that were refused.
    pub refused: u64,
    /// The time ran out before the throw had an end.
    pub endless: bool,
}

/// Runs a station against the robot of a scenario until the throw has ended.
pub fn run(scenario: &KrcScenario, station: &mut Station) -> Result<Seen, KrcError> {
    run_with(scenario, station, &mut |_, station| !station.stage().is_end())
}

/// As [`run`]; `each` is called at every step, and the run ends some time after it returns false.
pub fn run_with(
    scenario: &KrcScenario,
    station: &mut Station,
    each: &mut dyn FnMut(Instant, &mut Station) -> bool,
) -> Result<Seen, KrcError> {
    let mut robot = SimulatedRobot::new(scenario)?;
    let mut ends_at = Instant::ZERO + LONGEST;
    let mut ended = false;
    while robot.now < ends_at {
        robot.step(station, ends_at);
        if !ended && !each(robot.now, station) {
            ended = true;
            ends_at = robot.now + AFTER;
        }
    }
    Ok(Seen { endless: !ended, ..robot.into_seen() })
}

/// The robot of a scenario, its program, and the network to it.
pub struct SimulatedRobot {
    krc: Krc,
    link: DatagramLink,
    /// What the client has read of a TCP stream.
    stream: Framer,
    faults: RobotFaults,
    now: Instant,
    seen: Seen,
}

impl SimulatedRobot {
    /// The robot, whose program has just begun.
    pub fn new(scenario: &KrcScenario) -> Result<Self, KrcError> {
        let mut krc = scenario.controller()?;
        krc.start()?;
        krc.connected(Instant::ZERO);
        let faults = RobotFaults::new(&scenario.robot_faults);
        let (now, seen) = (Instant::ZERO, Seen::default());
        Ok(Self { krc, link: scenario.link(), stream: Framer::new(), faults, now, seen })
    }

    #[must_use]
    pub const fn now(&self) -> Instant {
        self.now
    }

    /// Why the robot stopped by itself.
    #[must_use]
    pub const fn fault(&self) -> Option<FaultCause> {
        self.seen.fault
    }

    /// The ball, as an onlooker sees it.
    #[must_use]
    pub fn ball(&self) -> BallSeen {
        BallSeen {
            released_at: self.krc.released().map(|(at, _)| at),
            landing: self.krc.landing().map(|landing| (landing.t_s, landing.p_m)),
            touch_after_s: None,
        }
    }

    /// What it did, when nothing follows.
    #[must_use]
    pub fn into_seen(self) -> Seen {
        let (released, landing, late) = (self.krc.released(), self.krc.landing(), self.krc.late());
        Seen { released, landing, late, ..self.seen }
    }

    /// Lets time pass until something happens, or until `until`.
    pub fn step(&mut self, station: &mut Station, until: Instant) {
        self.exchange(station, false);
        let all = [
            self.krc.poll_timeout(),
            self.link.poll_timeout(),
            self.faults.poll_timeout(),
            station.poll_timeout(),
        ];
        match all.into_iter().flatten().min().filter(|due| *due <= until) {
            Some(due) => self.serve(due, station),
            None => self.now = self.now.max(until),
        }
    }

    fn serve(&mut self, due: Instant, station: &mut Station) {
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

//! The controller behind a socket.
//!
//! * **Real time**: a cycle lasts as long as on the robot. If this program itself is delayed, its time stands still for
//!   that long, and answers that wait in the socket count as in time: the delay is not the client's fault. The number of
//!   delays is reported.
//! * **Lock step**: the time of the robot is its cycle count. After each telegram the controller waits for the answer
//!   without limit. An answer with a smaller IPOC is passed on (and refused), and the wait continues; anything else ends
//!   the wait.

use std::net::SocketAddr;

use can_link::Clock;
use protocol::{Duration, Instant};
use rsi_protocol::{Protocol, Root, StreamItem, Telegram};

use super::bench::RobotFaults;
use super::controller::Krc;
use super::event::{FaultCause, KrcEvent};
use super::link::{DatagramLink, Direction};
use super::port::{Port, Received, number_of};
use super::state::{KrcError, State};

/// Longest sleep, so that an interrupt is seen.
const LONGEST_SLEEP: Duration = Duration::from_millis(50);
/// Lock step over datagrams: the first telegram is repeated so often.
const REPEAT: Duration = Duration::from_millis(100);
/// Lock step: longest wait for the first answer of all.
const FIRST_LIMIT: Duration = Duration::from_secs(2);
/// Most answer times that are kept.
const MAX_TIMES: usize = 1_000_000;

/// Whose time counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// The clock's.
    RealTime,
    /// The robot's: it waits for each answer.
    LockStep,
}

#[derive(Clone, Copy, Debug)]
pub struct ServeOptions {
    /// Address of the client.
    pub pc: SocketAddr,
    /// Whose time counts.
    pub mode: Mode,
    /// End after this many telegrams.
    pub cycles: Option<u64>,
    /// In lock step: longest wait for an answer, by the clock.
    pub answer_limit: Duration,
}

/// Why the exchange did not come to its end.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The socket cannot be opened.
    #[error("{pc} cannot be reached: {error}")]
    Unreachable {
        /// Address of the client.
        pc: SocketAddr,
        error: std::io::Error,
    },
    /// The program cannot start.
    #[error(transparent)]
    Start(#[from] KrcError),
    /// In lock step the client did not answer.
    #[error("no answer to telegram {ipoc} within {limit}")]
    NoAnswer {
        /// Number of the telegram.
        ipoc: u64,
        /// How long was waited.
        limit: Duration,
    },
}

impl ServeError {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        Some(match self {
            Self::Unreachable { .. } => "start the client first; the robot connects to it".to_owned(),
            Self::NoAnswer { .. } => "in lock step the client must answer every telegram".to_owned(),
            Self::Start(error) => return error.next(),
        })
    }
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct Served {
    /// Telegrams with axis positions or IPOC only.
    pub telegrams: u64,
    /// Late answers of all program runs.
    pub late: u64,
    /// Answers that did not count.
    pub refused: u64,
    /// From sending a telegram to the arrival of its answer, microseconds; the first million.
    pub answer_times_us: Vec<u32>,
    /// How often this program was held up for more than half a cycle.
    pub held_up: u64,
    /// Events that are not in the log because too many came at once: a client that floods the robot.
    pub events_lost: u64,
    pub fault: Option<FaultCause>,
}

impl Served {
    /// The answer time that the given share of all answers does not exceed.
    #[must_use]
    pub fn answer_time(&self, share: f64) -> Option<Duration> {
        let mut times = self.answer_times_us.clone();
        times.sort_unstable();
        let last = times.len().checked_sub(1)?;
        let place = (share.clamp(0.0, 1.0) * last as f64).round() as usize;
        times.get(place).map(|us| Duration::from_micros(u64::from(*us)))
    }
}

/// Runs the program of `krc` against the client at `options.pc` until its end: the number of cycles, a stop or
/// fault after which nothing more is due, or `goes_on` returning false. `observe` gets every event.
///
/// # Errors
/// The client cannot be reached, or does not answer in lock step.
pub fn serve(
    krc: &mut Krc,
    link: &mut DatagramLink,
    faults: &mut RobotFaults,
    options: &ServeOptions,
    goes_on: &dyn Fn() -> bool,
    observe: &mut dyn FnMut(&KrcEvent),
) -> Result<Served, ServeError> {
    krc.start()?;
    let port = open(krc, options)?;
    let mut session = Session {
        krc,
        link,
        port,
        options,
        observe,
        served: Served::default(),
        clock: Clock::start(),
        now: Instant::ZERO,
        held_up: Duration::ZERO,
        sent: None,
        answered: None,
        repeated: None,
    };
    session.krc.connected(session.now);
    session.exchange()?;
    while goes_on() && options.cycles.is_none_or(|cycles| session.served.telegrams < cycles) {
        let all = [session.krc.poll_timeout(), session.link.poll_timeout(), faults.poll_timeout()];
        let Some(due) = all.into_iter().flatten().min() else { break };
        if !session.reach(due)? {
            continue;
        }
        session.exchange()?;
        let new_run = faults.poll_timeout().is_some_and(|at| at <= session.now)
            && faults.strike(session.now, session.krc);
        if new_run {
            session.link.clear();
            session.port = open(session.krc, options)?;
            session.krc.connected(session.now);
        } else {
            session.krc.handle_timeout(session.now);
        }
        session.exchange()?;
    }
    session.krc.stop(session.now);
    session.take_events();
    session.served.events_lost = session.krc.events_lost();
    Ok(session.served)
}

fn open(krc: &mut Krc, options: &ServeOptions) -> Result<Port, ServeError> {
    Port::open(krc.config().protocol, options.pc).map_err(|error| {
        krc.refused();
        ServeError::Unreachable { pc: options.pc, error }
    })
}

struct Session<'a> {
    krc: &'a mut Krc,
    link: &'a mut DatagramLink,
    port: Port,
    options: &'a ServeOptions,
    observe: &'a mut dyn FnMut(&KrcEvent),
    served: Served,
    clock: Clock,
    /// Time of the robot.
    now: Instant,
    /// How much the robot's time is behind the clock.
    held_up: Duration,
    /// The last telegram that went out, and when by the clock.
    sent: Option<(u64, Instant)>,
    /// The last telegram whose answer has come.
    answered: Option<u64>,
    /// The telegram that went out again, and how many answers may still come to its copies.
    repeated: Option<(u64, u64)>,
}

impl Session<'_> {
    /// Moves the robot's time to `due`; `false` if something came before or it is not yet time.
    fn reach(&mut self, due: Instant) -> Result<bool, ServeError> {
        if self.options.mode == Mode::LockStep {
            self.now = self.now.max(due);
            return Ok(true);
        }
        let mut now = self.clock.now().saturating_sub(self.held_up);
        let half_a_cycle = Duration::from_micros(self.krc.options().cycle.as_micros() / 2);
        if let Some(late) = now.checked_since(due).filter(|late| *late > half_a_cycle) {
            self.held_up += late;
            self.served.held_up += 1;
            now = due;
        }
        // Bytes that wait in the socket came before `due`, although this program reads them only now.
        self.now = self.now.max(now.min(due.saturating_sub(Duration::from_micros(1))));
        let something = self.poll_once();
        if now >= due {
            self.exchange()?;
            self.now = self.now.max(now);
            return Ok(true);
        }
        if !something {
            let limit = due.saturating_since(self.now).min(LONGEST_SLEEP);
            self.port.wait(std::time::Duration::from_micros(limit.as_micros()));
        }
        Ok(false)
    }

    /// Takes what has arrived at the socket into the network; `true` if there was something.
    fn poll_once(&mut self) -> bool {
        match self.port.receive() {
            Received::Nothing => false,
            Received::Closed => {
                self.krc.connection_lost(self.now);
                // A closed stream always counts as readable.
                self.port.wait(std::time::Duration::ZERO);
                std::thread::sleep(std::time::Duration::from_millis(1));
                false
            }
            Received::Items(items) => {
                let at = self.clock.now();
                for item in items {
                    match item {
                        StreamItem::Document(document) => {
                            let number = number_of(&document);
                            if self.answers_a_copy(number) {
                                continue;
                            }
                            self.note_answer(number, at);
                            self.link.send(self.now, Direction::ToRobot, document);
                        }
                        StreamItem::Dropped(bytes) => self.krc.stream_torn(self.now, bytes),
                    }
                }
                true
            }
        }
    }

    /// True if the answer is to a copy of an answered telegram: the robot sent that telegram once, so it accepts
    /// one answer.
    fn answers_a_copy(&mut self, number: Option<u64>) -> bool {
        match &mut self.repeated {
            Some((ipoc, copies)) if self.answered.is_some() && number == Some(*ipoc) && *copies > 0 => {
                *copies -= 1;
                true
            }
            _ => false,
        }
    }

    fn note_answer(&mut self, number: Option<u64>, at: Instant) {
        let Some((ipoc, sent_at)) = self.sent else { return };
        // An older number is a stale answer.
        if number.is_some_and(|number| number < ipoc) || self.answered == Some(ipoc) {
            return;
        }
        self.answered = Some(ipoc);
        if number == Some(ipoc) && self.served.answer_times_us.len() < MAX_TIMES {
            let took = at.saturating_since(sent_at).as_micros();
            self.served.answer_times_us.push(u32::try_from(took).unwrap_or(u32::MAX));
        }
    }

    /// Moves telegrams between controller, network and socket.
    fn exchange(&mut self) -> Result<(), ServeError> {
        loop {
            while let Some(bytes) = self.krc.poll_packet() {
                self.link.send(self.now, Direction::ToClient, bytes);
            }
            self.take_events();
            let Some((direction, bytes)) = self.link.poll(self.now) else { return Ok(()) };
            match direction {
                Direction::ToRobot => self.krc.handle_bytes(self.now, &bytes),
                Direction::ToClient => self.send(&bytes)?,
            }
        }
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), ServeError> {
        let telegram = Telegram::parse(bytes, Root::Rob).ok();
        // The answer to a telegram with IPOC only is ignored, so a client may leave it out.
        let expects = telegram.as_ref().filter(|telegram| !telegram.elements.is_empty());
        if let Some(telegram) = expects {
            self.sent = Some((telegram.ipoc.value(), self.clock.now()));
        }
        if !self.port.send(bytes) {
            self.krc.connection_lost(self.now);
            return Ok(());
        }
        match expects.map(|telegram| telegram.ipoc.value()) {
            Some(ipoc) if self.options.mode == Mode::LockStep && !self.krc.config().only_send => {
                self.await_answer(ipoc, bytes)
            }
            _ => Ok(()),
        }
    }

    /// Lock step: waits by the clock until the answer is there. Until the first answer of a client the telegram is
    /// repeated: with datagrams the start of the client is not visible.
    fn await_answer(&mut self, ipoc: u64, telegram: &[u8]) -> Result<(), ServeError> {
        let first = self.answered.is_none();
        // A client that has not begun may never come; the caller decides whether to start the program again.
        let limit =
            if first { self.options.answer_limit.min(FIRST_LIMIT) } else { self.options.answer_limit };
        let until = self.clock.now() + limit;
        let repeats = first && self.krc.config().protocol == Protocol::Udp;
        let mut repeat_at = self.clock.now() + REPEAT;
        while self.answered != Some(ipoc) && self.krc.state() == State::Run {
            if self.poll_once() {
                continue;
            }
            let now = self.clock.now();
            if now >= until {
                return Err(ServeError::NoAnswer { ipoc, limit });
            }
            if repeats && now >= repeat_at {
                let copies = self.repeated.map_or(0, |(_, copies)| copies);
                self.repeated = Some((ipoc, copies + 1));
                repeat_at = now + REPEAT;
                let _ = self.port.send(telegram);
            }
            let next = if repeats { until.min(repeat_at) } else { until };
            self.port.wait(std::time::Duration::from_micros(next.saturating_since(now).as_micros()));
        }
        Ok(())
    }

    fn take_events(&mut self) {
        while let Some(event) = self.krc.poll_event() {
            match &event {
                KrcEvent::Cycle(_) => self.served.telegrams += 1,
                KrcEvent::Late { .. } => self.served.late += 1,
                KrcEvent::Refused { .. } => self.served.refused += 1,
                KrcEvent::Fault { cause, .. } => self.served.fault = Some(*cause),
                _ => {}
            }
            (self.observe)(&event);
        }
    }
}

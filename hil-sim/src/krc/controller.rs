//! [`Krc`]: the state machine of the simulated controller.

use std::collections::VecDeque;

use protocol::{Duration, Instant};
use robot_model::RobotModel;
use rsi_protocol::{
    Config, Framer, Generation, Ipoc, Protocol, RobotData, RobotWriter, Root, StreamItem, Telegram, Value,
    ValueType, read_answer,
};

use super::check;
use super::correction::{Correction, cartesian, tool};
use super::drives::{AxisState, Drives};
use super::event::{CycleRecord, FaultCause, KrcEvent, Refused};
use super::hand::Hand;
use super::late::LateCounter;
use super::monitor::Monitor;
use super::options::KrcOptions;
use super::state::{KrcError, State};
use crate::mechanics::{HandPoint, Landing};
use crate::rng::Rng;

/// Time for which cycles continue after the drives have settled: a gripper may still be opening.
const QUIET_AFTER: Duration = Duration::from_secs(1);

/// Most events that wait to be fetched; older ones are dropped and counted.
const MAX_EVENTS: usize = 4096;

/// The last telegram of an exchange.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Sent {
    Nothing,
    /// `IPOC` only; its answer is ignored.
    First,
    Telegram {
        ipoc: u64,
    },
}

/// The exchange of telegrams of one program run.
#[derive(Clone, Debug)]
struct Exchange {
    sent: Sent,
    /// The first telegram had `IPOC` only: an answer to it is ignored, whenever it comes.
    empty_ipoc: Option<u64>,
    next_ipoc: u64,
    /// End of the window for the last telegram; `None` once it has ended.
    window_ends: Option<Instant>,
    answer: Option<Vec<Option<Value>>>,
    /// Last value of each entry that the robot receives.
    values: Vec<Value>,
}

/// Set points that slow down after a stop.
#[derive(Clone, Copy, Debug)]
struct Braking {
    q_deg: [f64; 6],
    from_deg_s: [f64; 6],
    since: Instant,
    length_s: f64,
}

/// A simulated robot controller with its arm, gripper and ball.
#[derive(Clone, Debug)]
pub struct Krc {
    model: RobotModel,
    config: Config,
    options: KrcOptions,
    axis_places: [usize; 6],
    /// Object input of the finger sensor.
    sensor: Option<(u8, ValueType)>,
    state: State,
    next_cycle: Option<Instant>,
    /// Without an exchange: cycles continue until this time, so that braking and gripper come to their ends.
    quiet_at: Instant,
    exchange: Option<Exchange>,
    braking: Option<Braking>,
    correction: Correction,
    monitor: Monitor,
    set_deg: [f64; 6],
    late: LateCounter,
    drives: Drives,
    hand: Hand,
    noise: Rng,
    last_set_at: Instant,
    framer: Framer,
    out: VecDeque<Vec<u8>>,
    events: VecDeque<KrcEvent>,
    events_lost: u64,
}

impl Krc {
    /// At rest in its start pose, without a running program.
    pub fn new(model: RobotModel, config: Config, options: KrcOptions, seed: u64) -> Result<Self, KrcError> {
        let axis_places = check::servable(&config, &options, &model).map_err(KrcError::Options)?;
        let start = options.start_deg;
        Ok(Self {
            axis_places,
            sensor: check::sensor(&config, &options).map_err(KrcError::Options)?,
            state: State::Off,
            next_cycle: None,
            quiet_at: Instant::ZERO,
            exchange: None,
            braking: None,
            correction: Correction::new(options.correction, &model, start),
            monitor: check::monitor(&options, &model, start),
            set_deg: start,
            late: LateCounter::new(options.late),
            drives: Drives::new(options.lag, Instant::ZERO, start),
            hand: Hand::new(options.hand, seed),
            noise: Rng::stream(seed, "krc axis noise"),
            last_set_at: Instant::ZERO,
            framer: Framer::new(),
            out: VecDeque::new(),
            events: VecDeque::new(),
            events_lost: 0,
            model,
            config,
            options,
        })
    }

    /// Starts the program: `Off` or `Fault` to `Open`. The start pose is the present pose of the set points.
    ///
    /// # Errors
    /// A program runs, or the arm still brakes.
    pub fn start(&mut self) -> Result<(), KrcError> {
        match self.state {
            State::Open | State::Run => Err(KrcError::NotReady("it runs already")),
            State::Off | State::Fault if self.braking.is_some() => {
                Err(KrcError::NotReady("the arm still brakes"))
            }
            State::Off | State::Fault => {
                self.state = State::Open;
                self.correction = Correction::new(self.options.correction, &self.model, self.set_deg);
                self.monitor = check::monitor(&self.options, &self.model, self.set_deg);
                self.late = LateCounter::new(self.options.late);
                self.framer = Framer::new();
                Ok(())
            }
        }
    }

    /// The socket is open: the exchange begins at `now`.
    pub fn connected(&mut self, now: Instant) {
        if self.state != State::Open {
            return;
        }
        self.state = State::Run;
        self.report(KrcEvent::Started { at: now });
        self.exchange = Some(Exchange {
            sent: Sent::Nothing,
            empty_ipoc: None,
            next_ipoc: self.first_ipoc(now),
            window_ends: None,
            answer: None,
            values: self.config.receive.iter().map(|entry| entry.kind.zero()).collect(),
        });
        self.next_cycle = Some(now);
        self.handle_timeout(now);
    }

    /// No client listens: `Open` back to `Off`.
    pub fn refused(&mut self) {
        if self.state == State::Open {
            self.state = State::Off;
        }
    }

    /// The TCP connection was closed; no new one is made within a program run.
    pub fn connection_lost(&mut self, now: Instant) {
        if self.state == State::Run {
            self.fault(now, FaultCause::ConnectionLost);
        }
    }

    /// Ends the program without a fault, as the operator does.
    pub fn stop(&mut self, now: Instant) {
        if matches!(self.state, State::Open | State::Run) {
            self.leave(now, State::Off);
            self.report(KrcEvent::Stopped { at: now });
        }
    }

    /// Stops the robot as a drive error does.
    pub fn cut_out(&mut self, now: Instant) {
        if self.state == State::Run {
            self.fault(now, FaultCause::Ordered);
        }
    }

    /// Bytes from the client: a datagram, or a piece of the stream.
    pub fn handle_bytes(&mut self, now: Instant, bytes: &[u8]) {
        match self.config.protocol {
            Protocol::Udp => self.document(now, bytes),
            Protocol::Tcp => {
                for item in self.framer.push(bytes) {
                    match item {
                        StreamItem::Document(document) => self.document(now, &document),
                        StreamItem::Dropped(bytes) => self.refuse(now, Refused::Torn { bytes }),
                    }
                }
            }
        }
    }

    /// The runner found bytes in the stream that belong to no document.
    pub fn stream_torn(&mut self, now: Instant, bytes: usize) {
        self.refuse(now, Refused::Torn { bytes });
    }

    pub fn poll_timeout(&self) -> Option<Instant> {
        let window = self.exchange.as_ref().and_then(|exchange| exchange.window_ends);
        match (window, self.next_cycle) {
            (Some(window), Some(cycle)) => Some(window.min(cycle)),
            (window, cycle) => window.or(cycle),
        }
    }

    /// Handles the earliest deadline if it is due; call it while [`Krc::poll_timeout`] is due.
    pub fn handle_timeout(&mut self, now: Instant) {
        let Some(due) = self.poll_timeout().filter(|due| *due <= now) else { return };
        let window =
            self.exchange.as_mut().and_then(|exchange| exchange.window_ends.take_if(|end| *end == due));
        if window.is_some() {
            self.close_window(due);
        } else {
            self.cycle(due);
        }
    }

    /// Bytes for the client.
    pub fn poll_packet(&mut self) -> Option<Vec<u8>> {
        self.out.pop_front()
    }

    pub fn poll_event(&mut self) -> Option<KrcEvent> {
        self.events.pop_front()
    }

    /// Events that were not fetched in time.
    pub fn events_lost(&self) -> u64 {
        self.events_lost
    }

    /// Where the controller is.
    pub fn state(&self) -> State {
        self.state
    }

    /// The true axes at `now`, not before the last cycle.
    pub fn actual(&self, now: Instant) -> AxisState {
        self.drives.state_at(now)
    }

    /// Set point of the axes, degrees.
    pub fn set_deg(&self) -> [f64; 6] {
        self.set_deg
    }

    /// Start pose of the program run, degrees.
    pub fn start_deg(&self) -> [f64; 6] {
        self.correction.start_deg()
    }

    /// Late answers of this program run.
    pub fn late(&self) -> u64 {
        self.late.total()
    }

    /// When and how the ball left the hand.
    pub fn released(&self) -> Option<(Instant, HandPoint)> {
        self.hand.released()
    }

    /// Where the ball meets the landing plane.
    pub fn landing(&self) -> Option<Landing> {
        self.hand.landing(&self.model)
    }

    pub fn config(&self) -> &Config {
        &self.config
    }

    pub fn options(&self) -> &KrcOptions {
        &self.options
    }

    pub fn model(&self) -> &RobotModel {
        &self.model
    }

    /// A KR C2 counts from the start of the program; the number of a KR C4 is a time and continues.
    fn first_ipoc(&self, now: Instant) -> u64 {
        let step = self.ipoc_step();
        match self.options.generation {
            Generation::KrC2 => self.options.ipoc_start,
            Generation::KrC4 => {
                let steps = now.as_micros() / self.options.cycle.as_micros().max(1);
                self.options.ipoc_start.wrapping_add(steps.wrapping_mul(step))
            }
        }
    }

    fn ipoc_step(&self) -> u64 {
        self.options.generation.ipoc_step(self.options.cycle.as_micros() / 1000)
    }

    /// One document from the client: taken, or refused with a reason.
    fn document(&mut self, now: Instant, bytes: &[u8]) {
        match self.judge(now, bytes) {
            Ok(None) => {}
            Ok(Some(answer)) => {
                if let Some(exchange) = &mut self.exchange {
                    exchange.answer = Some(answer);
                }
            }
            Err(why) => self.refuse(now, why),
        }
    }

    fn judge(&self, now: Instant, bytes: &[u8]) -> Result<Option<Vec<Option<Value>>>, Refused> {
        let Some(exchange) = &self.exchange else { return Err(Refused::OutsideWindow) };
        if self.config.only_send {
            return Ok(None);
        }
        let unreadable = |error: rsi_protocol::ReadError| Refused::Unreadable(error.to_string());
        let telegram = Telegram::parse(bytes, Root::Sen).map_err(unreadable)?;
        let right_type = match &telegram.kind {
            Some(kind) => *kind == self.config.sentype,
            None => !self.options.strict_type,
        };
        if !right_type {
            return Err(Refused::WrongType);
        }
        if exchange.empty_ipoc == Some(telegram.ipoc.value()) {
            return Ok(None);
        }
        let expected = match exchange.sent {
            Sent::Nothing | Sent::First => return Ok(None),
            Sent::Telegram { ipoc } => ipoc,
        };
        if telegram.ipoc.value() != expected {
            return Err(Refused::WrongIpoc { got: telegram.ipoc.value(), expected });
        }
        if exchange.answer.is_some() {
            return Err(Refused::Second);
        }
        // An answer at the very end of the window is late.
        if exchange.window_ends.is_none_or(|end| now >= end) {
            return Err(Refused::OutsideWindow);
        }
        read_answer(&telegram, &self.config).map(Some).map_err(unreadable)
    }

    /// Steps 5 and 6: the window ends.
    fn close_window(&mut self, at: Instant) {
        let Some(exchange) = &mut self.exchange else { return };
        let answer = exchange.answer.take();
        let late = answer.is_none();
        let entries = exchange.values.iter_mut().zip(&self.config.receive);
        match answer {
            Some(answer) => {
                for ((value, _), received) in entries.zip(answer) {
                    if let Some(received) = received {
                        *value = received;
                    }
                }
            }
            None => {
                for (value, entry) in entries.filter(|(_, entry)| !entry.hold) {
                    *value = entry.kind.zero();
                }
            }
        }
        let verdict = self.late.count(late);
        if late {
            self.report(KrcEvent::Late { at, total: self.late.total() });
        }
        if verdict.over_percent {
            self.report(KrcEvent::LateWarning { at });
        }
        if verdict.over_limit {
            self.fault(at, FaultCause::LateLimit { late: self.late.value() });
        } else if verdict.over_percent && self.options.late.percent_stops {
            self.fault(at, FaultCause::LatePercent);
        }
    }

    /// Steps 1 to 4, or one step of braking.
    fn cycle(&mut self, at: Instant) {
        if self.exchange.is_some() {
            self.run_cycle(at);
        } else {
            self.quiet_cycle(at);
        }
    }

    fn run_cycle(&mut self, at: Instant) {
        let Some(exchange) = &mut self.exchange else { return };
        self.next_cycle = Some(at + self.options.cycle);
        let begins_empty = self.options.generation.begins_with_empty_telegram();
        if exchange.sent == Sent::Nothing && begins_empty {
            exchange.sent = Sent::First;
            self.send(at, true);
            return;
        }
        let number = |place: usize| exchange.values.get(place).and_then(Value::number).unwrap_or_default();
        let scalar = |name: &str| self.config.scalar(name).map(number).unwrap_or_default();
        let correction = self.axis_places.map(number);
        let outputs = scalar(&self.options.outputs_name) as i32;
        let stop = scalar(&self.options.stop_name) != 0.0;
        let text_place = self.config.scalar("EStr");
        // Each text is shown once.
        let text = text_place.and_then(|place| exchange.values.get_mut(place)).map(take_text);
        if let Some(text) = text.filter(|text| !text.is_empty()) {
            self.report(KrcEvent::Text { at, text });
        }
        self.hand.set_outputs(at, outputs);
        if stop {
            self.leave(at, State::Off);
            self.report(KrcEvent::Stopped { at });
            return;
        }
        let wanted = self
            .correction
            .apply(&correction, &self.model, &self.set_deg)
            .and_then(|q_deg| self.monitor.check(&q_deg).map(|()| q_deg));
        match wanted {
            Ok(q_deg) => {
                self.give(at, q_deg);
                self.send(at, false);
            }
            Err(cause) => self.fault(at, cause),
        }
    }

    /// Gives a set point to the drives and moves the arm, the gripper and the ball on to `at`.
    fn give(&mut self, at: Instant, q_deg: [f64; 6]) {
        self.set_deg = q_deg;
        self.last_set_at = at;
        self.drives.set_point(at, self.options.cycle, &q_deg);
        if let Some((at, hand)) = self.hand.check(at, &self.drives, &self.model) {
            self.report(KrcEvent::Released { at, hand });
        }
        self.drives.advance(at);
    }

    fn send(&mut self, at: Instant, first: bool) {
        let actual_deg = self.drives.state_at(at).q_deg;
        let step = self.ipoc_step();
        let Some(exchange) = &mut self.exchange else { return };
        let ipoc = exchange.next_ipoc;
        exchange.next_ipoc = ipoc.wrapping_add(step);
        let written = if first {
            exchange.empty_ipoc = Some(ipoc);
            RobotWriter::first(Ipoc::new(ipoc))
        } else {
            exchange.sent = Sent::Telegram { ipoc };
            exchange.window_ends = (!self.config.only_send).then(|| at + self.options.window);
            let mut read_deg = actual_deg;
            if self.options.lag.noise_deg > 0.0 {
                for q in &mut read_deg {
                    *q += self.options.lag.noise_deg * self.noise.normal();
                }
            }
            let start = self.correction.start_deg();
            let data = RobotData {
                rist_mm_deg: cartesian(&tool(&self.model, &read_deg)),
                rsol_mm_deg: cartesian(&tool(&self.model, &start)),
                aipos_deg: read_deg,
                aspos_deg: start,
                macur: [0.0; 6],
                delay: self.late.value(),
            };
            let open = self.hand.is_open();
            let sensor = |index| match self.sensor {
                Some((wired, ValueType::Bool)) if wired == index => Some(Value::Bool(open)),
                Some((wired, _)) if wired == index => Some(Value::Long(open.into())),
                _ => None,
            };
            RobotWriter::new(&self.config, self.options.decimals).write(Ipoc::new(ipoc), &data, sensor)
        };
        let Ok(mut bytes) = written else {
            // Sizes were checked at the beginning, with the longest numbers.
            self.fault(at, FaultCause::Telegram);
            return;
        };
        if self.config.protocol == Protocol::Tcp {
            bytes.extend(std::iter::repeat_n(b'\n', self.options.tcp_line_feeds));
        }
        self.out.push_back(bytes);
        let (late, outputs) = (self.late.total(), self.hand.outputs());
        self.report(KrcEvent::Cycle(CycleRecord {
            at,
            ipoc,
            set_deg: self.set_deg,
            actual_deg,
            late,
            outputs,
        }));
    }

    /// One step of braking, or of standing still until everything has settled.
    fn quiet_cycle(&mut self, at: Instant) {
        let mut q_deg = self.set_deg;
        if let Some(braking) = self.braking {
            let since_s = at.saturating_since(braking.since).as_secs_f64();
            let stands = since_s >= braking.length_s;
            // Velocity falls to zero in a straight line: all axes stay on the tangent of the path.
            let travelled_s = if stands {
                0.5 * braking.length_s
            } else {
                since_s - since_s * since_s / (2.0 * braking.length_s)
            };
            for (q, (from, speed)) in q_deg.iter_mut().zip(braking.q_deg.iter().zip(braking.from_deg_s)) {
                *q = from + speed * travelled_s;
            }
            if stands {
                self.braking = None;
                self.quiet_at = at + self.drives.settling_time() + QUIET_AFTER;
                self.report(KrcEvent::Standing { at });
            }
        }
        self.give(at, q_deg);
        let goes_on = self.braking.is_some() || at < self.quiet_at;
        self.next_cycle = goes_on.then(|| at + self.options.cycle);
    }

    fn fault(&mut self, at: Instant, cause: FaultCause) {
        self.leave(at, State::Fault);
        self.report(KrcEvent::Fault { at, cause });
    }

    /// Ends the exchange; the arm brakes from the velocity of its last set points.
    fn leave(&mut self, at: Instant, state: State) {
        self.state = state;
        if self.exchange.take().is_none() {
            return;
        }
        let from_deg_s = self.monitor.qd_deg_s();
        let fastest = from_deg_s.iter().fold(0.0_f64, |so_far, speed| so_far.max(speed.abs()));
        let length_s = fastest / self.options.cut_out.braking_deg_s2;
        self.braking = Some(Braking { q_deg: self.set_deg, from_deg_s, since: self.last_set_at, length_s });
        // In a cycle: this very cycle brakes. Between two: the next one does.
        let next = self.last_set_at + self.options.cycle;
        self.next_cycle = Some(next.max(at));
    }

    fn refuse(&mut self, at: Instant, why: Refused) {
        self.report(KrcEvent::Refused { at, why });
    }

    fn report(&mut self, event: KrcEvent) {
        if self.events.len() == MAX_EVENTS {
            self.events.pop_front();
            self.events_lost += 1;
        }
        self.events.push_back(event);
    }
}

fn take_text(value: &mut Value) -> String {
    match value {
        Value::Text(text) => std::mem::take(text),
        _ => String::new(),
    }
}

//! Requests to PowerCubes with deadlines, repetition and typed errors; a part of a node, without IO.
//!
//! ```text
//! start ──▶ queue of the module ──▶ in flight (one per module, `window` in all)
//!              ▲                        │ answer ──▶ rest (`linger`) ──▶ next
//!              │                        │ deadline: again, at most `tries` times, then given up
//!              └── rest of one deadline ◀┘ after giving up, so that a late answer meets no open request
//! ```
//!
//! The protocol has no sequence number: only command and parameter relate an answer to its request. Hence one
//! request in flight per module, and a rest after a request was given up.

use std::collections::VecDeque;

use protocol::powercube::{Reply, Request};
use protocol::{Duration, Frame, Instant, ModuleId};

/// Requests that can wait per module.
pub const QUEUE_MAX: usize = 256;
const LANES: usize = ModuleId::MAX.get() as usize;

/// How long to wait and how often to try.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Policy {
    /// Time from handing a request to the bus until an attempt counts as lost.
    pub deadline: Duration,
    /// Attempts in all, at least 1.
    pub tries: u8,
    /// Requests in flight over all modules, at least 1.
    pub window: usize,
    /// After an answer the module is left alone this long; a second answer within it is counted in
    /// [`DriveClient::extra_answers`].
    pub linger: Duration,
}

impl Default for Policy {
    /// To search for modules. 50 ms covers the slowest adapter (SLCAN at 115 200 baud: some 10 ms for eight
    /// requests) and drives for which their makers' hosts wait up to 13 ms.
    fn default() -> Self {
        Self { deadline: Duration::from_millis(50), tries: 2, window: 8, linger: Duration::ZERO }
    }
}

impl Policy {
    /// For a drive that is known to be there: tolerates lost frames and a host that is delayed for a while; a dead
    /// drive is reported after half a second.
    pub const PATIENT: Self =
        Self { deadline: Duration::from_millis(100), tries: 5, window: 8, linger: Duration::ZERO };
}

/// Names one request; never reused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Ticket(u64);

/// Why a request has no usable answer.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum RequestFailed {
    /// Nothing came.
    #[error("module {module} does not answer {} ({tries} attempts)", what(.request))]
    NoAnswer {
        module: ModuleId,
        request: Request,
        /// How often.
        tries: u8,
    },
    #[error("module {module} refuses {} (code {code:#04X})", what(.request))]
    Refused {
        module: ModuleId,
        request: Request,
        /// Byte 2 of its answer.
        code: u8,
    },
    /// More than [`QUEUE_MAX`] requests wait for the module.
    #[error("too many requests wait for module {module}")]
    QueueFull {
        /// Whose queue.
        module: ModuleId,
    },
}

impl RequestFailed {
    pub const fn module(&self) -> ModuleId {
        match self {
            Self::NoAnswer { module, .. } | Self::Refused { module, .. } | Self::QueueFull { module } => {
                *module
            }
        }
    }
}

/// A request as text, for messages.
pub fn what(request: &Request) -> String {
    match request {
        Request::Get(parameter) => format!("the question for {parameter}"),
        Request::Set(parameter, value) => {
            format!("setting {parameter} to {}", value.as_f64().unwrap_or(f64::NAN))
        }
        Request::Move(motion) => format!("the motion {}", motion.command().kind().name()),
        other => other.command().name().to_owned(),
    }
}

/// The end of a request.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outcome {
    pub ticket: Ticket,
    pub module: ModuleId,
    /// The answer, or the reason why there is no answer.
    pub result: Result<Reply, RequestFailed>,
    /// From the first attempt to the answer or the end.
    pub took: Duration,
}

#[derive(Clone, Copy, Debug)]
struct Flight {
    ticket: Ticket,
    request: Request,
    tries: u8,
    begun: Instant,
    deadline: Instant,
}

#[derive(Clone, Debug, Default)]
struct Lane {
    queue: VecDeque<(Ticket, Request)>,
    flight: Option<Flight>,
    /// No new request before this.
    rest_until: Option<Instant>,
    /// The request answered last, while a second answer to it can still be recognised.
    answered: Option<(Request, Instant)>,
    extra: u32,
}

#[derive(Clone, Debug)]
pub struct DriveClient {
    policy: Policy,
    lanes: Vec<Lane>,
    /// Where the search for the next module begins, so that every module gets its turn.
    turn: usize,
    last_ticket: u64,
    out: VecDeque<Frame>,
    done: VecDeque<Outcome>,
    repeated: u64,
    unmatched: u64,
}

impl Default for DriveClient {
    fn default() -> Self {
        Self::new(Policy::default())
    }
}

impl DriveClient {
    /// No requests yet.
    pub fn new(policy: Policy) -> Self {
        Self {
            policy,
            lanes: vec![Lane::default(); LANES],
            turn: 0,
            last_ticket: 0,
            out: VecDeque::new(),
            done: VecDeque::new(),
            repeated: 0,
            unmatched: 0,
        }
    }

    /// Attempts after a first one was not answered.
    pub const fn repeated(&self) -> u64 {
        self.repeated
    }

    /// Answers that belong to no request of ours: late ones, or another host is on the bus.
    pub const fn unmatched(&self) -> u64 {
        self.unmatched
    }

    /// Second answers to requests that were sent once: two modules have this address.
    pub fn extra_answers(&self, module: ModuleId) -> u32 {
        self.lane(module).extra
    }

    pub const fn policy(&self) -> Policy {
        self.policy
    }

    /// Changes the policy for what is sent from now on.
    pub const fn set_policy(&mut self, policy: Policy) {
        self.policy = policy;
    }

    /// True while nothing waits and nothing is in flight.
    pub fn is_idle(&self) -> bool {
        self.lanes.iter().all(|lane| lane.queue.is_empty() && lane.flight.is_none())
    }

    /// Queues a request; its end comes through [`DriveClient::poll_outcome`].
    ///
    /// # Errors
    /// [`RequestFailed::QueueFull`].
    pub fn start(
        &mut self,
        now: Instant,
        module: ModuleId,
        request: Request,
    ) -> Result<Ticket, RequestFailed> {
        let ticket = Ticket(self.last_ticket + 1);
        let lane = self.lane_mut(module);
        if lane.queue.len() >= QUEUE_MAX {
            return Err(RequestFailed::QueueFull { module });
        }
        lane.queue.push_back((ticket, request));
        self.last_ticket = ticket.0;
        self.pump(now);
        Ok(ticket)
    }

    /// Forgets everything that waits or is in flight, without an outcome.
    pub fn cancel_all(&mut self) {
        for lane in &mut self.lanes {
            lane.queue.clear();
            lane.flight = None;
        }
        self.out.clear();
        self.done.clear();
    }

    /// The next request that has ended.
    pub fn poll_outcome(&mut self) -> Option<Outcome> {
        self.done.pop_front()
    }

    pub fn take_reply(&mut self, now: Instant, module: ModuleId, reply: &Reply) {
        let linger = self.policy.linger;
        let lane = &mut self.lanes[index(module)];
        match lane.flight {
            Some(flight) if reply.answers(&flight.request) => {
                lane.flight = None;
                lane.rest_until = (!linger.is_zero()).then(|| now + linger);
                // After a repetition a second answer is expected and is not counted.
                lane.answered = (flight.tries == 1).then_some((flight.request, now + linger));
                let result = if reply.is_accepted() {
                    Ok(*reply)
                } else {
                    let code = match reply {
                        Reply::SetAck { code: Some(code), .. } | Reply::MotionAck { code, .. } => *code,
                        _ => 0,
                    };
                    Err(RequestFailed::Refused { module, request: flight.request, code })
                };
                let took = now.saturating_since(flight.begun);
                self.done.push_back(Outcome { ticket: flight.ticket, module, result, took });
            }
            _ => {
                if lane.answered.is_some_and(|(request, until)| now <= until && reply.answers(&request)) {
                    lane.extra += 1;
                } else {
                    self.unmatched += 1;
                }
            }
        }
        self.pump(now);
    }

    /// Gives up or repeats what is due.
    pub fn handle_timeout(&mut self, now: Instant) {
        for (lane, module) in self.lanes.iter_mut().zip(ModuleId::all()) {
            if lane.rest_until.is_some_and(|until| until <= now) {
                lane.rest_until = None;
            }
            let Some(flight) = &mut lane.flight else { continue };
            if flight.deadline > now {
                continue;
            }
            if flight.tries < self.policy.tries {
                flight.tries += 1;
                flight.deadline = now + self.policy.deadline;
                self.repeated += 1;
                self.out.push_back(flight.request.encode(module));
                continue;
            }
            let failed = RequestFailed::NoAnswer { module, request: flight.request, tries: flight.tries };
            let took = now.saturating_since(flight.begun);
            self.done.push_back(Outcome { ticket: flight.ticket, module, result: Err(failed), took });
            lane.flight = None;
            lane.rest_until = Some(now + self.policy.deadline);
        }
        self.pump(now);
    }

    /// Next frame to send.
    pub fn poll_frame(&mut self) -> Option<Frame> {
        self.out.pop_front()
    }

    /// Earliest time at which [`DriveClient::handle_timeout`] has something to do.
    pub fn poll_timeout(&self) -> Option<Instant> {
        let flights = self.lanes.iter().filter_map(|lane| lane.flight.map(|flight| flight.deadline));
        let rests =
            self.lanes.iter().filter(|lane| !lane.queue.is_empty()).filter_map(|lane| lane.rest_until);
        flights.chain(rests).min()
    }

    /// Sends as many waiting requests as the window has room for, module by module in turn.
    fn pump(&mut self, now: Instant) {
        let mut in_flight = self.lanes.iter().filter(|lane| lane.flight.is_some()).count();
        for step in 0..LANES {
            if in_flight >= self.policy.window.max(1) {
                return;
            }
            let at = (self.turn + step) % LANES;
            let lane = &mut self.lanes[at];
            if lane.flight.is_some() || lane.rest_until.is_some_and(|until| until > now) {
                continue;
            }
            let Some((ticket, request)) = lane.queue.pop_front() else { continue };
            let Ok(module) = ModuleId::new(at as u8 + 1) else { continue };
            let deadline = now + self.policy.deadline;
            lane.flight = Some(Flight { ticket, request, tries: 1, begun: now, deadline });
            lane.rest_until = None;
            lane.answered = None;
            self.out.push_back(request.encode(module));
            self.turn = (at + 1) % LANES;
            in_flight += 1;
        }
    }

    fn lane(&self, module: ModuleId) -> &Lane {
        &self.lanes[index(module)]
    }

    fn lane_mut(&mut self, module: ModuleId) -> &mut Lane {
        &mut self.lanes[index(module)]
    }
}

const fn index(module: ModuleId) -> usize {
    module.get() as usize - 1
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::powercube::{ACCEPTED, Parameter, Value};

    const POSITION: Request = Request::Get(Parameter::ActPos);

    fn id(n: u8) -> ModuleId {
        ModuleId::new(n).unwrap()
    }

    fn ms(n: u64) -> Instant {
        Instant::from_micros(n * 1_000)
    }

    fn drained(client: &mut DriveClient) -> usize {
        std::iter::from_fn(|| client.poll_frame()).count()
    }

    fn position(rad: f32) -> Reply {
        Reply::Value(Parameter::ActPos, Value::F32(rad))
    }

    #[test]
    fn one_request_per_module_is_in_flight_and_the_window_bounds_them_all() {
        let mut client = DriveClient::default();
        for module in ModuleId::all() {
            client.start(ms(0), module, POSITION).unwrap();
            client.start(ms(0), module, POSITION).unwrap();
        }
        assert_eq!(drained(&mut client), 8);
        client.take_reply(ms(1), id(1), &position(0.5));
        assert_eq!(drained(&mut client), 1, "one answered, one more sent");
        assert_eq!(client.poll_outcome().unwrap().result, Ok(position(0.5)));
    }

    #[test]
    fn silence_is_repeated_once_and_then_reported_with_module_and_request() {
        let mut client = DriveClient::default();
        let ticket = client.start(ms(0), id(3), POSITION).unwrap();
        assert_eq!(drained(&mut client), 1);
        client.handle_timeout(ms(49));
        assert_eq!(drained(&mut client), 0, "a call before the deadline does nothing");
        client.handle_timeout(ms(50));
        assert_eq!((drained(&mut client), client.repeated()), (1, 1));
        client.handle_timeout(ms(100));
        let outcome = client.poll_outcome().unwrap();
        assert_eq!((outcome.ticket, outcome.took), (ticket, Duration::from_millis(100)));
        let text = outcome.result.unwrap_err().to_string();
        assert_eq!(text, "module 3 does not answer the question for ActPos (2 attempts)");
    }

    #[test]
    fn a_late_answer_is_never_taken_for_the_next_request() {
        let mut client = DriveClient::new(Policy { tries: 1, ..Policy::default() });
        client.start(ms(0), id(3), POSITION).unwrap();
        let second = client.start(ms(0), id(3), POSITION).unwrap();
        client.handle_timeout(ms(50));
        assert_eq!(drained(&mut client), 1, "the second waits for the rest to end");
        client.take_reply(ms(60), id(3), &position(0.1));
        assert_eq!(client.unmatched(), 1);
        client.handle_timeout(ms(100));
        assert_eq!(drained(&mut client), 1);
        client.take_reply(ms(101), id(3), &position(0.2));
        let outcomes: Vec<_> = std::iter::from_fn(|| client.poll_outcome()).collect();
        assert_eq!((outcomes.len(), outcomes[1].ticket), (2, second));
        assert_eq!(outcomes[1].result, Ok(position(0.2)));
    }

    #[test]
    fn a_second_answer_within_the_linger_time_is_counted_as_a_second_drive() {
        let mut client = DriveClient::new(Policy { linger: Duration::from_millis(10), ..Policy::default() });
        client.start(ms(0), id(4), POSITION).unwrap();
        client.take_reply(ms(1), id(4), &position(0.1));
        client.take_reply(ms(2), id(4), &position(0.9));
        assert_eq!((client.extra_answers(id(4)), client.extra_answers(id(5))), (1, 0));
    }

    #[test]
    fn a_refused_write_is_an_error_with_its_code() {
        let mut client = DriveClient::default();
        let request = Request::set(Parameter::MaxVel, Value::F32(9.0)).unwrap();
        client.start(ms(0), id(1), request).unwrap();
        assert_ne!(ACCEPTED, 0x65);
        client.take_reply(ms(1), id(1), &Reply::SetAck { parameter: Parameter::MaxVel, code: Some(0x65) });
        let failed = client.poll_outcome().unwrap().result.unwrap_err();
        assert_eq!(failed.to_string(), "module 1 refuses setting MaxVel to 9 (code 0x65)");
    }

    #[test]
    fn after_every_call_the_next_deadline_lies_ahead() {
        let mut client = DriveClient::default();
        for n in 1..=31 {
            client.start(ms(0), id(n), POSITION).unwrap();
        }
        let mut now = ms(0);
        for _ in 0..1_000 {
            let Some(due) = client.poll_timeout() else { break };
            assert!(due > now, "{due} at {now}");
            now = due;
            client.handle_timeout(now);
        }
        assert!(client.is_idle());
        assert_eq!(std::iter::from_fn(|| client.poll_outcome()).count(), 31);
    }
}

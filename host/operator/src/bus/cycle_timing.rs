//! Measures, before anything moves, which control period this machine and this bus can keep.
//!
//! For one second the host reads the drives in the rhythm of a control cycle: each drive twice per round, four drives at the
//! same time, a round every 3 ms. The answers give three times: how late the operating system wakes this program, how long
//! the answer of a drive takes from end to end, and how long a round of all drives takes. A period holds if none of the
//! measured times would have been too long for it:
//!
//! | largest measured time | limit | because |
//! |---|---|---|
//! | lateness of a wake-up | half a period | the controller counts a later cycle as late |
//! | time of an answer | two thirds of a period | the controller's deadline for replies |
//! | time of a round, plus a fifth | a period | the commands of a cycle have a fifth more bits than these requests |
//!
//! The margin is what the controller tolerates beyond that: it stops after `reply_missed_max` missed replies of a drive or
//! `cycle_late_max` late cycles in a row.

use std::collections::BTreeSet;
use std::fmt;
use std::sync::atomic::AtomicBool;

use can_link::{CanLink, Clock, Granted, Role, RunError, Runner, Urgent};
use protocol::powercube::{Address, Channel, Parameter, Reply, Request};
use protocol::{Duration, Frame, Instant, ModuleId, Node};

use crate::node::drive_client::{DriveClient, Policy};

/// Time between two rounds: that of the fastest cycle.
const ROUND: Duration = Duration::from_millis(3);
/// How long is measured.
pub const SPAN: Duration = Duration::from_secs(1);
/// A drive that has not answered by then is silent.
const ANSWER_MAX: Duration = Duration::from_millis(100);
/// Requests to each drive in a round.
const QUESTIONS: [Parameter; 2] = [Parameter::ActPos, Parameter::CubeState];
/// Drives with a request in flight at the same time, as with the controller.
const WINDOW: usize = 4;

/// Times in order of length.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Spread {
    sorted_us: Vec<u64>,
}

impl Spread {
    fn of(times: &[Duration]) -> Self {
        let mut sorted_us: Vec<u64> = times.iter().map(|time| time.as_micros()).collect();
        sorted_us.sort_unstable();
        Self { sorted_us }
    }

    #[must_use]
    pub const fn count(&self) -> usize {
        self.sorted_us.len()
    }

    /// The time that the given share of all (0.0..=1.0) does not exceed; zero if there are no times.
    #[must_use]
    pub fn within(&self, share: f64) -> Duration {
        let at = (share.clamp(0.0, 1.0) * self.sorted_us.len() as f64).ceil() as usize;
        Duration::from_micros(self.sorted_us.get(at.saturating_sub(1)).copied().unwrap_or(0))
    }

    /// The longest; zero if there are no times.
    #[must_use]
    pub fn worst(&self) -> Duration {
        Duration::from_micros(self.sorted_us.last().copied().unwrap_or(0))
    }

    fn to_json(&self) -> serde_json::Value {
        let us = |share| self.within(share).as_micros();
        serde_json::json!({ "count": self.count(), "median": us(0.5), "p99": us(0.99), "max": self.worst().as_micros() })
    }
}

/// What was measured.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CycleTiming {
    /// What the operating system granted meanwhile.
    pub granted: Granted,
    /// How late awakenings came.
    pub wake_late: Spread,
    /// From a question to its answer.
    pub answer: Spread,
    /// From the time a round should begin to its last answer.
    pub round: Spread,
    /// Modules that answered nothing.
    pub silent: Vec<ModuleId>,
    /// Questions of modules that otherwise answer, without an answer within 0.1 s.
    pub lost: usize,
    /// Another node spoke to the modules.
    pub foreign_requests: u64,
}

impl CycleTiming {
    /// The shortest period in which nothing of what was measured would have been late.
    #[must_use]
    pub fn shortest(&self) -> Duration {
        let us = [
            self.wake_late.worst().as_micros() * 2,
            self.answer.worst().as_micros() * 3 / 2,
            self.round.worst().as_micros() * 6 / 5,
            // An answer that was lost took longer than that.
            if self.lost > 0 { ANSWER_MAX.as_micros() } else { 0 },
        ];
        Duration::from_micros(us.into_iter().max().unwrap_or(0))
    }

    /// One whose rounds need exactly so much.
    #[cfg(test)]
    pub(crate) fn that_needs(us: u64) -> Self {
        Self { round: Spread::of(&[Duration::from_micros(us * 5 / 6)]), ..Self::default() }
    }

    /// A period with a margin of a half, for delays that one second does not show. It costs little: a throw is as
    /// exact at 10 ms as at 3 ms. The arm is then not stopped by a computer that is delayed for a moment.
    #[must_use]
    pub fn comfortable(&self) -> Duration {
        Duration::from_micros(self.shortest().as_micros() * 3 / 2)
    }

    /// True if a controller with this period would have been in time.
    #[must_use]
    pub fn holds(&self, period: Duration) -> bool {
        self.shortest() <= period
    }

    /// Everything, in µs.
    #[must_use]
    pub fn to_json(&self) -> serde_json::Value {
        serde_json::json!({
            "shortest_period_us": self.shortest().as_micros(),
            "comfortable_period_us": self.comfortable().as_micros(),
            "wake_late_us": self.wake_late.to_json(),
            "answer_us": self.answer.to_json(),
            "round_us": self.round.to_json(),
            "answers_lost": self.lost,
            "real_time_priority": self.granted.priority,
            "memory_locked": self.granted.memory,
        })
    }
}

/// `rounds of all drives 2.1 ms, 2.6 ms at worst; answers 0.6 ms, 1.0 ms at worst; woken 0.2 ms late at worst`
impl fmt::Display for CycleTiming {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ms = |time: Duration| 1e3 * time.as_secs_f64();
        write!(
            f,
            "rounds of all drives {:.1} ms, {:.1} ms at worst; answers {:.1} ms, {:.1} ms at worst; woken {:.1} ms late at worst",
            ms(self.round.within(0.5)),
            ms(self.round.worst()),
            ms(self.answer.within(0.5)),
            ms(self.answer.worst()),
            ms(self.wake_late.worst()),
        )?;
        if self.lost > 0 {
            write!(f, "; {} answers lost", self.lost)?;
        }
        Ok(())
    }
}

/// Asks `modules` on `link` for [`SPAN`], in the calling thread with the priority of a controller.
pub fn measure(link: &mut dyn CanLink, clock: Clock, modules: &[ModuleId]) -> Result<CycleTiming, RunError> {
    let urgent = Urgent::request(Role::Controller);
    let mut probe = Probe::new(clock.now(), modules);
    let until = clock.now() + SPAN;
    Runner::new(link, clock).run(&mut [&mut probe], &AtomicBool::new(false), Some(until))?;
    Ok(probe.timing(urgent.granted()))
}

/// The questions, as a node.
struct Probe {
    modules: Vec<ModuleId>,
    client: DriveClient,
    /// When the next round begins.
    due: Instant,
    /// When the round at work should have begun.
    open_since: Option<Instant>,
    wake_late: Vec<Duration>,
    answers: Vec<Duration>,
    rounds: Vec<Duration>,
    answered: BTreeSet<ModuleId>,
    unanswered: Vec<ModuleId>,
    foreign_requests: u64,
}

impl Probe {
    fn new(now: Instant, modules: &[ModuleId]) -> Self {
        let policy = Policy { deadline: ANSWER_MAX, tries: 1, window: WINDOW, linger: Duration::ZERO };
        Self {
            modules: modules.to_vec(),
            client: DriveClient::new(policy),
            due: now + ROUND,
            open_since: None,
            wake_late: Vec::new(),
            answers: Vec::new(),
            rounds: Vec::new(),
            answered: BTreeSet::new(),
            unanswered: Vec::new(),
            foreign_requests: 0,
        }
    }

    fn collect(&mut self, now: Instant) {
        while let Some(outcome) = self.client.poll_outcome() {
            if outcome.result.is_ok() {
                self.answers.push(outcome.took);
                self.answered.insert(outcome.module);
            } else {
                self.unanswered.push(outcome.module);
            }
        }
        if self.client.is_idle()
            && let Some(since) = self.open_since.take()
        {
            self.rounds.push(now.saturating_since(since));
        }
    }

    fn begin_round(&mut self, now: Instant) {
        self.wake_late.push(now.saturating_since(self.due));
        if self.open_since.is_none() {
            self.open_since = Some(self.due);
            for parameter in QUESTIONS {
                for module in &self.modules {
                    // A queue that was empty takes two.
                    let _ = self.client.start(now, *module, Request::Get(parameter));
                }
            }
        }
        while self.due <= now {
            self.due += ROUND;
        }
    }

    fn timing(&self, granted: Granted) -> CycleTiming {
        let silent = |module: &ModuleId| !self.answered.contains(module);
        CycleTiming {
            granted,
            wake_late: Spread::of(&self.wake_late),
            answer: Spread::of(&self.answers),
            // With a silent drive every round lasts as long as it is waited for.
            round: Spread::of(if self.modules.iter().any(silent) { &[] } else { &self.rounds }),
            silent: self.modules.iter().copied().filter(silent).collect(),
            lost: self.unanswered.iter().filter(|module| !silent(module)).count(),
            foreign_requests: self.foreign_requests,
        }
    }
}

impl Node for Probe {
    fn handle_frame(&mut self, now: Instant, frame: &Frame) {
        match Address::of(frame.id()) {
            Some(Address::Module(Channel::Get | Channel::Put, _)) => self.foreign_requests += 1,
            _ => {
                if let Ok((module, reply)) = Reply::decode(frame) {
                    self.client.take_reply(now, module, &reply);
                    self.collect(now);
                }
            }
        }
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.client.handle_timeout(now);
        self.collect(now);
        if self.due <= now {
            self.begin_round(now);
        }
    }

    fn poll_frame(&mut self) -> Option<Frame> {
        self.client.poll_frame()
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.client.poll_timeout().into_iter().chain([self.due]).min()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::powercube::{AddressedRequest, Value};

    fn us(n: u64) -> Duration {
        Duration::from_micros(n)
    }

    fn timing(wake: u64, answer: u64, round: u64) -> CycleTiming {
        let spread = |worst| Spread::of(&[us(10), us(worst)]);
        CycleTiming {
            wake_late: spread(wake),
            answer: spread(answer),
            round: spread(round),
            ..CycleTiming::default()
        }
    }

    /// Drives that answer after `delay`; `silent` never do.
    fn run(delay: Duration, silent: Option<u8>) -> CycleTiming {
        let modules: Vec<ModuleId> = (1..=6).map(|n| ModuleId::new(n).unwrap()).collect();
        let mut probe = Probe::new(Instant::ZERO, &modules);
        let mut wire: Vec<(Instant, ModuleId, Reply)> = Vec::new();
        let end = Instant::ZERO + SPAN;
        while let Some(due) = probe.poll_timeout().filter(|due| *due < end) {
            wire.sort_by_key(|(at, ..)| *at);
            let arrived = wire.first().copied().filter(|(at, ..)| *at <= due);
            let now = arrived.map_or(due, |(at, ..)| at);
            if let Some((at, module, reply)) = arrived {
                wire.remove(0);
                probe.client.take_reply(at, module, &reply);
                probe.collect(at);
            } else {
                probe.handle_timeout(due);
            }
            while let Some(frame) = probe.poll_frame() {
                let Some(Address::Module(_, module)) = Address::of(frame.id()) else { panic!("{frame:?}") };
                let reply = match AddressedRequest::decode(&frame).unwrap().request {
                    Request::Get(Parameter::ActPos) => Reply::Value(Parameter::ActPos, Value::F32(0.0)),
                    _ => Reply::Value(Parameter::CubeState, Value::U32(0)),
                };
                if silent != Some(module.get()) {
                    wire.push((now + delay, module, reply));
                }
            }
        }
        probe.timing(Granted::default())
    }

    #[test]
    fn each_limit_alone_sets_the_shortest_period() {
        assert_eq!(timing(1_600, 100, 100).shortest(), us(3_200));
        assert_eq!(timing(100, 4_000, 100).shortest(), us(6_000));
        assert_eq!(timing(100, 100, 2_500).shortest(), us(3_000));
        assert!(timing(0, 0, 2_500).holds(us(3_000)) && !timing(0, 0, 2_501).holds(us(3_000)));
        let lost = CycleTiming { lost: 1, ..timing(0, 0, 0) };
        assert!(!lost.holds(us(17_000)));
    }

    #[test]
    fn drives_that_answer_in_time_give_rounds_of_three_answers_in_a_row() {
        let timing = run(us(400), None);
        assert!(timing.round.count() > 300 && timing.silent.is_empty() && timing.lost == 0, "{timing:?}");
        assert_eq!((timing.answer.worst(), timing.wake_late.worst()), (us(400), us(0)));
        // Twelve questions, four at a time.
        assert!(timing.round.worst() >= us(1_200), "{timing}");
        assert!(timing.holds(us(3_000)), "{timing}");
    }

    #[test]
    fn a_silent_drive_is_named_and_does_not_count_as_slow() {
        let timing = run(us(300), Some(4));
        assert_eq!(timing.silent, [ModuleId::new(4).unwrap()]);
        assert_eq!((timing.lost, timing.round.count()), (0, 0));
        assert!(timing.holds(us(3_000)));
    }

    #[test]
    fn shares_are_read_from_the_sorted_times() {
        let spread = Spread::of(&(1..=100).map(us).collect::<Vec<_>>());
        assert_eq!((spread.within(0.5), spread.within(0.99), spread.worst()), (us(50), us(99), us(100)));
        assert_eq!(Spread::default().within(0.99), Duration::ZERO);
    }
}

//! The drives as the controller knows them, and which reply belongs to which request.
//!
//! # Why a reply is never taken for another
//!
//! The protocol has no sequence number: a reply repeats the drive's address, the command byte and the
//! parameter or motion byte (its [`Key`]), and nothing else. What makes the match safe:
//!
//! 1. A drive has at most one request of a key on its way, and one request at all, but for the gripper's
//!    output which has a key of its own ([`Lane`]).
//! 2. A drive answers in the order of the requests, and frames of one id keep their order on the bus. So
//!    the reply to a later request proves that replies to earlier ones are past: here or lost.
//! 3. A request that got no reply in time is *abandoned*: its key is barred until a later request of the
//!    drive is answered (by 2 the old reply is past then) or [`QUARANTINE`] has gone by. A reply that fits a
//!    barred key is late: it is counted, not used. The schedule puts a read in between when it
//!    needs a barred key ([`crate::groups::powercube::schedule`]).
//! 4. A bus repeats a frame (a receiver saw its last bit wrong) at once, before the sender's next one. So the key
//!    of the last answered request is barred for [`DUPLICATE_WINDOW`], or until another request is answered. In the
//!    control cycle writes and motions alternate, so this never waits.
//! 5. What breaks 2, a reply held up longer than the request after it, shows in the position: the controller
//!    drops positions that the joint cannot have reached ([`crate::supervisor`]).

use protocol::powercube::{
    Channel, Command, Config, CubeState, Dio, FirmwareVersion, MotionAck, Reply, Request, ShortState,
};
use protocol::{Duration, Instant};

use crate::group::PositionSample;
use crate::groups::powercube::ramp::Loaded;
use crate::rest::Rest;

/// Longest time an answer may still be under way. Hosts of the field wait up to 100 ms.
pub const QUARANTINE: Duration = Duration::from_millis(100);
/// A repeated frame comes within this time of the first.
pub const DUPLICATE_WINDOW: Duration = Duration::from_micros(1_500);
/// An answer that comes so much later than the drive's usual ones was held up by more than the bus: twice the longest wait for
/// it ([`T_JITTER_S`](crate::groups::powercube::drive_model::T_JITTER_S)).
pub const HELD_UP: Duration = Duration::from_micros(1_600);
/// Abandoned requests remembered per drive; with all places taken no request goes out.
const ABANDONED_MAX: usize = 4;

/// What a reply repeats of its request: command byte and parameter or motion byte.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Key {
    command: u8,
    detail: u8,
}

impl Key {
    /// Key of a request.
    pub const fn of_request(request: &Request) -> Self {
        let detail = match request {
            Request::Get(parameter) | Request::Set(parameter, _) => *parameter as u8,
            Request::Move(motion) => motion.code(),
            Request::Simple(_) | Request::Internal(_) | Request::SetStepInc { .. } => 0,
        };
        Self { command: request.command().code(), detail }
    }

    /// Key that a reply repeats; `None` for a state word sent unasked.
    pub fn of_reply(reply: &Reply) -> Option<Self> {
        let (command, detail) = match reply {
            Reply::Simple(simple) => (simple.command(), 0),
            Reply::Internal(_) => (Command::Internal, 0),
            Reply::Value(parameter, _) => (Command::GetParameter, *parameter as u8),
            Reply::SetAck { parameter, .. } => (Command::SetParameter, *parameter as u8),
            Reply::MotionAck { kind, .. } => (Command::SetMotion, kind.code(MotionAck::Simple)?),
            Reply::MotionExtended { kind, .. } => (Command::SetMotion, kind.code(MotionAck::Extended)?),
            Reply::SetStepInc => (Command::SetStepInc, 0),
            Reply::State(_) => return None,
        };
        Some(Self { command: command.code(), detail })
    }
}

/// Two requests of different keys may be on their way to one drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lane {
    /// The schedule's.
    Main,
    /// Gripper output and a halt of its own.
    Side,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Pending {
    key: Key,
    request: Request,
    number: u32,
    deadline: Instant,
    is_before_reset: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Abandoned {
    key: Key,
    number: u32,
    until: Instant,
}

/// What became of a frame from a drive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Matched {
    /// The answer to this request.
    Answer(Lane, Request),
    /// The answer to a request that was given up.
    Late,
    /// Nobody asked: a repeated frame, or another host is on the bus.
    Unasked,
}

/// Counts since start-up; they stay at their largest value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReplyCounters {
    /// Requests without a reply in time.
    pub missed: u16,
    /// Replies that came after that.
    pub late: u16,
    /// Unsolicited replies.
    pub unasked: u16,
    /// Positions that cannot be.
    pub implausible: u16,
}

/// A drive: requests on their way, and the last of everything it said.
#[derive(Clone, Copy, Debug, Default)]
pub struct DriveRecord {
    main: Option<Pending>,
    side: Option<Pending>,
    abandoned: [Option<Abandoned>; ABANDONED_MAX],
    /// Nothing is abandoned from then on: spares the search in all cycles without a lost reply.
    quarantine_end: Instant,
    answered: Option<(Key, Instant)>,
    number: u32,
    /// The last answer was to a request from before the last reset: what it says of errors and halts is past.
    pub is_before_reset: bool,
    /// When the last request of the main lane went out.
    asked_at: Instant,
    /// See [`Self::answer_us`].
    answer_us: u32,
    /// Requests missed in a row.
    pub missed_in_row: u32,
    /// Counts.
    pub counters: ReplyCounters,
    /// Configuration word, once read.
    pub config: Option<Config>,
    /// Firmware, once read.
    pub version: Option<FirmwareVersion>,
    /// State word as last read, and when.
    pub state: Option<(CubeState, Instant)>,
    /// Short state as last seen.
    pub short_state: ShortState,
    /// Digital lines as last seen.
    pub dio: Dio,
    /// Position as last seen.
    pub position: Option<PositionSample>,
    /// Whether the position stands.
    pub rest: Rest,
    /// State words in a row that showed MOTION.
    pub motion_words: u8,
    /// The last position was one that the joint cannot have reached.
    pub implausible: bool,
    /// Current as last read, A.
    pub current_a: Option<f32>,
    /// Readings above the current limit in a row.
    pub over_current: u8,
    /// What the drive's ramp registers hold.
    pub loaded: Loaded,
    /// Current limit that the drive holds, A; `None` when not known.
    pub max_cur_a: Option<f32>,
}

impl DriveRecord {
    /// True if the drive has found its zero, by the state word last read.
    pub fn is_homed(&self) -> bool {
        self.state.is_some_and(|(state, _)| state.contains(CubeState::HOME_OK))
    }

    /// True while a request of the main lane waits for its answer.
    pub const fn is_asked(&self) -> bool {
        self.main.is_some()
    }

    /// True if a request may go out on this lane now.
    pub fn can_send(&self, lane: Lane, request: &Request, now: Instant) -> bool {
        let key = Key::of_request(request);
        let (own, other) = match lane {
            Lane::Main => (&self.main, &self.side),
            Lane::Side => (&self.side, &self.main),
        };
        own.is_none() && other.is_none_or(|pending| pending.key != key) && !self.is_barred(key, now)
    }

    /// True while a reply with this key could belong to an earlier request.
    pub fn is_barred(&self, key: Key, now: Instant) -> bool {
        let repeated = self.answered.is_some_and(|(last, at)| last == key && now < at + DUPLICATE_WINDOW);
        repeated || (now < self.quarantine_end && self.is_quarantined(key, now))
    }

    fn is_quarantined(&self, key: Key, now: Instant) -> bool {
        let abandoned = self.abandoned.iter().flatten().any(|old| old.key == key && now < old.until);
        let full = self.abandoned.iter().flatten().filter(|old| now < old.until).count() == ABANDONED_MAX;
        abandoned || full
    }

    /// Time at which a key that is barred now gets free by itself.
    pub fn barred_until(&self, now: Instant) -> Option<Instant> {
        let quarantines = self.abandoned.iter().flatten().map(|old| old.until);
        let repeated = self.answered.map(|(_, at)| at + DUPLICATE_WINDOW);
        quarantines.chain(repeated).filter(|&until| until > now).min()
    }

    /// Notes a request as sent.
    pub fn begin(&mut self, now: Instant, lane: Lane, request: &Request, deadline: Instant) {
        self.number = self.number.wrapping_add(1);
        let key = Key::of_request(request);
        let pending =
            Pending { key, request: *request, number: self.number, deadline, is_before_reset: false };
        match lane {
            Lane::Main => {
                self.main = Some(pending);
                self.asked_at = now;
            }
            Lane::Side => self.side = Some(pending),
        }
    }

    /// A reset goes out now: errors and halts that were reported are past.
    pub fn reset(&mut self) {
        self.loaded = Loaded::default();
        self.short_state = ShortState::EMPTY;
        for pending in [&mut self.main, &mut self.side].into_iter().flatten() {
            pending.is_before_reset = true;
        }
    }

    /// What came with a position.
    pub const fn note(&mut self, short_state: ShortState, dio: Dio) {
        if !self.is_before_reset {
            self.short_state = short_state;
        }
        self.dio = dio;
    }

    /// Finds the request that a reply answers.
    pub fn match_reply(&mut self, now: Instant, reply: &Reply) -> Matched {
        let Some(key) = Key::of_reply(reply) else { return Matched::Unasked };
        let fits = |pending: &Option<Pending>| pending.as_ref().is_some_and(|pending| pending.key == key);
        let answered = if fits(&self.main) {
            self.main.take().map(|pending| (Lane::Main, pending))
        } else if fits(&self.side) {
            self.side.take().map(|pending| (Lane::Side, pending))
        } else {
            None
        };
        if let Some((lane, pending)) = answered {
            self.forget_before(pending.number);
            self.is_before_reset = pending.is_before_reset;
            self.answered = Some((key, now));
            self.missed_in_row = 0;
            if lane == Lane::Main {
                self.learn_answer_time(now);
            }
            return Matched::Answer(lane, pending.request);
        }
        let late = self.abandoned.iter_mut().find(|place| place.is_some_and(|old| old.key == key));
        if let Some(place) = late {
            *place = None;
            self.counters.late = self.counters.late.saturating_add(1);
            // Its duplicate may follow.
            self.answered = Some((key, now));
            return Matched::Late;
        }
        self.counters.unasked = self.counters.unasked.saturating_add(1);
        Matched::Unasked
    }

    /// How fast this drive answers, µs: the shortest time of late from handing out a request to its answer, in which the
    /// bus was free. Zero before the first answer.
    pub const fn answer_us(&self) -> u32 {
        self.answer_us
    }

    /// True if the arrival of an answer of the main lane does not show when the drive gave it: the drive was slow, or the
    /// controller was held up and reads it late.
    pub fn is_held_up(&self, now: Instant) -> bool {
        self.lateness(now) > HELD_UP
    }

    /// How much later than usual an answer of the main lane is that is handed over now.
    pub fn lateness(&self, now: Instant) -> Duration {
        now.saturating_since(self.asked_at + Duration::from_micros(self.answer_us.into()))
    }

    fn learn_answer_time(&mut self, now: Instant) {
        let us = u32::try_from(now.saturating_since(self.asked_at).as_micros()).unwrap_or(u32::MAX);
        // Grows slowly: a drive that has become slower is known after some hundred answers.
        self.answer_us = if self.answer_us == 0 { us } else { us.min(self.answer_us.saturating_add(1)) };
    }

    /// Replies to requests before this one are past.
    fn forget_before(&mut self, number: u32) {
        if self.quarantine_end == Instant::ZERO {
            return;
        }
        for place in &mut self.abandoned {
            // Serial comparison: numbers wrap after four thousand million requests.
            if place.is_some_and(|old| number.wrapping_sub(old.number) < u32::MAX / 2) {
                *place = None;
            }
        }
        if self.abandoned.iter().all(Option::is_none) {
            self.quarantine_end = Instant::ZERO;
        }
    }

    /// Gives up a request whose deadline has come; the main lane's first.
    #[inline]
    pub fn give_up_due(&mut self, now: Instant) -> Option<(Lane, Request)> {
        if self.main.is_none() && self.side.is_none() {
            return None;
        }
        let due = |pending: &Option<Pending>| pending.as_ref().is_some_and(|pending| pending.deadline <= now);
        let (lane, pending) = if due(&self.main) {
            (Lane::Main, self.main.take()?)
        } else if due(&self.side) {
            (Lane::Side, self.side.take()?)
        } else {
            return None;
        };
        self.bar(now, &pending);
        self.missed_in_row = self.missed_in_row.saturating_add(1);
        self.counters.missed = self.counters.missed.saturating_add(1);
        self.forget_written(&pending.request);
        Some((lane, pending.request))
    }

    fn bar(&mut self, now: Instant, pending: &Pending) {
        let free = self.abandoned.iter_mut().find(|place| place.is_none_or(|old| old.until <= now));
        if let Some(place) = free {
            let until = now + QUARANTINE;
            *place = Some(Abandoned { key: pending.key, number: pending.number, until });
            self.quarantine_end = self.quarantine_end.max(until);
        }
    }

    /// A write without answer may have happened or not.
    fn forget_written(&mut self, request: &Request) {
        use protocol::powercube::Parameter;
        match request {
            Request::Set(Parameter::TargetVel, _) => self.loaded.v_rad_s = None,
            Request::Set(Parameter::TargetAcc, _) => self.loaded.a_rad_s2 = None,
            Request::Set(Parameter::MaxCur, _) => self.max_cur_a = None,
            _ => {}
        }
    }

    /// No request on its way is waited for beyond `deadline`.
    pub fn hasten(&mut self, deadline: Instant) {
        for pending in [&mut self.main, &mut self.side].into_iter().flatten() {
            pending.deadline = pending.deadline.min(deadline);
        }
    }

    /// Earliest deadline of a request on its way.
    pub fn deadline(&self) -> Option<Instant> {
        [&self.main, &self.side].into_iter().flatten().map(|pending| pending.deadline).min()
    }
}

/// True if a frame is a request on the bus that this controller did not send (it never hears its own).
pub fn is_foreign_request(channel: Channel) -> bool {
    matches!(channel, Channel::Get | Channel::Put)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use protocol::powercube::{MotionCommand, MotionKind, MotionPosition, MotionRequest, Parameter, Value};
    use protocol::units::Radians;

    const US: fn(u64) -> Instant = Instant::from_micros;

    fn ramp() -> Request {
        Request::Move(MotionRequest::extended(MotionCommand::Ramp { target: Radians::new(1.0) }))
    }

    fn set_a() -> Request {
        Request::Set(Parameter::TargetAcc, Value::F32(1.0))
    }

    fn ramp_reply(q: f32) -> Reply {
        Reply::MotionExtended {
            kind: MotionKind::Ramp,
            position: MotionPosition::Radians(Radians::new(q)),
            short_state: ShortState::EMPTY,
            dio: Dio(0),
        }
    }

    fn ack_a() -> Reply {
        Reply::SetAck { parameter: Parameter::TargetAcc, code: Some(0x64) }
    }

    #[test]
    fn late_reply_to_a_motion_is_not_taken_for_the_next_motions() {
        let mut drive = DriveRecord::default();
        drive.begin(Instant::ZERO, Lane::Main, &ramp(), US(2_000));
        assert_eq!(drive.give_up_due(US(2_000)), Some((Lane::Main, ramp())));
        assert!(!drive.can_send(Lane::Main, &ramp(), US(3_000)), "barred");
        assert!(drive.can_send(Lane::Main, &set_a(), US(3_000)));
        drive.begin(Instant::ZERO, Lane::Main, &set_a(), US(5_000));
        // The late one comes now, while the write is on its way.
        assert_eq!(drive.match_reply(US(3_100), &ramp_reply(0.1)), Matched::Late);
        assert_eq!(drive.match_reply(US(3_200), &ack_a()), Matched::Answer(Lane::Main, set_a()));
        drive.begin(Instant::ZERO, Lane::Main, &ramp(), US(7_000));
        assert_eq!(drive.match_reply(US(5_000), &ramp_reply(0.2)), Matched::Answer(Lane::Main, ramp()));
        assert_eq!(drive.counters, ReplyCounters { missed: 1, late: 1, ..ReplyCounters::default() });
    }

    #[test]
    fn answer_to_a_later_request_lifts_the_bar_because_drives_answer_in_order() {
        let mut drive = DriveRecord::default();
        drive.begin(Instant::ZERO, Lane::Main, &ramp(), US(2_000));
        drive.give_up_due(US(2_000));
        drive.begin(Instant::ZERO, Lane::Main, &set_a(), US(5_000));
        assert!(matches!(drive.match_reply(US(3_200), &ack_a()), Matched::Answer(..)));
        assert!(drive.can_send(Lane::Main, &ramp(), US(3_200)), "the lost reply cannot come any more");
    }

    #[test]
    fn repeated_frame_is_nobodys_and_its_key_waits() {
        let mut drive = DriveRecord::default();
        drive.begin(Instant::ZERO, Lane::Main, &ramp(), US(2_000));
        assert!(matches!(drive.match_reply(US(400), &ramp_reply(0.1)), Matched::Answer(..)));
        assert!(!drive.can_send(Lane::Main, &ramp(), US(500)));
        assert_eq!(drive.match_reply(US(520), &ramp_reply(0.1)), Matched::Unasked);
        assert!(drive.can_send(Lane::Main, &ramp(), US(400) + DUPLICATE_WINDOW));
        assert_eq!(drive.barred_until(US(500)), Some(US(400) + DUPLICATE_WINDOW));
    }

    #[test]
    fn silent_drive_gets_no_request_of_an_old_key_before_the_quarantine_ends() {
        let mut drive = DriveRecord::default();
        let mut now = US(0);
        let keys = [Parameter::CubeState, Parameter::PosStateDio, Parameter::Cur, Parameter::ActPos];
        for parameter in keys {
            assert!(drive.can_send(Lane::Main, &Request::Get(parameter), now));
            drive.begin(Instant::ZERO, Lane::Main, &Request::Get(parameter), now + Duration::from_millis(2));
            now += Duration::from_millis(2);
            assert!(drive.give_up_due(now).is_some());
        }
        assert!(!drive.can_send(Lane::Main, &set_a(), now), "no place left to remember one more");
        assert_eq!(drive.missed_in_row, 4);
        assert!(drive.can_send(Lane::Main, &set_a(), now + QUARANTINE));
    }

    #[test]
    fn write_without_answer_leaves_the_register_unknown() {
        let mut drive = DriveRecord {
            loaded: Loaded { v_rad_s: Some(1.0), a_rad_s2: Some(1.0) },
            ..DriveRecord::default()
        };
        drive.begin(Instant::ZERO, Lane::Main, &set_a(), US(2_000));
        drive.give_up_due(US(2_000));
        assert_eq!(drive.loaded, Loaded { v_rad_s: Some(1.0), a_rad_s2: None });
    }

    #[test]
    fn gripper_write_may_overtake_without_confusing_the_main_lane() {
        let mut drive = DriveRecord::default();
        let grip = Request::Set(Parameter::DioData, Value::U32(0x10));
        drive.begin(Instant::ZERO, Lane::Main, &ramp(), US(2_000));
        assert!(drive.can_send(Lane::Side, &grip, US(10)) && !drive.can_send(Lane::Main, &grip, US(10)));
        drive.begin(Instant::ZERO, Lane::Side, &grip, US(2_000));
        let ack = Reply::SetAck { parameter: Parameter::DioData, code: Some(0x64) };
        assert_eq!(drive.match_reply(US(300), &ramp_reply(0.0)), Matched::Answer(Lane::Main, ramp()));
        assert_eq!(drive.match_reply(US(400), &ack), Matched::Answer(Lane::Side, grip));
    }

    proptest! {
        /// A drive that answers in order, with losses, delays and repeated frames at random; each answer
        /// carries the number of its request as position. No match is ever wrong.
        #[test]
        fn no_reply_is_ever_taken_for_another(
            steps in proptest::collection::vec((0u8..3, 100u64..4_000, 0u8..10), 1..200),
        ) {
            let mut drive = DriveRecord::default();
            let mut now = 0u64;
            // Replies on their way: (arrival, key choice, number); in order of requests.
            let mut wire: Vec<(u64, u8, u32)> = Vec::new();
            let mut current: Option<(u8, u32)> = None;
            let mut number = 0;
            for (choice, delay, luck) in steps {
                let request = [ramp(), set_a(), Request::Get(Parameter::PosStateDio)][usize::from(choice)];
                if drive.can_send(Lane::Main, &request, US(now)) {
                    number += 1;
                    drive.begin(Instant::ZERO, Lane::Main, &request, US(now + 2_000));
                    current = Some((choice, number));
                    if luck != 0 {
                        let earliest = wire.last().map_or(0, |reply| reply.0 + 100);
                        let at = earliest.max(now + delay);
                        wire.push((at, choice, number));
                        if luck == 1 {
                            wire.push((at + 120, choice, number));
                        }
                    }
                }
                let until = now + 1_000;
                while wire.first().is_some_and(|reply| reply.0 <= until) || drive.deadline().is_some_and(|d| d <= US(until)) {
                    let arrival = wire.first().map_or(u64::MAX, |reply| reply.0);
                    if drive.deadline().is_some_and(|deadline| deadline <= US(arrival)) {
                        now = drive.deadline().unwrap().as_micros();
                        drive.give_up_due(US(now));
                        continue;
                    }
                    let (at, kind, answered) = wire.remove(0);
                    now = at;
                    let reply = match kind {
                        0 => ramp_reply(answered as f32),
                        1 => ack_a(),
                        _ => Reply::Value(Parameter::PosStateDio, Value::U8(0)),
                    };
                    if let Matched::Answer(..) = drive.match_reply(US(now), &reply) {
                        prop_assert_eq!(current, Some((kind, answered)));
                    }
                }
                now = now.max(until);
            }
        }
    }
}

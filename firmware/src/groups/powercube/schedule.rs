//! Decides which drive gets which request next: the agenda of each drive in the running cycle, and the number of requests
//! in flight.
//!
//! # The control cycle on the bus
//!
//! Per joint: write acceleration (or speed), wait for its acknowledge, send the motion, wait for its
//! answer: four frames, 372 to 450 bits, so six joints fill 2.2 to 2.7 ms at 1 Mbit/s. A drive thinks for 0.1 to
//! 0.3 ms before it answers; other drives use the bus meanwhile. With W requests in flight the bus is fully used once
//! W · (request + answer) > request + answer + thinking: W is about three at 0.3 ms, and [`IN_FLIGHT_MAX`] is four
//! ([`crate::groups::powercube::cycle_timing`] has the whole count). A larger W would only fill transmit queues, where a halt
//! would have to wait.
//!
//! Order: the writes of all drives before any motion, base first. Joint by joint, the bus would idle for two answers of the
//! last joint; in this order it idles for one. A drive that needs two writes gets both in this first part.
//!
//! Each motion has a slot ([`crate::groups::powercube::slots`]) and never leaves before it, so that the commands of a drive come
//! one period apart. Reads for monitoring wait until the last motion is on the bus.
//!
//! [`IN_FLIGHT_MAX`]: crate::groups::powercube::settings::IN_FLIGHT_MAX

use protocol::powercube::{Parameter, Request};
use protocol::{Duration, Instant, JointIndex};

use crate::groups::powercube::drives::{DriveRecord, Key, Lane};
use crate::groups::powercube::order::Order;
use crate::joints::PerJoint;

/// Requests of one drive in one cycle: speed, acceleration, motion, read for monitoring.
pub const AGENDA_MAX: usize = 4;

/// Longest request with all stuff bits, µs at 1 Mbit/s.
const GUARD_US: u32 = 115;

/// What one drive is still to be asked in this cycle.
#[derive(Clone, Copy, Debug, Default)]
pub struct Agenda {
    /// Those from `next` to `len` are still to be sent; what lies outside is old.
    requests: [Option<Request>; AGENDA_MAX],
    next: u8,
    len: u8,
    /// Place of the first request in the order of all drives.
    first: u8,
    /// Place of the motion that has a slot.
    motion: u8,
    /// It is not sent before this time of the cycle, µs.
    slot_us: u32,
}

impl Agenda {
    /// Nothing.
    pub const EMPTY: Self = Self {
        requests: [None; AGENDA_MAX],
        next: 0,
        len: 0,
        first: 0,
        motion: AGENDA_MAX as u8,
        slot_us: 0,
    };

    /// These, in order; more than [`AGENDA_MAX`] are cut off.
    pub fn of(requests: &[Request]) -> Self {
        let mut agenda = Self::EMPTY;
        for request in requests {
            agenda.push(*request);
        }
        agenda
    }

    /// Appends one; false if there is no place.
    pub fn push(&mut self, request: Request) -> bool {
        if self.is_done() {
            self.clear();
        }
        let Some(place) = self.requests.get_mut(usize::from(self.len)) else { return false };
        *place = Some(request);
        self.len += 1;
        true
    }

    /// Drops all, and the slot.
    pub const fn clear(&mut self) {
        (self.next, self.len, self.first, self.motion) = (0, 0, 0, AGENDA_MAX as u8);
    }

    /// Gives the motion at the end of this agenda its slot. A drive with two writes begins before those with one.
    pub const fn hold_motion(&mut self, slot_us: u32) {
        self.slot_us = slot_us;
        self.motion = self.len.saturating_sub(1);
        self.first = if self.len > 2 { 0 } else { 1 };
    }

    /// The slot of the next request, if it has one, µs from the start of the cycle.
    fn slot_us(&self) -> Option<u32> {
        (self.next == self.motion && !self.is_done()).then_some(self.slot_us)
    }

    /// True if nothing is left to be sent.
    pub const fn is_done(&self) -> bool {
        self.next >= self.len
    }

    /// Next request.
    pub fn head(&self) -> Option<&Request> {
        if self.is_done() { None } else { self.requests.get(usize::from(self.next))?.as_ref() }
    }

    /// Place of the next request in the order of all drives; zero is for motions whose slot has come.
    const fn level(&self) -> u8 {
        1 + self.first + self.next
    }

    const fn advance(&mut self) {
        self.next += 1;
    }
}

/// Decision of [`Schedule::next`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Next {
    /// The drive.
    pub joint: JointIndex,
    /// What to ask it.
    pub request: Request,
}

/// How far a search for requests to send has got.
#[derive(Clone, Copy, Debug)]
pub struct Round {
    level: u8,
    /// Next drive to look at in this level.
    index: usize,
    /// Drives.
    count: usize,
    busy: usize,
    /// Only motions go out: a slot is near, and another request could occupy the bus in it.
    clear_for_motion: bool,
}

/// Agendas of all drives.
#[derive(Clone, Debug)]
pub struct Schedule {
    agenda: PerJoint<Agenda>,
    /// Who is looked at first.
    order: Order,
    /// Start of the cycle; slots count from here.
    cycle_at: Instant,
    /// Before this no slot of the cycle is near, µs.
    first_us: u32,
    /// Reads for monitoring wait until then, µs.
    monitoring_us: u32,
}

impl Default for Schedule {
    fn default() -> Self {
        Self {
            agenda: PerJoint::default(),
            order: Order::BASE_FIRST,
            cycle_at: Instant::ZERO,
            first_us: 0,
            monitoring_us: 0,
        }
    }
}

impl Schedule {
    /// Sets the order in which drives are asked that have the same number of requests behind them.
    pub const fn set_order(&mut self, order: Order) {
        self.order = order;
    }

    /// Replaces what is left of a drive's agenda.
    pub fn set(&mut self, joint: JointIndex, agenda: Agenda) {
        self.agenda.set(joint, agenda);
    }

    /// Drops what is left of a drive's agenda and gives it to be filled.
    pub fn restart(&mut self, joint: JointIndex) -> &mut Agenda {
        let agenda = self.agenda.at_mut(joint);
        agenda.clear();
        agenda
    }

    /// Drops what is left of a drive's agenda.
    pub fn clear(&mut self, joint: JointIndex) {
        self.agenda.set(joint, Agenda::EMPTY);
    }

    /// Drops everything.
    pub fn clear_all(&mut self) {
        self.agenda = PerJoint::default();
    }

    /// True if a drive has nothing on its agenda and no request on its way.
    pub fn is_done(&self, joint: JointIndex, drive: &DriveRecord) -> bool {
        self.agenda.at(joint).is_done() && !drive.is_asked()
    }

    /// Adds to a drive's agenda.
    pub fn push(&mut self, joint: JointIndex, request: Request) -> bool {
        self.agenda.at_mut(joint).push(request)
    }

    /// Begins a cycle at `cycle_at`: its first slot comes `first` later, and reads for monitoring wait for `monitoring`.
    pub fn begin_cycle(&mut self, cycle_at: Instant, first: Duration, monitoring: Duration) {
        self.cycle_at = cycle_at;
        self.first_us = micros(first).saturating_sub(GUARD_US);
        self.monitoring_us = micros(monitoring);
    }

    /// Gives the motion on a drive's agenda its slot in the cycle, µs from its start.
    pub const fn hold_motion(&mut self, joint: JointIndex, slot_us: u32) {
        self.agenda.at_mut(joint).hold_motion(slot_us);
    }

    /// Time of the cycle, µs.
    fn since_us(&self, now: Instant) -> u32 {
        micros(now.saturating_since(self.cycle_at))
    }

    /// When the next request of a drive may go out, µs from the start of the cycle.
    fn opens_us(&self, agenda: &Agenda) -> u32 {
        match agenda.head() {
            Some(Request::Get(_)) => self.monitoring_us,
            _ => agenda.slot_us().unwrap_or(0),
        }
    }

    /// Begins a round of [`Self::next`].
    pub fn round(
        &self,
        now: Instant,
        joints: impl Iterator<Item = JointIndex>,
        drives: &PerJoint<DriveRecord>,
    ) -> Round {
        let mut round = Round { level: u8::MAX, index: 0, count: 0, busy: 0, clear_for_motion: false };
        let since_us = self.since_us(now);
        let near = self.first_us <= since_us;
        for joint in joints {
            round.count += 1;
            if drives.at(joint).is_asked() {
                round.busy += 1;
                continue;
            }
            let agenda = self.agenda.at(joint);
            if agenda.is_done() {
                continue;
            }
            round.level = round.level.min(agenda.level());
            if near && let Some(slot_us) = agenda.slot_us() {
                if slot_us <= since_us {
                    round.level = 0;
                } else {
                    round.clear_for_motion |= slot_us < since_us.saturating_add(GUARD_US);
                }
            }
        }
        round
    }

    /// Next request to send now, if the number of drives asked at the same time allows one. Takes it off the
    /// agenda unless a barrier has to go before it.
    ///
    /// Within a round nothing but what this returns may be sent. The order is that of the map above: motions whose slot
    /// has come, then least sent first, then [`Order`]. A round visits each drive once per place of an agenda.
    pub fn next(
        &mut self,
        round: &mut Round,
        now: Instant,
        drives: &PerJoint<DriveRecord>,
        in_flight_max: usize,
    ) -> Option<Next> {
        let since_us = self.since_us(now);
        while round.level <= AGENDA_MAX as u8 && round.busy < in_flight_max {
            while round.index < round.count {
                let Ok(place) = JointIndex::new(round.index) else { break };
                let joint = self.order.joint_at(place);
                round.index += 1;
                let agenda = self.agenda.at(joint);
                let drive = drives.at(joint);
                if agenda.is_done() || drive.is_asked() {
                    continue;
                }
                let its_turn = match round.level {
                    0 => agenda.slot_us().is_some_and(|slot_us| slot_us <= since_us),
                    level => agenda.level() == level,
                };
                if !its_turn {
                    continue;
                }
                let Some(wanted) = agenda.head() else { continue };
                let request = if drive.can_send(Lane::Main, wanted, now) {
                    let waits = match agenda.slot_us() {
                        Some(slot_us) => since_us < slot_us,
                        None => {
                            let is_monitoring = matches!(wanted, Request::Get(_));
                            round.clear_for_motion || (is_monitoring && since_us < self.monitoring_us)
                        }
                    };
                    if waits {
                        continue;
                    }
                    let request = *wanted;
                    self.agenda.at_mut(joint).advance();
                    request
                } else if let Some(barrier) = barrier(drive, wanted, now) {
                    barrier
                } else {
                    continue;
                };
                round.busy += 1;
                return Some(Next { joint, request });
            }
            (round.level, round.index) = (round.level + 1, 0);
        }
        None
    }

    /// Earliest time at which a request that has to wait for its slot or its key can go out.
    pub fn wake_up(
        &self,
        now: Instant,
        joints: impl Iterator<Item = JointIndex>,
        drives: &PerJoint<DriveRecord>,
    ) -> Option<Instant> {
        let since_us = self.since_us(now);
        let mut earliest: Option<Instant> = None;
        for joint in joints {
            let (agenda, drive) = (self.agenda.at(joint), drives.at(joint));
            if agenda.is_done() || drive.is_asked() {
                continue;
            }
            let opens_us = self.opens_us(agenda);
            let opens = (opens_us > since_us).then(|| self.cycle_at + Duration::from_micros(opens_us.into()));
            for wake_up in [opens, drive.barred_until(now)].into_iter().flatten() {
                earliest = Some(earliest.map_or(wake_up, |other| other.min(wake_up)));
            }
        }
        earliest
    }
}

/// Microseconds; 71 minutes and more count as 71 minutes.
fn micros(span: Duration) -> u32 {
    u32::try_from(span.as_micros()).unwrap_or(u32::MAX)
}

/// A read that makes the key of the wanted request free by being answered.
fn barrier(drive: &DriveRecord, wanted: &Request, now: Instant) -> Option<Request> {
    let barriers = [Parameter::CubeState, Parameter::ActPos, Parameter::DefVersion].map(Request::Get);
    let is_other = |barrier: &Request| Key::of_request(barrier) != Key::of_request(wanted);
    barriers.into_iter().find(|barrier| is_other(barrier) && drive.can_send(Lane::Main, barrier, now))
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::powercube::{Reply, Value};

    fn joints() -> impl Iterator<Item = JointIndex> + Clone {
        JointIndex::first(6)
    }

    fn set_a() -> Request {
        Request::Set(Parameter::TargetAcc, Value::F32(1.0))
    }

    fn set_v() -> Request {
        Request::Set(Parameter::TargetVel, Value::F32(1.0))
    }

    #[test]
    fn first_requests_of_all_joints_go_before_any_second_one_within_the_window() {
        let (mut schedule, mut drives) = (Schedule::default(), PerJoint::<DriveRecord>::default());
        for joint in joints() {
            schedule.set(joint, Agenda::of(&[set_a(), set_v()]));
        }
        let mut order = Vec::new();
        let mut waiting = Vec::new();
        for k in 0..40u64 {
            let now = Instant::from_micros(100 * k);
            let mut round = schedule.round(now, joints(), &drives);
            while let Some(next) = schedule.next(&mut round, now, &drives, 4) {
                drives.at_mut(next.joint).begin(now, Lane::Main, &next.request, Instant::FAR_FUTURE);
                order.push((next.joint.get(), next.request == set_a()));
                waiting.push((next.joint, next.request));
            }
            assert!(waiting.len() <= 4);
            if !waiting.is_empty() {
                let (joint, request) = waiting.remove(0);
                let Request::Set(parameter, _) = request else { panic!() };
                drives.at_mut(joint).match_reply(now, &Reply::SetAck { parameter, code: Some(0x64) });
            }
        }
        let firsts: Vec<_> = (0..6).map(|joint| (joint, true)).collect();
        let seconds: Vec<_> = (0..6).map(|joint| (joint, false)).collect();
        assert_eq!(order, [firsts, seconds].concat());
    }

    fn motion() -> Request {
        use protocol::powercube::{MotionCommand, MotionRequest};
        Request::Move(MotionRequest::extended(MotionCommand::Ramp {
            target: protocol::units::Radians::new(1.0),
        }))
    }

    fn ask(schedule: &mut Schedule, drives: &mut PerJoint<DriveRecord>, us: u64) -> Vec<(usize, Request)> {
        let now = Instant::from_micros(us);
        let mut round = schedule.round(now, joints(), drives);
        let mut asked = Vec::new();
        while let Some(next) = schedule.next(&mut round, now, drives, 4) {
            drives.at_mut(next.joint).begin(now, Lane::Main, &next.request, Instant::FAR_FUTURE);
            asked.push((next.joint.get(), next.request));
        }
        asked
    }

    fn acknowledge(drives: &mut PerJoint<DriveRecord>, joint: usize, parameter: Parameter, us: u64) {
        let reply = Reply::SetAck { parameter, code: Some(0x64) };
        drives.at_mut(JointIndex::new(joint).unwrap()).match_reply(Instant::from_micros(us), &reply);
    }

    #[test]
    fn motion_waits_for_its_slot_and_the_wake_up_is_the_slot() {
        let (mut schedule, mut drives) = (Schedule::default(), PerJoint::<DriveRecord>::default());
        let joint = JointIndex::new(0).unwrap();
        schedule.set(joint, Agenda::of(&[set_a(), motion()]));
        schedule.hold_motion(joint, 1_000);
        assert_eq!(ask(&mut schedule, &mut drives, 0), [(0, set_a())]);
        acknowledge(&mut drives, 0, Parameter::TargetAcc, 400);
        assert_eq!(ask(&mut schedule, &mut drives, 999), []);
        let wake_up = schedule.wake_up(Instant::from_micros(999), joints(), &drives);
        assert_eq!(wake_up, Some(Instant::from_micros(1_000)));
        assert_eq!(ask(&mut schedule, &mut drives, 1_000), [(0, motion())]);
        // A motion without a slot, of a stop for example, goes at once.
        schedule.set(joint, Agenda::of(&[motion()]));
        assert_eq!(ask(&mut schedule, &mut PerJoint::default(), 1_001), [(0, motion())]);
    }

    #[test]
    fn drive_with_two_writes_sends_both_before_the_others_send_their_one() {
        let (mut schedule, mut drives) = (Schedule::default(), PerJoint::<DriveRecord>::default());
        for joint in joints() {
            let both = joint.get() == 3;
            let agenda = if both { vec![set_v(), set_a(), motion()] } else { vec![set_a(), motion()] };
            schedule.set(joint, Agenda::of(&agenda));
            schedule.hold_motion(joint, 1_000);
        }
        let first: Vec<usize> = ask(&mut schedule, &mut drives, 0).iter().map(|(joint, _)| *joint).collect();
        assert_eq!(first, [3, 0, 1, 2]);
        acknowledge(&mut drives, 3, Parameter::TargetVel, 400);
        assert_eq!(ask(&mut schedule, &mut drives, 400), [(3, set_a())]);
    }

    #[test]
    fn nothing_but_a_motion_goes_out_just_before_a_slot_and_reads_for_monitoring_wait_for_theirs() {
        let (mut schedule, mut drives) = (Schedule::default(), PerJoint::<DriveRecord>::default());
        let [first, second] = [0, 1].map(|joint| JointIndex::new(joint).unwrap());
        schedule.begin_cycle(Instant::ZERO, Duration::from_micros(1_000), Duration::from_micros(2_000));
        schedule.set(first, Agenda::of(&[motion()]));
        schedule.hold_motion(first, 1_000);
        schedule.set(second, Agenda::of(&[set_a()]));
        assert_eq!(ask(&mut schedule, &mut drives, 900), []);
        assert_eq!(ask(&mut schedule, &mut drives, 1_000), [(0, motion()), (1, set_a())]);
        let third = JointIndex::new(2).unwrap();
        let monitored = Request::Get(Parameter::Cur);
        schedule.push(third, monitored);
        assert_eq!(ask(&mut schedule, &mut drives, 1_999), []);
        assert_eq!(ask(&mut schedule, &mut drives, 2_000), [(2, monitored)]);
    }

    #[test]
    fn barred_request_is_preceded_by_a_read() {
        let (mut schedule, mut drives) = (Schedule::default(), PerJoint::<DriveRecord>::default());
        let joint = JointIndex::new(0).unwrap();
        let drive = drives.at_mut(joint);
        drive.begin(Instant::ZERO, Lane::Main, &set_a(), Instant::from_micros(2_000));
        drive.give_up_due(Instant::from_micros(2_000));
        let now = Instant::from_micros(3_000);
        schedule.set(joint, Agenda::of(&[set_a()]));
        let ask = |schedule: &mut Schedule, drives: &PerJoint<DriveRecord>| {
            schedule.next(&mut schedule.round(now, joints(), drives), now, drives, 4).unwrap()
        };
        let barrier = ask(&mut schedule, &drives);
        assert_eq!(barrier.request, Request::Get(Parameter::CubeState));
        let drive = drives.at_mut(joint);
        drive.begin(now, Lane::Main, &barrier.request, now + Duration::from_millis(2));
        drive.match_reply(now, &Reply::Value(Parameter::CubeState, Value::U32(2)));
        assert_eq!(ask(&mut schedule, &drives).request, set_a());
        assert!(schedule.is_done(joint, &DriveRecord::default()));
    }
}

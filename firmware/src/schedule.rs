//! Who is asked what next: the agenda of each drive in the running cycle, and how many drives are asked
//! at the same time.
//!
//! # The control cycle on the bus
//!
//! Per joint: write acceleration (or speed), wait for its acknowledge, send the motion, wait for its
//! answer: four frames, 372 to 450 bits, so six joints fill 2.2 to 2.7 ms at 1 Mbit/s. A drive thinks for 0.1 to
//! 0.3 ms before it answers; that time is free only if other drives use it. With W drives asked at
//! once the bus is full ([`crate::pace`] has the whole count) as soon as W · (request + answer) > request + answer + thinking, about three at
//! 0.3 ms; [`Settings::in_flight_max`] is four. More would only put frames into transmit queues, where a
//! halt could wait behind them.
//!
//! Order: all first requests before any second one, base first. Done joint by joint, the last joint's
//! two answers would both be waited for with an idle bus; this way it is one.
//!
//! A joint keeps its place in the cycle from cycle to cycle, so its commands come one period apart although
//! the joints' times differ.
//!
//! [`Settings::in_flight_max`]: crate::settings::Settings::in_flight_max

use protocol::powercube::{Parameter, Request};
use protocol::{Instant, JointIndex};

use crate::drives::{Drive, Key, Lane};
use crate::joints::PerJoint;

/// Requests of one drive in one cycle: speed, acceleration, motion, guest.
pub const AGENDA_MAX: usize = 4;

/// What one drive is still to be asked in this cycle.
#[derive(Clone, Copy, Debug, Default)]
pub struct Agenda {
    /// Those from `next` to `len` are still to be sent; what lies outside is old.
    requests: [Option<Request>; AGENDA_MAX],
    next: u8,
    len: u8,
}

impl Agenda {
    /// Nothing.
    pub const EMPTY: Self = Self { requests: [None; AGENDA_MAX], next: 0, len: 0 };

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

    /// Drops all.
    pub const fn clear(&mut self) {
        (self.next, self.len) = (0, 0);
    }

    /// True if nothing is left to be sent.
    pub const fn is_done(&self) -> bool {
        self.next >= self.len
    }

    /// Next request.
    pub fn head(&self) -> Option<Request> {
        if self.is_done() { None } else { *self.requests.get(usize::from(self.next))? }
    }

    /// Requests sent so far.
    pub const fn sent(&self) -> usize {
        self.next as usize
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
    level: usize,
    first: usize,
    busy: usize,
}

/// Agendas of all drives.
#[derive(Clone, Debug, Default)]
pub struct Schedule {
    agenda: PerJoint<Agenda>,
}

impl Schedule {
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
    pub fn is_done(&self, joint: JointIndex, drive: &Drive) -> bool {
        self.agenda.at(joint).is_done() && !drive.is_asked()
    }

    /// Adds to a drive's agenda.
    pub fn push(&mut self, joint: JointIndex, request: Request) -> bool {
        self.agenda.at_mut(joint).push(request)
    }

    /// Begins a round of [`Self::next`].
    pub fn round(&self, joints: impl Iterator<Item = JointIndex>, drives: &PerJoint<Drive>) -> Round {
        let busy = joints.filter(|&joint| drives.at(joint).is_asked()).count();
        Round { level: 0, first: 0, busy }
    }

    /// Next request to send now, if the number of drives asked at the same time allows one. Takes it off the
    /// agenda unless a barrier has to go before it.
    ///
    /// Within a round nothing but what this returns may be sent. The order is that of the map above: least sent first,
    /// then base first. A round visits each drive once per place of an agenda.
    pub fn next(
        &mut self,
        round: &mut Round,
        now: Instant,
        joints: &(impl Iterator<Item = JointIndex> + Clone),
        drives: &PerJoint<Drive>,
        in_flight_max: usize,
    ) -> Option<Next> {
        while round.level < AGENDA_MAX && round.busy < in_flight_max {
            for joint in joints.clone().filter(|joint| joint.get() >= round.first) {
                let agenda = self.agenda.at_mut(joint);
                let drive = drives.at(joint);
                if agenda.sent() != round.level || agenda.is_done() || drive.is_asked() {
                    continue;
                }
                let Some(wanted) = agenda.head() else { continue };
                let request = if drive.can_send(Lane::Main, &wanted, now) {
                    agenda.advance();
                    wanted
                } else if let Some(barrier) = barrier(drive, &wanted, now) {
                    barrier
                } else {
                    continue;
                };
                round.first = joint.get() + 1;
                round.busy += 1;
                return Some(Next { joint, request });
            }
            (round.level, round.first) = (round.level + 1, 0);
        }
        None
    }

    /// Earliest time at which a request that has to wait for its key can go out.
    pub fn wake_up(
        &self,
        now: Instant,
        joints: impl Iterator<Item = JointIndex>,
        drives: &PerJoint<Drive>,
    ) -> Option<Instant> {
        let waiting =
            joints.filter(|&joint| !self.agenda.at(joint).is_done() && !drives.at(joint).is_asked());
        waiting.filter_map(|joint| drives.at(joint).barred_until(now)).min()
    }
}

/// A read that makes the key of the wanted request free by being answered.
fn barrier(drive: &Drive, wanted: &Request, now: Instant) -> Option<Request> {
    let barriers = [Parameter::CubeState, Parameter::ActPos, Parameter::DefVersion].map(Request::Get);
    let is_other = |barrier: &Request| Key::of_request(barrier) != Key::of_request(wanted);
    barriers.into_iter().find(|barrier| is_other(barrier) && drive.can_send(Lane::Main, barrier, now))
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::powercube::{Reply, Value};
    use protocol::{Duration, ModuleId};

    fn joints() -> impl Iterator<Item = JointIndex> + Clone {
        JointIndex::first(6)
    }

    fn set_a() -> Request {
        Request::Set(Parameter::TargetAcc, Value::F32(1.0))
    }

    fn set_v() -> Request {
        Request::Set(Parameter::TargetVel, Value::F32(1.0))
    }

    fn module() -> ModuleId {
        ModuleId::MIN
    }

    #[test]
    fn first_requests_of_all_joints_go_before_any_second_one_within_the_window() {
        let (mut schedule, mut drives) = (Schedule::default(), PerJoint::<Drive>::default());
        for joint in joints() {
            schedule.set(joint, Agenda::of(&[set_a(), set_v()]));
        }
        let mut order = Vec::new();
        let mut waiting = Vec::new();
        for k in 0..40u64 {
            let now = Instant::from_micros(100 * k);
            let mut round = schedule.round(joints(), &drives);
            while let Some(next) = schedule.next(&mut round, now, &joints(), &drives, 4) {
                drives.at_mut(next.joint).begin(Lane::Main, module(), next.request, Instant::FAR_FUTURE);
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

    #[test]
    fn barred_request_is_preceded_by_a_read() {
        let (mut schedule, mut drives) = (Schedule::default(), PerJoint::<Drive>::default());
        let joint = JointIndex::new(0).unwrap();
        let drive = drives.at_mut(joint);
        drive.begin(Lane::Main, module(), set_a(), Instant::from_micros(2_000));
        drive.give_up_due(Instant::from_micros(2_000));
        let now = Instant::from_micros(3_000);
        schedule.set(joint, Agenda::of(&[set_a()]));
        let ask = |schedule: &mut Schedule, drives: &PerJoint<Drive>| {
            schedule.next(&mut schedule.round(joints(), drives), now, &joints(), drives, 4).unwrap()
        };
        let barrier = ask(&mut schedule, &drives);
        assert_eq!(barrier.request, Request::Get(Parameter::CubeState));
        let drive = drives.at_mut(joint);
        drive.begin(Lane::Main, module(), barrier.request, now + Duration::from_millis(2));
        drive.match_reply(now, &Reply::Value(Parameter::CubeState, Value::U32(2)));
        assert_eq!(ask(&mut schedule, &drives).request, set_a());
        assert!(schedule.is_done(joint, &Drive::default()));
    }
}

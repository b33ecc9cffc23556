//! The control cycle: analyse all joints, decide one command for each, hand them to the schedule.
//!
//! In cycle k the commands are computed from what cycle k-1 measured and act from the joint's slot in cycle k on,
//! for one period. So the law's state is one period old when its command begins to act, and the feed forward is the mean
//! acceleration of the reference over the slot-to-slot interval ([`crate::feedback`]), taken the drive's lag later: a
//! command moves the drive's generator, and the position follows it by 2ζ/ω, 5 ms. Without this lead the jump of the
//! acceleration at the start of a throw leaves a speed error of lag × jump, 45 mrad/s, to the feedback. The designs of
//! `cubectl tune` count on it.

use core::borrow::BorrowMut;

use protocol::powercube::{Motion, MotionCommand, Parameter, Request, Value};
use protocol::units::Radians;
use protocol::{Duration, Instant, JointIndex};

use super::standing::REST_SLACK;
use super::{Controller, Generator};
use crate::fault::{Cause, Fault};
use crate::feedback::{self, ErrorState};
use crate::groups::powercube::drive_model::DriveModel;
use crate::groups::powercube::drives::{Drive, PositionSample};
use crate::groups::powercube::order::Order;
use crate::groups::powercube::ramp::{self, RampState};
use crate::groups::powercube::slots::Slots;
use crate::joints::{PerJoint, at_least, clamp};
use crate::path::PathClock;
use crate::span;
use crate::spline::{Setpoint, Spline};
use crate::state::{State, StopWay};
use crate::store::Storage;
use crate::supervisor::{self, Measured};
use crate::trace::Event;

/// Cycles between the order and the start of the plan: the loop settles on the standing reference.
const START_CYCLES: u64 = 2;
/// Pull of the generator model to the measured speed, 1/s: against drift by jitter of the slots; slow,
/// because the measured speed lags by the drive's position loop.
const GENERATOR_PULL_1_S: f32 = 5.0;
/// Commands in a row turned into braking before a soft limit that stop the group.
const NEAR_LIMIT_ROW: u8 = 3;

impl<S: Storage, M: BorrowMut<Spline>> Controller<S, M> {
    /// Begins the committed trajectory. Preconditions were checked by the order.
    pub(super) fn start_run(&mut self, now: Instant, release_us: Option<u32>) {
        let period = self.settings.cycle_period();
        let start = now + period * START_CYCLES;
        self.schedule.clear_all();
        // Arming has asked for a rehearsal; without one the period is all that is known.
        let cycle_us = self.cycle_times().1.unwrap_or(self.settings.cycle_period_us);
        let answer_us = PerJoint(self.drives.0.each_ref().map(Drive::answer_us));
        let order = Order::slowest_first(self.settings.joints as usize, &answer_us);
        self.schedule.set_order(order);
        self.slots = Slots::plan(&self.settings, cycle_us, &order);
        let hurry = now + Duration::from_micros(self.settings.reply_deadline_us.into());
        for joint in self.joints() {
            self.drives.at_mut(joint).hasten(hurry);
            let q_start_rad = self.spline.borrow().start_rad(joint);
            let q_rad = self.drives.at(joint).position.map_or(q_start_rad, |position| position.q_rad);
            let track = self.track.at_mut(joint);
            track.estimator = feedback::ErrorEstimator::default();
            track.estimator.update(q_rad - q_start_rad, 0.0, 0.0, 0.0, self.settings.weights());
            track.generator = Generator { at: now, ..Generator::default() };
            track.model = DriveModel::at_rest(now, q_rad);
            track.measured_at = now;
            // Not a measurement of a motion, but as good: the joint stands.
            track.fresh = true;
            (track.u_in_force, track.u_sent) = (0.0, 0.0);
            (track.missed, track.near_limit_in_row) = (false, 0);
            track.phase_us = self.slots.expected_phase_us(joint);
        }
        if let Some(release_us) = release_us {
            let opening = Duration::from_micros(self.settings.gripper_opening_us.into());
            self.gripper.plan(start + Duration::from_micros(release_us.into()), opening);
        }
        self.late_in_row = 0;
        self.pace.begin_run();
        self.machine.transition_to_running(now, &mut self.trace, PathClock::starting(start));
        // The first cycle begins now; a cycle of the monitor may be half way.
        self.tick_due = now + Duration::from_micros(1);
    }

    pub(super) fn running_tick(&mut self, now: Instant, late: Duration) {
        if !self.host_is_alive(now) {
            self.fail(now, Fault::group(Cause::HostLost));
            self.stopping_tick(now);
            return;
        }
        let State::Running { clock, parking } = *self.machine.state() else { return };
        // Only control steps want an answer of each joint per cycle: the ramp to the last knot is sent once.
        if parking.is_none() {
            self.watch_overrun(now, late);
        }
        match parking {
            Some(_) if self.all_at_rest(now) => self.stand(now),
            Some(until) if until <= now => {
                self.fail(now, Fault { cause: Cause::RestNotReached, joint: self.not_at_rest(now) });
            }
            Some(_) => self.park_poll(),
            None => {
                let (s_us, _) = clock.at(now);
                if s_us
                    >= i64::from(self.spline.borrow().duration_us())
                        + 2 * i64::from(self.settings.cycle_period_us)
                {
                    self.park(now);
                } else {
                    self.control_step(now, &clock);
                }
            }
        }
    }

    /// Counts cycles that begin late or while the last one is still at work; several in a row are a fault.
    pub(super) fn watch_overrun(&mut self, now: Instant, late: Duration) {
        // A guest that is still on its way delays nothing; a missed reply is counted as that.
        let unfinished = self.joints().any(|joint| {
            let track = self.track.at(joint);
            !track.fresh && !track.missed
        });
        let slept = late * 2 > self.settings.cycle_period();
        if !unfinished && !slept {
            self.late_in_row = 0;
            return;
        }
        self.counters.cycles_late = self.counters.cycles_late.saturating_add(1);
        self.late_in_row = self.late_in_row.saturating_add(1);
        self.note(now, Event::LateCycle);
        if self.late_in_row >= self.settings.cycle_late_max {
            self.fail(now, Fault::group(Cause::CycleOverrun));
        }
    }

    /// One control step of all joints.
    pub(super) fn control_step(&mut self, now: Instant, clock: &PathClock) {
        self.counters.cycles = self.counters.cycles.wrapping_add(1);
        self.pace.begin_cycle(now);
        self.schedule.begin_cycle(self.tick_at + self.slots.first(), self.tick_at + self.slots.guests());
        let guest = JointIndex::new((self.ticks % self.settings.joints.max(1)) as usize).ok();
        let (mut any_saturated, mut near_limit, mut extra_write) = (false, None, false);
        for joint in self.joints() {
            let mut command = self.decide(joint, clock);
            let track = self.track.at_mut(joint);
            (track.fresh, track.missed) = (false, false);
            any_saturated |= track.saturated;
            track.near_limit_in_row =
                if command.position_limited { track.near_limit_in_row.saturating_add(1) } else { 0 };
            if track.near_limit_in_row >= NEAR_LIMIT_ROW {
                near_limit = near_limit.or(Some(joint));
            }
            let both = command.velocity_rad_s.is_some() && command.acceleration_rad_s2.is_some();
            // A low speed is raised ahead of need, one joint per cycle, when the bus has room.
            if command.velocity_stale && !both && !extra_write && guest == Some(joint) {
                command.velocity_rad_s = Some(self.settings.joint.at(joint).v_max_rad_s);
            }
            extra_write |= command.velocity_rad_s.is_some() && command.acceleration_rad_s2.is_some();
            self.track.at_mut(joint).command = command;
            self.plan(joint, &command);
            self.schedule.hold_motion(joint, self.tick_at + self.slots.of(joint));
        }
        if any_saturated {
            self.counters.cycles_saturated = self.counters.cycles_saturated.saturating_add(1);
        }
        // After a late cycle the time is for catching up.
        let has_room = !extra_write && self.late_in_row == 0;
        if let Some(joint) = guest.filter(|_| self.settings.cycle_guest && has_room) {
            let turn = self.ticks / self.settings.joints.max(1);
            let parameter = if turn.is_multiple_of(2) { Parameter::Cur } else { Parameter::CubeState };
            self.schedule.push(joint, Request::Get(parameter));
        }
        if let Some(joint) = near_limit {
            self.fail(now, Fault::at(Cause::NearLimit, joint));
        }
    }

    /// The law of one joint: pure but for the track it updates.
    fn decide(&mut self, joint: JointIndex, clock: &PathClock) -> ramp::Command {
        let limits = self.settings.joint.at(joint);
        let (a_max_rad_s2, ramp_limits) = (limits.a_max_rad_s2, limits.ramp_limits(self.settings.reach_rad));
        let gains = limits.gains();
        let period = self.settings.cycle_period();
        let period_s = self.settings.cycle_period_s();
        let track = self.track.at_mut(joint);
        if !track.fresh {
            track.estimator.predict(period_s, track.u_in_force);
            track.measured_at += period;
        }
        let t_act = self.tick_at + Duration::from_micros(track.phase_us.into());
        let lead_s = span::seconds(t_act.saturating_since(track.measured_at));
        let (e_rad, de_rad_s) = (track.estimator.e_rad(), track.estimator.de_rad_s());
        let x = ErrorState { e_rad, de_rad_s, u_last_rad_s2: track.u_in_force };
        let u_rad_s2 = gains.apply(&x);
        let e_act_rad = e_rad + lead_s * (de_rad_s + 0.5 * lead_s * track.u_in_force);
        let v_rad_s = track.generator.v_at(t_act);

        // The generator has to be ahead of the reference by the drive's lag, or the position comes too late by it.
        let t_generator = t_act + Duration::from_micros(self.settings.drive_lag_us.into());
        let from = self.reference(joint, clock, t_generator);
        let to = self.reference(joint, clock, t_generator + period);
        let qdd_ref = feedback::mean_acceleration(from.qd_rad_s, to.qd_rad_s, period_s);
        let action = feedback::clip_to_remaining(u_rad_s2, qdd_ref, a_max_rad_s2);
        let state = RampState { q_rad: from.q_rad + e_act_rad, v_rad_s };
        let loaded = self.drives.at(joint).loaded;
        let command = ramp::realise(action.qdd_rad_s2, period_s, state, &ramp_limits, &loaded);

        let track = self.track.at_mut(joint);
        track.u_sent = command.qdd_rad_s2 - qdd_ref;
        track.saturated = action.saturated;
        command
    }

    pub(super) fn reference(&mut self, joint: JointIndex, clock: &PathClock, t: Instant) -> Setpoint {
        let (s_us, _) = clock.at(t);
        let along = self.spline.borrow_mut().at(joint, s_us);
        clock.in_time(t, along)
    }

    /// Puts a command on the agenda of its drive, in place of what is left there.
    pub(super) fn plan(&mut self, joint: JointIndex, command: &ramp::Command) {
        let target = Radians::new(self.settings.joint.at(joint).to_drive_rad(command.target_rad));
        let agenda = self.schedule.restart(joint);
        if let Some(v) = command.velocity_rad_s {
            agenda.push(Request::Set(Parameter::TargetVel, Value::F32(v)));
        }
        if let Some(a) = command.acceleration_rad_s2 {
            agenda.push(Request::Set(Parameter::TargetAcc, Value::F32(a)));
        }
        agenda.push(Request::Move(Motion::extended(MotionCommand::Ramp { target })));
    }

    /// A position came in: what it says about the joint, and what has been in force since.
    pub(super) fn take_measurement(
        &mut self,
        now: Instant,
        joint: JointIndex,
        sample: PositionSample,
        of_motion: bool,
    ) {
        let (clock, tracking) = match *self.machine.state() {
            State::Running { clock, parking } => (clock, parking.is_none()),
            State::Stopping { way: StopWay::Halted, .. } => return,
            State::Stopping { clock, way, .. } => (clock, way == StopWay::Path),
            _ => return,
        };
        let reference = self.reference(joint, &clock, sample.at);
        let limits = *self.settings.joint.at(joint);
        let weights = self.settings.weights();
        let loaded_v = self.drives.at(joint).loaded.v_rad_s.unwrap_or(limits.v_max_rad_s);
        let (tick_at, period_s) = (self.tick_at, self.settings.cycle_period_s());
        let short = self.drives.at(joint).short_state;
        let track = self.track.at_mut(joint);
        track.reference = reference;
        let dt_s = span::seconds_between(track.measured_at, sample.at);
        let e_rad = sample.q_rad - reference.q_rad;
        if tracking && of_motion {
            track.estimator.update(e_rad, dt_s, track.u_in_force, period_s, weights);
            track.measured_at = sample.at;
            // After the next control step it is the answer of the cycle before: that step is still to be answered.
            track.fresh = track.sent.cycle_at == tick_at;
            track.missed = false;
            track.phase_us = sample.at.saturating_since(track.sent.cycle_at).as_micros().min(40_000) as u32;
            let qd_rad_s = reference.qd_rad_s + track.estimator.de_rad_s();
            let mut v_rad_s = track.generator.v_at(sample.at);
            v_rad_s += clamp(GENERATOR_PULL_1_S * dt_s, 0.0, 0.2) * (qd_rad_s - v_rad_s);
            track.u_in_force = track.sent.u_rad_s2;
            track.generator =
                Generator { v_rad_s, a_rad_s2: track.sent.qdd_rad_s2, cap_rad_s: loaded_v, at: sample.at };
        }
        let qd_rad_s = if tracking { reference.qd_rad_s + track.estimator.de_rad_s() } else { 0.0 };
        let measured = Measured { q_rad: sample.q_rad, qd_rad_s, e_rad: if tracking { e_rad } else { 0.0 } };
        if of_motion && self.joints().all(|joint| self.track.at(joint).fresh) {
            self.pace.end_cycle(now);
        }
        let cause = supervisor::check_short_state(short).or(supervisor::check_motion(&measured, &limits));
        if let Some(cause) = cause {
            self.fail(now, Fault::at(cause, joint));
        }
    }

    /// The plan is at its end: each joint ramps to its last position and stays.
    fn park(&mut self, now: Instant) {
        let mut longest_s = 0.0;
        for joint in self.joints() {
            self.park_joint(joint);
            longest_s = at_least(self.park_time_s(joint), longest_s);
        }
        if let State::Running { parking, .. } = self.machine.data() {
            *parking = Some(now + span::of_seconds(longest_s) + REST_SLACK);
        }
    }

    /// Longest time that the ramp to the last knot takes, s.
    fn park_time_s(&self, joint: JointIndex) -> f32 {
        let limits = self.settings.joint.at(joint);
        let end_rad = self.spline.borrow().end_rad(joint);
        let way_rad = self.drives.at(joint).position.map_or(0.0, |position| (position.q_rad - end_rad).abs());
        // Brakes from the speed it has, and goes back and the rest of the way at the speed of a jog.
        let v_rad_s = self.track.at(joint).generator.v_rad_s.abs();
        let braking_s = v_rad_s / limits.jog_a_rad_s2;
        let back_rad = way_rad + 0.5 * v_rad_s * braking_s;
        braking_s + back_rad / limits.jog_v_rad_s + 2.0 * limits.jog_v_rad_s / limits.jog_a_rad_s2
    }

    /// A lost one is repeated: without it the drive would go on to the target of its last command.
    pub(super) fn park_joint(&mut self, joint: JointIndex) {
        let limits = *self.settings.joint.at(joint);
        let end_rad = self.spline.borrow().end_rad(joint);
        let command = ramp::Command {
            target_rad: clamp(end_rad, limits.q_min_rad, limits.q_max_rad),
            velocity_rad_s: Some(limits.jog_v_rad_s),
            acceleration_rad_s2: Some(limits.jog_a_rad_s2),
            ..ramp::Command::default()
        };
        self.plan(joint, &command);
    }

    pub(super) fn park_poll(&mut self) {
        for joint in self.joints() {
            if self.schedule.is_done(joint, self.drives.at(joint)) {
                let parameter =
                    if self.ticks.is_multiple_of(2) { Parameter::PosStateDio } else { Parameter::CubeState };
                self.schedule.push(joint, Request::Get(parameter));
            }
        }
    }
}

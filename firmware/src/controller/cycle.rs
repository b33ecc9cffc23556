//! Analyse, decide, act: what the controller does with each event of the group.
//!
//! ```text
//! analyse   an event: a measurement, a missed answer, a report of a drive     serve, analyse
//! decide    the state determines what follows: a path, a wait, a stop         period, running, stopping
//! act       each joint gets its set point, or the group gets a command        control_step
//! ```
//!
//! The states are those of the diagram in [`crate::state`]. [`super::stopping`] describes a stop,
//! [`super::standing`] describes when a joint stands, and [`super::tracker`] holds the control law of a joint.

use core::borrow::BorrowMut;

use protocol::{Instant, JointIndex};

use super::Controller;
use crate::fault::{Cause, Fault};
use crate::group::{Command, DriveGroup, GroupEvent, Measured};
use crate::joints::at_least;
use crate::path::PathClock;
use crate::reach::SoftLimits;
use crate::rest::REST_SLACK;
use crate::span;
use crate::spline::Spline;
use crate::state::{Homing, Jog, State, StopWay};
use crate::store::Storage;
use crate::supervisor;
use crate::trace::TraceEvent;

/// Homing fails after this many times the number of missed answers in a row that stops a path: homing does not depend on a
/// single answer.
const HOMING_PATIENCE: u32 = 2;

impl<S: Storage, M: BorrowMut<Spline>, G: DriveGroup> Controller<S, M, G> {
    /// Reacts to each event of this call and to each deadline that has come, then lets the group send.
    pub(super) fn serve(&mut self, now: Instant) {
        while let Some(event) = self.group.poll_event(now, &self.settings) {
            match event {
                GroupEvent::Measured(measured) => self.analyse(now, &measured),
                GroupEvent::Missed(joint, in_row) => self.analyse_missed(now, joint, in_row),
                GroupEvent::Implausible(joint, again) => self.analyse_implausible(now, joint, again),
                GroupEvent::Failed(fault) => self.fail(now, fault),
                GroupEvent::Cycle { late, overrun } => {
                    self.jitter = self.jitter.max(late);
                    self.period(now, overrun);
                }
                GroupEvent::Progress => self.enter(now, State::Boot),
                GroupEvent::Found if *self.machine.state() == State::Boot => self.stand(now),
                GroupEvent::Homed(joint) => self.go_on_homing(now, joint),
                GroupEvent::JogReleased => self.machine.release_jog(),
                GroupEvent::JogEnded if matches!(self.machine.state(), State::Jogging(_)) => self.stand(now),
                GroupEvent::Found | GroupEvent::JogEnded => {}
            }
        }
        self.expire(now);
        self.group.flush(now, &self.settings);
    }

    /// Updates the estimator of a joint with a measured position, and checks the motion of the joint.
    // Not inlined, here and below. Inlined, each event would save and restore the registers that all branches together need.
    #[inline(never)]
    fn analyse(&mut self, now: Instant, measured: &Measured) {
        let Measured { joint, sample, in_force, cause } = *measured;
        let tracker = self.trackers.at_mut(joint);
        let (clock, tracking) = match *self.machine.state() {
            State::Running { clock, parking } => (clock, parking.is_none()),
            State::Stopping { way: StopWay::Halted, .. } => return,
            State::Stopping { clock, way, .. } => (clock, way == StopWay::Path),
            _ => {
                tracker.set_missed(false);
                return;
            }
        };
        let reference = clock.reference(self.spline.borrow_mut(), joint, sample.at);
        tracker.set_reference(reference);
        if let Some(in_force) = in_force.filter(|_| tracking) {
            let period_s = span::seconds(self.group.profile(&self.settings).period);
            let weights = self.settings.weights();
            let (qd_rad_s, dt_s) = tracker.update(sample, in_force, period_s, weights);
            self.group.observe(joint, qd_rad_s, dt_s);
        }
        let (qd_rad_s, e_rad) =
            if tracking { (tracker.qd_rad_s(), sample.q_rad - reference.q_rad) } else { (0.0, 0.0) };
        let measured = supervisor::SupervisedSample { q_rad: sample.q_rad, qd_rad_s, e_rad };
        let limits = self.settings.joint.at(joint);
        // A joint that was jogged from outside its limits, or has no zero, may be stopped where it is.
        let soft = SoftLimits::kept(limits, self.group.is_homed(joint)).with(self.stood_at_rad.get(joint));
        let cause = cause.or(supervisor::check_motion(&measured, limits, soft));
        if let Some(cause) = cause {
            self.fail(now, Fault::at(cause, joint));
        }
    }

    #[inline(never)]
    fn analyse_missed(&mut self, now: Instant, joint: JointIndex, in_row: u32) {
        self.counters.replies_missed = self.counters.replies_missed.saturating_add(1);
        self.trackers.at_mut(joint).set_missed(true);
        self.note(now, TraceEvent::Missed(joint));
        let patience = match self.machine.state() {
            State::Running { .. } | State::Stopping { .. } | State::Jogging(_) => 1,
            State::Homing(_) => HOMING_PATIENCE,
            // While nothing moves, `judge_standing` counts missed answers; finding counts its own.
            _ => return,
        };
        if in_row >= patience * self.settings.reply_missed_max {
            self.fail(now, Fault::at(Cause::DriveSilent, joint));
        } else if matches!(self.machine.state(), State::Running { parking: Some(_), .. }) {
            // Without this command the drive would continue to the target of its last command.
            self.park_joint(now, joint);
        }
    }

    fn analyse_implausible(&mut self, now: Instant, joint: JointIndex, again: bool) {
        self.trackers.at_mut(joint).set_missed(true);
        self.note(now, TraceEvent::Implausible(joint));
        // A single implausible position may be a mix-up on the bus; two in a row are a fault.
        if again {
            self.fail(now, Fault::at(Cause::ReplyImplausible, joint));
        }
    }

    /// A period begins: what the state does with it.
    #[inline(never)]
    fn period(&mut self, now: Instant, overrun: bool) {
        match *self.machine.state() {
            State::Boot => {}
            State::Idle
            | State::Ready
            | State::Armed { .. }
            | State::Stopped { .. }
            | State::Fault { .. } => self.judge_standing(now),
            State::Homing(Homing { joint, .. }) | State::Jogging(Jog { joint, .. }) => {
                self.judge_places(now, Some(joint));
            }
            State::Running { .. } => self.running(now, overrun),
            State::Stopping { .. } => self.stopping(now),
        }
    }

    /// Leads the joints along the plan, then to its last knot.
    fn running(&mut self, now: Instant, overrun: bool) {
        let State::Running { clock, parking } = *self.machine.state() else { return };
        // Before the plan begins the joints stand, and drives may still answer requests that were sent before the order.
        let (s_us, _) = clock.at(now);
        let overrun = overrun && s_us > 0;
        match parking {
            Some(_) if self.all_at_rest(now) => self.stand(now),
            Some(_) => {}
            None if self.misses_start(now, s_us) => self.not_begun(now, Cause::StartPassed),
            None if self.is_overrun(now, overrun) => self.fail(now, Fault::group(Cause::CycleOverrun)),
            None if self.runs_dry(s_us) => self.fail(now, Fault::group(Cause::PathRanDry)),
            None => {
                let settled = self.group.profile(&self.settings).period * 2;
                let end_us = self.spline.borrow().end_us().saturating_add(settled.as_micros() as i64);
                if s_us >= end_us {
                    self.park(now);
                } else {
                    self.control_step(now, &clock);
                }
            }
        }
    }

    /// Counts periods that begin late or before the last one is done; true if there were too many in a row.
    fn is_overrun(&mut self, now: Instant, overrun: bool) -> bool {
        if !overrun {
            self.late_in_row = 0;
            return false;
        }
        self.counters.cycles_late = self.counters.cycles_late.saturating_add(1);
        self.late_in_row = self.late_in_row.saturating_add(1);
        self.note(now, TraceEvent::LateCycle);
        self.late_in_row >= self.settings.cycle_late_max
    }

    /// One set point for each joint.
    pub(super) fn control_step(&mut self, now: Instant, clock: &PathClock) {
        self.counters.cycles = self.counters.cycles.wrapping_add(1);
        let profile = self.group.profile(&self.settings);
        let (spline, period_s) = (self.spline.borrow_mut(), span::seconds(profile.period));
        let (mut any_saturated, mut near_limit) = (false, None);
        for joint in self.settings.joints() {
            let acts_at = self.group.acts_at(joint);
            let reference = clock.interval(spline, joint, acts_at + profile.lag, profile.period);
            let (tracker, limits) = (self.trackers.at_mut(joint), self.settings.joint.at(joint));
            let set_point = tracker.decide(&profile, period_s, limits, acts_at, reference);
            let taken = self.group.set_point(&self.settings, joint, &set_point);
            any_saturated |= tracker.is_saturated();
            if tracker.is_near_limit(taken) {
                near_limit = near_limit.or(Some(joint));
            }
        }
        if any_saturated {
            self.counters.cycles_saturated = self.counters.cycles_saturated.saturating_add(1);
        }
        if let Some(joint) = near_limit {
            self.fail(now, Fault::at(Cause::NearLimit, joint));
        }
    }

    /// The plan has ended or had not begun: each joint ramps to the last or the first knot, and stays there.
    pub(super) fn park(&mut self, now: Instant) {
        let mut longest_s = 0.0;
        for joint in self.settings.joints() {
            longest_s = at_least(self.park_time_s(joint), longest_s);
            self.park_joint(now, joint);
        }
        self.machine.park(now + span::of_seconds(longest_s) + REST_SLACK);
    }

    /// Last knot of the plan; the first one if it was not begun.
    fn park_rad(&self, joint: JointIndex) -> f32 {
        let spline = self.spline.borrow();
        if self.is_on_plan { spline.end_rad(joint) } else { spline.start_rad(joint) }
    }

    /// Longest time of the ramp to that knot, s.
    fn park_time_s(&self, joint: JointIndex) -> f32 {
        let limits = self.settings.joint.at(joint);
        let end_rad = self.park_rad(joint);
        let way_rad = self.group.position(joint).map_or(0.0, |position| (position.q_rad - end_rad).abs());
        // The joint brakes, returns over the braking way, and goes the rest of the way at jog speed.
        let v_rad_s = self.trackers.at(joint).qd_rad_s().abs();
        let braking_s = v_rad_s / limits.jog_a_rad_s2;
        let back_rad = way_rad + 0.5 * v_rad_s * braking_s;
        braking_s + back_rad / limits.jog_v_rad_s + 2.0 * limits.jog_v_rad_s / limits.jog_a_rad_s2
    }

    fn park_joint(&mut self, now: Instant, joint: JointIndex) {
        let q_rad = self.park_rad(joint);
        self.group.command(now, &self.settings, Command::MoveTo { joint, q_rad });
    }
}

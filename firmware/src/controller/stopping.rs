//! Faults and stops: the reaction of the group, and coming to rest.
//!
//! | reaction | while tracking | homing | jogging | nothing moves |
//! |---|---|---|---|---|
//! | path stop | the path is followed more and more slowly; a quick stop if the joints cannot keep to it, or if it takes too long | halt | quick stop | halt |
//! | quick stop | one ramp per joint to where it can just stop | halt | one ramp | halt |
//! | halt | halt at once | halt | halt | halt |
//!
//! At rest the halt goes out in every case: drives then refuse motion until a reset, which only an
//! explicit new start sends. Stopped is entered when all joints are measured at rest; until then the group is Stopping, and
//! the halt is repeated.

use core::borrow::BorrowMut;

use protocol::{Duration, Instant};

use super::Controller;
use super::standing::HALT_REPEAT;
use crate::fault::{Cause, Fault, Reaction};
use crate::freeze::{FreezeFrame, FrozenJoint};
use crate::group::{Command, DriveGroup, Law};
use crate::joints::PerJoint;
use crate::path::{PathClock, Slowing};
use crate::rest::HALT_REST_MAX;
use crate::spline::Spline;
use crate::state::{State, StateKind, StopWay};
use crate::store::Storage;
use crate::trace::TraceEvent;

/// Cycles on the standing reference before the halt of a path stop.
const SETTLE_CYCLES: u64 = 3;

impl<S: Storage, M: BorrowMut<Spline>, G: DriveGroup> Controller<S, M, G> {
    /// Reacts to a fault, unless a more severe reaction is already in progress.
    pub(super) fn fail(&mut self, now: Instant, fault: Fault) {
        self.react(now, fault, fault.cause.reaction());
    }

    /// Stop or fault with a chosen reaction.
    #[inline(never)]
    pub(super) fn react(&mut self, now: Instant, fault: Fault, reaction: Reaction) {
        self.gripper.cancel();
        self.group.cancel_gripper();
        self.offer = None;
        self.freeze_at(now, fault);
        match (*self.machine.state(), reaction) {
            (_, Reaction::Refuse) => {}
            // The first cause stays; a fault takes the place of a plain stop.
            (State::Fault { .. }, _) => self.note(now, TraceEvent::FurtherFault(fault)),
            (State::Stopped { .. }, _) if fault.cause.is_plain_stop() => {}
            (State::Stopping { fault: first, way, clock, .. }, _) => {
                let first = self.latch(now, first, fault);
                match (reaction, way) {
                    (Reaction::Halt, _) => self.end_stop(now, first),
                    (Reaction::QuickStop, StopWay::Path) => {
                        self.quick_stop(now, first, clock);
                    }
                    (Reaction::QuickStop, StopWay::Quick) => {
                        // Ramps are sent; a drive that does not answer gets its halt now.
                        self.halt_silent(now, fault);
                    }
                    (_, StopWay::Halted) if !first.cause.is_plain_stop() => self.end_stop(now, first),
                    (Reaction::QuickStop | Reaction::PathStop | Reaction::Refuse, _) => {}
                }
            }
            (State::Running { clock, parking: None }, Reaction::PathStop) => {
                let max = Duration::from_micros(self.settings.stop_path_max_us.into());
                let deadline = now + max;
                self.enter(now, State::Stopping { fault, way: StopWay::Path, clock, deadline });
            }
            (State::Running { clock, parking: None }, Reaction::QuickStop) => {
                self.quick_stop(now, fault, clock);
            }
            // Parked joints move no faster than a jog.
            (State::Running { parking: Some(_), .. }, _) => self.end_stop(now, fault),
            (State::Jogging(_), Reaction::PathStop | Reaction::QuickStop) => {
                self.quick_stop(now, fault, PathClock::starting(now));
            }
            (State::Boot, _) if fault.cause.is_plain_stop() => {
                self.halt(now);
                // The halt disturbs the proof of the watchdogs that may be in progress: search again.
                self.find(now, false);
            }
            (
                State::Running { .. }
                | State::Jogging(_)
                | State::Boot
                | State::Idle
                | State::Homing(_)
                | State::Ready
                | State::Armed { .. }
                | State::Stopped { .. },
                _,
            ) => self.end_stop(now, fault),
        }
    }

    /// Latches the first cause of `latched` and `new`; returns it.
    fn latch(&mut self, now: Instant, latched: Fault, new: Fault) -> Fault {
        let first = first_cause(latched, new);
        if first != new {
            self.note(now, TraceEvent::FurtherFault(new));
        }
        self.machine.latch(first);
        if let Some(frame) = self.freeze.as_mut().filter(|_| names(latched, new)) {
            frame.fault = first;
        }
        first
    }

    pub(super) fn halt(&mut self, now: Instant) {
        self.halt_due = now + HALT_REPEAT;
        self.group.command(now, &self.settings, Command::Halt);
        self.counters.halts = self.counters.halts.saturating_add(1);
        self.note(now, TraceEvent::Halt);
    }

    /// True in Fault until the joints are measured at rest, for at most [`HALT_REST_MAX`] after the last halt.
    pub fn is_braking(&self, now: Instant) -> bool {
        self.kind() == StateKind::Fault && now < self.halt_due + HALT_REST_MAX && !self.all_at_rest(now)
    }

    /// Sends the halt and enters the next state: Fault at once, Stopped when all joints stand.
    pub(super) fn end_stop(&mut self, now: Instant, fault: Fault) {
        self.halt(now);
        if !fault.cause.is_plain_stop() {
            self.group.command(now, &self.settings, Command::Abandon);
            self.enter(now, State::Fault { fault });
        } else if self.all_at_rest(now) {
            self.keep_places();
            self.enter_standing(now, State::Stopped { fault });
        } else {
            let (clock, deadline) = (PathClock::starting(now), now + HALT_REST_MAX);
            self.enter(now, State::Stopping { fault, way: StopWay::Halted, clock, deadline });
        }
    }

    /// Searches the drives from the beginning. With `reset`, errors and halts are cleared first.
    pub(super) fn find(&mut self, now: Instant, reset: bool) {
        // The freeze frame belongs to the fault that ends here.
        self.freeze = None;
        self.group.command(now, &self.settings, Command::Find { reset });
        self.enter(now, State::Boot);
    }

    fn halt_silent(&mut self, now: Instant, fault: Fault) {
        if let (Cause::DriveSilent | Cause::ReplyImplausible, Some(joint)) = (fault.cause, fault.joint) {
            self.group.command(now, &self.settings, Command::HaltJoint(joint));
        }
    }

    /// Every joint brakes on its own.
    pub(super) fn quick_stop(&mut self, now: Instant, fault: Fault, clock: PathClock) {
        let deadline = self.group.brake(now, &self.settings);
        self.enter(now, State::Stopping { fault, way: StopWay::Quick, clock, deadline });
        self.halt_silent(now, fault);
    }

    /// One period of coming to rest.
    pub(super) fn stopping(&mut self, now: Instant) {
        let State::Stopping { fault, way, mut clock, .. } = *self.machine.state() else { return };
        match way {
            StopWay::Halted if self.all_at_rest(now) => {
                self.keep_places();
                self.enter_standing(now, State::Stopped { fault });
            }
            StopWay::Halted => self.repeat_halt(now),
            StopWay::Quick => {}
            StopWay::Path if clock.is_standing() => {
                let settled = clock.since() + self.group.profile(&self.settings).period * SETTLE_CYCLES;
                if settled <= now {
                    self.end_stop(now, fault);
                } else {
                    self.control_step(now, &clock);
                }
            }
            StopWay::Path => {
                let open = self.first_open(now);
                let (_, rate) = clock.at(open);
                match self.slowing(open, &clock) {
                    // Before the start of the plan and after its end the reference stands anyway.
                    _ if rate <= 0.0 => clock.advance(open, 0.0),
                    Some(slowing) => clock.advance(open, slowing),
                    None => {
                        self.quick_stop(now, fault, clock);
                        return;
                    }
                }
                self.machine.slow_down(clock);
                self.control_step(now, &clock);
            }
        }
    }

    /// First time whose reference may still change. Drives that close their own loop already have the references before it.
    fn first_open(&self, now: Instant) -> Instant {
        let profile = self.group.profile(&self.settings);
        if profile.law == Law::Reference { now + profile.lag } else { now }
    }

    /// Hardest slowing down of path time that all joints can follow in the cycle that begins at `open`.
    fn slowing(&mut self, open: Instant, clock: &PathClock) -> Option<f32> {
        let mut slowing = Slowing::default();
        let ahead = open + self.group.profile(&self.settings).period;
        let (s_us, rate) = clock.at(ahead);
        for joint in self.joints() {
            let a_rad_s2 = self.settings.stop_share * self.settings.joint.at(joint).a_max_rad_s2;
            let along = self.spline.borrow_mut().at(joint, s_us);
            slowing.require(along, rate, a_rad_s2);
        }
        slowing.hardest_1_s()
    }

    /// Keeps the freeze frame of the first fault.
    fn freeze_at(&mut self, now: Instant, fault: Fault) {
        if fault.cause.is_plain_stop() || self.freeze.is_some() {
            return;
        }
        let path_us = match *self.machine.state() {
            State::Running { clock, .. } | State::Stopping { clock, .. } => clock.at(now).0,
            _ => 0,
        };
        let (state, joints): (StateKind, _) = (self.kind(), self.joints());
        let blank = FreezeFrame { at: now, fault, state, path_us, joints: PerJoint::default() };
        // Filled in place: it is 400 bytes.
        let frame = self.freeze.insert(blank);
        for joint in joints {
            let (position, readings) = (self.group.position(joint), self.group.readings(joint));
            let tracker = self.trackers.at(joint);
            let age = position.map(|position| now.saturating_since(position.at).as_micros());
            *frame.joints.at_mut(joint) = FrozenJoint {
                q_rad: position.map_or(0.0, |position| position.q_rad),
                e_rad: tracker.error().e_rad(),
                de_rad_s: tracker.error().de_rad_s(),
                qd_ref_rad_s: tracker.reference().qd_rad_s,
                qdd_command_rad_s2: readings.qdd_command_rad_s2,
                current_a: readings.current_a,
                short_state: readings.short_state,
                state: readings.state,
                missed_in_row: readings.missed_in_row,
                age_us: age.and_then(|age| u32::try_from(age).ok()).unwrap_or(u32::MAX),
            };
        }
    }
}

/// The first of a latched cause and a new one. Two exceptions: a fault replaces a plain stop, and the name of an
/// error replaces the report that there is an error.
fn first_cause(latched: Fault, new: Fault) -> Fault {
    let fault_after_stop = latched.cause.is_plain_stop() && !new.cause.is_plain_stop();
    if fault_after_stop || names(latched, new) { new } else { latched }
}

/// True if `new` explains `latched`. The short state that comes with a position reports only that the drive has an
/// error; the state word, which is read next, names the error. All watchdogs wait for the same sign of life, so one
/// drive whose watchdog has expired explains the others.
fn names(latched: Fault, new: Fault) -> bool {
    let reported = Cause::DriveTowError.code()..=Cause::DriveLostHome.code();
    latched.cause == Cause::DriveError
        && reported.contains(&new.cause.code())
        && (latched.joint == new.joint || new.cause == Cause::DriveWatchdog)
}

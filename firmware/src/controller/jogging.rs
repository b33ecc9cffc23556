//! Jogging: one joint at reduced speed, acceleration and current, while the order is repeated.
//!
//! Each step sends the drive to where it would be when the hold time ends, braking included: a controller that
//! falls silent leaves a joint that stops there by itself.

use core::borrow::BorrowMut;

use protocol::powercube::{Motion, MotionCommand, Parameter, Request, Value};
use protocol::units::Radians;
use protocol::{Duration, Instant, JointIndex};

use super::Controller;
use super::boot::RESET_SETTLE;
use super::standing::REST_SLACK;
use crate::fault::{Cause, Fault, Refusal};
use crate::groups::powercube::drive_model::DriveModel;
use crate::groups::powercube::ramp::{self, RampState};
use crate::groups::powercube::schedule::Agenda;
use crate::joints::clamp;
use crate::orders::JOG_HOLD_MAX;
use crate::span;
use crate::spline::Spline;
use crate::state::{Jog, JogStep, State};
use crate::store::Storage;

impl<S: Storage, M: BorrowMut<Spline>> Controller<S, M> {
    pub(super) fn order_jog(
        &mut self,
        now: Instant,
        joint: JointIndex,
        qd_rad_s: f32,
        hold: Duration,
    ) -> Result<(), Refusal> {
        if joint.get() >= self.settings.joints as usize {
            return Err(Refusal::of(Cause::JointUnknown));
        }
        if !qd_rad_s.is_finite() || hold > JOG_HOLD_MAX || hold.is_zero() {
            return Err(Refusal::at(Cause::BadValue, joint));
        }
        self.require_host(now)?;
        let limits = *self.settings.joint.at(joint);
        let qd_rad_s = clamp(qd_rad_s, -limits.jog_v_rad_s, limits.jog_v_rad_s);
        let until = now + hold;
        if let State::Jogging(jog) = self.machine.data() {
            let same = jog.joint == joint && matches!(jog.step, JogStep::Starting | JogStep::Moving);
            if !same {
                return Err(Refusal::at(Cause::OrderNotNow, joint));
            }
            (jog.qd_rad_s, jog.until) = (qd_rad_s, until);
            return Ok(());
        }
        if self.drives.at(joint).position.is_none() {
            return Err(Refusal::at(Cause::DriveNotReady, joint));
        }
        if matches!(self.machine.state(), State::Stopped { .. }) {
            self.send_reset(now);
        }
        let q_rad = self.drives.at(joint).position.map_or(0.0, |position| position.q_rad);
        self.track.at_mut(joint).model = DriveModel::at_rest(now, q_rad);
        self.schedule.clear_all();
        self.offer = None;
        self.machine.transition_to_jogging(
            now,
            &mut self.trace,
            Jog { joint, qd_rad_s, until, step: JogStep::Starting },
        );
        self.start_jog(joint);
        Ok(())
    }

    fn start_jog(&mut self, joint: JointIndex) {
        let limits = *self.settings.joint.at(joint);
        let requests = [
            Request::Set(Parameter::MaxCur, Value::F32(limits.slow_current_a)),
            Request::Set(Parameter::TargetVel, Value::F32(limits.jog_v_rad_s)),
            Request::Set(Parameter::TargetAcc, Value::F32(limits.jog_a_rad_s2)),
        ];
        self.schedule.set(joint, Agenda::of(&requests));
    }

    pub(super) fn jogging_tick(&mut self, now: Instant, jog: Jog) {
        if !self.host_is_alive(now) && matches!(jog.step, JogStep::Starting | JogStep::Moving) {
            self.fail(now, Fault::group(Cause::HostLost));
            return;
        }
        match jog.step {
            JogStep::Starting | JogStep::Moving if jog.until <= now || jog.qd_rad_s == 0.0 => {
                self.release_jog(now, jog);
            }
            JogStep::Moving => {
                if self.schedule.is_done(jog.joint, self.drives.at(jog.joint)) {
                    let target_rad = self.jog_target(now, &jog);
                    self.schedule.set(jog.joint, Agenda::of(&self.jog_requests(&jog, target_rad)));
                    // Each tenth step its current, in the same breath.
                    if self.ticks.is_multiple_of(10) {
                        self.schedule.push(jog.joint, Request::Get(Parameter::Cur));
                    }
                }
            }
            JogStep::Releasing { .. } if self.all_at_rest(now) => {
                self.restore_current(jog.joint);
                self.set_jog_step(JogStep::Restoring);
            }
            JogStep::Releasing { until } if until <= now => {
                self.fail(now, Fault { cause: Cause::RestNotReached, joint: self.not_at_rest(now) });
                return;
            }
            JogStep::Releasing { .. } => {
                if self.schedule.is_done(jog.joint, self.drives.at(jog.joint)) {
                    let parameter = if self.ticks.is_multiple_of(2) {
                        Parameter::PosStateDio
                    } else {
                        Parameter::CubeState
                    };
                    self.schedule.push(jog.joint, Request::Get(parameter));
                }
            }
            JogStep::Starting if self.schedule.is_done(jog.joint, self.drives.at(jog.joint)) => {
                self.begin_to_move(now);
            }
            JogStep::Starting | JogStep::Restoring => {}
        }
        self.judge_places(now, Some(jog.joint));
        for joint in self.joints().filter(|&joint| joint != jog.joint) {
            if self.schedule.is_done(joint, self.drives.at(joint)) {
                self.schedule.push(joint, self.poll_request(joint));
            }
        }
    }

    /// Speed as a write before the motion: it keeps the keys alternating, and the cap up to date.
    fn jog_requests(&self, jog: &Jog, target_rad: f32) -> [Request; 2] {
        let limits = self.settings.joint.at(jog.joint);
        let target = Radians::new(limits.to_drive_rad(target_rad));
        let v = jog.qd_rad_s.abs().min(limits.jog_v_rad_s);
        [
            Request::Set(Parameter::TargetVel, Value::F32(v)),
            Request::Move(Motion::extended(MotionCommand::Ramp { target })),
        ]
    }

    /// Where the joint comes to rest if this is the last word. An unhomed joint has no limits to keep.
    fn jog_target(&self, now: Instant, jog: &Jog) -> f32 {
        let limits = self.settings.joint.at(jog.joint);
        let q_rad = self.drives.at(jog.joint).position.map_or(0.0, |position| position.q_rad);
        let left_s = span::seconds(jog.until.saturating_since(now));
        let way_rad = jog.qd_rad_s * left_s + 0.5 * jog.qd_rad_s * jog.qd_rad_s.abs() / limits.jog_a_rad_s2;
        let target_rad = q_rad + way_rad;
        if self.drive_is_homed(jog.joint) {
            clamp(target_rad, limits.q_min_rad.min(q_rad), limits.q_max_rad.max(q_rad))
        } else {
            target_rad
        }
    }

    /// Ramp to rest from where the joint is.
    fn release_jog(&mut self, now: Instant, jog: Jog) {
        let limits = *self.settings.joint.at(jog.joint);
        let Some(position) = self.drives.at(jog.joint).position else { return };
        let v_rad_s = if jog.step == JogStep::Moving { jog.qd_rad_s } else { 0.0 };
        let state = RampState { q_rad: position.q_rad, v_rad_s };
        let stop = ramp::stop(state, limits.jog_a_rad_s2, &limits.ramp_limits(self.settings.reach_rad));
        let homed = self.drive_is_homed(jog.joint);
        let free_rad = position.q_rad + 0.5 * v_rad_s * v_rad_s.abs() / limits.jog_a_rad_s2;
        let target_rad = if homed { stop.target_rad } else { free_rad };
        if jog.step == JogStep::Moving {
            self.schedule.set(jog.joint, Agenda::of(&self.jog_requests(&jog, target_rad)));
        } else {
            self.schedule.clear(jog.joint);
        }
        let rest_s = 2.0 * limits.jog_v_rad_s / limits.jog_a_rad_s2;
        let until = now + span::of_seconds(rest_s) + REST_SLACK;
        self.set_jog_step(JogStep::Releasing { until });
    }

    /// Current limit, speed and acceleration are set. A drive that was reset opens its brake first.
    fn begin_to_move(&mut self, now: Instant) {
        if now >= self.reset_at + RESET_SETTLE {
            self.set_jog_step(JogStep::Moving);
        }
    }

    fn set_jog_step(&mut self, step: JogStep) {
        if let State::Jogging(jog) = self.machine.data() {
            jog.step = step;
        }
    }

    pub(super) fn jogging_on_missed(&mut self, joint: JointIndex, jog: Jog, request: Request) {
        match (jog.step, request) {
            (JogStep::Starting, _) => self.start_jog(joint),
            (JogStep::Restoring, Request::Set(..)) => self.restore_current(joint),
            (JogStep::Moving | JogStep::Releasing { .. } | JogStep::Restoring, _) => {}
        }
    }

    pub(super) fn jogging_on_answer(&mut self, now: Instant, jog: Jog, joint: JointIndex) {
        if joint != jog.joint || !self.schedule.is_done(joint, self.drives.at(joint)) {
            return;
        }
        match jog.step {
            JogStep::Starting => self.begin_to_move(now),
            JogStep::Restoring => self.stand(now),
            JogStep::Moving | JogStep::Releasing { .. } => {}
        }
    }
}

//! Homing: joint by joint from the hand to the base (so the arm is light when the big joints turn), at the
//! drive's homing speed with a lowered current limit, bounded in time.

use core::borrow::BorrowMut;

use protocol::powercube::{CubeState, Parameter, Request, SimpleCommand, Value};
use protocol::{Duration, Instant, JointIndex};

use super::Controller;
use crate::fault::{Cause, Fault, Refusal};
use crate::groups::powercube::schedule::Agenda;
use crate::spline::Spline;
use crate::state::{Homing, HomingStep, State};
use crate::store::Storage;
use crate::supervisor;

impl<S: Storage, M: BorrowMut<Spline>> Controller<S, M> {
    pub(super) fn order_home(&mut self, now: Instant, mask: u8) -> Result<(), Refusal> {
        if let State::Homing(homing) = self.machine.state() {
            // The same joints again: the answer was lost.
            let left = homing.mask & !mask == 0 && mask != 0;
            return if left { Ok(()) } else { Err(Refusal::of(Cause::OrderNotNow)) };
        }
        let known = (1u32 << self.settings.joints) - 1;
        if mask == 0 || u32::from(mask) & !known != 0 {
            return Err(Refusal::of(Cause::JointUnknown));
        }
        self.require_host(now)?;
        if matches!(self.machine.state(), State::Stopped { .. }) {
            self.send_reset(now);
        }
        self.keep_places();
        self.schedule.clear_all();
        self.offer = None;
        self.home_next(now, mask);
        Ok(())
    }

    /// Goes on with the highest joint of the mask, or ends.
    fn home_next(&mut self, now: Instant, mask: u8) {
        let next = self.joints().rev().find(|joint| mask & (1 << joint.get()) != 0);
        let Some(joint) = next else {
            self.stand(now);
            return;
        };
        let deadline = now + Duration::from_micros(self.settings.home_timeout_us.into());
        let homing = Homing { mask, joint, step: HomingStep::Starting, deadline };
        self.machine.transition_to_homing(now, &mut self.trace, homing);
        self.start_homing(joint);
    }

    fn start_homing(&mut self, joint: JointIndex) {
        let limits = *self.settings.joint.at(joint);
        let requests = [
            Request::Set(Parameter::MaxCur, Value::F32(limits.slow_current_a)),
            Request::Set(Parameter::HomeVel, Value::F32(limits.home_v_rad_s)),
            Request::Simple(SimpleCommand::Home),
        ];
        self.schedule.set(joint, Agenda::of(&requests));
    }

    pub(super) fn homing_tick(&mut self, now: Instant, homing: Homing) {
        if !self.host_is_alive(now) {
            self.fail(now, Fault::group(Cause::HostLost));
            return;
        }
        if homing.deadline <= now {
            self.fail(now, Fault::at(Cause::HomingTimeout, homing.joint));
            return;
        }
        self.judge_places(now, Some(homing.joint));
        for joint in self.joints() {
            if !self.schedule.is_done(joint, self.drives.at(joint)) {
                continue;
            }
            // The joint at work: its state word, its position and sometimes its current.
            let request = match (joint == homing.joint, self.ticks % 4) {
                (true, 0) => Request::Get(Parameter::Cur),
                (true, 2) => Request::Get(Parameter::PosStateDio),
                (true, _) => Request::Get(Parameter::CubeState),
                (false, _) => self.poll_request(joint),
            };
            self.schedule.push(joint, request);
        }
    }

    pub(super) fn homing_on_missed(&mut self, joint: JointIndex, homing: Homing, request: Request) {
        match (homing.step, request) {
            // All of it again: each write may be repeated, and so may the order.
            (HomingStep::Starting, _) => self.start_homing(joint),
            (HomingStep::Restoring, Request::Set(..)) => self.restore_current(joint),
            (HomingStep::Searching | HomingStep::Restoring, _) => {}
        }
    }

    pub(super) fn restore_current(&mut self, joint: JointIndex) {
        let current_a = self.settings.joint.at(joint).current_max_a;
        let request = Request::Set(Parameter::MaxCur, Value::F32(current_a));
        self.schedule.set(joint, Agenda::of(&[request]));
    }

    pub(super) fn homing_on_answer(
        &mut self,
        now: Instant,
        homing: Homing,
        joint: JointIndex,
        request: Request,
    ) {
        if joint != homing.joint {
            return;
        }
        let step = match (homing.step, request) {
            (HomingStep::Starting, Request::Simple(SimpleCommand::Home)) => HomingStep::Searching,
            (HomingStep::Searching, Request::Get(Parameter::CubeState)) => {
                let Some((state, _)) = self.drives.at(joint).state else { return };
                if supervisor::check_state_word(state, false).is_some() {
                    self.fail(now, Fault::at(Cause::HomingFailed, joint));
                    return;
                }
                if !state.contains(CubeState::HOME_OK) || !self.all_at_rest(now) {
                    return;
                }
                self.restore_current(joint);
                HomingStep::Restoring
            }
            (HomingStep::Restoring, Request::Set(Parameter::MaxCur, _)) => {
                // Its position counts from its zero now.
                self.keep_places();
                self.home_next(now, homing.mask & !(1 << joint.get()));
                return;
            }
            _ => return,
        };
        if let State::Homing(data) = self.machine.data() {
            data.step = step;
        }
    }
}

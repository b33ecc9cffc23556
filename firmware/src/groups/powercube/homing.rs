//! Homing of one joint, at the drive's homing speed with a lowered current limit.

use protocol::powercube::{CubeState, Parameter, Request, SimpleCommand, Value};
use protocol::{Instant, JointIndex};

use super::settings::{HOME_V_RAD_S, SLOW_CURRENT_A};
use super::words::check_state_word;
use super::{Mode, PowerCubes};
use crate::fault::{Cause, Fault};
use crate::group::GroupEvent;
use crate::settings::Settings;

/// Homing in work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Homing {
    pub(super) joint: JointIndex,
    step: Step,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    /// Current limit, speed and the order itself are on their way.
    Starting,
    /// The drive has taken the order and looks for its zero.
    Searching,
    /// The current limit is put back.
    Restoring,
}

impl PowerCubes {
    pub(super) fn home(&mut self, settings: &Settings, joint: JointIndex) {
        if !matches!(self.mode, Mode::Homing(_)) {
            self.schedule.clear_all();
        }
        self.mode = Mode::Homing(Homing { joint, step: Step::Starting });
        self.start_homing(settings, joint);
    }

    fn start_homing(&mut self, settings: &Settings, joint: JointIndex) {
        self.set_agenda(
            joint,
            &[
                Request::Set(Parameter::MaxCur, Value::F32(SLOW_CURRENT_A.at(settings, joint))),
                Request::Set(Parameter::HomeVel, Value::F32(HOME_V_RAD_S.at(settings, joint))),
                Request::Simple(SimpleCommand::Home),
            ],
        );
    }

    pub(super) fn homing_period(&mut self, settings: &Settings, homing: Homing) {
        self.timing.abandon();
        for joint in settings.joints() {
            if !self.schedule.is_done(joint, self.drives.at(joint)) {
                continue;
            }
            // The joint at work: its state word, its position and sometimes its current.
            let request = match (joint == homing.joint, self.cycle.number % 4) {
                (true, 0) => Request::Get(Parameter::Cur),
                (true, 2) => Request::Get(Parameter::PosStateDio),
                (true, _) => Request::Get(Parameter::CubeState),
                (false, _) => self.look_request(settings, joint, false),
            };
            self.schedule.push(joint, request);
        }
    }

    pub(super) fn homing_on_missed(&mut self, settings: &Settings, homing: Homing, request: Request) {
        match (homing.step, request) {
            // All of it again: each write may be repeated, and so may the order.
            (Step::Starting, _) => self.start_homing(settings, homing.joint),
            (Step::Restoring, Request::Set(..)) => self.restore_current(settings, homing.joint),
            (Step::Searching | Step::Restoring, _) => {}
        }
    }

    pub(super) fn restore_current(&mut self, settings: &Settings, joint: JointIndex) {
        self.set_agenda(joint, &[Self::current_write(settings, joint)]);
    }

    pub(super) fn homing_on_answer(
        &mut self,
        now: Instant,
        settings: &Settings,
        homing: Homing,
        request: Request,
    ) {
        let joint = homing.joint;
        let step = match (homing.step, request) {
            (Step::Starting, Request::Simple(SimpleCommand::Home)) => Step::Searching,
            (Step::Searching, Request::Get(Parameter::CubeState)) => {
                let Some((state, _)) = self.drives.at(joint).state else { return };
                if check_state_word(state).is_some() {
                    self.fail(Fault::at(Cause::HomingFailed, joint));
                    return;
                }
                let all_stand = settings.joints().all(|joint| self.stands(now, settings, joint));
                if !state.contains(CubeState::HOME_OK) || !all_stand {
                    return;
                }
                self.restore_current(settings, joint);
                Step::Restoring
            }
            (Step::Restoring, Request::Set(Parameter::MaxCur, _)) => {
                self.push(GroupEvent::Homed(joint));
                return;
            }
            _ => return,
        };
        self.mode = Mode::Homing(Homing { joint, step });
    }
}

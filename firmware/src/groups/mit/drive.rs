//! One motor as the group knows it: its step, its answers, its set point.

use protocol::mit::{RegisterRequest, State, Status};
use protocol::{Frame, Instant};

use super::finding::{self, Step};
use crate::fault::Cause;
use crate::groups::answers::{Answers, Worth, only_turn_rad};
use crate::groups::position::{self, Drive as _};
use crate::groups::shape::Axis;
use crate::settings::JointSettings;

/// Width of a standing position, rad: four steps of the position. A joint without a brake creeps slowly against its friction.
const STANDING_RAD: f32 = 1_530e-6;

/// See the [module](self).
#[derive(Clone, Copy, Debug, Default)]
pub struct Drive {
    pub(super) step: Step,
    /// Periods in this step.
    pub(super) periods: u32,
    /// Since when the motor has got no command that feeds it; `None`: it is being asked for the first time.
    pub(super) looked_since: Option<Instant>,
    pub(super) answers: Answers,
    /// It was a request for a register.
    pub(super) asked: Option<RegisterRequest>,
    /// Place of the last command in its burst, from 1.
    pub(super) place: u64,
    pub(super) state: Option<State>,
    /// Torque that the set point needs, N·m.
    pub(super) ahead_nm: f32,
    /// Whole turns between the motor and the joint, rad.
    turn_rad: f32,
    pub(super) is_proven: bool,
    pub(super) is_homed: bool,
}

impl Drive {
    /// Looks for the motor from the beginning, unless it is held and answers.
    pub(super) fn find(&mut self, missed_max: u32) {
        if !self.is_held() || self.answers.missed_in_row > missed_max || self.cause(u8::MAX).is_some() {
            *self = Self { is_proven: self.is_proven, ..Self::default() };
        }
    }

    pub(super) fn go_to(&mut self, step: Step) {
        if self.step != step {
            (self.step, self.periods) = (step, 0);
        }
    }

    /// What the motor reports about itself.
    pub(super) fn cause(&self, hot_c: u8) -> Option<Cause> {
        let state = self.state.as_ref()?;
        let is_hot = state.transistors_c >= hot_c || state.rotor_c >= hot_c;
        finding::cause(state.status).or(is_hot.then_some(Cause::DrivePowerFault))
    }

    fn joint_rad(&self, limits: &JointSettings, p_rad: f32) -> f32 {
        limits.to_joint_rad(p_rad) + self.turn_rad
    }

    /// Position, velocity and torque for the motor.
    pub(super) fn for_motor(&self, limits: &JointSettings, set: Axis) -> (f32, f32, f32) {
        let turned = |value: f32| if limits.inverted { -value } else { value };
        let p_rad = limits.to_drive_rad(set.q_rad - self.turn_rad);
        (p_rad, turned(set.v_rad_s), turned(self.ahead_nm))
    }

    /// Takes a state that the motor measured at `at`.
    pub(super) fn take(&mut self, state: State, at: Instant, limits: &JointSettings, frame: &Frame) -> Worth {
        let q_rad = self.joint_rad(limits, state.p_rad);
        let follows = self.is_held() && state.status == Status::Enabled;
        let worth = self.answers.take(frame, q_rad, at, limits, follows, STANDING_RAD);
        if worth == Worth::Measured {
            self.state = Some(state);
        }
        worth
    }

    /// The motor gives torque from now on: the set point is where it stands, in the only turn within the limits.
    pub(super) fn hold_here(&mut self, limits: &JointSettings) -> Option<f32> {
        let found_rad = self.answers.sample?.q_rad;
        self.is_homed = false;
        let turn_rad = only_turn_rad(limits, found_rad).unwrap_or(0.0);
        self.turn_rad += turn_rad;
        self.answers.shift(turn_rad);
        let q_rad = found_rad + turn_rad;
        self.answers.sent = Axis { q_rad, v_rad_s: 0.0 };
        Some(q_rad)
    }

    /// The shaft is absolute within a turn: the joint is at home if no other turn would be within the limits.
    pub(super) fn home(&mut self, limits: &JointSettings) -> bool {
        let turn_rad = self.answers.sample.and_then(|sample| only_turn_rad(limits, sample.q_rad));
        self.is_homed = self.is_held() && turn_rad == Some(0.0);
        self.is_homed
    }
}

impl position::Drive for Drive {
    fn answers(&self) -> &Answers {
        &self.answers
    }

    fn answers_mut(&mut self) -> &mut Answers {
        &mut self.answers
    }

    fn is_held(&self) -> bool {
        self.step == Step::Held
    }

    fn is_homed(&self) -> bool {
        self.is_homed
    }

    fn switch_off(&mut self, _: Instant) {
        self.go_to(Step::Off);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hot_motor_is_reported_before_it_stops_by_itself_and_each_status_has_its_cause() {
        let state = |status, rotor_c| State {
            nibble: 1,
            status,
            p_rad: 0.0,
            v_rad_s: 0.0,
            t_nm: 0.0,
            transistors_c: 40,
            rotor_c,
        };
        for (status, rotor_c, cause) in [
            (Status::Enabled, 89, None),
            (Status::Enabled, 90, Some(Cause::DrivePowerFault)),
            (Status::RotorHot, 101, Some(Cause::DrivePowerFault)),
            (Status::LinkLost, 40, Some(Cause::DriveWatchdog)),
            (Status::UnderVoltage, 40, Some(Cause::DriveSupply)),
            (Status::Overload, 40, Some(Cause::OverCurrent)),
            (Status::Disabled, 40, Some(Cause::DriveError)),
        ] {
            let drive = Drive { state: Some(state(status, rotor_c)), ..Drive::default() };
            assert_eq!(drive.cause(90), cause, "{status:?} {rotor_c}");
        }
    }
}

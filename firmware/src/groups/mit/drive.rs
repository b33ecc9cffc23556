//! One motor as the group knows it: its step, its answers, its set point.

use core::f32::consts::TAU;

use mit_protocol::{RegisterRequest, State, Status};
use protocol::{Frame, Instant};

use super::finding::{self, Step};
use crate::fault::Cause;
use crate::group::PositionSample;
use crate::groups::shape::Axis;
use crate::joints::at_least;
use crate::rest::Rest;
use crate::settings::JointSettings;
use crate::supervisor::is_plausible;

/// An answer is stale if it does not change in any bit while the set points move by this, rad: eight steps of the position.
const STALE_RAD: f32 = 3e-3;
/// Width of a standing position, µrad: four steps of the position. A joint without a brake creeps slowly against its friction.
const STANDING_URAD: u32 = 1_530;

/// What an answer is worth.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Worth {
    Measured,
    /// Torn, or the first stale one; true for the second torn one in a row.
    Implausible(bool),
    /// Stale again.
    Frozen,
}

/// See the [module](self).
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Drive {
    pub(super) step: Step,
    /// Periods in this step.
    pub(super) periods: u32,
    /// Since when the motor has got no command that feeds it; `None`: it is being asked for the first time.
    pub(super) looked_since: Option<Instant>,
    /// The last frame has no answer yet.
    pub(super) awaited: bool,
    /// The answer before was missed: the next one may be that one, late.
    pub(super) is_doubtful: bool,
    /// An answer came that may have been late: another one may follow.
    pub(super) may_follow: bool,
    /// It was a request for a register.
    pub(super) asked: Option<RegisterRequest>,
    /// Place of the last command in its burst, from 1.
    pub(super) place: u64,
    pub(super) missed_in_row: u32,
    implausible_in_row: u32,
    pub(super) state: Option<State>,
    /// Last answer, and how far the set point has moved since it first came.
    answer: Option<[u8; 8]>,
    moved_rad: f32,
    /// Set point sent last.
    pub(super) sent: Axis,
    /// Torque that the set point needs, N·m.
    pub(super) ahead_nm: f32,
    /// Whole turns between the motor and the joint, rad.
    turn_rad: f32,
    pub(super) sample: Option<PositionSample>,
    pub(super) rest: Rest<STANDING_URAD>,
    pub(super) is_proven: bool,
    pub(super) is_homed: bool,
}

impl Drive {
    pub(super) fn is_held(&self) -> bool {
        self.step == Step::Held
    }

    /// Looks for the motor from the beginning, unless it is held and answers.
    pub(super) fn find(&mut self, missed_max: u32) {
        if !self.is_held() || self.missed_in_row > missed_max || self.trouble(u8::MAX).is_some() {
            *self = Self { is_proven: self.is_proven, ..Self::default() };
        }
    }

    pub(super) fn go_to(&mut self, step: Step) {
        if self.step != step {
            (self.step, self.periods) = (step, 0);
        }
    }

    /// What the motor reports about itself.
    pub(super) fn trouble(&self, hot_c: u8) -> Option<Cause> {
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
        let data = frame.data().first_chunk::<8>().copied();
        if data != self.answer {
            (self.answer, self.moved_rad) = (data, 0.0);
        }
        let is_stale = self.is_held() && state.status == Status::Enabled && self.moved_rad >= STALE_RAD;
        if is_stale || !is_plausible(q_rad, at, self.sample, limits.v_max_rad_s) {
            self.implausible_in_row = self.implausible_in_row.saturating_add(1);
            let again = self.implausible_in_row > 1;
            return if again && is_stale { Worth::Frozen } else { Worth::Implausible(again) };
        }
        let sample = PositionSample { q_rad, at };
        self.implausible_in_row = 0;
        (self.state, self.sample) = (Some(state), Some(sample));
        self.rest.take(sample);
        Worth::Measured
    }

    /// The motor gives torque from now on: the set point is where it stands, in the only turn within the limits.
    pub(super) fn hold_here(&mut self, limits: &JointSettings) -> Option<f32> {
        let sample = self.sample?;
        self.is_homed = false;
        if let Some(turn_rad) = only_turn_rad(limits, sample.q_rad) {
            self.turn_rad += turn_rad;
            self.sample = Some(PositionSample { q_rad: sample.q_rad + turn_rad, ..sample });
            self.rest = Rest::default();
        }
        let q_rad = self.sample.map_or(sample.q_rad, |sample| sample.q_rad);
        self.sent = Axis { q_rad, v_rad_s: 0.0 };
        Some(q_rad)
    }

    /// The shaft is absolute within a turn: the joint is at home if no other turn would be within the limits.
    pub(super) fn home(&mut self, limits: &JointSettings) -> bool {
        let turn_rad = self.sample.and_then(|sample| only_turn_rad(limits, sample.q_rad));
        self.is_homed = self.is_held() && turn_rad == Some(0.0);
        self.is_homed
    }

    /// Notes that the set point is sent in this period. Returns its acceleration since the last one, rad/s².
    pub(super) fn send_set_point(&mut self, set: Axis, dt_s: f32) -> f32 {
        self.moved_rad = at_least(self.moved_rad + (set.q_rad - self.sent.q_rad).abs(), 0.0);
        let qdd_rad_s2 = (set.v_rad_s - self.sent.v_rad_s) / dt_s;
        self.sent = set;
        qdd_rad_s2
    }
}

/// The turn by which a position within a turn must be shifted to lie within the soft limits; `None` unless there is just one.
fn only_turn_rad(limits: &JointSettings, q_rad: f32) -> Option<f32> {
    let is_inside = |turn_rad: &f32| {
        let q_rad = q_rad + turn_rad;
        q_rad >= limits.q_min_rad && q_rad <= limits.q_max_rad
    };
    let mut inside = [-TAU, 0.0, TAU].into_iter().filter(is_inside);
    inside.next().filter(|_| inside.next().is_none())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::Settings;
    use protocol::JointIndex;

    #[test]
    fn turn_is_chosen_only_if_it_is_the_only_one_within_the_limits() {
        let mut limits = *Settings::powercube6().joint.at(JointIndex::new(0).unwrap());
        // The first joint of an OpenArm.
        (limits.q_min_rad, limits.q_max_rad) = (-80_f32.to_radians(), 200_f32.to_radians());
        let turn = |q_deg: f32| only_turn_rad(&limits, q_deg.to_radians());
        assert_eq!(turn(90.0), Some(0.0));
        assert_eq!(turn(-170.0), Some(TAU), "parked at 190 degrees");
        assert_eq!(turn(-120.0), None, "neither -120 nor 240 degrees");
        (limits.q_min_rad, limits.q_max_rad) = (-4.0, 4.0);
        assert_eq!(only_turn_rad(&limits, 3.0), None, "also at -3.28 rad");
    }

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
            assert_eq!(drive.trouble(90), cause, "{status:?} {rotor_c}");
        }
    }
}

//! One motor as the group knows it: its step, its answers, its set point.

use core::f32::consts::TAU;

use mit_protocol::{RegisterRequest, State, Status};
use protocol::{Duration, Frame, Instant};

use super::finding::{self, Step};
use crate::fault::Cause;
use crate::group::PositionSample;
use crate::groups::shape::Axis;
use crate::joints::{at_least, clamp};
use crate::reach::{SoftLimits, way_rad};
use crate::rest::Rest;
use crate::settings::JointSettings;
use crate::span;
use crate::supervisor::is_plausible;

/// Way of the set points while the answer stays the same, bit by bit, that shows a stale answer: eight steps of the position.
const STALE_RAD: f32 = 3e-3;
/// Width of a standing position, µrad: four steps of the position. A joint without a brake creeps slowly against its friction.
const STANDING_URAD: u32 = 1_530;
/// Share of the following error at which the set point waits for the motor.
const WINDOW_SHARE: f32 = 0.5;
/// A position older than this many periods bounds nothing.
const FRESH_PERIODS: u64 = 4;

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
    /// Set point, joint side.
    pub(super) set: Axis,
    /// The law gave it in this period.
    pub(super) is_given: bool,
    /// Distance of the set point from the measured position when [`super::Mode::Moving`] began: what the load takes.
    pub(super) load_rad: f32,
    pub(super) u_rad_s2: f32,
    pub(super) qdd_rad_s2: f32,
    pub(super) position_limited: bool,
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
    pub(super) fn for_motor(&self, limits: &JointSettings) -> (f32, f32, f32) {
        let turned = |value: f32| if limits.inverted { -value } else { value };
        let p_rad = limits.to_drive_rad(self.set.q_rad - self.turn_rad);
        (p_rad, turned(self.set.v_rad_s), turned(self.ahead_nm))
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
    pub(super) fn hold_here(&mut self, limits: &JointSettings) {
        let Some(sample) = self.sample else { return };
        self.is_homed = false;
        if let Some(turn_rad) = only_turn_rad(limits, sample.q_rad) {
            self.turn_rad += turn_rad;
            self.sample = Some(PositionSample { q_rad: sample.q_rad + turn_rad, ..sample });
            self.rest = Rest::default();
        }
        let q_rad = self.sample.map_or(sample.q_rad, |sample| sample.q_rad);
        self.set = Axis { q_rad, v_rad_s: 0.0 };
        self.sent = self.set;
    }

    /// The shaft is absolute within a turn: the joint is at home if no other turn would be within the limits.
    pub(super) fn home(&mut self, limits: &JointSettings) -> bool {
        let turn_rad = self.sample.and_then(|sample| only_turn_rad(limits, sample.q_rad));
        self.is_homed = self.is_held() && turn_rad == Some(0.0);
        self.is_homed
    }

    /// Position at `at`, if the joint goes on with the speed of the set point.
    fn ahead_rad(&self, at: Instant) -> Option<f32> {
        let sample = self.sample?;
        Some(sample.q_rad + self.set.v_rad_s * span::seconds_between(sample.at, at))
    }

    /// The set point after an acceleration for a period: v' = clip(v + a T), q' = q + (v + v') T / 2. One that could not stop before a
    /// soft limit brakes.
    pub(super) fn accelerate(
        &mut self,
        limits: &JointSettings,
        acts_at: Instant,
        qdd_rad_s2: f32,
        dt_s: f32,
    ) {
        let Axis { q_rad, v_rad_s } = self.set;
        let a_max = limits.a_max_rad_s2;
        let brake = clamp(-v_rad_s / dt_s, -a_max, a_max);
        let towards = |a: f32| clamp(v_rad_s + a * dt_s, -limits.v_max_rad_s, limits.v_max_rad_s);
        let v = towards(if qdd_rad_s2.is_finite() { clamp(qdd_rad_s2, -a_max, a_max) } else { brake });
        let measured_rad = self.ahead_rad(acts_at).unwrap_or(q_rad);
        let soft = SoftLimits::of(limits).with(measured_rad);
        let rest_rad = measured_rad + 0.5 * (v_rad_s + v) * dt_s + way_rad(v, a_max);
        self.position_limited =
            (rest_rad > soft.q_max_rad && v > 0.0) || (rest_rad < soft.q_min_rad && v < 0.0);
        let v = if self.position_limited { towards(brake) } else { v };
        self.qdd_rad_s2 = (v - v_rad_s) / dt_s;
        self.set = Axis { q_rad: q_rad + 0.5 * (v_rad_s + v) * dt_s, v_rad_s: v };
    }

    /// Keeps the set point near the measured position, so that a motor that is held up is not pulled ever harder.
    pub(super) fn keep_near(&mut self, now: Instant, limits: &JointSettings, period: Duration) {
        let is_fresh =
            self.sample.is_some_and(|sample| now.saturating_since(sample.at) <= period * FRESH_PERIODS);
        if let Some(q_rad) = self.ahead_rad(now).filter(|_| is_fresh) {
            let window_rad = WINDOW_SHARE * limits.error_max_rad;
            self.set.q_rad = clamp(self.set.q_rad, q_rad - window_rad, q_rad + window_rad);
        }
    }

    /// Notes that the set point is sent in this period. Returns its acceleration since the last one, rad/s².
    pub(super) fn send_set_point(&mut self, dt_s: f32) -> f32 {
        self.moved_rad = at_least(self.moved_rad + (self.set.q_rad - self.sent.q_rad).abs(), 0.0);
        let qdd_rad_s2 = (self.set.v_rad_s - self.sent.v_rad_s) / dt_s;
        self.sent = self.set;
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
    fn set_point_follows_the_acceleration_and_brakes_before_a_limit() {
        let limits = *Settings::powercube6().joint.at(JointIndex::new(0).unwrap());
        let now = Instant::from_micros(1_000);
        let at = |q_rad: f32, v_rad_s: f32| Drive {
            sample: Some(PositionSample { q_rad, at: now }),
            set: Axis { q_rad, v_rad_s },
            ..Drive::default()
        };
        let mut drive = at(0.0, 1.0);
        drive.accelerate(&limits, now, 5.0, 0.01);
        assert!((drive.set.v_rad_s - 1.05).abs() < 1e-6 && (drive.set.q_rad - 0.01025).abs() < 1e-6);
        drive.accelerate(&limits, now, f32::NAN, 0.01);
        assert!(drive.set.v_rad_s < 1.05, "no number brakes");
        // 2 rad/s need 0.192 rad with 10.4 rad/s2.
        let mut near = at(limits.q_max_rad - 0.15, 2.0);
        near.accelerate(&limits, now, 0.0, 0.003);
        assert!(near.position_limited && (near.qdd_rad_s2 + limits.a_max_rad_s2).abs() < 1e-2);
        let mut beyond = at(limits.q_max_rad + 0.1, -0.5);
        beyond.accelerate(&limits, now, 0.0, 0.003);
        assert!(!beyond.position_limited, "the way back is free");
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

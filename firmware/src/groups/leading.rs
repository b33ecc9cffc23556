//! Set points of a group that follows positions: the next one of each joint, from mode and orders (pure).

use protocol::{Duration, Instant, JointIndex};

use super::answers::Answers;
use super::dynamics::Motion;
use super::shape::Axis;
use crate::fault::{Cause, Refusal};
use crate::group::{Command, GroupEvent, InForce, PositionSample, Readings, SetPoint, Taken};
use crate::joints::{PerJoint, at_least, clamp};
use crate::reach::{self, SoftLimits, way_rad};
use crate::settings::{JointSettings, Settings};
use crate::span;

/// A jog is ordered to where its speed leads in this time, s: beyond every range.
const JOG_WAY_S: f32 = 1e3;
/// Share of the following error at which the set point waits for the drive.
const WINDOW_SHARE: f32 = 0.5;
/// A position older than this many periods bounds nothing.
const FRESH_PERIODS: u64 = 4;
/// Speed below which a set point stands, rad/s.
const STANDS_RAD_S: f32 = 1e-3;

/// What the set points do.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) enum Mode {
    /// With a reset faults are cleared.
    Finding {
        reset: bool,
    },
    #[default]
    Standing,
    Jogging {
        joint: JointIndex,
        qd_rad_s: f32,
        until: Instant,
        released: bool,
    },
    Tracking,
    /// Joints that have an end position go there.
    Moving,
    Braking,
    /// Brakes, and refuses motion.
    Halted,
}

/// The set point of a joint.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Led {
    /// Joint side.
    pub(super) set: Axis,
    /// The law gave it in this period.
    is_given: bool,
    end_rad: Option<f32>,
    /// Distance of the set point from the joint that the load takes, when [`Mode::Moving`] began.
    pub(super) load_rad: f32,
    pub(super) u_rad_s2: f32,
    /// That of the set point before.
    pub(super) u_before_rad_s2: f32,
    pub(super) qdd_rad_s2: f32,
    pub(super) position_limited: bool,
}

impl Led {
    /// The set point after an acceleration for a period: v' = clip(v + a T), q' = q + (v + v') T / 2. One that could not stop before a
    /// soft limit brakes. `measured_rad`: where the joint is when it begins to act.
    fn accelerate(&mut self, limits: &JointSettings, measured_rad: f32, qdd_rad_s2: f32, dt_s: f32) {
        let Axis { q_rad, v_rad_s } = self.set;
        let a_max = limits.a_max_rad_s2;
        let brake = clamp(-v_rad_s / dt_s, -a_max, a_max);
        let towards = |a: f32| clamp(v_rad_s + a * dt_s, -limits.v_max_rad_s, limits.v_max_rad_s);
        let v = towards(if qdd_rad_s2.is_finite() { clamp(qdd_rad_s2, -a_max, a_max) } else { brake });
        let soft = SoftLimits::of(limits).with(measured_rad);
        let rest_rad = measured_rad + 0.5 * (v_rad_s + v) * dt_s + way_rad(v, a_max);
        self.position_limited =
            (rest_rad > soft.q_max_rad && v > 0.0) || (rest_rad < soft.q_min_rad && v < 0.0);
        let v = if self.position_limited { towards(brake) } else { v };
        self.qdd_rad_s2 = (v - v_rad_s) / dt_s;
        self.set = Axis { q_rad: q_rad + 0.5 * (v_rad_s + v) * dt_s, v_rad_s: v };
    }

    /// Position at `at`, if the joint goes on with the speed of the set point.
    fn ahead_rad(&self, sample: Option<PositionSample>, at: Instant) -> Option<f32> {
        let sample = sample?;
        Some(sample.q_rad + self.set.v_rad_s * span::seconds_between(sample.at, at))
    }

    /// Keeps the set point near the measured position, so that a drive that is held up is not pulled ever harder.
    fn keep_near(
        &mut self,
        now: Instant,
        limits: &JointSettings,
        period: Duration,
        sample: Option<PositionSample>,
    ) {
        let is_fresh = sample.is_some_and(|sample| now.saturating_since(sample.at) <= period * FRESH_PERIODS);
        if let Some(q_rad) = self.ahead_rad(sample, now).filter(|_| is_fresh) {
            let window_rad = WINDOW_SHARE * limits.error_max_rad;
            self.set.q_rad = clamp(self.set.q_rad, q_rad - window_rad, q_rad + window_rad);
        }
    }
}

/// The set points of all joints.
#[derive(Debug)]
pub(super) struct Leader {
    pub(super) mode: Mode,
    pub(super) joints: PerJoint<Led>,
}

impl Leader {
    pub(super) fn new(mode: Mode) -> Self {
        Self { mode, joints: PerJoint::default() }
    }

    pub(super) const fn is_finding(&self) -> bool {
        matches!(self.mode, Mode::Finding { .. })
    }

    /// The joint stands at `q_rad`.
    pub(super) fn stand(&mut self, joint: JointIndex, q_rad: f32) {
        self.joints.at_mut(joint).set = Axis { q_rad, v_rad_s: 0.0 };
    }

    /// What an order changes in the set points. Returns the joint whose motion begins.
    pub(super) fn command(
        &mut self,
        now: Instant,
        settings: &Settings,
        command: Command,
    ) -> Option<JointIndex> {
        match command {
            Command::Find { reset } => self.mode = Mode::Finding { reset },
            Command::Stand { .. } if self.mode == Mode::Halted => {}
            Command::Reset | Command::Stand { .. } => self.mode = Mode::Standing,
            Command::Abandon | Command::Halt => self.mode = Mode::Halted,
            _ if self.mode == Mode::Halted => {}
            Command::Jog { joint, qd_rad_s, until } => {
                let until = if qd_rad_s == 0.0 { now } else { until };
                self.mode = Mode::Jogging { joint, qd_rad_s, until, released: false };
                return Some(joint);
            }
            Command::Track => {
                self.mode = Mode::Tracking;
                for joint in settings.joints() {
                    let led = self.joints.at_mut(joint);
                    (led.u_rad_s2, led.u_before_rad_s2) = (0.0, 0.0);
                }
            }
            Command::MoveTo { joint, q_rad } => {
                if self.mode != Mode::Moving {
                    self.mode = Mode::Moving;
                    settings.joints().for_each(|joint| self.joints.at_mut(joint).end_rad = None);
                }
                let is_first = self.joints.at_mut(joint).end_rad.replace(q_rad).is_none();
                return is_first.then_some(joint);
            }
            Command::Home(_) | Command::HaltJoint(_) => {}
        }
        None
    }

    /// The next set point of a drive that is held, kept near where its joint is at `reached_at`. From the last set point that the drive
    /// has certainly received, it is at most as far away as the joint goes in one period. The speed for this is that of the motion, or
    /// `v_catch_up_rad_s` if this is faster. A plan makes up for the rest in the next periods. A stop and a slow motion drop it.
    pub(super) fn next(
        &mut self,
        settings: &Settings,
        joint: JointIndex,
        reached_at: Instant,
        answers: &mut Answers,
        is_homed: bool,
        v_catch_up_rad_s: f32,
    ) -> Motion {
        self.lead(settings, joint, answers.sample, is_homed);
        let led = self.joints.at_mut(joint);
        led.keep_near(reached_at, settings.joint.at(joint), settings.cycle_period(), answers.sample);
        let Axis { q_rad, v_rad_s } = led.set;
        let dt_s = settings.cycle_period_s();
        let v_motion_rad_s = at_least(v_rad_s.abs(), answers.sent.v_rad_s.abs());
        let way_rad = at_least(v_motion_rad_s, v_catch_up_rad_s) * dt_s;
        let q_rad = clamp(q_rad, answers.taken_rad - way_rad, answers.taken_rad + way_rad);
        if self.mode != Mode::Tracking {
            led.set.q_rad = q_rad;
        }
        let qdd_rad_s2 = answers.send(Axis { q_rad, v_rad_s }, dt_s);
        Motion { q_rad, qd_rad_s: v_rad_s, qdd_rad_s2 }
    }

    /// A motion was ordered.
    pub(super) const fn moves(&self) -> bool {
        matches!(self.mode, Mode::Tracking | Mode::Moving | Mode::Jogging { .. })
    }

    /// The set point and the joint behind it stand, the joint for `swing` at least.
    pub(super) fn is_at_rest(
        &self,
        now: Instant,
        settings: &Settings,
        joint: JointIndex,
        answers: &Answers,
        swing: Duration,
    ) -> bool {
        let since = answers.rests_since(now, settings);
        self.joints.at(joint).set.v_rad_s.abs() <= STANDS_RAD_S
            && since.is_some_and(|since| now >= since + swing)
    }

    /// See [`crate::group::DriveGroup::check_group`].
    pub(super) fn check_group(&self) -> Result<(), Refusal> {
        let fit = !self.is_finding() && self.mode != Mode::Halted;
        if fit { Ok(()) } else { Err(Refusal::of(Cause::DriveNotReady)) }
    }

    /// See [`crate::group::Measured`]; `in_time`: the last set point acts.
    pub(super) fn in_force(&self, joint: JointIndex, in_time: bool) -> Option<InForce> {
        let led = self.joints.at(joint);
        let u_rad_s2 = if in_time { led.u_rad_s2 } else { led.u_before_rad_s2 };
        (self.mode == Mode::Tracking).then_some(InForce { u_rad_s2, in_time })
    }

    /// What the set points know; `state` and `error` are the family's.
    pub(super) fn readings(
        &self,
        joint: JointIndex,
        answers: &Answers,
        state: Option<u32>,
        error: bool,
    ) -> Readings {
        let led = self.joints.at(joint);
        Readings {
            qdd_command_rad_s2: led.qdd_rad_s2,
            position_limited: led.position_limited,
            error,
            halted: self.mode == Mode::Halted,
            missed_in_row: answers.missed_in_row,
            state,
            short_state: state.unwrap_or(0) as u8,
            ..Readings::default()
        }
    }

    /// Acceleration with which a joint brakes: slow motions end slowly.
    const fn braking_rad_s2(&self, limits: &JointSettings) -> f32 {
        match self.mode {
            Mode::Moving | Mode::Jogging { .. } => limits.jog_a_rad_s2,
            _ => limits.a_max_rad_s2,
        }
    }

    /// A jog that ends by itself.
    pub(super) fn proceed(&mut self, now: Instant, all_rest: bool) -> Option<GroupEvent> {
        match &mut self.mode {
            Mode::Jogging { qd_rad_s, until, released: released @ false, .. }
                if *until <= now || *qd_rad_s == 0.0 =>
            {
                *released = true;
                Some(GroupEvent::JogReleased)
            }
            Mode::Jogging { released: true, .. } if all_rest => {
                self.mode = Mode::Standing;
                Some(GroupEvent::JogEnded)
            }
            _ => None,
        }
    }

    /// Time for which the slowest joint brakes.
    pub(super) fn brake(&mut self, settings: &Settings) -> Duration {
        let mut longest_s = 0.0;
        for joint in settings.joints() {
            let a_rad_s2 = self.braking_rad_s2(settings.joint.at(joint));
            longest_s = at_least(self.joints.at(joint).set.v_rad_s.abs() / a_rad_s2, longest_s);
        }
        match &mut self.mode {
            Mode::Jogging { released, .. } => *released = true,
            Mode::Halted => {}
            mode => *mode = Mode::Braking,
        }
        span::of_seconds(longest_s)
    }

    /// The law gives a set point. `sample`: last position of the joint.
    pub(super) fn given(
        &mut self,
        limits: &JointSettings,
        joint: JointIndex,
        point: &SetPoint,
        sample: Option<PositionSample>,
    ) -> Taken {
        let led = self.joints.at_mut(joint);
        led.is_given = true;
        let measured_rad = led.ahead_rad(sample, point.acts_at).unwrap_or(led.set.q_rad);
        led.accelerate(limits, measured_rad, point.qdd_rad_s2, point.period_s);
        led.u_before_rad_s2 = led.u_rad_s2;
        led.u_rad_s2 = led.qdd_rad_s2 - point.qdd_reference_rad_s2;
        Taken { position_limited: led.position_limited }
    }

    /// The set point of a joint for the next period, unless the law gave it.
    fn lead(
        &mut self,
        settings: &Settings,
        joint: JointIndex,
        sample: Option<PositionSample>,
        is_homed: bool,
    ) {
        let (dt_s, limits) = (settings.cycle_period_s(), settings.joint.at(joint));
        let (mode, braking_rad_s2) = (self.mode, self.braking_rad_s2(limits));
        let led = self.joints.at_mut(joint);
        let is_given = core::mem::take(&mut led.is_given);
        let set = &mut led.set;
        match mode {
            Mode::Tracking if is_given => {}
            Mode::Moving if let Some(end_rad) = led.end_rad => {
                set.approach(end_rad + led.load_rad, limits.jog_v_rad_s, limits.jog_a_rad_s2, dt_s);
            }
            Mode::Jogging { joint: at_work, qd_rad_s, released: false, .. } if at_work == joint => {
                let q_rad = sample.map_or(set.q_rad, |sample| sample.q_rad);
                let soft = SoftLimits::kept(limits, is_homed);
                let way_rad = reach::reachable(q_rad, soft, q_rad + JOG_WAY_S * qd_rad_s) - q_rad;
                let v_max = clamp(qd_rad_s.abs(), 0.0, limits.jog_v_rad_s);
                set.approach(set.q_rad + way_rad, v_max, limits.jog_a_rad_s2, dt_s);
            }
            _ => set.drive(0.0, braking_rad_s2, dt_s),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn set_point_follows_the_acceleration_and_brakes_before_a_limit() {
        let limits = *Settings::powercube6().joint.at(JointIndex::new(0).unwrap());
        let at = |q_rad: f32, v_rad_s: f32| Led { set: Axis { q_rad, v_rad_s }, ..Led::default() };
        let mut led = at(0.0, 1.0);
        led.accelerate(&limits, 0.0, 5.0, 0.01);
        assert!((led.set.v_rad_s - 1.05).abs() < 1e-6 && (led.set.q_rad - 0.01025).abs() < 1e-6);
        led.accelerate(&limits, 0.01, f32::NAN, 0.01);
        assert!(led.set.v_rad_s < 1.05, "no number brakes");
        // 2 rad/s need 0.192 rad with 10.4 rad/s2.
        let mut near = at(limits.q_max_rad - 0.15, 2.0);
        near.accelerate(&limits, limits.q_max_rad - 0.15, 0.0, 0.003);
        assert!(near.position_limited && (near.qdd_rad_s2 + limits.a_max_rad_s2).abs() < 1e-2);
        let mut beyond = at(limits.q_max_rad + 0.1, -0.5);
        beyond.accelerate(&limits, limits.q_max_rad + 0.1, 0.0, 0.003);
        assert!(!beyond.position_limited, "the way back is free");
    }
}

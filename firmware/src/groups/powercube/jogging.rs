//! Jogging: one joint at reduced speed, acceleration and current, until the time of the order is over.
//!
//! Each step sends the drive to where it would be when that time ends, braking included: a controller that falls silent
//! leaves a joint that stops there by itself.

use protocol::powercube::{MotionCommand, MotionRequest, Parameter, Request, Value};
use protocol::units::Radians;
use protocol::{Duration, Instant, JointIndex};

use super::drive_model::DriveModel;
use super::readiness::RESET_SETTLE;
use super::settings::SLOW_CURRENT_A;
use super::{Mode, PowerCubes};
use crate::fault::{Cause, Fault};
use crate::group::GroupEvent;
use crate::reach::{self, SoftLimits};
use crate::rest::REST_SLACK;
use crate::settings::Settings;
use crate::span;

/// A target is made only from a position that is younger; two answers may be missed in between. A joint goes 8 mrad meanwhile at most.
const POSITION_AGE_MAX: Duration = Duration::from_millis(32);

/// Jog in work.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jog {
    pub(super) joint: JointIndex,
    /// Within the speed of a jog.
    qd_rad_s: f32,
    until: Instant,
    /// A motion has left.
    pub(super) led: bool,
    step: Step,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    /// Current limit, speed and acceleration are on their way.
    Starting,
    Moving,
    /// Ramps down; the joint must be measured at rest by then.
    Releasing {
        until: Instant,
    },
    /// The current limit is put back.
    Restoring,
}

impl Jog {
    /// The joint ramps to rest.
    pub(super) const fn is_releasing(self) -> bool {
        matches!(self.step, Step::Releasing { .. })
    }
}

impl PowerCubes {
    /// Begins a jog, or goes on with the one at work.
    pub(super) fn jog(
        &mut self,
        now: Instant,
        settings: &Settings,
        joint: JointIndex,
        qd_rad_s: f32,
        until: Instant,
    ) {
        if let Mode::Jogging(jog) = &mut self.mode {
            // Speed zero lets go. The joint brakes from the speed it was sent at: a drive with the order speed zero never arrives.
            let speed = if qd_rad_s == 0.0 { jog.qd_rad_s } else { qd_rad_s };
            (jog.qd_rad_s, jog.until) = (speed, if qd_rad_s == 0.0 { now } else { until });
            return;
        }
        self.axes.at_mut(joint).model = DriveModel::at_rest(now, self.q_rad(joint));
        self.schedule.clear_all();
        self.mode = Mode::Jogging(Jog { joint, qd_rad_s, until, led: false, step: Step::Starting });
        self.start_jog(settings, joint);
    }

    fn start_jog(&mut self, settings: &Settings, joint: JointIndex) {
        let limits = settings.joint.at(joint);
        self.set_agenda(
            joint,
            &[
                Request::Set(Parameter::MaxCur, Value::F32(SLOW_CURRENT_A.at(settings, joint))),
                Request::Set(Parameter::TargetVel, Value::F32(limits.jog_v_rad_s)),
                Request::Set(Parameter::TargetAcc, Value::F32(limits.jog_a_rad_s2)),
            ],
        );
    }

    pub(super) fn jogging_period(&mut self, now: Instant, settings: &Settings, jog: Jog) {
        self.timing.abandon();
        let is_free = self.schedule.is_done(jog.joint, self.drives.at(jog.joint));
        match jog.step {
            Step::Starting | Step::Moving if jog.until <= now || jog.qd_rad_s == 0.0 => {
                self.release_jog(now, settings, jog);
            }
            Step::Moving if is_free && !self.is_fresh(now, jog.joint) => {
                self.schedule.push(jog.joint, Request::Get(Parameter::PosStateDio));
            }
            Step::Moving if is_free => {
                let target_rad = self.jog_target(now, settings, &jog);
                self.set_agenda(jog.joint, &jog_requests(settings, &jog, target_rad));
                // Each tenth step its current, in the same breath.
                if self.cycle.number.is_multiple_of(10) {
                    self.schedule.push(jog.joint, Request::Get(Parameter::Cur));
                }
            }
            Step::Releasing { .. } if settings.joints().all(|joint| self.stands(now, settings, joint)) => {
                self.restore_current(settings, jog.joint);
                self.set_jog_step(Step::Restoring);
            }
            Step::Releasing { until } if until <= now => {
                let joint = settings.joints().find(|&joint| !self.stands(now, settings, joint));
                self.fail(Fault { cause: Cause::RestNotReached, joint });
                return;
            }
            Step::Releasing { .. } => self.watch(jog.joint),
            Step::Starting if is_free => self.begin_to_move(now),
            Step::Starting | Step::Moving | Step::Restoring => {}
        }
        for joint in settings.joints().filter(|&joint| joint != jog.joint) {
            if self.schedule.is_done(joint, self.drives.at(joint)) {
                self.schedule.push(joint, self.look_request(settings, joint, false));
            }
        }
    }

    /// Whether the position still says where the joint is: after a while without answers a target made from it may lie behind.
    fn is_fresh(&self, now: Instant, joint: JointIndex) -> bool {
        let position = self.drives.at(joint).position;
        position.is_some_and(|position| now.saturating_since(position.at) <= POSITION_AGE_MAX)
    }

    /// Where the joint comes to rest if this is the last command.
    fn jog_target(&self, now: Instant, settings: &Settings, jog: &Jog) -> f32 {
        let limits = settings.joint.at(jog.joint);
        let q_rad = self.q_rad(jog.joint);
        let left_s = span::seconds(jog.until.saturating_since(now));
        let way_rad = jog.qd_rad_s * left_s + reach::way_rad(jog.qd_rad_s, limits.jog_a_rad_s2);
        let soft = SoftLimits::kept(limits, self.drives.at(jog.joint).is_homed());
        reach::reachable(q_rad, soft, q_rad + way_rad)
    }

    /// Ramp to rest from where the joint is. One that was not led yet stays.
    fn release_jog(&mut self, now: Instant, settings: &Settings, jog: Jog) {
        let limits = settings.joint.at(jog.joint);
        self.schedule.clear(jog.joint);
        if jog.led {
            self.ramp_down(now, settings, jog.joint, Some(jog.joint));
        }
        let rest_s = 2.0 * limits.jog_v_rad_s / limits.jog_a_rad_s2;
        self.set_jog_step(Step::Releasing { until: now + span::of_seconds(rest_s) + REST_SLACK });
        self.push(GroupEvent::JogReleased);
    }

    /// Current limit, speed and acceleration are set. A drive that was reset opens its brake first.
    fn begin_to_move(&mut self, now: Instant) {
        if now >= self.reset_at + RESET_SETTLE {
            self.set_jog_step(Step::Moving);
        }
    }

    fn set_jog_step(&mut self, step: Step) {
        if let Mode::Jogging(jog) = &mut self.mode {
            jog.step = step;
        }
    }

    pub(super) fn jogging_on_missed(
        &mut self,
        now: Instant,
        settings: &Settings,
        jog: Jog,
        request: Request,
    ) {
        match (jog.step, request) {
            (Step::Starting, _) => self.start_jog(settings, jog.joint),
            (Step::Restoring, Request::Set(..)) => self.restore_current(settings, jog.joint),
            // As a stop: what leads the joint to rest is sent again.
            (Step::Releasing { .. }, Request::Set(..) | Request::Move(_)) if jog.led => {
                self.ramp_down(now, settings, jog.joint, Some(jog.joint));
            }
            (Step::Moving | Step::Releasing { .. } | Step::Restoring, _) => {}
        }
    }

    pub(super) fn jogging_on_answer(&mut self, now: Instant, jog: Jog) {
        if !self.schedule.is_done(jog.joint, self.drives.at(jog.joint)) {
            return;
        }
        match jog.step {
            Step::Starting => self.begin_to_move(now),
            Step::Restoring => self.push(GroupEvent::JogEnded),
            Step::Moving | Step::Releasing { .. } => {}
        }
    }
}

/// Speed as a write before the motion: it keeps the keys alternating, and the cap up to date.
fn jog_requests(settings: &Settings, jog: &Jog, target_rad: f32) -> [Request; 2] {
    let limits = settings.joint.at(jog.joint);
    let target = Radians::new(limits.to_drive_rad(target_rad));
    let v = jog.qd_rad_s.abs().min(limits.jog_v_rad_s);
    [
        Request::Set(Parameter::TargetVel, Value::F32(v)),
        Request::Move(MotionRequest::extended(MotionCommand::Ramp { target })),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::group::PositionSample;
    use protocol::powercube::CubeState;

    /// By hand: 0.1 s at 0.2 rad/s, then braking with 1 rad/s2, are 20 mrad each.
    #[test]
    fn target_of_a_jog_is_where_the_joint_comes_to_rest_and_within_the_limits_of_a_homed_one() {
        let settings = Settings::powercube6();
        let (joint, now) = (JointIndex::new(0).unwrap(), Instant::from_micros(1_000_000));
        let limits = settings.joint.at(joint);
        assert_eq!(limits.jog_a_rad_s2, 1.0);
        let mut group = PowerCubes::default();
        let until = now + Duration::from_millis(100);
        let jog = |qd_rad_s| Jog { joint, qd_rad_s, until, led: true, step: Step::Moving };
        let mut target_rad = |q_rad, qd_rad_s, homed: bool| {
            let drive = group.drives.at_mut(joint);
            drive.position = Some(PositionSample { q_rad, at: now });
            let word = if homed { CubeState::HOME_OK } else { CubeState::from_bits(0) };
            drive.state = Some((word, now));
            group.jog_target(now, &settings, &jog(qd_rad_s))
        };
        for homed in [true, false] {
            assert!((target_rad(0.5, 0.2, homed) - 0.54).abs() < 1e-6);
            assert!((target_rad(0.5, -0.2, homed) - 0.46).abs() < 1e-6);
        }
        let near = limits.q_max_rad - 0.01;
        assert_eq!(target_rad(near, 0.2, true), limits.q_max_rad);
        assert!((target_rad(near, 0.2, false) - (near + 0.04)).abs() < 1e-6, "no zero, no limits");
        let beyond = limits.q_max_rad + 0.1;
        assert_eq!(target_rad(beyond, 0.2, true), beyond, "never further out");
        assert!((target_rad(beyond, -0.2, true) - (beyond - 0.04)).abs() < 1e-6, "back in");
    }
}

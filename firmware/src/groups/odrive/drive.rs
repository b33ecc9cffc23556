//! One axis as the group knows it: its step, its heartbeats, its answers.

use protocol::odrive::{AxisState, Heartbeat, Version};
use protocol::{Duration, Instant};

use super::finding::{Step, cause_of};
use super::options::{Axis, Home};
use crate::fault::Cause;
use crate::groups::answers::{Answers, only_turn_rad};
use crate::groups::position::{self, Drive as _};
use crate::groups::shape::Axis as SetPoint;
use crate::settings::JointSettings;

/// Heartbeats come every 100 ms as shipped. An axis whose last one is older may have fallen to idle.
const HEARD_MAX: Duration = Duration::from_millis(500);

/// See the [module](self).
#[derive(Clone, Copy, Debug, Default)]
pub struct Drive {
    pub(super) step: Step,
    /// Since when it is in this step.
    pub(super) since: Instant,
    /// When the order of the step was sent last.
    pub(super) ordered_at: Option<Instant>,
    /// Periods for which the step has waited for an answer.
    pub(super) asked: u8,
    pub(super) answers: Answers,
    pub(super) heartbeat: Option<Heartbeat>,
    pub(super) heard_at: Instant,
    /// Times that the loop was to be closed.
    pub(super) closings: u8,
    /// Estimates that nobody asked for.
    pub(super) unasked: u8,
    /// Turns of the axis at which the joint is at its zero, less the offset of the settings.
    pub(super) zero_rev: f32,
    /// Set point of the period: position and speed in its middle.
    pub(super) middle: SetPoint,
    /// Torque that the set point needs, N·m at the joint.
    pub(super) ahead_nm: f32,
    /// From the beginning of a burst to the end of the request at the earliest, and as a rule.
    pub(super) asked_after: [Duration; 2],
    /// From the beginning of a burst to the end of the set point, as a rule.
    pub(super) acts_after: Duration,
    pub(super) is_proven: bool,
    pub(super) is_homed: bool,
    /// A lost axis was reported.
    pub(super) is_reported: bool,
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

    fn switch_off(&mut self, now: Instant) {
        self.go_to(now, Step::Off);
    }
}

impl Drive {
    /// Estimates are asked for in this step.
    pub(super) fn has_asked(&self) -> bool {
        matches!(self.step, Step::Place | Step::Close | Step::Held | Step::Off)
    }

    pub(super) fn go_to(&mut self, now: Instant, step: Step) {
        if self.step != step {
            (self.step, self.since, self.ordered_at, self.asked) = (step, now, None, 0);
        }
    }

    /// Looks for the axis from the beginning, unless it is held and answers.
    pub(super) fn find(&mut self, now: Instant, missed_max: u32, version: Version) {
        let is_sound =
            self.is_held() && self.answers.missed_in_row <= missed_max && self.cause(now, version).is_none();
        if !is_sound {
            *self = Self { is_proven: self.is_proven, since: now, ..Self::default() };
        }
        self.is_reported = false;
    }

    pub(super) fn has_torque(&self) -> bool {
        self.heartbeat.is_some_and(|heartbeat| heartbeat.state == AxisState::ClosedLoop)
    }

    /// What is wrong with an axis that should give torque.
    pub(super) fn cause(&self, now: Instant, version: Version) -> Option<Cause> {
        if !self.is_held() {
            return None;
        }
        let heartbeat = self.heartbeat?;
        // One that falls to idle without an error is wrong, too.
        let is_away = (!self.has_torque()).then_some(Cause::DriveError);
        let is_silent = (now.saturating_since(self.heard_at) > HEARD_MAX).then_some(Cause::DriveSilent);
        (heartbeat.error != 0).then(|| cause_of(heartbeat.error, version)).or(is_away).or(is_silent)
    }

    /// Angle of the joint at a reported position.
    pub(super) fn joint_rad(&self, axis: Axis, limits: &JointSettings, rev: f32) -> f32 {
        limits.to_joint_rad(axis.to_rad(rev - self.zero_rev))
    }

    /// Position and velocity for the axis, turns.
    pub(super) fn for_axis(&self, axis: Axis, limits: &JointSettings) -> (f32, f32) {
        let turned = if limits.inverted { -self.middle.v_rad_s } else { self.middle.v_rad_s };
        (axis.to_rev(limits.to_drive_rad(self.middle.q_rad)) + self.zero_rev, axis.to_rev(turned))
    }

    /// The joint is shifted by whole turns that the axis counts.
    fn shift(&mut self, axis: Axis, limits: &JointSettings, turns: f32) {
        self.zero_rev += turns;
        let by_rad = -axis.to_rad(turns);
        self.answers.shift(if limits.inverted { -by_rad } else { by_rad });
        self.is_homed = false;
    }

    /// The set point is where the joint stands, in the only turn within the limits.
    pub(super) fn stand_here(&mut self, axis: Axis, limits: &JointSettings) -> Option<f32> {
        let found_rad = self.answers.sample?.q_rad;
        if axis.home == Home::Joint
            && let Some(turn_rad) = only_turn_rad(limits, found_rad)
        {
            let turns = axis.to_rev(turn_rad);
            self.shift(axis, limits, if limits.inverted { turns } else { -turns });
        }
        let q_rad = self.answers.sample?.q_rad;
        self.answers.sent = SetPoint { q_rad, v_rad_s: 0.0 };
        self.middle = self.answers.sent;
        Some(q_rad)
    }

    /// The joint takes its zero. Returns how far its positions are shifted by it; `None`: it has no zero here.
    pub(super) fn home(&mut self, axis: Axis, limits: &JointSettings) -> Option<f32> {
        let before_rad = self.answers.sample.filter(|_| self.is_held())?.q_rad;
        if axis.home == Home::Motor {
            let turns = axis.to_rev(limits.to_drive_rad(before_rad) - limits.to_drive_rad(0.0));
            self.shift(axis, limits, libm::roundf(turns));
        }
        let q_rad = self.answers.sample?.q_rad;
        let by_rad = q_rad - before_rad;
        self.answers.sent.q_rad += by_rad;
        self.middle.q_rad += by_rad;
        self.is_homed = match axis.home {
            Home::Joint => only_turn_rad(limits, q_rad) == Some(0.0),
            Home::Motor => limits.holds(q_rad),
        };
        self.is_homed.then_some(by_rad)
    }
}

//! Tracking of one joint: where it is in relation to its reference, and what it does next.
//!
//! In cycle k a set point is computed from what cycle k-1 measured, and acts in cycle k for one period. So the state is one
//! period old when the set point begins to act, and the feed forward is the mean acceleration of the reference over the
//! interval in which it acts ([`crate::feedback`]), taken the drive's lag later: a set point moves the drive's generator, and the
//! position follows it. Without this lead the jump of the acceleration at the start of a throw leaves a speed error of lag
//! times jump to the feedback (45 mrad/s with a lag of 5 ms). The designs of `cubectl tune` count on it.

use protocol::Instant;

use crate::feedback::{self, ErrorEstimator, ErrorState, Weights};
use crate::group::{InForce, Law, PositionSample, Profile, SetPoint, Taken};
use crate::settings::JointSettings;
use crate::span;
use crate::spline::Setpoint;

/// Set points in a row turned into braking before a soft limit that stop the group.
const NEAR_LIMIT_ROW: u8 = 3;

/// See the [module](self).
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Tracker {
    estimator: ErrorEstimator,
    /// Time of the state in the estimator.
    measured_at: Instant,
    /// A set point was answered since the last control step.
    fresh: bool,
    /// An answer was missed, or is of no use.
    missed: bool,
    /// Input of the error system in force since the last answer, rad/s².
    u_in_force_rad_s2: f32,
    /// At the last measurement.
    reference: Setpoint,
    saturated: bool,
    near_limit_in_row: u8,
}

impl Tracker {
    /// The joint stands `e_rad` from its reference.
    pub(super) fn begin(now: Instant, e_rad: f32, weights: Weights) -> Self {
        let mut estimator = ErrorEstimator::default();
        estimator.update(e_rad, 0.0, 0.0, 0.0, weights);
        // Not the answer to a set point, but as good: the joint stands.
        Self { estimator, measured_at: now, fresh: true, ..Self::default() }
    }

    /// Analyses an answered set point. Returns the speed of the joint, rad/s, and the time since the state before, s.
    pub(super) fn update(
        &mut self,
        sample: PositionSample,
        in_force: InForce,
        period_s: f32,
        weights: Weights,
    ) -> (f32, f32) {
        let dt_s = span::seconds_between(self.measured_at, sample.at);
        let e_rad = sample.q_rad - self.reference.q_rad;
        self.estimator.update(e_rad, dt_s, self.u_in_force_rad_s2, period_s, weights);
        self.measured_at = sample.at;
        // An answer that comes after the next control step is that of the cycle before: that step is still to be answered.
        self.fresh = in_force.in_time;
        self.missed = false;
        self.u_in_force_rad_s2 = in_force.u_rad_s2;
        (self.qd_rad_s(), dt_s)
    }

    /// Decides what the joint does from `acts_at` on, with the reference at the beginning of that period and its velocity
    /// at the end.
    #[inline]
    pub(super) fn decide(
        &mut self,
        profile: &Profile,
        period_s: f32,
        limits: &JointSettings,
        acts_at: Instant,
        (from, qd_to_rad_s): (Setpoint, f32),
    ) -> SetPoint {
        if !self.fresh {
            self.estimator.predict(period_s, self.u_in_force_rad_s2);
            self.measured_at += profile.period;
        }
        (self.fresh, self.missed) = (false, false);
        let qdd_reference_rad_s2 = feedback::mean_acceleration(from.qd_rad_s, qd_to_rad_s, period_s);
        let reference = SetPoint {
            acts_at,
            period_s,
            qdd_rad_s2: qdd_reference_rad_s2,
            qdd_reference_rad_s2,
            q_rad: from.q_rad,
            qd_rad_s: from.qd_rad_s,
        };
        if profile.law == Law::Reference {
            return reference;
        }
        let (e_rad, de_rad_s) = (self.estimator.e_rad(), self.estimator.de_rad_s());
        let x = ErrorState { e_rad, de_rad_s, u_last_rad_s2: self.u_in_force_rad_s2 };
        let u_rad_s2 = limits.gains().apply(&x);
        let action = feedback::clip_to_remaining(u_rad_s2, qdd_reference_rad_s2, limits.a_max_rad_s2);
        self.saturated = action.saturated;
        let lead_s = span::seconds(acts_at.saturating_since(self.measured_at));
        SetPoint {
            qdd_rad_s2: action.qdd_rad_s2,
            q_rad: from.q_rad + (e_rad + lead_s * (de_rad_s + 0.5 * lead_s * self.u_in_force_rad_s2)),
            qd_rad_s: from.qd_rad_s + de_rad_s,
            ..reference
        }
    }

    /// Takes note of what became of a set point; true if the joint has been braked before a soft limit too often in a row.
    pub(super) const fn is_near_limit(&mut self, taken: Taken) -> bool {
        self.near_limit_in_row =
            if taken.position_limited { self.near_limit_in_row.saturating_add(1) } else { 0 };
        self.near_limit_in_row >= NEAR_LIMIT_ROW
    }

    /// Whether the last answer was missed.
    pub(super) const fn set_missed(&mut self, missed: bool) {
        self.missed = missed;
    }

    /// True if the last answer was missed.
    pub(super) const fn is_missed(&self) -> bool {
        self.missed
    }

    /// True if the law wanted more than the joint had left.
    pub(super) const fn is_saturated(&self) -> bool {
        self.saturated
    }

    /// Sets the reference at the last measurement.
    pub(super) const fn set_reference(&mut self, reference: Setpoint) {
        self.reference = reference;
    }

    /// Reference at the last measurement.
    pub(super) const fn reference(&self) -> &Setpoint {
        &self.reference
    }

    /// Following error and its rate.
    pub(super) const fn error(&self) -> &ErrorEstimator {
        &self.estimator
    }

    /// Estimated speed of the joint, rad/s.
    pub(super) const fn qd_rad_s(&self) -> f32 {
        self.reference.qd_rad_s + self.estimator.de_rad_s()
    }
}

//! Tracking of one joint: its state relative to its reference, and its next set point.
//!
//! In cycle k a set point is computed from the measurement of cycle k-1, and acts in cycle k for one period. So the
//! state is one period old when the set point begins to act. The feed forward is the mean acceleration of the
//! reference over the interval in which the set point acts ([`crate::feedback`]), taken later by the lag of the
//! drive: a set point moves the drive's generator, and the position follows it. Without this shift the jump of the
//! acceleration at the start of a throw leaves a speed error of lag times jump to the feedback (45 mrad/s with a
//! lag of 5 ms). The designs of `cubectl tune` assume it.

use protocol::Instant;

use crate::feedback::{self, ErrorEstimator, ErrorState, Weights};
use crate::group::{InForce, Law, PositionSample, Profile, SetPoint, Taken};
use crate::settings::JointSettings;
use crate::span;
use crate::spline::Setpoint;

/// Set points in a row that were turned into braking before a soft limit; this many stop the group.
const NEAR_LIMIT_ROW: u8 = 3;

/// See the [module](self).
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Tracker {
    estimator: ErrorEstimator,
    /// Time of the state in the estimator.
    measured_at: Instant,
    /// A set point was answered since the last control step.
    fresh: bool,
    /// An answer was missed, or is not usable.
    missed: bool,
    /// Input of the error system in force since the last answer, rad/s².
    u_in_force_rad_s2: f32,
    /// At the last measurement.
    reference: Setpoint,
    saturated: bool,
    near_limit_in_row: u8,
}

impl Tracker {
    /// Starts with the joint at rest, `e_rad` from its reference.
    pub(super) fn begin(now: Instant, e_rad: f32, weights: Weights) -> Self {
        let mut estimator = ErrorEstimator::default();
        estimator.update(e_rad, 0.0, 0.0, 0.0, weights);
        // There is no answer to a set point yet, but the joint stands, which is as good.
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
        // An answer that comes after the next control step belongs to the cycle before: the answer to that step is still to
        // come.
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

    /// Records what became of a set point; true if the joint has been braked before a soft limit too often in a row.
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

#[cfg(test)]
mod tests {
    use protocol::{Duration, JointIndex};

    use super::*;
    use crate::settings::Settings;

    const US: fn(u64) -> Instant = Instant::from_micros;
    const PERIOD_US: u64 = 3_000;
    const PERIOD_S: f32 = 3e-3;
    const PLAIN: Weights = Weights { alpha: 1.0, beta: 1.0 };
    /// A clock that has run for long.
    const BEGIN_US: u64 = 10_000_000;
    const U_RAD_S2: f32 = 3.0;

    fn profile(law: Law) -> Profile {
        let period = Duration::from_micros(PERIOD_US);
        Profile { law, period, lag: Duration::from_micros(5_000), lead: period * 2 }
    }

    /// Error under a constant input, and its rate.
    fn parabola(us: u64) -> (f32, f32) {
        let t_s = (us - BEGIN_US) as f32 * 1e-6;
        (0.01 + t_s * (0.2 + 0.5 * U_RAD_S2 * t_s), 0.2 + U_RAD_S2 * t_s)
    }

    /// A joint whose error is on the parabola, measured each period; the time of the last measurement, µs.
    fn followed(in_time: bool) -> (Tracker, u64) {
        let mut tracker = Tracker::begin(US(BEGIN_US), 0.01, PLAIN);
        tracker.set_reference(Setpoint { q_rad: 1.0, qd_rad_s: 0.5, qdd_rad_s2: 0.0 });
        let mut at = BEGIN_US;
        for _ in 0..6 {
            at += PERIOD_US;
            let sample = PositionSample { q_rad: 1.0 + parabola(at).0, at: US(at) };
            tracker.update(sample, InForce { u_rad_s2: U_RAD_S2, in_time }, PERIOD_S, PLAIN);
        }
        (tracker, at)
    }

    fn decided(tracker: &mut Tracker, law: Law, acts_at_us: u64) -> SetPoint {
        let limits = *Settings::powercube6().joint.at(JointIndex::new(0).unwrap());
        let from = Setpoint { q_rad: 2.0, qd_rad_s: 0.7, qdd_rad_s2: 0.0 };
        let to_rad_s = 0.7 + 4.0 * PERIOD_S;
        tracker.decide(&profile(law), PERIOD_S, &limits, US(acts_at_us), (from, to_rad_s))
    }

    fn assert_near(found: f32, expected: f32) {
        assert!((found - expected).abs() < 2e-4, "{found}, expected {expected}");
    }

    /// The state is predicted for the time at which the set point acts: after an answer in time, after a late
    /// answer to the set point before, and through cycles without an answer.
    #[test]
    fn set_point_begins_where_the_joint_will_be() {
        for in_time in [true, false] {
            let (mut tracker, at) = followed(in_time);
            for cycle in 0..4 {
                let acts_at = at + PERIOD_US * (cycle + 1) + 900;
                let set_point = decided(&mut tracker, Law::Feedback, acts_at);
                assert_near(set_point.q_rad, 2.0 + parabola(acts_at).0);
                // The rate is that of the state that the law uses: at the last measurement, or at the last control step.
                let state_at = at + PERIOD_US * (cycle + u64::from(!in_time));
                assert_near(set_point.qd_rad_s, 0.7 + parabola(state_at).1);
                assert_eq!(set_point.acts_at, US(acts_at));
                assert_near(set_point.qdd_reference_rad_s2, 4.0);
            }
        }
    }

    #[test]
    fn law_acts_on_error_rate_and_last_input_and_is_clipped_beside_the_reference() {
        let (mut tracker, at) = followed(true);
        let gains = Settings::powercube6().joint.at(JointIndex::new(0).unwrap()).gains();
        let (e_rad, de_rad_s) = parabola(at);
        let u = gains.apply(&ErrorState { e_rad, de_rad_s, u_last_rad_s2: U_RAD_S2 });
        assert!((-14.4..0.0).contains(&u), "{u}: within what the joint has");
        let set_point = decided(&mut tracker, Law::Feedback, at + PERIOD_US);
        assert!((set_point.qdd_rad_s2 - (4.0 + u)).abs() < 0.02, "{} for {}", set_point.qdd_rad_s2, 4.0 + u);
        assert!(!tracker.is_saturated());

        let mut tracker = Tracker::begin(US(BEGIN_US), -0.1, PLAIN);
        let set_point = decided(&mut tracker, Law::Feedback, BEGIN_US + PERIOD_US);
        assert_eq!(set_point.qdd_rad_s2, 10.4);
        assert!(tracker.is_saturated());
    }

    #[test]
    fn group_that_closes_its_own_loop_gets_the_reference() {
        let (mut tracker, at) = followed(true);
        let set_point = decided(&mut tracker, Law::Reference, at + PERIOD_US);
        assert_eq!((set_point.q_rad, set_point.qd_rad_s), (2.0, 0.7));
        assert_eq!(set_point.qdd_rad_s2, set_point.qdd_reference_rad_s2);
    }

    /// The first answer is compared with the place where the joint stood when the run began.
    #[test]
    fn first_answer_of_a_run_gives_the_speed_since_its_beginning() {
        let mut tracker = Tracker::begin(US(BEGIN_US), 0.02, PLAIN);
        assert_eq!((tracker.error().e_rad(), tracker.error().de_rad_s()), (0.02, 0.0));
        let first = decided(&mut tracker, Law::Feedback, BEGIN_US + 2 * PERIOD_US);
        assert_eq!((first.q_rad, first.qd_rad_s), (2.02, 0.7));
        tracker.set_reference(Setpoint { q_rad: 1.0, qd_rad_s: 0.5, qdd_rad_s2: 0.0 });
        let sample = PositionSample { q_rad: 1.02 + 0.3 * PERIOD_S, at: US(BEGIN_US + PERIOD_US) };
        let in_force = InForce { u_rad_s2: 0.0, in_time: true };
        let (qd_rad_s, dt_s) = tracker.update(sample, in_force, PERIOD_S, PLAIN);
        assert_near(qd_rad_s, 0.5 + 0.3);
        assert_near(dt_s, PERIOD_S);
    }

    #[test]
    fn third_set_point_in_a_row_that_brakes_before_a_limit_is_too_many() {
        let mut tracker = Tracker::default();
        let (free, braked) = (Taken::default(), Taken { position_limited: true });
        let row = [braked, braked, free, braked, braked, braked, braked, free];
        let near = row.map(|taken| tracker.is_near_limit(taken));
        assert_eq!(near, [false, false, false, false, false, true, true, false]);
    }
}

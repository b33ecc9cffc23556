//! Saturated state feedback on the tracking error of one joint (pure).
//!
//! # The law
//!
//! ```text
//! e  = q - q_ref                              rad      paper 002, eq. (10)
//! ė' = u,  u = v - q̈_ref                      rad/s²   double integrator
//! u  = k₁ e + k₂ ė + k₃ u⁻                    k: 1/s², 1/s, 1
//! v  = clip(q̈_ref + u, -v_max, v_max)         rad/s²   eq. (11), (12)
//! ```
//!
//! `u⁻` is the input that acts while the new one is on its way: the drives take one period to take
//! over a command, so the state of the loop is (e, ė, u⁻). The paper's law is k₃ = 0. `q̈_ref` is the
//! mean over the interval in which the command will act, one delay later, which for a cubic
//! reference leaves no error at the end of the interval. Gains are negative.
//!
//! # The rate of the error
//!
//! [`ErrorEstimator`] differences the *error*, not the position, so the reference's own motion adds no noise and no
//! lag. It adds the known change of speed since the middle of the interval. With both weights at one this is the
//! whole estimator. Smaller weights average over several measurements, which fast cycles need because position
//! comes in steps.
//!
//! An answer may come after the control step that needed it. The state is then predicted to a time after the
//! measurement, but the difference still spans the time since the last *measurement*. Over the short remaining time
//! alone, one step of the encoder would look like a leap in speed.

use crate::joints::{at_least, clamp};

/// Feedback row k of one joint: 1/s², 1/s, 1.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Gains {
    /// On the position error, 1/s².
    pub k_error_1_s2: f32,
    /// On the rate of the error, 1/s.
    pub k_rate_1_s: f32,
    /// On the input that acts meanwhile.
    pub k_last: f32,
}

/// State of the loop at the time of the last measurement.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ErrorState {
    /// Position error e, rad.
    pub e_rad: f32,
    /// Rate of the error ė, rad/s.
    pub de_rad_s: f32,
    /// Input u⁻ in force from the measurement until the new command acts, rad/s².
    pub u_last_rad_s2: f32,
}

/// Outcome of one control step of one joint.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Action {
    /// Acceleration to command, v, rad/s².
    pub qdd_rad_s2: f32,
    /// Input of the error system that results from it, u, rad/s².
    pub u_rad_s2: f32,
    /// The clip acted: the law wanted more than the joint has left.
    pub saturated: bool,
}

impl Gains {
    /// The unclipped law.
    pub fn apply(&self, x: &ErrorState) -> f32 {
        self.k_error_1_s2 * x.e_rad + self.k_rate_1_s * x.de_rad_s + self.k_last * x.u_last_rad_s2
    }
}

/// Clips the wanted input `u_rad_s2` to what the joint has left beside the reference's acceleration.
///
/// `a_max_rad_s2` is not negative. A wanted input that is not a number counts as saturated; then only the reference
/// acts.
pub fn clip_to_remaining(u_rad_s2: f32, qdd_ref_rad_s2: f32, a_max_rad_s2: f32) -> Action {
    let u_wanted = if u_rad_s2.is_finite() { u_rad_s2 } else { 0.0 };
    let wanted = qdd_ref_rad_s2 + u_wanted;
    let qdd_rad_s2 = clamp(wanted, -a_max_rad_s2, a_max_rad_s2);
    Action {
        qdd_rad_s2,
        u_rad_s2: qdd_rad_s2 - qdd_ref_rad_s2,
        saturated: qdd_rad_s2 != wanted || !u_rad_s2.is_finite(),
    }
}

/// Mean acceleration of the reference over an interval of `dt_s` from its velocities at the ends.
pub fn mean_acceleration(qd_from_rad_s: f32, qd_to_rad_s: f32, dt_s: f32) -> f32 {
    (qd_to_rad_s - qd_from_rad_s) / dt_s
}

/// Position error and its rate from measurements of position.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ErrorEstimator {
    e_rad: f32,
    de_rad_s: f32,
    /// From the last measurement to the time of the state, s.
    since_s: f32,
    started: bool,
}

/// Shortest time between measurements that is used for the rate, in periods: closer ones contain little information about it.
const SHORTEST_DIFFERENCE: f32 = 0.5;

/// Weights of a new measurement, 0..=1 each; both one: plain difference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weights {
    /// On the position error.
    pub alpha: f32,
    /// On its rate.
    pub beta: f32,
}

impl ErrorEstimator {
    /// Position error, rad.
    pub const fn e_rad(&self) -> f32 {
        self.e_rad
    }

    /// Rate of the error, rad/s.
    pub const fn de_rad_s(&self) -> f32 {
        self.de_rad_s
    }

    /// Takes an error `e_rad` that was measured `dt_s` after the time of the state (negative if the state was
    /// predicted past the measurement); input `u_rad_s2` was in force in between. The first measurement, and a
    /// second one of the same time, sets the error and keeps the rate.
    pub fn update(&mut self, e_rad: f32, dt_s: f32, u_rad_s2: f32, period_s: f32, weights: Weights) {
        if !self.started || self.since_s + dt_s <= 0.0 {
            (self.e_rad, self.since_s, self.started) = (e_rad, 0.0, true);
            return;
        }
        self.predict(dt_s, u_rad_s2);
        let innovation = e_rad - self.e_rad;
        self.e_rad += weights.alpha * innovation;
        // e_k - e_{k-1} = T ė + T² u / 2: the difference is the rate in the middle of the interval
        // and the prediction has already carried it to the end.
        self.de_rad_s += weights.beta * innovation / at_least(self.since_s, SHORTEST_DIFFERENCE * period_s);
        self.since_s = 0.0;
    }

    /// Lets `dt_s` pass without a measurement (a lost reply); less than zero goes back.
    pub fn predict(&mut self, dt_s: f32, u_rad_s2: f32) {
        self.e_rad += dt_s * (self.de_rad_s + 0.5 * dt_s * u_rad_s2);
        self.de_rad_s += dt_s * u_rad_s2;
        self.since_s += dt_s;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const PLAIN: Weights = Weights { alpha: 1.0, beta: 1.0 };

    #[test]
    fn clip_leaves_the_reference_its_share() {
        let action = clip_to_remaining(5.0, 8.0, 10.0);
        assert_eq!(action, Action { qdd_rad_s2: 10.0, u_rad_s2: 2.0, saturated: true });
        let action = clip_to_remaining(-5.0, 8.0, 10.0);
        assert_eq!(action, Action { qdd_rad_s2: 3.0, u_rad_s2: -5.0, saturated: false });
    }

    #[test]
    fn lost_number_leaves_the_reference_alone_and_is_reported() {
        let action = clip_to_remaining(f32::NAN, 3.0, 10.0);
        assert_eq!((action.qdd_rad_s2, action.saturated), (3.0, true));
    }

    proptest! {
        #[test]
        fn clipped_command_never_exceeds_the_bound(u in -1e6f32..1e6, a in -20f32..20.0, bound in 0f32..20.0) {
            prop_assert!(clip_to_remaining(u, a, bound).qdd_rad_s2.abs() <= bound);
        }

        /// Closed form: e(t) = e₀ + v₀ t + u t²/2 for constant u.
        #[test]
        fn plain_difference_is_exact_on_a_parabola(e0 in -0.1f32..0.1, v0 in -0.5f32..0.5, u in -10f32..10.0) {
            let e = |t: f32| e0 + v0 * t + 0.5 * u * t * t;
            let dt = 0.017;
            let mut estimator = ErrorEstimator::default();
            for k in 0..6 {
                estimator.update(e(k as f32 * dt), dt, u, dt, PLAIN);
            }
            prop_assert!((estimator.de_rad_s() - (v0 + u * 5.0 * dt)).abs() < 1e-4);
        }
    }

    proptest! {
        /// The state was predicted past the control step; the answer came up to a third of a period before or after that step.
        #[test]
        fn late_answer_gives_the_rate_of_the_whole_interval(
            e0 in -0.1f32..0.1, v0 in -0.5f32..0.5, u in -10f32..10.0, late in -0.001f32..0.001,
        ) {
            let e = |t: f32| e0 + v0 * t + 0.5 * u * t * t;
            let dt = 0.003;
            let mut estimator = ErrorEstimator { e_rad: e0, de_rad_s: 0.0, since_s: 0.0, started: true };
            estimator.predict(dt, u);
            estimator.update(e(dt + late), late, u, dt, PLAIN);
            prop_assert!((estimator.e_rad() - e(dt + late)).abs() < 1e-6);
            prop_assert!((estimator.de_rad_s() - (v0 + u * (dt + late))).abs() < 1e-3);
        }

        /// One step of the encoder, read at any time, changes the rate by no more than over half a period.
        #[test]
        fn step_of_the_encoder_is_no_leap_in_speed(wait in 0f32..0.004, late in -0.004f32..0.004) {
            let (step, dt, weights) = (0.02f32.to_radians(), 0.003, Weights { alpha: 0.6, beta: 0.2 });
            let mut estimator = ErrorEstimator { started: true, ..ErrorEstimator::default() };
            estimator.predict(wait, 0.0);
            estimator.update(step, late, 0.0, dt, weights);
            prop_assert!(estimator.de_rad_s().abs() <= 1.001 * weights.beta * step / (0.5 * dt));
        }
    }

    #[test]
    fn smaller_weights_quieten_steps_of_the_measurement() {
        let step = 0.02f32.to_radians();
        let noise = |weights: Weights| {
            let (mut estimator, mut worst) = (ErrorEstimator::default(), 0.0f32);
            for k in 0..400 {
                // A slow drift seen through a coarse scale.
                let e = (0.01 * k as f32 * 0.003 / step).round() * step;
                estimator.update(e, 0.003, 0.0, 0.003, weights);
                if k > 100 {
                    worst = worst.max((estimator.de_rad_s() - 0.01).abs());
                }
            }
            worst
        };
        let (plain, averaged) = (noise(PLAIN), noise(Weights { alpha: 0.5, beta: 0.1 }));
        assert!((0.09..0.13).contains(&plain), "{plain}");
        assert!((0.005..0.025).contains(&averaged), "{averaged}");
    }

    #[test]
    fn lost_measurement_is_bridged_by_the_model() {
        let mut estimator = ErrorEstimator { e_rad: 0.01, de_rad_s: 0.1, since_s: 0.0, started: true };
        estimator.predict(0.1, 2.0);
        assert!((estimator.e_rad() - 0.03).abs() < 1e-7 && (estimator.de_rad_s() - 0.3).abs() < 1e-7);
    }
}

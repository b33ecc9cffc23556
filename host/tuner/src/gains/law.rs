//! The saturated law: gains, weights of the cost, the family of gains that is searched, and scaled coordinates.

use super::problem::Problem;
use crate::model::{Sampled, StateMatrix, StateRow, StateVector, known_row, target_row};

/// Gain row [k_pos 1/s2, k_vel 1/s, k_last -] as the firmware holds it.
pub type Gains = [f32; 3];

/// Weights of the quadratic cost in scaled coordinates: W = diag(1, velocity, 0, ...) + floor I.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weights {
    /// On (w / velocity scale)^2.
    pub velocity: f64,
    /// On (u / u_max)^2.
    pub input: f64,
    /// On every scaled state: keeps the inequalities strict for the states the cost does not see.
    pub floor: f64,
}

impl Weights {
    /// Mostly position: the throw is lost by position errors; the rest keeps the loop damped.
    pub const DEFAULT: Self = Self { velocity: 0.02, input: 1e-3, floor: 1e-3 };

    /// W.
    pub fn state(&self) -> StateMatrix {
        let mut w = StateMatrix::from_diagonal_element(self.floor);
        w[(0, 0)] += 1.0;
        w[(1, 1)] += self.velocity;
        w
    }
}

/// Scales of the state (see [`crate::model`] for its order) for errors up to `position_rad` under
/// commands up to `u_max`: velocity and time as a double integrator relates them, the transients as
/// large as a full command makes them within lag and period.
pub fn scales(problem: &Problem, position_rad: f64, u_max: f64) -> StateVector {
    let velocity = (position_rad * u_max).sqrt();
    let (lag, period) = (problem.drive().lag_s(), problem.period_s());
    StateVector::from_column_slice(&[
        position_rad,
        velocity,
        u_max,
        u_max * lag * lag,
        u_max * (lag + 0.5 * period),
        u_max * 2.0 * lag,
        u_max * lag * (lag + period),
    ])
}

/// Time unit of the cost: how long u_max needs for a velocity of the scale, s.
pub fn time_unit_s(position_rad: f64, u_max: f64) -> f64 {
    (position_rad / u_max).sqrt()
}

/// Horizon over which the cost predicts, for the family: delay plus drive lag.
pub(super) fn horizon_s(problem: &Problem) -> f64 {
    problem.delay().centre() + problem.drive().lag_s()
}

/// Radius of the set that is certified for errors up to `position_rad` under commands up to `u_max`: at least so
/// large that delay and lag take no larger share of its time unit than the problem allows. A proof for a larger set
/// also holds for a smaller one.
pub(super) fn certified_radius_rad(problem: &Problem, position_rad: f64, u_max: f64) -> f64 {
    position_rad.max(u_max * (horizon_s(problem) / problem.horizon_share_max()).powi(2))
}

/// Feedback of the predicted state: u = -omega^2 e(t + theta) - 2 zeta omega e'(t + theta).
///
/// The prediction e + theta e' + theta^2/2 u_last takes the last command for the one that acts over
/// the delay, which is why it is part of the gain row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Family {
    /// Bandwidth, rad/s.
    pub omega: f64,
    /// Damping ratio.
    pub zeta: f64,
}

impl Family {
    /// [k_pos, k_vel, k_last] for a prediction over `theta_s`.
    pub fn gains(&self, theta_s: f64) -> [f64; 3] {
        let (w2, d) = (self.omega * self.omega, 2.0 * self.zeta * self.omega);
        [-w2, -(w2 * theta_s + d), -(0.5 * w2 * theta_s * theta_s + d * theta_s)]
    }
}

/// K as a row on the state.
pub fn row(gains: Gains) -> StateRow {
    known_row(gains.map(f64::from))
}

/// H: slow feedback of the drive's target and its velocity, predicted over the delay.
pub(crate) fn slow_row(problem: &Problem, family: Family) -> StateRow {
    target_row(&problem.drive(), family.gains(problem.delay().centre()))
}

/// (A + B F) and F in scaled coordinates.
pub(super) fn scaled_loop(
    model: &Sampled,
    f: &StateRow,
    scales: &StateVector,
    u_max: f64,
) -> (StateMatrix, StateRow) {
    let closed = model.a + model.b * f;
    (
        StateMatrix::from_fn(|i, j| closed[(i, j)] * scales[j] / scales[i]),
        StateRow::from_fn(|_, j| f[j] * scales[j] / u_max),
    )
}

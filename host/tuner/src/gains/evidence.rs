//! The saturated loop simulated: what the certificate bounds, seen happening.

use super::certificate::SaturatedCertificate;
use super::law::{Gains, row, time_unit_s};
use super::problem::Problem;
use crate::model::{Sampled, StateRow, StateVector, steady_state};
use crate::noise::Noise;

/// One step of the saturated loop.
fn step(model: &Sampled, k: &StateRow, u_max: f64, x: &StateVector) -> (StateVector, f64) {
    let u = (k * x)[0].clamp(-u_max, u_max);
    (model.a * x + model.b * u, u)
}

/// Directions in which the initial set is sampled for the settling time; the loop is odd, so half a circle.
const DIRECTIONS: usize = 8;
/// Time units after which a loop has settled if it ever does.
const HORIZON: f64 = 6.0;
/// Share of the initial radius below which a position error counts as settled.
const SETTLED: f64 = 0.05;

/// Time until the position error of the worst initial state stays below a twentieth of the initial radius, s, at
/// the nominal period and delay with the command bounded by `u_max`; infinite if it does not.
pub(super) fn settling_s(problem: &Problem, gains: Gains, u_max: f64) -> f64 {
    let (e0, v0) = problem.error_set();
    let (period, delay) = problem.grid(1)[0];
    let model = problem.sampled(period, delay);
    let k = row(gains);
    let steps = (HORIZON * time_unit_s(e0, u_max) / period).ceil() as usize + 4;
    let mut worst = 0.0f64;
    for i in 0..DIRECTIONS {
        let angle = std::f64::consts::PI * i as f64 / DIRECTIONS as f64;
        let mut x = steady_state(e0 * angle.cos(), v0 * angle.sin());
        let mut settled_s = 0.0;
        for n in 0..steps {
            let (next, _) = step(&model, &k, u_max, &x);
            let (before, after) = (x[0].abs() / e0 - SETTLED, next[0].abs() / e0 - SETTLED);
            if before > 0.0 {
                // Between the samples too, or long periods make everything equal.
                let share = if after < 0.0 { before / (before - after) } else { 1.0 };
                settled_s = (n as f64 + share) * period;
            }
            x = next;
        }
        worst = worst.max(if x[0].abs() < SETTLED * e0 { settled_s } else { f64::INFINITY });
    }
    worst
}

/// What dense sampling found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evidence {
    /// States sampled on the boundary of the first region.
    pub boundary_states: usize,
    /// Largest V(x+)/V(x) over one step from them, over periods, delays and bounds.
    pub step_ratio_max: f64,
    pub trajectories: usize,
    /// Largest V met along any of them (it starts at 1).
    pub v_max: f64,
    /// Largest |position error| from the initial set, rad.
    pub position_max_rad: f64,
    /// Longest time from the initial set until the position error stays below 2 % of its radius, s.
    pub settling_s: f64,
    /// Largest position error of the opposite sign from a pure position error, as a fraction of it.
    pub overshoot: f64,
    /// Share of steps in which the command was clipped, over the trajectories from the initial set.
    pub saturated_share: f64,
}

/// Of this many boundary states one is run to rest.
const RUN: usize = 20;
/// Points of half the boundary of the initial set from which the loop is run; the other half is its mirror image.
const STARTS: usize = 16;

/// Samples `states` states on the boundary of the first region and runs one in `RUN` to rest, with
/// period, delay and the momentary bound (u_max to the full acceleration) drawn again in each step.
///
/// `None` if the ellipsoid is not positive definite (a refused certificate).
pub(super) fn gather(
    problem: &Problem,
    certificate: &SaturatedCertificate,
    states: usize,
    seed: u64,
) -> Option<Evidence> {
    let region = certificate.regions.first()?;
    let k = row(certificate.gains);
    let l = region.p.cholesky()?.l();
    let to_state = l.transpose().try_inverse()?;
    let models: Vec<Sampled> =
        problem.grid(5).iter().map(|&(period, delay)| problem.sampled(period, delay)).collect();
    let mut rng = Noise(seed | 1);
    let draw = |rng: &mut Noise| {
        let model = &models[(rng.unit() * models.len() as f64) as usize % models.len()];
        let extra = rng.unit() * (problem.acceleration_max_rad_s2() - region.u_max_rad_s2);
        // Half of the steps at the certified bound itself, which is the hard case.
        let bound = region.u_max_rad_s2 + if rng.unit() < 0.5 { 0.0 } else { extra };
        (model, bound)
    };
    let mut found = Evidence {
        boundary_states: states,
        step_ratio_max: 0.0,
        trajectories: 0,
        v_max: 0.0,
        position_max_rad: 0.0,
        settling_s: 0.0,
        overshoot: 0.0,
        saturated_share: 0.0,
    };
    let steps =
        (HORIZON * time_unit_s(region.scales[0], region.u_max_rad_s2) / problem.period_s()) as usize + 10;
    for i in 0..states {
        let z = StateVector::from_fn(|_, _| rng.normal()).normalize();
        let mut x = (to_state * z).component_mul(&region.scales);
        let run = if i % RUN == 0 { steps } else { 1 };
        found.trajectories += usize::from(run > 1);
        for n in 0..run {
            let (model, bound) = draw(&mut rng);
            let (next, _) = step(model, &k, bound, &x);
            let after = region.value(&next);
            if n == 0 {
                found.step_ratio_max = found.step_ratio_max.max(after / region.value(&x));
            }
            found.v_max = found.v_max.max(after);
            x = next;
        }
    }
    initial_set_runs(problem, certificate, &mut found, steps);
    Some(found)
}

/// From points of half the boundary of the initial set, at every corner of period and delay, at u_max.
fn initial_set_runs(
    problem: &Problem,
    certificate: &SaturatedCertificate,
    found: &mut Evidence,
    steps: usize,
) {
    let (e0, v0) = problem.error_set();
    let k = row(certificate.gains);
    let u_max = certificate.regions[0].u_max_rad_s2;
    let (mut clipped, mut all) = (0usize, 0usize);
    for (period, delay) in problem.corners() {
        let model = problem.sampled(period, delay);
        for i in 0..STARTS {
            let angle = std::f64::consts::PI * i as f64 / STARTS as f64;
            let mut x = steady_state(e0 * angle.cos(), v0 * angle.sin());
            let mut last_outside = 0;
            for n in 0..2 * steps {
                let (next, u) = step(&model, &k, u_max, &x);
                clipped += usize::from(u.abs() >= u_max);
                all += 1;
                x = next;
                found.position_max_rad = found.position_max_rad.max(x[0].abs());
                if i == 0 {
                    found.overshoot = found.overshoot.max(-x[0] / e0);
                }
                if x[0].abs() > 0.02 * e0 {
                    last_outside = n + 1;
                }
            }
            found.settling_s = found.settling_s.max(last_outside as f64 * period);
        }
    }
    found.saturated_share = clipped as f64 / all.max(1) as f64;
}

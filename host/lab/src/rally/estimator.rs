//! Errors of the flight estimator against the Cramer-Rao bound.

use hil_sim::mechanics::{BallOptions, LooseBall};
use nalgebra::Vector3;
use operator::flight_estimator::Flight;
use operator::flight_estimator::fit::{Air, Sample};
use planner::plan::rng::SplitMix64;
use serde::Serialize;

/// Quantile of the normal distribution for a 95 % interval.
const Z: f64 = 1.959_964;

/// Errors of the estimator against its bound.
#[derive(Debug, Clone, Serialize)]
pub struct EstimatorRow {
    /// What is believed of the drag.
    pub drag: &'static str,
    /// Time seen, ms.
    pub seen_ms: u32,
    /// Root mean square of the error per axis at 0.6 s, mm.
    pub rms_mm: f64,
    /// The same by the covariance of a flight whose drag is known: the Cramer-Rao bound, mm.
    pub bound_mm: f64,
    /// Mean of the squared error over its covariance, per axis, and the 95 % band of such a mean.
    pub nees: (f64, f64, f64),
}

/// Errors at 0.6 s of simulated flights with a drag drawn 10 % about the ball's.
pub fn estimator(runs: usize, seed: u64) -> Vec<EstimatorRow> {
    const CATCH_S: f64 = 0.6;
    const SIGMA_M: f64 = 0.002;
    let drag_1_m = BallOptions::default().drag_1_m;
    let known = |drag_1_m| Air { gravity_m_s2: 9.81, drag_1_m, drag_sigma_1_m: 0.0 };
    let runs = runs.max(20);
    let mut rows = Vec::new();
    for (drag, sigma) in [("known", 0.0), ("unknown to 10 %", 0.1), ("ignored", 0.0)] {
        for n in [6_u32, 12, 24] {
            let mut rng = SplitMix64::stream(seed, u64::from(n));
            let (mut squares, mut nees, mut bound, mut count) = (0.0, 0.0, 0.0, 0.0_f64);
            for _ in 0..runs {
                let true_drag = drag_1_m * (1.0 + sigma * rng.normal());
                let ball = BallOptions { drag_1_m: true_drag, ..BallOptions::default() };
                let mut at = LooseBall {
                    p_m: Vector3::new(0.4, 0.1, 0.3),
                    v_m_s: Vector3::new(
                        3.0 + 0.3 * rng.normal(),
                        0.3 * rng.normal(),
                        2.5 + 0.3 * rng.normal(),
                    ),
                    spin_rad_s: Vector3::zeros(),
                };
                let mut samples = Vec::new();
                for k in 1..=n {
                    at.fly(&ball, 9.81, 1.0 / 120.0);
                    let p_m = at.p_m + Vector3::from_fn(|_, _| SIGMA_M * rng.normal());
                    samples.push(Sample { t_s: f64::from(k) / 120.0, p_m });
                }
                let left_s = CATCH_S - f64::from(n) / 120.0;
                for _ in 0..200 {
                    at.fly(&ball, 9.81, left_s / 200.0);
                }
                let air = match drag {
                    "known" => known(true_drag),
                    "ignored" => known(0.0),
                    _ => Air { drag_sigma_1_m: sigma * drag_1_m, ..known(drag_1_m) },
                };
                let fits = (
                    Flight::fit(&samples, SIGMA_M, &air, None),
                    Flight::fit(&samples, SIGMA_M, &known(true_drag), None),
                );
                let (Some(fit), Some(best)) = fits else { continue };
                let (p, _, covariance) = fit.at(CATCH_S);
                let off = at.p_m - p;
                let Some(inverse) = covariance.try_inverse() else { continue };
                squares += off.norm_squared() / 3.0;
                nees += off.dot(&(inverse * off)) / 3.0;
                bound += best.at(CATCH_S).2.trace() / 3.0;
                count += 1.0;
            }
            let half = Z * (2.0 / (3.0 * count)).sqrt();
            rows.push(EstimatorRow {
                drag,
                seen_ms: n * 1000 / 120,
                rms_mm: (squares / count).sqrt() * 1e3,
                bound_mm: (bound / count).sqrt() * 1e3,
                nees: (nees / count, 1.0 - half, 1.0 + half),
            });
        }
    }
    rows
}

//! What a search makes small: the paper's objective, the energy, or how badly the ball lands.

use nalgebra::{Matrix2, Vector2};

use super::energy;
pub use super::options::Goal;
use super::problem::Problem;
use super::spread::Spread;
use super::statistics::LandingPrediction;
use crate::throw::Throw;

/// Share of objective (1) that stays in the others: it decides where they do not care.
pub(crate) const EFFORT_SHARE: f64 = 1e-3;
/// Probabilities nearer to 0 or 1 than this are all the same.
const PROBABILITY_FLOOR: f64 = 1e-9;
/// Tenths of a millimetre and the logarithm of the odds are of the size of objective (1), which the solver is made for.
const SPREAD_SCALE_1_M: f64 = 1e4;
const ODDS_SCALE: f64 = 10.0;
/// A throw takes hundreds of joules.
pub(crate) const ENERGY_SCALE_1_J: f64 = 0.1;

/// Value of a goal as a function of the landing, with its derivatives by mean and covariance.
pub(crate) struct Price {
    pub(crate) value: f64,
    pub(crate) by_mean: Vector2<f64>,
    pub(crate) by_covariance: Matrix2<f64>,
}

impl Goal {
    /// Price of a landing about `aim` (coordinates in m); `None` for a goal that does not depend on it.
    pub(crate) fn price(
        &self,
        mean_m: &Vector2<f64>,
        covariance_m2: &Matrix2<f64>,
        aim: &Vector2<f64>,
    ) -> Option<Price> {
        match self {
            Self::Effort | Self::Energy => None,
            Self::Spread(_) => {
                let off = mean_m - aim;
                let rms_m = (off.norm_squared() + covariance_m2.trace()).max(1e-18).sqrt();
                Some(Price {
                    value: SPREAD_SCALE_1_M * rms_m,
                    by_mean: off * (SPREAD_SCALE_1_M / rms_m),
                    by_covariance: Matrix2::identity() * (0.5 * SPREAD_SCALE_1_M / rms_m),
                })
            }
            Self::Miss(_, region) => {
                let landing = LandingPrediction {
                    mean_m: *mean_m,
                    covariance_m2: *covariance_m2,
                    delay_sensitivity_m_s: Vector2::zeros(),
                };
                let hit = landing.hit(aim, region);
                let (p, floor) = (hit.probability, PROBABILITY_FLOOR);
                let slope = -ODDS_SCALE * (1.0 / (1.0 - p + floor) + 1.0 / (p + floor));
                Some(Price {
                    value: ODDS_SCALE * ((1.0 - p + floor) / (p + floor)).ln(),
                    by_mean: hit.by_mean * slope,
                    by_covariance: hit.by_covariance * slope,
                })
            }
        }
    }

    /// What a search would have to pay for this throw; infinite if it does not land.
    pub(crate) fn value(&self, problem: &Problem<'_>, throw: &Throw) -> f64 {
        let effort = problem.objective(throw);
        if *self == Self::Energy {
            return energy::joule(problem, throw)
                .map_or(f64::INFINITY, |e| ENERGY_SCALE_1_J * e + EFFORT_SHARE * effort);
        }
        let Some(noise) = self.noise() else { return effort };
        Spread::of(problem, throw, &problem.aim, noise)
            .and_then(|s| self.price(&s.mean_m, &s.covariance_m2, &problem.aim.centre()))
            .map_or(f64::INFINITY, |price| price.value + EFFORT_SHARE * effort)
    }
}

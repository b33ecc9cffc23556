//! Landing of the ball with all errors: covariance of the landing and the probability of a hit.
//!
//! Mean and covariance come from `spread`: sigma points of every source, not a linearisation. The Monte Carlo here
//! is their reference. All sources are independent and normal; the drag is folded at zero.

use nalgebra::{Matrix2, Vector2, Vector3, Vector6};

use super::disturbed::{Disturbed, drawn_flight};
pub use super::options::{Noise, Region};
use super::problem::Problem;
use super::rng::SplitMix64;
use super::spread::Spread;
use crate::flight::landing;
use crate::throw::Throw;

/// Predicted landing in the plane of the target, in its coordinates ([`crate::flight::Aim`]; x and y of the world on a
/// horizontal one).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LandingPrediction {
    /// Mean in m (x, y).
    pub mean_m: Vector2<f64>,
    pub covariance_m2: Matrix2<f64>,
    /// Speed of the landing point with the release delay, `dL/dδ`, in m/s (mm per ms).
    pub delay_sensitivity_m_s: Vector2<f64>,
}

/// Landing when the gripper opens `delay_s` late (early if negative); `None` if the ball does not come down.
#[must_use]
pub fn landing_with_delay(problem: &Problem<'_>, throw: &Throw, delay_s: f64) -> Option<Vector2<f64>> {
    let (p, v) = throw.ball_at_time(problem.arm, throw.ha_s + delay_s);
    let landing = problem.flight.meet(&p, &v, &problem.aim, delay_s)?;
    Some(problem.aim.coordinates(&landing.p, delay_s + landing.time_s))
}

/// Predicts the landing; `None` if a ball at a node of the rule does not come down on the plane of the target.
#[must_use]
pub fn predict(problem: &Problem<'_>, throw: &Throw, noise: &Noise) -> Option<LandingPrediction> {
    let spread = Spread::of(problem, throw, &problem.aim, noise)?;
    let (p, v) = throw.ball_at_release(problem.arm);
    let nominal = problem.flight.meet(&p, &v, &problem.aim, 0.0)?;
    let g = problem.aim.jacobian(&nominal, 0.0);
    let v = v - problem.aim.course().velocity_m_s(nominal.time_s);
    let a = throw.ball_acceleration_at_release(problem.arm);
    Some(LandingPrediction {
        mean_m: spread.mean_m,
        covariance_m2: spread.covariance_m2,
        delay_sensitivity_m_s: landing::delay_sensitivity(&g, &v, &a),
    })
}

/// Landings of `draws` disturbed throws: the full model, no linearisation. The oracle of [`predict`].
#[must_use]
pub fn monte_carlo(
    problem: &Problem<'_>,
    throw: &Throw,
    noise: &Noise,
    draws: usize,
    seed: u64,
) -> Vec<Vector2<f64>> {
    let arm = problem.arm;
    let mut rng = SplitMix64::new(seed);
    (0..draws)
        .filter_map(|_| {
            let off = Disturbed::drawn(problem.joints(), noise, &mut rng);
            let state = off.at_release(throw);
            let frames = arm.fk(&state.q);
            let p = arm.ball(&frames).pos;
            let twist: Vector6<f64> = frames.jacobian(&p) * state.qd;
            let v = Vector3::new(twist[0], twist[1], twist[2]);
            let flight = drawn_flight(&problem.flight, noise, &mut rng)?;
            let landing = flight.meet(&p, &v, &problem.aim, off.delay_s)?;
            Some(problem.aim.coordinates(&landing.p, off.delay_s + landing.time_s))
        })
        .collect()
}

/// Probability of a hit with `dP = by_mean · dμ + tr(by_covariance dC)`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Hit {
    pub(crate) probability: f64,
    pub(crate) by_mean: Vector2<f64>,
    pub(crate) by_covariance: Matrix2<f64>,
}

impl LandingPrediction {
    /// Probability that a normal landing falls into the region about `target` (x, y in m).
    #[must_use]
    pub fn hit_probability(&self, target: &Vector2<f64>, region: &Region) -> f64 {
        self.hit(target, region).probability
    }

    /// The probability and its derivatives.
    ///
    /// Integrates the density of x times the chance of y given x, exactly along y and by Gauss-Legendre panels in x;
    /// the derivatives are those of the integrand, so they belong to this very sum.
    pub(crate) fn hit(&self, target: &Vector2<f64>, region: &Region) -> Hit {
        let offset = self.mean_m - target;
        // A covariance of zero is a point.
        let c = self.covariance_m2 + Matrix2::identity() * 1e-14;
        let sx = c[(0, 0)].sqrt();
        // y given x: mean offset.y + slope (x - offset.x), standard deviation sy.
        let slope = c[(0, 1)] / c[(0, 0)];
        let sy = (c[(1, 1)] - slope * c[(0, 1)]).max(1e-14).sqrt();
        let reach = match *region {
            Region::Disc { radius_m } => radius_m,
            Region::Box { half_x_m, .. } => half_x_m,
        };
        let half_y = |x: f64| match *region {
            Region::Disc { radius_m } => (radius_m * radius_m - x * x).max(0.0).sqrt(),
            Region::Box { half_y_m, .. } => half_y_m,
        };
        let cdf = |t: f64| 0.5 * libm::erfc(-t * std::f64::consts::FRAC_1_SQRT_2);
        let density = |t: f64| (-0.5 * t * t).exp() / std::f64::consts::TAU.sqrt();
        let mut hit = Hit { probability: 0.0, by_mean: Vector2::zeros(), by_covariance: Matrix2::zeros() };
        // Only the part within 9 sigma of the mean matters; panels there.
        let (from, to) = ((-reach).max(offset.x - 9.0 * sx), reach.min(offset.x + 9.0 * sx));
        if from >= to {
            return hit;
        }
        let panels = 200;
        let width = (to - from) / f64::from(panels);
        let nodes = [
            (-0.774_596_669_241_483_4, 5.0 / 18.0),
            (0.0, 8.0 / 18.0),
            (0.774_596_669_241_483_4, 5.0 / 18.0),
        ];
        let (mut by_sx, mut by_slope, mut by_sy) = (0.0, 0.0, 0.0);
        for panel in 0..panels {
            for (node, weight) in nodes {
                let x = from + width * (f64::from(panel) + 0.5 + 0.5 * node);
                let u = (x - offset.x) / sx;
                let share = weight * width * density(u) / sx;
                let mean_y = offset.y + slope * (x - offset.x);
                let h = half_y(x);
                let (upper, lower) = ((h - mean_y) / sy, (-h - mean_y) / sy);
                let (up, low) = (density(upper), density(lower));
                let inside = cdf(upper) - cdf(lower);
                hit.probability += share * inside;
                hit.by_mean.x += share * (u / sx * inside + slope / sy * (up - low));
                hit.by_mean.y -= share / sy * (up - low);
                by_sx += share * (u * u - 1.0) / sx * inside;
                by_slope -= share * (x - offset.x) / sy * (up - low);
                by_sy -= share * (upper * up - lower * low) / sy;
            }
        }
        hit.probability = hit.probability.clamp(0.0, 1.0);
        let by_xx = 0.5 * by_sx / sx - by_slope * slope / c[(0, 0)] + 0.5 * by_sy * slope * slope / sy;
        let by_xy = by_slope / c[(0, 0)] - by_sy * slope / sy;
        let by_yy = 0.5 * by_sy / sy;
        hit.by_covariance = Matrix2::new(by_xx, 0.5 * by_xy, 0.5 * by_xy, by_yy);
        hit
    }

    /// Root of the mean squared distance from `target` in m: what σ-optimal planning minimises.
    #[must_use]
    pub fn rms_miss_m(&self, target: &Vector2<f64>) -> f64 {
        ((self.mean_m - target).norm_squared() + self.covariance_m2.trace()).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hit_probability_of_a_round_spread_is_the_rayleigh_law() {
        let prediction = LandingPrediction {
            mean_m: Vector2::new(1.0, 2.0),
            covariance_m2: Matrix2::identity() * 0.01_f64.powi(2),
            delay_sensitivity_m_s: Vector2::zeros(),
        };
        for radius_m in [0.005, 0.01, 0.02, 0.05] {
            let p = prediction.hit_probability(&Vector2::new(1.0, 2.0), &Region::Disc { radius_m });
            let exact = 1.0 - (-0.5 * (radius_m / 0.01_f64).powi(2)).exp();
            assert!((p - exact).abs() < 1e-5, "{radius_m}: {p} {exact}");
        }
        let square = Region::Box { half_x_m: 0.01, half_y_m: 0.02 };
        let p = prediction.hit_probability(&Vector2::new(1.0, 2.0), &square);
        assert!((p - 0.682_689_492 * 0.954_499_736).abs() < 1e-7);
        assert_eq!(prediction.hit_probability(&Vector2::new(5.0, 2.0), &square), 0.0);
    }

    #[test]
    fn derivatives_of_the_hit_probability_match_differences() {
        let at = |n: [f64; 5]| LandingPrediction {
            mean_m: Vector2::new(n[0], n[1]),
            covariance_m2: Matrix2::new(n[2], n[3], n[3], n[4]),
            delay_sensitivity_m_s: Vector2::zeros(),
        };
        let n = [4e-3, -7e-3, 1.2e-4, 0.5e-4, 2.5e-4];
        for region in [Region::Disc { radius_m: 0.015 }, Region::Box { half_x_m: 0.01, half_y_m: 0.02 }] {
            let aim = Vector2::new(1e-3, 2e-3);
            let hit = at(n).hit(&aim, &region);
            let c = &hit.by_covariance;
            let claimed = [hit.by_mean.x, hit.by_mean.y, c[(0, 0)], 2.0 * c[(0, 1)], c[(1, 1)]];
            for (k, claimed) in claimed.into_iter().enumerate() {
                let step = if k < 2 { 1e-6 } else { 1e-8 };
                let moved = |sign: f64| {
                    let mut m = n;
                    m[k] += sign * step;
                    at(m).hit_probability(&aim, &region)
                };
                let differenced = (moved(1.0) - moved(-1.0)) / (2.0 * step);
                assert!(
                    (claimed - differenced).abs() <= 1e-5 * differenced.abs().max(1.0),
                    "{region:?} {k}: {claimed}, by differences {differenced}"
                );
            }
        }
    }
}

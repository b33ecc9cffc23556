//! Where the ball lands when nothing is exact: covariance of the landing and the probability of a hit.
//!
//! Late or early release is treated beyond first order, because release-delay nulling leaves nothing of first order:
//! the landing is evaluated at the nodes of a Gauss-Hermite rule over the jitter. Tracking errors and drag are small
//! and enter linearly through the landing Jacobian. All sources are independent and normal.

use nalgebra::{Matrix2, SMatrix, Vector2, Vector3, Vector6};

use super::problem::Problem;
use super::rng::SplitMix64;
use super::throw::{JOINTS, Joints, Throw};
use crate::flight::{FlightModel, landing};

/// Standard deviations of what is not exact.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Noise {
    /// Time of the release in s.
    pub release_time_s: f64,
    /// Joint angles at the release in rad, each joint.
    pub position_rad: f64,
    /// Joint speeds at the release in rad/s, each joint.
    pub speed_rad_s: f64,
    /// Drag constant in 1/m.
    pub drag_per_m: f64,
}

impl Default for Noise {
    /// 2 ms of release jitter; tracking as in robot-models 1.10 (LQR with clipping, 17 ms); drag of a light ball unknown
    /// by 0.005 1/m.
    fn default() -> Self {
        Self { release_time_s: 2e-3, position_rad: 9e-4, speed_rad_s: 0.012, drag_per_m: 5e-3 }
    }
}

/// Predicted landing in the plane of the target.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LandingPrediction {
    /// Mean in m (x, y).
    pub mean_m: Vector2<f64>,
    /// Covariance in m².
    pub covariance_m2: Matrix2<f64>,
    /// Speed of the landing point with the release delay, `dL/dδ`, in m/s (mm per ms).
    pub delay_sensitivity_m_s: Vector2<f64>,
}

/// Nodes and weights of the 7-point Gauss-Hermite rule for the standard normal.
const HERMITE: [(f64, f64); 7] = [
    (-3.750_439_717_725_742, 5.482_688_559_722_184e-4),
    (-2.366_759_410_734_541, 0.030_757_123_967_586_5),
    (-1.154_405_394_739_968, 0.240_123_178_605_012_7),
    (0.0, 0.457_142_857_142_857_1),
    (1.154_405_394_739_968, 0.240_123_178_605_012_7),
    (2.366_759_410_734_541, 0.030_757_123_967_586_5),
    (3.750_439_717_725_742, 5.482_688_559_722_184e-4),
];

fn xy(p: &Vector3<f64>) -> Vector2<f64> {
    Vector2::new(p.x, p.y)
}

/// Landing when the gripper opens `delay_s` late (early if negative); `None` if the ball does not come down.
#[must_use]
pub fn landing_with_delay(problem: &Problem<'_>, throw: &Throw, delay_s: f64) -> Option<Vector2<f64>> {
    let (p, v) = throw.ball_at_time(problem.arm, throw.ha_s + delay_s);
    Some(xy(&problem.flight.land(&p, &v, problem.target.z)?.p))
}

/// Predicts the landing; `None` if the undisturbed ball does not come down on the plane of the target.
#[must_use]
pub fn predict(problem: &Problem<'_>, throw: &Throw, noise: &Noise) -> Option<LandingPrediction> {
    let arm = problem.arm;
    let frames = arm.fk(&throw.q_rad);
    let p = arm.ball(&frames).pos;
    let jac = frames.jacobian(&p);
    let twist = jac * throw.qd_rad_s;
    let v = Vector3::new(twist[0], twist[1], twist[2]);
    let z = problem.target.z;
    let nominal = problem.flight.land(&p, &v, z)?;
    let g = problem.flight.landing_jacobian(&p, &v, &nominal);

    let mut mean = Vector2::zeros();
    let mut second = Matrix2::zeros();
    for (node, weight) in HERMITE {
        let at = landing_with_delay(problem, throw, node * noise.release_time_s)? - xy(&nominal.p);
        mean += at * weight;
        second += at * at.transpose() * weight;
    }
    let mut covariance = second - mean * mean.transpose();

    let by_q = frames.twist_gradient(&jac, &throw.qd_rad_s);
    let upper = |m: &SMatrix<f64, 6, 6>| m.fixed_rows::<3>(0).into_owned();
    let (g_p, g_v) = (g.fixed_columns::<3>(0), g.fixed_columns::<3>(3));
    let by_position = g_p * upper(&jac) + g_v * upper(&by_q);
    let by_speed = g_v * upper(&jac);
    covariance += by_position * by_position.transpose() * noise.position_rad.powi(2);
    covariance += by_speed * by_speed.transpose() * noise.speed_rad_s.powi(2);

    if noise.drag_per_m > 0.0 {
        let by_drag = drag_sensitivity(&problem.flight, &p, &v, z, noise.drag_per_m)?;
        covariance += by_drag * by_drag.transpose() * noise.drag_per_m.powi(2);
    }
    let a = throw.ball_acceleration_at_release(arm);
    Some(LandingPrediction {
        mean_m: xy(&nominal.p) + mean,
        covariance_m2: covariance,
        delay_sensitivity_m_s: landing::delay_sensitivity(&g, &v, &a),
    })
}

/// `∂L/∂k`. Drag is never negative; in vacuum the one-sided difference stands for both sides.
fn drag_sensitivity(
    flight: &FlightModel,
    p: &Vector3<f64>,
    v: &Vector3<f64>,
    z: f64,
    sigma: f64,
) -> Option<Vector2<f64>> {
    let at = |k: f64| Some(xy(&flight.with_drag(k).ok()?.land(p, v, z)?.p));
    let k = flight.drag_per_m();
    let step = 0.5 * sigma;
    let low = (k - step).max(0.0);
    Some((at(k + step)? - at(low)?) / (k + step - low))
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
            let mut state = throw.at_time(throw.ha_s + noise.release_time_s * rng.normal());
            state.q += Joints::from_fn(|_, _| noise.position_rad * rng.normal());
            state.qd += Joints::from_fn(|_, _| noise.speed_rad_s * rng.normal());
            let frames = arm.fk(&state.q);
            let p = arm.ball(&frames).pos;
            let twist: Vector6<f64> = frames.jacobian(&p) * state.qd;
            // In vacuum a negative drag stands for the other side of an uncertainty that is really one-sided.
            let k = problem.flight.drag_per_m() + noise.drag_per_m * rng.normal();
            let v = Vector3::new(twist[0], twist[1], twist[2]);
            let land =
                |k: f64| Some(xy(&problem.flight.with_drag(k).ok()?.land(&p, &v, problem.target.z)?.p));
            if k >= 0.0 { land(k) } else { Some(land(0.0)? * 2.0 - land(-k)?) }
        })
        .collect()
}

/// Region that counts as a hit, in the plane of the target.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case", tag = "shape")]
pub enum Region {
    /// Disc about the target.
    Disc {
        /// Radius in m.
        radius_m: f64,
    },
    /// Rectangle about the target with edges along x and y.
    Box {
        /// Half edge along x in m.
        half_x_m: f64,
        /// Half edge along y in m.
        half_y_m: f64,
    },
}

impl LandingPrediction {
    /// Probability that a normal landing falls into the region about `target` (x, y in m).
    ///
    /// Integrates the density of x given the region's extent in y exactly along y and by Gauss-Legendre panels in x.
    #[must_use]
    pub fn hit_probability(&self, target: &Vector2<f64>, region: &Region) -> f64 {
        let offset = self.mean_m - target;
        // A covariance of zero is a point.
        let c = self.covariance_m2 + Matrix2::identity() * 1e-14;
        let sx = c[(0, 0)].sqrt();
        let slope = c[(0, 1)] / c[(0, 0)];
        let sy = (c[(1, 1)] - slope * c[(0, 1)]).max(1e-14).sqrt();
        let (reach, half_y): (f64, Box<dyn Fn(f64) -> f64>) = match *region {
            Region::Disc { radius_m } => {
                (radius_m, Box::new(move |x| (radius_m * radius_m - x * x).max(0.0).sqrt()))
            }
            Region::Box { half_x_m, half_y_m } => (half_x_m, Box::new(move |_| half_y_m)),
        };
        let cdf = |t: f64| 0.5 * libm::erfc(-t * std::f64::consts::FRAC_1_SQRT_2);
        // Only the part within 9 sigma of the mean matters; panels there.
        let (from, to) = ((-reach).max(offset.x - 9.0 * sx), reach.min(offset.x + 9.0 * sx));
        if from >= to {
            return 0.0;
        }
        let panels = 200;
        let width = (to - from) / f64::from(panels);
        let nodes = [
            (-0.774_596_669_241_483_4, 5.0 / 18.0),
            (0.0, 8.0 / 18.0),
            (0.774_596_669_241_483_4, 5.0 / 18.0),
        ];
        let mut sum = 0.0;
        for panel in 0..panels {
            for (node, weight) in nodes {
                let x = from + width * (f64::from(panel) + 0.5 + 0.5 * node);
                let u = (x - offset.x) / sx;
                let density = (-0.5 * u * u).exp() / (sx * std::f64::consts::TAU.sqrt());
                let mean_y = offset.y + slope * (x - offset.x);
                let h = half_y(x);
                sum += weight * width * density * (cdf((h - mean_y) / sy) - cdf((-h - mean_y) / sy));
            }
        }
        sum.clamp(0.0, 1.0)
    }

    /// Root of the mean squared distance from `target` in m: what σ-optimal planning minimises.
    #[must_use]
    pub fn rms_miss_m(&self, target: &Vector2<f64>) -> f64 {
        ((self.mean_m - target).norm_squared() + self.covariance_m2.trace()).sqrt()
    }
}

/// Joints of the arm; the linear maps above are 2 × 6.
const _: () = assert!(JOINTS == 6);

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
    fn hermite_rule_integrates_moments_of_the_normal() {
        for (power, moment) in [(0, 1.0), (2, 1.0), (4, 3.0), (6, 15.0), (8, 105.0)] {
            let sum: f64 = HERMITE.iter().map(|(x, w)| w * x.powi(power)).sum();
            assert!((sum - moment).abs() < 1e-9 * moment, "{power}: {sum}");
        }
    }
}

//! The flight to come.

use nalgebra::{Matrix3, Vector3};
use robot_model::cubic::Cubic;

/// The ball at one time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Foreseen {
    /// Time, s.
    pub t_s: f64,
    /// Centre, m.
    pub p_m: Vector3<f64>,
    /// Velocity, m/s.
    pub v_m_s: Vector3<f64>,
    /// Covariance of the centre, m².
    pub covariance_m2: Matrix3<f64>,
}

impl Foreseen {
    /// Standard deviation across the flight: root of the larger eigenvalue of the lateral covariance, m.
    #[must_use]
    pub(crate) fn lateral_sigma_m(&self) -> f64 {
        let speed = self.v_m_s.norm();
        if speed.is_nan() || speed <= 1e-6 {
            return self.covariance_m2.trace().max(0.0).sqrt();
        }
        let (a, b) = across(&(self.v_m_s / speed));
        let c = &self.covariance_m2;
        let (xx, xy, yy) = (a.dot(&(c * a)), a.dot(&(c * b)), b.dot(&(c * b)));
        let middle = 0.5 * (xx + yy);
        let spread = (0.25 * (xx - yy) * (xx - yy) + xy * xy).sqrt();
        (middle + spread).max(0.0).sqrt()
    }
}

/// Two unit vectors across a unit vector and each other.
#[must_use]
pub fn across(u: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
    let helper = if u.z.abs() < 0.9 { Vector3::z() } else { Vector3::x() };
    let a = helper.cross(u).normalize();
    (a, u.cross(&a))
}

/// How well the flight is seen: what further samples will do to the covariance follows from it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Watch {
    /// Standard deviation of one sample per axis, m.
    pub sigma_m: f64,
    /// Time between two samples, s.
    pub period_s: f64,
    /// From the exposure of a sample to its arrival, s.
    pub latency_s: f64,
    /// Time of the first sample of the flight, s; of the expected release before there is one.
    pub first_s: f64,
}

impl Watch {
    /// Standard deviation per axis, at `catch_s`, of a line through all samples that have arrived by `by_s`: sigma²
    /// \[1/N + (t_c - t_m)²/S\]. Infinite for fewer than three samples.
    #[must_use]
    pub(crate) fn sigma_by_m(&self, by_s: f64, catch_s: f64) -> f64 {
        let span = by_s - self.latency_s - self.first_s;
        let n = (span / self.period_s).floor() + 1.0;
        if n.is_nan() || n < 3.0 {
            return f64::INFINITY;
        }
        let length = (n - 1.0) * self.period_s;
        let middle = self.first_s + 0.5 * length;
        let spread = n * (n + 1.0) * length * length / (12.0 * (n - 1.0));
        self.sigma_m * (1.0 / n + (catch_s - middle).powi(2) / spread).sqrt()
    }
}

/// The flight to come on an even grid of times.
#[derive(Debug, Clone, PartialEq)]
pub struct Forecast {
    /// The ball, in order of times with equal steps; at least two.
    pub points: Vec<Foreseen>,
    /// How well it is seen.
    pub watch: Watch,
}

impl Forecast {
    /// The ball at a time inside the grid; `None` outside. Cubic between grid points.
    #[must_use]
    pub fn at(&self, t_s: f64) -> Option<Foreseen> {
        let (first, last) = (self.points.first()?, self.points.last()?);
        let step = (last.t_s - first.t_s) / (self.points.len() - 1) as f64;
        let inside = t_s >= first.t_s - 1e-9 && t_s <= last.t_s + 1e-9 && step > 0.0;
        if !inside {
            return None;
        }
        let i = (((t_s - first.t_s) / step) as usize).min(self.points.len() - 2);
        let (a, b) = (&self.points[i], &self.points[i + 1]);
        let s = ((t_s - a.t_s) / step).clamp(0.0, 1.0);
        let path_m = Cubic::between(step, (a.p_m, a.v_m_s), (b.p_m, b.v_m_s));
        Some(Foreseen {
            t_s,
            p_m: path_m.position(s * step),
            v_m_s: a.v_m_s.lerp(&b.v_m_s, s),
            covariance_m2: a.covariance_m2 * (1.0 - s) + b.covariance_m2 * s,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Five samples at 8.3 to 41.7 ms with 2 mm: 43.6 mm at 0.6 s, per axis.
    #[test]
    fn line_through_samples_has_the_reference_sigma() {
        let period_s = 1.0 / 120.0;
        let watch = Watch { sigma_m: 0.002, period_s, latency_s: 0.0, first_s: period_s };
        assert!((watch.sigma_by_m(5.2 * period_s, 0.6) - 0.0436).abs() < 1e-4);
        assert!(watch.sigma_by_m(2.5 * period_s, 0.6).is_infinite());
    }

    #[test]
    fn between_grid_points_the_parabola_is_exact_and_outside_there_is_nothing() {
        let g = Vector3::new(0.0, 0.0, -9.81);
        let v = Vector3::new(2.0, 1.0, 3.0);
        let point = |t_s: f64| Foreseen {
            t_s,
            p_m: v * t_s + g * (0.5 * t_s * t_s),
            v_m_s: v + g * t_s,
            covariance_m2: Matrix3::identity() * t_s,
        };
        let watch = Watch { sigma_m: 0.002, period_s: 0.01, latency_s: 0.0, first_s: 0.0 };
        let forecast = Forecast { points: (0..10).map(|k| point(0.1 * f64::from(k))).collect(), watch };
        let at = forecast.at(0.333).unwrap();
        assert!((at.p_m - point(0.333).p_m).norm() < 1e-12 && (at.v_m_s - point(0.333).v_m_s).norm() < 1e-12);
        assert!(
            forecast.at(0.95).is_none() && forecast.at(-0.01).is_none() && forecast.at(f64::NAN).is_none()
        );
    }

    #[test]
    fn sigma_along_the_flight_does_not_count() {
        let foreseen = Foreseen {
            t_s: 0.0,
            p_m: Vector3::zeros(),
            v_m_s: Vector3::x() * 3.0,
            covariance_m2: Matrix3::from_diagonal(&Vector3::new(1.0, 4e-4, 1e-4)),
        };
        assert!((foreseen.lateral_sigma_m() - 0.02).abs() < 1e-12);
    }
}

//! Gauss-Newton over a batch of samples.
//!
//! ```text
//! unknown x = (p0, v0, b) at time t0      p' = v,  v' = g - b |v| v
//! min  sum |z_i - p(t_i; x)|² / s²  +  (x - x0)' L0 (x - x0)
//! ```
//!
//! The sensitivities are integrated with the flight (variational equations), so they are exact for the integrated flight; at the
//! solution the inverse of the information L0 + sum H_i' H_i / s² is the covariance, which is the Cramer-Rao bound of the
//! linearised problem.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

/// Unknowns: position, velocity, drag.
pub const UNKNOWNS: usize = 7;
/// (p0, v0, b).
pub type Vars = SVector<f64, UNKNOWNS>;
/// Inverse covariance of [`Vars`].
pub type Information = SMatrix<f64, UNKNOWNS, UNKNOWNS>;

/// Longest step of the integration, s: one step of fourth order between two samples is exact to micrometres.
const STEP_MAX_S: f64 = 0.01;
const ITERATIONS: usize = 4;
/// Below this move of the solution (in standard deviations, squared) it has converged.
const CONVERGED: f64 = 1e-6;

/// Where the centre of a ball was seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Time of the exposure, s.
    pub t_s: f64,
    pub p_m: Vector3<f64>,
}

/// The ball at some time with its derivatives by the unknowns.
#[derive(Debug, Clone, Copy)]
struct Flown {
    p: Vector3<f64>,
    v: Vector3<f64>,
    /// Columns v0, b; by p0 it is the identity.
    p_by: SMatrix<f64, 3, 4>,
    v_by: SMatrix<f64, 3, 4>,
}

/// Gravity, and the drag that is believed before anything is seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Air {
    /// m/s², downwards.
    pub gravity_m_s2: f64,
    /// Drag b, 1/m.
    pub drag_1_m: f64,
    /// Its standard deviation, 1/m; zero for a drag that is known (or ignored, if it is zero as well).
    pub drag_sigma_1_m: f64,
}

/// Knowledge of a flight before it is seen: the plan of the thrower.
#[derive(Debug, Clone, PartialEq)]
pub struct FlightPrior {
    /// Time that position and velocity belong to, s.
    pub t_s: f64,
    pub p_m: Vector3<f64>,
    pub v_m_s: Vector3<f64>,
    /// Covariance of both.
    pub covariance: SMatrix<f64, 6, 6>,
}

#[derive(Debug, Clone, PartialEq)]
pub struct Flight {
    /// Time of the unknowns, s.
    t0_s: f64,
    vars: Vars,
    covariance: Information,
    gravity_m_s2: f64,
    /// Sum of squared residuals of the samples over the variance of one, and their number.
    pub chi2: (f64, usize),
    /// The same with the prior: its squared distance from the solution over its variance added.
    pub chi2_with_belief: f64,
}

fn step(at: &Flown, b: f64, g: f64, h: f64) -> Flown {
    type By = SMatrix<f64, 3, 4>;
    let rate = |v: &Vector3<f64>, by: &By| {
        let speed = v.norm();
        let a = Vector3::new(0.0, 0.0, -g) - v * (b * speed);
        let a_by_v = if speed > 0.0 {
            (Matrix3::identity() * speed + v * v.transpose() / speed) * -b
        } else {
            Matrix3::zeros()
        };
        let mut by = a_by_v * by;
        let mut last = by.column_mut(3);
        last -= v * speed;
        (a, by)
    };
    let (a1, d1) = rate(&at.v, &at.v_by);
    let (v2, w2) = (at.v + a1 * (0.5 * h), at.v_by + d1 * (0.5 * h));
    let (a2, d2) = rate(&v2, &w2);
    let (v3, w3) = (at.v + a2 * (0.5 * h), at.v_by + d2 * (0.5 * h));
    let (a3, d3) = rate(&v3, &w3);
    let (v4, w4) = (at.v + a3 * h, at.v_by + d3 * h);
    let (a4, d4) = rate(&v4, &w4);
    Flown {
        p: at.p + (at.v + (v2 + v3) * 2.0 + v4) * (h / 6.0),
        v: at.v + (a1 + (a2 + a3) * 2.0 + a4) * (h / 6.0),
        p_by: at.p_by + (at.v_by + (w2 + w3) * 2.0 + w4) * (h / 6.0),
        v_by: at.v_by + (d1 + (d2 + d3) * 2.0 + d4) * (h / 6.0),
    }
}

fn start(x: &Vars) -> Flown {
    let mut v_by = SMatrix::<f64, 3, 4>::zeros();
    v_by.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
    Flown {
        p: x.fixed_rows::<3>(0).into_owned(),
        v: x.fixed_rows::<3>(3).into_owned(),
        p_by: SMatrix::zeros(),
        v_by,
    }
}

fn fly(mut at: Flown, b: f64, g: f64, duration_s: f64) -> Flown {
    let steps = (duration_s.abs() / STEP_MAX_S).ceil().max(1.0);
    for _ in 0..steps as usize {
        at = step(&at, b, g, duration_s / steps);
    }
    at
}

fn rows(at: &Flown) -> SMatrix<f64, 3, UNKNOWNS> {
    let mut h = SMatrix::<f64, 3, UNKNOWNS>::zeros();
    h.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
    h.fixed_view_mut::<3, 4>(0, 3).copy_from(&at.p_by);
    h
}

impl Flight {
    /// The flight of the prior alone, without samples.
    #[must_use]
    pub fn of_prior(prior: &FlightPrior, air: &Air) -> Self {
        let mut covariance = Information::zeros();
        covariance.fixed_view_mut::<6, 6>(0, 0).copy_from(&prior.covariance);
        covariance[(6, 6)] = air.drag_sigma_1_m * air.drag_sigma_1_m;
        Self {
            t0_s: prior.t_s,
            vars: vars(&prior.p_m, &prior.v_m_s, air.drag_1_m),
            covariance,
            gravity_m_s2: air.gravity_m_s2,
            chi2: (0.0, 0),
            chi2_with_belief: 0.0,
        }
    }

    /// From samples (in order of time) with the standard deviation `sigma_m` per axis, and a prior if there is one;
    /// `None` with fewer than three samples and no prior, or if the samples do not determine a velocity.
    #[must_use]
    pub fn fit(samples: &[Sample], sigma_m: f64, air: &Air, prior: Option<&FlightPrior>) -> Option<Self> {
        let (first, last) = (samples.first()?, samples.last()?);
        let finite = samples.iter().all(|s| s.t_s.is_finite() && s.p_m.iter().all(|p| p.is_finite()));
        if !finite || prior.is_none() && (samples.len() < 3 || last.t_s - first.t_s < 1e-3) {
            return None;
        }
        let t0_s = prior.map_or(first.t_s, |prior| prior.t_s);
        let mut information0 = Information::zeros();
        // A known drag keeps its value: a weight far above that of the samples.
        let drag_sigma = air.drag_sigma_1_m.max(1e-7);
        information0[(6, 6)] = drag_sigma.powi(-2);
        let mut mean = vars(&Vector3::zeros(), &Vector3::zeros(), air.drag_1_m);
        if let Some(prior) = prior {
            let l0 = prior.covariance.cholesky()?.inverse();
            information0.fixed_view_mut::<6, 6>(0, 0).copy_from(&l0);
            mean = vars(&prior.p_m, &prior.v_m_s, air.drag_1_m);
        }
        let mut x = match prior {
            Some(_) => mean,
            None => guess(samples, air),
        };
        let weight = sigma_m.powi(-2);
        for iteration in 0..ITERATIONS {
            let mut information = information0;
            let mut gradient = information0 * (mean - x);
            let mut chi2 = 0.0;
            let belief = (x - mean).dot(&(information0 * (x - mean)));
            let mut at = start(&x);
            let mut t_s = t0_s;
            for sample in samples {
                at = fly(at, x[6], air.gravity_m_s2, sample.t_s - t_s);
                t_s = sample.t_s;
                let off = sample.p_m - at.p;
                let h = rows(&at);
                information += h.tr_mul(&h) * weight;
                gradient += h.tr_mul(&off) * weight;
                chi2 += off.norm_squared() * weight;
            }
            let factor = information.cholesky()?;
            let moved = factor.solve(&gradient);
            let converged = moved.dot(&gradient) < CONVERGED;
            x += moved;
            x[6] = x[6].max(0.0);
            if converged || iteration + 1 == ITERATIONS {
                return Some(Self {
                    t0_s,
                    vars: x,
                    covariance: factor.inverse(),
                    gravity_m_s2: air.gravity_m_s2,
                    chi2: ((chi2 - moved.dot(&gradient)).max(0.0), samples.len()),
                    chi2_with_belief: (chi2 + belief - moved.dot(&gradient)).max(0.0),
                });
            }
        }
        None
    }

    /// Position (m), velocity (m/s) and covariance of the position (m²) at a time.
    #[must_use]
    pub fn at(&self, t_s: f64) -> (Vector3<f64>, Vector3<f64>, Matrix3<f64>) {
        self.of_flown(&fly(start(&self.vars), self.vars[6], self.gravity_m_s2, t_s - self.t0_s))
    }

    fn of_flown(&self, at: &Flown) -> (Vector3<f64>, Vector3<f64>, Matrix3<f64>) {
        let h = rows(at);
        (at.p, at.v, h * self.covariance * h.transpose())
    }

    /// The same at `count` times from `from_s` on, `step_s` apart.
    #[must_use]
    pub fn course(
        &self,
        from_s: f64,
        step_s: f64,
        count: usize,
    ) -> Vec<(Vector3<f64>, Vector3<f64>, Matrix3<f64>)> {
        let mut at = fly(start(&self.vars), self.vars[6], self.gravity_m_s2, from_s - self.t0_s);
        (0..count)
            .map(|_| {
                let out = self.of_flown(&at);
                at = fly(at, self.vars[6], self.gravity_m_s2, step_s);
                out
            })
            .collect()
    }

    /// Drag and its standard deviation, 1/m.
    #[must_use]
    pub fn drag_1_m(&self) -> (f64, f64) {
        (self.vars[6], self.covariance[(6, 6)].max(0.0).sqrt())
    }
}

fn vars(p: &Vector3<f64>, v: &Vector3<f64>, b: f64) -> Vars {
    Vars::from_column_slice(&[p.x, p.y, p.z, v.x, v.y, v.z, b])
}

/// Line per axis after gravity is taken out.
fn guess(samples: &[Sample], air: &Air) -> Vars {
    let n = samples.len() as f64;
    let t0 = samples[0].t_s;
    let mean_t = samples.iter().map(|s| s.t_s - t0).sum::<f64>() / n;
    let spread: f64 = samples.iter().map(|s| (s.t_s - t0 - mean_t).powi(2)).sum();
    let flat = |s: &Sample| s.p_m + Vector3::z() * (0.5 * air.gravity_m_s2 * (s.t_s - t0).powi(2));
    let mean = samples.iter().map(flat).sum::<Vector3<f64>>() / n;
    let v = samples.iter().map(|s| (flat(s) - mean) * (s.t_s - t0 - mean_t)).sum::<Vector3<f64>>() / spread;
    vars(&(mean - v * mean_t), &v, air.drag_1_m)
}

#[cfg(test)]
mod tests {
    use hil_sim::mechanics::{BallOptions, LooseBall};
    use planner::plan::rng::SplitMix64;

    use super::*;

    const AIR: Air = Air { gravity_m_s2: 9.81, drag_1_m: 0.0284, drag_sigma_1_m: 0.006 };
    const SIGMA_M: f64 = 0.002;

    /// The simulated ball, seen at 120 Hz from 8.3 ms on; and where it really is at `catch_s`.
    fn seen(rng: &mut SplitMix64, n: usize, drag_1_m: f64, catch_s: f64) -> (Vec<Sample>, Vector3<f64>) {
        let options = BallOptions { drag_1_m, ..BallOptions::default() };
        let mut ball = LooseBall {
            p_m: Vector3::new(0.4, 0.1, 0.3),
            v_m_s: Vector3::new(3.0 + 0.3 * rng.normal(), 0.3 * rng.normal(), 2.5 + 0.3 * rng.normal()),
            spin_rad_s: Vector3::zeros(),
        };
        let mut samples = Vec::new();
        let mut t_s = 0.0;
        for k in 1..=n {
            let until = k as f64 / 120.0;
            ball.fly(&options, 9.81, until - t_s);
            t_s = until;
            let noise = Vector3::from_fn(|_, _| SIGMA_M * rng.normal());
            samples.push(Sample { t_s, p_m: ball.p_m + noise });
        }
        for _ in 0..100 {
            ball.fly(&options, 9.81, (catch_s - t_s) / 100.0);
        }
        (samples, ball.p_m)
    }

    /// Vacuum and known drag: sigma at the catch is s² [1/N + (t_c - t_m)²/S], the closed form.
    #[test]
    fn covariance_in_vacuum_is_the_closed_form_of_a_line_fit() {
        let mut rng = SplitMix64::new(1);
        let (samples, _) = seen(&mut rng, 5, 0.0, 0.6);
        let vacuum = Air { drag_1_m: 0.0, drag_sigma_1_m: 0.0, ..AIR };
        let flight = Flight::fit(&samples, SIGMA_M, &vacuum, None).unwrap();
        for axis in 0..3 {
            let sigma = flight.at(0.6).2[(axis, axis)].sqrt();
            assert!((sigma - 0.0436).abs() < 2e-4, "{sigma}");
        }
    }

    /// Over many flights the error of the prediction agrees with the covariance, at 50, 100 and 200 ms, with the
    /// drag unknown within its prior. The band is the 99.9 % band of a chi-square mean over 3 × 400 degrees of
    /// freedom.
    #[test]
    fn errors_of_the_prediction_are_as_large_as_the_covariance_says() {
        let mut rng = SplitMix64::new(2);
        for n in [6, 12, 24] {
            let (mut sum, runs) = (0.0, 400);
            for _ in 0..runs {
                let drag = AIR.drag_1_m + AIR.drag_sigma_1_m * rng.normal();
                let (samples, truth) = seen(&mut rng, n, drag, 0.6);
                let flight = Flight::fit(&samples, SIGMA_M, &AIR, None).unwrap();
                let (p, _, covariance) = flight.at(0.6);
                let off = truth - p;
                sum += off.dot(&(covariance.try_inverse().unwrap() * off));
            }
            let mean = sum / f64::from(runs) / 3.0;
            let band = 3.29 * (2.0_f64 / (3.0 * f64::from(runs))).sqrt();
            assert!((mean - 1.0).abs() < band, "{n} samples: {mean} outside 1 ± {band}");
        }
    }

    #[test]
    fn drag_that_is_ignored_shows_as_an_error_beyond_the_covariance() {
        let mut rng = SplitMix64::new(3);
        let ignored = Air { drag_1_m: 0.0, drag_sigma_1_m: 0.0, ..AIR };
        let (samples, truth) = seen(&mut rng, 30, 0.0284, 0.7);
        let flight = Flight::fit(&samples, SIGMA_M, &ignored, None).unwrap();
        let (p, _, covariance) = flight.at(0.7);
        let off = truth - p;
        let nees = off.dot(&(covariance.try_inverse().unwrap() * off)) / 3.0;
        assert!(off.norm() > 0.01 && nees > 5.0, "{off} {nees}");
    }

    #[test]
    fn a_prior_helps_while_little_is_seen() {
        let mut rng = SplitMix64::new(4);
        let (samples, _) = seen(&mut rng, 5, AIR.drag_1_m, 0.6);
        let mut covariance = SMatrix::<f64, 6, 6>::identity() * 0.005_f64.powi(2);
        covariance.fixed_view_mut::<3, 3>(3, 3).fill_with_identity();
        covariance.fixed_view_mut::<3, 3>(3, 3).scale_mut(0.1_f64.powi(2));
        let prior = FlightPrior {
            t_s: 0.0,
            p_m: Vector3::new(0.4, 0.1, 0.3),
            v_m_s: Vector3::new(3.0, 0.0, 2.5),
            covariance,
        };
        let with = Flight::fit(&samples, SIGMA_M, &AIR, Some(&prior)).unwrap().at(0.6).2;
        let without = Flight::fit(&samples, SIGMA_M, &AIR, None).unwrap().at(0.6).2;
        assert!(with[(1, 1)].sqrt() < 0.037 && without[(1, 1)].sqrt() > 0.041, "{with} {without}");
        let alone = Flight::of_prior(&prior, &AIR).at(0.6).2;
        assert!(alone[(1, 1)].sqrt() > with[(1, 1)].sqrt());
    }

    #[test]
    fn too_little_or_no_number_is_no_flight() {
        let sample = |t_s: f64| Sample { t_s, p_m: Vector3::zeros() };
        assert!(Flight::fit(&[sample(0.0), sample(0.1)], SIGMA_M, &AIR, None).is_none());
        assert!(Flight::fit(&[sample(0.0); 5], SIGMA_M, &AIR, None).is_none());
        assert!(Flight::fit(&[sample(0.0), sample(f64::NAN), sample(0.2)], SIGMA_M, &AIR, None).is_none());
        assert!(Flight::fit(&[], SIGMA_M, &AIR, None).is_none());
    }
}

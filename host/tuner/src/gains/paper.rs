//! Design A: Theorem 1 of the paper, continuous time, the command never saturates.
//!
//! Q > 0 and Y with  A Q + Q A' + B Y + Y' B' + 2 alpha Q <= 0,  [[umax^2 I, Y], [Y', Q]] >= 0 and
//! **Q >= I**; K = Y Q^-1. The last inequality is missing in print. It puts the unit ball of initial
//! states into {x : x' Q^-1 x <= 1}, the set on which the second one bounds the command; without it
//! Q may shrink to nothing and any gain passes. alpha, the decay rate, is the largest possible one.

use super::law::Gains;
use super::lmi::{Lmi, SolveError, bordered, symmetric_at, symmetric_unknowns};
use super::problem::Problem;
use super::rigor::{min_eigenvalue_bound, product_error};
use nalgebra::{DMatrix, DVector};

/// A system x' = A x + B u in coordinates in which the initial states are the unit ball.
#[derive(Clone, Debug, PartialEq)]
pub struct System {
    /// n x n.
    pub a: DMatrix<f64>,
    /// n x p.
    pub b: DMatrix<f64>,
    /// Bound of |u|, > 0.
    pub u_max: f64,
}

impl System {
    /// Of a joint: the least acceleration left over all phases.
    pub(super) fn of(problem: &Problem) -> Self {
        let u_max = problem.phases().iter().map(|p| p.u_max_rad_s2).fold(f64::INFINITY, f64::min);
        let (position, velocity) = problem.error_set();
        Self::joint(position, velocity, u_max)
    }

    /// Double integrator of one joint (paper eq. 10): state (position error / `position_rad`, velocity
    /// error / `velocity_rad_s`), input u in rad/s2.
    pub fn joint(position_rad: f64, velocity_rad_s: f64, u_max_rad_s2: f64) -> Self {
        Self {
            a: DMatrix::from_row_slice(2, 2, &[0.0, velocity_rad_s / position_rad, 0.0, 0.0]),
            b: DMatrix::from_row_slice(2, 1, &[0.0, 1.0 / velocity_rad_s]),
            u_max: u_max_rad_s2,
        }
    }
}

/// What Theorem 1 claims, with the numbers that prove it.
#[derive(Clone, Debug, PartialEq)]
pub struct PaperCertificate {
    /// Decay rate, 1/s.
    pub alpha: f64,
    /// n x n.
    pub q: DMatrix<f64>,
    /// p x n, K = Y Q^-1.
    pub y: DMatrix<f64>,
}

/// Proven lower bounds of the smallest eigenvalue of each inequality (all must be >= 0).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PaperMargins {
    /// -(A Q + Q A' + B Y + Y' B' + 2 alpha Q).
    pub decay: f64,
    /// [[umax^2 I, Y], [Y', Q]].
    pub input: f64,
    /// Q - I.
    pub unit_ball: f64,
}

/// Which inequality is not proven.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("certificate refused: {inequality} is only proven down to {margin:.3e}")]
pub struct PaperRefusal {
    pub inequality: &'static str,
    /// Proven bound of its smallest eigenvalue.
    pub margin: f64,
}

impl PaperCertificate {
    /// K = Y Q^-1 (p x n).
    pub fn gain(&self) -> Option<DMatrix<f64>> {
        Some(&self.y * self.q.clone().try_inverse()?)
    }

    /// The same in physical units, rounded to f32; k_last = 0.
    pub(super) fn gains(&self, problem: &Problem) -> Option<Gains> {
        let k = self.gain()?;
        let (position, velocity) = problem.error_set();
        Some([(k[0] / position) as f32, (k[1] / velocity) as f32, 0.0])
    }

    /// Checks every inequality by itself, with bounds on all rounding, for numbers from any source.
    ///
    /// # Errors
    /// [`PaperRefusal`] names the first inequality that is not proven.
    pub fn check(&self, system: &System) -> Result<PaperMargins, PaperRefusal> {
        let (a, b) = (&system.a, &system.b);
        let decay =
            -(a * &self.q + &self.q * a.transpose() + b * &self.y + self.y.transpose() * b.transpose())
                - &self.q * (2.0 * self.alpha);
        // Two products with A, two with B, a scaling, five additions: entry errors add up.
        let scale = decay.amax() + 2.0 * self.alpha.abs() * self.q.amax();
        let error = 2.0 * product_error((a, 0.0), (&self.q, 0.0))
            + 2.0 * product_error((b, 0.0), (&self.y, 0.0))
            + 8.0 * f64::EPSILON * scale;
        let p = self.y.nrows();
        let square = system.u_max * system.u_max;
        let input = bordered(&(DMatrix::identity(p, p) * square), &self.y, &self.q);
        let unit_ball = &self.q - DMatrix::identity(self.q.nrows(), self.q.nrows());
        let margins = PaperMargins {
            decay: min_eigenvalue_bound(&decay, error),
            input: min_eigenvalue_bound(&input, f64::EPSILON * square),
            unit_ball: min_eigenvalue_bound(&unit_ball, f64::EPSILON * self.q.amax()),
        };
        for (inequality, margin) in [
            ("the decay inequality", margins.decay),
            ("the input bound", margins.input),
            ("Q >= I (initial states inside the region of the input bound)", margins.unit_ball),
        ] {
            if margin.is_nan() || margin < 0.0 {
                return Err(PaperRefusal { inequality, margin });
            }
        }
        Ok(margins)
    }
}

/// The program "maximise the margin t of all inequalities at this decay rate", t <= 1.
///
/// With `contain_unit_ball` false it is the theorem as printed; kept because a test shows which gains that version
/// accepts.
pub(super) fn program(system: &System, alpha: f64, contain_unit_ball: bool) -> Lmi {
    let (n, p) = (system.a.nrows(), system.b.ncols());
    let first_y = symmetric_unknowns(n);
    let t = first_y + n * p;
    let mut lmi = Lmi::new(t + 1);
    lmi.objective[t] = 1.0;
    let (a, b) = (&system.a, &system.b);
    let identity = DMatrix::identity(n, n);
    lmi.require(|x| {
        let (q, y) = unpack(x, n, p);
        -(a * &q + &q * a.transpose() + b * &y + y.transpose() * b.transpose())
            - q * (2.0 * alpha)
            - &identity * x[t]
    });
    lmi.require(|x| {
        let (q, y) = unpack(x, n, p);
        let u = DMatrix::identity(p, p) * (system.u_max * system.u_max);
        bordered(&u, &y, &q) - DMatrix::identity(n + p, n + p) * x[t]
    });
    if contain_unit_ball {
        lmi.require(|x| unpack(x, n, p).0 - &identity * (1.0 + x[t]));
    } else {
        lmi.require(|x| unpack(x, n, p).0 - &identity * x[t]);
    }
    lmi.require(|x| DMatrix::from_element(1, 1, 1.0 - x[t]));
    lmi
}

/// (Q, Y) from the unknowns.
pub(super) fn unpack(x: &DVector<f64>, n: usize, p: usize) -> (DMatrix<f64>, DMatrix<f64>) {
    let first_y = symmetric_unknowns(n);
    (symmetric_at(x, 0, n), DMatrix::from_fn(p, n, |i, j| x[first_y + i * n + j]))
}

/// Margins below this count as infeasible: well above the rounding of the check, far below any use.
const MARGIN_MIN: f64 = 1e-8;

/// Largest decay rate to a relative resolution of 1e-9, with its certificate.
///
/// The feasible rates are an interval from 0 (a scaled Q proves smaller rates too), so bisection
/// finds its end. Each accepted point passed [`PaperCertificate::check`].
///
/// # Errors
/// [`SolveError`] if not even a decay of 1e-3 is proven.
pub(super) fn largest_decay(system: &System) -> Result<PaperCertificate, SolveError> {
    let attempt = |alpha: f64| -> Result<PaperCertificate, SolveError> {
        let x = program(system, alpha, true).solve(1e-9)?;
        let (q, y) = unpack(&x, system.a.nrows(), system.b.ncols());
        let certificate = PaperCertificate { alpha, q, y };
        match certificate.check(system) {
            Ok(m) if m.decay.min(m.input).min(m.unit_ball) > MARGIN_MIN => Ok(certificate),
            _ => Err(SolveError::Infeasible),
        }
    };
    let mut low = 1e-3;
    let mut best = attempt(low)?;
    let mut high = 2e-3;
    while let Ok(found) = attempt(high) {
        (best, low) = (found, high);
        high *= 2.0;
        if high > 1e6 {
            break;
        }
    }
    while high - low > 1e-9 * high {
        let middle = 0.5 * (low + high);
        match attempt(middle) {
            Ok(found) => (best, low) = (found, middle),
            Err(_) => high = middle,
        }
    }
    Ok(best)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unit_double_integrator() -> System {
        System::joint(1.0, 1.0, 10.0)
    }

    #[test]
    fn reproduces_the_independently_computed_optimum() {
        let system = unit_double_integrator();
        let found = largest_decay(&system).unwrap();
        assert!((found.alpha - 1.905_009_6).abs() < 2e-7, "{}", found.alpha);
        let k = found.gain().unwrap();
        assert!((k[0] + 5.6546).abs() < 2e-3 && (k[1] + 3.8100).abs() < 1e-3, "{k}");
        let want = DMatrix::from_row_slice(2, 2, &[3.1275, -5.9579, -5.9579, 17.6847]);
        assert!((&found.q - want).amax() < 5e-3, "{}", found.q);
        let margins = found.check(&system).unwrap();
        assert!(margins.decay > 0.0 && margins.input > 0.0 && margins.unit_ball > 0.0);
    }

    #[test]
    fn without_q_above_identity_the_checker_refuses_and_the_command_explodes() {
        let system = unit_double_integrator();
        let x = program(&system, 50.0, false).solve(1e-9).unwrap();
        let (q, y) = unpack(&x, 2, 1);
        let printed = PaperCertificate { alpha: 50.0, q, y };
        let refusal = printed.check(&system).unwrap_err();
        assert!(refusal.inequality.starts_with("Q >= I"), "{refusal}");
        // The theorem as printed promises |u| <= 10 from the unit ball.
        let u0 = printed.gain().unwrap().norm();
        assert!(u0 > 100.0 * system.u_max, "{u0}");
    }

    #[test]
    fn a_changed_number_is_refused() {
        let system = unit_double_integrator();
        let found = largest_decay(&system).unwrap();
        for (name, change) in [
            ("alpha", (|c: &mut PaperCertificate| c.alpha *= 1.001) as fn(&mut PaperCertificate)),
            ("q", |c| c.q[(0, 0)] *= 0.99),
            ("y", |c| c.y[(0, 0)] *= 1.01),
            ("nan", |c| c.q[(1, 1)] = f64::NAN),
        ] {
            let mut tampered = found.clone();
            change(&mut tampered);
            assert!(tampered.check(&system).is_err(), "{name}");
        }
    }
}

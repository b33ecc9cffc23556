//! The flight of a disc from noisy views of its centre and normal.
//!
//! Gauss-Newton over all views in information form: unknown are centre, velocity and tilt at the release and the
//! horizontal wind; a prior determines tilt and wind if the views do not. Views count by their time stamp, in any
//! order of arrival. The covariance is the inverse of the information at the solution, which is the Cramer-Rao
//! bound of the linearised problem.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use super::aero::Body;
use super::flight::{Air, DiscState, Path};
use super::throw::Throw;

/// Number of unknowns: centre, velocity, tilt about x and y, wind along x and y.
pub const UNKNOWNS: usize = 10;
type Vars = SVector<f64, UNKNOWNS>;
type Information = SMatrix<f64, UNKNOWNS, UNKNOWNS>;

/// One view of the disc.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// When it was exposed, s after the release.
    pub t_s: f64,
    /// Centre, m.
    pub center_m: Vector3<f64>,
    /// Unit normal, where the view shows it.
    pub normal: Option<Vector3<f64>>,
}

/// What is known before the first view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Model {
    /// The disc.
    pub body: Body,
    /// Spin at the release, rad/s.
    pub spin_rad_s: f64,
    /// Air; its wind is the mean of the prior. Vacuum gives the parabola of the paper.
    pub air: Air,
    /// Standard deviation of a view's centre, m per axis.
    pub center_sigma_m: f64,
    /// Standard deviation of a view's normal, rad per axis.
    pub normal_sigma_rad: f64,
    /// Standard deviation of the tilt at the release about level, rad per axis.
    pub tilt_sigma_rad: f64,
    /// Standard deviation of the wind, m/s per axis.
    pub wind_sigma_m_s: f64,
}

impl Model {
    /// Disc of the paper in air, views with 2 mm and 1°.
    #[must_use]
    pub fn in_air() -> Self {
        Self {
            body: Body::of_paper(),
            spin_rad_s: 50.0,
            air: Air::still(),
            center_sigma_m: 0.002,
            normal_sigma_rad: 1.0_f64.to_radians(),
            tilt_sigma_rad: 0.2,
            wind_sigma_m_s: 1.0,
        }
    }
}

/// An estimated flight.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    model: Model,
    vars: Vars,
    covariance: Information,
    /// Views that were used.
    pub used: usize,
    /// Views that were left out: farther from the flight than 1 in 1000 would be; at most a quarter.
    pub left_out: usize,
}

/// Step of the flights, s: the nutation of the paper's disc at 50 rad/s takes 60 ms.
const STEP_S: f64 = 0.004;
/// Chi-square of three degrees of freedom that 1 in 1000 exceeds.
const GATE: f64 = 16.3;
/// Steps of the differences, in the order of the unknowns.
const STEPS: [f64; UNKNOWNS] = [1e-4, 1e-4, 1e-4, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-2, 1e-2];

fn released(model: &Model, x: &Vars) -> (DiscState, Air) {
    let throw = Throw { start_m: x.fixed_rows::<3>(0).into(), velocity_m_s: x.fixed_rows::<3>(3).into() };
    // Small rotations about x and y.
    let normal = Vector3::new(x[7], -x[6], 1.0);
    let mut air = model.air;
    if air.density_kg_m3 > 0.0 {
        air.wind_m_s += Vector3::new(x[8], x[9], 0.0);
    }
    (DiscState::released(&throw, normal, model.spin_rad_s, &model.body), air)
}

fn flown(model: &Model, x: &Vars, until_s: f64) -> Path {
    let (state, air) = released(model, x);
    Path::flown_in_steps(&model.body, &air, &state, until_s, STEP_S)
}

/// Residuals of a view in standard deviations: centre, then normal across itself.
fn residual(model: &Model, path: &Path, view: &View) -> (Vector3<f64>, Option<Vector3<f64>>) {
    let at = path.at(view.t_s);
    let center = (view.center_m - at.p_m) / model.center_sigma_m;
    let normal = view.normal.map(|n| (n - at.normal * n.dot(&at.normal)) / model.normal_sigma_rad);
    (center, normal)
}

impl Estimate {
    /// From views; `None` with fewer than three, or if their times do not determine a velocity.
    #[must_use]
    pub fn new(model: &Model, views: &[View]) -> Option<Self> {
        Self::refit(model, views, None)
    }

    /// The same from an earlier estimate of this flight: fewer iterations.
    #[must_use]
    pub(crate) fn refit(model: &Model, views: &[View], earlier: Option<&Self>) -> Option<Self> {
        let finite =
            |v: &&View| v.t_s >= 0.0 && v.t_s.is_finite() && v.center_m.iter().all(|x| x.is_finite());
        let views: Vec<View> = views.iter().filter(finite).copied().collect();
        let last_s = views.iter().map(|v| v.t_s).fold(0.0, f64::max);
        let mut fits = views.clone();
        // The view that fits worst goes, one at a time: it pulls the others' residuals beyond the gate.
        loop {
            let guess = first_guess(model, &fits)?;
            let (vars, covariance) = fit(model, &fits, earlier.map_or(guess, |e| e.vars))?;
            let path = flown(model, &vars, last_s + 0.01);
            let off = |v: &View| residual(model, &path, v).0.norm_squared();
            let worst = (0..fits.len()).max_by(|a, b| off(&fits[*a]).total_cmp(&off(&fits[*b])))?;
            let left_out = views.len() - fits.len();
            if off(&fits[worst]) < GATE || 4 * (left_out + 1) > views.len() {
                return Some(Self { model: *model, vars, covariance, used: fits.len(), left_out });
            }
            fits.swap_remove(worst);
        }
    }

    /// The estimated flight until the floor or for `until_s`.
    #[must_use]
    pub fn path(&self, until_s: f64) -> Path {
        flown(&self.model, &self.vars, until_s)
    }

    /// Predicted centre at a time, m, with its covariance, m².
    #[must_use]
    pub fn center(&self, t_s: f64) -> (Vector3<f64>, Matrix3<f64>) {
        let at = |x: &Vars| flown(&self.model, x, t_s + 0.01).at(t_s).p_m;
        let mut jacobian = SMatrix::<f64, 3, UNKNOWNS>::zeros();
        for (k, step) in STEPS.iter().enumerate() {
            let mut d = Vars::zeros();
            d[k] = *step;
            jacobian.set_column(k, &((at(&(self.vars + d)) - at(&(self.vars - d))) / (2.0 * step)));
        }
        (at(&self.vars), jacobian * self.covariance * jacobian.transpose())
    }

    /// Estimated wind along x and y, m/s, with standard deviations.
    #[must_use]
    pub fn wind_m_s(&self) -> [(f64, f64); 2] {
        [8, 9].map(|k| (self.vars[k], self.covariance[(k, k)].sqrt()))
    }
}

/// Per-axis line through the centres after gravity is taken out; level disc, no wind.
fn first_guess(model: &Model, views: &[View]) -> Option<Vars> {
    if views.len() < 3 {
        return None;
    }
    let n = views.len() as f64;
    let mean_t = views.iter().map(|v| v.t_s).sum::<f64>() / n;
    let spread: f64 = views.iter().map(|v| (v.t_s - mean_t).powi(2)).sum();
    if spread < 1e-9 {
        return None;
    }
    let flat = |v: &View| v.center_m + Vector3::z() * (0.5 * model.air.gravity_m_s2 * v.t_s * v.t_s);
    let mean = views.iter().map(flat).sum::<Vector3<f64>>() / n;
    let velocity = views.iter().map(|v| (flat(v) - mean) * (v.t_s - mean_t)).sum::<Vector3<f64>>() / spread;
    let mut out = Vars::zeros();
    out.fixed_rows_mut::<3>(0).copy_from(&(mean - velocity * mean_t));
    out.fixed_rows_mut::<3>(3).copy_from(&velocity);
    Some(out)
}

/// Gauss-Newton; returns the solution and the inverse of the information there.
fn fit(model: &Model, views: &[View], mut x: Vars) -> Option<(Vars, Information)> {
    let last_s = views.iter().map(|v| v.t_s).fold(0.0, f64::max) + 0.01;
    let mut prior = Vars::repeat(1e-6);
    for k in [6, 7] {
        prior[k] = model.tilt_sigma_rad.powi(-2);
    }
    for k in [8, 9] {
        prior[k] = model.wind_sigma_m_s.powi(-2);
    }
    let mut information = Information::zeros();
    for _ in 0..6 {
        let path = flown(model, &x, last_s);
        let moved: Vec<(Path, Path)> = (0..UNKNOWNS)
            .map(|k| {
                let mut d = Vars::zeros();
                d[k] = STEPS[k];
                (flown(model, &(x - d), last_s), flown(model, &(x + d), last_s))
            })
            .collect();
        information = Information::from_diagonal(&prior);
        let mut gradient: Vars = -prior.component_mul(&x);
        // The priors are about zero for tilt and wind only; centre and velocity have practically no prior.
        gradient.fixed_rows_mut::<6>(0).fill(0.0);
        for view in views {
            let (center, normal) = residual(model, &path, view);
            let mut rows = SMatrix::<f64, 6, UNKNOWNS>::zeros();
            let mut off = SVector::<f64, 6>::zeros();
            off.fixed_rows_mut::<3>(0).copy_from(&center);
            off.fixed_rows_mut::<3>(3).copy_from(&normal.unwrap_or_else(Vector3::zeros));
            for (k, (low, high)) in moved.iter().enumerate() {
                let (a, b) = (residual(model, low, view), residual(model, high, view));
                rows.fixed_view_mut::<3, 1>(0, k).copy_from(&((a.0 - b.0) / (2.0 * STEPS[k])));
                if let (Some(a), Some(b)) = (a.1, b.1) {
                    rows.fixed_view_mut::<3, 1>(3, k).copy_from(&((a - b) / (2.0 * STEPS[k])));
                }
            }
            information += rows.tr_mul(&rows);
            gradient += rows.tr_mul(&off);
        }
        let step = information.cholesky()?.solve(&gradient);
        x += step;
        if step.component_div(&Vars::from(STEPS)).amax() < 0.1 {
            break;
        }
    }
    let covariance = information.cholesky()?.inverse();
    x.iter().all(|v| v.is_finite()).then_some((x, covariance))
}

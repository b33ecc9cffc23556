//! Design B: discrete time at the real period, delay and drive lag as states, saturation allowed
//! and certified.
//!
//! The command is u = sat(K x), |u| <= umax(t), where umax(t) is what the reference leaves at that
//! moment and never less than the phase's `u_max`. If |H x| <= u_max for some row H, then sat(K x)
//! lies between K x and H x whatever the bound is at the moment (T. Hu, Z. Lin, "Control Systems with
//! Actuator Saturation", 2001, lemma 7.3.1; a bound that varies or differs by sign is covered as long as it
//! stays above |H x|). So for V(x) = x' P x the inequalities, for F in {K, H} and each (period, delay)
//!
//! ```text
//!   e^(-2 beta h) P - (A + B F)' P (A + B F) >= t h (W + r F'F)      h = period / time unit
//!   [[P, H'], [H, 1]] >= 0                             |H x| <= u_max on {V <= 1}
//!   I - G' P G >= 0                                    initial errors {G z, |z| <= 1} inside
//! ```
//!
//! prove: from every initial error the saturated loop stays in {V <= 1}, V falls in every step, and
//! the cost sum h (x' W x + r u^2) is at most 1/t. All in coordinates scaled by [`scales`], u by u_max.
//! t is maximised for given K and H, which is a small semidefinite program in P and t.
//!
//! K is searched for in the two-parameter family of a double integrator whose state is predicted
//! over the delay ([`Family`]), from the member with the smallest simulated worst cost downwards,
//! until the inequalities hold; H is a slow member of the same family acting on the drive's target.
//!
//! A plan whose braking is harder than its start leaves less to correct with later on, when the
//! errors are long gone. So each phase has a certificate of its own; the initial set of the next one
//! is the ellipsoid {V <= sigma^2} that the decay e^(-beta) per time unit leaves.

use super::certificate::{Region, SaturatedCertificate};
use super::evidence::worst_cost;
use super::lmi::{Lmi, SolveError, bordered, symmetric_at, symmetric_unknowns};
use super::model::{STATES, sampled, target_row};
use super::problem::{Phase, Problem};
use nalgebra::{DMatrix, RowVector6, Vector6};

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

    /// W, 6 x 6.
    pub fn state(&self) -> DMatrix<f64> {
        let mut w = DMatrix::identity(STATES, STATES) * self.floor;
        w[(0, 0)] += 1.0;
        w[(1, 1)] += self.velocity;
        w
    }
}

/// Scales of the state (see [`super::model`] for its order) for errors up to `position_rad` under
/// commands up to `u_max`: velocity and time as a double integrator relates them, the transients as
/// large as a full command makes them within lag and period.
pub fn scales(problem: &Problem, position_rad: f64, u_max: f64) -> Vector6<f64> {
    let velocity = (position_rad * u_max).sqrt();
    let (lag, period) = (problem.drive().lag_s(), problem.period_s());
    Vector6::new(
        position_rad,
        velocity,
        u_max,
        u_max * lag * lag,
        u_max * (lag + 0.5 * period),
        u_max * 2.0 * lag,
    )
}

/// Time unit of the cost: how long u_max needs for a velocity of the scale, s.
pub fn time_unit_s(position_rad: f64, u_max: f64) -> f64 {
    (position_rad / u_max).sqrt()
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
    /// [k_pos, k_vel, k_last] for a prediction over `theta_s` (position) and `theta_s + late_s`
    /// (velocity, whose estimate is `late_s` old).
    pub fn gains(&self, theta_s: f64, late_s: f64) -> [f64; 3] {
        let (w2, d) = (self.omega * self.omega, 2.0 * self.zeta * self.omega);
        [-w2, -(w2 * theta_s + d), -(0.5 * w2 * theta_s * theta_s + d * (theta_s + late_s))]
    }
}

/// K as a row on the state.
pub fn row(gains: Gains) -> RowVector6<f64> {
    RowVector6::new(f64::from(gains[0]), f64::from(gains[1]), f64::from(gains[2]), 0.0, 0.0, 0.0)
}

/// H: slow feedback of the drive's target and its velocity, predicted over the delay.
pub(crate) fn slow_row(problem: &Problem, family: Family) -> RowVector6<f64> {
    target_row(&problem.drive(), family.gains(problem.delay().centre(), 0.0))
}

/// Why no saturated design exists for the data.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SaturatedError {
    /// Even the gentlest gains worth having are not certified.
    #[error(
        "joint {joint}: saturation binds: {u_max:.3} rad/s2 are left in phase {phase}, and no gains faster than \
         {omega_min} rad/s are certified for initial errors of {radius_rad} rad. Shrink the initial error to \
         {feasible_radius_rad:.4} rad, or leave {feasible_u_max:.3} rad/s2 (reference acceleration at most \
         {feasible_reference:.3} rad/s2)"
    )]
    SaturationBinds {
        /// Joint number.
        joint: usize,
        /// Phase, from 1.
        phase: usize,
        /// Left for control, rad/s2.
        u_max: f64,
        /// Slowest bandwidth tried, rad/s.
        omega_min: f64,
        /// Radius asked for, rad.
        radius_rad: f64,
        /// Largest radius that is certified (relaxed problem solved).
        feasible_radius_rad: f64,
        /// Smallest bound that certifies the radius asked for (the problem is homogeneous).
        feasible_u_max: f64,
        /// What the reference may use then, rad/s2 (0 if the drive cannot give the bound at all).
        feasible_reference: f64,
    },
    /// The delay forbids even slow gains.
    #[error(
        "joint {joint}: delay binds: with {delay_s} s delay, a period of {period_s} s and {lag_s} s drive lag no \
         gains faster than {omega_min} rad/s are stable; shorten the period or the delay"
    )]
    DelayBinds {
        /// Joint number.
        joint: usize,
        /// Largest delay.
        delay_s: f64,
        /// Nominal period.
        period_s: f64,
        /// Lag of the drive.
        lag_s: f64,
        /// Slowest bandwidth tried, rad/s.
        omega_min: f64,
    },
}

/// Slowest bandwidth worth tuning: at 3 rad/s an error halves in about half a second.
const OMEGA_MIN_RAD_S: f64 = 3.0;
/// Step of the search along the bandwidth.
const OMEGA_RATIO: f64 = 0.94;
/// Damping ratios tried.
const ZETAS: [f64; 3] = [0.6, 0.75, 0.9];
/// Slow rows tried: share of u_max / error radius that its stiffness takes, and its damping. Optima
/// of the full program (H free, ten times slower to solve) lie along this line.
const SLOW: [(f64, f64); 3] = [(0.8, 0.45), (0.75, 0.475), (0.6, 0.55)];

/// Designs the gains of one joint and certifies them.
///
/// The gains are rounded to f32 before anything is proven: the certificate is about the numbers the
/// firmware holds.
///
/// # Errors
/// [`SaturatedError`] with the binding condition and what to relax.
pub fn design(problem: &Problem) -> Result<SaturatedCertificate, SaturatedError> {
    let weights = Weights::DEFAULT;
    match search(problem, weights, OMEGA_RATIO) {
        Some(found) => Ok(found),
        None => Err(diagnose(problem, weights)),
    }
}

/// Certifies given gains for the problem, e.g. those in a controller; `None` if not provable here.
pub fn certify(problem: &Problem, gains: Gains) -> Option<SaturatedCertificate> {
    certify_with(problem, gains, Weights::DEFAULT, &problem.certified_points())
        .filter(|c| c.check(problem).is_ok())
}

/// Horizon over which the cost predicts, for the family: delay plus drive lag.
fn horizon(problem: &Problem) -> (f64, f64) {
    (problem.delay().centre() + problem.drive().lag_s(), 0.5 * problem.period_s())
}

/// The certified member of the family with the smallest simulated worst cost.
///
/// Along each damping ratio the fastest member that is provable at the nominal period is found
/// by bisection; the cheapest of these is then slowed down until everything is proven.
fn search(problem: &Problem, weights: Weights, ratio: f64) -> Option<SaturatedCertificate> {
    let (theta, late) = horizon(problem);
    // Beyond one radian of phase over the delay no member is stable.
    let omega_top = 1.0 / (theta + late);
    if omega_top < OMEGA_MIN_RAD_S {
        return None;
    }
    let steps = ((omega_top / OMEGA_MIN_RAD_S).ln() / -ratio.ln()).floor().max(0.0) as i32;
    let member = |step: i32, zeta: f64| {
        Family { omega: omega_top * ratio.powi(step), zeta }.gains(theta, late).map(|k| k as f32)
    };
    let nominal = problem.grid(1);
    let u_max = problem.phases()[0].u_max_rad_s2;
    let exists = |gains: Gains| certify_with(problem, gains, weights, &nominal).is_some();
    let mut tops: Vec<(f64, i32, f64)> = Vec::new();
    for zeta in ZETAS {
        // Neither end need be provable: the slow one may miss the decay that is asked for.
        let Some(first) =
            [4, 6, 3, 8, 5, 2, 7].iter().map(|i| steps * i / 8).find(|&s| exists(member(s, zeta)))
        else {
            continue;
        };
        let (mut unproven, mut proven) = (-1, first);
        while proven - unproven > 1 {
            let middle = (proven + unproven).div_euclid(2);
            if exists(member(middle, zeta)) {
                proven = middle;
            } else {
                unproven = middle;
            }
        }
        tops.push((worst_cost(problem, member(proven, zeta), u_max, weights), proven, zeta));
    }
    tops.sort_by(|a, b| a.0.total_cmp(&b.0));
    // Jitter and later phases cost a little more; strides double so that few programs are solved.
    let points = problem.certified_points();
    for &(_, top, zeta) in &tops {
        let (mut step, mut stride) = (top, 1);
        while step <= steps {
            let found = certify_with(problem, member(step, zeta), weights, &points);
            if let Some(found) = found.filter(|c| c.check(problem).is_ok()) {
                return Some(refine(problem, weights, &points, found, (step - stride / 2, step), |s| {
                    member(s, zeta)
                }));
            }
            step += stride;
            stride *= 2;
        }
    }
    None
}

/// Bisects between an unproven and a proven member for the fastest proven one.
fn refine(
    problem: &Problem,
    weights: Weights,
    points: &[(f64, f64)],
    mut best: SaturatedCertificate,
    (mut unproven, mut proven): (i32, i32),
    member: impl Fn(i32) -> Gains,
) -> SaturatedCertificate {
    while proven - unproven > 1 {
        let middle = (proven + unproven).div_euclid(2);
        match certify_with(problem, member(middle), weights, points).filter(|c| c.check(problem).is_ok()) {
            Some(found) => (best, proven) = (found, middle),
            None => unproven = middle,
        }
    }
    best
}

/// One region per phase, each starting where the contraction of the one before has led.
fn certify_with(
    problem: &Problem,
    gains: Gains,
    weights: Weights,
    vertices: &[(f64, f64)],
) -> Option<SaturatedCertificate> {
    let mut regions: Vec<Region> = Vec::new();
    let mut generators = problem.error_generators();
    for phase in problem.phases() {
        let region = region(problem, gains, *phase, &generators, weights, vertices)?;
        if let Some(duration) = phase.duration_s {
            let sigma = region.shrinkage(problem, duration);
            // {V <= sigma^2} = {S L^-T z sigma, |z| <= 1} with P = L L' in scaled coordinates.
            let l = region.p.clone().cholesky()?.l();
            let back = l.transpose().try_inverse()? * sigma;
            generators = DMatrix::from_diagonal(&super::certificate::dynamic(&region.scales)) * back;
        }
        regions.push(region);
    }
    Some(SaturatedCertificate { gains, weights, regions })
}

/// Solves for P and t with the first slow row for which there is a solution.
fn region(
    problem: &Problem,
    gains: Gains,
    phase: Phase,
    generators: &DMatrix<f64>,
    weights: Weights,
    vertices: &[(f64, f64)],
) -> Option<Region> {
    // Extent of the initial set along the drive's target, which is what H acts on.
    let target = DMatrix::from_row_slice(1, STATES, target_row(&problem.drive(), [1.0, 0.0, 0.0]).as_slice());
    let extent = (target * generators).norm().max(generators.row(0).norm());
    let u_max = phase.u_max_rad_s2;
    let scales = scales(problem, extent, u_max);
    let fast = row(gains);
    // The slow row must be slower than the gains themselves, or it bounds nothing.
    let omega_max = 0.9 * f64::from(-gains[0]).max(0.0).sqrt();
    SLOW.iter().find_map(|&(share, zeta)| {
        let omega = (share * u_max / extent).sqrt().min(omega_max);
        let slow = slow_row(problem, Family { omega, zeta });
        let (p, t) = solve(problem, (&fast, &slow), (u_max, &scales), generators, weights, vertices).ok()?;
        let decay_1_s = DECAY / time_unit_s(extent, u_max);
        Some(Region { u_max_rad_s2: u_max, scales, slow, p, cost_rate: t, decay_1_s })
    })
}

/// beta: guaranteed decay per time unit. A clipped double integrator cannot be asked for more than
/// its slow row has; at 0.25 an error at the rim of the region has lost two thirds after 0.6 s.
const DECAY: f64 = 0.12;
/// Margin of the decay inequality per time unit: covers periods and delays between the corners.
const DECAY_MARGIN: f64 = 2e-3;
/// Largest eigenvalue of P, scaled.
const P_MAX: f64 = 10.0;
/// Margin asked of every inequality, in scaled coordinates; the check proves it is not all rounding.
const MARGIN: f64 = 1e-4;
/// Tolerances of the solver, tried in turn: near the end of the feasible gains the last digits are
/// not always reached. The loosest is a tenth of the margin, and the check does not depend on it.
const TOLERANCES: [f64; 2] = [1e-7, 1e-5];
/// Share of the solver's cost rate that is claimed; the rest keeps the inequalities strict.
const CLAIM: f64 = 0.99;
/// Slower costs than this are no use: V would need a thousand time units to fall.
const COST_RATE_MIN: f64 = 1e-3;

/// The program of the module head in (P, t) for given K and H.
pub(crate) fn program(
    problem: &Problem,
    (fast, slow): (&RowVector6<f64>, &RowVector6<f64>),
    (u_max, scales): (f64, &Vector6<f64>),
    generators: &DMatrix<f64>,
    weights: Weights,
    vertices: &[(f64, f64)],
) -> Lmi {
    let n = STATES;
    let t = symmetric_unknowns(n);
    let mut lmi = Lmi::new(t + 1);
    lmi.objective[t] = 1.0;
    let unit = time_unit_s(scales[0], u_max);
    let w = weights.state();
    let identity = DMatrix::identity(n, n);
    for &(period, delay) in vertices {
        let model = sampled(&problem.drive(), period, delay);
        for f in [fast, slow] {
            let (closed, f) = scaled_loop(&model, f, scales, u_max);
            let h = period / unit;
            let stage = (&w + f.transpose() * &f * weights.input) * h;
            let keep = (-2.0 * DECAY * h).exp();
            lmi.require(|x| {
                let p = symmetric_at(x, 0, n);
                &p * keep - closed.transpose() * &p * &closed - &stage * x[t] - &identity * (DECAY_MARGIN * h)
            });
        }
    }
    let h = DMatrix::from_fn(1, n, |_, j| slow[j] * scales[j] / u_max);
    lmi.require(|x| {
        let p = symmetric_at(x, 0, n);
        bordered(&p, &h.transpose(), &DMatrix::from_element(1, 1, 1.0))
            - DMatrix::identity(n + 1, n + 1) * MARGIN
    });
    // Bounded above as well: nothing else keeps P finite in directions the initial set lacks.
    lmi.require(|x| &identity * P_MAX - symmetric_at(x, 0, n));
    let g = DMatrix::from_fn(n, generators.ncols(), |i, j| generators[(i, j)] / scales[i]);
    let m = generators.ncols();
    lmi.require(|x| DMatrix::identity(m, m) * (1.0 - MARGIN) - g.transpose() * symmetric_at(x, 0, n) * &g);
    lmi
}

pub(crate) fn solve(
    problem: &Problem,
    rows: (&RowVector6<f64>, &RowVector6<f64>),
    (u_max, scales): (f64, &Vector6<f64>),
    generators: &DMatrix<f64>,
    weights: Weights,
    vertices: &[(f64, f64)],
) -> Result<(DMatrix<f64>, f64), SolveError> {
    let lmi = program(problem, rows, (u_max, scales), generators, weights, vertices);
    let x = match lmi.solve(TOLERANCES[0]) {
        Err(SolveError::NotSolved(_)) => lmi.solve(TOLERANCES[1])?,
        other => other?,
    };
    let t = CLAIM * x[symmetric_unknowns(STATES)];
    if t < COST_RATE_MIN {
        return Err(SolveError::Infeasible);
    }
    Ok((symmetric_at(&x, 0, STATES), t))
}

/// (A + B F) and F in scaled coordinates.
pub(crate) fn scaled_loop(
    model: &super::model::Sampled,
    f: &RowVector6<f64>,
    scales: &Vector6<f64>,
    u_max: f64,
) -> (DMatrix<f64>, DMatrix<f64>) {
    let closed = model.a + model.b * f;
    (
        DMatrix::from_fn(STATES, STATES, |i, j| closed[(i, j)] * scales[j] / scales[i]),
        DMatrix::from_fn(1, STATES, |_, j| f[j] * scales[j] / u_max),
    )
}

/// Finds out what binds by solving relaxed problems: without saturation first, then smaller sets.
fn diagnose(problem: &Problem, weights: Weights) -> SaturatedError {
    let joint = problem.joint();
    // Errors a thousandth of the size never saturate: what fails then is the delay.
    let tiny = problem.with_scaled_error_set(1e-3);
    if search(&tiny, weights, 0.8).is_none() {
        return SaturatedError::DelayBinds {
            joint,
            delay_s: problem.delay().high,
            period_s: problem.period_s(),
            lag_s: problem.drive().lag_s(),
            omega_min: OMEGA_MIN_RAD_S,
        };
    }
    let (mut low, mut high) = (1e-3f64, 1.0f64);
    for _ in 0..7 {
        let middle = (low * high).sqrt();
        if search(&problem.with_scaled_error_set(middle), weights, 0.8).is_some() {
            low = middle;
        } else {
            high = middle;
        }
    }
    let (radius, _) = problem.error_set();
    let (phase, u_max) = problem
        .phases()
        .iter()
        .enumerate()
        .map(|(i, p)| (i + 1, p.u_max_rad_s2))
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .unwrap_or((1, 0.0));
    // The loop is homogeneous: errors c times smaller need bounds c times smaller.
    let feasible_u_max = u_max / low;
    SaturatedError::SaturationBinds {
        joint,
        phase,
        u_max,
        omega_min: OMEGA_MIN_RAD_S,
        radius_rad: radius,
        feasible_radius_rad: radius * low,
        feasible_u_max,
        feasible_reference: (problem.acceleration_max_rad_s2() - feasible_u_max).max(0.0),
    }
}

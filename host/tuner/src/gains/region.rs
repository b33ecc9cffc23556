//! Region of one phase: the semidefinite program in (P, t) for given gains, see [`super::saturated`].

use super::certificate::Region;
use super::law::{
    Family, Gains, Weights, certified_radius_rad, row, scaled_loop, scales, slow_row, time_unit_s,
};
use super::lmi::{Lmi, SolveError, symmetric_at, symmetric_unknowns};
use super::problem::{Phase, Problem};
use crate::model::{STATES, StateMatrix, StateRow, StateVector, target_row};
use nalgebra::DMatrix;

/// Slow rows tried: share of u_max / error radius that its stiffness takes, and its damping. Optima
/// of the full program (H free, ten times slower to solve) lie along this line.
const SLOW: [(f64, f64); 2] = [(0.8, 0.45), (0.75, 0.475)];

/// Margin of the decay inequality per time unit: covers periods and delays between the points.
const DECAY_MARGIN: f64 = 2e-3;
/// Weight of the trace of P, scaled, against the rate that is maximised. Nothing else keeps P small in directions
/// that neither the initial set nor the cost contains, and a large P there proves less between the points.
const TRACE_PRICE: f64 = 1e-5;
/// Required margin of every inequality, in scaled coordinates; the check proves that it is more than rounding.
const MARGIN: f64 = 1e-4;
/// Tolerance of the solver, a tenth of the margin: near the end of the feasible gains further digits are
/// not always reached, and the check does not depend on it.
const TOLERANCE: f64 = 1e-5;
/// Share of the solver's cost rate that is claimed; the rest keeps the inequalities strict.
const CLAIM: f64 = 0.99;
/// Slower costs than this are no use: V would need a thousand time units to fall.
const COST_RATE_MIN: f64 = 1e-3;

/// Requirements on a region.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Ask<'a> {
    pub(super) weights: Weights,
    /// Decay rate of sqrt(V) per time unit.
    pub(super) decay: f64,
    /// (period, delay), s, at which the inequalities are posed; the check covers the whole box.
    pub(super) points: &'a [(f64, f64)],
}

/// Solves for P and t with the first slow row for which there is a solution.
pub(super) fn region(
    problem: &Problem,
    gains: Gains,
    phase: Phase,
    generators: &DMatrix<f64>,
    ask: &Ask<'_>,
) -> Option<Region> {
    // Extent of the initial set along the drive's target, which is what H acts on.
    let target = DMatrix::from_row_slice(1, STATES, target_row(&problem.drive(), [1.0, 0.0, 0.0]).as_slice());
    let asked = (target * generators).norm().max(generators.row(0).norm());
    let u_max = phase.u_max_rad_s2;
    let extent = certified_radius_rad(problem, asked, u_max);
    let generators = &(generators * (extent / asked));
    let scales = scales(problem, extent, u_max);
    let fast = row(gains);
    // The slow row must be slower than the gains themselves, or it bounds nothing.
    let omega_max = 0.9 * f64::from(-gains[0]).max(0.0).sqrt();
    SLOW.iter().find_map(|&(share, zeta)| {
        let omega = (share * u_max / extent).sqrt().min(omega_max);
        let slow = slow_row(problem, Family { omega, zeta });
        let (p, t) = solve(problem, (&fast, &slow), (u_max, &scales), generators, ask).ok()?;
        let decay_1_s = ask.decay / time_unit_s(extent, u_max);
        Some(Region { u_max_rad_s2: u_max, scales, slow, p, cost_rate: t, decay_1_s })
    })
}

/// The program of [`super::saturated`] in (P, t) for given K and H.
pub(super) fn program(
    problem: &Problem,
    (fast, slow): (&StateRow, &StateRow),
    (u_max, scales): (f64, &StateVector),
    generators: &DMatrix<f64>,
    ask: &Ask<'_>,
) -> Lmi {
    let n = STATES;
    let t = symmetric_unknowns(n);
    let mut lmi = Lmi::new(t + 1);
    lmi.objective[t] = 1.0;
    for i in 0..n {
        lmi.objective[symmetric_unknowns(i + 1) - 1] = -TRACE_PRICE;
    }
    let unit = time_unit_s(scales[0], u_max);
    let identity = DMatrix::identity(n, n);
    for &(period, delay) in ask.points {
        let model = problem.sampled(period, delay);
        for f in [fast, slow] {
            let (closed, f) = scaled_loop(&model, f, scales, u_max);
            let h = period / unit;
            let stage = dynamic(&((ask.weights.state() + f.transpose() * f * ask.weights.input) * h));
            let closed = dynamic(&closed);
            let keep = (-2.0 * ask.decay * h).exp();
            lmi.require(|x| {
                let p = symmetric_at(x, 0, n);
                &p * keep - closed.transpose() * &p * &closed - &stage * x[t] - &identity * (DECAY_MARGIN * h)
            });
        }
    }
    // [[P, H'], [H, 1]] >= 0 by its Schur complement: H is given, so it stays linear.
    let h = DMatrix::from_fn(1, n, |_, j| slow[j] * scales[j] / u_max);
    let hh = h.transpose() * &h * (1.0 + 2.0 * MARGIN);
    lmi.require(|x| symmetric_at(x, 0, n) - &hh - &identity * (2.0 * MARGIN));
    let g = DMatrix::from_fn(n, generators.ncols(), |i, j| generators[(i, j)] / scales[i]);
    let m = generators.ncols();
    lmi.require(|x| DMatrix::identity(m, m) * (1.0 - MARGIN) - g.transpose() * symmetric_at(x, 0, n) * &g);
    lmi
}

fn solve(
    problem: &Problem,
    rows: (&StateRow, &StateRow),
    (u_max, scales): (f64, &StateVector),
    generators: &DMatrix<f64>,
    ask: &Ask<'_>,
) -> Result<(StateMatrix, f64), SolveError> {
    let lmi = program(problem, rows, (u_max, scales), generators, ask);
    let x = lmi.solve_above(COST_RATE_MIN, TOLERANCE)?;
    let t = CLAIM * x[symmetric_unknowns(STATES)];
    if t < CLAIM * COST_RATE_MIN {
        return Err(SolveError::TooLow);
    }
    Ok((StateMatrix::from_column_slice(symmetric_at(&x, 0, STATES).as_slice()), t))
}

fn dynamic(m: &StateMatrix) -> DMatrix<f64> {
    DMatrix::from_column_slice(STATES, STATES, m.as_slice())
}

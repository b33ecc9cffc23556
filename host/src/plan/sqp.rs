//! Local solve: sequential quadratic programming with exact second derivatives.
//!
//! `min f(x)` subject to `c_E(x) = 0`, `c_I(x) ≥ 0`. Each step solves
//!
//! ```text
//! min  ½ dᵀ (W + ρ A_EᵀA_E + τ I) d + ∇fᵀ d   subject to  c_E + A_E d = 0,  c_I + A_I d ≥ 0
//! ```
//!
//! with W the Hessian of the Lagrangian by differences of its exact gradient. The term in ρ leaves the solution as it
//! is (A_E d is fixed) and makes the matrix positive definite where W is so on the null space of A_E. If the linearised
//! constraints contradict each other, the violated ones become a quadratic price for that step, which is a damped
//! Gauss-Newton step towards feasibility within the rows that hold. Steps are accepted by an l1 merit function over
//! the last few values, so that curved constraints do not shorten good steps.

use super::cuts::Cut;
use super::problem::Problem;
use super::qp::{self, Constraint, DIM, QpFailure, Row, Square};
use super::rows::{
    EQUALITIES, F, Gradient, HA, HB, INEQUALITIES, Layout, Q, QD, Sink, evaluate, kinematic_rows, spline_rows,
};
use super::throw::JOINTS;

/// Tolerances and bounds of a local solve.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Settings {
    pub(crate) iterations_max: usize,
    /// Largest violation of a scaled row at a solution.
    pub(crate) feasibility: f64,
    /// Relative change of the objective at which the solve has converged.
    pub(crate) objective: f64,
    /// Stop early when the objective cannot get below this any more (feasible point, small steps).
    pub(crate) give_up_above: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self { iterations_max: 60, feasibility: 1e-8, objective: 1e-7, give_up_above: f64::INFINITY }
    }
}

/// Result of a local solve.
#[derive(Debug, Clone)]
pub(crate) struct Local {
    pub(crate) x: Row,
    pub(crate) objective: f64,
    /// Largest violation of a scaled row.
    pub(crate) violation: f64,
    pub(crate) iterations: usize,
    /// Multipliers of the inequalities.
    pub(crate) multipliers: Box<[f64; INEQUALITIES]>,
}

/// Rows of one evaluation.
struct Rows {
    n: usize,
    objective: f64,
    gradient: Row,
    eq: Vec<(usize, Constraint)>,
    ineq: Vec<(usize, Constraint)>,
}

impl Rows {
    fn new(n: usize) -> Self {
        Self {
            n,
            objective: 0.0,
            gradient: [0.0; DIM],
            eq: Vec::with_capacity(EQUALITIES),
            ineq: Vec::with_capacity(96),
        }
    }

    fn clear(&mut self) {
        self.objective = 0.0;
        self.gradient = [0.0; DIM];
        self.eq.clear();
        self.ineq.clear();
    }
}

impl Sink for Rows {
    fn wants(&self, _: usize) -> bool {
        true
    }
    fn wants_eq(&self, _: usize) -> bool {
        true
    }
    fn objective(&mut self, value: f64, gradient: impl FnOnce(&mut Gradient<'_>)) {
        self.objective = value;
        gradient(&mut Gradient { row: &mut self.gradient, factor: 1.0 });
    }
    fn eq(&mut self, id: usize, value: f64, gradient: impl FnOnce(&mut Gradient<'_>)) {
        let mut a = [0.0; DIM];
        gradient(&mut Gradient { row: &mut a, factor: 1.0 });
        self.eq.push((id, Constraint { a, c: value }));
    }
    fn ineq(&mut self, id: usize, value: f64, gradient: impl FnOnce(&mut Gradient<'_>)) {
        let mut a = [0.0; DIM];
        gradient(&mut Gradient { row: &mut a, factor: 1.0 });
        self.ineq.push((id, Constraint { a, c: value }));
    }
}

/// Objective and violations only.
#[derive(Default)]
struct Values {
    objective: f64,
    sum: f64,
    worst: f64,
}

impl Sink for Values {
    fn wants(&self, _: usize) -> bool {
        true
    }
    fn wants_eq(&self, _: usize) -> bool {
        true
    }
    fn objective(&mut self, value: f64, _: impl FnOnce(&mut Gradient<'_>)) {
        self.objective = value;
    }
    fn eq(&mut self, _: usize, value: f64, _: impl FnOnce(&mut Gradient<'_>)) {
        self.sum += value.abs();
        self.worst = self.worst.max(value.abs());
    }
    fn ineq(&mut self, _: usize, value: f64, _: impl FnOnce(&mut Gradient<'_>)) {
        // Written so that NaN counts as violated.
        let violation = if value >= 0.0 { 0.0 } else { -value };
        self.sum += violation;
        self.worst = self.worst.max(violation);
    }
}

/// Gradient of the Lagrangian `f - Σ λ c` for fixed multipliers.
struct Lagrangian<'a> {
    eq: &'a [f64; EQUALITIES],
    ineq: &'a [f64; INEQUALITIES],
    gradient: Row,
}

impl Lagrangian<'_> {
    fn add(&mut self, multiplier: f64, gradient: impl FnOnce(&mut Gradient<'_>)) {
        if multiplier != 0.0 {
            gradient(&mut Gradient { row: &mut self.gradient, factor: -multiplier });
        }
    }
}

impl Sink for Lagrangian<'_> {
    fn wants(&self, id: usize) -> bool {
        self.ineq[id] != 0.0
    }
    fn wants_eq(&self, id: usize) -> bool {
        self.eq[id] != 0.0
    }
    fn objective(&mut self, _: f64, gradient: impl FnOnce(&mut Gradient<'_>)) {
        gradient(&mut Gradient { row: &mut self.gradient, factor: 1.0 });
    }
    fn eq(&mut self, id: usize, _: f64, gradient: impl FnOnce(&mut Gradient<'_>)) {
        self.add(self.eq[id], gradient);
    }
    fn ineq(&mut self, id: usize, _: f64, gradient: impl FnOnce(&mut Gradient<'_>)) {
        self.add(self.ineq[id], gradient);
    }
}

/// Hessian of the Lagrangian by forward differences of its gradient.
///
/// The kinematic rows are functions of (q, q̇, F[, q̈]), the spline rows of (q̇, h_a, h_b[, q̈]) and linear in q; so each
/// is differenced only along the variables it bends with, and the rest follows from symmetry.
fn hessian(
    problem: &Problem<'_>,
    layout: &Layout,
    x: &Row,
    cuts: &[Cut],
    eq: &[f64; EQUALITIES],
    ineq: &[f64; INEQUALITIES],
    out: &mut Square,
) {
    let n = layout.n;
    for row in out.iter_mut().take(n) {
        row[..n].fill(0.0);
    }
    let sink = || Lagrangian { eq, ineq, gradient: [0.0; DIM] };
    let mut base = sink();
    spline_rows(problem, layout, x, &mut base);
    let mut moved = *x;
    for k in (QD..n).filter(|k| *k != F) {
        let eps = DIFFERENCE_STEP * x[k].abs().max(1.0);
        moved[k] = x[k] + eps;
        let mut at = sink();
        spline_rows(problem, layout, &moved, &mut at);
        moved[k] = x[k];
        for i in QD..n {
            let second = 0.5 * (at.gradient[i] - base.gradient[i]) / eps;
            out[k][i] += second;
            out[i][k] += second;
        }
        // q enters the spline rows linearly: only its coupling is left.
        for i in Q..QD {
            let second = (at.gradient[i] - base.gradient[i]) / eps;
            out[k][i] += second;
            out[i][k] += second;
        }
    }
    if eq.iter().all(|l| *l == 0.0) {
        return;
    }
    let mut base = sink();
    kinematic_rows(problem, layout, x, cuts, &mut base);
    // Without nulling the kinematic rows are linear in q̇ (J q̇) apart from currents, so q and F are enough.
    let bends = |k: usize| k < QD || k == F || layout.qdd && k != HA && k != HB;
    for k in (0..n).filter(|k| bends(*k)) {
        let eps = DIFFERENCE_STEP * x[k].abs().max(1.0);
        moved[k] = x[k] + eps;
        let mut at = sink();
        kinematic_rows(problem, layout, &moved, cuts, &mut at);
        moved[k] = x[k];
        for i in 0..n {
            let second = (at.gradient[i] - base.gradient[i]) / eps;
            if bends(i) {
                out[k][i] += 0.5 * second;
                out[i][k] += 0.5 * second;
            } else {
                out[k][i] += second;
                out[i][k] += second;
            }
        }
    }
}

/// Truncation and rounding of a forward difference of gradients balance here.
const DIFFERENCE_STEP: f64 = 1e-7;
/// Joint angles move at most this far in one step, in rad.
const STEP_MAX_RAD: f64 = 0.5;
/// Beyond this a step is not believed.
const STEP_FAR_RAD: f64 = 2.5;
/// Multipliers of nearly contradicting rows are huge; the curvature they would bring is noise.
const CURVATURE_CAP: f64 = 300.0;
/// Price of squared violations where the linearised constraints contradict each other, and damping of such steps.
const RELAX_PRICE: f64 = 1e4;
const RELAX_DAMPING: f64 = 30.0;
const RELAX_CAP: f64 = 1e2;
/// A run whose violation has not halved within this many steps is at a stationary point of the violation.
const PATIENCE: usize = 25;
/// Merit values remembered.
const MEMORY: usize = 4;

/// Solves from `x`; always returns the best point of the run, feasible or not (see [`Local::violation`]).
pub(crate) fn solve(
    problem: &Problem<'_>,
    layout: &Layout,
    start: &Row,
    cuts: &[Cut],
    settings: &Settings,
) -> Local {
    let n = layout.n;
    let mut x = *start;
    let mut rows = Rows::new(n);
    let mut lambda_eq = [0.0; EQUALITIES];
    let mut lambda = Box::new([0.0; INEQUALITIES]);
    let mut penalty = 10.0_f64;
    let mut memory: Vec<(f64, f64)> = Vec::with_capacity(MEMORY);
    let mut iterations = 0;
    let mut constraints: Vec<Constraint> = Vec::with_capacity(128);
    let mut violation = f64::INFINITY;
    let mut stalls = 0;
    let mut w = [[0.0; DIM]; DIM];
    let mut mark = (f64::INFINITY, 0);
    while iterations < settings.iterations_max {
        iterations += 1;
        rows.clear();
        evaluate(problem, layout, &x, cuts, &mut rows);
        violation = worst(&rows);
        if !violation.is_finite() || !rows.objective.is_finite() {
            break;
        }
        hessian(problem, layout, &x, cuts, &lambda_eq, &lambda, &mut w);
        constraints.clear();
        constraints.extend(rows.eq.iter().map(|r| r.1));
        constraints.extend(rows.ineq.iter().map(|r| r.1));
        // Variables that do not matter (a shift along a fixed axis) need some curvature.
        for (k, row) in w.iter_mut().enumerate().take(n) {
            row[k] += 1e-6;
        }
        if violation < 0.5 * mark.0 || violation <= 1e-5 {
            mark = (violation, iterations);
        } else if iterations - mark.1 > PATIENCE {
            break;
        }
        let Some(l) = convexify(&mut w, &constraints[..rows.eq.len()], n) else { break };
        // A program that is feasible only by a huge step says nothing about here: treat it like an infeasible one.
        let far = |d: &Row| d[Q..QD].iter().any(|d| d.abs() > STEP_FAR_RAD);
        let (d, multipliers) = match qp::solve(&l, &rows.gradient, n, &constraints, rows.eq.len()) {
            Ok(s) if !far(&s.d) => (s.d, s.multipliers),
            Ok(_) | Err(QpFailure::Infeasible | QpFailure::Numerical) => match relaxed(&w, &rows) {
                Some(found) => found,
                None => break,
            },
        };
        let mut step_limit = 1.0_f64;
        for k in 0..JOINTS {
            let big = d[Q + k].abs();
            if big > STEP_MAX_RAD {
                step_limit = step_limit.min(STEP_MAX_RAD / big);
            }
        }
        lambda_eq = [0.0; EQUALITIES];
        lambda.fill(0.0);
        let mut largest = 0.0_f64;
        for ((id, _), m) in rows.eq.iter().zip(&multipliers) {
            lambda_eq[*id] = m.clamp(-CURVATURE_CAP, CURVATURE_CAP);
            largest = largest.max(m.abs());
        }
        for ((id, _), m) in rows.ineq.iter().zip(&multipliers[rows.eq.len()..]) {
            lambda[*id] = m.min(CURVATURE_CAP);
            largest = largest.max(m.abs());
        }
        let wanted = (1.5 * largest + 1.0).min(1e6);
        // The penalty follows the multipliers up at once and down slowly.
        penalty = if wanted > penalty { wanted } else { (0.7 * penalty + 0.3 * wanted).max(1.0) };

        let slope: f64 = rows.gradient.iter().zip(&d).take(n).map(|(g, d)| g * d).sum();
        let total = total_violation(&rows);
        let predicted = slope - penalty * total;
        let small_change = slope.abs() <= settings.objective * rows.objective.abs().max(1e-3);
        if violation <= settings.feasibility && small_change {
            break;
        }
        if violation <= 1e-6 && rows.objective + 4.0 * slope > settings.give_up_above && slope.abs() < 0.5 {
            break;
        }
        let reference =
            memory.iter().map(|(f, v)| f + penalty * v).fold(rows.objective + penalty * total, f64::max);
        memory.push((rows.objective, total));
        if memory.len() > MEMORY {
            memory.remove(0);
        }
        let mut alpha = step_limit;
        let mut accepted = false;
        for _ in 0..12 {
            let mut trial = x;
            for k in 0..n {
                trial[k] += alpha * d[k];
            }
            if trial[F] > 1e-3 && trial[HA] > 1e-3 && trial[HB] > 1e-3 {
                let mut values = Values::default();
                evaluate(problem, layout, &trial, cuts, &mut values);
                let merit = values.objective + penalty * values.sum;
                if merit <= reference + 1e-4 * alpha * predicted.min(0.0) + 1e-12 * reference.abs() {
                    x = trial;
                    accepted = true;
                    break;
                }
            }
            alpha *= 0.5;
        }
        if !accepted {
            stalls += 1;
            memory.clear();
            if stalls > 1 {
                break;
            }
            // The model is useless here: take a short step along it and see.
            for k in 0..n {
                x[k] += alpha * d[k];
            }
        }
    }
    rows.clear();
    evaluate(problem, layout, &x, cuts, &mut rows);
    if worst(&rows).is_finite() {
        violation = worst(&rows);
    }
    Local { x, objective: rows.objective, violation, iterations, multipliers: lambda }
}

/// Evaluates all rows with gradients once; the largest violation.
pub(crate) fn evaluate_once(problem: &Problem<'_>, throw: &super::throw::Throw) -> f64 {
    let layout = Layout::new(problem, None);
    let mut rows = Rows::new(layout.n);
    evaluate(problem, &layout, &layout.variables(throw), &[], &mut rows);
    worst(&rows)
}

fn worst(rows: &Rows) -> f64 {
    let eq = rows.eq.iter().map(|r| r.1.c.abs()).fold(0.0, f64::max);
    let ineq = rows.ineq.iter().map(|r| -r.1.c).fold(0.0, f64::max);
    if rows.eq.iter().chain(&rows.ineq).any(|r| r.1.c.is_nan()) { f64::NAN } else { eq.max(ineq) }
}

fn total_violation(rows: &Rows) -> f64 {
    rows.eq.iter().map(|r| r.1.c.abs()).sum::<f64>()
        + rows.ineq.iter().map(|r| (-r.1.c).max(0.0)).sum::<f64>()
}

/// Turns W into `W + ρ A_EᵀA_E + τ I`, as little as makes it positive definite, and returns its Cholesky factor.
fn convexify(w: &mut Square, equalities: &[Constraint], n: usize) -> Option<Square> {
    let scale = (0..n).map(|k| w[k][k].abs()).fold(1.0, f64::max);
    for add in [1.0, 9.0, 90.0] {
        for constraint in equalities {
            for i in 0..n {
                let ai = add * constraint.a[i];
                if ai != 0.0 {
                    for (wk, ak) in w[i].iter_mut().zip(&constraint.a).take(n) {
                        *wk += ai * ak;
                    }
                }
            }
        }
        if let Some(l) = qp::cholesky(w, n) {
            return Some(l);
        }
    }
    let mut tau = 1e-3;
    while tau <= 1e4 * scale {
        for (k, row) in w.iter_mut().enumerate().take(n) {
            row[k] += tau;
        }
        if let Some(l) = qp::cholesky(w, n) {
            return Some(l);
        }
        tau *= 4.0;
    }
    None
}

/// The program with the violated constraints as a quadratic price instead of rows: always feasible at d = 0.
fn relaxed(w: &Square, rows: &Rows) -> Option<(Row, Vec<f64>)> {
    let n = rows.n;
    let mut h = *w;
    let mut g = rows.gradient;
    let mut hard: Vec<Constraint> = Vec::with_capacity(rows.ineq.len());
    let mut soften = |c: &Constraint| {
        for i in 0..n {
            if c.a[i] != 0.0 {
                g[i] += RELAX_PRICE * c.a[i] * c.c;
                for k in 0..n {
                    h[i][k] += RELAX_PRICE * c.a[i] * c.a[k];
                }
            }
        }
    };
    for (_, c) in &rows.eq {
        soften(c);
    }
    for (_, c) in &rows.ineq {
        if c.c < 0.0 { soften(c) } else { hard.push(*c) }
    }
    for (k, row) in h.iter_mut().enumerate().take(n) {
        row[k] += RELAX_DAMPING;
    }
    let mut l = qp::cholesky(&h, n);
    let mut tau = 1.0;
    while l.is_none() && tau < 1e9 {
        for (k, row) in h.iter_mut().enumerate().take(n) {
            row[k] += tau;
        }
        tau *= 4.0;
        l = qp::cholesky(&h, n);
    }
    let l = l?;
    let d = qp::solve(&l, &g, n, &hard, 0).ok()?.d;
    // First-order multipliers of the priced rows.
    let along = |c: &Constraint| c.a.iter().zip(&d).take(n).map(|(a, d)| a * d).sum::<f64>() + c.c;
    let mut multipliers: Vec<f64> =
        rows.eq.iter().map(|r| (-RELAX_PRICE * along(&r.1)).clamp(-RELAX_CAP, RELAX_CAP)).collect();
    multipliers.extend(
        rows.ineq
            .iter()
            .map(|r| if r.1.c < 0.0 { (-RELAX_PRICE * along(&r.1)).clamp(0.0, RELAX_CAP) } else { 0.0 }),
    );
    Some((d, multipliers))
}

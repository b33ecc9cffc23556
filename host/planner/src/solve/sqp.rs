//! Local solve: sequential quadratic programming with exact second derivatives.
//!
//! `min f(x)` subject to `c_E(x) = 0`, `c_I(x) ≥ 0`. Each step solves
//!
//! ```text
//! min  ½ dᵀ |W + ρ A_EᵀA_E| d + ∇fᵀ d   subject to  c_E + A_E d = 0,  c_I + A_I d ≥ 0
//! ```
//!
//! with W the Hessian of the Lagrangian by differences of its exact gradient. The term in ρ leaves the solution as it
//! is (A_E d is fixed) and makes the matrix positive definite where W is so on the null space of A_E; elsewhere the bars
//! turn negative eigenvalues positive. Near a solution the inequalities that hold with a multiplier are priced like the
//! equalities, `½ ρ (A d + c)²`: that is zero at the solution too, and there W curves upwards along all of them. If the
//! linearised constraints contradict each other, the violated ones become a quadratic price for that step, which is a damped
//! Gauss-Newton step towards feasibility within the rows that hold. Steps are accepted by an l1 merit function over
//! the last few values, so that curved constraints do not shorten good steps. After a short full step the factors of
//! the matrix are used again (a chord step): the Hessian is the costliest part.

use super::Task;
use super::curvature::{Matrix, hessian};
use super::qp::{self, Constraint, Factor, QpFailure, Row, Square};
pub use super::rows::Multipliers;
use super::rows::Rows;

/// Tolerances and bounds of a local solve.
#[derive(Debug, Clone, Copy)]
pub struct Settings {
    /// Steps of one solve.
    pub iterations_max: usize,
    /// Largest violation of a scaled row at a solution.
    pub feasibility: f64,
    /// Relative change of the objective at which the solve has converged.
    pub objective: f64,
    /// Stop early when the objective will not get below this any more.
    pub give_up_above: f64,
    /// A run that is far from the constraints and has not halved its violation within this many steps is at a stationary
    /// point of the violation.
    pub patience: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            iterations_max: 60,
            feasibility: 1e-8,
            objective: 1e-7,
            give_up_above: f64::INFINITY,
            patience: 25,
        }
    }
}

/// Result of a local solve.
#[derive(Debug, Clone)]
pub struct Local<const D: usize> {
    /// The variables.
    pub x: Row<D>,
    /// Value of the objective.
    pub objective: f64,
    /// Largest violation of a scaled row.
    pub violation: f64,
    /// Steps that were made.
    pub iterations: usize,
    /// Multipliers of the last step; they start a solve of a task nearby.
    pub multipliers: Multipliers,
}

/// Joint angles move at most this far in one step, in rad.
const STEP_MAX_RAD: f64 = 0.5;
/// Beyond this a step is not believed.
const STEP_FAR_RAD: f64 = 2.5;
/// Price of squared violations where the linearised constraints contradict each other, and damping of such steps.
const RELAX_PRICE: f64 = 1e4;
const RELAX_DAMPING: f64 = 30.0;
const RELAX_CAP: f64 = 1e2;
/// After a full step shorter than this in every variable the factors are used again, unless that has just failed to
/// bring the violation down to the given share.
const CHORD_STEP: f64 = 0.04;
const CHORD_SHARE: f64 = 0.2;
/// Below this violation a step or two back into the constraints suffice.
const NEARLY_FEASIBLE: f64 = 1e-3;
/// The last steps of a run only go back into the constraints, if they are no farther away than this.
const LAST_STEPS: usize = 3;
const LAST_VIOLATION: f64 = 1e-2;
/// Below this violation a run descends along the constraints. Its violation follows the length of its steps and need
/// not halve.
const DESCENDING_VIOLATION: f64 = 1e-3;
/// Steps back into the constraints after the last step of a run.
const RETURN_STEPS: usize = 8;
/// Where a run ends can be told when it is this near to the constraints and its steps are this short.
const GIVE_UP_VIOLATION: f64 = 1e-2;
const GIVE_UP_STEP: f64 = 0.1;
/// Below this violation multipliers say which inequalities a solution rests on.
const PRICED_VIOLATION: f64 = 0.1;
/// Halvings of a step at most.
const HALVINGS: usize = 12;
/// Merit values remembered.
const MEMORY: usize = 4;

/// Multipliers at a throw that is optimal for a target near this one (a stored throw).
///
/// At an optimum a program with any positive definite matrix has the step zero and the multipliers of the optimum. The
/// launch is taken as if it hit: only the target has changed since.
pub(crate) fn multipliers_at<const D: usize, T: Task<D>>(task: &T, x: &Row<D>) -> Option<Multipliers> {
    let mut rows = Rows::default();
    rows.evaluate(task, x);
    for row in &mut rows.eq {
        row.c = 0.0;
    }
    for row in &mut rows.ineq {
        row.c = row.c.max(0.0);
    }
    if !rows.objective.is_finite() || rows.worst().is_nan() {
        return None;
    }
    let solution =
        qp::solve(&Factor::identity(), &rows.gradient, task.variables(), &rows.eq, &rows.ineq, &[]).ok()?;
    let mut out = Multipliers::zero(task.numbers());
    out.set(&rows, &solution.eq, &solution.ineq);
    Some(out)
}

/// Solves from `start`; always returns the last point of the run, feasible or not (see [`Local::violation`]).
///
/// `warm` are multipliers to begin with, from a near solution.
#[must_use]
pub fn solve<const D: usize, T: Task<D>>(
    task: &T,
    start: &Row<D>,
    settings: &Settings,
    warm: Option<Multipliers>,
) -> Local<D> {
    let n = task.variables();
    let mut x = *start;
    let (mut rows, mut next) = (Rows::default(), Rows::default());
    rows.evaluate(task, &x);
    let mut believed = warm.is_some();
    let mut multipliers = warm.unwrap_or_else(|| Multipliers::zero(task.numbers()));
    let mut penalty = 10.0_f64;
    let mut memory: Vec<(f64, f64)> = Vec::with_capacity(MEMORY);
    let mut iterations = 0;
    let mut likely: Vec<usize> = Vec::new();
    let mut violation = rows.worst();
    let mut stalls = 0;
    let mut w = [[0.0; D]; D];
    let mut factor: Option<Matrix<D>> = None;
    let mut mark = (f64::INFINITY, 0);
    while iterations < settings.iterations_max && violation.is_finite() && rows.objective.is_finite() {
        iterations += 1;
        if violation < 0.5 * mark.0 || violation <= DESCENDING_VIOLATION {
            mark = (violation, iterations);
        } else if iterations - mark.1 > settings.patience {
            break;
        }
        likely.clear();
        likely.extend((0..rows.ineq.len()).filter(|k| multipliers.ineq[rows.ineq_id[*k]] > 0.0));
        if factor.is_none() {
            hessian(task, &x, &multipliers, &mut w);
            // Variables that do not matter (a shift along a fixed axis) need some curvature.
            for (k, row) in w.iter_mut().enumerate().take(n) {
                row[k] += 1e-6;
            }
            let near = believed && violation <= PRICED_VIOLATION;
            factor = Matrix::convex(&mut w, &rows, if near { &likely } else { &[] }, n);
        }
        let Some(used) = factor.take() else { break };
        let gradient = used.gradient(&rows, n);
        // A program that is feasible only by a huge step says nothing about here: treat it like an infeasible one.
        let far = |d: &Row<D>| d[task.angles()].iter().any(|d| d.abs() > STEP_FAR_RAD);
        let (d, eq, ineq, plain) = match qp::solve(&used.factor, &gradient, n, &rows.eq, &rows.ineq, &likely)
        {
            Ok(s) if !far(&s.d) => (s.d, s.eq, s.ineq, true),
            Ok(_) | Err(QpFailure::Infeasible | QpFailure::Numerical) => match relaxed(&w, &rows, n) {
                Some((d, eq, ineq)) => (d, eq, ineq, false),
                None => break,
            },
        };
        let largest = multipliers.set(&rows, &eq, &ineq);
        let wanted = (1.5 * largest + 1.0).min(1e6);
        // The penalty follows the multipliers up at once and down slowly.
        penalty = if wanted > penalty { wanted } else { (0.7 * penalty + 0.3 * wanted).max(1.0) };

        let slope: f64 = rows.gradient.iter().zip(&d).take(n).map(|(g, d)| g * d).sum();
        let total = rows.total();
        let predicted = slope - penalty * total;
        let small_change = slope.abs() <= settings.objective * rows.objective.abs().max(1e-3);
        if violation <= settings.feasibility && small_change {
            break;
        }
        let short = |most: f64| d.iter().take(n).all(|d| d.abs() < most);
        let near_the_end = violation <= GIVE_UP_VIOLATION && short(GIVE_UP_STEP);
        if near_the_end && rows.objective + 2.0 * slope.min(0.0) > settings.give_up_above {
            break;
        }
        let chord = short(CHORD_STEP);
        // Nothing left to gain, or no steps left to gain it, but not feasible yet: steps along a nearly flat valley would
        // bend out of the constraints again and again, so only go back into them, the shortest way.
        let out_of_steps = iterations + LAST_STEPS > settings.iterations_max && violation < LAST_VIOLATION;
        let finish = small_change && violation < NEARLY_FEASIBLE || out_of_steps;
        let mut d = d;
        if believed && finish {
            match qp::solve(&used.factor, &[0.0; D], n, &rows.eq, &rows.ineq, &likely) {
                Ok(back) => d = back.d,
                Err(QpFailure::Infeasible | QpFailure::Numerical) => {}
            }
        }
        let reference =
            memory.iter().map(|(f, v)| f + penalty * v).fold(rows.objective + penalty * total, f64::max);
        memory.push((rows.objective, total));
        if memory.len() > MEMORY {
            memory.remove(0);
        }
        let mut alpha = step_limit(task, &d);
        let mut accepted = false;
        for _ in 0..HALVINGS {
            let trial = moved(&x, alpha, &d, n);
            if task.is_motion(&trial) {
                next.evaluate(task, &trial);
                let merit = next.objective + penalty * next.total();
                if merit <= reference + 1e-4 * alpha * predicted.min(0.0) + 1e-12 * reference.abs() {
                    x = trial;
                    accepted = true;
                    break;
                }
            }
            alpha *= 0.5;
        }
        if accepted {
            std::mem::swap(&mut rows, &mut next);
        } else {
            stalls += 1;
            memory.clear();
            if stalls > 1 {
                break;
            }
            // The model is useless here: take a short step along it and see.
            let trial = moved(&x, alpha, &d, n);
            if !task.is_motion(&trial) {
                break;
            }
            x = trial;
            rows.evaluate(task, &x);
        }
        let before = violation;
        violation = rows.worst();
        let full = accepted && alpha >= 1.0 && plain;
        // The step that has just been taken was the last one needed.
        if full && believed && finish && violation <= settings.feasibility {
            break;
        }
        if full && believed && chord && violation <= (CHORD_SHARE * before).max(1e-7) {
            factor = Some(used);
        }
        believed = plain;
    }
    let mut end = Local { x, objective: rows.objective, violation, iterations, multipliers };
    step_back(task, settings, &mut end, rows, next);
    end
}

/// The shortest way back into the constraints. A run that ends without steps left is a little outside those that it descended
/// along; back inside it is a throw, which a later run can continue. `rows` are those of the end, `next` is room.
fn step_back<const D: usize, T: Task<D>>(
    task: &T,
    settings: &Settings,
    end: &mut Local<D>,
    mut rows: Rows<D>,
    mut next: Rows<D>,
) {
    let n = task.variables();
    for _ in 0..RETURN_STEPS {
        if !(end.violation > settings.feasibility && end.violation < LAST_VIOLATION) {
            break;
        }
        let Ok(back) = qp::solve(&Factor::identity(), &[0.0; D], n, &rows.eq, &rows.ineq, &[]) else {
            break;
        };
        let trial = moved(&end.x, 1.0, &back.d, n);
        if !task.is_motion(&trial) {
            break;
        }
        next.evaluate(task, &trial);
        end.iterations += 1;
        let after = next.worst();
        if after.is_nan() || after >= end.violation {
            break;
        }
        (end.x, end.objective, end.violation) = (trial, next.objective, after);
        std::mem::swap(&mut rows, &mut next);
    }
}

/// `x + alpha d` in the first `n` variables.
fn moved<const D: usize>(x: &Row<D>, alpha: f64, d: &Row<D>, n: usize) -> Row<D> {
    let mut out = *x;
    for (x, d) in out.iter_mut().zip(d).take(n) {
        *x += alpha * d;
    }
    out
}

/// Share of a step, at most 1, with which no joint angle moves more than [`STEP_MAX_RAD`].
fn step_limit<const D: usize, T: Task<D>>(task: &T, d: &Row<D>) -> f64 {
    let largest = d[task.angles()].iter().fold(0.0, |most: f64, d| most.max(d.abs()));
    if largest > STEP_MAX_RAD { STEP_MAX_RAD / largest } else { 1.0 }
}

/// Evaluates all rows with gradients once; the largest violation.
pub(crate) fn evaluate_once<const D: usize, T: Task<D>>(task: &T, x: &Row<D>) -> f64 {
    let mut rows = Rows::default();
    rows.evaluate(task, x);
    rows.worst()
}

/// The program with the violated constraints as a quadratic price instead of rows: always feasible at d = 0.
fn relaxed<const D: usize>(w: &Square<D>, rows: &Rows<D>, n: usize) -> Option<(Row<D>, Vec<f64>, Vec<f64>)> {
    let mut h = *w;
    let mut g = rows.gradient;
    let mut hard: Vec<Constraint<D>> = Vec::with_capacity(rows.ineq.len());
    let mut soften = |c: &Constraint<D>| {
        for i in 0..n {
            if c.a[i] != 0.0 {
                g[i] += RELAX_PRICE * c.a[i] * c.c;
                for k in 0..n {
                    h[i][k] += RELAX_PRICE * c.a[i] * c.a[k];
                }
            }
        }
    };
    for c in &rows.eq {
        soften(c);
    }
    for c in &rows.ineq {
        if c.c < 0.0 { soften(c) } else { hard.push(*c) }
    }
    for (k, row) in h.iter_mut().enumerate().take(n) {
        row[k] += RELAX_DAMPING;
    }
    let mut factor = Factor::new(&h, n);
    let mut tau = 1.0;
    while factor.is_none() && tau < 1e9 {
        for (k, row) in h.iter_mut().enumerate().take(n) {
            row[k] += tau;
        }
        tau *= 4.0;
        factor = Factor::new(&h, n);
    }
    let factor = factor?;
    let d = qp::solve(&factor, &g, n, &[], &hard, &[]).ok()?.d;
    // First-order multipliers of the priced rows.
    let along = |c: &Constraint<D>| c.a.iter().zip(&d).take(n).map(|(a, d)| a * d).sum::<f64>() + c.c;
    let eq = rows.eq.iter().map(|r| (-RELAX_PRICE * along(r)).clamp(-RELAX_CAP, RELAX_CAP)).collect();
    let priced =
        |r: &Constraint<D>| if r.c < 0.0 { (-RELAX_PRICE * along(r)).clamp(0.0, RELAX_CAP) } else { 0.0 };
    let ineq = rows.ineq.iter().map(priced).collect();
    Some((d, eq, ineq))
}

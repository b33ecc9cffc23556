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
use super::qp::{self, Constraint, Factor, QpFailure, Row, Square, WIDTH};
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
    /// A run that is farther than this from the constraints ends at once.
    pub hopeless_above: f64,
    /// When the matrix of a step is used again.
    pub chord: Chord,
}

/// After a full step shorter than `step` in every variable its matrix is used again, if it has brought the violation down to
/// `share` of what it was.
#[derive(Debug, Clone, Copy)]
pub struct Chord {
    /// Largest change of a variable.
    pub step: f64,
    /// Part of the violation that may be left.
    pub share: f64,
}

impl Chord {
    /// For starts of which nothing is known, and objectives that bend much.
    pub(crate) const CAREFUL: Self = Self { step: 0.04, share: 0.2 };
    /// For starts near a solution.
    pub(crate) const NEAR: Self = Self { step: 0.1, share: 0.4 };
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            iterations_max: 60,
            feasibility: 1e-8,
            objective: 1e-7,
            give_up_above: f64::INFINITY,
            patience: 12,
            hopeless_above: f64::INFINITY,
            chord: Chord::CAREFUL,
        }
    }
}

/// Why a local solve has ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ended {
    /// The point keeps the constraints. The next step would change the objective by [`Settings::objective`] or less.
    Converged,
    /// The point is near the constraints, and the objective will not get below [`Settings::give_up_above`].
    NotBetter,
    /// The violation was not halved within [`Settings::patience`] steps, or it is larger than [`Settings::hopeless_above`].
    Infeasible,
    /// No step along the direction makes the merit function smaller, or the program of a step has no solution.
    Stalled,
    /// [`Settings::iterations_max`] steps were made. The point may keep the constraints. Another solve can start from it.
    OutOfSteps,
    /// The objective or a constraint is not a number.
    Undefined,
}

/// Result of a local solve.
#[derive(Debug, Clone)]
pub struct Local {
    /// Why it ended there.
    pub ended: Ended,
    /// The variables.
    pub x: Row,
    /// Value of the objective.
    pub objective: f64,
    /// Largest violation of a scaled row.
    pub violation: f64,
    /// Steps that were made.
    pub iterations: usize,
    /// Multipliers of the last step; they start a solve of a task nearby.
    pub multipliers: Multipliers,
}

impl Local {
    /// Whether no scaled row is violated by more than `most`.
    #[must_use]
    pub fn is_feasible(&self, most: f64) -> bool {
        self.violation <= most && self.objective.is_finite()
    }
}

/// Joint angles move at most this far in one step, in rad.
const STEP_MAX_RAD: f64 = 0.5;
/// Beyond this a step is not believed.
const STEP_FAR_RAD: f64 = 2.5;
/// Price of squared violations if the linearised constraints contradict each other, and damping of such steps.
const RELAX_PRICE: f64 = 1e4;
const RELAX_DAMPING: f64 = 30.0;
const RELAX_CAP: f64 = 1e2;
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
/// The end of a run can be predicted when it is this near to the constraints and its steps are this short.
const GIVE_UP_VIOLATION: f64 = 1e-2;
const GIVE_UP_STEP: f64 = 0.1;
/// Below this violation multipliers show which inequalities are active at a solution.
const PRICED_VIOLATION: f64 = 0.1;
/// Halvings of a step at most.
const HALVINGS: usize = 12;
/// Merit values remembered.
const MEMORY: usize = 4;

/// Multipliers at a throw that is optimal for a target near this one (a stored throw).
///
/// At an optimum a program with any positive definite matrix has the step zero and the multipliers of the optimum. The
/// launch is taken as if it hit: only the target has changed since.
pub(crate) fn multipliers_at<T: Task>(task: &T, x: &Row) -> Option<Multipliers> {
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

/// Solves from `start`; always returns the last point of the run, feasible or not (see [`Local::violation`]), and why it is the last.
///
/// `warm` are multipliers to begin with, from a near solution.
#[must_use]
pub fn solve<T: Task>(task: &T, start: &Row, settings: &Settings, warm: Option<Multipliers>) -> Local {
    let mut run = Run::new(task, start, settings, warm);
    let ended = loop {
        if let Some(ended) = run.ended().or_else(|| run.step().err()) {
            break ended;
        }
    };
    let Run { x, rows, next, violation, iterations, multipliers, .. } = run;
    let mut end = Local { ended, x, objective: rows.objective, violation, iterations, multipliers };
    step_back(task, settings, &mut end, rows, next);
    end
}

/// A solve under way.
struct Run<'t, T> {
    task: &'t T,
    settings: &'t Settings,
    x: Row,
    /// Rows at `x`.
    rows: Rows,
    /// Room for the rows of a trial.
    next: Rows,
    violation: f64,
    iterations: usize,
    multipliers: Multipliers,
    /// Inequalities with a multiplier.
    likely: Vec<usize>,
    /// Whether the multipliers are those of a program whose constraints agree, or of a near solution.
    believed: bool,
    penalty: f64,
    /// Objective and total violation of the last steps.
    memory: Vec<(f64, f64)>,
    stalls: usize,
    /// Hessian of the Lagrangian, convex.
    w: Square,
    /// Matrix of the step before, if it is used again.
    factor: Option<Matrix>,
    /// Violation when it was last halved, and the step that did it.
    mark: (f64, usize),
}

/// Solution of the program of a step.
struct Direction {
    d: Row,
    /// Whether the linearised constraints agree with each other.
    plain: bool,
    used: Matrix,
}

impl<'t, T: Task> Run<'t, T> {
    fn new(task: &'t T, start: &Row, settings: &'t Settings, warm: Option<Multipliers>) -> Self {
        let mut rows = Rows::default();
        rows.evaluate(task, start);
        Self {
            task,
            settings,
            x: *start,
            violation: rows.worst(),
            rows,
            next: Rows::default(),
            iterations: 0,
            likely: Vec::new(),
            believed: warm.is_some(),
            multipliers: warm.unwrap_or_else(|| Multipliers::zero(task.numbers())),
            penalty: 10.0,
            memory: Vec::with_capacity(MEMORY),
            stalls: 0,
            w: [[0.0; WIDTH]; WIDTH],
            factor: None,
            mark: (f64::INFINITY, 0),
        }
    }

    /// What keeps the run from another step.
    fn ended(&self) -> Option<Ended> {
        if !(self.violation.is_finite() && self.rows.objective.is_finite()) {
            Some(Ended::Undefined)
        } else if self.violation > self.settings.hopeless_above {
            Some(Ended::Infeasible)
        } else {
            (self.iterations >= self.settings.iterations_max).then_some(Ended::OutOfSteps)
        }
    }

    /// One step; an error ends the run.
    fn step(&mut self) -> Result<(), Ended> {
        let n = self.task.variables();
        self.iterations += 1;
        if self.violation < 0.5 * self.mark.0 || self.violation <= DESCENDING_VIOLATION {
            self.mark = (self.violation, self.iterations);
        } else if self.iterations - self.mark.1 > self.settings.patience {
            return Err(Ended::Infeasible);
        }
        let Direction { mut d, plain, used } = self.direction().ok_or(Ended::Stalled)?;
        let slope: f64 = self.rows.gradient.iter().zip(&d).take(n).map(|(g, d)| g * d).sum();
        let small_change = slope.abs() <= self.settings.objective * self.rows.objective.abs().max(1e-3);
        if self.violation <= self.settings.feasibility && small_change {
            return Err(Ended::Converged);
        }
        let short = |most: f64| d.iter().take(n).all(|d| d.abs() < most);
        let near_the_end = self.violation <= GIVE_UP_VIOLATION && short(GIVE_UP_STEP);
        if near_the_end && self.rows.objective + 2.0 * slope.min(0.0) > self.settings.give_up_above {
            return Err(Ended::NotBetter);
        }
        let chord = short(self.settings.chord.step);
        // Nothing left to gain, or no steps left to gain it, but not feasible yet: steps along a nearly flat valley would
        // bend out of the constraints again and again, so only go back into them, the shortest way.
        let out_of_steps =
            self.iterations + LAST_STEPS > self.settings.iterations_max && self.violation < LAST_VIOLATION;
        let finish = small_change && self.violation < NEARLY_FEASIBLE || out_of_steps;
        if self.believed && finish {
            let back =
                qp::solve(&used.factor, &[0.0; WIDTH], n, &self.rows.eq, &self.rows.ineq, &self.likely);
            match back {
                Ok(back) => d = back.d,
                Err(QpFailure::Infeasible | QpFailure::Numerical) => {}
            }
        }
        let full = self.go_along(&d, slope).ok_or(Ended::Stalled)? && plain;
        let before = std::mem::replace(&mut self.violation, self.rows.worst());
        // The step that has just been taken was the last one needed.
        if full && self.believed && finish && self.violation <= self.settings.feasibility {
            return Err(if small_change { Ended::Converged } else { Ended::OutOfSteps });
        }
        if full && self.believed && chord && self.violation <= (self.settings.chord.share * before).max(1e-7)
        {
            self.factor = Some(used);
        }
        self.believed = plain;
        Ok(())
    }

    /// Solves the program of this step; its multipliers become those of the run.
    fn direction(&mut self) -> Option<Direction> {
        let n = self.task.variables();
        let rows = &self.rows;
        self.likely.clear();
        self.likely.extend((0..rows.ineq.len()).filter(|k| self.multipliers.ineq[rows.ineq_id[*k]] > 0.0));
        if self.factor.is_none() {
            hessian(self.task, &self.x, &self.multipliers, &mut self.w);
            // Variables that do not matter (a shift along a fixed axis) need some curvature.
            for (k, row) in self.w.iter_mut().enumerate().take(n) {
                row[k] += 1e-6;
            }
            let near = self.believed && self.violation <= PRICED_VIOLATION;
            let priced: &[usize] = if near { &self.likely } else { &[] };
            self.factor = Matrix::convex(&mut self.w, rows, priced, n);
        }
        let used = self.factor.take()?;
        let gradient = used.gradient(rows, n);
        // A program that is feasible only by a huge step is of no use here: it is treated as infeasible.
        let far = |d: &Row| d[self.task.angles()].iter().any(|d| d.abs() > STEP_FAR_RAD);
        let (d, eq, ineq, plain) =
            match qp::solve(&used.factor, &gradient, n, &rows.eq, &rows.ineq, &self.likely) {
                Ok(s) if !far(&s.d) => (s.d, s.eq, s.ineq, true),
                Ok(_) | Err(QpFailure::Infeasible | QpFailure::Numerical) => {
                    let (d, eq, ineq) = relaxed(&self.w, rows, n)?;
                    (d, eq, ineq, false)
                }
            };
        let largest = self.multipliers.set(rows, &eq, &ineq);
        let wanted = (1.5 * largest + 1.0).min(1e6);
        // The penalty follows the multipliers up at once and down slowly.
        self.penalty =
            if wanted > self.penalty { wanted } else { (0.7 * self.penalty + 0.3 * wanted).max(1.0) };
        Some(Direction { d, plain, used })
    }

    /// Moves along `d` as far as the merit function allows; returns whether that was the full step. `None`: no step.
    fn go_along(&mut self, d: &Row, slope: f64) -> Option<bool> {
        let n = self.task.variables();
        let (total, penalty) = (self.rows.total(), self.penalty);
        let predicted = slope - penalty * total;
        let merits = self.memory.iter().map(|(f, v)| f + penalty * v);
        let reference = merits.fold(self.rows.objective + penalty * total, f64::max);
        self.memory.push((self.rows.objective, total));
        if self.memory.len() > MEMORY {
            self.memory.remove(0);
        }
        let mut alpha = step_limit(self.task, d);
        for _ in 0..HALVINGS {
            let trial = moved(&self.x, alpha, d, n);
            if self.task.is_motion(&trial) {
                self.next.evaluate(self.task, &trial);
                let merit = self.next.objective + penalty * self.next.total();
                if merit <= reference + 1e-4 * alpha * predicted.min(0.0) + 1e-12 * reference.abs() {
                    self.x = trial;
                    std::mem::swap(&mut self.rows, &mut self.next);
                    return Some(alpha >= 1.0);
                }
            }
            alpha *= 0.5;
        }
        self.stalls += 1;
        self.memory.clear();
        // The model is useless here: take a short step along it and see.
        let trial = moved(&self.x, alpha, d, n);
        if self.stalls > 1 || !self.task.is_motion(&trial) {
            return None;
        }
        self.x = trial;
        self.rows.evaluate(self.task, &self.x);
        Some(false)
    }
}

/// The shortest way back into the constraints. A run that ends without steps left is a little outside the
/// constraints along which it descended; back inside it is a throw, which a later run can continue. `rows` are
/// those of the end, `next` is working space.
fn step_back<T: Task>(task: &T, settings: &Settings, end: &mut Local, mut rows: Rows, mut next: Rows) {
    let n = task.variables();
    for _ in 0..RETURN_STEPS {
        if !(end.violation > settings.feasibility && end.violation < LAST_VIOLATION) {
            break;
        }
        let Ok(back) = qp::solve(&Factor::identity(), &[0.0; WIDTH], n, &rows.eq, &rows.ineq, &[]) else {
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
fn moved(x: &Row, alpha: f64, d: &Row, n: usize) -> Row {
    let mut out = *x;
    for (x, d) in out.iter_mut().zip(d).take(n) {
        *x += alpha * d;
    }
    out
}

/// Share of a step, at most 1, with which no joint angle moves more than [`STEP_MAX_RAD`].
fn step_limit<T: Task>(task: &T, d: &Row) -> f64 {
    let largest = d[task.angles()].iter().fold(0.0, |most: f64, d| most.max(d.abs()));
    if largest > STEP_MAX_RAD { STEP_MAX_RAD / largest } else { 1.0 }
}

/// Evaluates all rows with gradients once; the largest violation.
pub(crate) fn evaluate_once<T: Task>(task: &T, x: &Row) -> f64 {
    let mut rows = Rows::default();
    rows.evaluate(task, x);
    rows.worst()
}

/// The program with the violated constraints as a quadratic price instead of rows: always feasible at d = 0.
fn relaxed(w: &Square, rows: &Rows, n: usize) -> Option<(Row, Vec<f64>, Vec<f64>)> {
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
    let along = |c: &Constraint| c.a.iter().zip(&d).take(n).map(|(a, d)| a * d).sum::<f64>() + c.c;
    let eq = rows.eq.iter().map(|r| (-RELAX_PRICE * along(r)).clamp(-RELAX_CAP, RELAX_CAP)).collect();
    let priced =
        |r: &Constraint| if r.c < 0.0 { (-RELAX_PRICE * along(r)).clamp(0.0, RELAX_CAP) } else { 0.0 };
    let ineq = rows.ineq.iter().map(priced).collect();
    Some((d, eq, ineq))
}

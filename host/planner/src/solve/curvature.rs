//! Curvature of a step: the Hessian of the Lagrangian, and a positive definite matrix in its place.

use nalgebra::DMatrix;

use super::qp::{Constraint, Factor, Row, Square, WIDTH};
use super::rows::{Multipliers, Rows};
use super::{Gradient, Sink, Task, When};

/// Truncation and rounding of a forward difference of gradients balance here.
const DIFFERENCE_STEP: f64 = 1e-7;
/// An indefinite matrix is given at least this much curvature in every direction.
const CURVATURE_MIN: f64 = 1.0;
/// Bound on the steps of the eigenvalue iteration; matrices of this size need some 40.
const EIGEN_STEPS_MAX: usize = 1_000;
/// Prices ρ that are tried.
const PRICES: [f64; 2] = [10.0, 100.0];

/// Gradient of the Lagrangian `f - Σ λ c` for fixed multipliers.
struct Lagrangian<'a> {
    at: &'a Multipliers,
    gradient: Row,
}

impl Lagrangian<'_> {
    #[inline]
    fn add(&mut self, multiplier: f64, gradient: impl FnOnce(&mut Gradient<'_>)) {
        if multiplier != 0.0 {
            gradient(&mut Gradient { row: &mut self.gradient, factor: -multiplier });
        }
    }
}

impl Sink for Lagrangian<'_> {
    #[inline]
    fn wants(&self, id: usize) -> bool {
        self.at.ineq[id] != 0.0
    }
    #[inline]
    fn wants_eq(&self, id: usize) -> bool {
        self.at.eq[id] != 0.0
    }
    #[inline]
    fn objective(&mut self, _: f64, gradient: impl FnOnce(&mut Gradient<'_>)) {
        gradient(&mut Gradient { row: &mut self.gradient, factor: 1.0 });
    }
    #[inline]
    fn eq(&mut self, id: usize, _: f64, gradient: impl FnOnce(&mut Gradient<'_>)) {
        self.add(self.at.eq[id], gradient);
    }
    #[inline]
    fn ineq(&mut self, id: usize, _: f64, gradient: impl FnOnce(&mut Gradient<'_>)) {
        self.add(self.at.ineq[id], gradient);
    }
}

/// Hessian of the Lagrangian by forward differences of its gradient.
pub(crate) fn hessian<T: Task>(task: &T, x: &Row, at: &Multipliers, out: &mut Square) {
    let n = task.variables();
    for row in out.iter_mut().take(n) {
        row[..n].fill(0.0);
    }
    let no_equality = at.eq.iter().all(|l| *l == 0.0);
    let mut moved = *x;
    for (part, when) in task.parts() {
        if when == When::WithMultipliers && no_equality {
            continue;
        }
        let gradient = |x: &Row| {
            let mut sink = Lagrangian { at, gradient: [0.0; WIDTH] };
            task.part_rows(part, x, &mut sink);
            sink.gradient
        };
        let base = gradient(x);
        for k in (0..n).filter(|k| task.bends(part, *k)) {
            let eps = DIFFERENCE_STEP * x[k].abs().max(1.0);
            moved[k] = x[k] + eps;
            let there = gradient(&moved);
            moved[k] = x[k];
            for i in 0..n {
                let share = if task.twice(part, i) { 0.5 } else { 1.0 };
                let second = share * (there[i] - base[i]) / eps;
                out[k][i] += second;
                out[i][k] += second;
            }
        }
    }
}

/// A positive definite matrix in the place of W.
pub(crate) struct Matrix {
    pub(crate) factor: Factor,
    /// Numbers of the inequalities that are priced in it.
    priced: Vec<usize>,
}

impl Matrix {
    /// Turns W into `W + ρ A_EᵀA_E`; if that is not positive definite, prices the rows in `likely` (positions) as well, and
    /// if that does not help, turns up what is negative.
    pub(crate) fn convex(w: &mut Square, rows: &Rows, likely: &[usize], n: usize) -> Option<Self> {
        let mut before = 0.0;
        for price in PRICES {
            rows.eq.iter().for_each(|row| add_square(w, price - before, row, n));
            before = price;
            if let Some(factor) = Factor::new(w, n) {
                return Some(Self { factor, priced: Vec::new() });
            }
        }
        if !likely.is_empty() {
            let mut priced = *w;
            likely.iter().for_each(|k| add_square(&mut priced, before, &rows.ineq[*k], n));
            if let Some(factor) = Factor::new(&priced, n) {
                return Some(Self { factor, priced: likely.iter().map(|k| rows.ineq_id[*k]).collect() });
            }
        }
        Some(Self { factor: turned_up(w, n)?, priced: Vec::new() })
    }

    /// Gradient of the objective with that of the priced rows.
    pub(crate) fn gradient(&self, rows: &Rows, n: usize) -> Row {
        let mut g = rows.gradient;
        let [.., price] = PRICES;
        for (row, id) in rows.ineq.iter().zip(&rows.ineq_id) {
            if self.priced.contains(id) {
                for (g, a) in g.iter_mut().zip(&row.a).take(n) {
                    *g += price * row.c * a;
                }
            }
        }
        g
    }
}

/// Adds `price aᵀa`.
fn add_square(w: &mut Square, price: f64, row: &Constraint, n: usize) {
    for i in 0..n {
        let ai = price * row.a[i];
        if ai != 0.0 {
            for (wk, ak) in w[i].iter_mut().zip(&row.a).take(n) {
                *wk += ai * ak;
            }
        }
    }
}

/// Factor of the matrix with its negative eigenvalues turned positive.
///
/// A shift of the whole diagonal would do as well, but it also shortens every step along which the curvature is
/// known and small: where the price of a throw hardly depends on its posture, steps became gradient steps.
fn turned_up(w: &mut Square, n: usize) -> Option<Factor> {
    let eigen = DMatrix::from_fn(n, n, |i, k| w[i][k]).try_symmetric_eigen(1e-12, EIGEN_STEPS_MAX)?;
    for (value, vector) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
        let add = value.abs().max(CURVATURE_MIN) - value;
        if add > 0.0 {
            for i in 0..n {
                for k in 0..n {
                    w[i][k] += add * vector[i] * vector[k];
                }
            }
        }
    }
    Factor::new(w, n)
}

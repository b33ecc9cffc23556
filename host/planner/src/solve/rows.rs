//! Rows of one evaluation, and the multipliers that belong to them.

use super::qp::{Constraint, Row, WIDTH};
use super::{Gradient, Sink, Task};

/// Multipliers of nearly contradicting rows are huge; the curvature they would bring is noise.
const CURVATURE_CAP: f64 = 300.0;

/// Multipliers by row number.
#[derive(Debug, Clone)]
pub struct Multipliers {
    pub(crate) eq: Box<[f64]>,
    pub(crate) ineq: Box<[f64]>,
}

impl Multipliers {
    pub(super) fn zero((equalities, inequalities): (usize, usize)) -> Self {
        Self {
            eq: vec![0.0; equalities].into_boxed_slice(),
            ineq: vec![0.0; inequalities].into_boxed_slice(),
        }
    }

    /// Takes over those of a program; bounded, since the curvature that huge ones bring is noise. Returns the largest.
    pub(super) fn set(&mut self, rows: &Rows, eq: &[f64], ineq: &[f64]) -> f64 {
        self.eq.fill(0.0);
        self.ineq.fill(0.0);
        let mut largest = 0.0_f64;
        for (id, m) in rows.eq_id.iter().zip(eq) {
            self.eq[*id] = m.clamp(-CURVATURE_CAP, CURVATURE_CAP);
            largest = largest.max(m.abs());
        }
        for (id, m) in rows.ineq_id.iter().zip(ineq) {
            self.ineq[*id] = m.min(CURVATURE_CAP);
            largest = largest.max(m.abs());
        }
        largest
    }
}

/// Rows of one evaluation.
pub(crate) struct Rows {
    pub(super) objective: f64,
    pub(crate) gradient: Row,
    pub(super) eq_id: Vec<usize>,
    pub(crate) eq: Vec<Constraint>,
    pub(crate) ineq_id: Vec<usize>,
    pub(crate) ineq: Vec<Constraint>,
}

impl Default for Rows {
    fn default() -> Self {
        Self {
            objective: 0.0,
            gradient: [0.0; WIDTH],
            eq_id: Vec::new(),
            eq: Vec::new(),
            ineq_id: Vec::new(),
            ineq: Vec::new(),
        }
    }
}

impl Rows {
    pub(super) fn evaluate<T: Task>(&mut self, task: &T, x: &Row) {
        self.objective = 0.0;
        self.gradient = [0.0; WIDTH];
        self.eq_id.clear();
        self.eq.clear();
        self.ineq_id.clear();
        self.ineq.clear();
        task.rows(x, self);
    }

    /// Largest violation; NaN if a row has no value.
    pub(super) fn worst(&self) -> f64 {
        let mut worst = 0.0_f64;
        for v in self.eq.iter().map(|r| r.c.abs()).chain(self.ineq.iter().map(|r| -r.c)) {
            if v.is_nan() {
                return f64::NAN;
            }
            worst = worst.max(v);
        }
        worst
    }

    pub(super) fn total(&self) -> f64 {
        // Written so that NaN counts as violated.
        let short = |c: f64| if c >= 0.0 { 0.0 } else { -c };
        self.eq.iter().map(|r| r.c.abs()).sum::<f64>() + self.ineq.iter().map(|r| short(r.c)).sum::<f64>()
    }
}

#[inline]
fn constraint(value: f64, gradient: impl FnOnce(&mut Gradient<'_>)) -> Constraint {
    let mut a = [0.0; WIDTH];
    gradient(&mut Gradient { row: &mut a, factor: 1.0 });
    Constraint { a, c: value }
}

impl Sink for Rows {
    #[inline]
    fn wants(&self, _: usize) -> bool {
        true
    }
    #[inline]
    fn wants_eq(&self, _: usize) -> bool {
        true
    }
    #[inline]
    fn objective(&mut self, value: f64, gradient: impl FnOnce(&mut Gradient<'_>)) {
        self.objective += value;
        gradient(&mut Gradient { row: &mut self.gradient, factor: 1.0 });
    }
    #[inline]
    fn eq(&mut self, id: usize, value: f64, gradient: impl FnOnce(&mut Gradient<'_>)) {
        self.eq_id.push(id);
        self.eq.push(constraint(value, gradient));
    }
    #[inline]
    fn ineq(&mut self, id: usize, value: f64, gradient: impl FnOnce(&mut Gradient<'_>)) {
        self.ineq_id.push(id);
        self.ineq.push(constraint(value, gradient));
    }
}

//! Linear matrix inequalities as data, and their solution by an interior-point method.
//!
//! maximise c'x subject to F_b(x) = F_b0 + sum_i x_i F_bi >= 0 (positive semidefinite) for each block b.

use super::interior;
use nalgebra::{DMatrix, DVector};

/// One block F0 + sum x_i F_i >= 0, all matrices symmetric n x n.
#[derive(Clone, Debug)]
pub(super) struct Block {
    /// F0.
    pub(super) constant: DMatrix<f64>,
    /// Column i is F_i, column by column.
    pub(super) slopes: DMatrix<f64>,
}

/// A semidefinite program over a vector of scalar variables.
#[derive(Clone, Debug)]
pub(super) struct Lmi {
    /// c: what is maximised.
    pub(super) objective: DVector<f64>,
    /// The constraints.
    pub(super) blocks: Vec<Block>,
}

/// Why a program has no trustworthy solution.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SolveError {
    /// Proven: no x satisfies the blocks.
    #[error("the inequalities have no solution (proven by the solver)")]
    Infeasible,
    /// Proven by the dual: the objective stays below the requested value.
    #[error("the objective stays below the value asked for (bounded by the dual)")]
    TooLow,
    /// The solver stopped in another state; its numbers are not used.
    #[error(
        "the solver stopped after {steps} steps with a gap of {gap:.1e} and residuals of {primal:.1e} and {dual:.1e}; \
         only a fully solved program is accepted"
    )]
    NotSolved {
        steps: usize,
        /// Between the objective and its bound, relative above one.
        gap: f64,
        /// Of the inequalities, for data scaled to one.
        primal: f64,
        /// Of the multipliers, for data scaled to one.
        dual: f64,
    },
}

impl Lmi {
    /// A program over `variables` unknowns without constraints.
    pub(super) fn new(variables: usize) -> Self {
        Self { objective: DVector::zeros(variables), blocks: Vec::new() }
    }

    /// Adds the block whose value at x is `f(x)`; `f` must be affine and symmetric.
    ///
    /// The coefficient matrices are read off at the unit vectors, so that an inequality is written
    /// once, as the formula of the paper it comes from.
    pub(super) fn require(&mut self, f: impl Fn(&DVector<f64>) -> DMatrix<f64>) {
        let n = self.objective.len();
        let constant = f(&DVector::zeros(n));
        let mut slopes = DMatrix::zeros(constant.len(), n);
        for (i, mut slope) in slopes.column_iter_mut().enumerate() {
            let mut e = DVector::zeros(n);
            e[i] = 1.0;
            slope.copy_from_slice((f(&e) - &constant).as_slice());
        }
        self.blocks.push(Block { constant, slopes });
    }

    /// Solves the program; only the status `Solved` counts.
    ///
    /// Tolerance `tolerance` on gap and residuals (relative). A result relies on the certificate check, not on this
    /// number.
    pub(super) fn solve(&self, tolerance: f64) -> Result<DVector<f64>, SolveError> {
        self.solve_above(f64::NEG_INFINITY, tolerance)
    }

    /// As [`Lmi::solve`], but gives up with [`SolveError::TooLow`] as soon as a dual feasible point shows that
    /// the objective cannot reach `floor`.
    pub(super) fn solve_above(&self, floor: f64, tolerance: f64) -> Result<DVector<f64>, SolveError> {
        interior::solve(self, floor, tolerance).map(|(x, _)| x)
    }
}

fn triangle(n: usize) -> usize {
    n * (n + 1) / 2
}

/// Number of unknowns of a symmetric n x n matrix variable.
pub(super) fn symmetric_unknowns(n: usize) -> usize {
    triangle(n)
}

/// The symmetric n x n matrix stored from unknown `first` on (upper triangle by columns).
pub(super) fn symmetric_at(x: &DVector<f64>, first: usize, n: usize) -> DMatrix<f64> {
    DMatrix::from_fn(n, n, |i, j| {
        let (r, c) = (i.min(j), i.max(j));
        x[first + triangle(c) + r]
    })
}

/// [[a, b], [b', d]].
pub(super) fn bordered(a: &DMatrix<f64>, b: &DMatrix<f64>, d: &DMatrix<f64>) -> DMatrix<f64> {
    let (n, m) = (a.nrows(), d.nrows());
    let mut out = DMatrix::zeros(n + m, n + m);
    out.view_mut((0, 0), (n, n)).copy_from(a);
    out.view_mut((0, n), (n, m)).copy_from(b);
    out.view_mut((n, 0), (m, n)).copy_from(&b.transpose());
    out.view_mut((n, n), (m, m)).copy_from(d);
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// maximise x subject to [[1, x], [x, 4]] >= 0: x = 2.
    fn determinant() -> Lmi {
        let mut lmi = Lmi::new(1);
        lmi.objective[0] = 1.0;
        lmi.require(|x| DMatrix::from_row_slice(2, 2, &[1.0, x[0], x[0], 4.0]));
        lmi
    }

    #[test]
    fn closed_form_of_a_determinant_is_found() {
        assert!((determinant().solve(1e-9).unwrap()[0] - 2.0).abs() < 1e-6);
    }

    #[test]
    fn contradiction_is_reported_as_infeasible() {
        let mut lmi = determinant();
        lmi.require(|x| DMatrix::from_element(1, 1, x[0] - 3.0));
        assert_eq!(lmi.solve(1e-9), Err(SolveError::Infeasible));
    }

    #[test]
    fn unbounded_program_is_not_taken_for_solved() {
        let mut lmi = Lmi::new(1);
        lmi.objective[0] = 1.0;
        lmi.require(|x| DMatrix::from_element(1, 1, x[0]));
        assert!(matches!(lmi.solve(1e-9), Err(SolveError::NotSolved { .. })));
    }
}

//! Linear matrix inequalities as data, and their solution by an interior-point method.
//!
//! maximise c'x subject to F_b(x) = F_b0 + sum_i x_i F_bi >= 0 (positive semidefinite) for each block b.

use clarabel::algebra::CscMatrix;
use clarabel::solver::{
    DefaultInfo, DefaultSettingsBuilder, DefaultSolver, IPSolver, SolverStatus, SupportedConeT,
};
use nalgebra::{DMatrix, DVector};

/// One block F0 + sum x_i F_i >= 0, all matrices symmetric n x n.
#[derive(Clone, Debug)]
pub struct Block {
    /// F0.
    pub constant: DMatrix<f64>,
    /// (i, F_i) for the variables that occur.
    pub terms: Vec<(usize, DMatrix<f64>)>,
}

impl Block {
    /// F(x).
    pub fn at(&self, x: &DVector<f64>) -> DMatrix<f64> {
        self.terms.iter().fold(self.constant.clone(), |sum, (i, f)| sum + f * x[*i])
    }
}

/// A semidefinite program over a vector of scalar variables.
#[derive(Clone, Debug)]
pub struct Lmi {
    /// c: what is maximised.
    pub objective: DVector<f64>,
    /// The constraints.
    pub blocks: Vec<Block>,
}

/// Relative dual residual below which a dual point counts as feasible. A point that is not quite rejects gains that
/// could be proven, never the other way round; a tenth of this took 5 % more steps and decided the same in all of 68
/// programs.
const DUAL_FEASIBLE: f64 = 1e-4;
/// Residual to which each linear system of the solver is refined, share of the tolerance of the program: its own
/// 1e-13 costs up to ten more substitutions a step for digits that no result keeps.
const REFINED: f64 = 0.1;

/// Why a program has no trustworthy solution.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SolveError {
    /// Proven: no x satisfies the blocks.
    #[error("the inequalities have no solution (proven by the solver)")]
    Infeasible,
    /// Proven by the dual: the objective stays below what was asked for.
    #[error("the objective stays below the value asked for (bounded by the dual)")]
    TooLow,
    /// The solver stopped in another state; its numbers are not used.
    #[error("the conic solver ended with {0}; only a fully solved program is accepted")]
    NotSolved(String),
}

impl Lmi {
    /// A program over `variables` unknowns without constraints.
    pub fn new(variables: usize) -> Self {
        Self { objective: DVector::zeros(variables), blocks: Vec::new() }
    }

    /// Adds the block whose value at x is `f(x)`; `f` must be affine and symmetric.
    ///
    /// The coefficient matrices are read off at the unit vectors, so that an inequality is written
    /// once, as the formula of the paper it comes from.
    pub fn require(&mut self, f: impl Fn(&DVector<f64>) -> DMatrix<f64>) {
        let n = self.objective.len();
        let constant = f(&DVector::zeros(n));
        let terms = (0..n)
            .filter_map(|i| {
                let mut e = DVector::zeros(n);
                e[i] = 1.0;
                let slope = f(&e) - &constant;
                (slope.amax() > 0.0).then_some((i, slope))
            })
            .collect();
        self.blocks.push(Block { constant, terms });
    }

    /// Solves the program; only the status `Solved` counts.
    ///
    /// Tolerance `tolerance` on gap and residuals (relative). The certificate check, not this
    /// number, is what a result rests on.
    ///
    /// # Errors
    /// [`SolveError`].
    pub fn solve(&self, tolerance: f64) -> Result<DVector<f64>, SolveError> {
        self.solve_above(f64::NEG_INFINITY, tolerance)
    }

    /// As [`Lmi::solve`], but gives up with [`SolveError::TooLow`] as soon as a dual feasible point shows that
    /// the objective cannot reach `floor`.
    ///
    /// # Errors
    /// [`SolveError`].
    pub fn solve_above(&self, floor: f64, tolerance: f64) -> Result<DVector<f64>, SolveError> {
        lapack_shim::link();
        let n = self.objective.len();
        let rows: usize = self.blocks.iter().map(|b| triangle(b.constant.nrows())).sum();
        // Clarabel: minimise q'x, A x + s = b, s in the cone; here s = svec(F(x)).
        let mut columns: Vec<Vec<(usize, f64)>> = vec![Vec::new(); n];
        let mut rhs = Vec::with_capacity(rows);
        let mut cones = Vec::with_capacity(self.blocks.len());
        for block in &self.blocks {
            let first = rhs.len();
            rhs.extend(svec(&block.constant));
            for (i, f) in &block.terms {
                let entries = svec(f).into_iter().enumerate().filter(|(_, v)| *v != 0.0);
                columns[*i].extend(entries.map(|(k, v)| (first + k, -v)));
            }
            cones.push(SupportedConeT::PSDTriangleConeT(block.constant.nrows()));
        }
        let mut colptr = vec![0];
        let (mut rowval, mut nzval) = (Vec::new(), Vec::new());
        for column in columns {
            for (row, value) in column {
                rowval.push(row);
                nzval.push(value);
            }
            colptr.push(rowval.len());
        }
        let a = CscMatrix::new(rows, n, colptr, rowval, nzval);
        let q: Vec<f64> = self.objective.iter().map(|c| -c).collect();
        let settings = DefaultSettingsBuilder::default()
            .verbose(false)
            .max_threads(1)
            .chordal_decomposition_enable(false)
            .tol_gap_abs(tolerance)
            .tol_gap_rel(tolerance)
            .tol_feas(tolerance)
            .max_iter(100)
            .presolve_enable(false)
            .iterative_refinement_reltol(REFINED * tolerance)
            .iterative_refinement_abstol(REFINED * tolerance)
            .build()
            .map_err(|e| SolveError::NotSolved(format!("settings: {e}")))?;
        let mut solver = DefaultSolver::new(&CscMatrix::zeros((n, n)), &q, &a, &rhs, &cones, settings)
            .map_err(|e| SolveError::NotSolved(format!("set-up: {e}")))?;
        // Minimised is the negative objective, so the dual cost bounds the objective from above.
        solver.set_termination_callback(move |info: &DefaultInfo<f64>| {
            info.res_dual < DUAL_FEASIBLE && -info.cost_dual < floor
        });
        solver.solve();
        match solver.solution.status {
            SolverStatus::CallbackTerminated => Err(SolveError::TooLow),
            SolverStatus::Solved => Ok(DVector::from_column_slice(&solver.solution.x)),
            SolverStatus::PrimalInfeasible => Err(SolveError::Infeasible),
            other => Err(SolveError::NotSolved(format!("{other:?}"))),
        }
    }
}

fn triangle(n: usize) -> usize {
    n * (n + 1) / 2
}

/// Upper triangle by columns, off-diagonal entries times sqrt 2: keeps inner products.
fn svec(m: &DMatrix<f64>) -> Vec<f64> {
    let mut v = Vec::with_capacity(triangle(m.nrows()));
    for j in 0..m.ncols() {
        for i in 0..=j {
            // Averaging removes the rounding asymmetry of a product.
            let x = 0.5 * (m[(i, j)] + m[(j, i)]);
            v.push(if i == j { x } else { x * std::f64::consts::SQRT_2 });
        }
    }
    v
}

/// Number of unknowns of a symmetric n x n matrix variable.
pub fn symmetric_unknowns(n: usize) -> usize {
    triangle(n)
}

/// The symmetric n x n matrix stored from unknown `first` on (upper triangle by columns).
pub fn symmetric_at(x: &DVector<f64>, first: usize, n: usize) -> DMatrix<f64> {
    DMatrix::from_fn(n, n, |i, j| {
        let (r, c) = (i.min(j), i.max(j));
        x[first + triangle(c) + r]
    })
}

/// [[a, b], [b', d]].
pub fn bordered(a: &DMatrix<f64>, b: &DMatrix<f64>, d: &DMatrix<f64>) -> DMatrix<f64> {
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
        assert!(matches!(lmi.solve(1e-9), Err(SolveError::NotSolved(_))));
    }
}

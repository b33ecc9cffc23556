//! Primal-dual interior-point method for small dense semidefinite programs.
//!
//! Path following from an infeasible start with Nesterov-Todd directions and Mehrotra's corrector (M. J. Todd, K. C. Toh,
//! R. H. Tutuncu, "On the Nesterov-Todd direction in semidefinite programming", SIAM J. Optim. 8, 1998). Each block has a
//! slack S = F(x) >= 0 and a multiplier Z >= 0. Multipliers with <F_i, Z> = -c_i, summed over the blocks, prove
//! c'x <= <F0, Z> for each feasible x; those with <F_i, Z> = 0 and <F0, Z> < 0 prove that there is none.

use super::lmi::{Lmi, SolveError};
use nalgebra::{Cholesky, DMatrix, DMatrixView, DVector, Dyn, SymmetricEigen};

/// Most programs need 8 to 20 steps; more means that no more digits are to be had.
const STEPS_MAX: usize = 60;
/// Residual of <F_i, Z> = -c_i, in units of the largest c_i, below which the multipliers count as a bound.
/// Multipliers that are not exactly a bound can reject gains that could be proven, never the other way round.
const DUAL_FEASIBLE: f64 = 1e-4;
/// Largest <F_i, Z> over -<F0, Z>, in scaled units, with which the multipliers count as a contradiction.
const CONTRADICTION: f64 = 1e-8;
/// Slacks and multipliers at the start, in scaled units.
const START: f64 = 10.0;
/// Share of the way to the boundary that a step takes: at least, and what is added for a whole step.
const STEP_SHARE: (f64, f64) = (0.9, 0.09);
/// Share of the tolerance that the gap of the centred point keeps. Closer to the boundary the rounding of a step
/// grows, and the multipliers lose more than the gap gains.
const CENTRED: f64 = 0.1;
/// Way to the boundary that is far enough for a whole step.
const FAR: f64 = 2.0;
/// Added to the matrix of a step, relative and absolute: unknowns that depend on each other would make it singular.
const REGULAR: f64 = 1e-14;
/// Repetitions of the solution of a step with its residual, which undo that addition and most of the rounding.
const REFINEMENTS: usize = 2;
/// Sweeps after which the eigenvalue iteration of a block gives up.
const SWEEPS: usize = 1000;

/// A program in units in which the largest slope of each unknown and of each block, the largest constant and the
/// largest entry of the objective are about one. The blocks are below each other, each column by column.
struct Scaled {
    /// Rows of each block.
    sizes: Vec<usize>,
    constant: DVector<f64>,
    /// One column per unknown.
    slopes: DMatrix<f64>,
    objective: DVector<f64>,
    /// Units of the unknowns, of the multipliers of each block, and of the objective.
    unknowns: DVector<f64>,
    multipliers: Vec<f64>,
    unit: f64,
}

/// `x`, or one if it cannot be divided by.
fn divisor(x: f64) -> f64 {
    if x > 0.0 { x } else { 1.0 }
}

impl Scaled {
    fn new(lmi: &Lmi) -> Self {
        let (blocks, n) = (&lmi.blocks, lmi.objective.len());
        let largest = |i| blocks.iter().map(|b| b.slopes.column(i).norm()).fold(0.0, f64::max);
        let mut unknowns = DVector::from_fn(n, |i, _| 1.0 / divisor(largest(i)));
        let mut slopes: Vec<DMatrix<f64>> =
            blocks.iter().map(|b| &b.slopes * DMatrix::from_diagonal(&unknowns)).collect();
        let mut constants: Vec<DMatrix<f64>> = blocks.iter().map(|b| b.constant.clone()).collect();
        let mut multipliers = Vec::new();
        for (slopes, constant) in slopes.iter_mut().zip(&mut constants) {
            let share = 1.0 / divisor(slopes.column_iter().map(|f| f.norm()).fold(0.0, f64::max));
            *slopes *= share;
            *constant *= share;
            multipliers.push(share);
        }
        let objective = lmi.objective.component_mul(&unknowns);
        let steepest = divisor(objective.amax());
        let size = divisor(constants.iter().map(DMatrix::norm).fold(0.0, f64::max));
        unknowns *= size;
        multipliers.iter_mut().for_each(|unit| *unit *= steepest);
        let mut all = DMatrix::zeros(slopes.iter().map(DMatrix::nrows).sum(), n);
        let mut first = 0;
        for slopes in slopes {
            all.rows_mut(first, slopes.nrows()).copy_from(&slopes);
            first += slopes.nrows();
        }
        Self {
            sizes: constants.iter().map(DMatrix::nrows).collect(),
            constant: stacked(constants.into_iter()) / size,
            slopes: all,
            objective: objective / steepest,
            unknowns,
            multipliers,
            unit: steepest * size,
        }
    }

    /// The blocks of `v` as matrices.
    fn blocks<'a>(&'a self, v: &'a DVector<f64>) -> impl Iterator<Item = DMatrixView<'a, f64>> {
        self.sizes.iter().scan(0, |first, &n| {
            let from = *first;
            *first += n * n;
            Some(DMatrixView::from_slice(&v.as_slice()[from..*first], n, n))
        })
    }

    fn start(&self) -> Point {
        let identity = stacked(self.sizes.iter().map(|&n| DMatrix::identity(n, n)));
        Point { x: DVector::zeros(self.objective.len()), s: &identity * START, z: identity * START }
    }
}

/// The inverse of [`Scaled::blocks`].
fn stacked(blocks: impl Iterator<Item = DMatrix<f64>>) -> DVector<f64> {
    DVector::from_vec(blocks.flat_map(|m| Vec::from(m.data)).collect())
}

/// Eigenvalues and vectors of a symmetric matrix; `None` if it holds lost numbers or the iteration gives up.
fn eigen(m: DMatrix<f64>) -> Option<SymmetricEigen<f64, Dyn>> {
    if m.iter().any(|x| !x.is_finite()) {
        return None;
    }
    SymmetricEigen::try_new(m, f64::EPSILON, SWEEPS)
}

/// A point on the way, or a change of it: unknowns, slacks and multipliers.
struct Point {
    x: DVector<f64>,
    s: DVector<f64>,
    z: DVector<f64>,
}

/// Coordinates of a block halfway between its S and Z: T S T' = T^-T Z T^-1 = diag(d).
struct Halfway {
    t: DMatrix<f64>,
    d: DVector<f64>,
}

impl Halfway {
    /// `None` if S or Z is not positive definite.
    fn new(s: DMatrixView<'_, f64>, z: DMatrixView<'_, f64>) -> Option<Self> {
        let l = s.into_owned().cholesky()?.unpack();
        let product = eigen(l.tr_mul(&(z * &l)))?;
        if product.eigenvalues.min() <= 0.0 {
            return None;
        }
        let d = product.eigenvalues.map(f64::sqrt);
        let mut t = l.tr_solve_lower_triangular(&product.eigenvectors)?.transpose();
        for (mut row, d) in t.row_iter_mut().zip(&d) {
            row *= d.sqrt();
        }
        Some(Self { t, d })
    }

    /// Largest step, up to [`FAR`], after which diag(d) + step `change` is not indefinite.
    fn boundary(&self, change: DMatrixView<'_, f64>) -> Option<f64> {
        let n = self.d.len();
        let relative = DMatrix::from_fn(n, n, |i, j| change[(i, j)] / (self.d[i] * self.d[j]).sqrt());
        Some(-1.0 / eigen(relative)?.eigenvalues.min().min(-1.0 / FAR))
    }

    /// dS + dZ with which the symmetric part of (S + dS) (Z + dZ) becomes `aim` I, if `product` is what dS dZ will be.
    fn sum(&self, aim: f64, product: &DMatrix<f64>) -> DMatrix<f64> {
        let d = &self.d;
        DMatrix::from_fn(d.len(), d.len(), |i, j| {
            let missing = if i == j { aim - d[i] * d[i] } else { 0.0 };
            (2.0 * missing - product[(i, j)] - product[(j, i)]) / (d[i] + d[j])
        })
    }
}

/// What a point leaves of the equations.
struct Residuals {
    /// F(x) - S.
    primal: DVector<f64>,
    /// -c_i - <F_i, Z>.
    dual: DVector<f64>,
}

/// The linear equations of a step, in the coordinates halfway between S and Z:
/// dS = sum dx_i F_i + (F(x) - S), <F_i, dZ> = -c_i - <F_i, Z>, and dS + dZ is given.
struct Newton<'a> {
    program: &'a Scaled,
    halfway: Vec<Halfway>,
    slopes: DMatrix<f64>,
    primal: DVector<f64>,
    residuals: &'a Residuals,
    matrix: Cholesky<f64, Dyn>,
}

impl<'a> Newton<'a> {
    /// `None` if rounding makes further steps impossible.
    fn new(program: &'a Scaled, at: &Point, residuals: &'a Residuals) -> Option<Self> {
        let pairs = program.blocks(&at.s).zip(program.blocks(&at.z));
        let halfway = pairs.map(|(s, z)| Halfway::new(s, z)).collect::<Option<Vec<_>>>()?;
        let mut slopes = DMatrix::zeros(program.slopes.nrows(), program.slopes.ncols());
        let mut primal = DVector::zeros(slopes.nrows());
        let mut first = 0;
        for Halfway { t, .. } in &halfway {
            // T F T' of many F at once: their columns times the Kronecker product.
            let twice = t.kronecker(t);
            let rows = twice.nrows();
            slopes.rows_mut(first, rows).gemm(1.0, &twice, &program.slopes.rows(first, rows), 0.0);
            primal.rows_mut(first, rows).gemv(1.0, &twice, &residuals.primal.rows(first, rows), 0.0);
            first += rows;
        }
        let mut matrix = slopes.transpose() * &slopes;
        for i in 0..matrix.nrows() {
            matrix[(i, i)] += REGULAR * (1.0 + matrix[(i, i)]);
        }
        Some(Self { program, halfway, slopes, primal, residuals, matrix: matrix.cholesky()? })
    }

    fn solve(&self, sum: &DVector<f64>) -> Point {
        let x = DVector::zeros(self.slopes.ncols());
        let mut change = Point { x, s: self.primal.clone(), z: sum - &self.primal };
        for _ in 0..=REFINEMENTS {
            change.x += self.matrix.solve(&(self.slopes.tr_mul(&change.z) - &self.residuals.dual));
            change.s = &self.primal + &self.slopes * &change.x;
            change.z = sum - &change.s;
        }
        change
    }

    /// How far S and Z can go along `change`.
    fn boundaries(&self, change: &Point) -> Option<(f64, f64)> {
        let nearest = |change| {
            let mut all = self.halfway.iter().zip(self.program.blocks(change));
            all.try_fold(FAR, |nearest, (at, change)| Some(at.boundary(change)?.min(nearest)))
        };
        Some((nearest(&change.s)?, nearest(&change.z)?))
    }

    /// The change of the point, as long as it may be. It aims at no smaller S Z than `least`.
    fn step(&self, least: f64) -> Option<Point> {
        // Predictor: straight to S Z = 0. Its result shows how far the corrector may aim.
        let d = stacked(self.halfway.iter().map(|at| DMatrix::from_diagonal(&at.d)));
        let ahead = self.solve(&-&d);
        let (primal, dual) = self.boundaries(&ahead)?;
        let product = (&d + &ahead.s * primal.min(1.0)).dot(&(&d + &ahead.z * dual.min(1.0)));
        let rows: usize = self.program.sizes.iter().sum();
        let aim = d.norm_squared() / rows as f64 * (product / d.norm_squared()).clamp(0.0, 1.0).powi(3);
        let aim = aim.max(least);
        let blocks = self.program.blocks(&ahead.s).zip(self.program.blocks(&ahead.z));
        let sum = stacked(self.halfway.iter().zip(blocks).map(|(at, (s, z))| at.sum(aim, &(s * z))));
        let mut change = self.solve(&sum);
        let (primal, dual) = self.boundaries(&change)?;
        let length = |to: f64| (to * (STEP_SHARE.0 + STEP_SHARE.1 * to.min(1.0))).min(1.0);
        // Back to the coordinates of the program. Rounding must not leave Z asymmetric.
        let z = self.halfway.iter().zip(self.program.blocks(&change.z)).map(|(at, z)| {
            let z = at.t.tr_mul(&(z * &at.t));
            (&z + z.transpose()) * (0.5 * length(dual))
        });
        change.z = stacked(z);
        change.s = (&self.residuals.primal + &self.program.slopes * &change.x) * length(primal);
        change.x *= length(primal);
        Some(change)
    }
}

/// Where the objective is largest, and the multiplier of each block, which proves it.
pub(super) type Solution = (DVector<f64>, Vec<DMatrix<f64>>);

/// Maximises the objective of `lmi`; see [`Lmi::solve_above`].
pub(super) fn solve(lmi: &Lmi, floor: f64, tolerance: f64) -> Result<Solution, SolveError> {
    let program = Scaled::new(lmi);
    let mut at = program.start();
    let mut steps = 0;
    loop {
        let slope = program.slopes.tr_mul(&at.z);
        let height = program.constant.dot(&at.z);
        let residuals = Residuals {
            primal: &program.constant + &program.slopes * &at.x - &at.s,
            dual: -&program.objective - &slope,
        };
        let (value, bound) = (program.unit * program.objective.dot(&at.x), program.unit * height);
        let size = value.abs().min(bound.abs()).max(1.0);
        // bound - value is the sum of these three, which must not cancel each other: the residuals are errors of both.
        let apart = at.s.dot(&at.z) + residuals.primal.dot(&at.z).abs() + residuals.dual.dot(&at.x).abs();
        let gap = program.unit * apart / size;
        let (primal, dual) = (residuals.primal.amax(), residuals.dual.amax());
        if gap < tolerance && primal < tolerance && dual < tolerance {
            let multipliers = program.blocks(&at.z).zip(&program.multipliers).map(|(z, unit)| z * *unit);
            return Ok((at.x.component_mul(&program.unknowns), multipliers.collect()));
        }
        if dual < DUAL_FEASIBLE && bound < floor {
            return Err(SolveError::TooLow);
        }
        if slope.amax() < -CONTRADICTION * height {
            return Err(SolveError::Infeasible);
        }
        let rows: usize = program.sizes.iter().sum();
        let least = CENTRED * tolerance * size / (program.unit * rows as f64);
        let step = Newton::new(&program, &at, &residuals).and_then(|newton| newton.step(least));
        let Some(step) = step.filter(|_| steps < STEPS_MAX) else {
            return Err(SolveError::NotSolved { steps, gap, primal, dual });
        };
        at.x += step.x;
        at.s += step.s;
        at.z += step.z;
        steps += 1;
    }
}

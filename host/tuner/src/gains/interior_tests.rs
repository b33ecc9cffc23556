//! The solver on programs whose optimum, or whose contradiction, is known from how they are built.

use super::interior::{Solution, solve};
use super::lmi::{Block, Lmi, SolveError};
use nalgebra::{DMatrix, DVector};
use proptest::prelude::*;

const TOLERANCE: f64 = 1e-8;

/// Numbers in -1..1.
struct Random(u64);

impl Random {
    fn number(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    fn symmetric(&mut self, n: usize) -> DMatrix<f64> {
        let m = DMatrix::from_fn(n, n, |_, _| self.number());
        (&m + m.transpose()) * 0.5
    }

    fn rotation(&mut self, n: usize) -> DMatrix<f64> {
        DMatrix::from_fn(n, n, |_, _| self.number()).qr().q()
    }
}

/// A program with its solution.
struct Known {
    lmi: Lmi,
    optimum: f64,
}

/// A block of `rows` rows, of which `active` are zero in the slack at the optimum and positive in the multiplier.
#[derive(Clone, Copy, Debug)]
struct Shape {
    rows: usize,
    active: usize,
}

/// A program with a known optimum: slack S and multiplier Z are drawn with S Z = 0, S + Z > 0, then constants and
/// objective are chosen so that both are feasible, which proves both optimal. If the number of unknowns is between
/// the freedom of Z and that of S, both are the only ones (for almost all slopes), so that the interior is not
/// empty on either side. `units` are powers of ten: the largest random one of each block and unknown, and that of the
/// objective.
fn known(seed: u64, shapes: &[Shape], extra: f64, units: (f64, f64)) -> Known {
    let mut random = Random(seed | 1);
    let least: usize = shapes.iter().map(|s| s.active * (s.active + 1) / 2).sum();
    let spare: usize = shapes.iter().map(|s| s.active * (s.rows - s.active)).sum();
    let n = (least + (extra * spare as f64) as usize).max(1);
    let x = DVector::from_fn(n, |_, _| random.number());
    let unknown_units = DVector::from_fn(n, |_, _| 10f64.powf(units.0 * random.number()));
    let mut lmi = Lmi::new(n);
    let mut optimum = 0.0;
    for shape in shapes {
        let q = random.rotation(shape.rows);
        let mut spectrum = |from: usize, to: usize| {
            let d = DVector::from_fn(shape.rows, |i, _| {
                if (from..to).contains(&i) { 1.1 + random.number() } else { 0.0 }
            });
            &q * DMatrix::from_diagonal(&d) * q.transpose()
        };
        let (slack, multiplier) = (spectrum(shape.active, shape.rows), spectrum(0, shape.active));
        let block_unit = 10f64.powf(units.0 * random.number());
        let mut slopes = DMatrix::zeros(shape.rows * shape.rows, n);
        for mut slope in slopes.column_iter_mut() {
            slope.copy_from_slice(random.symmetric(shape.rows).as_slice());
        }
        let linear = DMatrix::from_column_slice(shape.rows, shape.rows, (&slopes * &x).as_slice());
        let constant = slack - linear;
        lmi.objective -= slopes.tr_mul(&DVector::from_column_slice(multiplier.as_slice()));
        optimum += constant.dot(&multiplier);
        let slopes = &slopes * DMatrix::from_diagonal(&unknown_units) * block_unit;
        lmi.blocks.push(Block { constant: constant * block_unit, slopes });
    }
    lmi.objective.component_mul_assign(&unknown_units);
    lmi.objective *= units.1;
    Known { lmi, optimum: optimum * units.1 }
}

/// Smallest eigenvalue of any matrix.
fn lowest(matrices: impl Iterator<Item = DMatrix<f64>>) -> f64 {
    matrices.map(|m| m.symmetric_eigenvalues().min()).fold(f64::INFINITY, f64::min)
}

/// What the multipliers leave of <F_i, Z> = -c_i, relative to the terms of the sum above one.
fn dual_residual(lmi: &Lmi, multipliers: &[DMatrix<f64>]) -> f64 {
    let sum = |i: usize, f: fn(f64) -> f64| -> f64 {
        let of = |(b, z): (&Block, &DMatrix<f64>)| -> f64 {
            b.slopes.column(i).iter().zip(z).map(|(f_i, z)| f(f_i * z)).sum()
        };
        lmi.blocks.iter().zip(multipliers).map(of).sum()
    };
    let n = lmi.objective.len();
    (0..n).map(|i| (sum(i, |p| p) + lmi.objective[i]).abs() / sum(i, f64::abs).max(1.0)).fold(0.0, f64::max)
}

/// F(x).
fn at(block: &Block, x: &DVector<f64>) -> DMatrix<f64> {
    let n = block.constant.nrows();
    &block.constant + DMatrix::from_column_slice(n, n, (&block.slopes * x).as_slice())
}

/// How far the objective can still be below its optimum, proven by the multipliers alone.
pub(super) fn proven_gap(lmi: &Lmi, (x, multipliers): &Solution) -> f64 {
    assert!(lowest(lmi.blocks.iter().map(|b| at(b, x))) > -TOLERANCE, "not feasible");
    assert!(lowest(multipliers.iter().cloned()) > -1e-12, "the multipliers prove nothing");
    let residual = dual_residual(lmi, multipliers);
    assert!(residual < 1e-8, "the multipliers prove nothing: {residual:e}");
    let bound: f64 = lmi.blocks.iter().zip(multipliers).map(|(b, z)| b.constant.dot(z)).sum();
    bound - lmi.objective.dot(x)
}

fn shapes() -> impl Strategy<Value = Vec<Shape>> {
    let shape = (1usize..8, 0.0f64..1.0)
        .prop_map(|(rows, share)| Shape { rows, active: (share * (rows + 1) as f64) as usize });
    prop::collection::vec(shape, 1..6)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn constructed_optimum_is_found(seed: u64, shapes in shapes(), extra in 0.2f64..0.8) {
        let Known { lmi, optimum } = known(seed, &shapes, extra, (0.0, 1.0));
        let found = solve(&lmi, f64::NEG_INFINITY, TOLERANCE).map_err(|e| TestCaseError::fail(e.to_string()))?;
        let error = (lmi.objective.dot(&found.0) - optimum).abs();
        prop_assert!(error < 2.0 * TOLERANCE * optimum.abs().max(1.0), "{error:e} {optimum}");
        let gap = proven_gap(&lmi, &found);
        prop_assert!(gap.abs() < 2.0 * TOLERANCE * optimum.abs().max(1.0), "{gap:e}");
    }

    #[test]
    fn units_over_six_decades_change_no_optimum(
        seed: u64, shapes in shapes(), extra in 0.2f64..0.8, unit in 0.0f64..6.0,
    ) {
        let unit = 10f64.powf(unit);
        let Known { lmi, optimum } = known(seed, &shapes, extra, (3.0, unit));
        // The difference of large terms has fewer digits than the terms.
        prop_assume!(optimum.abs() > 0.1 * unit);
        let found = lmi.solve(TOLERANCE).map_err(|e| TestCaseError::fail(e.to_string()))?;
        let error = (lmi.objective.dot(&found) - optimum).abs();
        prop_assert!(error < 2.0 * TOLERANCE * optimum.abs().max(1.0), "{error:e} {optimum}");
    }

    #[test]
    fn floor_above_the_optimum_is_called_too_low_and_one_below_is_not(
        seed: u64, shapes in shapes(), extra in 0.2f64..0.8, away in 0.001f64..10.0,
    ) {
        let Known { lmi, optimum } = known(seed, &shapes, extra, (0.0, 1.0));
        let away = away * optimum.abs().max(1.0);
        prop_assert_eq!(lmi.solve_above(optimum + away, TOLERANCE), Err(SolveError::TooLow));
        let found = lmi.solve_above(optimum - away, TOLERANCE);
        prop_assert!(found.is_ok(), "{found:?}");
    }

    /// A positive definite Z with <F_i, Z> = 0 and <F0, Z> < 0 contradicts <F(x), Z> >= 0.
    #[test]
    fn constructed_contradiction_is_reported_as_infeasible(
        seed: u64, shapes in shapes(), share in 0.0f64..0.8, depth in 0.01f64..1.0,
    ) {
        let freedom: usize = shapes.iter().map(|s| s.rows * (s.rows + 1) / 2).sum();
        prop_assume!(freedom > 2);
        let unknowns = 1 + (share * (freedom - 2) as f64) as usize;
        let mut random = Random(seed | 1);
        let mut lmi = Lmi::new(unknowns);
        lmi.objective = DVector::from_fn(unknowns, |_, _| random.number());
        let mut multipliers = Vec::new();
        for shape in &shapes {
            let q = random.rotation(shape.rows);
            let d = DVector::from_fn(shape.rows, |_, _| 1.1 + random.number());
            multipliers.push(&q * DMatrix::from_diagonal(&d) * q.transpose());
            let slopes = (0..unknowns).map(|_| random.symmetric(shape.rows)).collect::<Vec<_>>();
            let columns: Vec<_> = slopes.iter().map(|m| DVector::from_column_slice(m.as_slice())).collect();
            let constant = random.symmetric(shape.rows);
            lmi.blocks.push(Block { constant, slopes: DMatrix::from_columns(&columns) });
        }
        let square: f64 = multipliers.iter().map(DMatrix::norm_squared).sum();
        let along = |of: &dyn Fn(&Block) -> DMatrix<f64>| -> f64 {
            lmi.blocks.iter().zip(&multipliers).map(|(b, z)| of(b).dot(z)).sum::<f64>() / square
        };
        let slope = |b: &Block, i: usize| {
            DMatrix::from_column_slice(b.constant.nrows(), b.constant.nrows(), b.slopes.column(i).as_slice())
        };
        let heights: Vec<f64> = (0..unknowns).map(|i| along(&|b: &Block| slope(b, i))).collect();
        let height = along(&|b: &Block| b.constant.clone()) + depth;
        for (block, z) in lmi.blocks.iter_mut().zip(&multipliers) {
            block.constant -= z * height;
            for (mut column, h) in block.slopes.column_iter_mut().zip(&heights) {
                column -= DVector::from_column_slice(z.as_slice()) * *h;
            }
        }
        prop_assert_eq!(lmi.solve(TOLERANCE), Err(SolveError::Infeasible));
    }
}

#[test]
fn lost_and_missing_numbers_end_without_a_solution() {
    let square = |x: f64| DMatrix::from_row_slice(2, 2, &[1.0, x, x, 4.0]);
    for lost in [f64::NAN, f64::INFINITY, f64::MAX] {
        let mut lmi = Lmi::new(1);
        lmi.objective[0] = lost;
        lmi.require(|x| square(x[0]));
        assert!(matches!(lmi.solve(TOLERANCE), Err(SolveError::NotSolved { .. })), "objective {lost}");
        let mut lmi = Lmi::new(1);
        lmi.objective[0] = 1.0;
        lmi.require(|x| square(x[0]) * lost);
        assert!(lmi.solve(TOLERANCE).is_err(), "block {lost}");
    }
    // An unknown that occurs nowhere is harmless, unless the objective rises with it.
    let mut lmi = Lmi::new(2);
    lmi.objective[0] = 1.0;
    lmi.require(|x| square(x[0]));
    assert!((lmi.solve(TOLERANCE).unwrap()[0] - 2.0).abs() < 1e-6);
    lmi.objective[1] = 1.0;
    assert!(matches!(lmi.solve(TOLERANCE), Err(SolveError::NotSolved { .. })));
}

/// The gap was still above the tolerance when the points were closer to the boundary than rounding allows.
#[test]
fn point_far_closer_to_the_boundary_than_the_tolerance_asks_is_not_aimed_at() {
    let shapes = [(5, 5), (7, 1), (2, 2), (6, 0), (5, 5)].map(|(rows, active)| Shape { rows, active });
    let Known { lmi, optimum } =
        known(9865337549504251686, &shapes, 0.777098953268489, (3.0, 10f64.powf(0.23389202234876577)));
    let found = lmi.solve(TOLERANCE).unwrap();
    assert!((lmi.objective.dot(&found) - optimum).abs() < 2.0 * TOLERANCE * optimum.abs().max(1.0));
}

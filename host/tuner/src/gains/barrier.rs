//! Second opinion for tests: maximises the objective of an [`Lmi`] by Newton's method on
//! c'x / mu + sum log det F_b(x), nothing shared with the conic solver.
//!
//! S. Boyd, L. Vandenberghe, "Convex Optimization", section 11.3.

use super::lmi::{Block, Lmi};
use nalgebra::{DMatrix, DVector};

/// Maximum of the last unknown (which must be the objective and make every block feasible when very
/// negative), to about 10^-`digits` times the number of rows.
pub(crate) fn maximise(lmi: &Lmi, digits: i32) -> Option<f64> {
    // Everything zero is inside for t far down: the margin t enters every block with -I.
    let x = lowered(lmi, DVector::zeros(lmi.objective.len()));
    path(lmi, x, digits)
}

/// As [`maximise`] for a program whose last unknown does not enter every block: a margin added to
/// all blocks is driven above zero first, from `start` on.
pub(crate) fn maximise_from(lmi: &Lmi, start: &DVector<f64>, digits: i32) -> Option<f64> {
    let n = lmi.objective.len();
    let mut first = Lmi { objective: DVector::zeros(n + 1), blocks: lmi.blocks.clone() };
    first.objective[n] = 1.0;
    for block in &mut first.blocks {
        let m = block.constant.nrows();
        block.terms.push((n, -DMatrix::identity(m, m)));
    }
    // Bounds keep phase I compact: the margin from above, the objective's unknown on both sides.
    for (i, sign, limit) in [(n, -1.0, 1.0), (n - 1, 1.0, 10.0), (n - 1, -1.0, 10.0)] {
        let constant = DMatrix::from_element(1, 1, limit);
        first.blocks.push(Block { constant, terms: vec![(i, DMatrix::from_element(1, 1, sign))] });
    }
    let mut x = DVector::zeros(n + 1);
    x.rows_mut(0, n).copy_from(start);
    let x = lowered(&first, x);
    let inside = follow(&first, x, 0)?;
    if inside[n] <= 0.0 {
        return None;
    }
    path(lmi, inside.rows(0, n).into_owned(), digits)
}

/// `x` with its last entry so low that every block is positive definite.
fn lowered(lmi: &Lmi, mut x: DVector<f64>) -> DVector<f64> {
    let worst =
        lmi.blocks.iter().map(|b| b.at(&x).symmetric_eigenvalues().min()).fold(f64::INFINITY, f64::min);
    let last = x.len() - 1;
    x[last] = worst.min(0.0) - 1.0;
    x
}

/// Value of the last unknown at the end of the central path.
fn path(lmi: &Lmi, x: DVector<f64>, digits: i32) -> Option<f64> {
    follow(lmi, x, digits).map(|x| x[x.len() - 1])
}

/// Follows the central path from a strictly feasible point.
fn follow(lmi: &Lmi, mut x: DVector<f64>, digits: i32) -> Option<DVector<f64>> {
    let rows: usize = lmi.blocks.iter().map(|b| b.constant.nrows()).sum();
    let mut mu = 1.0;
    while mu > 0.1 * 10f64.powi(-digits - 2) / rows as f64 {
        for _ in 0..200 {
            let (g, h) = derivatives(lmi, &x, mu)?;
            let step = h.clone().cholesky()?.solve(&g);
            let decrement = g.dot(&step);
            if decrement < 1e-9 {
                break;
            }
            let mut length = 1.0 / (1.0 + decrement.sqrt());
            while value(lmi, &(&x + &step * length), mu).is_none() {
                length *= 0.5;
            }
            x += step * length;
        }
        mu *= 0.3;
    }
    Some(x)
}

fn value(lmi: &Lmi, x: &DVector<f64>, mu: f64) -> Option<f64> {
    let mut sum = lmi.objective.dot(x) / mu;
    for block in &lmi.blocks {
        let l = block.at(x).cholesky()?;
        sum += 2.0 * l.l().diagonal().map(f64::ln).sum();
    }
    Some(sum)
}

/// Gradient and negative Hessian of the barrier function.
fn derivatives(lmi: &Lmi, x: &DVector<f64>, mu: f64) -> Option<(DVector<f64>, DMatrix<f64>)> {
    let n = x.len();
    let mut g = &lmi.objective / mu;
    let mut h = DMatrix::identity(n, n) * 1e-12;
    for block in &lmi.blocks {
        let inverse = block.at(x).cholesky()?.inverse();
        let scaled: Vec<(usize, DMatrix<f64>)> =
            block.terms.iter().map(|(i, f)| (*i, &inverse * f)).collect();
        for (i, fi) in &scaled {
            g[*i] += fi.trace();
            for (j, fj) in &scaled {
                h[(*i, *j)] += (fi * fj).trace();
            }
        }
    }
    Some((g, h))
}

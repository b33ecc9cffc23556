//! Second opinion for tests: maximises the objective of an [`Lmi`] by Newton's method on
//! c'x / mu + sum log det F_b(x), nothing shared with the conic solver.
//!
//! S. Boyd, L. Vandenberghe, "Convex Optimization", section 11.3.

use super::lmi::Lmi;
use nalgebra::{DMatrix, DVector};

/// Maximum of the last unknown (which must be the objective and make every block feasible when very
/// negative), to about 10^-`digits` times the number of rows.
pub(crate) fn maximise(lmi: &Lmi, digits: i32) -> Option<f64> {
    let n = lmi.objective.len();
    let t = n - 1;
    // Phase I: Q = 2 I is inside for t far down; the margin t enters every block with -I.
    let mut x = DVector::zeros(n);
    let worst =
        lmi.blocks.iter().map(|b| b.at(&x).symmetric_eigenvalues().min()).fold(f64::INFINITY, f64::min);
    x[t] = worst.min(0.0) - 1.0;
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
    Some(x[t])
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

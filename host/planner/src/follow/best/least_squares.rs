//! Levenberg-Marquardt on the excesses over the limits.

use nalgebra::{DMatrix, DVector};

use crate::follow::limits::Axes;

use super::excess::{Excess, SPARE, Window};
use super::variables::{SCALES, Variables};

/// Steps of one solve.
const STEPS_MAX: usize = 40;
/// A solve that gains less than this share of the cost in [`SLOW_MAX`] steps in a row is given up.
const SLOW: f64 = 0.02;
const SLOW_MAX: usize = 4;
/// Step of the differences, in scales of the variables.
const DIFFERENCE: f64 = 1e-4;

/// Variables near `x` without any excess, with the joints in the middle of the window; `None` if none are reached.
pub(super) fn solve(
    excess: &mut Excess<'_>,
    x: &Variables,
    q_center: &Axes,
    points: usize,
) -> Option<(Variables, Axes)> {
    let (hand, blend_max_s) = (excess.hand(), excess.blend_max_s());
    let free = Variables::free(hand);
    let mut x = *x;
    x.clamp(hand, blend_max_s);
    let mut window = excess.window(&x, q_center, points)?;
    let mut residuals = excess.residuals(&x, &window);
    let mut cost = squares(&residuals);
    let (mut damping, mut slow) = (1e-2, 0);
    for _ in 0..STEPS_MAX {
        if inside(&residuals) {
            return Some((x, window.q_center));
        }
        let (normal, gradient) = linearised(excess, &x, &window, points, &residuals, &free);
        let before = cost;
        loop {
            let damped =
                &normal + DMatrix::from_diagonal_element(free.len(), free.len(), damping * (1e-6 + cost));
            let step = damped.cholesky()?.solve(&gradient);
            let mut trial = x;
            for (k, i) in free.iter().enumerate() {
                // No variable moves by more than ten scales at once.
                trial.0[*i] -= SCALES[*i] * step[k].clamp(-10.0, 10.0);
            }
            trial.clamp(hand, blend_max_s);
            let moved = excess.window(&trial, &window.q_center, points);
            if let Some((there, r_trial)) = moved.map(|there| {
                let residuals = excess.residuals(&trial, &there);
                (there, residuals)
            }) && squares(&r_trial) < cost
            {
                (x, window, cost, residuals) = (trial, there, squares(&r_trial), r_trial);
                damping = (damping * 0.2).max(1e-6);
                break;
            }
            damping *= 6.0;
            if damping > 1e6 {
                return None;
            }
        }
        slow = if cost > (1.0 - SLOW) * before { slow + 1 } else { 0 };
        if slow >= SLOW_MAX {
            return None;
        }
    }
    inside(&residuals).then_some((x, window.q_center))
}

/// True if the remaining excess is less than the reserve of the residuals: the limits themselves hold.
fn inside(residuals: &[f64]) -> bool {
    residuals.iter().all(|r| *r < 0.9 * SPARE)
}

fn squares(residuals: &[f64]) -> f64 {
    residuals.iter().map(|r| r * r).sum()
}

/// `JᵀJ` and `Jᵀr` in scaled variables; a variable that leads out of reach both ways counts as fixed.
fn linearised(
    excess: &mut Excess<'_>,
    x: &Variables,
    window: &Window,
    points: usize,
    residuals: &[f64],
    free: &[usize],
) -> (DMatrix<f64>, DVector<f64>) {
    let mut columns: Vec<Option<(Vec<f64>, f64)>> = Vec::with_capacity(free.len());
    for i in free {
        let column = [DIFFERENCE, -DIFFERENCE].into_iter().find_map(|h| {
            let mut moved = *x;
            moved.0[*i] += h * SCALES[*i];
            moved.clamp(excess.hand(), excess.blend_max_s());
            if moved.0[*i] == x.0[*i] {
                return None;
            }
            if Variables::is_of_ramps(*i) {
                return Some((excess.residuals(&moved, window), h));
            }
            let there = excess.window(&moved, &window.q_center, points)?;
            Some((excess.residuals(&moved, &there), h))
        });
        columns.push(column);
    }
    let rows: Vec<usize> = (0..residuals.len())
        .filter(|r| residuals[*r] != 0.0 || columns.iter().flatten().any(|(c, _)| c[*r] != 0.0))
        .collect();
    let jacobian = DMatrix::from_fn(rows.len(), free.len(), |r, k| {
        columns[k].as_ref().map_or(0.0, |(column, h)| (column[rows[r]] - residuals[rows[r]]) / h)
    });
    let active = DVector::from_fn(rows.len(), |r, _| residuals[rows[r]]);
    (jacobian.tr_mul(&jacobian), jacobian.tr_mul(&active))
}

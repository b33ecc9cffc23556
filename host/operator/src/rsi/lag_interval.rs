//! The lag from slopes of the residuals: the last steps to the least squares, and the accuracy that the cycles of a test motion
//! allow.

use planner::follow::limits::AXES;

use super::cycles::Cycle;
use super::identify::{residuals, squares};

/// Length of a block, s: longer than the lag that is looked for, so that blocks are nearly independent.
const BLOCK_S: f64 = 0.5;
/// Student's t for 95 % with the blocks of a wiggle, about 16 degrees of freedom.
const T_95: f64 = 2.12;
/// Step of the differences, s.
const STEP_S: f64 = 1e-4;
/// Steps of Gauss and Newton at most; two to four are needed.
const STEPS_MAX: usize = 10;

/// Residuals at a lag and how they change with it, per s of dead time and of time constant.
struct Slopes {
    left: Vec<f64>,
    by_dead: Vec<f64>,
    by_constant: Vec<f64>,
    /// `Jᵀ J`, its upper half row by row.
    a: [f64; 3],
}

impl Slopes {
    fn at(window: &[Cycle], inputs: &[[f64; AXES]], period_s: f64, (dead_s, constant_s): (f64, f64)) -> Self {
        let at = |dead_s: f64, constant_s: f64| residuals(window, inputs, period_s, dead_s, constant_s);
        let slope = |low: Vec<f64>, high: Vec<f64>, width_s: f64| -> Vec<f64> {
            low.iter().zip(&high).map(|(low, high)| (high - low) / width_s).collect()
        };
        let [dead_low, constant_low] = [dead_s, constant_s].map(|s| (s - STEP_S).max(0.0));
        let (dead_high, constant_high) = (dead_s + STEP_S, constant_s + STEP_S);
        let by_dead = slope(at(dead_low, constant_s), at(dead_high, constant_s), dead_high - dead_low);
        let by_constant =
            slope(at(dead_s, constant_low), at(dead_s, constant_high), constant_high - constant_low);
        let a = by_dead.iter().zip(&by_constant).fold([0.0; 3], |a, (dead, constant)| {
            [a[0] + dead * dead, a[1] + dead * constant, a[2] + constant * constant]
        });
        Self { left: at(dead_s, constant_s), by_dead, by_constant, a }
    }

    /// Change of dead time and time constant that makes the linear model of these products `Jᵀ r` zero, s.
    fn solve(&self, [d, c]: [f64; 2]) -> [f64; 2] {
        let a = self.a;
        let determinant = a[0] * a[2] - a[1] * a[1];
        [(a[1] * c - a[2] * d) / determinant, (a[1] * d - a[0] * c) / determinant]
    }
}

/// The least squares near a lag, and the lag there: a grid can end anywhere in the long valley in which one value replaces the
/// other.
pub(super) fn polished(
    window: &[Cycle],
    inputs: &[[f64; AXES]],
    period_s: f64,
    (mut cost, mut dead_s, mut constant_s): (f64, f64, f64),
) -> (f64, f64, f64) {
    for _ in 0..STEPS_MAX {
        let slopes = Slopes::at(window, inputs, period_s, (dead_s, constant_s));
        let product = |by: &[f64]| by.iter().zip(&slopes.left).map(|(by, left)| by * left).sum::<f64>();
        let (of_dead, of_constant) = (product(&slopes.by_dead), product(&slopes.by_constant));
        let [d, c] = slopes.solve([of_dead, of_constant]);
        // Neither may be negative: if one would be, it becomes zero and the other takes the rest.
        let [a, b, c_c] = slopes.a;
        let next = if constant_s + c < 0.0 {
            (dead_s - (of_dead - b * constant_s) / a, 0.0)
        } else if dead_s + d < 0.0 {
            (0.0, constant_s - (of_constant - b * dead_s) / c_c)
        } else {
            (dead_s + d, constant_s + c)
        };
        let next_cost = squares(window, inputs, period_s, next.0, next.1);
        // Written so that NaN ends it.
        let is_less = next_cost < cost;
        if !is_less {
            break;
        }
        (cost, dead_s, constant_s) = (next_cost, next.0, next.1);
    }
    (cost, dead_s, constant_s)
}

/// Half widths of 95 % intervals of dead time, time constant and their sum, s. NaN if the cycles do not distinguish them.
///
/// The estimate is linear in the residuals for small ones. Its covariance is `A⁻¹ G A⁻¹` with `A = Jᵀ J` and `G` the sum over blocks of
/// the squares of `Jᵀ r` of each block (clustered "sandwich"; Liang and Zeger 1986): neighbours in time may err together.
pub(super) fn half_widths_s(
    window: &[Cycle],
    inputs: &[[f64; AXES]],
    period_s: f64,
    lag_s: (f64, f64),
) -> [f64; 3] {
    let slopes = Slopes::at(window, inputs, period_s, lag_s);
    // Residuals stand axis by axis; a block has a piece of each axis.
    let cycles = window.len() - 1;
    let block = ((BLOCK_S / period_s) as usize).max(1);
    let blocks = cycles.div_ceil(block);
    let mut g = vec![[0.0; 2]; blocks];
    for (n, ((dead, constant), left)) in
        slopes.by_dead.iter().zip(&slopes.by_constant).zip(&slopes.left).enumerate()
    {
        let of = &mut g[n % cycles / block];
        *of = [of[0] + dead * left, of[1] + constant * left];
    }
    // What each block moves the estimate by.
    let sums = g
        .iter()
        .map(|products| slopes.solve(*products))
        .fold([0.0; 3], |sums, [d, c]| [sums[0] + d * d, sums[1] + c * c, sums[2] + (d + c) * (d + c)]);
    let few = blocks as f64 / (blocks as f64 - 2.0).max(1.0);
    sums.map(|sum| T_95 * (sum * few).sqrt())
}

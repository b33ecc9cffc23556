//! Landing of a ball whose release is late or early: the first-order condition and windows beyond it.
//!
//! While the gripper hesitates, the hand carries the ball on along its motion; a release δ late lands at
//! `L(δ) = land(p(δ), v(δ))`. With `e = a - g` the acceleration of the hand against free fall, `dL/dδ = G_v e`, which
//! vanishes exactly if e is along the velocity at the landing; then `d²L/dδ² = G_v q⃛-part + O(|e|²)` is left, and the
//! windows bound what it does.

use nalgebra::Vector2;

use super::WINDOW;
use crate::plan::landed::Landed;
use crate::plan::layout::{Layout, SLOPE};
use crate::plan::problem::Problem;
use crate::solve::{Row, Sink};
use crate::throw::Throw;

/// The first-order condition is a central difference over ± this delay; its error is ε² L‴/6, about 1e-3 mm per ms.
const SLOPE_DELAY_S: f64 = 1e-3;
/// Shifts count in centimetres, so that they weigh like the other scaled rows.
const SHIFT_SCALE: f64 = 100.0;
/// Smooths the distance at zero; far below any window.
const SHIFT_EPS_M: f64 = 1e-4;
/// A ball that comes through the plane more slowly rises hardly a millimetre above it: with a little more delay it does not get
/// there at all.
const THROUGH_MIN_M_S: f64 = 0.15;
/// Windows aim a little inside, so that another integration of the flight agrees.
const WINDOW_SHARE: f64 = 0.98;

/// `dL/dδ = 0` and `|L(δ) - L(0)| ≤ window` for late and early release.
pub(super) fn delay_rows<S: Sink<D>, const N: usize, const D: usize>(
    problem: &Problem<'_, N>,
    layout: &Layout<N>,
    x: &Row<D>,
    throw: &Throw<N>,
    sink: &mut S,
) {
    let var = Layout::<N>::VARIABLES;
    let number = Layout::<N>::NUMBERS;
    if !problem.options.null_delay {
        return;
    }
    let aim = layout.aim(problem, x);
    let late = |delay_s: f64| Landed::of(problem, &problem.flight, throw, &aim, delay_s);
    if sink.wants_eq(SLOPE) || sink.wants_eq(SLOPE + 1) {
        match (late(SLOPE_DELAY_S), late(-SLOPE_DELAY_S)) {
            (Some(after), Some(before)) => {
                let scale = 0.5 / SLOPE_DELAY_S;
                let value = (after.xy - before.xy) * scale;
                for (i, axis) in [Vector2::x(), Vector2::y()].into_iter().enumerate() {
                    sink.eq(SLOPE + i, value[i], |g| {
                        after.add_gradient(g, layout, &(axis * scale));
                        before.add_gradient(g, layout, &(axis * -scale));
                    });
                }
            }
            _ => {
                for i in 0..2 {
                    sink.eq(SLOPE + i, 1e3, |_| {});
                }
            }
        }
    }
    if problem.options.delay_windows.is_empty() {
        return;
    }
    // Measured from where this throw lands, not from the target: whether it hits is another row's business, and a row
    // that mixes both is stiff wherever the throw still misses by metres.
    let on_time = late(0.0);
    for (k, window) in problem.options.delay_windows.iter().enumerate() {
        for (side, sign) in [(0, 1.0), (1, -1.0)] {
            let id = number.delay + 2 * k + side;
            if !sink.wants(id) {
                continue;
            }
            // A phase shorter than the delay ends before the release.
            let (h, h_index) = if sign < 0.0 { (throw.ha_s, var.ha) } else { (throw.hb_s, var.hb) };
            if h <= window.delay_s {
                sink.ineq(id, (h - window.delay_s) * SHIFT_SCALE - 1.0, |g| g.add(h_index, SHIFT_SCALE));
                continue;
            }
            let end = late(sign * window.delay_s).filter(|end| end.through_m_s >= THROUGH_MIN_M_S);
            let (Some(end), Some(on_time)) = (end, &on_time) else {
                sink.ineq(id, -1e3, |_| {});
                continue;
            };
            let off = end.xy - on_time.xy;
            let distance_m = (off.norm_squared() + SHIFT_EPS_M * SHIFT_EPS_M).sqrt();
            let value = (window.shift_m * WINDOW_SHARE - distance_m) * SHIFT_SCALE;
            if value < WINDOW {
                sink.ineq(id, value, |g| {
                    let along = off * (-SHIFT_SCALE / distance_m);
                    end.add_gradient(g, layout, &along);
                    on_time.add_gradient(g, layout, &-along);
                    if let Some((at, axes)) = layout.shift {
                        let by_plane = along.dot(&(end.by_plane - on_time.by_plane));
                        for (a, n) in aim.normal().iter().enumerate().filter(|(a, _)| axes[*a]) {
                            g.add(at + a, by_plane * n);
                        }
                    }
                });
            }
        }
    }
}

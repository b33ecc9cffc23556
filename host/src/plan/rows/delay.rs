//! Landing of a ball whose release is late or early: the first-order condition and windows beyond it.
//!
//! While the gripper hesitates, the hand carries the ball on along its motion; a release δ late lands at
//! `L(δ) = land(p(δ), v(δ))`. With `e = a - g` the acceleration of the hand against free fall, `dL/dδ = G_v e`, which
//! vanishes exactly if e is along the velocity at the landing; then `d²L/dδ² = G_v q⃛-part + O(|e|²)` is left, and the
//! windows bound what it does.

use nalgebra::{Matrix2x3, Vector2};

use super::{DELAY, HA, HB, Layout, Q, QD, QDD, Sink, WINDOW};
use crate::plan::problem::Problem;
use crate::plan::qp::Row;
use crate::plan::throw::{JOINTS, Throw};

/// The first-order condition is a central difference over ± this delay; its error is ε² L‴/6, about 1e-3 mm per ms.
const SLOPE_DELAY_S: f64 = 1e-3;
/// Shifts count in centimetres, so that they weigh like the other scaled rows.
const SHIFT_SCALE: f64 = 100.0;
/// Smooths the distance at zero; far below any window.
const SHIFT_EPS_M: f64 = 1e-4;
/// Windows aim a little inside, so that another integration of the flight agrees.
const WINDOW_SHARE: f64 = 0.98;

/// A landing and its derivatives.
struct Late {
    landing: Vector2<f64>,
    by_q: [Vector2<f64>; JOINTS],
    by_qd: [Vector2<f64>; JOINTS],
    by_qdd: [Vector2<f64>; JOINTS],
    by_h: Vector2<f64>,
    /// Variable of the phase in which the release falls.
    h_index: usize,
    /// By the height of the plane.
    by_plane: Vector2<f64>,
}

/// Landing of a release `delay_s` late on the plane at `z_m`; `None` if the ball does not come down there.
fn late(problem: &Problem<'_>, throw: &Throw, z_m: f64, delay_s: f64) -> Option<Late> {
    let arm = problem.arm;
    let (h, h_index) = if delay_s < 0.0 { (throw.ha_s, HA) } else { (throw.hb_s, HB) };
    // At a fixed time, not at a fixed phase: the derivatives by h differ from those of a cut.
    let (s, m) = (delay_s, delay_s.abs());
    let (p1, p2) = (s - s * s * s / (3.0 * h * h), s * s / 2.0 - m * m * m / (3.0 * h));
    let (v1, v2) = (1.0 - s * s / (h * h), s - s * m / h);
    let (p1_h, p2_h) = (2.0 * s * s * s / (3.0 * h * h * h), m * m * m / (3.0 * h * h));
    let (v1_h, v2_h) = (2.0 * s * s / (h * h * h), s * m / (h * h));
    let (qd_r, qdd_r) = (&throw.qd_rad_s, &throw.qdd_rad_s2);
    let q = throw.q_rad + qd_r * p1 + qdd_r * p2;
    let qd = qd_r * v1 + qdd_r * v2;
    let frames = arm.fk(&q);
    let p = arm.ball(&frames).pos;
    let jac = frames.jacobian(&p);
    let by_q = frames.twist_gradient(&jac, &qd);
    let v = (jac * qd).fixed_rows::<3>(0).into_owned();
    let landed = problem.flight.land(&p, &v, z_m)?;
    let g = problem.flight.landing_jacobian(&p, &v, &landed);
    let (g_p, g_v): (Matrix2x3<f64>, Matrix2x3<f64>) =
        (g.fixed_columns::<3>(0).into_owned(), g.fixed_columns::<3>(3).into_owned());
    let columns: [(Vector2<f64>, Vector2<f64>); JOINTS] = std::array::from_fn(|k| {
        let column = jac.fixed_view::<3, 1>(0, k);
        (g_p * column + g_v * by_q.fixed_view::<3, 1>(0, k), g_v * column)
    });
    let mut by_h = Vector2::zeros();
    for (k, (a, b)) in columns.iter().enumerate() {
        by_h += a * (qd_r[k] * p1_h + qdd_r[k] * p2_h) + b * (qd_r[k] * v1_h + qdd_r[k] * v2_h);
    }
    Some(Late {
        landing: landed.p.xy(),
        by_q: columns.map(|(a, _)| a),
        by_qd: columns.map(|(a, b)| a * p1 + b * v1),
        by_qdd: columns.map(|(a, b)| a * p2 + b * v2),
        by_h,
        h_index,
        by_plane: landed.v.xy() / landed.v.z,
    })
}

/// `dL/dδ = 0` (equalities 7 and 8) and `|L(δ) - target| ≤ window` for late and early release.
pub(super) fn delay_rows<S: Sink>(
    problem: &Problem<'_>,
    layout: &Layout,
    x: &Row,
    throw: &Throw,
    sink: &mut S,
) {
    if !problem.options.null_delay {
        return;
    }
    let target = layout.target(problem, x);
    if sink.wants_eq(7) || sink.wants_eq(8) {
        let at = |side: f64| late(problem, throw, target.z, side * SLOPE_DELAY_S);
        match (at(1.0), at(-1.0)) {
            (Some(after), Some(before)) => {
                let scale = 0.5 / SLOPE_DELAY_S;
                let value = (after.landing - before.landing) * scale;
                for i in 0..2 {
                    sink.eq(7 + i, value[i], |g| {
                        for (end, sign) in [(&after, scale), (&before, -scale)] {
                            for k in 0..JOINTS {
                                g.add(Q + k, sign * end.by_q[k][i]);
                                g.add(QD + k, sign * end.by_qd[k][i]);
                                g.add(QDD + k, sign * end.by_qdd[k][i]);
                            }
                            g.add(end.h_index, sign * end.by_h[i]);
                        }
                    });
                }
            }
            _ => {
                for i in 0..2 {
                    sink.eq(7 + i, 1e3, |_| {});
                }
            }
        }
    }
    for (k, window) in problem.options.delay_windows.iter().enumerate() {
        for (side, sign) in [(0, 1.0), (1, -1.0)] {
            let id = DELAY + 2 * k + side;
            if !sink.wants(id) {
                continue;
            }
            // A phase shorter than the delay ends before the release.
            let (h, h_index) = if sign < 0.0 { (throw.ha_s, HA) } else { (throw.hb_s, HB) };
            if h <= window.delay_s {
                sink.ineq(id, (h - window.delay_s) * SHIFT_SCALE - 1.0, |g| g.add(h_index, SHIFT_SCALE));
                continue;
            }
            let Some(end) = late(problem, throw, target.z, sign * window.delay_s) else {
                sink.ineq(id, -1e3, |_| {});
                continue;
            };
            let off = end.landing - target.xy();
            let distance_m = (off.norm_squared() + SHIFT_EPS_M * SHIFT_EPS_M).sqrt();
            let value = (window.shift_m * WINDOW_SHARE - distance_m) * SHIFT_SCALE;
            if value < WINDOW {
                sink.ineq(id, value, |g| {
                    let along = off * (-SHIFT_SCALE / distance_m);
                    for j in 0..JOINTS {
                        g.add(Q + j, along.dot(&end.by_q[j]));
                        g.add(QD + j, along.dot(&end.by_qd[j]));
                        g.add(QDD + j, along.dot(&end.by_qdd[j]));
                    }
                    g.add(end.h_index, along.dot(&end.by_h));
                    if let Some((at, axes)) = layout.shift {
                        for (axis, by) in
                            [-along.x, -along.y, along.dot(&end.by_plane)].into_iter().enumerate()
                        {
                            if axes[axis] {
                                g.add(at + axis, by);
                            }
                        }
                    }
                });
            }
        }
    }
}

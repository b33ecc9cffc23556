//! Objective and limits of the spline, bounds of the times: closed forms of the variables.

use nalgebra::Vector3;

use super::{WINDOW, has_goal};
use crate::plan::goal::EFFORT_SHARE;
use crate::plan::layout::Layout;
use crate::plan::problem::Problem;
use crate::solve::{Row, Sink};
use crate::throw::Basis;

/// Weight of the squared shift of the target against the objective when the nearest reachable target is looked for.
const SHIFT_WEIGHT: f64 = 1e3;
const SHIFT_COST_SHARE: f64 = 1e-3;

/// Objective and the limits (2) to (6) of the spline: closed forms of the variables.
pub(crate) fn spline_rows<S: Sink>(problem: &Problem<'_>, layout: &Layout, x: &Row, sink: &mut S) {
    objective(problem, layout, x, sink);
    for joint in 0..problem.joints() {
        range_rows(problem, layout, x, joint, sink);
        rate_rows(problem, layout, x, joint, sink);
    }
    if layout.qdd {
        extreme_rows(problem, layout, x, sink);
    }
    time_rows(problem, x, sink);
    if let Some((at, [_, _, true])) = layout.shift {
        let above_m = problem.target.z + x[at + 2] - problem.arm.world().floor_z_m;
        if above_m < WINDOW && sink.wants(problem.numbers().target_floor) {
            sink.ineq(problem.numbers().target_floor, above_m, |g| g.add(at + 2, 1.0));
        }
    }
}

/// Joint acceleration at the release, in rad/s²; zero where the layout has none.
fn release_acceleration(layout: &Layout, x: &Row, joint: usize) -> f64 {
    if layout.qdd { x[layout.variables().qdd + joint] } else { 0.0 }
}

/// The objective: q⃛ is constant in each phase, so its squared integral is 4 Σ(q̈h ∓ q̇)²/h³.
fn objective<S: Sink>(problem: &Problem<'_>, layout: &Layout, x: &Row, sink: &mut S) {
    let var = problem.variables();
    let w = &problem.options.weights;
    let (ha, hb) = (x[var.ha], x[var.hb]);
    let (mut sa, mut sb, mut sa_h, mut sb_h) = (0.0, 0.0, 0.0, 0.0);
    for j in 0..problem.joints() {
        let (qd, qdd) = (x[var.qd + j], release_acceleration(layout, x, j));
        let (ea, eb) = (qd - qdd * ha, qd + qdd * hb);
        sa += ea * ea;
        sb += eb * eb;
        sa_h -= 2.0 * ea * qdd;
        sb_h += 2.0 * eb * qdd;
    }
    let k = 4.0 * w.k_j;
    let total = ha + hb;
    let (ia, ib) = (1.0 / (ha * ha * ha), 1.0 / (hb * hb * hb));
    let share = match layout.shift {
        Some(_) => SHIFT_COST_SHARE,
        None if has_goal(problem, layout) => EFFORT_SHARE,
        None => 1.0,
    };
    let mut value = share * (w.k_t * total + w.k_b * hb / total + k * (sa * ia + sb * ib));
    if let Some((at, _)) = layout.shift {
        value += SHIFT_WEIGHT * Vector3::new(x[at], x[at + 1], x[at + 2]).norm_squared();
    }
    sink.objective(value, |g| {
        g.add(var.ha, share * (w.k_t - w.k_b * hb / (total * total) + k * (sa_h * ia - 3.0 * sa * ia / ha)));
        g.add(var.hb, share * (w.k_t + w.k_b * ha / (total * total) + k * (sb_h * ib - 3.0 * sb * ib / hb)));
        for j in 0..problem.joints() {
            let (qd, qdd) = (x[var.qd + j], release_acceleration(layout, x, j));
            let (ea, eb) = (qd - qdd * ha, qd + qdd * hb);
            g.add(var.qd + j, share * 2.0 * k * (ea * ia + eb * ib));
            if layout.qdd {
                g.add(var.qdd + j, share * 2.0 * k * (eb * hb * ib - ea * ha * ia));
            }
        }
        if let Some((at, axes)) = layout.shift {
            for a in 0..3 {
                if axes[a] {
                    g.add(at + a, 2.0 * SHIFT_WEIGHT * x[at + a]);
                }
            }
        }
    });
}

/// Both outer ends of a joint inside its range (2), (3).
fn range_rows<S: Sink>(problem: &Problem<'_>, layout: &Layout, x: &Row, j: usize, sink: &mut S) {
    let var = problem.variables();
    let number = problem.numbers();
    let l = &problem.limits;
    let (ha, hb) = (x[var.ha], x[var.hb]);
    let (q, qd, qdd) = (x[var.q + j], x[var.qd + j], release_acceleration(layout, x, j));
    let start = q - qd * ha * (2.0 / 3.0) + qdd * ha * ha / 6.0;
    let stop = q + qd * hb * (2.0 / 3.0) + qdd * hb * hb / 6.0;
    for (base, at, h_index, sign_h, h) in [
        (number.range, start, var.ha, -1.0, ha),
        (number.range + 2 * problem.joints(), stop, var.hb, 1.0, hb),
    ] {
        for (id, value, sign) in
            [(base + 2 * j, at - l.q_min[j], 1.0), (base + 2 * j + 1, l.q_max[j] - at, -1.0)]
        {
            if value < WINDOW && sink.wants(id) {
                sink.ineq(id, value, |g| {
                    g.add(var.q + j, sign);
                    g.add(var.qd + j, sign * sign_h * h * (2.0 / 3.0));
                    g.add(h_index, sign * (sign_h * qd * (2.0 / 3.0) + qdd * h / 3.0));
                    if layout.qdd {
                        g.add(var.qdd + j, sign * h * h / 6.0);
                    }
                });
            }
        }
    }
}

/// Speed (4), acceleration (5) and jerk (6) of a joint.
fn rate_rows<S: Sink>(problem: &Problem<'_>, layout: &Layout, x: &Row, j: usize, sink: &mut S) {
    let var = problem.variables();
    let number = problem.numbers();
    let l = &problem.limits;
    let (ha, hb) = (x[var.ha], x[var.hb]);
    let (qd, qdd) = (x[var.qd + j], release_acceleration(layout, x, j));
    for (s, sign) in [(0, 1.0), (1, -1.0)] {
        // Speed at the release (4).
        let value = 1.0 - sign * qd / l.v[j];
        if value < WINDOW && sink.wants(number.speed + 2 * j + s) {
            sink.ineq(number.speed + 2 * j + s, value, |g| g.add(var.qd + j, -(sign / l.v[j])));
        }
        // Acceleration (5), times h so that it stays linear: A h ∓ (2 q̇ - q̈ h) ≥ 0.
        let scale = 1.0 / (2.0 * l.v[j]);
        for (id, h_index, h, dir) in
            [(number.acc_start + 2 * j + s, var.ha, ha, -1.0), (number.acc_stop + 2 * j + s, var.hb, hb, 1.0)]
        {
            let demand = 2.0 * qd + dir * qdd * h;
            let value = (l.a[j] * h - sign * demand) * scale;
            if value < WINDOW && sink.wants(id) {
                sink.ineq(id, value, |g| {
                    g.add(h_index, (l.a[j] - sign * dir * qdd) * scale);
                    g.add(var.qd + j, -(2.0 * sign * scale));
                    if layout.qdd {
                        g.add(var.qdd + j, -(sign * dir * h * scale));
                    }
                });
            }
        }
        // Jerk (6), times h²/2.
        for (id, h_index, h, dir) in
            [(number.jerk_a + 2 * j + s, var.ha, ha, -1.0), (number.jerk_b + 2 * j + s, var.hb, hb, 1.0)]
        {
            let value = (l.j[j] * h * h * 0.5 - sign * (qd + dir * qdd * h)) / l.v[j];
            if value < WINDOW && sink.wants(id) {
                sink.ineq(id, value, |g| {
                    g.add(h_index, (l.j[j] * h - sign * dir * qdd) / l.v[j]);
                    g.add(var.qd + j, -(sign / l.v[j]));
                    if layout.qdd {
                        g.add(var.qdd + j, -(sign * dir * h / l.v[j]));
                    }
                });
            }
        }
        if layout.qdd {
            let value = 1.0 - sign * qdd / l.a[j];
            if value < WINDOW && sink.wants(number.acc_release + 2 * j + s) {
                sink.ineq(number.acc_release + 2 * j + s, value, |g| {
                    g.add(var.qdd + j, -(sign / l.a[j]));
                });
            }
        }
    }
}

/// With joint acceleration at the release, speed and position can peak inside a phase.
fn extreme_rows<S: Sink>(problem: &Problem<'_>, layout: &Layout, x: &Row, sink: &mut S) {
    let var = problem.variables();
    let number = problem.numbers();
    let l = &problem.limits;
    let throw = layout.throw(x);
    for j in 0..problem.joints() {
        for (k, side) in [(0, -1.0), (1, 1.0)] {
            let h_index = if side < 0.0 { var.ha } else { var.hb };
            let (qd, qdd) = (throw.qd_rad_s[j], throw.qdd_rad_s2[j]);
            if let Some(sigma) = throw.speed_peak_phase(j, side) {
                let b = Basis::at(sigma, throw.phase_s(side));
                let peak = qd * b.vel.0 + qdd * b.vel.1;
                let sign = peak.signum();
                let value = 1.0 - sign * peak / l.v[j];
                let id = number.peak + problem.joints() * k + j;
                if value < WINDOW && sink.wants(id) {
                    // The phase of the peak is stationary, so only the direct dependence counts.
                    sink.ineq(id, value, |g| {
                        g.add(var.qd + j, -(sign * b.vel.0 / l.v[j]));
                        g.add(var.qdd + j, -(sign * b.vel.1 / l.v[j]));
                        g.add(h_index, -(sign * (qd * b.vel_by_h.0 + qdd * b.vel_by_h.1) / l.v[j]));
                    });
                }
            }
            if let Some(sigma) = throw.turning_phase(j, side) {
                let b = Basis::at(sigma, throw.phase_s(side));
                let at = throw.q_rad[j] + qd * b.pos.0 + qdd * b.pos.1;
                let (lower, upper) = (at - l.q_min[j], l.q_max[j] - at);
                let (value, sign) = if lower < upper { (lower, 1.0) } else { (upper, -1.0) };
                let id = number.turn + problem.joints() * k + j;
                if value < WINDOW && sink.wants(id) {
                    sink.ineq(id, value, |g| {
                        g.add(var.q + j, sign);
                        g.add(var.qd + j, sign * b.pos.0);
                        g.add(var.qdd + j, sign * b.pos.1);
                        g.add(h_index, sign * (qd * b.pos_by_h.0 + qdd * b.pos_by_h.1));
                    });
                }
            }
        }
    }
}

/// Bounds of times, braking ratio and the shift of the target; all linear.
fn time_rows<S: Sink>(problem: &Problem<'_>, x: &Row, sink: &mut S) {
    let var = problem.variables();
    let number = problem.numbers();
    let b = &problem.bounds;
    let (ha, hb) = (x[var.ha], x[var.hb]);
    let total = ha + hb;
    let (r_min, r_max) = (*b.braking_ratio.start(), *b.braking_ratio.end());
    let rows: [(f64, f64, f64, f64); 6] = [
        // value, and its derivative by F, h_a, h_b
        (x[var.f] - b.flight_s.start(), 1.0, 0.0, 0.0),
        (b.flight_s.end() - x[var.f], -1.0, 0.0, 0.0),
        (total - b.duration_s.start(), 0.0, 1.0, 1.0),
        (b.duration_s.end() - total, 0.0, -1.0, -1.0),
        (hb - r_min * total, 0.0, -r_min, 1.0 - r_min),
        (r_max * total - hb, 0.0, r_max, r_max - 1.0),
    ];
    for (i, (value, by_f, by_ha, by_hb)) in rows.into_iter().enumerate() {
        if value < WINDOW && sink.wants(number.times + i) {
            sink.ineq(number.times + i, value, |g| {
                g.add(var.f, by_f);
                g.add(var.ha, by_ha);
                g.add(var.hb, by_hb);
            });
        }
    }
}

//! Currents (7) and (8) at the release.

use super::{Gradient, MOTOR, POINT, Q, QD, SUPPLY, Sink};
use crate::plan::problem::Problem;
use crate::throw::{JOINTS, Joints, Throw};

/// Currents are sums of absolute values; `√(x² + ε²)` has a gradient at zero, and over-estimates by at most ε.
const ABS_EPS: f64 = 1e-4;
/// Rows with more than this share of the limit left are not built: their gradient is costly.
const NEAR: f64 = 0.25;

fn abs_eps(x: f64) -> (f64, f64) {
    let r = (x * x + ABS_EPS * ABS_EPS).sqrt();
    (r, x / r)
}

/// Currents (7) and (8) at the release with the paper's simplification `τ(q_r, q̇_r, 0)`.
pub(super) fn release_current_rows<S: Sink>(
    problem: &Problem<'_>,
    throw: &Throw,
    frames: &robot_model::Frames<JOINTS>,
    sink: &mut S,
) {
    let arm = problem.arm;
    let Some(drives) = arm.drives() else { return };
    let supplies = arm.supplies();
    if !(MOTOR..SUPPLY + supplies.len().min(POINT - SUPPLY)).any(|id| sink.wants(id)) {
        return;
    }
    let (q, qd) = (&throw.q_rad, &throw.qd_rad_s);
    let tau = problem.holding().bias_torques(q, qd);
    let motor: [f64; JOINTS] = std::array::from_fn(|j| {
        drives[j].k_b_a_s_rad * abs_eps(qd[j]).0 + drives[j].k_m_a_nm * abs_eps(tau[j]).0
    });
    let near_motor = |j: usize| 1.0 - motor[j] / drives[j].current_max_a;
    let near_supply = |k: usize| {
        let sum: f64 = (0..JOINTS).filter(|j| supplies[k].feeds[*j]).map(|j| motor[j]).sum();
        1.0 - sum / supplies[k].current_max_a
    };
    let supplies_used = supplies.len().min(POINT - SUPPLY);
    let any = (0..JOINTS).any(|j| near_motor(j) < NEAR) || (0..supplies_used).any(|k| near_supply(k) < NEAR);
    if !any {
        return;
    }
    let gradient = problem.holding().inverse_dynamics_gradient_at(frames, qd, &Joints::zeros());
    let add = |g: &mut Gradient<'_>, j: usize, scale: f64| {
        let by_tau = scale * drives[j].k_m_a_nm * abs_eps(tau[j]).1;
        for k in 0..JOINTS {
            g.add(Q + k, by_tau * gradient.by_q[(j, k)]);
            g.add(QD + k, by_tau * gradient.by_qd[(j, k)]);
        }
        g.add(QD + j, scale * drives[j].k_b_a_s_rad * abs_eps(qd[j]).1);
    };
    for j in 0..JOINTS {
        if near_motor(j) < NEAR && sink.wants(MOTOR + j) {
            sink.ineq(MOTOR + j, near_motor(j), |g| add(g, j, -1.0 / drives[j].current_max_a));
        }
    }
    for k in 0..supplies_used {
        if near_supply(k) < NEAR && sink.wants(SUPPLY + k) {
            sink.ineq(SUPPLY + k, near_supply(k), |g| {
                for j in (0..JOINTS).filter(|j| supplies[k].feeds[*j]) {
                    add(g, j, -1.0 / supplies[k].current_max_a);
                }
            });
        }
    }
}

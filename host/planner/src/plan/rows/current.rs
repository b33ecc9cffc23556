//! Currents (7) and (8) at the release.

use crate::plan::layout::SUPPLIES_MAX;
use crate::plan::problem::Problem;
use crate::solve::{Gradient, Sink};
use crate::throw::Throw;
use robot_model::JointVec;

/// Currents are sums of absolute values; `√(x² + ε²)` has a gradient at zero, and over-estimates by at most ε.
const ABS_EPS: f64 = 1e-4;
/// Rows with more than this share of the limit left are not built: their gradient is costly.
const NEAR: f64 = 0.25;

#[inline]
fn abs_eps(x: f64) -> (f64, f64) {
    let r = (x * x + ABS_EPS * ABS_EPS).sqrt();
    (r, x / r)
}

/// Currents (7) and (8) at the release with the paper's simplification `τ(q_r, q̇_r, 0)`.
pub(super) fn release_current_rows<S: Sink>(
    problem: &Problem<'_>,
    throw: &Throw,
    frames: &robot_model::Frames,
    sink: &mut S,
) {
    let var = problem.variables();
    let number = problem.numbers();
    let (n, arm) = (problem.joints(), problem.arm);
    let Some(drives) = arm.drives() else { return };
    let supplies = arm.supplies();
    if !(number.motor..number.supply + supplies.len().min(SUPPLIES_MAX)).any(|id| sink.wants(id)) {
        return;
    }
    let (q, qd) = (&throw.q_rad, &throw.qd_rad_s);
    let tau = problem.holding().bias_torques(q, qd);
    let motor = JointVec::from_fn(n, |j| {
        drives[j].k_b_a_s_rad * abs_eps(qd[j]).0 + drives[j].k_m_a_nm * abs_eps(tau[j]).0
    });
    let near_motor = |j: usize| 1.0 - motor[j] / drives[j].current_max_a;
    let near_supply = |k: usize| {
        let sum: f64 = (0..n).filter(|j| supplies[k].feeds[*j]).map(|j| motor[j]).sum();
        1.0 - sum / supplies[k].current_max_a
    };
    let supplies_used = supplies.len().min(SUPPLIES_MAX);
    let any = (0..n).any(|j| near_motor(j) < NEAR) || (0..supplies_used).any(|k| near_supply(k) < NEAR);
    if !any {
        return;
    }
    let gradient = problem.holding().inverse_dynamics_gradient_at(frames, qd, &JointVec::zeros(n));
    let add = |g: &mut Gradient<'_>, j: usize, scale: f64| {
        let by_tau = scale * drives[j].k_m_a_nm * abs_eps(tau[j]).1;
        for k in 0..n {
            g.add(var.q + k, by_tau * gradient.by_q[(j, k)]);
            g.add(var.qd + k, by_tau * gradient.by_qd[(j, k)]);
        }
        g.add(var.qd + j, scale * drives[j].k_b_a_s_rad * abs_eps(qd[j]).1);
    };
    for j in 0..n {
        if near_motor(j) < NEAR && sink.wants(number.motor + j) {
            sink.ineq(number.motor + j, near_motor(j), |g| add(g, j, -1.0 / drives[j].current_max_a));
        }
    }
    for k in 0..supplies_used {
        if near_supply(k) < NEAR && sink.wants(number.supply + k) {
            sink.ineq(number.supply + k, near_supply(k), |g| {
                for j in (0..n).filter(|j| supplies[k].feeds[*j]) {
                    add(g, j, -1.0 / supplies[k].current_max_a);
                }
            });
        }
    }
}

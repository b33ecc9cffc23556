//! Plain discrete LQR with clipping: the reference for the certified designs.
//!
//! State (position error, velocity error, last command), double integrator whose command acts a
//! delay later, no drive lag, saturation ignored in the design. No certificate comes with it.

use crate::model::exponential;
use nalgebra::{Matrix3, RowVector3, Vector3};

/// x+ = A x + B u over one period, the last command acting until `delay_s`.
fn plant(period_s: f64, delay_s: f64) -> (Matrix3<f64>, Vector3<f64>) {
    let integrator = |t: f64| exponential(&Matrix3::new(0.0, t, 0.0, 0.0, 0.0, t, 0.0, 0.0, 0.0));
    let (before, after) = (integrator(delay_s), integrator(period_s - delay_s));
    // The third state of each part is the acceleration held in it.
    let last = after.fixed_view::<2, 2>(0, 0) * before.fixed_view::<2, 1>(0, 2);
    let free = after.fixed_view::<2, 2>(0, 0) * before.fixed_view::<2, 2>(0, 0);
    let mut a = Matrix3::zeros();
    a.fixed_view_mut::<2, 2>(0, 0).copy_from(&free);
    a.fixed_view_mut::<2, 1>(0, 2).copy_from(&last);
    (a, Vector3::new(after[(0, 2)], after[(1, 2)], 1.0))
}

/// Solution P of the Riccati equation P = A'PA - A'PB (r + B'PB)^-1 B'PA + Q and the row K of u = K x.
///
/// Value iteration from Q; `None` if it has not converged to 1e-12 after 100 000 steps.
fn riccati(
    a: &Matrix3<f64>,
    b: &Vector3<f64>,
    q: &Matrix3<f64>,
    r: f64,
) -> Option<(Matrix3<f64>, RowVector3<f64>)> {
    let mut p = *q;
    for _ in 0..100_000 {
        let pb = p * b;
        let k = -(pb.transpose() * a) / (r + b.dot(&pb));
        let closed = a + b * k;
        let next = closed.transpose() * p * closed + q + k.transpose() * k * r;
        let change = (next - p).amax();
        p = (next + next.transpose()) * 0.5;
        if change < 1e-12 * p.amax() {
            return Some((p, k));
        }
    }
    None
}

/// [k_pos, k_vel, k_last] for the cost e^2 + (v / `velocity_rad_s`)^2 + (u / `input_rad_s2`)^2 per period.
pub fn gains(period_s: f64, delay_s: f64, velocity_per_rad: f64, input_per_rad: f64) -> Option<[f32; 3]> {
    let (a, b) = plant(period_s, delay_s);
    let q = Matrix3::from_diagonal(&Vector3::new(1.0, velocity_per_rad.powi(-2), 0.0));
    let (_, k) = riccati(&a, &b, &q, input_per_rad.powi(-2))?;
    Some([k[0] as f32, k[1] as f32, k[2] as f32])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn riccati_equation_holds_and_the_loop_is_stable() {
        let (a, b) = plant(0.017, 0.017);
        let q = Matrix3::from_diagonal(&Vector3::new(1.0, 0.01, 0.0));
        let r = 1e-6;
        let (p, k) = riccati(&a, &b, &q, r).unwrap();
        let pb = p * b;
        let residual =
            a.transpose() * p * a - a.transpose() * pb * pb.transpose() * a / (r + b.dot(&pb)) + q - p;
        assert!(residual.amax() < 1e-9 * p.amax());
        let closed = a + b * k;
        assert!(closed.complex_eigenvalues().iter().all(|z| z.norm() < 1.0));
    }

    #[test]
    fn delay_free_limit_is_the_known_double_integrator_regulator() {
        // Continuous LQR of e^2 + (u/c)^2: k = [-c, -sqrt(2 c)].
        let c = 100.0;
        let k = gains(1e-4, 0.0, 1e9, c).unwrap();
        assert!((f64::from(k[0]) + c).abs() < 0.02 * c, "{k:?}");
        assert!((f64::from(k[1]) + (2.0 * c).sqrt()).abs() < 0.02 * (2.0 * c).sqrt(), "{k:?}");
    }
}

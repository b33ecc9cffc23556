//! Tracking error of one joint, sampled: what the controller's command does until its next command.
//!
//! The drive turns acceleration commands into a position target r (ramp generator) and follows it
//! with its own position loop:
//!
//! ```text
//!   r'' = a                                 a: acceleration command, held
//!   y'' = wn^2 (r - y) - 2 zeta wn y'       y: joint position
//! ```
//!
//! With a = u + (mean reference acceleration over the interval in which the command acts, seen
//! 2 zeta/wn later) the reference drops out and the same equations hold for the errors: for a
//! reference of piecewise linear acceleration the ideal target has r'' = q_ref''(t + 2 zeta/wn).
//! At the k-th sample the controller sees y, forms u_k, which acts from `delay` on; until then
//! u_(k-1) still acts. State, in this order (see [`STATES`]):
//!
//! | entry | meaning | unit |
//! |---|---|---|
//! | e | position error | rad |
//! | w | its difference over the last period | rad/s |
//! | u_last | last command | rad/s2 |
//! | s | lead of the target beyond the steady lag, r - y - (2 zeta/wn) y' | rad |
//! | p | velocity error beyond its difference, y' - w | rad/s |
//! | d | r' - y' | rad/s |
//!
//! s, p and d vanish in steady motion; written like this the states are nearly independent, which
//! the semidefinite programs need (with r - y and y' themselves the solver lost its way).
//!
//! The controller knows the first three only; its gain row is [k_pos, k_vel, k_last].

use nalgebra::{Matrix6, RowVector6, SMatrix, SVector, Vector6};

/// Number of states of the sampled model.
pub const STATES: usize = 6;

/// Position loop of a drive, y/r = wn^2 / (s^2 + 2 zeta wn s + wn^2).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriveLag {
    /// Natural frequency, rad/s, > 0.
    pub wn_rad_s: f64,
    /// Damping ratio, > 0.
    pub zeta: f64,
}

impl DriveLag {
    /// The drive of the robot model: 320 rad/s, 0.8 (5 ms behind a ramp).
    pub const POWERCUBE: Self = Self { wn_rad_s: 320.0, zeta: 0.8 };

    /// How far the position runs behind a steady ramp, s: 2 zeta / wn.
    pub fn lag_s(&self) -> f64 {
        2.0 * self.zeta / self.wn_rad_s
    }
}

/// x_(k+1) = A x_k + B u_k over one period.
#[derive(Clone, Debug, PartialEq)]
pub struct Sampled {
    /// 6 x 6.
    pub a: Matrix6<f64>,
    /// 6 x 1.
    pub b: Vector6<f64>,
    /// Bound of the rounding error of each entry, relative to the largest entry of `a` and `b`.
    pub relative_error: f64,
}

/// Rounding bound of [`sampled`]: products of a few matrices with entries of order one after time
/// scaling, each at 1e-15; compared with a second evaluation in the tests.
const SAMPLED_RELATIVE_ERROR: f64 = 1e-12;

/// Exact discretisation for a period and a delay of its command, 0 <= delay <= period, both in s.
///
/// Arguments outside give the model of the nearest delay inside.
pub fn sampled(drive: &DriveLag, period_s: f64, delay_s: f64) -> Sampled {
    let delay_s = delay_s.clamp(0.0, period_s);
    // z = [r, r', y, y'], driven by a constant acceleration for each part of the period.
    let (f1, g1) = hold(drive, delay_s);
    let (f2, g2) = hold(drive, period_s - delay_s);
    let f = f2 * f1;
    let g_last = f2 * g1;
    // x from z = [r r' y y' w u_last], first in the order of z, then permuted and differenced.
    let mut a = Matrix6::zeros();
    a.fixed_view_mut::<4, 4>(0, 0).copy_from(&f);
    a.fixed_view_mut::<4, 1>(0, 5).copy_from(&g_last);
    let mut b = Vector6::zeros();
    b.fixed_rows_mut::<4>(0).copy_from(&g2);
    b[5] = 1.0;
    // w+ = (y+ - y) / T.
    let y_row = a.row(2) / period_s;
    a.row_mut(4).copy_from(&y_row);
    a[(4, 2)] -= 1.0 / period_s;
    b[4] = b[2] / period_s;
    let (to_x, from_x) = coordinates(drive.lag_s());
    Sampled { a: to_x * a * from_x, b: to_x * b, relative_error: SAMPLED_RELATIVE_ERROR }
}

/// x = S z and z = S^-1 x for z = [r, r', y, y', w, u_last].
#[rustfmt::skip]
fn coordinates(lag_s: f64) -> (Matrix6<f64>, Matrix6<f64>) {
    let l = lag_s;
    let to_x = Matrix6::new(
        0.0, 0.0,  1.0,  0.0,  0.0, 0.0,
        0.0, 0.0,  0.0,  0.0,  1.0, 0.0,
        0.0, 0.0,  0.0,  0.0,  0.0, 1.0,
        1.0, 0.0, -1.0,   -l,  0.0, 0.0,
        0.0, 0.0,  0.0,  1.0, -1.0, 0.0,
        0.0, 1.0,  0.0, -1.0,  0.0, 0.0,
    );
    let from_x = Matrix6::new(
        1.0,   l, 0.0, 1.0,   l, 0.0,
        0.0, 1.0, 0.0, 0.0, 1.0, 1.0,
        1.0, 0.0, 0.0, 0.0, 0.0, 0.0,
        0.0, 1.0, 0.0, 0.0, 1.0, 0.0,
        0.0, 1.0, 0.0, 0.0, 0.0, 0.0,
        0.0, 0.0, 1.0, 0.0, 0.0, 0.0,
    );
    (to_x, from_x)
}

/// Row on the state for feedback u = k_r r + k_v r' + k_u u_last of the drive's target.
pub fn target_row(drive: &DriveLag, [k_r, k_v, k_u]: [f64; 3]) -> RowVector6<f64> {
    let v = k_r * drive.lag_s() + k_v;
    RowVector6::new(k_r, v, k_u, k_r, v, k_v)
}

/// z(t) = F z(0) + G a for constant a; z = [r, r', y, y'].
fn hold(drive: &DriveLag, t_s: f64) -> (SMatrix<f64, 4, 4>, SVector<f64, 4>) {
    let (wn, zeta) = (drive.wn_rad_s, drive.zeta);
    // Time in units of 1/wn, velocities as v/wn, acceleration as a/wn^2: all entries of order one.
    #[rustfmt::skip]
    let m = SMatrix::<f64, 5, 5>::from_row_slice(&[
        0.0, 1.0,  0.0,         0.0, 0.0,
        0.0, 0.0,  0.0,         0.0, 1.0,
        0.0, 0.0,  0.0,         1.0, 0.0,
        1.0, 0.0, -1.0, -2.0 * zeta, 0.0,
        0.0, 0.0,  0.0,         0.0, 0.0,
    ]);
    let e = exponential(&(m * (wn * t_s)));
    let unit = [1.0, wn, 1.0, wn];
    let f = SMatrix::from_fn(|i, j| e[(i, j)] * unit[i] / unit[j]);
    let g = SVector::from_fn(|i, _| e[(i, 4)] * unit[i] / (wn * wn));
    (f, g)
}

/// Matrix exponential: Taylor series of the argument scaled below 1/4, then squaring.
pub fn exponential<const N: usize>(m: &SMatrix<f64, N, N>) -> SMatrix<f64, N, N> {
    let norm = m.column_iter().map(|column| column.abs().sum()).fold(0.0, f64::max);
    let squarings = if norm > 0.25 { (norm / 0.25).log2().ceil() as i32 } else { 0 };
    let scaled = m / 2f64.powi(squarings);
    let (mut sum, mut term) = (SMatrix::identity(), SMatrix::identity());
    // 0.25^18 / 18! < 1e-26: beyond f64.
    for k in 1..=18 {
        term = term * scaled / f64::from(k);
        sum += term;
    }
    for _ in 0..squarings {
        sum *= sum;
    }
    sum
}

/// State of a joint whose target and position move together at constant velocity error.
///
/// Such a joint has run long enough for the drive's transient to be over: the position lags the
/// target by 2 zeta/wn times the velocity.
pub fn steady_state(position_rad: f64, velocity_rad_s: f64) -> Vector6<f64> {
    Vector6::new(position_rad, velocity_rad_s, 0.0, 0.0, 0.0, 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Integrates the drive with 4th-order steps: an independent way to the same numbers.
    fn integrate(drive: &DriveLag, z: [f64; 4], a: f64, t: f64) -> [f64; 4] {
        let steps = 4000;
        let h = t / f64::from(steps);
        let (wn, ze) = (drive.wn_rad_s, drive.zeta);
        let d = |z: [f64; 4]| [z[1], a, z[3], wn * wn * (z[0] - z[2]) - 2.0 * ze * wn * z[3]];
        let add = |z: [f64; 4], k: [f64; 4], h: f64| std::array::from_fn(|i| z[i] + h * k[i]);
        let mut z = z;
        for _ in 0..steps {
            let k1 = d(z);
            let k2 = d(add(z, k1, h / 2.0));
            let k3 = d(add(z, k2, h / 2.0));
            let k4 = d(add(z, k3, h));
            z = std::array::from_fn(|i| z[i] + h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]));
        }
        z
    }

    #[test]
    fn sampled_model_equals_the_integrated_drive() {
        let drive = DriveLag::POWERCUBE;
        for (period, delay) in [(0.017, 0.017), (0.017, 0.009), (0.002, 0.0015), (0.003, 0.0)] {
            let model = sampled(&drive, period, delay);
            let x = Vector6::new(0.08, -0.3, 2.0, 0.004, -0.25, 0.1);
            let u = -1.5;
            let (y, dy) = (x[0], x[1] + x[4]);
            let r = y + drive.lag_s() * dy + x[3];
            let z = integrate(&drive, [r, dy + x[5], y, dy], x[2], delay);
            let z = integrate(&drive, z, u, period - delay);
            let next = model.a * x + model.b * u;
            let w = (z[2] - y) / period;
            let want = [z[2], w, u, z[0] - z[2] - drive.lag_s() * z[3], z[3] - w, z[1] - z[3]];
            let row = target_row(&drive, [2.0, 3.0, 5.0]);
            assert!(((row * next)[0] - (2.0 * z[0] + 3.0 * z[1] + 5.0 * u)).abs() < 1e-9);
            for i in 0..6 {
                assert!(
                    (next[i] - want[i]).abs() < 1e-9 * (1.0 + want[i].abs()),
                    "{i}: {} {}",
                    next[i],
                    want[i]
                );
            }
        }
    }

    #[test]
    fn rounding_stays_far_below_the_stated_bound() {
        // The same period in two halves must compose: exp is evaluated differently then.
        let drive = DriveLag::POWERCUBE;
        for t in [0.001, 0.0085, 0.017, 0.05] {
            let (whole, _) = hold(&drive, t);
            let (half, _) = hold(&drive, t / 2.0);
            let difference = (half * half - whole).amax() / whole.amax();
            assert!(difference < 0.01 * SAMPLED_RELATIVE_ERROR, "{t}: {difference:e}");
        }
    }

    #[test]
    fn steady_error_moves_on_without_a_transient() {
        let drive = DriveLag::POWERCUBE;
        let x = steady_state(0.02, 0.4);
        let next = sampled(&drive, 0.01, 0.005).a * x;
        let want = steady_state(0.02 + 0.4 * 0.01, 0.4);
        assert!((next - want).amax() < 1e-12);
    }
}

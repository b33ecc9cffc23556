//! Tracking error of one joint, sampled: effect of the controller's command until its next command.
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
//! At the k-th sample the controller measures y, and its estimator (`firmware::feedback`, there `e_rad` and
//! `de_rad_s`) processes it:
//!
//! ```text
//!   e~- = e~ + T w + T^2/2 u_last    w- = w + T u_last      as if u_last had acted all the time
//!   e~  = e~- + alpha (y - e~-)      w  = w- + beta/T (y - e~-)
//! ```
//!
//! Then it forms u_k = sat(k_pos e~ + k_vel w + k_last u_last), which acts from `delay` on; until then u_last = u_(k-1)
//! still acts. State, in this order (see [`STATES`]):
//!
//! | entry | meaning | unit |
//! |---|---|---|
//! | e | position error | rad |
//! | w | estimated rate of it | rad/s |
//! | u_last | last command | rad/s2 |
//! | s | lead of the target beyond the steady lag, r - y - (2 zeta/wn) y' | rad |
//! | p | velocity error beyond its estimate, y' - w | rad/s |
//! | d | r' - y' | rad/s |
//! | c | error of the estimated position, e~ - e | rad |
//!
//! s, p, d and c vanish in steady motion. In this form the states are nearly independent, which the semidefinite
//! programs need (with r - y and y' themselves the solver did not converge).
//!
//! The controller knows e + c, w and u_last only; its gain row is [k_pos, k_vel, k_last].
//!
//! Left out: friction, the rounding of positions (0.02 degrees), the velocity limit of the ramp generator, lost replies,
//! coupling between joints. They are in the trials on the simulated cell ([`crate::gains::trial`]), which are evidence, not proof.

use nalgebra::{RowSVector, SMatrix, SVector};
use serde::{Deserialize, Serialize};

/// Number of states of the sampled model.
pub const STATES: usize = 7;

pub type StateVector = SVector<f64, STATES>;
pub type StateMatrix = SMatrix<f64, STATES, STATES>;
pub type StateRow = RowSVector<f64, STATES>;

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

/// Weights of the controller's estimator of the error (registers `estimator.alpha` and `estimator.beta`).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Estimator {
    /// Of a measurement on the position error, 0..=1.
    pub alpha: f64,
    /// On its rate, 0..=1.
    pub beta: f64,
}

/// From this period on, s, measurements are so far apart that their differences need no averaging.
const PLAIN_PERIOD_S: f64 = 0.01;

impl Estimator {
    /// Every measurement as it is: difference of the errors, carried on to the sample by the command.
    pub const PLAIN: Self = Self { alpha: 1.0, beta: 1.0 };
    /// The firmware's built-in weights: positions come in steps of 0.02 degrees, which a short period makes 0.1 rad/s.
    pub const AVERAGING: Self = Self { alpha: 0.6, beta: 0.2 };

    /// What the firmware's settings use at a period.
    pub fn usual(period_s: f64) -> Self {
        if period_s >= PLAIN_PERIOD_S { Self::PLAIN } else { Self::AVERAGING }
    }
}

/// x_(k+1) = A x_k + B u_k over one period.
#[derive(Clone, Debug, PartialEq)]
pub struct Sampled {
    /// 7 x 7.
    pub a: StateMatrix,
    /// 7 x 1.
    pub b: StateVector,
    /// Bound of the rounding error of each entry, relative to the largest entry of `a` and `b`.
    pub relative_error: f64,
}

/// Rounding bound of [`sampled`]: products of a few matrices with entries of order one after time
/// scaling, each at 1e-15; compared with a second evaluation in the tests.
const SAMPLED_RELATIVE_ERROR: f64 = 1e-12;

/// Exact discretisation for a period and a delay of its command, 0 <= delay <= period, both in s.
///
/// Arguments outside give the model of the nearest delay inside.
pub fn sampled(drive: &DriveLag, estimator: &Estimator, period_s: f64, delay_s: f64) -> Sampled {
    let delay_s = delay_s.clamp(0.0, period_s);
    // z = [r, r', y, y'], driven by a constant acceleration for each part of the period.
    let (f1, g1) = hold(drive, delay_s);
    let (f2, g2) = hold(drive, period_s - delay_s);
    let f = f2 * f1;
    let g_last = f2 * g1;
    // In the order z = [r r' y y' e~ w u_last] first.
    let mut a = StateMatrix::zeros();
    a.fixed_view_mut::<4, 4>(0, 0).copy_from(&f);
    a.fixed_view_mut::<4, 1>(0, 6).copy_from(&g_last);
    let mut b = StateVector::zeros();
    b.fixed_rows_mut::<4>(0).copy_from(&g2);
    b[6] = 1.0;
    let t = period_s;
    let predicted_e = StateRow::from_row_slice(&[0.0, 0.0, 0.0, 0.0, 1.0, t, 0.5 * t * t]);
    let predicted_w = StateRow::from_row_slice(&[0.0, 0.0, 0.0, 0.0, 0.0, 1.0, t]);
    let innovation = a.row(2) - predicted_e;
    a.set_row(4, &(predicted_e + innovation * estimator.alpha));
    a.set_row(5, &(predicted_w + innovation * (estimator.beta / t)));
    b[4] = estimator.alpha * b[2];
    b[5] = estimator.beta / t * b[2];
    let (to_x, from_x) = coordinates(drive.lag_s());
    Sampled { a: to_x * a * from_x, b: to_x * b, relative_error: SAMPLED_RELATIVE_ERROR }
}

/// x = S z and z = S^-1 x for z = [r, r', y, y', e~, w, u_last].
#[rustfmt::skip]
fn coordinates(lag_s: f64) -> (StateMatrix, StateMatrix) {
    let l = lag_s;
    let to_x = StateMatrix::from_row_slice(&[
        0.0, 0.0,  1.0,  0.0, 0.0,  0.0, 0.0,
        0.0, 0.0,  0.0,  0.0, 0.0,  1.0, 0.0,
        0.0, 0.0,  0.0,  0.0, 0.0,  0.0, 1.0,
        1.0, 0.0, -1.0,   -l, 0.0,  0.0, 0.0,
        0.0, 0.0,  0.0,  1.0, 0.0, -1.0, 0.0,
        0.0, 1.0,  0.0, -1.0, 0.0,  0.0, 0.0,
        0.0, 0.0, -1.0,  0.0, 1.0,  0.0, 0.0,
    ]);
    let from_x = StateMatrix::from_row_slice(&[
        1.0,   l, 0.0, 1.0,   l, 0.0, 0.0,
        0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0,
        1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
        0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0,
        1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0,
        0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0,
        0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0,
    ]);
    (to_x, from_x)
}

/// Row on the state for feedback u = k_r r + k_v r' + k_u u_last of the drive's target.
pub fn target_row(drive: &DriveLag, [k_r, k_v, k_u]: [f64; 3]) -> StateRow {
    let v = k_r * drive.lag_s() + k_v;
    StateRow::from_row_slice(&[k_r, v, k_u, k_r, v, k_v, 0.0])
}

/// Row on the state for feedback of what the controller knows: its estimates and its last command.
pub fn known_row([k_pos, k_vel, k_last]: [f64; 3]) -> StateRow {
    StateRow::from_row_slice(&[k_pos, k_vel, k_last, 0.0, 0.0, 0.0, k_pos])
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
/// Such a joint has run long enough for the drive's transient to be over: the position lags the target by 2 zeta/wn
/// times the velocity, and the estimator knows both. A joint that stands at the start of a plan is in this state.
pub fn steady_state(position_rad: f64, velocity_rad_s: f64) -> StateVector {
    StateVector::from_column_slice(&[position_rad, velocity_rad_s, 0.0, 0.0, 0.0, 0.0, 0.0])
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
            for estimator in [Estimator::PLAIN, Estimator::AVERAGING] {
                let model = sampled(&drive, &estimator, period, delay);
                let x = StateVector::from_column_slice(&[0.08, -0.3, 2.0, 0.004, -0.25, 0.1, 0.003]);
                let (u, u_last) = (-1.5, x[2]);
                let (y, dy) = (x[0], x[1] + x[4]);
                let r = y + drive.lag_s() * dy + x[3];
                let z = integrate(&drive, [r, dy + x[5], y, dy], u_last, delay);
                let z = integrate(&drive, z, u, period - delay);
                let next = model.a * x + model.b * u;
                let (e, w) = (x[0] + x[6] + period * (x[1] + 0.5 * period * u_last), x[1] + period * u_last);
                let (e, w) = (e + estimator.alpha * (z[2] - e), w + estimator.beta / period * (z[2] - e));
                let lead = z[0] - z[2] - drive.lag_s() * z[3];
                let want = [z[2], w, u, lead, z[3] - w, z[1] - z[3], e - z[2]];
                let row = target_row(&drive, [2.0, 3.0, 5.0]);
                assert!(((row * next)[0] - (2.0 * z[0] + 3.0 * z[1] + 5.0 * u)).abs() < 1e-9);
                let row = known_row([2.0, 3.0, 5.0]);
                assert!(((row * next)[0] - (2.0 * e + 3.0 * w + 5.0 * u)).abs() < 1e-9);
                for i in 0..STATES {
                    let (found, want) = (next[i], want[i]);
                    assert!((found - want).abs() < 1e-9 * (1.0 + want.abs()), "{i}: {found} {want}");
                }
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
        for estimator in [Estimator::PLAIN, Estimator::AVERAGING] {
            let next = sampled(&drive, &estimator, 0.01, 0.005).a * x;
            let want = steady_state(0.02 + 0.4 * 0.01, 0.4);
            assert!((next - want).amax() < 1e-12);
        }
    }
}

//! Free rotation of a thing with an axis of symmetry, in closed form.
//!
//! No torque acts in flight (Euler's equations with zero on the right). With `I_a` about the axis `n` and `I_t` across it,
//! the angular momentum over `I_t` is constant:
//!
//! ```text
//! l = ω + (I_a/I_t - 1) (ω·n) n        in rad/s, world
//! ṅ = l × n                            so the axis turns about l at |l|:  n(t) = exp([l] t) n(0)
//! ```

use nalgebra::{Matrix3, Rotation3, Vector3};

/// Rotation of a thing from the instant at which it is free.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Precession {
    /// Axis of symmetry at the release, unit vector, world.
    pub axis: Vector3<f64>,
    /// Angular momentum over the transverse moment of inertia in rad/s, world; constant.
    pub momentum_rad_s: Vector3<f64>,
    /// Derivatives of the momentum by the angular velocity, and by the axis in 1/s.
    momentum_by_omega: Matrix3<f64>,
    momentum_by_axis: Matrix3<f64>,
}

/// The axis some time after the release, with its derivatives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AxisState {
    /// Unit vector, world.
    pub axis: Vector3<f64>,
    /// By the angular velocity at the release, in s.
    pub by_omega: Matrix3<f64>,
    /// By the axis at the release.
    pub by_axis: Matrix3<f64>,
    /// By the time, in 1/s.
    pub by_time: Vector3<f64>,
}

impl Precession {
    /// From the axis (unit vector) and the angular velocity (rad/s) at the release, both in the world, and the moment of
    /// inertia about the axis over that across it (0 to 2).
    #[must_use]
    pub fn new(axis: &Vector3<f64>, omega_rad_s: &Vector3<f64>, inertia_ratio: f64) -> Self {
        let more = inertia_ratio - 1.0;
        let along = omega_rad_s.dot(axis);
        Self {
            axis: *axis,
            momentum_rad_s: omega_rad_s + axis * (more * along),
            momentum_by_omega: Matrix3::identity() + axis * axis.transpose() * more,
            momentum_by_axis: (axis * omega_rad_s.transpose() + Matrix3::identity() * along) * more,
        }
    }

    /// The axis `time_s` after the release.
    #[must_use]
    pub fn axis_at(&self, time_s: f64) -> Vector3<f64> {
        Rotation3::from_scaled_axis(self.momentum_rad_s * time_s) * self.axis
    }

    /// The axis `time_s` after the release, with derivatives.
    #[must_use]
    pub fn state_at(&self, time_s: f64) -> AxisState {
        let turn = self.momentum_rad_s * time_s;
        let rotation = Rotation3::from_scaled_axis(turn).into_inner();
        let axis = rotation * self.axis;
        // A change dl of the momentum turns the rotation by J dl t further, J the left Jacobian of the rotation group.
        let by_momentum = -axis.cross_matrix() * left_jacobian(&turn) * time_s;
        AxisState {
            axis,
            by_omega: by_momentum * self.momentum_by_omega,
            by_axis: rotation + by_momentum * self.momentum_by_axis,
            by_time: self.momentum_rad_s.cross(&axis),
        }
    }

    /// Derivative of the momentum by the angular velocity at the release.
    #[must_use]
    pub fn momentum_by_omega(&self) -> &Matrix3<f64> {
        &self.momentum_by_omega
    }

    /// Derivative of the momentum by the axis at the release, in rad/s.
    #[must_use]
    pub fn momentum_by_axis(&self) -> &Matrix3<f64> {
        &self.momentum_by_axis
    }
}

/// Below this angle in rad the series is exact to rounding.
const SMALL_RAD: f64 = 1e-2;

/// `∫₀¹ exp([turn] s) ds`.
fn left_jacobian(turn: &Vector3<f64>) -> Matrix3<f64> {
    let angle = turn.norm();
    let square = angle * angle;
    let (first, second) = if angle < SMALL_RAD {
        (0.5 - square / 24.0 + square * square / 720.0, 1.0 / 6.0 - square / 120.0 + square * square / 5040.0)
    } else {
        ((1.0 - angle.cos()) / square, (angle - angle.sin()) / (square * angle))
    };
    let cross = turn.cross_matrix();
    Matrix3::identity() + cross * first + cross * cross * second
}

#[cfg(test)]
mod tests {
    use nalgebra::{Quaternion, UnitQuaternion};

    use super::*;

    /// Axis in the world by Euler's equations in the body (z is the axis of symmetry), Runge-Kutta of fourth order.
    fn integrated(body: UnitQuaternion<f64>, omega_w: Vector3<f64>, ratio: f64, time_s: f64) -> Vector3<f64> {
        let rate = |q: &Quaternion<f64>, w: &Vector3<f64>| {
            let turned = q * Quaternion::from_imag(*w) * 0.5;
            (turned, Vector3::new((1.0 - ratio) * w.y * w.z, (ratio - 1.0) * w.z * w.x, 0.0))
        };
        let (mut q, mut w) = (body.into_inner(), body.inverse() * omega_w);
        let steps = 4000;
        let h = time_s / f64::from(steps);
        for _ in 0..steps {
            let a = rate(&q, &w);
            let b = rate(&(q + a.0 * (0.5 * h)), &(w + a.1 * (0.5 * h)));
            let c = rate(&(q + b.0 * (0.5 * h)), &(w + b.1 * (0.5 * h)));
            let d = rate(&(q + c.0 * h), &(w + c.1 * h));
            q += (a.0 + (b.0 + c.0) * 2.0 + d.0) * (h / 6.0);
            w += (a.1 + (b.1 + c.1) * 2.0 + d.1) * (h / 6.0);
        }
        UnitQuaternion::new_normalize(q) * Vector3::z()
    }

    #[test]
    fn the_closed_form_is_the_integral_of_eulers_equations() {
        let body = UnitQuaternion::from_euler_angles(0.4, -0.7, 1.1);
        let axis = body * Vector3::z();
        for omega in [
            Vector3::new(3.0, -5.0, 2.0),
            Vector3::zeros(),
            // Along the axis: it stays.
            axis * 6.0,
            // Hardly any rotation: the series.
            Vector3::new(1e-3, 2e-3, -1e-3),
        ] {
            for ratio in [0.0, 0.1, 1.0, 1.8, 2.0] {
                let closed = Precession::new(&axis, &omega, ratio).axis_at(0.9);
                let stepped = integrated(body, omega, ratio, 0.9);
                assert!((closed - stepped).norm() < 1e-9, "{omega} {ratio}: {closed} {stepped}");
            }
        }
        let at_rest = Precession::new(&axis, &Vector3::zeros(), 1.8);
        assert!((at_rest.axis_at(2.0) - axis).norm() < 1e-15);
        let along = Precession::new(&axis, &(axis * 6.0), 1.8);
        assert!((along.axis_at(2.0) - axis).norm() < 1e-14);
        assert!((along.momentum_rad_s - axis * 10.8).norm() < 1e-12);
    }

    #[test]
    fn a_thing_with_equal_moments_turns_about_its_angular_velocity() {
        let (axis, omega) = (Vector3::x(), Vector3::new(1.0, 2.0, -0.5));
        let ball = Precession::new(&axis, &omega, 1.0);
        assert!((ball.momentum_rad_s - omega).norm() < 1e-15);
    }

    #[test]
    fn derivatives_of_axis_and_momentum_match_differences() {
        let axis = Vector3::new(0.3, -0.5, 0.8).normalize();
        for (omega, ratio) in [
            (Vector3::new(3.0, -2.0, 1.0), 1.8),
            (Vector3::new(-1.0, 0.5, 4.0), 0.1),
            (Vector3::zeros(), 1.8),
            (Vector3::new(2e-3, 1e-3, 3e-3), 0.4),
        ] {
            let (t, eps) = (0.7, 1e-6);
            let here = Precession::new(&axis, &omega, ratio);
            let state = here.state_at(t);
            let close = |claimed: Vector3<f64>, differenced: Vector3<f64>, what: &str| {
                assert!((claimed - differenced).norm() < 1e-7, "{what} {omega}: {claimed} {differenced}");
            };
            for i in 0..3 {
                let mut step = Vector3::zeros();
                step[i] = eps;
                let at = |sign: f64| Precession::new(&axis, &(omega + step * sign), ratio);
                let (hi, lo) = (at(1.0), at(-1.0));
                close(
                    state.by_omega.column(i).into(),
                    (hi.axis_at(t) - lo.axis_at(t)) / (2.0 * eps),
                    "by omega",
                );
                close(
                    here.momentum_by_omega().column(i).into(),
                    (hi.momentum_rad_s - lo.momentum_rad_s) / (2.0 * eps),
                    "momentum by omega",
                );
                // The formulas hold for an axis of any length, so one coordinate may be changed alone.
                let at = |sign: f64| Precession::new(&(axis + step * sign), &omega, ratio);
                let (hi, lo) = (at(1.0), at(-1.0));
                close(
                    state.by_axis.column(i).into(),
                    (hi.axis_at(t) - lo.axis_at(t)) / (2.0 * eps),
                    "by axis",
                );
                close(
                    here.momentum_by_axis().column(i).into(),
                    (hi.momentum_rad_s - lo.momentum_rad_s) / (2.0 * eps),
                    "momentum by axis",
                );
            }
            close(state.by_time, (here.axis_at(t + eps) - here.axis_at(t - eps)) / (2.0 * eps), "by time");
        }
    }
}

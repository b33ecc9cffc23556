//! The cubic between two states: position and velocity at both ends.
//!
//! The one evaluator of the host: motions of joints, flights on a grid, references of the tuner. Other evaluators
//! exist for a reason: the controller has one in single precision, the verifier of the planner shares no formula
//! with it, and the planner's own throw has the release as origin and derivatives by its variables.

use std::ops::{Add, Div, Mul, Sub};

/// Quantities that a cubic can lead: numbers and vectors.
pub trait Quantity:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<f64, Output = Self> + Div<f64, Output = Self>
{
}

impl<T> Quantity for T where
    T: Copy + Add<Output = T> + Sub<Output = T> + Mul<f64, Output = T> + Div<f64, Output = T>
{
}

/// `x = x₀ + τ (c₁ + τ (c₂ + τ c₃))` with `τ = t / h` for `t` from 0 to `h`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cubic<T> {
    h_s: f64,
    x0: T,
    c1: T,
    c2: T,
    c3: T,
}

impl<T: Quantity> Cubic<T> {
    /// The cubic that leads from `(position, velocity)` to another such pair within `h_s`, above 0.
    #[must_use]
    pub fn between(h_s: f64, (x0, v0): (T, T), (x1, v1): (T, T)) -> Self {
        let way = x1 - x0;
        let (p0, p1) = (v0 * h_s, v1 * h_s);
        Self { h_s, x0, c1: p0, c2: way * 3.0 - p0 * 2.0 - p1, c3: p0 + p1 - way * 2.0 }
    }

    /// Position `t_s` after the start.
    #[must_use]
    pub fn position(&self, t_s: f64) -> T {
        let tau = t_s / self.h_s;
        self.x0 + (self.c1 + (self.c2 + self.c3 * tau) * tau) * tau
    }

    /// Velocity, per s.
    #[must_use]
    pub fn velocity(&self, t_s: f64) -> T {
        let tau = t_s / self.h_s;
        (self.c1 + (self.c2 * 2.0 + self.c3 * (3.0 * tau)) * tau) / self.h_s
    }

    /// Acceleration, per s².
    #[must_use]
    pub fn acceleration(&self, t_s: f64) -> T {
        (self.c2 * 2.0 + self.c3 * (6.0 * (t_s / self.h_s))) / (self.h_s * self.h_s)
    }

    /// Jerk, per s³; the same at all times.
    #[must_use]
    pub fn jerk(&self) -> T {
        self.c3 * 6.0 / (self.h_s * self.h_s * self.h_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cubic_meets_both_ends_and_its_derivatives_are_those_of_its_position() {
        let cubic = Cubic::between(0.4, (1.0, -2.0), (0.3, 5.0));
        let ends = [cubic.position(0.0), cubic.velocity(0.0), cubic.position(0.4), cubic.velocity(0.4)];
        for (got, wanted) in ends.into_iter().zip([1.0, -2.0, 0.3, 5.0_f64]) {
            assert!((got - wanted).abs() < 1e-14, "{ends:?}");
        }
        let dt = 1e-5;
        for t in [0.05, 0.2, 0.33] {
            let slope = |f: &dyn Fn(f64) -> f64| (f(t + dt) - f(t - dt)) / (2.0 * dt);
            assert!((slope(&|t| cubic.position(t)) - cubic.velocity(t)).abs() < 1e-6);
            assert!((slope(&|t| cubic.velocity(t)) - cubic.acceleration(t)).abs() < 1e-6);
            assert!((slope(&|t| cubic.acceleration(t)) - cubic.jerk()).abs() < 1e-6);
        }
    }

    #[test]
    fn a_known_cubic_is_given_back() {
        let cubic = Cubic::between(2.0, (0.0, 0.0), (8.0, 12.0));
        for t in [0.0, 0.5, 1.0, 1.7_f64] {
            assert!((cubic.position(t) - t.powi(3)).abs() < 1e-14);
        }
    }
}

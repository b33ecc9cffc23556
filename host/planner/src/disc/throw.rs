//! A thrown disc: where it starts and how fast, and the two throws of the paper.

use nalgebra::Vector3;

/// Gravity of the paper, m/s².
pub const GRAVITY_M_S2: f64 = 9.81;

/// A thrown disc.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Throw {
    /// Centre at time 0, m.
    pub start_m: Vector3<f64>,
    /// Velocity at time 0, m/s.
    pub velocity_m_s: Vector3<f64>,
}

impl Throw {
    /// Scenario 1, flat: (50, -100, 120) cm, (0, 400, 0) cm/s.
    #[must_use]
    pub fn flat() -> Self {
        Self { start_m: Vector3::new(0.5, -1.0, 1.2), velocity_m_s: Vector3::new(0.0, 4.0, 0.0) }
    }

    /// Scenario 2, oblique: (50, -100, 105) cm, (-200, 400, 100) cm/s.
    #[must_use]
    pub fn oblique() -> Self {
        Self { start_m: Vector3::new(0.5, -1.0, 1.05), velocity_m_s: Vector3::new(-2.0, 4.0, 1.0) }
    }

    /// Centre of the disc on its parabola, m.
    #[must_use]
    pub fn at(&self, t_s: f64) -> Vector3<f64> {
        self.start_m + self.velocity_m_s * t_s - Vector3::z() * (0.5 * GRAVITY_M_S2 * t_s * t_s)
    }
}

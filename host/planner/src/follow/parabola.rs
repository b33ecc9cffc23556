//! The flight of the ball in vacuum (paper 000, equations 1 to 4).

use nalgebra::Vector3;

/// A flight in vacuum: position and velocity at t = 0, gravity along -z of the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parabola {
    /// Position at t = 0 in m.
    pub p0: Vector3<f64>,
    /// Velocity at t = 0 in m/s.
    pub v0: Vector3<f64>,
    /// Gravity in m/s², positive.
    pub gravity_m_s2: f64,
}

impl Parabola {
    /// The flight from `p0` that is at `target` after `flight_s`.
    #[must_use]
    pub fn through(p0: Vector3<f64>, target: Vector3<f64>, flight_s: f64, gravity_m_s2: f64) -> Self {
        let v0 = (target - p0) / flight_s + Vector3::z() * (0.5 * gravity_m_s2 * flight_s);
        Self { p0, v0, gravity_m_s2 }
    }

    /// The flight from `p0` to `target` that leaves under the angle `beta_rad` to the horizontal (equation 4).
    ///
    /// `None` if the straight line under this angle passes below the target, or the target is above or below `p0`.
    #[must_use]
    pub(crate) fn with_angle(
        p0: Vector3<f64>,
        target: Vector3<f64>,
        beta_rad: f64,
        gravity_m_s2: f64,
    ) -> Option<Self> {
        let (x, y) = ((target - p0).xy().norm(), target.z - p0.z);
        let (sin, cos) = beta_rad.sin_cos();
        let above = x * sin - y * cos;
        if x < 1e-9 || cos < 1e-9 || above <= 0.0 {
            return None;
        }
        // y = x tan β - g x² / (2 v0² cos² β), solved for v0.
        let speed = x * (gravity_m_s2 / (2.0 * cos * above)).sqrt();
        Some(Self::through(p0, target, x / (speed * cos), gravity_m_s2))
    }

    /// Position at `t_s`.
    #[must_use]
    pub fn position(&self, t_s: f64) -> Vector3<f64> {
        self.p0 + self.v0 * t_s - Vector3::z() * (0.5 * self.gravity_m_s2 * t_s * t_s)
    }

    /// Velocity at `t_s`.
    #[must_use]
    pub fn velocity(&self, t_s: f64) -> Vector3<f64> {
        self.v0 - Vector3::z() * (self.gravity_m_s2 * t_s)
    }

    /// The same flight with t = 0 moved to `t_s`.
    #[must_use]
    pub fn from_time(&self, t_s: f64) -> Self {
        Self { p0: self.position(t_s), v0: self.velocity(t_s), ..*self }
    }

    /// When the flight is at `target`, through which it passes, in s; by the horizontal way.
    #[must_use]
    pub fn time_to(&self, target: &Vector3<f64>) -> f64 {
        (target - self.p0).xy().norm() / self.v0.xy().norm()
    }

    /// Angle of the velocity at t = 0 to the horizontal, in rad; positive upwards.
    #[must_use]
    pub(crate) fn beta_rad(&self) -> f64 {
        self.v0.z.atan2(self.v0.xy().norm())
    }

    /// Angle between the velocity and the vertical at `t_s`, with its first and second derivative by time.
    #[must_use]
    pub fn polar(&self, t_s: f64) -> [f64; 3] {
        let (across, v) = (self.v0.xy().norm(), self.velocity(t_s));
        let (g, speed2) = (self.gravity_m_s2, v.norm_squared());
        let rate = across * g / speed2;
        [across.atan2(v.z), rate, 2.0 * rate * g * v.z / speed2]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const G: f64 = 9.81;

    #[test]
    fn the_flight_meets_its_target_at_its_time_and_under_its_angle() {
        let (p0, target) = (Vector3::new(0.7, -0.4, 1.3), Vector3::new(2.5, 0.2, 0.6));
        for beta_deg in [-10.0_f64, 0.0, 20.0, 45.0, 70.0] {
            let flight =
                Parabola::with_angle(p0, target, beta_deg.to_radians(), G).expect("above the target");
            assert!((flight.beta_rad().to_degrees() - beta_deg).abs() < 1e-9);
            let time = (target - p0).xy().norm() / flight.v0.xy().norm();
            assert!((flight.position(time) - target).norm() < 1e-12, "{beta_deg}");
        }
        assert!(Parabola::with_angle(p0, target, -0.7, G).is_none(), "the line passes below the target");
    }

    #[test]
    fn at_equal_heights_45_degrees_is_the_slowest_throw() {
        let (p0, target) = (Vector3::new(0.0, 0.0, 1.0), Vector3::new(2.0, 0.0, 1.0));
        let speed =
            |deg: f64| Parabola::with_angle(p0, target, deg.to_radians(), G).expect("in reach").v0.norm();
        assert!((speed(45.0) - (G * 2.0).sqrt()).abs() < 1e-12);
        assert!(speed(44.0) > speed(45.0) && speed(46.0) > speed(45.0));
    }

    #[test]
    fn the_turn_of_the_tangent_is_that_of_finite_differences() {
        let flight = Parabola { p0: Vector3::zeros(), v0: Vector3::new(2.0, 1.5, 2.2), gravity_m_s2: G };
        for t in [-0.1, 0.0, 0.3] {
            let h = 1e-4;
            let [at, before, after] = [t, t - h, t + h].map(|t| flight.polar(t));
            assert!(((after[0] - before[0]) / (2.0 * h) - at[1]).abs() < 1e-6);
            assert!(((after[1] - before[1]) / (2.0 * h) - at[2]).abs() < 1e-5);
        }
    }
}

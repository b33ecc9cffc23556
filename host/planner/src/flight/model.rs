//! Forces on the ball.

use nalgebra::{Matrix3, Vector3};

/// Forces that act on a flying ball; accelerations, so the mass is already divided out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FlightModel {
    gravity_m_s2: f64,
    drag_per_m: f64,
    magnus_rad_s: Vector3<f64>,
}

/// A flight model with a parameter outside its range.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum FlightModelError {
    /// Gravity is not a positive finite number.
    #[error("gravity must be positive and finite, got {0} m/s²")]
    Gravity(f64),
    /// Drag is negative or not finite.
    #[error("drag must be zero or positive and finite, got {0} 1/m")]
    Drag(f64),
    /// The Magnus vector is not finite.
    #[error("the Magnus vector must be finite")]
    Magnus,
}

impl FlightModel {
    /// Gravity along -z only, in m/s²; the paper's model.
    ///
    /// # Errors
    /// If gravity is not positive and finite.
    pub fn vacuum(gravity_m_s2: f64) -> Result<Self, FlightModelError> {
        if !(gravity_m_s2 > 0.0 && gravity_m_s2.is_finite()) {
            return Err(FlightModelError::Gravity(gravity_m_s2));
        }
        Ok(Self { gravity_m_s2, drag_per_m: 0.0, magnus_rad_s: Vector3::zeros() })
    }

    /// With quadratic drag `a = -k |v| v`, k in 1/m: `k = ρ c_d A / (2 m)`.
    ///
    /// # Errors
    /// If k is negative or not finite.
    pub fn with_drag(mut self, drag_per_m: f64) -> Result<Self, FlightModelError> {
        if !(drag_per_m >= 0.0 && drag_per_m.is_finite()) {
            return Err(FlightModelError::Drag(drag_per_m));
        }
        self.drag_per_m = drag_per_m;
        Ok(self)
    }

    /// With a Magnus force `a = m × v`; `m` (1/s) is the ball's spin times its lift constant, held during the flight.
    ///
    /// # Errors
    /// If `m` is not finite.
    pub fn with_magnus(mut self, magnus_rad_s: Vector3<f64>) -> Result<Self, FlightModelError> {
        if !magnus_rad_s.iter().all(|m| m.is_finite()) {
            return Err(FlightModelError::Magnus);
        }
        self.magnus_rad_s = magnus_rad_s;
        Ok(self)
    }

    /// Gravity in m/s², positive.
    #[must_use]
    #[inline]
    pub fn gravity_m_s2(&self) -> f64 {
        self.gravity_m_s2
    }

    /// Drag constant in 1/m.
    #[must_use]
    #[inline]
    pub fn drag_per_m(&self) -> f64 {
        self.drag_per_m
    }

    /// Magnus vector in 1/s.
    #[must_use]
    #[inline]
    pub fn magnus_rad_s(&self) -> &Vector3<f64> {
        &self.magnus_rad_s
    }

    /// Whether only gravity acts, so that closed forms hold.
    #[must_use]
    #[inline]
    pub fn is_vacuum(&self) -> bool {
        self.drag_per_m == 0.0 && self.magnus_rad_s == Vector3::zeros()
    }

    /// Acceleration in m/s² at velocity `v` (m/s); it depends on nothing else.
    #[must_use]
    #[inline]
    pub fn acceleration(&self, v: &Vector3<f64>) -> Vector3<f64> {
        let drag = v * (-self.drag_per_m * v.norm());
        Vector3::new(drag.x, drag.y, drag.z - self.gravity_m_s2) + self.magnus_rad_s.cross(v)
    }

    /// `∂a/∂v` in 1/s.
    #[must_use]
    #[inline]
    pub fn acceleration_by_v(&self, v: &Vector3<f64>) -> Matrix3<f64> {
        let speed = v.norm();
        let mut by_v = self.magnus_rad_s.cross_matrix();
        if speed > 0.0 {
            by_v -= (Matrix3::identity() * speed + v * v.transpose() / speed) * self.drag_per_m;
        }
        by_v
    }

    /// State after `duration_s` (which may be negative), with the derivatives by the velocity at the start.
    #[must_use]
    #[inline]
    pub fn fly(&self, p: &Vector3<f64>, v: &Vector3<f64>, duration_s: f64) -> FlightState {
        if self.is_vacuum() {
            let t = duration_s;
            let g = Vector3::new(0.0, 0.0, -self.gravity_m_s2);
            return FlightState {
                p: p + v * t + g * (0.5 * t * t),
                v: v + g * t,
                p_by_v0: Matrix3::identity() * t,
                v_by_v0: Matrix3::identity(),
            };
        }
        let mut state = FlightState::begin(p, v);
        let mut left_s = finite(duration_s);
        while left_s != 0.0 {
            let h = self.step_s(&state.v, left_s);
            state = self.advance(&state, h);
            left_s -= h;
        }
        state
    }

    /// Position and velocity after `duration_s`: those of [`FlightModel::fly`] to the bit, at a fraction of its price.
    #[must_use]
    #[inline]
    pub fn coast(&self, p: &Vector3<f64>, v: &Vector3<f64>, duration_s: f64) -> (Vector3<f64>, Vector3<f64>) {
        if self.is_vacuum() {
            let end = self.fly(p, v, duration_s);
            return (end.p, end.v);
        }
        let (mut p, mut v, mut left_s) = (*p, *v, finite(duration_s));
        while left_s != 0.0 {
            let h = self.step_s(&v, left_s);
            (p, v) = self.coast_step(&p, &v, h);
            left_s -= h;
        }
        (p, v)
    }

    /// The step to take at a velocity with `left_s` to go (which may be negative): the forces turn or brake the ball by
    /// a small part only.
    #[inline]
    pub(super) fn step_s(&self, v: &Vector3<f64>, left_s: f64) -> f64 {
        let rate = self.drag_per_m * v.norm() + self.magnus_rad_s.norm();
        let most = STEP_S.min(STEP_SHARE / rate).max(STEP_MIN_S);
        // Without a last step of nothing but rounding.
        if left_s.abs() > most * (1.0 + 1e-9) { most.copysign(left_s) } else { left_s }
    }

    /// Position and velocity one step later.
    pub(super) fn coast_step(
        &self,
        p: &Vector3<f64>,
        v: &Vector3<f64>,
        h: f64,
    ) -> (Vector3<f64>, Vector3<f64>) {
        if self.is_vacuum() {
            let g = Vector3::new(0.0, 0.0, -self.gravity_m_s2);
            return (p + v * h + g * (0.5 * h * h), v + g * h);
        }
        let stages = self.stages(v, h);
        (stages.position(p, h), stages.velocity(v, h))
    }

    /// The state one step later.
    pub(super) fn advance(&self, x: &FlightState, h: f64) -> FlightState {
        if self.is_vacuum() {
            let (p, v) = self.coast_step(&x.p, &x.v, h);
            return FlightState { p, v, p_by_v0: x.p_by_v0 + x.v_by_v0 * h, v_by_v0: x.v_by_v0 };
        }
        self.rk4(x, h)
    }

    /// The stages of a Runge-Kutta step; forces do not depend on position, so velocities are all they need.
    fn stages(&self, v: &Vector3<f64>, h: f64) -> Stages {
        let a1 = self.acceleration(v);
        let v2 = v + a1 * (h / 2.0);
        let a2 = self.acceleration(&v2);
        let v3 = v + a2 * (h / 2.0);
        let a3 = self.acceleration(&v3);
        let v4 = v + a3 * h;
        Stages { v: [*v, v2, v3, v4], a: [a1, a2, a3, self.acceleration(&v4)] }
    }

    fn rk4(&self, x: &FlightState, h: f64) -> FlightState {
        let stages = self.stages(&x.v, h);
        let [v1, v2, v3, v4] = &stages.v;
        let b1 = self.acceleration_by_v(v1) * x.v_by_v0;
        let w2 = x.v_by_v0 + b1 * (h / 2.0);
        let b2 = self.acceleration_by_v(v2) * w2;
        let w3 = x.v_by_v0 + b2 * (h / 2.0);
        let b3 = self.acceleration_by_v(v3) * w3;
        let w4 = x.v_by_v0 + b3 * h;
        let b4 = self.acceleration_by_v(v4) * w4;
        FlightState {
            p: stages.position(&x.p, h),
            v: stages.velocity(&x.v, h),
            p_by_v0: x.p_by_v0 + (x.v_by_v0 + (w2 + w3) * 2.0 + w4) * (h / 6.0),
            v_by_v0: x.v_by_v0 + (b1 + (b2 + b3) * 2.0 + b4) * (h / 6.0),
        }
    }
}

/// Velocities and accelerations of the four stages of a Runge-Kutta step.
struct Stages {
    v: [Vector3<f64>; 4],
    a: [Vector3<f64>; 4],
}

impl Stages {
    fn position(&self, p: &Vector3<f64>, h: f64) -> Vector3<f64> {
        let [v1, v2, v3, v4] = &self.v;
        p + (v1 + (v2 + v3) * 2.0 + v4) * (h / 6.0)
    }

    fn velocity(&self, v: &Vector3<f64>, h: f64) -> Vector3<f64> {
        let [a1, a2, a3, a4] = &self.a;
        v + (a1 + (a2 + a3) * 2.0 + a4) * (h / 6.0)
    }
}

/// A duration that is no number has no steps.
fn finite(duration_s: f64) -> f64 {
    if duration_s.is_finite() { duration_s } else { 0.0 }
}

/// Longest integration step in s: the error of a ball at 5 m/s with k = 0.1/m is below 1e-10 m.
const STEP_S: f64 = 0.01;
/// Share of the velocity that forces may turn or brake in one step, about.
const STEP_SHARE: f64 = 0.05;
/// Shortest step in s: a ball that is braked at once has a position that hardly matters.
const STEP_MIN_S: f64 = 2e-4;

/// Ball after some time of flight; forces do not depend on position, so `∂p/∂p0 = 1` and `∂v/∂p0 = 0`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FlightState {
    /// Position in m.
    pub p: Vector3<f64>,
    /// Velocity in m/s.
    pub v: Vector3<f64>,
    /// `∂p/∂v0` in s.
    pub p_by_v0: Matrix3<f64>,
    /// `∂v/∂v0`.
    pub v_by_v0: Matrix3<f64>,
}

impl FlightState {
    /// At the release.
    #[inline]
    pub(super) fn begin(p: &Vector3<f64>, v: &Vector3<f64>) -> Self {
        Self { p: *p, v: *v, p_by_v0: Matrix3::zeros(), v_by_v0: Matrix3::identity() }
    }
}

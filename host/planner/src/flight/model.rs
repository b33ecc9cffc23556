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
    #[error("gravity must be positive and finite, got {0} m/s²")]
    Gravity(f64),
    #[error("drag must be zero or positive and finite, got {0} 1/m")]
    Drag(f64),
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
    pub(crate) fn is_vacuum(&self) -> bool {
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
    pub(crate) fn acceleration_by_v(&self, v: &Vector3<f64>) -> Matrix3<f64> {
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

    /// Position and velocity after `duration_s`: bit for bit those of [`FlightModel::fly`], at a fraction of the cost.
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

    /// The step at a velocity with `left_s` to go (which may be negative): forces turn or brake the ball only a
    /// little in it.
    #[inline]
    pub(super) fn step_s(&self, v: &Vector3<f64>, left_s: f64) -> f64 {
        let speed = v.norm();
        let rate = self.drag_per_m * speed + self.magnus_rad_s.norm();
        // Drag bends most where gravity turns the velocity: about the apex of a steep flight.
        let turning = (TURN_SHARE * speed / self.gravity_m_s2).clamp(STEP_AT_APEX_S, STEP_S);
        let most = turning.min(STEP_SHARE / rate).max(STEP_MIN_S);
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
        self.step(x, h)
    }

    /// The stages of a step; forces do not depend on position, so velocities are all they need.
    #[inline]
    fn stages(&self, v: &Vector3<f64>, h: f64) -> Stages {
        let a1 = self.acceleration(v);
        let v2 = v + a1 * (C21 * h);
        let a2 = self.acceleration(&v2);
        let v3 = v + a2 * (C32 * h);
        let a3 = self.acceleration(&v3);
        let v4 = v + (a1 * C41 + a2 * C42 + a3 * C43) * h;
        let a4 = self.acceleration(&v4);
        let v5 = v + (a1 * C51 + a2 * C52 + a3 * C53 + a4 * C54) * h;
        let a5 = self.acceleration(&v5);
        let v6 = v + (a2 * C62 + a3 * C63 + a4 * C64 + a5 * C65) * h;
        let a6 = self.acceleration(&v6);
        let v7 = v + (a1 * C71 + a2 * C72 + a3 * C73 + a4 * C74 + a6 * C76) * h;
        Stages { v: [*v, v2, v3, v4, v5, v6, v7], a: [a1, a2, a3, a4, a5, a6, self.acceleration(&v7)] }
    }

    /// One step with the derivatives by the velocity at the start: those of the step itself.
    fn step(&self, x: &FlightState, h: f64) -> FlightState {
        let stages = self.stages(&x.v, h);
        let by_v = |k: usize| self.acceleration_by_v(&stages.v[k]);
        let w1 = &x.v_by_v0;
        let b1 = by_v(0) * w1;
        let b2 = by_v(1) * (w1 + b1 * (C21 * h));
        let w3 = w1 + b2 * (C32 * h);
        let b3 = by_v(2) * w3;
        let w4 = w1 + (b1 * C41 + b2 * C42 + b3 * C43) * h;
        let b4 = by_v(3) * w4;
        let w5 = w1 + (b1 * C51 + b2 * C52 + b3 * C53 + b4 * C54) * h;
        let b5 = by_v(4) * w5;
        let w6 = w1 + (b2 * C62 + b3 * C63 + b4 * C64 + b5 * C65) * h;
        let b6 = by_v(5) * w6;
        let w7 = w1 + (b1 * C71 + b2 * C72 + b3 * C73 + b4 * C74 + b6 * C76) * h;
        let b7 = by_v(6) * w7;
        FlightState {
            p: stages.position(&x.p, h),
            v: stages.velocity(&x.v, h),
            p_by_v0: x.p_by_v0 + ((w1 + w7) * W1 + (w3 + w4) * W3 + (w5 + w6) * W5) * h,
            v_by_v0: x.v_by_v0 + ((b1 + b7) * W1 + (b3 + b4) * W3 + (b5 + b6) * W5) * h,
        }
    }
}

// Butcher's Runge-Kutta method of sixth order: how far stage i goes along the acceleration of stage j (`Cij`), and the
// weights of the stages 1 and 7, 3 and 4, 5 and 6.
const C21: f64 = 1.0 / 3.0;
const C32: f64 = 2.0 / 3.0;
const C41: f64 = 1.0 / 12.0;
const C42: f64 = 1.0 / 3.0;
const C43: f64 = -1.0 / 12.0;
const C51: f64 = -1.0 / 16.0;
const C52: f64 = 9.0 / 8.0;
const C53: f64 = -3.0 / 16.0;
const C54: f64 = -3.0 / 8.0;
const C62: f64 = 9.0 / 8.0;
const C63: f64 = -3.0 / 8.0;
const C64: f64 = -3.0 / 4.0;
const C65: f64 = 0.5;
const C71: f64 = 9.0 / 44.0;
const C72: f64 = -9.0 / 11.0;
const C73: f64 = 63.0 / 44.0;
const C74: f64 = 18.0 / 11.0;
const C76: f64 = -16.0 / 11.0;
const W1: f64 = 11.0 / 120.0;
const W3: f64 = 27.0 / 40.0;
const W5: f64 = -4.0 / 15.0;

/// Velocities and accelerations of the stages of a step.
struct Stages {
    v: [Vector3<f64>; 7],
    a: [Vector3<f64>; 7],
}

impl Stages {
    #[inline]
    fn position(&self, p: &Vector3<f64>, h: f64) -> Vector3<f64> {
        let [v1, _, v3, v4, v5, v6, v7] = &self.v;
        p + ((v1 + v7) * W1 + (v3 + v4) * W3 + (v5 + v6) * W5) * h
    }

    #[inline]
    fn velocity(&self, v: &Vector3<f64>, h: f64) -> Vector3<f64> {
        let [a1, _, a3, a4, a5, a6, a7] = &self.a;
        v + ((a1 + a7) * W1 + (a3 + a4) * W3 + (a5 + a6) * W5) * h
    }
}

/// A duration that is not a number has no steps.
fn finite(duration_s: f64) -> f64 {
    if duration_s.is_finite() { duration_s } else { 0.0 }
}

/// Longest integration step in s.
const STEP_S: f64 = 0.05;
/// Share of the time in which gravity turns the velocity, and the step that is short enough for every velocity.
const TURN_SHARE: f64 = 0.2;
const STEP_AT_APEX_S: f64 = 0.01;
/// Share of the velocity that forces may turn or brake in one step, about.
const STEP_SHARE: f64 = 0.12;
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Midpoint steps with Richardson's extrapolation to the limit of no step: another method altogether.
    fn extrapolated(model: &FlightModel, v0: &Vector3<f64>, duration_s: f64) -> Vector3<f64> {
        let midpoint = |steps: u32| {
            let h = duration_s / f64::from(steps);
            let (mut p, mut v) = (Vector3::zeros(), *v0);
            for _ in 0..steps {
                let half = v + model.acceleration(&v) * (0.5 * h);
                p += half * h;
                v += model.acceleration(&half) * h;
            }
            p
        };
        let rows: Vec<Vector3<f64>> = [1_000, 2_000, 4_000, 8_000].into_iter().map(midpoint).collect();
        // The error of the midpoint rule has the powers 2, 3 and 4 of the step.
        let once: Vec<_> = rows.windows(2).map(|r| (r[1] * 4.0 - r[0]) / 3.0).collect();
        let twice: Vec<_> = once.windows(2).map(|r| (r[1] * 8.0 - r[0]) / 7.0).collect();
        (twice[1] * 16.0 - twice[0]) / 15.0
    }

    #[test]
    fn flights_agree_with_another_method_from_flat_to_nearly_vertical() {
        let vacuum = FlightModel::vacuum(9.81).expect("valid");
        for (k, within_m) in [(0.005, 1e-10), (0.1, 1e-9), (1.0, 1e-7), (10.0, 1e-5)] {
            for v0 in [[5.0, 0.0, 1.0], [2.0, 1.0, 3.0], [0.4, 0.0, 4.0], [0.05, 0.0, 3.0], [0.3, 0.0, 0.1]] {
                let v0 = Vector3::from(v0);
                for magnus in [Vector3::zeros(), Vector3::new(0.2, -0.1, 0.3)] {
                    let model = vacuum.with_drag(k).expect("valid").with_magnus(magnus).expect("valid");
                    let off =
                        (model.fly(&Vector3::zeros(), &v0, 0.8).p - extrapolated(&model, &v0, 0.8)).norm();
                    assert!(off < within_m, "drag {k}/m, {v0:?}: {off} m");
                }
            }
        }
    }
}

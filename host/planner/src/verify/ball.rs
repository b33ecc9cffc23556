//! The flying ball in small steps of its own (Heun), without closed forms.

use nalgebra::Vector3;

use super::target::Plane;
use crate::plan::file::LandingInfo;

pub const STEP_S: f64 = 2e-4;
/// No throw of an arm flies longer.
const FLIGHT_MAX_S: f64 = 10.0;

/// Forces on the ball, as a plan file states them.
#[derive(Debug, Clone, Copy)]
pub struct Ball {
    gravity_m_s2: f64,
    drag_per_m: f64,
    magnus_rad_s: Vector3<f64>,
}

/// The ball meets the plane of the target.
#[derive(Debug, Clone, Copy)]
pub struct Met {
    /// Position in m.
    pub p: Vector3<f64>,
    /// Velocity in m/s.
    pub v: Vector3<f64>,
    /// Time since its release in s.
    pub s: f64,
}

impl Ball {
    /// From the file.
    #[must_use]
    pub fn new(l: &LandingInfo) -> Self {
        Self {
            gravity_m_s2: l.gravity_m_s2,
            drag_per_m: l.drag_per_m,
            magnus_rad_s: Vector3::from(l.magnus_rad_s),
        }
    }

    fn acceleration(&self, v: &Vector3<f64>) -> Vector3<f64> {
        Vector3::new(0.0, 0.0, -self.gravity_m_s2) - v * (self.drag_per_m * v.norm())
            + self.magnus_rad_s.cross(v)
    }

    /// Position and velocity one step later.
    #[must_use]
    pub fn step(&self, p: &Vector3<f64>, v: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
        self.step_by(p, v, STEP_S)
    }

    /// Position and velocity `dt` later, which may be negative.
    #[must_use]
    pub fn step_by(&self, p: &Vector3<f64>, v: &Vector3<f64>, dt: f64) -> (Vector3<f64>, Vector3<f64>) {
        let a = self.acceleration(v);
        let b = self.acceleration(&(v + a * dt));
        (p + v * dt + a * (0.5 * dt * dt), v + (a + b) * (0.5 * dt))
    }

    /// Where the ball passes the plane of the target from the side of its normal, released `since_s` after the planned
    /// release; calls `on_the_way` with time since its release and position of every step.
    pub fn land(
        &self,
        p: &Vector3<f64>,
        v: &Vector3<f64>,
        plane: &Plane,
        since_s: f64,
        mut on_the_way: impl FnMut(f64, &Vector3<f64>),
    ) -> Option<Met> {
        let (mut p, mut v, mut s) = (*p, *v, 0.0);
        while s < FLIGHT_MAX_S {
            let (p1, v1) = self.step(&p, &v);
            let (above, below) = (plane.above_m(&p, since_s + s), plane.above_m(&p1, since_s + s + STEP_S));
            if above >= 0.0 && below < 0.0 {
                let share = above / (above - below);
                return Some(Met { p: p + (p1 - p) * share, v: v + (v1 - v) * share, s: s + STEP_S * share });
            }
            (p, v) = (p1, v1);
            s += STEP_S;
            on_the_way(s, &p);
        }
        None
    }
}

//! The flying ball in small steps of its own (Heun), without closed forms.

use nalgebra::Vector3;

use crate::plan::file::LandingInfo;

/// Step in s.
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
        let dt = STEP_S;
        let a = self.acceleration(v);
        let b = self.acceleration(&(v + a * dt));
        (p + v * dt + a * (0.5 * dt * dt), v + (a + b) * (0.5 * dt))
    }

    /// Where the ball comes down through the plane at `z_m`, calling `on_the_way` with time and position of every step.
    pub fn land(
        &self,
        p: &Vector3<f64>,
        v: &Vector3<f64>,
        z_m: f64,
        mut on_the_way: impl FnMut(f64, &Vector3<f64>),
    ) -> Option<Vector3<f64>> {
        let (mut p, mut v, mut s) = (*p, *v, 0.0);
        while s < FLIGHT_MAX_S {
            let (p1, v1) = self.step(&p, &v);
            if p1.z <= z_m && v1.z < 0.0 && p.z >= z_m {
                return Some(p + (p1 - p) * ((p.z - z_m) / (p.z - p1.z)));
            }
            (p, v) = (p1, v1);
            s += STEP_S;
            on_the_way(s, &p);
        }
        None
    }
}

//! The target as the file states it: a plane that may move, and the rim of an opening.

use nalgebra::Vector3;

use crate::plan::file::Target;

/// Point, plane and way of the target.
#[derive(Debug, Clone)]
pub struct Plane {
    point_m: Vector3<f64>,
    normal: Vector3<f64>,
    course: Vec<Vector3<f64>>,
}

impl Plane {
    /// From the file. The normal of an opening is used unchanged: if it is not a unit vector, it gives wrong
    /// distances, and a finding of its own.
    #[must_use]
    pub fn new(target: &Target) -> Self {
        Self {
            point_m: Vector3::from(target.position_m),
            normal: target.opening.map_or(Vector3::z(), |o| Vector3::from(o.normal)),
            course: target.course.iter().map(|c| Vector3::from(*c)).collect(),
        }
    }

    /// Whether the normal is a unit vector.
    #[must_use]
    pub(crate) fn is_sound(&self) -> bool {
        (self.normal.norm() - 1.0).abs() < 1e-9
    }

    /// Unit normal, to the side from which the ball comes.
    #[must_use]
    pub fn normal(&self) -> &Vector3<f64> {
        &self.normal
    }

    /// The target at a time after the planned release.
    #[must_use]
    pub fn point_m(&self, t_s: f64) -> Vector3<f64> {
        let mut at = self.point_m;
        let mut power = 1.0;
        for c in &self.course {
            power *= t_s;
            at += c * power;
        }
        at
    }

    /// Its velocity there, by a central difference.
    #[must_use]
    pub fn velocity_m_s(&self, t_s: f64) -> Vector3<f64> {
        let dt = 1e-4;
        (self.point_m(t_s + dt) - self.point_m(t_s - dt)) / (2.0 * dt)
    }

    /// Distance of a point from the plane at a time.
    #[must_use]
    pub(crate) fn above_m(&self, p: &Vector3<f64>, t_s: f64) -> f64 {
        self.normal.dot(&(p - self.point_m(t_s)))
    }

    /// Distance of a point from the circle of `radius_m` about the target at a time.
    #[must_use]
    pub(crate) fn rim_distance_m(&self, radius_m: f64, p: &Vector3<f64>, t_s: f64) -> f64 {
        let r = p - self.point_m(t_s);
        let height = self.normal.dot(&r);
        let out = (r.norm_squared() - height * height).max(0.0).sqrt();
        (out - radius_m).hypot(height)
    }
}

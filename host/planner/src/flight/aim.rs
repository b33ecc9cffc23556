//! Target of the ball: a point on a plane, at rest or moving.

use nalgebra::{SMatrix, Vector2, Vector3};

/// Coefficients of a course, at most.
pub const COURSE_MAX: usize = 5;

/// Way of a target since the planned release: `Σ c_k t^k`, k from 1, t in s.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Course {
    coefficients_m: [Vector3<f64>; COURSE_MAX],
}

impl Course {
    /// From `c_1`, `c_2`, … in m/s, m/s², …; `None` for more than [`COURSE_MAX`] or a number that is not finite.
    #[must_use]
    pub fn new(coefficients_m: &[[f64; 3]]) -> Option<Self> {
        let finite = coefficients_m.iter().flatten().all(|c| c.is_finite());
        if coefficients_m.len() > COURSE_MAX || !finite {
            return None;
        }
        let mut course = Self::default();
        for (into, from) in course.coefficients_m.iter_mut().zip(coefficients_m) {
            *into = Vector3::from(*from);
        }
        Some(course)
    }

    /// The coefficients without the zeros behind the last other one.
    #[must_use]
    pub(crate) fn coefficients_m(&self) -> Vec<[f64; 3]> {
        let count =
            self.coefficients_m.iter().rposition(|c| *c != Vector3::zeros()).map_or(0, |last| last + 1);
        self.coefficients_m.iter().take(count).map(|c| (*c).into()).collect()
    }

    /// Whether the target does not move.
    #[must_use]
    #[inline]
    pub fn is_at_rest(&self) -> bool {
        self.coefficients_m.iter().all(|c| *c == Vector3::zeros())
    }

    /// Way in m, `t_s` after the planned release.
    #[must_use]
    #[inline]
    pub fn way_m(&self, t_s: f64) -> Vector3<f64> {
        self.coefficients_m.iter().rev().fold(Vector3::zeros(), |sum, c| (sum + c) * t_s)
    }

    /// Velocity in m/s at the same time.
    #[must_use]
    #[inline]
    pub fn velocity_m_s(&self, t_s: f64) -> Vector3<f64> {
        let mut sum = Vector3::zeros();
        for (k, c) in self.coefficients_m.iter().enumerate().rev() {
            sum = sum * t_s + c * (k + 1) as f64;
        }
        sum
    }

    /// Acceleration in m/s² at the same time.
    #[must_use]
    #[inline]
    pub(crate) fn acceleration_m_s2(&self, t_s: f64) -> Vector3<f64> {
        let mut sum = Vector3::zeros();
        for (k, c) in self.coefficients_m.iter().enumerate().skip(1).rev() {
            sum = sum * t_s + c * ((k + 1) * k) as f64;
        }
        sum
    }
}

/// A point and the plane through it in which misses are measured.
///
/// The plane is horizontal unless the target is an opening. It moves with the target without turning. Coordinates on it
/// are those of the world at the planned release: a target that moves has the same coordinates all the time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Aim {
    point_m: Vector3<f64>,
    /// To the side from which the ball comes.
    normal: Vector3<f64>,
    /// Axes of the coordinates.
    axes: [Vector3<f64>; 2],
    course: Course,
    /// Whether the plane is horizontal and at rest.
    level: bool,
}

impl Aim {
    /// A point at rest on a horizontal plane, in m; coordinates are x and y of the world.
    #[must_use]
    #[inline]
    pub fn level(point_m: Vector3<f64>) -> Self {
        Self {
            point_m,
            normal: Vector3::z(),
            axes: [Vector3::x(), Vector3::y()],
            course: Course::default(),
            level: true,
        }
    }

    /// A point on the plane with this normal (not zero; towards the side from which the ball comes).
    ///
    /// On a plane that is not horizontal the first axis is horizontal and the second one is across it, upwards.
    #[must_use]
    pub fn new(point_m: Vector3<f64>, normal: &Vector3<f64>, course: Course) -> Self {
        let normal = normal.normalize();
        let across = Vector3::z().cross(&normal);
        let axes = if across.norm() < 1e-9 {
            [Vector3::x(), Vector3::y() * normal.z.signum()]
        } else {
            let first = across.normalize();
            [first, normal.cross(&first)]
        };
        let level = course.is_at_rest() && normal == Vector3::z();
        Self { point_m, normal, axes, course, level }
    }

    /// The same with its point moved by `by_m`.
    #[must_use]
    #[inline]
    pub fn shifted(mut self, by_m: &Vector3<f64>) -> Self {
        self.point_m += by_m;
        self
    }

    /// Whether the plane is horizontal, the ball comes from above, and the target is at rest.
    #[must_use]
    #[inline]
    pub(crate) fn is_level(&self) -> bool {
        self.level
    }

    /// Unit normal of the plane, to the side from which the ball comes.
    #[must_use]
    #[inline]
    pub fn normal(&self) -> &Vector3<f64> {
        &self.normal
    }

    /// Unit axes of the coordinates on the plane.
    #[must_use]
    pub fn axes(&self) -> &[Vector3<f64>; 2] {
        &self.axes
    }

    /// How the target moves.
    #[must_use]
    #[inline]
    pub fn course(&self) -> &Course {
        &self.course
    }

    /// The target `t_s` after the planned release, in m.
    #[must_use]
    #[inline]
    pub(crate) fn point_at(&self, t_s: f64) -> Vector3<f64> {
        if self.level { self.point_m } else { self.point_m + self.course.way_m(t_s) }
    }

    /// Distance of a point from the plane in m, `t_s` after the planned release; positive on the side of the normal.
    #[must_use]
    #[inline]
    pub(crate) fn above_m(&self, p: &Vector3<f64>, t_s: f64) -> f64 {
        if self.level { p.z - self.point_m.z } else { self.normal.dot(&(p - self.point_at(t_s))) }
    }

    /// Coordinates of the target in m.
    #[must_use]
    #[inline]
    pub fn centre(&self) -> Vector2<f64> {
        self.coordinates(&self.point_m, 0.0)
    }

    /// Coordinates on the plane in m, of a point `t_s` after the planned release.
    #[must_use]
    #[inline]
    pub fn coordinates(&self, p: &Vector3<f64>, t_s: f64) -> Vector2<f64> {
        if self.level {
            return p.xy();
        }
        let at = p - self.course.way_m(t_s);
        Vector2::new(self.axes[0].dot(&at), self.axes[1].dot(&at))
    }

    /// The point of the plane with these coordinates, at the planned release.
    #[must_use]
    pub fn place(&self, coordinates: &Vector2<f64>) -> Vector3<f64> {
        let off = coordinates - self.centre();
        self.point_m + self.axes[0] * off.x + self.axes[1] * off.y
    }

    /// Derivative of the coordinates of a landing by the ball's distance from its path, for the velocity `approach`
    /// against the plane: the plane is met earlier or later.
    #[must_use]
    #[inline]
    pub(crate) fn onto_plane(&self, approach: &Vector3<f64>) -> SMatrix<f64, 2, 3> {
        let along = approach / self.normal.dot(approach);
        let row = |axis: &Vector3<f64>| (axis - self.normal * axis.dot(&along)).transpose();
        SMatrix::<f64, 2, 3>::from_rows(&[row(&self.axes[0]), row(&self.axes[1])])
    }

    /// How coordinates of a landing change with the position of the plane along its normal.
    #[must_use]
    #[inline]
    pub(crate) fn by_offset(&self, approach: &Vector3<f64>) -> Vector2<f64> {
        let along = approach / self.normal.dot(approach);
        Vector2::new(self.axes[0].dot(&along), self.axes[1].dot(&along))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_course_has_the_way_velocity_and_acceleration_of_its_polynomial() {
        let course = Course::new(&[[0.5, 0.0, 1.0], [0.0, 2.0, 0.0], [1.0, 0.0, 0.0]]).expect("three");
        let t = 0.7;
        assert!((course.way_m(t) - Vector3::new(0.5 * t + t * t * t, 2.0 * t * t, t)).norm() < 1e-15);
        assert!((course.velocity_m_s(t) - Vector3::new(0.5 + 3.0 * t * t, 4.0 * t, 1.0)).norm() < 1e-15);
        assert!((course.acceleration_m_s2(t) - Vector3::new(6.0 * t, 4.0, 0.0)).norm() < 1e-14);
        assert_eq!(course.coefficients_m().len(), 3);
        assert_eq!(Course::new(&[[0.0; 3]; 6]), None);
        assert_eq!(Course::new(&[[f64::NAN; 3]]), None);
        assert!(Course::default().is_at_rest() && Course::default().coefficients_m().is_empty());
    }

    #[test]
    fn coordinates_on_a_plane_lead_back_to_the_point() {
        let course = Course::new(&[[0.2, -0.1, 0.4]]).expect("one");
        for normal in [Vector3::x(), -Vector3::x(), Vector3::z(), -Vector3::z(), Vector3::new(1.0, 2.0, 0.5)]
        {
            let aim = Aim::new(Vector3::new(1.0, -0.5, 0.3), &normal, course);
            let [a, b] = aim.axes();
            assert!(a.cross(b).dot(aim.normal()) > 0.999_999, "{normal}: axes and normal are right-handed");
            let at = aim.centre() + Vector2::new(0.03, -0.05);
            let place = aim.place(&at);
            assert!((aim.coordinates(&place, 0.0) - at).norm() < 1e-15);
            assert!(aim.above_m(&place, 0.0).abs() < 1e-15);
            let later = place + course.way_m(0.8);
            assert!((aim.coordinates(&later, 0.8) - at).norm() < 1e-15);
        }
    }
}

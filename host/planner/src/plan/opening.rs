//! Openings: a ball passes through a disc that has a side.

use nalgebra::Vector3;

pub use super::options::Opening;
use super::options::Region;
use super::problem::Problem;
use crate::flight::{Aim, FlightModel};
use crate::throw::Throw;

impl Problem<'_> {
    /// The disc about the centre of an opening within which a ball that comes as in this throw passes clear of the rim;
    /// `None` without an opening.
    #[must_use]
    pub fn region_of_opening(&self, throw: &Throw) -> Option<Region> {
        let opening = self.options.opening.as_ref()?;
        let (p, v) = throw.ball_at_release(self.arm);
        let landing = self.flight.meet(&p, &v, &self.aim, 0.0)?;
        let approach = self.aim.approach(&landing, 0.0);
        let cos = -self.aim.normal().dot(&approach) / approach.norm();
        let radius_m = opening.radius_m - self.arm.gripper().ball_radius_m / cos.max(1e-3);
        (radius_m > 0.0).then_some(Region::Disc { radius_m })
    }
}

/// Where the centre of the ball is nearest to the rim.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct NearRim {
    /// Distance from the circle in m.
    pub(crate) distance_m: f64,
    /// Its change with the velocity at the centre of the opening, in s.
    pub(crate) by_v: Vector3<f64>,
    /// Its change with the time of flight at a fixed velocity, in m/s.
    pub(crate) by_flight_s: f64,
}

/// Instants that are checked, to both sides of the passage; and how often a step is halved at the nearest.
const STEPS: i32 = 16;
const HALVINGS: usize = 24;

/// The way of a ball about the opening, which it passes through the centre with `v` (m/s) after `flight_s`.
pub(crate) fn nearest_to_rim(
    flight: &FlightModel,
    aim: &Aim,
    radius_m: f64,
    v: &Vector3<f64>,
    flight_s: f64,
) -> NearRim {
    let course = aim.course();
    let here = course.way_m(flight_s);
    let approach = v - course.velocity_m_s(flight_s);
    // A rim that is farther away in time than this is not nearer than at the passage.
    let window_s = (2.0 * radius_m / approach.norm().max(1e-3)).min(flight_s.max(1e-3));
    // Place of the ball against the centre `s` after the passage, and the vector to it from the rim.
    let from_rim = |s: f64| {
        let r = flight.coast(&Vector3::zeros(), v, s).0 - (course.way_m(flight_s + s) - here);
        let flat = r - aim.normal() * aim.normal().dot(&r);
        let out = flat.norm();
        // Every point of the rim is as near to the centre as any other.
        let radial = if out > 1e-12 { flat / out } else { aim.axes()[0] };
        r - radial * radius_m
    };
    let (mut at_s, mut step_s) = (0.0, window_s / f64::from(STEPS));
    let mut least_m = from_rim(0.0).norm();
    for i in -STEPS..=STEPS {
        let s = step_s * f64::from(i);
        let distance_m = from_rim(s).norm();
        if distance_m < least_m {
            (least_m, at_s) = (distance_m, s);
        }
    }
    for _ in 0..HALVINGS {
        step_s *= 0.5;
        for s in [at_s - step_s, at_s + step_s] {
            let distance_m = from_rim(s).norm();
            if distance_m < least_m {
                (least_m, at_s) = (distance_m, s);
            }
        }
    }
    // At the nearest instant the distance is stationary in time, so only the direct dependence counts.
    let away = from_rim(at_s) / least_m.max(1e-12);
    let state = flight.fly(&Vector3::zeros(), v, at_s);
    NearRim {
        distance_m: least_m,
        by_v: state.p_by_v0.tr_mul(&away),
        by_flight_s: -away.dot(&(course.velocity_m_s(flight_s + at_s) - course.velocity_m_s(flight_s))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flight::Course;

    #[test]
    fn a_straight_way_through_the_centre_is_nearest_to_the_rim_by_the_cosine() {
        // Hardly any gravity: the way is a line.
        let flight = FlightModel::vacuum(1e-9).expect("valid");
        for angle in [0.0, 0.4, 1.0_f64] {
            let aim = Aim::new(Vector3::zeros(), &-Vector3::x(), Course::default());
            let v = Vector3::new(angle.cos(), angle.sin(), 0.0) * 3.0;
            let near = nearest_to_rim(&flight, &aim, 0.1, &v, 1.0);
            assert!((near.distance_m - 0.1 * angle.cos()).abs() < 1e-9, "{angle}: {near:?}");
        }
    }

    #[test]
    fn derivatives_of_the_distance_from_the_rim_match_differences() {
        let flight = FlightModel::vacuum(9.81).expect("valid").with_drag(0.05).expect("valid");
        let course = Course::new(&[[0.3, -0.2, 0.1], [0.0, 0.4, 0.0]]).expect("two");
        let aim = Aim::new(Vector3::new(1.0, 0.0, 0.0), &Vector3::new(-1.0, 0.2, 0.1), course);
        let (v, f) = (Vector3::new(2.0, 0.5, 1.0), 0.6);
        let at = |v: &Vector3<f64>, f: f64| nearest_to_rim(&flight, &aim, 0.12, v, f);
        let (near, eps) = (at(&v, f), 1e-6);
        for i in 0..3 {
            let mut step = Vector3::zeros();
            step[i] = eps;
            let differenced = (at(&(v + step), f).distance_m - at(&(v - step), f).distance_m) / (2.0 * eps);
            assert!((near.by_v[i] - differenced).abs() < 1e-6, "{i}: {} {differenced}", near.by_v[i]);
        }
        let differenced = (at(&v, f + eps).distance_m - at(&v, f - eps).distance_m) / (2.0 * eps);
        assert!((near.by_flight_s - differenced).abs() < 1e-6, "{} {differenced}", near.by_flight_s);
    }
}

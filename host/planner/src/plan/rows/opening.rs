//! The ball passes through an opening: within its angle of incidence, and clear of the rim.

use super::WINDOW;
use super::arriving::Arriving;
use crate::flight::Aim;
use crate::plan::cuts::CLEARANCE_SCALE;
use crate::plan::opening::nearest_to_rim;
use crate::plan::problem::Problem;
use crate::solve::Sink;

/// Cosines of angles are small numbers: they weigh like other rows with this factor.
const ANGLE_SCALE: f64 = 3.0;

/// Angle against the normal, and distance from the rim.
pub(super) fn opening_rows<S: Sink>(problem: &Problem<'_>, aim: &Aim, arriving: &Arriving<'_>, sink: &mut S) {
    let number = problem.numbers();
    let Some(opening) = &problem.options.opening else { return };
    let flight_s = arriving.throw.flight_s;
    let v = &arriving.end.v;
    let approach = v - aim.course().velocity_m_s(flight_s);
    let pull = aim.course().acceleration_m_s2(flight_s);
    let speed = approach.norm();
    let unit = approach / speed;
    let cos = -aim.normal().dot(&unit);
    let value = (cos - opening.incidence_max_rad.cos()) * ANGLE_SCALE;
    if value < WINDOW && sink.wants(number.opening) {
        let by_v = (-aim.normal() - unit * cos) * (ANGLE_SCALE / speed);
        sink.ineq(number.opening, value, |g| arriving.add_gradient(problem, g, &by_v, -by_v.dot(&pull)));
    }
    let id = number.opening + 1;
    if !sink.wants(id) {
        return;
    }
    let rim = nearest_to_rim(&problem.flight, aim, opening.radius_m, v, flight_s);
    let wanted_m = problem.rim_clearance_m();
    let value = (rim.distance_m - wanted_m) * CLEARANCE_SCALE;
    if value < WINDOW {
        sink.ineq(id, value, |g| {
            let by_v = rim.by_v * CLEARANCE_SCALE;
            arriving.add_gradient(problem, g, &by_v, rim.by_flight_s * CLEARANCE_SCALE);
        });
    }
}

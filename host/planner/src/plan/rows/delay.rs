//! Landing of a ball whose release is late or early: the first-order condition and windows beyond it.
//!
//! While the gripper hesitates, the hand carries the ball on along its motion; a release δ late lands at
//! `L(δ) = land(p(δ), v(δ))`. With `e = a - g` the acceleration of the hand against free fall, `dL/dδ = G_v e`, which
//! vanishes exactly if e is along the velocity at the landing; then `d²L/dδ² = G_v q⃛-part + O(|e|²)` is left, and the
//! windows bound what it does.

use nalgebra::Vector2;

use super::WINDOW;
use crate::flight::Aim;
use crate::plan::landed::{Landed, Released};
use crate::plan::layout::{Layout, SLOPE};
use crate::plan::options::{Form, WINDOW_ROUNDING_M};
use crate::plan::problem::Problem;
use crate::solve::{Row, Sink};
use crate::throw::Throw;

/// The first-order condition is a central difference over ± this delay; its error is ε² L‴/6, about 1e-3 mm per ms.
const SLOPE_DELAY_S: f64 = 1e-3;
/// Shifts count in centimetres, so that they weigh like the other scaled rows.
const SHIFT_SCALE: f64 = 100.0;
/// Smooths the distance at zero; far below any window.
const SHIFT_EPS_M: f64 = 1e-4;
/// A ball that comes through the plane more slowly rises hardly a millimetre above it: with a little more delay it
/// does not reach the plane at all.
const THROUGH_MIN_M_S: f64 = 0.15;
/// Without windows the ball must still come through the plane when the gripper opens this much late or early: the
/// spread of the landing is computed for 3.75 standard deviations, 7.5 ms of the assumed gripper.
pub(super) const JITTER_S: f64 = 0.01;
/// Rows require this multiple of its square, because of drag and rounding.
const THROUGH_SHARE: f64 = 1.1;

/// Sides of a window: late and early.
const SIDES: [(usize, f64); 2] = [(0, 1.0), (1, -1.0)];

/// `dL/dδ = 0`, `|L(δ) - L(0)| ≤ window` for late and early release, and a flight that comes through the plane in any case.
pub(super) fn delay_rows<S: Sink>(
    problem: &Problem<'_>,
    layout: &Layout,
    x: &Row,
    throw: &Throw,
    sink: &mut S,
) {
    // Without nulling the paper's form has none of these rows.
    if !problem.options.null_delay && problem.options.form != Form::Best {
        return;
    }
    let delayed = Delayed { problem, layout, throw, aim: layout.aim(problem, x) };
    if problem.options.null_delay {
        delayed.slope_rows(sink);
    }
    if !problem.options.delay_windows.is_empty() {
        delayed.window_rows(sink);
    } else if problem.options.form == Form::Best {
        for (side, sign) in SIDES {
            let id = problem.numbers().through + side;
            if sink.wants(id) {
                delayed.through_row(id, &Released::of(problem, throw, sign * JITTER_S), sink);
            }
        }
    }
}

struct Delayed<'c, 'a> {
    problem: &'c Problem<'a>,
    layout: &'c Layout,
    throw: &'c Throw,
    aim: Aim,
}

impl Delayed<'_, '_> {
    fn landed(&self, delay_s: f64) -> Option<Landed> {
        Landed::of(self.problem, &self.problem.flight, self.throw, &self.aim, delay_s)
    }

    fn slope_rows<S: Sink>(&self, sink: &mut S) {
        if !sink.wants_eq(SLOPE) && !sink.wants_eq(SLOPE + 1) {
            return;
        }
        let (Some(after), Some(before)) = (self.landed(SLOPE_DELAY_S), self.landed(-SLOPE_DELAY_S)) else {
            for i in 0..2 {
                sink.eq(SLOPE + i, 1e3, |_| {});
            }
            return;
        };
        let scale = 0.5 / SLOPE_DELAY_S;
        let value = (after.xy - before.xy) * scale;
        for (i, axis) in [Vector2::x(), Vector2::y()].into_iter().enumerate() {
            sink.eq(SLOPE + i, value[i], |g| {
                after.add_gradient(g, self.layout, &(axis * scale));
                before.add_gradient(g, self.layout, &(axis * -scale));
            });
        }
    }

    fn window_rows<S: Sink>(&self, sink: &mut S) {
        let (var, number) = (self.problem.variables(), self.problem.numbers());
        let (problem, layout, throw) = (self.problem, self.layout, self.throw);
        // Measured from where this throw lands, not from the target: another row makes it hit, and a row that mixes
        // both is stiff while the throw still misses by metres.
        let on_time = self.landed(0.0);
        for (k, window) in problem.options.delay_windows.iter().enumerate() {
            for (side, sign) in SIDES {
                let (id, through_id) = (number.delay + 2 * k + side, number.through + 2 * k + side);
                if !sink.wants(id) && !sink.wants(through_id) {
                    continue;
                }
                // A phase shorter than the delay ends before the release.
                let (h, h_index) = if sign < 0.0 { (throw.ha_s, var.ha) } else { (throw.hb_s, var.hb) };
                if h <= window.delay_s {
                    sink.ineq(id, (h - window.delay_s) * SHIFT_SCALE - 1.0, |g| g.add(h_index, SHIFT_SCALE));
                    continue;
                }
                let released = Released::of(problem, throw, sign * window.delay_s);
                // Grazing has a row of its own: there the shift has an infinite slope, and beyond it no value.
                let spare = self.through_row(through_id, &released, sink);
                let end = Landed::after(&released, &problem.flight, &self.aim)
                    .filter(|end| end.through_m_s >= THROUGH_MIN_M_S);
                let (Some(end), Some(on_time)) = (end, &on_time) else {
                    // That row leads back, unless drag takes what it reckons with.
                    if spare >= 0.0 {
                        sink.ineq(id, -1e3, |_| {});
                    }
                    continue;
                };
                let off = end.xy - on_time.xy;
                let distance_m = (off.norm_squared() + SHIFT_EPS_M * SHIFT_EPS_M).sqrt();
                let value =
                    (window.shift_m * problem.window_share - WINDOW_ROUNDING_M - distance_m) * SHIFT_SCALE;
                if value < WINDOW {
                    sink.ineq(id, value, |g| {
                        let along = off * (-SHIFT_SCALE / distance_m);
                        end.add_gradient(g, layout, &along);
                        on_time.add_gradient(g, layout, &-along);
                        if let Some((at, axes)) = layout.shift {
                            let by_plane = along.dot(&(end.by_plane - on_time.by_plane));
                            for (a, n) in self.aim.normal().iter().enumerate().filter(|(a, _)| axes[*a]) {
                                g.add(at + a, by_plane * n);
                            }
                        }
                    });
                }
            }
        }
    }

    /// The released ball comes through the plane; returns the value of the row.
    fn through_row<S: Sink>(&self, id: usize, released: &Released, sink: &mut S) -> f64 {
        let flight = &self.problem.flight;
        let value =
            released.through_m2_s2(flight, &self.aim) - THROUGH_SHARE * THROUGH_MIN_M_S * THROUGH_MIN_M_S;
        if value < WINDOW {
            sink.ineq(id, value, |g| released.add_through_gradient(g, self.layout, flight, &self.aim));
        }
        value
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::super::describe;
    use super::*;
    use crate::plan::layout::Numbers;
    use crate::plan::options::Options;
    use crate::plan::paper::PaperParameters;
    use crate::solve::{Gradient, WIDTH};
    use crate::throw::Arm;

    const FIRST: usize = Numbers::of(6).delay;
    const COUNT: usize = Numbers::of(6).cut - FIRST;

    /// Takes the inequalities of windows and flights.
    struct Rows {
        value: [Option<f64>; COUNT],
        gradient: [Row; COUNT],
    }

    impl Sink for Rows {
        fn wants(&self, _: usize) -> bool {
            true
        }
        fn wants_eq(&self, _: usize) -> bool {
            false
        }
        fn objective(&mut self, _: f64, _: impl FnOnce(&mut Gradient<'_>)) {}
        fn eq(&mut self, _: usize, _: f64, _: impl FnOnce(&mut Gradient<'_>)) {}
        fn ineq(&mut self, id: usize, value: f64, gradient: impl FnOnce(&mut Gradient<'_>)) {
            self.value[id - FIRST] = Some(value);
            gradient(&mut Gradient { row: &mut self.gradient[id - FIRST], factor: 1.0 });
        }
    }

    fn rows(problem: &Problem<'_>, layout: &Layout, x: &Row) -> Rows {
        let mut rows = Rows { value: [None; COUNT], gradient: [[0.0; WIDTH]; COUNT] };
        delay_rows(problem, layout, x, &layout.throw(x), &mut rows);
        rows
    }

    /// A throw with the target above the point of release, at the height in m that the ball reaches less `below_apex_m`.
    fn to_the_apex(arm: &Arm, below_apex_m: f64) -> (Problem<'_>, Throw) {
        let h = PaperParameters::from_array([0.493, -0.465, 0.858, 0.583, -1.098, 0.586, 0.920, 0.06]);
        let first = Problem::new(arm, Vector3::new(1.0, 1.0, -1.0), Options::best()).expect("valid");
        let mut throw = h.throws(&first)[0].throw;
        let (mut p, mut v) = throw.ball_at_release(arm);
        if v.z < 0.0 {
            throw.qd_rad_s = -throw.qd_rad_s;
            (p, v) = throw.ball_at_release(arm);
        }
        let apex_m = p.z + v.z * v.z / (2.0 * first.flight.gravity_m_s2());
        let target = Vector3::new(1.0, 1.0, apex_m - below_apex_m);
        (Problem::new(arm, target, Options::best()).expect("valid"), throw)
    }

    #[test]
    fn gradients_of_windows_and_of_the_height_of_a_grazing_flight_match_differences() {
        let arm = Arm::load("powercube6").expect("built in");
        let mut seen = [0; 2];
        // Through the plane, hardly through it, and below it.
        for below_apex_m in [0.03, 0.001, -0.05] {
            let (problem, throw) = to_the_apex(&arm, below_apex_m);
            for shift in [None, Some([true; 3])] {
                let layout = Layout::new(&problem, shift);
                let x = layout.row(&throw);
                let claimed = rows(&problem, &layout, &x);
                for row in 0..COUNT {
                    // The wall where the way of a ball is not known has no gradient.
                    let Some(value) = claimed.value[row].filter(|value| *value > -1e3) else { continue };
                    let largest = claimed.gradient[row].iter().fold(0.0_f64, |m, g| m.max(g.abs()));
                    seen[usize::from(row >= COUNT / 2)] += 1;
                    for k in 0..layout.n {
                        let eps = 1e-7;
                        let mut moved = x;
                        moved[k] = x[k] + eps;
                        let after = rows(&problem, &layout, &moved).value[row];
                        moved[k] = x[k] - eps;
                        let before = rows(&problem, &layout, &moved).value[row];
                        let differenced = (after.expect("near") - before.expect("near")) / (2.0 * eps);
                        assert!(
                            (claimed.gradient[row][k] - differenced).abs() < 1e-5 * largest.max(1.0),
                            "{below_apex_m} m, row {row} ({value}), variable {k}: {} claimed, {differenced} by differences",
                            claimed.gradient[row][k]
                        );
                    }
                }
            }
        }
        assert!(seen.iter().all(|count| *count > 3), "rows of both kinds: {seen:?}");
    }

    #[test]
    fn rows_of_windows_and_flights_have_names_with_and_without_windows() {
        let arm = Arm::load("powercube6").expect("built in");
        let (mut problem, _) = to_the_apex(&arm, 0.1);
        let number = problem.numbers();
        let name = |problem: &Problem<'_>, id: usize| describe(problem, id, &[]);
        assert_eq!(
            name(&problem, number.delay + 3),
            "shift of the landing when the gripper opens 25 ms early"
        );
        assert_eq!(
            name(&problem, number.through + 2),
            "height of the flight when the gripper opens 25 ms late"
        );
        problem.options.delay_windows.clear();
        assert_eq!(
            name(&problem, number.through + 1),
            "height of the flight when the gripper opens 10 ms early"
        );
    }

    #[test]
    fn the_row_of_a_grazing_flight_is_negative_where_the_ball_does_not_come_through_the_plane() {
        let arm = Arm::load("powercube6").expect("built in");
        let mut negative = 0;
        for below_apex_m in [0.1, 0.03, 0.01, 0.0, -0.01, -0.1] {
            let (problem, throw) = to_the_apex(&arm, below_apex_m);
            let layout = Layout::new(&problem, None);
            let found = rows(&problem, &layout, &layout.row(&throw));
            for (k, window) in problem.options.delay_windows.iter().enumerate() {
                for (side, sign) in [(0, 1.0), (1, -1.0)] {
                    let delay_s = sign * window.delay_s;
                    let aim: Aim = problem.aim;
                    let end = Landed::of(&problem, &problem.flight, &throw, &aim, delay_s);
                    let passes = end.is_some_and(|end| end.through_m_s >= THROUGH_MIN_M_S);
                    let value = found.value[COUNT / 2 + 2 * k + side];
                    assert!(passes || value.is_some_and(|value| value < 0.0), "{below_apex_m}: {value:?}");
                    negative += usize::from(value.is_some_and(|value| value < 0.0));
                }
            }
        }
        assert!(negative > 4, "{negative}");
    }
}

//! Landing of a ball whose release is late or early: the first-order condition and windows beyond it.
//!
//! While the gripper hesitates, the hand carries the ball on along its motion; a release δ late lands at
//! `L(δ) = land(p(δ), v(δ))`. With `e = a - g` the acceleration of the hand against free fall, `dL/dδ = G_v e`, which
//! vanishes exactly if e is along the velocity at the landing; then `d²L/dδ² = G_v q⃛-part + O(|e|²)` is left, and the
//! windows bound what it does.

use nalgebra::Vector2;

use super::WINDOW;
use crate::plan::landed::{Landed, Released};
use crate::plan::layout::{Layout, SLOPE};
use crate::plan::problem::Problem;
use crate::solve::{Row, Sink};
use crate::throw::Throw;

/// The first-order condition is a central difference over ± this delay; its error is ε² L‴/6, about 1e-3 mm per ms.
const SLOPE_DELAY_S: f64 = 1e-3;
/// Shifts count in centimetres, so that they weigh like the other scaled rows.
const SHIFT_SCALE: f64 = 100.0;
/// Smooths the distance at zero; far below any window.
const SHIFT_EPS_M: f64 = 1e-4;
/// A ball that comes through the plane more slowly rises hardly a millimetre above it: with a little more delay it does not get
/// there at all.
const THROUGH_MIN_M_S: f64 = 0.15;
/// Rows ask for this much more than the square of it, for what drag and rounding take.
const THROUGH_SHARE: f64 = 1.1;
/// Windows aim a little inside, so that another integration of the flight agrees.
const WINDOW_SHARE: f64 = 0.98;

/// `dL/dδ = 0` and `|L(δ) - L(0)| ≤ window` for late and early release.
pub(super) fn delay_rows<S: Sink<D>, const N: usize, const D: usize>(
    problem: &Problem<'_, N>,
    layout: &Layout<N>,
    x: &Row<D>,
    throw: &Throw<N>,
    sink: &mut S,
) {
    let var = Layout::<N>::VARIABLES;
    let number = Layout::<N>::NUMBERS;
    if !problem.options.null_delay {
        return;
    }
    let aim = layout.aim(problem, x);
    let late = |delay_s: f64| Landed::of(problem, &problem.flight, throw, &aim, delay_s);
    if sink.wants_eq(SLOPE) || sink.wants_eq(SLOPE + 1) {
        match (late(SLOPE_DELAY_S), late(-SLOPE_DELAY_S)) {
            (Some(after), Some(before)) => {
                let scale = 0.5 / SLOPE_DELAY_S;
                let value = (after.xy - before.xy) * scale;
                for (i, axis) in [Vector2::x(), Vector2::y()].into_iter().enumerate() {
                    sink.eq(SLOPE + i, value[i], |g| {
                        after.add_gradient(g, layout, &(axis * scale));
                        before.add_gradient(g, layout, &(axis * -scale));
                    });
                }
            }
            _ => {
                for i in 0..2 {
                    sink.eq(SLOPE + i, 1e3, |_| {});
                }
            }
        }
    }
    if problem.options.delay_windows.is_empty() {
        return;
    }
    // Measured from where this throw lands, not from the target: whether it hits is another row's business, and a row
    // that mixes both is stiff wherever the throw still misses by metres.
    let on_time = late(0.0);
    for (k, window) in problem.options.delay_windows.iter().enumerate() {
        for (side, sign) in [(0, 1.0), (1, -1.0)] {
            let id = number.delay + 2 * k + side;
            if !sink.wants(id) && !sink.wants(number.through + 2 * k + side) {
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
            let energy = released.through_m2_s2(&problem.flight, &aim)
                - THROUGH_SHARE * THROUGH_MIN_M_S * THROUGH_MIN_M_S;
            if energy < WINDOW {
                sink.ineq(number.through + 2 * k + side, energy, |g| {
                    released.add_through_gradient(g, layout, &problem.flight, &aim);
                });
            }
            let end = Landed::after(&released, &problem.flight, &aim);
            let (Some(end), Some(on_time)) = (end.filter(|end| end.through_m_s >= THROUGH_MIN_M_S), &on_time)
            else {
                if energy >= 0.0 {
                    sink.ineq(id, -1e3, |_| {});
                }
                continue;
            };
            let off = end.xy - on_time.xy;
            let distance_m = (off.norm_squared() + SHIFT_EPS_M * SHIFT_EPS_M).sqrt();
            let value = (window.shift_m * WINDOW_SHARE - distance_m) * SHIFT_SCALE;
            if value < WINDOW {
                sink.ineq(id, value, |g| {
                    let along = off * (-SHIFT_SCALE / distance_m);
                    end.add_gradient(g, layout, &along);
                    on_time.add_gradient(g, layout, &-along);
                    if let Some((at, axes)) = layout.shift {
                        let by_plane = along.dot(&(end.by_plane - on_time.by_plane));
                        for (a, n) in aim.normal().iter().enumerate().filter(|(a, _)| axes[*a]) {
                            g.add(at + a, by_plane * n);
                        }
                    }
                });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::flight::Aim;
    use crate::plan::layout::width;
    use crate::plan::options::Options;
    use crate::plan::paper::PaperParameters;
    use crate::solve::Gradient;
    use crate::throw::Arm;

    const WIDE: usize = width(6);
    const FIRST: usize = Layout::<6>::NUMBERS.delay;
    const COUNT: usize = Layout::<6>::NUMBERS.cut - FIRST;

    /// Takes the inequalities of windows and flights.
    struct Rows {
        value: [Option<f64>; COUNT],
        gradient: [Row<WIDE>; COUNT],
    }

    impl Sink<WIDE> for Rows {
        fn wants(&self, _: usize) -> bool {
            true
        }
        fn wants_eq(&self, _: usize) -> bool {
            false
        }
        fn objective(&mut self, _: f64, _: impl FnOnce(&mut Gradient<'_, WIDE>)) {}
        fn eq(&mut self, _: usize, _: f64, _: impl FnOnce(&mut Gradient<'_, WIDE>)) {}
        fn ineq(&mut self, id: usize, value: f64, gradient: impl FnOnce(&mut Gradient<'_, WIDE>)) {
            self.value[id - FIRST] = Some(value);
            gradient(&mut Gradient { row: &mut self.gradient[id - FIRST], factor: 1.0 });
        }
    }

    fn rows(problem: &Problem<'_, 6>, layout: &Layout<6>, x: &Row<WIDE>) -> Rows {
        let mut rows = Rows { value: [None; COUNT], gradient: [[0.0; WIDE]; COUNT] };
        delay_rows(problem, layout, x, &layout.throw(x), &mut rows);
        rows
    }

    /// A throw with the target above the point of release, at the height in m that the ball reaches less `below_apex_m`.
    fn to_the_apex(arm: &Arm, below_apex_m: f64) -> (Problem<'_, 6>, Throw<6>) {
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
                let x = layout.variables(&throw);
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
    fn the_row_of_a_grazing_flight_is_negative_where_the_ball_does_not_come_through_the_plane() {
        let arm = Arm::load("powercube6").expect("built in");
        let mut negative = 0;
        for below_apex_m in [0.1, 0.03, 0.01, 0.0, -0.01, -0.1] {
            let (problem, throw) = to_the_apex(&arm, below_apex_m);
            let layout = Layout::new(&problem, None);
            let found = rows(&problem, &layout, &layout.variables(&throw));
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

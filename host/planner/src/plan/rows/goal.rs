//! The part of the objective that depends on the landing or the energy.

use super::Layout;
use crate::plan::energy::energy;
use crate::plan::goal::{ENERGY_SCALE_1_J, Goal};
use crate::plan::problem::Problem;
use crate::plan::spread::Spread;
use crate::solve::{Row, Sink};

/// Whether [`goal_rows`] adds anything.
pub(crate) fn has_goal(problem: &Problem<'_>, layout: &Layout) -> bool {
    problem.options.goal != Goal::Effort && layout.shift.is_none()
}

/// Energy, spread or odds of the landing; no row for the paper's objective, and none while the target itself moves.
pub(crate) fn goal_rows<S: Sink>(problem: &Problem<'_>, layout: &Layout, x: &Row, sink: &mut S) {
    if !has_goal(problem, layout) {
        return;
    }
    let goal = &problem.options.goal;
    let throw = layout.throw(x);
    let Some(noise) = goal.noise() else {
        let Some(used) = energy(problem, layout, &throw) else {
            sink.objective(f64::INFINITY, |_| {});
            return;
        };
        sink.objective(ENERGY_SCALE_1_J * used.joule, |g| {
            for (i, by) in used.gradient.iter().enumerate().take(layout.n) {
                g.add(i, ENERGY_SCALE_1_J * by);
            }
        });
        return;
    };
    let Some(spread) = Spread::of(problem, &throw, &problem.aim, noise) else {
        sink.objective(f64::INFINITY, |_| {});
        return;
    };
    if let Some(price) = goal.price(&spread.mean_m, &spread.covariance_m2, &problem.aim.centre()) {
        sink.objective(price.value, |g| {
            spread.add_gradient(g, layout, &price.by_mean, &price.by_covariance);
        });
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::plan::paper::PaperParameters;
    use crate::plan::problem::Options;
    use crate::plan::statistics::{Noise, Region};
    use crate::solve::{Gradient, WIDTH};
    use crate::throw::{Arm, Joints};

    /// Takes the objective and nothing else.
    struct Objective {
        value: f64,
        gradient: Row,
    }

    impl Sink for Objective {
        fn wants(&self, _: usize) -> bool {
            false
        }
        fn wants_eq(&self, _: usize) -> bool {
            false
        }
        fn objective(&mut self, value: f64, gradient: impl FnOnce(&mut Gradient<'_>)) {
            self.value += value;
            gradient(&mut Gradient { row: &mut self.gradient, factor: 1.0 });
        }
        fn eq(&mut self, _: usize, _: f64, _: impl FnOnce(&mut Gradient<'_>)) {}
        fn ineq(&mut self, _: usize, _: f64, _: impl FnOnce(&mut Gradient<'_>)) {}
    }

    #[test]
    fn gradients_of_spread_and_odds_match_differences() {
        let arm = Arm::load("powercube6").expect("built in");
        // Jitter long enough that the tails reach beyond the braking phase.
        let noise = Noise { release_time_s: 0.02, ..Noise::default() };
        let h = PaperParameters::from_array([0.493, -0.465, 0.858, 0.583, -1.098, 0.586, 0.920, 0.06]);
        for (goal, drag_per_m) in [
            (Goal::Spread(noise), 0.0),
            (Goal::Spread(noise), 0.004),
            (Goal::Miss(noise, Region::Disc { radius_m: 0.06 }), 0.0),
            (Goal::Miss(noise, Region::Box { half_x_m: 0.03, half_y_m: 0.08 }), 0.0),
        ] {
            let options = Options { goal, drag_per_m, ..Options::best() };
            let problem = Problem::new(&arm, Vector3::new(1.0, 1.0, -1.0), options).expect("valid");
            let layout = Layout::new(&problem, None);
            let mut throw = h.throws(&problem)[0].throw;
            throw.qdd_rad_s2 = Joints::from_slice(&[0.5, -1.0, 2.0, 0.3, -0.7, 1.1]);
            let x = layout.row(&throw);
            let at = |x: &Row| {
                let mut sink = Objective { value: 0.0, gradient: [0.0; WIDTH] };
                goal_rows(&problem, &layout, x, &mut sink);
                sink
            };
            let claimed = at(&x);
            assert!(claimed.value.is_finite());
            let largest = claimed.gradient.iter().fold(0.0_f64, |m, g| m.max(g.abs()));
            for k in 0..layout.n {
                let mut moved = x;
                let eps = 1e-5;
                moved[k] = x[k] + eps;
                let after = at(&moved).value;
                moved[k] = x[k] - eps;
                let differenced = (after - at(&moved).value) / (2.0 * eps);
                assert!(
                    (claimed.gradient[k] - differenced).abs() < 1e-5 * largest,
                    "{goal:?}, variable {k}: {} claimed, {differenced} by differences",
                    claimed.gradient[k]
                );
            }
        }
    }
}

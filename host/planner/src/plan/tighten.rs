//! Continuation in the arrival attitude: a throw that lands on the target, brought to the attitude asked for in steps.
//!
//! The angles that are allowed begin at those of the throw and shrink. A direction in the world is not turned with the azimuth
//! of the target, so stored throws keep their price and their basin only without it; from there the steps lead on.

use super::attitude::arrived_with_delay;
use super::local::Found;
use super::options::{Attitude, Cone};
use super::outcome::NearestAttitude;
use super::planner::Planner;
use super::problem::Problem;
use crate::solve::sqp::Settings;
use crate::throw::Throw;

/// Local solves on the way.
const SOLVES_MAX: usize = 16;
/// Shortest step in rad.
const STEP_MIN_RAD: f64 = 0.02;

impl<'a, const N: usize> Planner<'_, 'a, N> {
    /// The problem with nothing asked of the arrival attitude; `None` if nothing is.
    pub(super) fn without_attitude(&self) -> Option<Problem<'a, N>> {
        let attitude = self.problem.options.attitude.filter(Attitude::is_asked)?;
        Some(self.with_attitude(attitude.unasked()))
    }

    fn with_attitude(&self, attitude: Attitude) -> Problem<'a, N> {
        let mut problem = self.problem.clone();
        problem.options.attitude = Some(attitude);
        problem
    }

    /// From a throw to this target with any attitude to one with the attitude asked for: a step that fails is halved, one that
    /// succeeds doubles the next.
    ///
    /// # Errors
    /// The nearest attitude on the way; `None` if the throw does not arrive.
    pub(super) fn tighten(
        &self,
        start: &Throw<N>,
        stopped: &dyn Fn() -> bool,
    ) -> Result<Found<N>, Option<NearestAttitude>> {
        let asked = self.problem.options.attitude.ok_or(None)?;
        let excess_of = |throw: &Throw<N>| {
            arrived_with_delay(self.problem, throw, 0.0).map(|arrived| arrived.excess_rad(&asked))
        };
        let mut throw = *start;
        let mut excess_rad = excess_of(&throw).ok_or(None)?.max(0.0);
        let mut step_rad = excess_rad;
        for _ in 0..SOLVES_MAX {
            if stopped() {
                break;
            }
            let next_rad = (excess_rad - step_rad).max(0.0);
            if next_rad == 0.0 {
                let found = self.solve(&throw, self.anywhere(), &Settings::default(), usize::MAX);
                if let Some(found) = found {
                    return Ok(found);
                }
            } else {
                let wider = self.with_attitude(widened(&asked, next_rad));
                let found = Planner::new(&wider).solve_from_throw(&throw);
                if let Some((found, left_rad)) = found.and_then(|f| Some((f, excess_of(&f.throw)?))) {
                    throw = found.throw;
                    excess_rad = left_rad.clamp(0.0, next_rad);
                    step_rad = (2.0 * step_rad).min(excess_rad);
                    continue;
                }
            }
            step_rad *= 0.5;
            if step_rad < STEP_MIN_RAD {
                break;
            }
        }
        Err(self.nearest_attitude(&asked, &throw))
    }

    /// What stops a throw with an attitude that is too far from the one asked for.
    fn nearest_attitude(&self, asked: &Attitude, throw: &Throw<N>) -> Option<NearestAttitude> {
        let arrived = arrived_with_delay(self.problem, throw, 0.0)?;
        let [axis_rad, spin_rad] = arrived.angles_rad(asked);
        let of = |what, angle_rad: Option<f64>, cone: Option<Cone>, direction_w| {
            Some(NearestAttitude {
                what,
                direction_w,
                angle_rad: angle_rad?,
                angle_max_rad: cone?.angle_max_rad,
            })
        };
        let axis = of("arrival axis", axis_rad, asked.axis, Some(arrived.axis_w));
        let spin = of("spin axis", spin_rad, asked.spin, arrived.spin_axis_w());
        axis.into_iter().chain(spin).max_by(|a, b| a.excess_rad().total_cmp(&b.excess_rad()))
    }
}

fn widened(asked: &Attitude, by_rad: f64) -> Attitude {
    let wider = |cone: Cone| Cone { angle_max_rad: cone.angle_max_rad + by_rad, ..cone };
    Attitude { axis: asked.axis.map(wider), spin: asked.spin.map(wider), ..*asked }
}

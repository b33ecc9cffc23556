//! The nearest reachable target, for one that is not.

use nalgebra::Vector3;

use super::local::{Nearest, nearest_from};
use super::outcome::Budget;
pub use super::outcome::NearestTarget;
use super::planner::{Planner, kind_of};
use super::posture::resting_start;
use super::problem::Problem;
use super::rng::SplitMix64;
use crate::parallel::each;
use crate::solve::sqp::Settings;
use crate::store::{Index, Record};
use crate::throw::Throw;

/// Stored throws, and random points, from which the nearest target is looked for.
const STORED_STARTS: usize = 12;
const RANDOM_STARTS: u64 = 48;
/// A nearest target within this distance is believed at once, in m.
const DIRECT_MAX_M: f64 = 0.5;
/// Where that fails, because the target is too far for it, throws are walked towards it from this many stored targets.
const WALKED: usize = 12;
/// Random starts for a stored target to which the stored throw does not lead under the options at hand.
const WALK_RANDOM_STARTS: u64 = 8;
/// First and shortest step, steps, and the gain below which a step is the last one.
const WALK_STEP_M: f64 = 0.2;
const WALK_STEP_MIN_M: f64 = 0.02;
const WALK_STEPS_MAX: usize = 40;
const WALK_GAIN_M: f64 = 1e-3;

impl Planner<'_, '_> {
    /// The nearest reachable target: from stored throws in the direction of the target, and from random starts.
    #[must_use]
    pub fn nearest(&self, index: &Index, budget: &Budget) -> Option<(NearestTarget, Throw)> {
        let kind = kind_of(&self.problem.options);
        let stored = self.stored_near(index, |r| r.kind == kind, STORED_STARTS);
        let mut starts: Vec<Throw> = stored.iter().filter_map(|r| self.place(&r.throw)).collect();
        for k in 0..RANDOM_STARTS {
            let mut rng = SplitMix64::stream(budget.seed ^ 0x6E65_6172, k);
            starts.push(resting_start(self.problem, &mut rng));
        }
        let direct = each(&starts, |s| {
            let n = self.nearest_from_throw(s, [true; 3])?;
            Some((self.nearest_target(self.problem.target + n.shift_m, n.constraint), n.throw))
        });
        let direct = least(direct.into_iter().flatten().collect());
        if direct.as_ref().is_some_and(|(n, _)| n.distance_m < DIRECT_MAX_M) {
            return direct;
        }
        let walked = {
            // The nearest ones may lie on the edge of the reach of other options: some of the nearer half of all.
            let stored = self.stored_near(index, |_| true, index.records().len().div_ceil(2));
            let apart = stored.len().div_ceil(WALKED).max(1);
            let some: Vec<&Record> = stored.into_iter().step_by(apart).collect();
            each(&some, |record| self.walk(record, budget.seed))
        };
        least(walked.into_iter().flatten().chain(direct).collect())
    }

    /// The nearest reachable target along some axes, from one throw.
    #[must_use]
    pub fn nearest_from_throw(&self, start: &Throw, axes: [bool; 3]) -> Option<Nearest> {
        nearest_from(self.problem, &self.scanner, start, axes, &Settings::default()).ok()
    }

    fn nearest_target(&self, point: Vector3<f64>, constraint: String) -> NearestTarget {
        NearestTarget { point, distance_m: (point - self.problem.target).norm(), constraint }
    }

    /// Stored throws to the targets nearest to this one, the nearest first.
    pub(super) fn stored_near<'i>(
        &self,
        index: &'i Index,
        wanted: impl Fn(&Record) -> bool,
        most: usize,
    ) -> Vec<&'i Record> {
        let mut stored: Vec<&Record> = index.records().iter().filter(|r| wanted(r)).collect();
        stored.sort_by(|a, b| self.away_m(a).total_cmp(&self.away_m(b)));
        stored.truncate(most);
        stored
    }

    /// From a stored target, with whatever options it was reached, towards this one.
    fn walk(&self, record: &Record, seed: u64) -> Option<(NearestTarget, Throw)> {
        let (arm, target) = (self.problem.arm, self.problem.target);
        let (sin, cos) = self.azimuth_rad.sin_cos();
        let options = &self.problem.options;
        let mut at = Vector3::new(record.range_m * cos, record.range_m * sin, record.height_m);
        let own = Problem::new(arm, at, options.clone()).ok()?;
        let planner = Planner::new(&own);
        let random = || (0..WALK_RANDOM_STARTS).find_map(|k| planner.random_start(seed, k));
        let mut throw = planner.from_record(record).or_else(random)?.throw;
        let (mut constraint, mut step_m) = (String::new(), WALK_STEP_M);
        for _ in 0..WALK_STEPS_MAX {
            let way = target - at;
            let next = at + way * (step_m / way.norm().max(step_m));
            let n = Problem::new(arm, next, options.clone())
                .ok()
                .and_then(|problem| Planner::new(&problem).nearest_from_throw(&throw, [true; 3]));
            let Some(n) = n else {
                step_m *= 0.5;
                if step_m < WALK_STEP_MIN_M {
                    break;
                }
                continue;
            };
            let there = next + n.shift_m;
            let gain = way.norm() - (target - there).norm();
            if gain > 0.0 {
                (at, throw) = (there, n.throw);
            }
            constraint = n.constraint;
            if gain < WALK_GAIN_M {
                break;
            }
        }
        // Without any step the way on is closed, by what is not known.
        if constraint.is_empty() {
            "several limits at once".clone_into(&mut constraint);
        }
        Some((self.nearest_target(at, constraint), throw))
    }
}

fn least(found: Vec<(NearestTarget, Throw)>) -> Option<(NearestTarget, Throw)> {
    found.into_iter().min_by(|a, b| a.0.distance_m.total_cmp(&b.0.distance_m))
}

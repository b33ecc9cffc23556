//! The nearest reachable target, for one that is not.

use nalgebra::Vector3;

use super::local::{Nearest, nearest_from};
pub use super::outcome::NearestTarget;
use super::outcome::{Budget, NoThrow, Watch};
use super::planner::{Planner, kind_of};
use super::posture::resting_start;
use super::problem::Problem;
use super::rng::SplitMix64;
use super::warm_start::RINGS;
use crate::parallel::each;
use crate::solve::sqp::Settings;
use crate::store::{Index, Record};
use crate::throw::Throw;

/// Stored throws, and random points, from which the nearest target is looked for.
const STORED_STARTS: usize = 12;
const RANDOM_STARTS: u64 = 48;
/// A nearest target within this distance is believed at once, in m.
const DIRECT_MAX_M: f64 = 0.5;
/// If that fails because the target is too far for it, throws are walked towards it from this many stored targets.
const WALKED: usize = 12;
/// Random starts for a stored target to which the stored throw does not lead under the options at hand.
const WALK_RANDOM_STARTS: u64 = 8;
/// First and shortest step, steps, and the gain below which a step is the last one.
const WALK_STEP_M: f64 = 0.2;
const WALK_STEP_MIN_M: f64 = 0.02;
const WALK_STEPS_MAX: usize = 40;
const WALK_GAIN_M: f64 = 1e-3;
/// A target farther than this from the reach of the stored throws is refused without a search, in m.
const CLEARLY_M: f64 = 0.05;
/// Stored throws that are tried, moved, and walked before a target is refused without a search.
const QUICK_TRIES: usize = 6;
const QUICK_STARTS: usize = 8;
const QUICK_WALKED: usize = 3;
/// Distances inside the edge of the reach at which a target that a search finds is sought, in m, one after the other.
const INWARD_M: [f64; 3] = [0.0, 0.003, 0.02];
/// Shares of the way from there to the nearest stored target.
const SHARES: [f64; 3] = [0.25, 0.5, 1.0];

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
            // The nearest ones may be at the edge of the reach of other options: some of the nearer half of all.
            let stored = self.stored_near(index, |_| true, index.records().len().div_ceil(2));
            let apart = stored.len().div_ceil(WALKED).max(1);
            let some: Vec<&Record> = stored.into_iter().step_by(apart).collect();
            each(&some, |record| self.walk(record, budget.seed))
        };
        least(walked.into_iter().flatten().chain(direct).collect())
    }

    /// The refusal of a target that lies clearly beyond the edge of a table of stored throws, without a search: no stored
    /// throw leads there, and the few nearest ones can be moved no nearer than `CLEARLY_M`. `None`: only a search can say.
    #[must_use]
    pub fn refused_at_once(&self, index: &Index, budget: &Budget, watch: &Watch) -> Option<NoThrow> {
        let (kind, options) = (kind_of(&self.problem.options), &self.problem.options);
        let reported = self.has_table(index) && options.obstacles.is_empty() && options.course.is_at_rest();
        let inside = || {
            let near = !self.warm_starts(index, 1).is_empty();
            near && index.surrounds(kind, self.range_m, self.problem.target.z, RINGS)
        };
        if !reported || inside() || self.from_index(index, QUICK_TRIES).is_some() {
            return None;
        }
        let near = self.stored_near(index, |r| r.kind == kind, QUICK_STARTS);
        let direct = each(&near, |record| {
            let n = self.nearest_from_throw(&self.place(&record.throw)?, [true; 3])?;
            Some((self.nearest_target(self.problem.target + n.shift_m, n.constraint), n.throw))
        });
        let direct = least(direct.into_iter().flatten().collect());
        let found = match direct {
            Some(direct) if direct.0.distance_m < DIRECT_MAX_M => Some(direct),
            direct => {
                let walked = each(&near[..near.len().min(QUICK_WALKED)], |r| self.walk(r, budget.seed));
                least(walked.into_iter().flatten().chain(direct).collect())
            }
        };
        let (nearest, _) = found.filter(|(nearest, _)| nearest.distance_m > CLEARLY_M)?;
        Some(NoThrow {
            target: self.problem.target,
            nearest: Some(self.proven(&nearest, index, budget, watch)?),
            obstruction: None,
            starts: 0,
            interrupted: false,
        })
    }

    /// The nearest target in round numbers to which a search finds a throw: at `nearest`, a little inside the edge of the reach, or
    /// on the way from there to the nearest stored target. `None` if there is none.
    pub(super) fn proven(
        &self,
        nearest: &NearestTarget,
        index: &Index,
        budget: &Budget,
        watch: &Watch,
    ) -> Option<NearestTarget> {
        let away = (nearest.point - self.problem.target).try_normalize(1e-9)?;
        let kind = kind_of(&self.problem.options);
        let stored = self.stored_near(index, |r| r.kind == kind, 1);
        let to_stored = stored.first().map(|record| self.stored_target(record) - nearest.point);
        let inside = INWARD_M.into_iter().map(|inward_m| away * inward_m);
        let between = to_stored.iter().flat_map(|way| SHARES.map(|share| way * share));
        // A search begins with the stored throws: what they lead to, it finds.
        let budget = if stored.is_empty() { *budget } else { Budget { starts: 0, ..*budget } };
        inside.chain(between).find_map(|shift| {
            let point = (nearest.point + shift).map(|x| (x * 1e3).round() / 1e3 + 0.0);
            let problem = Problem::new(self.problem.arm, point, self.problem.options.clone()).ok()?;
            let found = Planner::new(&problem).persistent().attempt(index, &budget, watch).is_ok();
            found.then(|| self.nearest_target(point, nearest.constraint.clone()))
        })
    }

    /// The target of a stored throw, turned into the direction of this one.
    fn stored_target(&self, record: &Record) -> Vector3<f64> {
        let (sin, cos) = self.azimuth_rad.sin_cos();
        Vector3::new(record.range_m * cos, record.range_m * sin, record.height_m)
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

    /// From a stored target, reached with any options, towards this one.
    fn walk(&self, record: &Record, seed: u64) -> Option<(NearestTarget, Throw)> {
        let (arm, target) = (self.problem.arm, self.problem.target);
        let options = &self.problem.options;
        let mut at = self.stored_target(record);
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

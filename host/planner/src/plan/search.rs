//! Search: stored throws, continuation from their neighbours, then seeded random starts until more of them hardly help.

use std::sync::atomic::Ordering;
use std::time::Instant;

use super::local::{Begin, Found, evaluate_once, solve_from};
use super::obstruction::obstruction;
use super::optima::{ENOUGH_STORED, Optima, Surroundings};
pub use super::outcome::{Best, Budget, NoThrow, Watch};
pub use super::planner::{Planner, kind_of};
use super::warm_start::{RINGS, WarmStart, warm_starts};
use crate::parallel::each;
use crate::solve::sqp::{Chord, Settings};
use crate::store::{Index, Record};
use crate::throw::Throw;

impl Planner<'_, '_> {
    /// One local solve from random point number `index` of the search space.
    #[must_use]
    pub fn random_start(&self, seed: u64, index: u64) -> Option<Found> {
        Some(self.refine(self.solve_random(seed, index, None)?))
    }

    /// One local solve from a throw for a near target.
    #[must_use]
    pub fn from_throw(&self, start: &Throw) -> Option<Found> {
        Some(self.refine(self.solve_from_throw(start)?))
    }

    /// As [`Planner::from_throw`], without the second stage for other goals than the paper's objective.
    pub(super) fn solve_from_throw(&self, start: &Throw) -> Option<Found> {
        self.solve(start, self.anywhere(), &Settings::default(), usize::MAX)
    }

    /// A local solve from a throw with steps enough to end where it leads.
    #[must_use]
    pub fn finished(&self, start: &Throw) -> Option<Found> {
        let settings = Settings { iterations_max: FINISH_STEPS, ..Settings::default() };
        self.solve(start, self.anywhere(), &settings, FINISH_STEPS)
    }

    /// One local solve from a stored throw.
    #[must_use]
    pub fn from_record(&self, record: &Record) -> Option<Found> {
        Some(self.refine(self.polish(record, &Settings::default(), usize::MAX)?))
    }

    /// The second stage for a goal other than the paper's objective: from a throw that keeps every limit downhill
    /// in the goal. Never worse than the throw itself.
    fn refine(&self, found: Found) -> Found {
        if self.effort.is_none() {
            return found;
        }
        let as_it_is =
            Found { objective: self.problem.options.goal.value(self.problem, &found.throw), ..found };
        let settings = Settings {
            iterations_max: REFINE_STEPS,
            objective: 1e-5,
            // Long ways downhill run beside curved constraints, not on them.
            patience: REFINE_STEPS,
            ..Settings::default()
        };
        let better = solve_from(
            self.problem,
            &self.scanner,
            &found.throw,
            self.anywhere(),
            &settings,
            2 * REFINE_STEPS,
        );
        match better {
            Ok(better) if better.objective < as_it_is.objective => {
                Found { iterations: better.iterations + found.iterations, ..better }
            }
            _ => as_it_is,
        }
    }

    /// The second stage for the throws that are best as they are; the others would hardly overtake them.
    fn refine_best(&self, found: Vec<Found>) -> Vec<Found> {
        if self.effort.is_none() {
            return found;
        }
        let goal = &self.problem.options.goal;
        let as_they_are: Vec<Found> =
            each(&found, |f| Found { objective: goal.value(self.problem, &f.throw), ..*f });
        let mut best = distinct(as_they_are);
        best.truncate(REFINED_MAX);
        distinct(each(&best, |f| self.refine(*f)))
    }

    pub(super) fn polish(&self, record: &Record, settings: &Settings, most: usize) -> Option<Found> {
        let begin = Begin::Optimal { touches: record.touches };
        self.solve(&self.place(&record.throw)?, begin, settings, most)
    }

    /// The best throw from stored throws alone, in a fraction of a millisecond.
    ///
    /// Stored throws are tried in the order of their expected prices. Each gets only a few steps, because a good
    /// start needs no more and a bad one would need hundreds; `tries` bounds the local solves. If none of them ends
    /// in a throw, all the others around are tried, then the most promising ones with more steps, unless the table
    /// ends before the target.
    #[must_use]
    pub fn from_index(&self, index: &Index, tries: usize) -> Option<Found> {
        let order = self.warm_starts(index, MORE_TRIES.max(tries));
        let (first, rest) = order.split_at(tries.min(order.len()));
        let patient =
            Settings { objective: 1e-4, feasibility: 1e-7, patience: STORED_PATIENCE, ..Settings::default() };
        let patiently = || {
            let (kind, height_m) = (kind_of(&self.problem.options), self.problem.target.z);
            let beyond_the_edge = !index.surrounds(kind, self.range_m, height_m, RINGS);
            let tried = if beyond_the_edge { &[] } else { first };
            tried.iter().find_map(|(_, record)| self.polish(record, &patient, PATIENT_STEPS))
        };
        self.first_pass(first)
            .or_else(|| self.first_pass(rest))
            .or_else(patiently)
            .map(|found| self.refine(found))
    }

    /// As [`Planner::from_index`], and if no stored throw leads to the target, the first of at most `starts` random
    /// ones that does.
    #[must_use]
    pub fn from_index_or_random(&self, index: &Index, tries: usize, starts: u64, seed: u64) -> Option<Found> {
        self.from_index(index, tries).or_else(|| (0..starts).find_map(|k| self.random_start(seed, k)))
    }

    /// As [`Planner::from_index`], but gives up after the quick pass.
    #[must_use]
    pub fn from_index_quickly(&self, index: &Index, tries: usize) -> Option<Found> {
        self.quickly(&self.warm_starts(index, tries))
    }

    /// The first pass with its second stage.
    pub(super) fn quickly(&self, order: &[WarmStart<'_>]) -> Option<Found> {
        self.first_pass(order).map(|found| self.refine(found))
    }

    pub(super) fn warm_starts<'i>(&self, index: &'i Index, most: usize) -> Vec<WarmStart<'i>> {
        warm_starts(index, kind_of(&self.problem.options), self.range_m, self.problem.target.z, most)
    }

    fn first_pass(&self, order: &[WarmStart<'_>]) -> Option<Found> {
        let mut best: Option<Found> = None;
        let mut in_vain = 0;
        for (price, record) in order {
            let bound = best.map_or(f64::INFINITY, |b| b.objective * WORTH_FINDING);
            if best.is_some() && (price * WORTH_TRYING > bound || in_vain == IN_VAIN_MAX) {
                break;
            }
            let settings = Settings { give_up_above: bound, ..QUICK };
            match self.polish(record, &settings, QUICK_STEPS) {
                Some(found) if found.objective < bound => best = Some(found),
                _ => in_vain += usize::from(best.is_some()),
            }
        }
        best
    }

    /// The best throw within a budget.
    ///
    /// Stored throws are polished first, then random starts run on all cores until more of them hardly help. The
    /// result depends only on the index, the seed and the number of starts, unless time or `watch.stop` ends the
    /// search.
    ///
    /// # Errors
    /// [`NoThrow`] with the nearest reachable target if no start ends in a throw.
    pub fn search(&self, index: &Index, budget: &Budget, watch: &Watch) -> Result<Best, NoThrow> {
        let began = Instant::now();
        // A search that may end in a refusal takes its time.
        let persistent = self.clone().persistent();
        let none = match persistent.attempt(index, budget, watch) {
            Ok(best) => return Ok(best),
            Err(none) => none,
        };
        if watch.stop.load(Ordering::Relaxed) {
            return Err(none);
        }
        let stopped =
            || watch.stop.load(Ordering::Relaxed) || budget.time.is_some_and(|t| began.elapsed() >= t);
        if !stopped()
            && let Some(best) = self.best_of(&persistent.walk_from_nearest(index, &stopped, watch), &stopped)
        {
            return Ok(Best { starts: none.starts + best.starts, ..best });
        }
        if let Some(found) = obstruction(self.problem) {
            return Err(NoThrow { obstruction: Some(Box::new(found)), ..none });
        }
        let Some((nearest, throw)) = self.nearest(index, budget) else { return Err(none) };
        // Looking for the nearest target is itself a way in: it may end at the target.
        if nearest.distance_m < REACHED_M {
            let Some(found) = self.from_throw(&throw) else { return Err(none) };
            let mut optima = Optima::default();
            optima.add_random(Some(found));
            let (starts, interrupted) = (none.starts, none.interrupted);
            let confidence = optima.confidence();
            return Ok(Best { found, starts, solved: 1, interrupted, confidence, others: vec![found] });
        }
        Err(NoThrow { nearest: persistent.proven(&nearest, index, budget, watch), ..none })
    }

    /// True if the index allows conclusions about targets that it has no throw for.
    pub(super) fn has_table(&self, index: &Index) -> bool {
        let kind = kind_of(&self.problem.options);
        let for_such_targets = self.problem.aim.is_level() && self.problem.options.opening.is_none();
        index.is_own()
            && for_such_targets
            && index.records().iter().filter(|r| r.kind == kind).count() >= TABLE_MIN
    }

    /// Walks to the target from the stored throws nearest to it, with any expected price.
    ///
    /// A kind of throw that reaches farther is often more expensive than the kind that ends before the target.
    /// Stored throws of the cheaper kind are tried first and all end at the edge of its reach.
    fn walk_from_nearest(&self, index: &Index, stopped: &(dyn Fn() -> bool + Sync), watch: &Watch) -> Optima {
        let kind = kind_of(&self.problem.options);
        let wanted = |r: &Record| r.kind == kind && self.away_m(r) <= WALKED_WITHIN_M;
        let walked = each(&self.stored_near(index, wanted, NEAREST_WALKED), |record| {
            (!stopped()).then(|| counted(watch, self.walk_to_target(record, stopped)))
        });
        let mut optima = Optima::default();
        walked.into_iter().flatten().for_each(|found| optima.add_stored(found));
        optima
    }

    /// The best of the throws that some starts ended in; `None` if no start ended in a throw.
    pub(super) fn best_of(&self, optima: &Optima, stopped: &(dyn Fn() -> bool + Sync)) -> Option<Best> {
        let others = self.finish(optima, stopped);
        Some(Best {
            found: *others.first()?,
            starts: optima.starts(),
            solved: optima.solved(),
            interrupted: stopped(),
            confidence: optima.confidence(),
            others,
        })
    }

    /// As [`Planner::search`], but without the walks and without a search for the nearest reachable target if there is no
    /// throw.
    ///
    /// # Errors
    /// [`NoThrow`] if no start ends in a throw.
    pub fn attempt(&self, index: &Index, budget: &Budget, watch: &Watch) -> Result<Best, NoThrow> {
        let began = Instant::now();
        let out_of_time = || budget.time.is_some_and(|t| began.elapsed() >= t);
        let stopped = || watch.stop.load(Ordering::Relaxed) || out_of_time();
        let mut optima = Optima::default();
        let surroundings = self.polish_stored(index, &mut optima, &stopped, watch);
        let batch = if surroundings == Surroundings::Stored { ENOUGH_STORED } else { BATCH };
        // Without a table, a throw that was found by only one or two starts is seldom the best one. So more starts are made.
        let most = |optima: &Optima| {
            let more = !budget.all && surroundings == Surroundings::Unknown && optima.solved() > 0;
            budget.starts.saturating_mul(if more { MORE_STARTS } else { 1 })
        };
        let mut begun = 0;
        while begun < most(&optima)
            && !stopped()
            && (budget.all || !optima.enough(surroundings, self.problem.options.null_delay))
        {
            let batch: Vec<u64> = ((begun as u64)..(most(&optima).min(begun + batch) as u64)).collect();
            begun += batch.len();
            let known = (surroundings == Surroundings::Unknown).then(|| optima.found());
            let ended = each(&batch, |k| {
                (!stopped()).then(|| counted(watch, self.solve_random(budget.seed, *k, known.as_deref())))
            });
            ended.into_iter().flatten().for_each(|found| optima.add_random(found));
        }
        let interrupted = stopped() && (begun < most(&optima) || optima.random() < begun);
        let best = self.best_of(&optima, &stopped).map(|best| Best { interrupted, ..best });
        best.ok_or_else(|| NoThrow {
            target: self.problem.target,
            nearest: None,
            obstruction: None,
            starts: optima.starts(),
            interrupted,
        })
    }

    /// Polishes the stored throws around the target. If none of them leads there, walks from their targets to this one,
    /// and from throws that were stored for other constraints.
    fn polish_stored(
        &self,
        index: &Index,
        optima: &mut Optima,
        stopped: &(dyn Fn() -> bool + Sync),
        watch: &Watch,
    ) -> Surroundings {
        let kind = kind_of(&self.problem.options);
        let near = self.warm_starts(index, STORED_TRIES);
        let solve = |work: &(dyn Fn() -> Option<Found> + Sync)| (!stopped()).then(|| counted(watch, work()));
        let polished =
            each(&near, |(_, record)| solve(&|| self.polish(record, &Settings::default(), usize::MAX)));
        polished.into_iter().flatten().for_each(|found| optima.add_stored(found));
        // What answers at once must not be better than a search.
        if let Some(found) = self.first_pass(&near) {
            optima.add_stored(Some(found));
        }
        if optima.solved() == 0 {
            let walked = each(&near[..near.len().min(WALKED)], |(_, record)| {
                solve(&|| self.walk_to_target(record, stopped))
            });
            walked.into_iter().flatten().for_each(|found| optima.add_stored(found));
        }
        if optima.solved() == 0 {
            let others = each(&self.other_kinds(index, kind), |start| {
                solve(&|| self.solve(start, self.anywhere(), &Settings::default(), usize::MAX))
            });
            others.into_iter().flatten().for_each(|found| optima.add_stored(found));
        }
        match near.len() {
            _ if !self.has_table(index) => Surroundings::Unknown,
            0 => Surroundings::Empty,
            _ => Surroundings::Stored,
        }
    }

    /// More steps for the best few throws: the steps of a start show where it will end, but may not suffice to end there.
    pub(super) fn finish(&self, optima: &Optima, stopped: &(dyn Fn() -> bool + Sync)) -> Vec<Found> {
        let finished = optima
            .found()
            .iter()
            .enumerate()
            .map(|(rank, found)| {
                if rank >= FINISHED_MAX || stopped() {
                    return *found;
                }
                match self.finished(&found.throw) {
                    Some(better) if better.objective < found.objective => {
                        Found { iterations: found.iterations + better.iterations, ..better }
                    }
                    _ => *found,
                }
            })
            .collect();
        self.refine_best(distinct(finished))
    }

    /// Expected distance of the landing from the target, root mean square in m; `None` if the ball does not come down.
    #[must_use]
    pub fn rms_miss_m(&self, throw: &Throw, noise: &super::statistics::Noise) -> Option<f64> {
        let predicted = super::statistics::predict(self.problem, throw, noise)?;
        Some(predicted.rms_miss_m(&self.problem.aim.centre()))
    }

    /// One evaluation of objective and constraints with all gradients at a throw; returns the largest violation.
    ///
    /// For benchmarks: the first part of each step of the local solver.
    #[must_use]
    pub fn evaluate(&self, throw: &Throw) -> f64 {
        evaluate_once(self.problem, throw)
    }
}

/// Throws that get a second stage.
const REFINED_MAX: usize = 16;
/// Steps of the second stage, per round.
const REFINE_STEPS: usize = 80;
/// A nearest target this close is the target: the pull of the objective on the shift is of this size.
const REACHED_M: f64 = 1e-3;
/// A stored throw is not tried if its expected price is above this share of the best one so far.
const WORTH_TRYING: f64 = 1.01;
/// A throw that costs more than this share of the best one so far is not another one.
const WORTH_FINDING: f64 = 0.999;
/// Stored throws tried without a gain after the first success.
const IN_VAIN_MAX: usize = 2;
/// Stored throws that get a few steps each if the first ones lead nowhere.
const MORE_TRIES: usize = 30;
/// Steps for one stored throw in the last pass.
const PATIENT_STEPS: usize = 60;
/// Steps without progress before a stored throw is given up in the last pass, see [`Settings::patience`]. With the
/// number for a random start, 12, six more of 396 targets of `pincher4` get a throw under fewer limits.
const STORED_PATIENCE: usize = 25;
/// Steps for one stored throw in the first pass, and its tolerances.
const QUICK_STEPS: usize = 12;
const QUICK: Settings = Settings {
    iterations_max: QUICK_STEPS,
    feasibility: 1e-7,
    objective: 3e-4,
    give_up_above: f64::INFINITY,
    patience: 4,
    // At the edge of the reach a throw nearly fits, and the rows that a scan adds make it far from feasible. Of 43
    // failed first tries for 1000 targets (paper's form) 22 were that far off, of 1022 successful tries one.
    hopeless_above: 0.5,
    chord: Chord::NEAR,
};
/// Stored throws that a full search polishes.
const STORED_TRIES: usize = 12;
/// Stored throws that are walked to the target if none leads there directly.
const WALKED: usize = 4;
/// Stored throws that are walked to the target before it is refused, and how far at most, in m.
const NEAREST_WALKED: usize = 24;
const WALKED_WITHIN_M: f64 = 0.3;
/// Fewer stored throws than this allow no conclusion about other targets.
const TABLE_MIN: usize = 200;
/// Random starts between two checks of their results, without stored throws; a fixed number, so that the number of cores does
/// not matter.
const BATCH: usize = 8;
/// Factor for the starts of the budget in a search without a table, once it has found a throw.
const MORE_STARTS: usize = 4;
/// Throws that get more steps in the end, and how many.
const FINISHED_MAX: usize = 2;
const FINISH_STEPS: usize = 200;

pub(super) fn counted(watch: &Watch, found: Option<Found>) -> Option<Found> {
    watch.done.fetch_add(1, Ordering::Relaxed);
    watch.solved.fetch_add(usize::from(found.is_some()), Ordering::Relaxed);
    found
}

/// Cheapest first, of equal ones the first, so that the order of threads does not matter.
fn distinct(mut found: Vec<Found>) -> Vec<Found> {
    // The sort is stable.
    found.sort_by(|a, b| a.objective.total_cmp(&b.objective));
    found.dedup_by(|a, b| (a.objective - b.objective).abs() < 1e-6 * b.objective.abs());
    found
}

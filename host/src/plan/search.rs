//! Search over starts: stored throws first, then seeded random ones, on all cores.

use std::f64::consts::{PI, TAU};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use nalgebra::Vector3;
use rayon::prelude::*;
use robot_model::jacobian::joint_rates;

use super::goal::Goal;
use super::local::{Begin, Found, solve_from};
use super::nearest::{NearestTarget, nearest_text};
use super::paper::PaperParameters;
use super::problem::{Options, Problem};
use super::promise::{Promise, promising};
use super::rng::SplitMix64;
use super::scan::Scanner;
use super::sqp::Settings;
use super::throw::{JOINTS, Throw};
use crate::store::{Index, Record};

/// How long to search.
#[derive(Debug, Clone, Copy)]
pub struct Budget {
    /// Random starts after the stored ones.
    pub starts: usize,
    /// No new start after this time.
    pub time: Option<Duration>,
    /// Seed of the random starts; same seed and same starts give the same throw on any number of cores.
    pub seed: u64,
}

impl Default for Budget {
    fn default() -> Self {
        Self { starts: 96, time: None, seed: 1 }
    }
}

/// Shared with whoever watches or stops a search.
#[derive(Debug, Default)]
pub struct Watch {
    /// Set to end the search; the best throw so far is returned.
    pub stop: AtomicBool,
    /// Starts that have ended.
    pub done: AtomicUsize,
    /// Starts that found a throw.
    pub solved: AtomicUsize,
}

/// The best throw of a search.
#[derive(Debug, Clone, PartialEq)]
pub struct Best {
    /// The throw with its price.
    pub found: Found,
    /// Starts that were run, stored ones included.
    pub starts: usize,
    /// Starts that ended in a throw.
    pub solved: usize,
    /// Whether the search was stopped before its budget was used.
    pub interrupted: bool,
    /// All throws that were found, cheapest first; equal ones once.
    pub others: Vec<Found>,
}

/// No start ended in a throw.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("no throw reaches ({:.3}, {:.3}, {:.3}) m{}", target.x, target.y, target.z, nearest_text(nearest.as_ref()))]
pub struct NoThrow {
    /// The target in m.
    pub target: Vector3<f64>,
    /// The nearest target that a throw reaches, if one was found.
    pub nearest: Option<NearestTarget>,
    /// Starts that were run.
    pub starts: usize,
    /// Whether the search was stopped before its budget was used, so that "none" is not proven by it.
    pub interrupted: bool,
}

/// Which constraints a stored throw was made for; only the same kind is offered as a start first.
#[must_use]
pub fn kind_of(options: &Options) -> u32 {
    u32::from(options.free_spin)
        | u32::from(options.null_delay) << 1
        | u32::from(options.clean_release) << 2
        | u32::from(!options.avoid_collisions) << 3
        | u32::from(!options.delay_windows.is_empty()) << 4
}

/// Plans throws for one problem; holds what depends on the problem but not on the start.
#[derive(Debug, Clone)]
pub struct Planner<'p, 'a> {
    pub(super) problem: &'p Problem<'a>,
    /// The problem with the paper's objective, if `problem` has another: what every start is solved for first.
    effort: Option<Problem<'a>>,
    pub(super) scanner: Scanner,
    pub(super) azimuth_rad: f64,
    pub(super) range_m: f64,
    mirror: Option<[f64; JOINTS]>,
}

impl<'p, 'a> Planner<'p, 'a> {
    /// For a problem.
    #[must_use]
    pub fn new(problem: &'p Problem<'a>) -> Self {
        let t = &problem.target;
        let effort = (problem.options.goal != Goal::Effort).then(|| {
            let mut effort = problem.clone();
            effort.options.goal = Goal::Effort;
            effort
        });
        Self {
            problem,
            effort,
            scanner: Scanner::new(problem),
            azimuth_rad: t.y.atan2(t.x),
            range_m: t.x.hypot(t.y),
            mirror: mirror_signs(problem),
        }
    }

    /// One local solve from random point number `index` of the search space.
    #[must_use]
    pub fn random_start(&self, seed: u64, index: u64) -> Option<Found> {
        Some(self.refine(self.solve_random(seed, index)?))
    }

    fn solve_random(&self, seed: u64, index: u64) -> Option<Found> {
        let mut rng = SplitMix64::stream(seed, index);
        let unit = std::array::from_fn(|_| rng.unit());
        let h = PaperParameters::in_bounds(&self.problem.bounds, self.azimuth_rad, unit);
        let start = h.start(self.problem);
        self.solve(&start, Begin::Anywhere, &Settings::default(), usize::MAX)
    }

    /// One local solve from a throw for a near target.
    #[must_use]
    pub fn from_throw(&self, start: &Throw) -> Option<Found> {
        Some(self.refine(self.solve(start, Begin::Anywhere, &Settings::default(), usize::MAX)?))
    }

    /// One local solve from a stored throw.
    #[must_use]
    pub fn from_record(&self, record: &Record) -> Option<Found> {
        Some(self.refine(self.polish(record, &Settings::default(), usize::MAX)?))
    }

    fn solve(&self, start: &Throw, begin: Begin, settings: &Settings, most: usize) -> Option<Found> {
        let problem = self.effort.as_ref().unwrap_or(self.problem);
        solve_from(problem, &self.scanner, start, begin, settings, most).ok()
    }

    /// The second stage for a goal other than the paper's objective: from a throw that keeps every limit downhill in
    /// what counts. Never worse than the throw itself.
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
            Begin::Anywhere,
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
            found.par_iter().map(|f| Found { objective: goal.value(self.problem, &f.throw), ..*f }).collect();
        let mut best = distinct(as_they_are);
        best.truncate(REFINED_MAX);
        distinct(best.par_iter().map(|f| self.refine(*f)).collect())
    }

    fn polish(&self, record: &Record, settings: &Settings, most: usize) -> Option<Found> {
        let begin = Begin::Optimal { touches: record.touches };
        self.solve(&self.place(&record.throw)?, begin, settings, most)
    }

    /// The best throw from stored throws alone; this is what answers in a fraction of a millisecond.
    ///
    /// Stored throws are taken in the order of what they promise. Each gets only a few steps, because a good start
    /// needs no more and a bad one would need hundreds; `tries` bounds the local solves. If none of them ends in a
    /// throw, all the others around have their turn, then the most promising ones with patience.
    #[must_use]
    pub fn from_index(&self, index: &Index, tries: usize) -> Option<Found> {
        let order = self.promising(index, MORE_TRIES.max(tries));
        let (first, rest) = order.split_at(tries.min(order.len()));
        let patient = Settings { objective: 1e-4, feasibility: 1e-7, ..Settings::default() };
        self.first_pass(first)
            .or_else(|| self.first_pass(rest))
            .or_else(|| first.iter().find_map(|(_, record)| self.polish(record, &patient, PATIENT_STEPS)))
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
        self.first_pass(&self.promising(index, tries)).map(|found| self.refine(found))
    }

    fn promising<'i>(&self, index: &'i Index, most: usize) -> Vec<Promise<'i>> {
        promising(index, kind_of(&self.problem.options), self.range_m, self.problem.target.z, most)
    }

    fn first_pass(&self, order: &[Promise<'_>]) -> Option<Found> {
        let mut best: Option<Found> = None;
        let mut in_vain = 0;
        for (promise, record) in order {
            let bound = best.map_or(f64::INFINITY, |b| b.objective * WORTH_FINDING);
            if best.is_some() && (promise * WORTH_TRYING > bound || in_vain == IN_VAIN_MAX) {
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

    /// A stored throw turned to this target; mirrored or in another posture if joint 1 does not reach otherwise.
    pub(super) fn place(&self, stored: &Throw) -> Option<Throw> {
        let mut turned = self.turned(stored);
        if self.fits(&turned) {
            return Some(turned);
        }
        if let Some(signs) = self.mirror {
            let mut mirrored = *stored;
            for (j, sign) in signs.iter().enumerate() {
                mirrored.q_rad[j] *= sign;
                mirrored.qd_rad_s[j] *= sign;
                mirrored.qdd_rad_s2[j] *= sign;
            }
            let mirrored = self.turned(&mirrored);
            if self.fits(&mirrored) {
                return Some(mirrored);
            }
            if let Some(other) = self.other_posture(&mirrored) {
                return Some(other);
            }
        }
        if let Some(other) = self.other_posture(&turned) {
            return Some(other);
        }
        // The solver may still bend it into the range.
        turned.q_rad[0] = turned.q_rad[0].clamp(self.problem.limits.q_min[0], self.problem.limits.q_max[0]);
        Some(turned)
    }

    fn turned(&self, stored: &Throw) -> Throw {
        let mut throw = *stored;
        let l = &self.problem.limits;
        let axis_up = self.problem.arm.joints()[0].x_pj.rot[(2, 2)].signum();
        let middle = 0.5 * (l.q_min[0] + l.q_max[0]);
        let q = throw.q_rad[0] + axis_up * self.azimuth_rad;
        throw.q_rad[0] = q - TAU * ((q - middle) / TAU).round();
        throw
    }

    fn fits(&self, throw: &Throw) -> bool {
        let l = &self.problem.limits;
        let inside = |q: f64| q >= l.q_min[0] - 1e-3 && q <= l.q_max[0] + 1e-3;
        inside(throw.start()[0]) && inside(throw.stop()[0])
    }

    /// The same release in another posture of the arm that keeps the ranges.
    fn other_posture(&self, throw: &Throw) -> Option<Throw> {
        let arm = self.problem.arm;
        let frames = arm.fk(&throw.q_rad);
        let jac = frames.jacobian(&arm.ball(&frames).pos);
        let twist = jac * throw.qd_rad_s;
        let acceleration = jac * throw.qdd_rad_s2 + frames.bias_acceleration(&jac, &throw.qd_rad_s);
        let solutions = arm.ik(&arm.ee(&frames)).ok()?;
        solutions.in_range().find_map(|s| {
            let frames = arm.fk(&s.q);
            let jac = frames.jacobian(&arm.ball(&frames).pos);
            let qd = joint_rates(&jac, &twist)?;
            let mut other = Throw { q_rad: s.q, qd_rad_s: qd, ..*throw };
            if self.problem.options.null_delay {
                let bias = frames.bias_acceleration(&jac, &qd);
                other.qdd_rad_s2 = joint_rates(&jac, &(acceleration - bias))?;
            }
            let l = &self.problem.limits;
            let (start, stop) = (other.start(), other.stop());
            (0..JOINTS)
                .all(|j| {
                    start[j].min(stop[j]) >= l.q_min[j] - 1e-3 && start[j].max(stop[j]) <= l.q_max[j] + 1e-3
                })
                .then_some(other)
        })
    }

    /// The best throw within a budget.
    ///
    /// Stored throws are polished first, then random starts run on all cores. The result depends only on the index, the
    /// seed and the number of starts, unless time or `watch.stop` ends the search.
    ///
    /// # Errors
    /// [`NoThrow`] with the nearest reachable target if no start ends in a throw.
    pub fn search(&self, index: &Index, budget: &Budget, watch: &Watch) -> Result<Best, NoThrow> {
        let none = match self.attempt(index, budget, watch) {
            Ok(best) => return Ok(best),
            Err(none) => none,
        };
        if watch.stop.load(Ordering::Relaxed) {
            return Err(none);
        }
        let Some((nearest, throw)) = self.nearest(index, budget) else { return Err(none) };
        // Looking for the nearest target is itself a way in: it may end at the target.
        if nearest.distance_m < REACHED_M
            && let Some(found) = self.from_throw(&throw)
        {
            let (starts, interrupted) = (none.starts, none.interrupted);
            return Ok(Best { found, starts, solved: 1, interrupted, others: vec![found] });
        }
        Err(NoThrow { nearest: Some(nearest), ..none })
    }

    /// As [`Planner::search`], without looking for the nearest reachable target if there is no throw.
    ///
    /// # Errors
    /// [`NoThrow`] if no start ends in a throw.
    pub fn attempt(&self, index: &Index, budget: &Budget, watch: &Watch) -> Result<Best, NoThrow> {
        let began = Instant::now();
        let out_of_time = || budget.time.is_some_and(|t| began.elapsed() >= t);
        let stopped = || watch.stop.load(Ordering::Relaxed) || out_of_time();
        let near = self.promising(index, STORED_TRIES);
        let warm: Vec<Option<Found>> = near
            .par_iter()
            .map(|(_, record)| {
                let found = self.polish(record, &Settings::default(), usize::MAX);
                watch.done.fetch_add(1, Ordering::Relaxed);
                watch.solved.fetch_add(usize::from(found.is_some()), Ordering::Relaxed);
                found
            })
            .collect();
        let skipped = AtomicUsize::new(0);
        let cold: Vec<Option<Found>> = (0..budget.starts as u64)
            .into_par_iter()
            .map(|k| {
                if stopped() {
                    skipped.fetch_add(1, Ordering::Relaxed);
                    return None;
                }
                let found = self.solve_random(budget.seed, k);
                watch.done.fetch_add(1, Ordering::Relaxed);
                watch.solved.fetch_add(usize::from(found.is_some()), Ordering::Relaxed);
                found
            })
            .collect();
        let skipped = skipped.into_inner();
        let starts = warm.len() + cold.len() - skipped;
        let interrupted = skipped > 0;
        let solved: Vec<Found> = warm.into_iter().chain(cold).flatten().collect();
        let count = solved.len();
        let others = self.refine_best(distinct(solved));
        match others.first() {
            Some(found) => Ok(Best { found: *found, starts, solved: count, interrupted, others }),
            None => Err(NoThrow { target: self.problem.target, nearest: None, starts, interrupted }),
        }
    }

    /// Expected distance of the landing from the target, root mean square in m; `None` if the ball does not come down.
    #[must_use]
    pub fn rms_miss_m(&self, throw: &Throw, noise: &super::statistics::Noise) -> Option<f64> {
        let aim = nalgebra::Vector2::new(self.problem.target.x, self.problem.target.y);
        Some(super::statistics::predict(self.problem, throw, noise)?.rms_miss_m(&aim))
    }

    /// One evaluation of objective and constraints with all gradients at a throw; returns the largest violation.
    ///
    /// For benchmarks: it is what a step of the local solver starts with.
    #[must_use]
    pub fn evaluate(&self, throw: &Throw) -> f64 {
        super::sqp::evaluate_once(self.problem, throw)
    }

    /// The throw as a record of the store.
    #[must_use]
    pub fn record(&self, found: &Found) -> Record {
        let axis_up = self.problem.arm.joints()[0].x_pj.rot[(2, 2)].signum();
        let mut throw = found.throw;
        let q = throw.q_rad[0] - axis_up * self.azimuth_rad;
        throw.q_rad[0] = if q > PI {
            q - TAU
        } else if q < -PI {
            q + TAU
        } else {
            q
        };
        Record {
            kind: kind_of(&self.problem.options),
            range_m: self.range_m,
            height_m: self.problem.target.z,
            objective: found.objective,
            slope_per_m: [
                found.slope_per_m.x * self.azimuth_rad.cos() + found.slope_per_m.y * self.azimuth_rad.sin(),
                found.slope_per_m.z,
            ],
            touches: found.touches,
            throw,
        }
    }
}

/// Throws that get a second stage.
const REFINED_MAX: usize = 16;
/// Steps of the second stage, per round.
const REFINE_STEPS: usize = 80;
/// A nearest target this close is the target: the pull of the objective on the shift is of this size.
const REACHED_M: f64 = 1e-3;
/// A stored throw is not tried if it promises more than this share of the best price so far.
const WORTH_TRYING: f64 = 1.01;
/// A throw that costs more than this share of the best one so far is not another one.
const WORTH_FINDING: f64 = 0.999;
/// Stored throws tried without a gain after the first success.
const IN_VAIN_MAX: usize = 2;
/// Stored throws that get a few steps each if the first ones lead nowhere.
const MORE_TRIES: usize = 30;
/// Steps for one stored throw in the last pass.
const PATIENT_STEPS: usize = 60;
/// Steps for one stored throw in the first pass, and its tolerances.
const QUICK_STEPS: usize = 12;
const QUICK: Settings = Settings {
    iterations_max: QUICK_STEPS,
    feasibility: 1e-7,
    objective: 3e-4,
    give_up_above: f64::INFINITY,
    patience: 4,
};
/// Stored throws that a full search polishes.
const STORED_TRIES: usize = 16;

/// Cheapest first, of equal ones the first, so that the order of threads does not matter.
fn distinct(mut found: Vec<Found>) -> Vec<Found> {
    // The sort is stable.
    found.sort_by(|a, b| a.objective.total_cmp(&b.objective));
    found.dedup_by(|a, b| (a.objective - b.objective).abs() < 1e-6 * b.objective.abs());
    found
}

/// Signs that mirror a posture in the plane of the base axis, if the arm has that symmetry: joints whose axis lies in
/// the plane at zero change sign, joints across it keep theirs.
fn mirror_signs(problem: &Problem<'_>) -> Option<[f64; JOINTS]> {
    let arm = problem.arm;
    let zero = arm.fk(&super::throw::Joints::zeros());
    let signs: [f64; JOINTS] = std::array::from_fn(|j| if zero.axis(j).y.abs() > 0.5 { 1.0 } else { -1.0 });
    let q = super::throw::Joints::from_fn(|j, _| 0.3 + 0.37 * j as f64);
    let mirrored = super::throw::Joints::from_fn(|j, _| q[j] * signs[j]);
    let (a, b) = (arm.ball(&arm.fk(&q)), arm.ball(&arm.fk(&mirrored)));
    let flip = |v: Vector3<f64>| Vector3::new(v.x, -v.y, v.z);
    let same_point = (flip(a.pos) - b.pos).norm() < 1e-9;
    let same_throw = (flip(a.rot.column(2).into()) - Vector3::from(b.rot.column(2))).norm() < 1e-9;
    (same_point && same_throw).then_some(signs)
}

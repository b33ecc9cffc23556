//! Many trials: shares with intervals, by flight time and by fault.

use std::time::Instant as Clock;

use hil_sim::two_arms::TwoArmOptions;
use nalgebra::Vector3;
use operator::ball_catch::limits::Executed;
use operator::ball_catch::thrower::Scatter;
use operator::ball_catch::trial::{
    CatchOutcome, Outcome, Pair, Touch, TrialOptions, WAIT_HOLD_DEG, WAIT_MATCHED_DEG,
};
use planner::catch::Joints;
use planner::catch::arm::NotACatcher;
use planner::catch::draw::{Aimed, Window};
use planner::catch::task::{Allowed, Decline, Settings};
use rayon::prelude::*;
use serde::Serialize;

use super::calibration::{CalibrationBin, brier, calibration};
use super::degraded::{TrialOf, degradations};
use super::estimator::{EstimatorRow, estimator};
use super::exchange::Partners;
use super::failures::{Failure, RULE, failure, first_begun};
use super::throws::{Drawn, draw_throws, reached_from};
use super::waiting::find_wait;

/// Width of the bins of flight time, s, and their first edge.
const BIN_S: (f64, f64) = (0.4, 0.1);
const BINS: usize = 5;
/// Quantile of the normal distribution for a 95 % interval.
const Z: f64 = 1.959_964;

/// Hits out of tries.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Share {
    pub hits: usize,
    pub of: usize,
}

impl Share {
    pub fn of(hits: &[bool]) -> Self {
        Self { hits: hits.iter().filter(|hit| **hit).count(), of: hits.len() }
    }

    pub fn count(&mut self, hit: bool) {
        self.hits += usize::from(hit);
        self.of += 1;
    }

    /// Share, 0..=1; zero without trials.
    pub fn value(&self) -> f64 {
        self.hits as f64 / self.of.max(1) as f64
    }

    /// 95 % interval of Wilson.
    pub fn wilson(&self) -> (f64, f64) {
        if self.of == 0 {
            return (0.0, 1.0);
        }
        let (n, p) = (self.of as f64, self.value());
        let middle = (p + Z * Z / (2.0 * n)) / (1.0 + Z * Z / n);
        let half = Z / (1.0 + Z * Z / n) * (p * (1.0 - p) / n + Z * Z / (4.0 * n * n)).sqrt();
        ((middle - half).max(0.0), (middle + half).min(1.0))
    }

    /// 95 % interval of Newcombe for how much larger this share is than another of other trials.
    pub fn gain(&self, other: &Self) -> (f64, f64) {
        let ((low, high), (other_low, other_high)) = (self.wilson(), other.wilson());
        let gain = self.value() - other.value();
        let less = f64::hypot(self.value() - low, other_high - other.value());
        let more = f64::hypot(high - self.value(), other.value() - other_low);
        (gain - less, gain + more)
    }
}

#[derive(Debug, Clone, Default, Serialize)]
pub struct Row {
    pub name: String,
    /// Where the catcher waits, deg.
    pub wait_deg: [f64; 6],
    /// The ball lay in the cup at the end: the cell's word.
    pub caught: Share,
    /// Caught by the rule of miss and angle (and of relative speed, for matched catches) where the ball crosses the mouth plane.
    pub by_rule: Share,
    /// Of the throws for which a place exists, those caught.
    pub of_possible: Share,
    /// Caught, though the search found no place: how much that search misses.
    pub caught_without_place: usize,
    /// Of an arm with eyes only: throws for which the search finds a catch if the arm knows the flight exactly 50 ms after the
    /// release.
    pub in_time: Option<usize>,
    /// By flight time, from 0.4 s in steps of 0.1 s: all throws.
    pub by_flight: Vec<Share>,
    /// The same of the throws for which a place exists.
    pub possible_by_flight: Vec<Share>,
    /// Throws in which the arm began to catch, and those of them that were caught.
    pub begun: Share,
    /// Mean over these throws of the predicted probability of the last decision; 0 where the catch was given up.
    pub predicted: f64,
    /// The predicted probability of the last decision against what came of it, and its Brier score.
    pub last_decision: (Vec<CalibrationBin>, f64),
    /// Predicted probability of the first decision to move against what came of it, and its Brier score.
    pub first_decision: (Vec<CalibrationBin>, f64),
    pub failures: Vec<Failure>,
    /// Lateral miss of the balls that crossed the mouth plane, mm: 50 %, 95 %.
    pub miss_mm: (f64, f64),
    /// Throws for which the catcher declined, and its most frequent reason.
    pub declined: usize,
    pub reasons: Vec<(String, usize)>,
    /// Tried and not caught, and reported so or as not known.
    pub safe: usize,
    /// Something else was reported than happened: numbers of these throws, from 0.
    pub silent: Vec<usize>,
    /// Throws in which an arm passed a limit, or the arms touched each other.
    pub limit_passed: Vec<usize>,
    /// Declined throws whose ball touched the cup or a link that could have been out of its way.
    pub not_clear: Vec<usize>,
    /// Declined throws whose ball flew against the catcher's column or turntable, which cannot move away.
    pub declined_at_base: usize,
    /// Largest use of speed and acceleration limits by thrower and catcher, from their joints as they moved.
    pub executed: [Executed; 2],
    pub refusals: usize,
    /// Decision times, µs: 50 %, 99 %, most. Not part of the result: of the machine.
    pub decision_us: (f64, f64, f64),
    /// Candidates judged per search, mean.
    pub judged: f64,
}

/// Caught by the rule of the task.
pub fn by_rule(outcome: &Outcome, settings: &Settings) -> bool {
    let fast = settings.allowed == Allowed::Matched;
    outcome
        .crossing
        .is_some_and(|c| c.miss_m <= RULE.0 && c.angle_rad <= RULE.1 && (!fast || c.speed_m_s <= RULE.2))
}

/// All throws in one setting; `exists` says for which of them there is a place.
pub fn row(
    name: &str,
    pair: &Pair,
    throws: &[Aimed],
    options: &(impl Fn(usize) -> TrialOptions + Sync),
    exists: &[bool],
    seed: u64,
) -> Row {
    let outcomes: Vec<(Outcome, Vec<f64>)> = throws
        .par_iter()
        .enumerate()
        .map(|(k, aimed)| {
            let mut times = Vec::new();
            let outcome = pair.run_timed(aimed, &options(k), seed.wrapping_add(k as u64), |observe| {
                let clock = Clock::now();
                observe();
                times.push(clock.elapsed().as_secs_f64() * 1e6);
            });
            (outcome, times)
        })
        .collect();
    let bins = vec![Share::default(); BINS];
    let mut row =
        Row { name: name.to_owned(), by_flight: bins.clone(), possible_by_flight: bins, ..Row::default() };
    let (mut predictions, mut last_predictions) = (Vec::new(), Vec::new());
    let (mut misses, mut times, mut judged) = (Vec::new(), Vec::new(), (0_usize, 0_usize));
    for (k, ((outcome, took), aimed)) in outcomes.iter().zip(throws).enumerate() {
        let options = options(k);
        row.caught.count(outcome.caught);
        row.by_rule.count(by_rule(outcome, &options.settings));
        let place = exists.get(k).copied().unwrap_or(true);
        let bin = ((aimed.flight_s - BIN_S.0) / BIN_S.1).floor().clamp(0.0, (BINS - 1) as f64) as usize;
        row.by_flight[bin].count(outcome.caught);
        if place {
            row.of_possible.count(outcome.caught);
            row.possible_by_flight[bin].count(outcome.caught);
        }
        row.caught_without_place += usize::from(outcome.caught && !place);
        if !outcome.caught {
            row.failures.push(failure(k, aimed, place, outcome));
        }
        if let Some(first) = first_begun(outcome) {
            row.begun.count(outcome.caught);
            predictions.push((first.probability, outcome.caught));
            let last = outcome.choice.as_ref().map_or(0.0, |choice| choice.probability);
            row.predicted += last;
            last_predictions.push((last, outcome.caught));
        }
        misses.extend(outcome.crossing.filter(|_| outcome.choice.is_some()).map(|c| c.miss_m * 1e3));
        match outcome.reported {
            CatchOutcome::Declined(why) => {
                row.declined += 1;
                note(&mut row.reasons, why);
            }
            _ if !outcome.caught => row.safe += usize::from(outcome.reported_truly()),
            _ => {}
        }
        if !outcome.reported_truly() {
            row.silent.push(k);
        }
        if !outcome.within_limits(options.jerk) {
            row.limit_passed.push(k);
        }
        match outcome.first_touch().filter(|_| outcome.choice.is_none()) {
            Some(Touch::Moving) => row.not_clear.push(k),
            Some(Touch::Base) => row.declined_at_base += 1,
            None => {}
        }
        for (most, arm) in row.executed.iter_mut().zip(&outcome.executed) {
            most.speed = most.speed.max(arm.speed);
            most.acceleration = most.acceleration.max(arm.acceleration);
            most.left_range |= arm.left_range;
        }
        row.refusals += outcome.refusals.len();
        times.extend(took);
        for logged in outcome.log.iter().filter(|logged| logged.count.judged > 0) {
            judged.0 += logged.count.judged;
            judged.1 += 1;
        }
    }
    row.predicted /= row.begun.of.max(1) as f64;
    row.last_decision = (calibration(&last_predictions), brier(&last_predictions));
    row.first_decision = (calibration(&predictions), brier(&predictions));
    row.miss_mm = (quantile(&mut misses, 0.5), quantile(&mut misses, 0.95));
    row.decision_us = (quantile(&mut times, 0.5), quantile(&mut times, 0.99), quantile(&mut times, 1.0));
    row.judged = judged.0 as f64 / judged.1.max(1) as f64;
    row.reasons.sort_by_key(|(_, n)| std::cmp::Reverse(*n));
    row
}

pub(super) fn note(reasons: &mut Vec<(String, usize)>, why: Decline) {
    let why = why.to_string();
    match reasons.iter_mut().find(|(other, _)| *other == why) {
        Some((_, n)) => *n += 1,
        None => reasons.push((why, 1)),
    }
}

/// Value below which a share of the values lies; NaN without any.
fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let place = (share * values.len() as f64).ceil() as usize;
    values.get(place.saturating_sub(1).min(values.len().saturating_sub(1))).copied().unwrap_or(f64::NAN)
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StudyOptions {
    /// Throws per setting: for shares of caught balls, those for which a place exists.
    pub throws: usize,
    pub seed: u64,
    /// Only settings whose name has this in it.
    pub only: Option<String>,
}

impl StudyOptions {
    fn wants(&self, name: &str) -> bool {
        self.only.as_ref().is_none_or(|only| name.contains(only.as_str()))
    }
}

#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NoStudy {
    #[error("an arm of the cell cannot catch balls: {0}")]
    NotACatcher(#[from] NotACatcher),
    #[error("the thrower cannot throw to the catcher {distance_m} m away")]
    OutOfReach { distance_m: f64 },
}

/// Results besides the rows.
#[derive(Debug, Clone, Serialize)]
pub struct Study {
    pub estimator: Vec<EstimatorRow>,
    /// Rallies by distance.
    pub rallies: Vec<Rallies>,
}

/// Rallies of arms so far apart.
#[derive(Debug, Clone, Serialize)]
pub struct Rallies {
    pub distance_m: f64,
    /// Catches in a row of each rally, at most `RALLY_THROWS`.
    pub lengths: Vec<usize>,
    /// Throws that were caught, of all.
    pub caught: Share,
}

/// No arm with this tracker knows a flight earlier after the release, s: five frames at 120 Hz and 15 ms of latency.
const SEEN_S: f64 = 0.05;
/// Throws for which a waiting pose is found.
const WAIT_THROWS: usize = 200;
/// Throws of one rally, and rallies for this many throws of a setting.
const RALLY_THROWS: usize = 40;
const THROWS_PER_RALLY: usize = 10;

/// Makes the study; `done` gets each row when it is there.
pub fn run(
    cell: &TwoArmOptions,
    options: &StudyOptions,
    mut done: impl FnMut(&Row),
) -> Result<Study, NoStudy> {
    for distance_m in [2.0, 2.5, 3.0] {
        let cell = at_distance(cell, distance_m);
        let pair = Pair::new(cell)?;
        let refused = || NoStudy::OutOfReach { distance_m };
        for (window, settings) in goals() {
            let settings =
                settings.into_iter().map(|(name, trial)| (format!("D {distance_m} m, {name}"), trial));
            let wanted: Vec<_> = settings.filter(|(name, _)| options.wants(name)).collect();
            if wanted.is_empty() {
                continue;
            }
            // Other throws than the counted ones: the pose must not be fitted to them.
            let others = draw_throws(&pair, &window, WAIT_THROWS, !options.seed).ok_or_else(refused)?;
            let mut drawn = Drawn::new(&pair, window, options.seed);
            for (name, trial) in wanted {
                let wait = find_wait(&pair, &trial, &others, options.seed);
                let trial = TrialOptions { wait: wait.q_rad, ..trial };
                let (throws, exists) = drawn.possible(&trial, options.throws).ok_or_else(refused)?;
                let row = row(&name, &pair, &throws, &|_| trial.clone(), &exists, options.seed);
                let in_time = (!trial.cooperative).then(|| {
                    let reached = |aimed| reached_from(&pair, aimed, &trial, &trial.wait, SEEN_S).is_some();
                    throws.par_iter().filter(|aimed| reached(*aimed)).count()
                });
                done(&Row { wait_deg: wait.q_rad.map(f64::to_degrees).array(), in_time, ..row });
            }
        }
    }
    let near = at_distance(cell, 2.5);
    let faults =
        degradations(&near).into_iter().map(|(name, cell, trial)| (format!("degraded: {name}"), cell, trial));
    let fixed = priors().map(|(name, trial)| (name, near.clone(), trial)).chain(restitutions(&near));
    let fixed = fixed
        .map(|(name, cell, trial)| -> (_, _, TrialOf) { (name, cell, Box::new(move |_| trial.clone())) });
    let wanted: Vec<_> = faults.chain(fixed).filter(|(name, ..)| options.wants(name)).collect();
    if !wanted.is_empty() {
        let throws = draw_throws(&Pair::new(near.clone())?, &Window::high(), options.throws, options.seed);
        let throws = throws.ok_or(NoStudy::OutOfReach { distance_m: 2.5 })?;
        for (name, cell, trial) in wanted {
            done(&row(&name, &Pair::new(cell)?, &throws, &trial, &[], options.seed));
        }
    }
    let estimator =
        if options.wants("estimator") { estimator(options.throws, options.seed) } else { Vec::new() };
    let rallies = rallies(cell, options)?;
    Ok(Study { estimator, rallies })
}

fn rallies(cell: &TwoArmOptions, options: &StudyOptions) -> Result<Vec<Rallies>, NotACatcher> {
    let trial = TrialOptions { cooperative: true, ..TrialOptions::default() };
    let of_distance = |distance_m: f64| {
        let partners = Partners::new(at_distance(cell, distance_m))?;
        let played: Vec<(usize, usize)> = (0..options.throws.div_ceil(THROWS_PER_RALLY))
            .into_par_iter()
            .map(|k| {
                let rally = partners.play(RALLY_THROWS, &trial, options.seed + k as u64, |_, _| {});
                (rally.length(), rally.exchanges.len())
            })
            .collect();
        let mut caught = Share::default();
        for (length, throws) in &played {
            caught.hits += length;
            caught.of += throws;
        }
        let lengths = played.into_iter().map(|(length, _)| length).collect();
        Ok(Rallies { distance_m, lengths, caught })
    };
    let distances = [2.0, 2.5].into_iter();
    let wanted = distances.filter(|distance_m| options.wants(&format!("D {distance_m} m, rally")));
    wanted.map(of_distance).collect()
}

/// The same cell with the arms this far apart.
pub fn at_distance(cell: &TwoArmOptions, distance_m: f64) -> TwoArmOptions {
    let mut cell = cell.clone();
    let apart = cell.arms[1].x_wb.pos - cell.arms[0].x_wb.pos;
    cell.arms[1].x_wb.pos = cell.arms[0].x_wb.pos + apart * (distance_m / apart.norm());
    cell
}

fn trial(allowed: Allowed, cooperative: bool, share: f64, jerk: bool) -> TrialOptions {
    let wait = if allowed == Allowed::Matched { WAIT_MATCHED_DEG } else { WAIT_HOLD_DEG };
    TrialOptions {
        settings: Settings { allowed, ..Settings::default() },
        cooperative,
        jerk,
        scatter: Scatter { share, ..Scatter::default() },
        wait: Joints::from(wait.map(f64::to_radians)),
        ..TrialOptions::default()
    }
}

/// A ball that is gripped beside where the plan has it, across the axis of the cup, with the plan and without.
fn priors() -> impl Iterator<Item = (String, TrialOptions)> {
    let grid =
        [0.0, 20.0, 40.0, 60.0].into_iter().flat_map(|off_mm| [1, 3, 5].map(|percent| (off_mm, percent)));
    grid.flat_map(|(off_mm, percent)| {
        [true, false].map(|cooperative| {
            let grip_off_m = Vector3::new(off_mm * 1e-3, 0.0, 0.0);
            let trial = trial(Allowed::Either, cooperative, 0.01 * f64::from(percent), false);
            let with = if cooperative { "with" } else { "without" };
            let name = format!("prior: {off_mm:.0} mm off, {percent} %, {with} the plan");
            (name, TrialOptions { grip_off_m, ..trial })
        })
    })
}

/// A ball and a cup that bounce more and more, by kind of catch; eyes only.
fn restitutions(cell: &TwoArmOptions) -> impl Iterator<Item = (String, TwoArmOptions, TrialOptions)> {
    [0.15, 0.3, 0.4, 0.5, 0.6, 0.7].into_iter().flat_map(|restitution| {
        let kinds = [(Allowed::Hold, "hold"), (Allowed::Matched, "matched"), (Allowed::Either, "either")];
        kinds.map(|(allowed, kind)| {
            let mut cell = cell.clone();
            cell.cup.surface.restitution = restitution;
            let wait = if allowed == Allowed::Hold { WAIT_HOLD_DEG } else { WAIT_MATCHED_DEG };
            let wait = Joints::from(wait.map(f64::to_radians));
            let trial = TrialOptions { wait, ..trial(allowed, false, 0.01, false) };
            (format!("restitution {restitution}, {kind}"), cell, trial)
        })
    })
}

fn goals() -> [(Window, Vec<(&'static str, TrialOptions)>); 2] {
    let all = Window::default();
    let long = Window::high();
    let cooperative = vec![
        ("cooperative, matched, 1 %", trial(Allowed::Matched, true, 0.01, false)),
        ("cooperative, matched, 3 %", trial(Allowed::Matched, true, 0.03, false)),
        ("cooperative, matched, 1 %, with jerk limits", trial(Allowed::Matched, true, 0.01, true)),
        ("cooperative, hold, 1 %", trial(Allowed::Hold, true, 0.01, false)),
    ];
    let uninformed = vec![
        ("uninformed, matched", trial(Allowed::Matched, false, 0.01, false)),
        ("uninformed, hold", trial(Allowed::Hold, false, 0.01, false)),
        ("uninformed, hold, with jerk limits", trial(Allowed::Hold, false, 0.01, true)),
        ("uninformed, matched, with jerk limits", trial(Allowed::Matched, false, 0.01, true)),
        ("uninformed, either", trial(Allowed::Either, false, 0.01, false)),
    ];
    [(long, cooperative), (all, uninformed)]
}

impl Study {
    /// The tables besides the rows, as text.
    pub fn as_text(&self) -> String {
        let mut out = String::new();
        if !self.estimator.is_empty() {
            out += "estimate at 0.6 s: drag, seen ms, rms mm, bound mm, mean squared error over covariance [band]\n";
        }
        for row in &self.estimator {
            let (nees, low, high) = row.nees;
            out += &format!(
                "  {:16} {:4} {:7.1} {:7.1} {nees:6.2} [{low:.2}, {high:.2}]\n",
                row.drag, row.seen_ms, row.rms_mm, row.bound_mm
            );
        }
        for Rallies { distance_m, lengths, caught } in &self.rallies {
            let mean = lengths.iter().sum::<usize>() as f64 / lengths.len() as f64;
            let full = lengths.iter().filter(|length| **length == RALLY_THROWS).count();
            let (low, high) = caught.wilson();
            out += &format!(
                "D {distance_m} m, rallies of at most {RALLY_THROWS} throws: {} of {} caught, {:.1} % [{:.1}, {:.1}]; mean length {mean:.1} over {}, {full} complete\n",
                caught.hits,
                caught.of,
                caught.value() * 100.0,
                low * 100.0,
                high * 100.0,
                lengths.len()
            );
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wilson_intervals_have_their_published_values() {
        // 78 of 100: the interval is known as 0.689 to 0.850.
        let (low, high) = Share { hits: 78, of: 100 }.wilson();
        assert!((low - 0.689).abs() < 1e-3 && (high - 0.850).abs() < 1e-3, "{low} {high}");
        assert_eq!(Share::default().wilson(), (0.0, 1.0));
        assert!(Share { hits: 500, of: 500 }.wilson().0 > 0.992);
    }

    /// 56 of 70 and 48 of 80: example (a) of Newcombe (1998), method 10.
    #[test]
    fn gains_have_their_published_interval() {
        let (low, high) = Share { hits: 56, of: 70 }.gain(&Share { hits: 48, of: 80 });
        assert!((low - 0.0524).abs() < 1e-4 && (high - 0.3339).abs() < 1e-4, "{low} {high}");
    }

    #[test]
    fn quantiles_are_values_of_the_sample() {
        let mut values = [5.0, 1.0, 3.0, 2.0, 4.0];
        assert_eq!((quantile(&mut values, 0.5), quantile(&mut values, 1.0)), (3.0, 5.0));
        assert!(quantile(&mut [], 0.5).is_nan());
    }
}

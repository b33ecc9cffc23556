//! The planner of the paper (000, section 3.2): a grid of releases, ramps, and steps along the parabola.
//!
//! A release is a place on concentric cylinders around A1, a parabola of the family through the target (angle β, so
//! speed v0), and a roll of the hand about v0. The hand is across v0 and does not turn. Speeds follow from the inverse
//! Jacobian, start and stop from ramps of constant acceleration. From each release the hand follows the parabola
//! forwards and backwards in steps of the controller as long as the limits and both ramps allow.
//!
//! Releases with many points are close together: in a grid over the whole reach most of them fall between its
//! values. So the grid is made finer ([`PaperOptions::refinements`]) around the best releases, and around better
//! ones that fail only in the last tests: all neighbours at half the step, then at a quarter, and so on.

mod options;

use std::cmp::Ordering;
use std::f64::consts::{PI, TAU};

use crate::follow::clear::{Clear, Scenes};
use crate::follow::found::{Found, NotFound, SearchSize, Stage, StageCounts};
use crate::follow::hand::HandLaw;
use crate::follow::limits::{AXES, Axes};
use crate::follow::motion::{FollowMotion, Peaks, RampPlan, Ramps};
use crate::follow::parabola::Parabola;
use crate::follow::posture::{Posture, Reach};
use crate::follow::ramp::RampShape;
use crate::follow::setting::Setting;
use nalgebra::Vector3;
pub use options::{Criterion, GridAxis, PaperOptions, RampTiming};
use rayon::prelude::*;

/// Releases of the grid around which it is made finer: feasible ones, and ones that only the last tests refuse.
const REFINED: usize = 24;
const REFINED_MISSES: usize = 72;
/// Moves to a better neighbour before the step is halved.
const MOVES: usize = 4;

/// `q̇ᵀ W q̇` in rad²/s² (equation 6).
#[must_use]
pub fn j1(qd: &Axes, w: &[f64; AXES]) -> f64 {
    qd.iter().zip(w).map(|(qd, w)| w * qd * qd).sum()
}

/// `(j1, e^(-n²)) G (j1, e^(-n²))ᵀ` for `n` followed points (equation 8).
#[must_use]
pub fn j2(j1: f64, points: usize, g: &[f64; 2]) -> f64 {
    let few = (-(points as f64).powi(2)).exp();
    g[0] * j1 * j1 + g[1] * few * few
}

/// Where and how the ball is released.
#[derive(Debug, Clone, Copy)]
struct Release {
    /// Angle about A1.
    place_rad: f64,
    radius_m: f64,
    height_m: f64,
    /// Angle of the throw to the horizontal.
    beta_deg: f64,
    /// Roll of the hand about v0.
    roll_rad: f64,
}

impl Release {
    /// Moved by `counts` steps.
    fn moved(&self, counts: [f64; 5], steps: &Self) -> Self {
        let [place, radius, height, beta, roll] = counts;
        Self {
            place_rad: self.place_rad + place * steps.place_rad,
            radius_m: self.radius_m + radius * steps.radius_m,
            height_m: self.height_m + height * steps.height_m,
            beta_deg: self.beta_deg + beta * steps.beta_deg,
            roll_rad: self.roll_rad + roll * steps.roll_rad,
        }
    }

    fn halved(&self) -> Self {
        Self {
            place_rad: 0.5 * self.place_rad,
            radius_m: 0.5 * self.radius_m,
            height_m: 0.5 * self.height_m,
            beta_deg: 0.5 * self.beta_deg,
            roll_rad: 0.5 * self.roll_rad,
        }
    }

    /// The flight from here through the target; `None` if no parabola leaves under this angle.
    fn flight(&self, setting: &Setting<'_>) -> Option<Parabola> {
        let (sin, cos) = self.place_rad.sin_cos();
        let p0 = Vector3::new(self.radius_m * cos, self.radius_m * sin, self.height_m);
        Parabola::with_angle(p0, setting.target, self.beta_deg.to_radians(), setting.gravity_m_s2())
    }
}

/// A feasible throw during the search.
struct Candidate {
    at: Release,
    flight: Parabola,
    hand: HandLaw,
    /// Postures on the parabola; the release is at `release`.
    window: Vec<Posture>,
    release: usize,
    j1: f64,
    j2: f64,
}

impl Candidate {
    fn better_than(&self, other: &Self, criterion: Criterion) -> bool {
        match criterion {
            Criterion::J2 => self.j2 < other.j2,
            Criterion::Points => (self.window.len(), -self.j1) > (other.window.len(), -other.j1),
        }
    }
}

/// Neighbours of a release in a grid of five numbers, itself included.
const NEIGHBOURS: u32 = 3_u32.pow(5);

/// Steps to a neighbour, each -1, 0 or 1.
fn offsets(neighbour: u32) -> [f64; 5] {
    std::array::from_fn(|k| f64::from(neighbour / 3_u32.pow(k as u32) % 3) - 1.0)
}

#[derive(Clone, Copy)]
struct Search<'a> {
    setting: &'a Setting<'a>,
    options: &'a PaperOptions,
    reach: Reach<'a>,
    ramps: RampPlan,
}

/// Plans a throw in the form of the paper.
///
/// # Errors
/// [`NotFound`] with the number of releases that each test refused.
pub fn plan(setting: &Setting<'_>, options: &PaperOptions) -> Result<Found, Box<NotFound>> {
    let search = Search::new(setting, options);
    let searched: Vec<_> = search.places_rad().into_par_iter().map(|place| search.place(place)).collect();
    let (mut found, mut misses, mut counts) = (Vec::new(), Vec::new(), StageCounts::default());
    for (some, missed, counted) in searched {
        found.extend(some);
        misses.extend(missed);
        counts = counts.plus(&counted);
    }
    let mut releases = options.size();
    let mut best: Option<Candidate> = None;
    for (candidate, counted, tried) in search.refined(found, misses) {
        counts = counts.plus(&counted);
        releases += tried;
        let is_better = |candidate: &Candidate| {
            best.as_ref().is_none_or(|best| candidate.better_than(best, options.criterion))
        };
        best = candidate.filter(is_better).or(best);
    }
    let size = SearchSize { releases, counts };
    match best {
        Some(found) => Ok(search.finished(&found, size)),
        None => Err(Box::new(NotFound { size, nearest: None })),
    }
}

/// What one task of the search has found so far.
struct Trial<'a> {
    clear: Clear<'a>,
    best: Option<Candidate>,
    /// The best of those that only the last tests refused.
    missed: Option<Candidate>,
    counts: StageCounts,
}

impl<'a> Trial<'a> {
    fn new(setting: &Setting<'a>, scenes: &'a Scenes) -> Self {
        let clear = Clear::new(setting.arm, scenes, setting.margins);
        Self { clear, best: None, missed: None, counts: StageCounts::default() }
    }
}

/// A candidate that a test refused, if it got as far as to be one.
type Refused = (Stage, Option<Box<Candidate>>);

impl From<Stage> for Refused {
    fn from(stage: Stage) -> Self {
        (stage, None)
    }
}

impl<'a> Search<'a> {
    fn new(setting: &'a Setting<'a>, options: &'a PaperOptions) -> Self {
        let together = match options.ramps {
            RampTiming::Synchronised => 1.0,
            RampTiming::Own => 0.0,
        };
        let ramps = RampPlan { shape: RampShape { blend_s: 0.0, fade_s: 0.0 }, together };
        Self { setting, options, reach: Reach::new(setting.arm), ramps }
    }

    /// Angles about A1 in the world: the direction of the throw only turns the grid, so they are counted from the
    /// azimuth of the target.
    fn places_rad(&self) -> Vec<f64> {
        let azimuth = self.setting.target.y.atan2(self.setting.target.x);
        self.options.places_rad().0.map(|place_rad| azimuth + place_rad).collect()
    }

    /// Heights and angles of the grid on one line of a cylinder, with their flights: `None` if no parabola leaves there.
    fn on_line(
        &self,
        place_rad: f64,
        radius_m: f64,
    ) -> impl Iterator<Item = (Release, Option<Parabola>)> + use<'a> {
        let (setting, options) = (self.setting, self.options);
        options.height_m.values().flat_map(move |height_m| {
            options.beta_deg.values().map(move |beta_deg| {
                let at = Release { place_rad, radius_m, height_m, beta_deg, roll_rad: 0.0 };
                (at, at.flight(setting))
            })
        })
    }

    /// A release with each roll of the grid.
    fn rolled(&self, at: Release) -> impl Iterator<Item = Release> + use<> {
        let rolls = self.options.rolls;
        (0..rolls).map(move |roll| Release { roll_rad: -PI + TAU * roll as f64 / rolls as f64, ..at })
    }

    /// The best release of each cylinder at one angle about A1, and the best that failed in the last tests.
    fn place(&self, place_rad: f64) -> (Vec<Candidate>, Vec<Candidate>, StageCounts) {
        let scenes = Scenes::new();
        let mut trial = Trial::new(self.setting, &scenes);
        let (mut found, mut misses) = (Vec::new(), Vec::new());
        let options = self.options;
        for radius_m in options.radius_m.values() {
            for (at, flight) in self.on_line(place_rad, radius_m) {
                let Some(flight) = flight else {
                    trial.counts.add(Stage::Flight, options.rolls as u64);
                    continue;
                };
                for at in self.rolled(at) {
                    self.release(&at, &flight, &mut trial);
                }
            }
            found.extend(trial.best.take());
            misses.extend(trial.missed.take());
        }
        (found, misses, trial.counts)
    }

    /// The best releases near those of the grid, each with the number of releases tried for it.
    fn refined(
        &self,
        mut found: Vec<Candidate>,
        mut misses: Vec<Candidate>,
    ) -> Vec<(Option<Candidate>, StageCounts, u64)> {
        let criterion = self.options.criterion;
        for some in [&mut found, &mut misses] {
            some.sort_by(|a, b| match () {
                () if a.better_than(b, criterion) => Ordering::Less,
                () if b.better_than(a, criterion) => Ordering::Greater,
                () => Ordering::Equal,
            });
        }
        found.truncate(REFINED);
        // Useful only if it may become better than the best found so far.
        misses.retain(|miss| found.first().is_none_or(|best| miss.better_than(best, criterion)));
        misses.truncate(if self.options.refinements > 0 { REFINED_MISSES } else { 0 });
        let seeds: Vec<_> = found
            .into_iter()
            .map(|candidate| (candidate.at, Some(candidate)))
            .chain(misses.into_iter().map(|miss| (miss.at, None)))
            .collect();
        seeds.into_par_iter().map(|(at, candidate)| self.finer(at, candidate)).collect()
    }

    /// The best release near `at`; `from` is the feasible one known there: all neighbours in a grid that gets finer.
    fn finer(&self, at: Release, from: Option<Candidate>) -> (Option<Candidate>, StageCounts, u64) {
        let scenes = Scenes::new();
        let mut trial = Trial { best: from, ..Trial::new(self.setting, &scenes) };
        let (mut steps, mut tried) = (self.options.steps(), 0);
        for _ in 0..self.options.refinements {
            steps = steps.halved();
            for _ in 0..MOVES {
                let center = trial.best.as_ref().map_or(at, |best| best.at);
                let mut improved = false;
                for neighbour in 0..NEIGHBOURS {
                    let at = center.moved(offsets(neighbour), &steps);
                    tried += 1;
                    match at.flight(self.setting) {
                        Some(flight) => improved |= self.release(&at, &flight, &mut trial),
                        None => trial.counts.add(Stage::Flight, 1),
                    }
                }
                if !improved {
                    break;
                }
            }
        }
        (trial.best, trial.counts, tried)
    }

    /// Tests one release in all postures; keeps it if it is better than the best, and returns whether it did.
    fn release(&self, at: &Release, flight: &Parabola, trial: &mut Trial<'_>) -> bool {
        let hand = HandLaw::constant(at.roll_rad);
        let at_release = hand.at(flight, 0.0);
        let mut is_better = false;
        let postures = self.reach.all(&at_release.x_wb);
        if postures.is_empty() {
            trial.counts.add(Stage::Reach, 1);
        }
        for q in postures {
            match self.posture(at, flight, &hand, q, trial) {
                Ok(Some(candidate)) => {
                    trial.counts.add(Stage::Feasible, 1);
                    (trial.best, is_better) = (Some(candidate), true);
                }
                Ok(None) => trial.counts.add(Stage::Dominated, 1),
                Err((stage, candidate)) => {
                    trial.counts.add(stage, 1);
                    let criterion = self.options.criterion;
                    let is_better = |miss: &Candidate| {
                        trial.missed.as_ref().is_none_or(|best| miss.better_than(best, criterion))
                    };
                    if let Some(miss) = candidate.filter(|miss| is_better(miss)) {
                        trial.missed = Some(*miss);
                    }
                }
            }
        }
        is_better
    }

    /// `Ok(None)` for a release that is not better than `best`, before further tests.
    fn posture(
        &self,
        at: &Release,
        flight: &Parabola,
        hand: &HandLaw,
        q: Axes,
        trial: &mut Trial<'_>,
    ) -> Result<Option<Candidate>, Refused> {
        let options = self.options;
        let (best, clear) = (trial.best.as_ref(), &mut trial.clear);
        let release = self.reach.rates(q, &hand.at(flight, 0.0)).ok_or(Stage::Singular)?;
        if !self.within_speed(&release) {
            return Err(Stage::Speed.into());
        }
        let j1 = j1(&release.qd, &options.w);
        // More points make the second part of j2 smaller, never the first.
        if let (Criterion::J2, Some(best)) = (options.criterion, best)
            && options.g[0] * j1 * j1 >= best.j2
        {
            return Ok(None);
        }
        self.start_reachable(&release, clear)?;
        self.stop_reachable(&release, clear)?;
        let (window, release) = self.follow(flight, hand, release, clear);
        let candidate = Candidate {
            at: *at,
            flight: *flight,
            hand: *hand,
            j2: j2(j1, window.len(), &options.g),
            window,
            release,
            j1,
        };
        if best.is_some_and(|best| !candidate.better_than(best, options.criterion)) {
            return Ok(None);
        }
        let found = self.motion(&candidate);
        let commands = found.commands(self.setting.lag_s);
        if !commands.iter().all(|command| self.setting.commands.holds(command)) {
            return Err((Stage::CutOut, Some(Box::new(candidate))));
        }
        let used = Peaks::of(&commands, found.period_s).use_of(&self.setting.limits);
        if used.iter().any(|u| *u > 1.0) {
            return Err((Stage::CutOut, Some(Box::new(candidate))));
        }
        let (first_flight, landing_s) = self.flight_of_window(&candidate);
        match clear.first_contact(&found, &first_flight, landing_s) {
            None => Ok(Some(candidate)),
            Some(contact) => Err((Stage::of(&contact), Some(Box::new(candidate)))),
        }
    }

    fn within_speed(&self, posture: &Posture) -> bool {
        posture.qd.iter().zip(self.setting.limits.v_max_rad_s.iter()).all(|(v, max)| v.abs() <= *max)
    }

    fn within_range(&self, q: &Axes, qd: &Axes) -> bool {
        let limits = &self.setting.limits;
        (0..AXES).all(|i| q[i] >= limits.q_min_rad[i] && q[i] <= limits.q_max_rad[i])
            && self.setting.commands.holds(&(q + qd * self.setting.lag_s))
    }

    fn above_floor(&self, q: &Axes, clear: &Clear<'_>) -> bool {
        clear.height_m(&self.setting.arm.fk(q)) >= clear.margins().floor_m
    }

    fn start_reachable(&self, edge: &Posture, clear: &Clear<'_>) -> Result<(), Stage> {
        let rest = Ramps::start(edge, self.ramps, &self.setting.limits).rest();
        if !self.within_range(&rest, &Axes::zeros(AXES)) {
            return Err(Stage::StartRange);
        }
        if self.above_floor(&rest, clear) { Ok(()) } else { Err(Stage::StartFloor) }
    }

    fn stop_reachable(&self, edge: &Posture, clear: &Clear<'_>) -> Result<(), Stage> {
        let rest = Ramps::stop(edge, self.ramps, &self.setting.limits).rest();
        if !self.within_range(&rest, &Axes::zeros(AXES)) {
            return Err(Stage::StopRange);
        }
        if self.above_floor(&rest, clear) { Ok(()) } else { Err(Stage::StopFloor) }
    }

    /// Steps forwards and backwards from the release; returns the postures and the number of the release among them.
    fn follow(
        &self,
        flight: &Parabola,
        hand: &HandLaw,
        release: Posture,
        clear: &Clear<'_>,
    ) -> (Vec<Posture>, usize) {
        let period_s = self.setting.period_s;
        let mut window = std::collections::VecDeque::from([release]);
        let mut at = 0;
        let (mut ahead, mut back) = (true, true);
        while ahead || back {
            if ahead {
                let t_s = (window.len() - at) as f64 * period_s;
                let next = self.next_step(flight, hand, &window[window.len() - 1], t_s);
                match next.filter(|p| self.stop_reachable(p, clear).is_ok()) {
                    Some(posture) => window.push_back(posture),
                    None => ahead = false,
                }
            }
            if back {
                let t_s = -((at + 1) as f64) * period_s;
                let next = self.next_step(flight, hand, &window[0], t_s);
                match next.filter(|p| self.start_reachable(p, clear).is_ok()) {
                    Some(posture) => {
                        window.push_front(posture);
                        at += 1;
                    }
                    None => back = false,
                }
            }
        }
        (window.into(), at)
    }

    /// The posture at `t_s` if it can be reached from its neighbour within the limits.
    fn next_step(&self, flight: &Parabola, hand: &HandLaw, from: &Posture, t_s: f64) -> Option<Posture> {
        let state = hand.at(flight, t_s);
        let q = self.reach.near(&state.x_wb, &from.q)?;
        let next = self.reach.rates(q, &state)?;
        let limits = &self.setting.limits;
        let change = (next.qd - from.qd) / self.setting.period_s;
        let gentle = change.iter().zip(limits.a_max_rad_s2.iter()).all(|(a, max)| a.abs() <= *max);
        (gentle && self.within_speed(&next) && self.within_range(&next.q, &next.qd)).then_some(next)
    }

    fn motion(&self, candidate: &Candidate) -> FollowMotion {
        let window = &candidate.window;
        let limits = &self.setting.limits;
        let start = Ramps::start(&window[0], self.ramps, limits);
        let stop = Ramps::stop(&window[window.len() - 1], self.ramps, limits);
        FollowMotion::around(window, &start, &stop, self.setting.period_s)
    }

    /// The flight with t = 0 at the first step on the parabola, and when it ends.
    fn flight_of_window(&self, candidate: &Candidate) -> (Parabola, f64) {
        let back_s = candidate.release as f64 * self.setting.period_s;
        let flight = candidate.flight.from_time(-back_s);
        (flight, flight.time_to(&self.setting.target))
    }

    fn finished(&self, candidate: &Candidate, size: SearchSize) -> Found {
        let motion = self.motion(candidate);
        let (flight, _) = self.flight_of_window(candidate);
        Found {
            flight,
            hand: candidate.hand,
            motion,
            release: candidate.release,
            j1: candidate.j1,
            j2: candidate.j2,
            size,
        }
    }
}

//! Throws for trials: drawn, and judged by whether a place to catch them exists.

use std::ops::Range;

use hil_sim::mechanics::{BallOptions, LooseBall};
use nalgebra::{Matrix3, Vector3};
use operator::ball_catch::trial::{Pair, TrialOptions};
use planner::catch::Joints;
use planner::catch::draw::{Aimed, Window, draw};
use planner::catch::forecast::{Forecast, Foreseen, Watch};
use planner::catch::search::{Choice, search};
use planner::catch::task::{Decline, Start};
use planner::flight::FlightModel;
use planner::motion_law::State;
use planner::plan::rng::SplitMix64;
use rayon::prelude::*;

/// A place exists if an arm that knows the throw at one of these times reaches one, s after the release: motions that begin at different
/// times go different ways.
const KNOWN_S: [f64; 5] = [-2.0, -0.6, -0.3, 0.0, 0.07];
/// The release in the time of these searches, s.
const RELEASE_S: f64 = 2.0;
/// Draws per throw before giving up.
const TRIES: usize = 3_000_000;
/// If none of so many first throws is found, the thrower cannot reach the window: at 3 m one in some hundred is not found.
const FIRST: usize = 4;
/// Throws drawn at most for one that can be caught.
const DRAWN_PER_POSSIBLE: usize = 10;

/// Throws at a cell, drawn from a seed.
///
/// `None` if the thrower cannot reach the window.
pub fn draw_throws(pair: &Pair, window: &Window, count: usize, seed: u64) -> Option<Vec<Aimed>> {
    let first = count.min(FIRST);
    let mut throws = draw_from(pair, window, 0..first, seed, TRIES)?;
    if throws.is_empty() {
        return None;
    }
    throws.extend(draw_from(pair, window, first..count, seed, TRIES)?);
    Some(throws)
}

/// Throws at one window of one cell, drawn once for several settings.
#[derive(Debug)]
pub struct Drawn<'a> {
    pair: &'a Pair,
    window: Window,
    seed: u64,
    /// Numbers that were tried; a few of them lead to no throw where a window is hard to reach.
    numbers: usize,
    throws: Vec<Aimed>,
}

impl<'a> Drawn<'a> {
    pub fn new(pair: &'a Pair, window: Window, seed: u64) -> Self {
        Self { pair, window, seed, numbers: 0, throws: Vec::new() }
    }

    /// As many throws as it takes until `possible` of them have a place where they can be caught, at most ten times as many; and for
    /// each whether it has one.
    ///
    /// `None` if the thrower cannot reach the window.
    pub fn possible(&mut self, options: &TrialOptions, possible: usize) -> Option<(Vec<Aimed>, Vec<bool>)> {
        let mut exists: Vec<bool> = Vec::new();
        let mut found = 0;
        while found < possible && exists.len() < DRAWN_PER_POSSIBLE * possible {
            let missing = exists.len()..exists.len() + (possible - found);
            while self.throws.len() < missing.end {
                let numbers = self.numbers..self.numbers + missing.end - self.throws.len();
                self.numbers = numbers.end;
                let more = draw_from(self.pair, &self.window, numbers, self.seed, TRIES)?;
                if more.is_empty() {
                    return None;
                }
                self.throws.extend(more);
            }
            let next = &self.throws[missing];
            let places: Vec<bool> =
                next.par_iter().map(|aimed| place_exists(self.pair, aimed, options)).collect();
            found += places.iter().filter(|place| **place).count();
            exists.extend(places);
        }
        Some((self.throws[..exists.len()].to_vec(), exists))
    }
}

/// How the ball of a cell flies.
pub(super) fn flight(pair: &Pair) -> Option<FlightModel> {
    let flight = FlightModel::vacuum(pair.cell.arms[0].model.world().gravity_m_s2).ok()?;
    flight.with_drag(pair.cell.ball.drag_1_m).ok()
}

/// One throw for each of these numbers, which seed the draws. A number that finds none in so many tries is left out.
pub(super) fn draw_from(
    pair: &Pair,
    window: &Window,
    numbers: Range<usize>,
    seed: u64,
    tries: usize,
) -> Option<Vec<Aimed>> {
    let [thrower, catcher] = &pair.cell.arms;
    let flight = flight(pair)?;
    let throws = numbers.into_par_iter().filter_map(|k| {
        let mut rng = SplitMix64::stream(seed, k as u64);
        draw(&thrower.model, &thrower.x_wb, &catcher.x_wb, &flight, window, &mut rng, tries)
    });
    Some(throws.collect())
}

/// Whether a place to catch this throw exists for an arm that knows it, at one of some times. A partner keeps clear of the thrower's way,
/// whoever knows no plan of its whole reach.
pub fn place_exists(pair: &Pair, aimed: &Aimed, options: &TrialOptions) -> bool {
    why_no_place(pair, aimed, options).is_none()
}

/// Why no place to catch this throw exists, for the arm that knows it earliest; `None` if one does.
pub(super) fn why_no_place(pair: &Pair, aimed: &Aimed, options: &TrialOptions) -> Option<Decline> {
    let mut none: Option<Decline> = None;
    for at_s in KNOWN_S {
        match catch_from(pair, aimed, options, &options.wait, at_s) {
            Ok(_) => return None,
            Err(why) => none = none.or(Some(why)),
        }
    }
    none
}

/// The catch that the search finds for an arm that rests at `wait` and knows the throw `known_s` after its release: its probability, and
/// the largest share of an acceleration or jerk limit that its motion uses. `None` if it finds none.
pub(super) fn reached_from(
    pair: &Pair,
    aimed: &Aimed,
    options: &TrialOptions,
    wait: &Joints,
    known_s: f64,
) -> Option<(f64, f64)> {
    let choice = catch_from(pair, aimed, options, wait, known_s).ok()?;
    Some((choice.probability, choice.used))
}

fn catch_from(
    pair: &Pair,
    aimed: &Aimed,
    options: &TrialOptions,
    wait: &Joints,
    known_s: f64,
) -> Result<Choice, Decline> {
    let arm = &pair.catcher_for(aimed, options);
    let state = std::array::from_fn(|i| State::rest(wait[i]));
    let start = Start { at_s: RELEASE_S + known_s, state: &state, under_way: None };
    let gravity_m_s2 = pair.cell.arms[0].model.world().gravity_m_s2;
    let forecast = true_forecast(&pair.cell.ball, aimed, RELEASE_S, gravity_m_s2);
    search(arm, &options.settings, &start, &forecast).0
}

/// The flight of the planned throw as it is, released at `release_s`.
pub fn true_forecast(ball: &BallOptions, aimed: &Aimed, release_s: f64, gravity_m_s2: f64) -> Forecast {
    let mut at = LooseBall { p_m: aimed.p_m, v_m_s: aimed.v_m_s, spin_rad_s: Vector3::zeros() };
    let points = (0..240).map(|k| {
        let point = Foreseen {
            t_s: release_s + 0.005 * f64::from(k),
            p_m: at.p_m,
            v_m_s: at.v_m_s,
            covariance_m2: Matrix3::identity() * 1e-8,
        };
        at.fly(ball, gravity_m_s2, 0.005);
        point
    });
    let watch = Watch { sigma_m: 0.002, period_s: 1.0 / 120.0, latency_s: 0.015, first_s: 0.0 };
    Forecast { points: points.collect(), watch }
}

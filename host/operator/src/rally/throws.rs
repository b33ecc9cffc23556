//! Throws for trials: drawn, and judged by whether a place to catch them exists.

use std::ops::Range;

use hil_sim::mechanics::{BallOptions, LooseBall};
use nalgebra::{Matrix3, Vector3};
use planner::catch::draw::{Aimed, Window, draw};
use planner::catch::forecast::{Forecast, Foreseen, Watch};
use planner::catch::law::State;
use planner::catch::search::{Start, search};
use planner::flight::FlightModel;
use planner::plan::rng::SplitMix64;
use rayon::prelude::*;

use super::trial::{Pair, TrialOptions};

/// Draws per throw before giving up.
const TRIES: usize = 3_000_000;
/// Throws drawn at most for one that can be caught.
const DRAWN_PER_POSSIBLE: usize = 10;

/// Throws at a court, drawn from a seed.
///
/// `None` if the thrower cannot reach the window.
#[must_use]
pub fn draw_throws(pair: &Pair, window: &Window, count: usize, seed: u64) -> Option<Vec<Aimed>> {
    draw_from(pair, window, 0..count, seed)
}

/// As many throws as it takes until `possible` of them have a place where they can be caught, at most ten times as many; and for each
/// whether it has one.
///
/// `None` if the thrower cannot reach the window.
#[must_use]
pub fn draw_possible(
    pair: &Pair,
    window: &Window,
    options: &TrialOptions,
    possible: usize,
    seed: u64,
) -> Option<(Vec<Aimed>, Vec<bool>)> {
    let (mut throws, mut exists) = (Vec::new(), Vec::new());
    let mut found = 0;
    for block in 0..DRAWN_PER_POSSIBLE {
        let drawn = draw_from(pair, window, block * possible..(block + 1) * possible, seed)?;
        let places: Vec<bool> = drawn.par_iter().map(|aimed| place_exists(pair, aimed, options)).collect();
        for (aimed, place) in drawn.into_iter().zip(places) {
            throws.push(aimed);
            exists.push(place);
            found += usize::from(place);
            if found == possible {
                return Some((throws, exists));
            }
        }
    }
    Some((throws, exists))
}

fn draw_from(pair: &Pair, window: &Window, numbers: Range<usize>, seed: u64) -> Option<Vec<Aimed>> {
    let [thrower, catcher] = &pair.court.arms;
    let flight = FlightModel::vacuum(thrower.model.world().gravity_m_s2).ok()?;
    let flight = flight.with_drag(pair.court.ball.drag_1_m).ok()?;
    numbers
        .into_par_iter()
        .map(|k| {
            let mut rng = SplitMix64::stream(seed, k as u64);
            draw(&thrower.model, &thrower.x_wb, &catcher.x_wb, &flight, window, &mut rng, TRIES)
        })
        .collect()
}

/// Whether a place to catch this throw exists for an arm that knows it long before. A partner keeps clear of the thrower's way,
/// whoever knows no plan of its whole reach.
#[must_use]
pub fn place_exists(pair: &Pair, aimed: &Aimed, options: &TrialOptions) -> bool {
    let arm = &pair.catcher_for(aimed, options);
    let state = std::array::from_fn(|i| State::rest(options.wait[i]));
    let start = Start { at_s: 0.0, state: &state, under_way: None };
    let forecast = true_forecast(&pair.court.ball, aimed, 2.0, pair.court.arms[0].model.world().gravity_m_s2);
    search(arm, &options.settings, &start, &forecast).0.is_ok()
}

/// The flight of the planned throw as it is, released at `release_s`.
#[must_use]
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

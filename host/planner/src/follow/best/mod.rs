//! The planner without a grid: the longest window under all limits of the commands.
//!
//! # Map
//! ```text
//!  mod        starts in parallel, growth, kicks, the best of them
//!   |   \
//!   |    march      throws carried from nearer targets
//!   |      v
//!   |    seeds      releases to start from
//!   v      v
//!  least_squares    drives all excesses over limits to zero
//!   v
//!  excess           how far a window is beyond each limit
//!   v
//!  variables        numbers of the search <-> flight, hand, ramps
//! ```
//!
//! For a fixed number of points, feasibility is a least-squares problem: every limit gives residuals that are zero
//! inside. A feasible window is then made longer, starting from itself, until no longer one is found; the best are
//! disturbed and grown again. Every result passes the same final tests as the paper form, and the verifier.

mod excess;
mod least_squares;
mod march;
mod seeds;
mod variables;

use rayon::prelude::*;
use robot_model::radical_inverse;
use serde::{Deserialize, Serialize};

use super::clear::Scenes;
use super::found::{Found, NotFound, SearchSize, Stage};
use super::limits::{AXES, Axes};
use super::motion::Peaks;
use super::paper::{j1, j2};
use super::setting::Setting;
use excess::Excess;
use seeds::Seed;
pub use variables::HandFreedom;
use variables::{COUNT, Variables};

/// Options of the search.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BestOptions {
    /// How the hand may turn during the window.
    pub hand: HandFreedom,
    /// Releases that are drawn.
    pub draws: usize,
    /// Releases that are optimised. If none leads to a throw, throws to nearer targets are carried outwards.
    pub starts: usize,
    /// Disturbed restarts of each of the best results.
    pub kicks: usize,
    /// Where the sequences of draws and kicks begin.
    pub seed: u64,
    /// Stop growing at this many points.
    pub points_max: usize,
    /// Diagonal of W for the reported j1.
    pub w: [f64; AXES],
    /// Diagonal of G for the reported j2.
    pub g: [f64; 2],
}

impl Default for BestOptions {
    fn default() -> Self {
        Self {
            hand: HandFreedom::TangentAndRoll,
            draws: 20_000,
            starts: 24,
            kicks: 12,
            seed: 1,
            points_max: 80,
            w: [1.0; AXES],
            g: [1.0; 2],
        }
    }
}

/// Results that are disturbed and grown again.
const KICKED: usize = 4;
/// Lag of the detour of a search without lag, s.
const DETOUR_LAG_S: f64 = 0.024;
/// First lengthening of a window, in points; halved at each failure.
const GROWTH: usize = 8;

/// A feasible window.
#[derive(Debug, Clone)]
struct Grown {
    x: Variables,
    q_center: Axes,
    points: usize,
    cost_j1: f64,
}

impl Grown {
    fn better_than(&self, other: &Self) -> bool {
        (self.points, -self.cost_j1) > (other.points, -other.cost_j1)
    }
}

/// Plans the throw with the longest window found.
///
/// # Errors
/// [`NotFound`] if no start leads to a feasible throw with one point, and none can be carried to the target.
pub fn plan(setting: &Setting<'_>, options: &BestOptions) -> Result<Found, Box<NotFound>> {
    let (seeds, mut counts) = seeds::draw(setting, options, options.starts);
    let tried: Vec<Option<Grown>> = seeds.par_iter().map(|seed| from_seed(setting, options, seed)).collect();
    counts.add(Stage::Unsolved, tried.iter().filter(|g| g.is_none()).count() as u64);
    let mut grown: Vec<Grown> = tried.into_iter().flatten().collect();
    if grown.is_empty() {
        let releases = options.draws as u64;
        match march::toward(setting, options) {
            Ok(carried) => grown.push(carried),
            Err(nearest) => {
                return Err(Box::new(NotFound { size: SearchSize { releases, counts }, nearest }));
            }
        }
    }
    counts.add(Stage::Feasible, grown.len() as u64);
    grown.sort_by(|a, b| {
        (b.points, a.cost_j1).partial_cmp(&(a.points, b.cost_j1)).unwrap_or(std::cmp::Ordering::Equal)
    });
    grown.truncate(KICKED);
    let kicked: Vec<Grown> = grown
        .par_iter()
        .enumerate()
        .map(|(k, g)| {
            let kicked = kick(setting, options, g.clone(), k as u64);
            if options.kicks > 0 { detour(setting, options, kicked, k as u64) } else { kicked }
        })
        .collect();
    let size = SearchSize { releases: options.draws as u64, counts };
    let best = kicked.into_iter().reduce(|a, b| if b.better_than(&a) { b } else { a });
    best.and_then(|g| finished(setting, options, &g, size))
        .ok_or_else(|| Box::new(NotFound { size, nearest: None }))
}

fn from_seed(setting: &Setting<'_>, options: &BestOptions, seed: &Seed) -> Option<Grown> {
    let scenes = Scenes::new();
    let mut excess = Excess::new(setting, options.hand, &scenes);
    let first = shortest(&mut excess, options, seed)?;
    Some(grow(&mut excess, options, first))
}

/// A window of two points or, where that has none, of one.
fn shortest(excess: &mut Excess<'_>, options: &BestOptions, seed: &Seed) -> Option<Grown> {
    [2, 1].into_iter().find_map(|points| feasible(excess, options, &seed.x, &seed.q, points))
}

/// Makes the window longer as long as that succeeds.
fn grow(excess: &mut Excess<'_>, options: &BestOptions, mut best: Grown) -> Grown {
    let mut step = GROWTH;
    while step > 0 && best.points < options.points_max {
        let points = (best.points + step).min(options.points_max);
        match feasible(excess, options, &best.x, &best.q_center, points) {
            Some(longer) => best = longer,
            None => step /= 2,
        }
    }
    best
}

/// Disturbs the variables and grows again.
fn kick(setting: &Setting<'_>, options: &BestOptions, mut best: Grown, stream: u64) -> Grown {
    const BASES: [u32; COUNT] = [2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37, 41, 43, 47];
    let scenes = Scenes::new();
    let mut excess = Excess::new(setting, options.hand, &scenes);
    for kick in 0..options.kicks as u64 {
        let number = 20 + (options.seed + stream) * 1000 + kick;
        // Large and small disturbances in turn.
        let size = [0.3, 1.0, 3.0][kick as usize % 3];
        let mut x = best.x;
        for (i, base) in BASES.into_iter().enumerate() {
            x.0[i] += size * variables::SCALES[i] * (2.0 * radical_inverse(number, base) - 1.0);
        }
        x.clamp(options.hand, excess.blend_max_s());
        let Some(again) = feasible(&mut excess, options, &x, &best.q_center, best.points) else { continue };
        let again = grow(&mut excess, options, again);
        if again.better_than(&best) {
            best = again;
        }
    }
    best
}

/// Grows a window as if the robot had another lag, and returns to the part of it that is feasible.
///
/// A window that no small change makes longer is often at a limit that depends on the lag: commands lead by the
/// lag, so other instants limit it. Without lag 34 points at 2.5 m and 0.6 m height became more in this way.
fn detour(setting: &Setting<'_>, options: &BestOptions, best: Grown, stream: u64) -> Grown {
    let scenes = Scenes::new();
    let other_lag_s = if setting.lag_s > 0.0 { 0.0 } else { DETOUR_LAG_S };
    let other = Setting { lag_s: other_lag_s, ..*setting };
    let mut there = Excess::new(&other, options.hand, &scenes);
    let shorter = [0, 2, 4, 8, 16].map(|fewer: usize| best.points.saturating_sub(fewer).max(1));
    let first =
        shorter.into_iter().find_map(|points| feasible(&mut there, options, &best.x, &best.q_center, points));
    let Some(first) = first else { return best };
    let first = grow(&mut there, options, first);
    let grown = kick(&other, options, first, stream);
    let mut here = Excess::new(setting, options.hand, &scenes);
    (best.points + 1..=grown.points)
        .rev()
        .find_map(|points| feasible(&mut here, options, &grown.x, &grown.q_center, points))
        .map_or(best, |back| grow(&mut here, options, back))
}

/// A feasible window of `points` near `x`, tested completely.
fn feasible(
    excess: &mut Excess<'_>,
    options: &BestOptions,
    x: &Variables,
    q_center: &Axes,
    points: usize,
) -> Option<Grown> {
    let (x, q_center) = least_squares::solve(excess, x, q_center, points)?;
    let (motion, flight) = excess.motion(&x, &q_center, points)?;
    let setting = excess.setting();
    let used = Peaks::of(&motion.commands(setting.lag_s), motion.period_s).use_of(&setting.limits);
    if used.iter().any(|u| *u > 1.0) || !excess.in_range(&motion) {
        return None;
    }
    let landing_s = flight.time_to(&setting.target);
    if excess.clear().first_contact(&motion, &flight, landing_s).is_some() {
        return None;
    }
    let release = &motion.states[(motion.first + motion.last) / 2];
    Some(Grown { x, q_center, points, cost_j1: j1(&release.qd, &options.w) })
}

fn finished(setting: &Setting<'_>, options: &BestOptions, grown: &Grown, size: SearchSize) -> Option<Found> {
    let scenes = Scenes::new();
    let excess = Excess::new(setting, options.hand, &scenes);
    let (motion, flight) = excess.motion(&grown.x, &grown.q_center, grown.points)?;
    let release = (grown.points - 1) / 2;
    Some(Found {
        flight,
        hand: grown.x.hand(),
        release,
        j1: grown.cost_j1,
        j2: j2(grown.cost_j1, grown.points, &options.g),
        motion,
        size,
    })
}

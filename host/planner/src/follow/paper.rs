//! The planner of the paper (000, section 3.2): a grid of releases, ramps, and steps along the parabola.
//!
//! A release is a place on concentric cylinders around A1, a parabola of the family through the target (angle β, so
//! speed v0), and a roll of the hand about v0. The hand is across v0 and does not turn. Speeds follow from the inverse
//! Jacobian, start and stop from ramps of constant acceleration. From each release the hand follows the parabola
//! forwards and backwards in steps of the controller as long as the limits and both ramps allow.

use std::f64::consts::{PI, TAU};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::clear::{Clear, Scenes};
use super::found::{Found, NotFound, SearchSize, Stage, StageCounts};
use super::hand::HandLaw;
use super::limits::{AXES, Axes};
use super::motion::{Motion, Peaks, RampPlan, Ramps};
use super::parabola::Parabola;
use super::posture::{Posture, Reach};
use super::ramp::RampShape;
use super::setting::Setting;

/// First value, last value, and number of steps between them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct GridAxis {
    /// First value.
    pub from: f64,
    /// Last value.
    pub to: f64,
    /// Number of values, at least 1.
    pub count: usize,
}

impl GridAxis {
    /// The values.
    pub fn values(&self) -> impl Iterator<Item = f64> + Clone + use<> {
        let Self { from, to, count } = *self;
        let step = if count > 1 { (to - from) / (count - 1) as f64 } else { 0.0 };
        (0..count).map(move |k| from + step * k as f64)
    }
}

/// How the ramps of the axes are timed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RampTiming {
    /// All axes start and stop together, the slowest with the full acceleration.
    Synchronised,
    /// Every axis takes its own shortest time; all are ready at the same instant.
    Own,
}

/// Which of the feasible throws is the best.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Criterion {
    /// The smallest j2 (equation 8).
    J2,
    /// The most followed points, then the smallest j1.
    Points,
}

/// Resolution, weights and limits of the search.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PaperOptions {
    /// Radius of the cylinders in m.
    pub radius_m: GridAxis,
    /// Height of the release above the base in m.
    pub height_m: GridAxis,
    /// Number of places on a cylinder.
    pub places: usize,
    /// Angle of the throw to the horizontal in deg.
    pub beta_deg: GridAxis,
    /// Number of rolls about v0.
    pub rolls: usize,
    /// Diagonal of W (equation 7).
    pub w: [f64; AXES],
    /// Diagonal of G (equation 8).
    pub g: [f64; 2],
    /// Timing of the ramps.
    pub ramps: RampTiming,
    /// What is the best.
    pub criterion: Criterion,
}

impl PaperOptions {
    /// A grid that covers the reach of an arm, each axis with a number of values in proportion to `resolution` (1 takes
    /// seconds, 2 about 32 times as long).
    #[must_use]
    pub fn covering(reach_m: f64, base_z_m: f64, floor_z_m: f64, resolution: f64) -> Self {
        let values = |count: f64| ((count * resolution).round() as usize).max(2);
        Self {
            radius_m: GridAxis { from: 0.25 * reach_m, to: 0.95 * reach_m, count: values(8.0) },
            height_m: GridAxis {
                from: (base_z_m - 0.7 * reach_m).max(floor_z_m + 0.1),
                to: base_z_m + 0.8 * reach_m,
                count: values(10.0),
            },
            places: values(36.0),
            beta_deg: GridAxis { from: -30.0, to: 75.0, count: values(15.0) },
            rolls: values(24.0),
            w: [1.0; AXES],
            g: [1.0; 2],
            ramps: RampTiming::Synchronised,
            criterion: Criterion::J2,
        }
    }

    /// Number of releases in the grid.
    #[must_use]
    pub fn size(&self) -> u64 {
        [self.radius_m.count, self.height_m.count, self.places, self.beta_deg.count, self.rolls]
            .into_iter()
            .map(|n| n as u64)
            .product()
    }
}

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

/// A feasible throw during the search.
struct Candidate {
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
    let together = match options.ramps {
        RampTiming::Synchronised => 1.0,
        RampTiming::Own => 0.0,
    };
    let ramps = RampPlan { shape: RampShape { blend_s: 0.0, fade_s: 0.0 }, together };
    let search = Search { setting, options, reach: Reach::new(setting.arm), ramps };
    // Where the throw is to go only turns the grid, so the places are counted from the azimuth of the target.
    let azimuth = setting.target.y.atan2(setting.target.x);
    let places = (0..options.places).map(|k| azimuth + TAU * k as f64 / options.places as f64);
    let (best, counts) = places.collect::<Vec<_>>().into_par_iter().map(|place| search.place(place)).reduce(
        || (None, StageCounts::default()),
        |a, b| (better(a.0, b.0, options.criterion), a.1.plus(&b.1)),
    );
    let size = SearchSize { releases: options.size(), counts };
    match best {
        Some(found) => Ok(search.finished(&found, size)),
        None => Err(Box::new(NotFound { size })),
    }
}

fn better(a: Option<Candidate>, b: Option<Candidate>, criterion: Criterion) -> Option<Candidate> {
    match (a, b) {
        (Some(a), Some(b)) => Some(if b.better_than(&a, criterion) { b } else { a }),
        (a, b) => a.or(b),
    }
}

impl Search<'_> {
    /// The best release at one angle about A1.
    fn place(&self, place_rad: f64) -> (Option<Candidate>, StageCounts) {
        let scenes = Scenes::new();
        let mut clear = Clear::new(self.setting.arm, &scenes, self.setting.margins);
        let (mut best, mut counts) = (None, StageCounts::default());
        let options = self.options;
        for radius_m in options.radius_m.values() {
            for height_m in options.height_m.values() {
                let p0 =
                    nalgebra::Vector3::new(radius_m * place_rad.cos(), radius_m * place_rad.sin(), height_m);
                for beta_deg in options.beta_deg.values() {
                    let flight = Parabola::with_angle(
                        p0,
                        self.setting.target,
                        beta_deg.to_radians(),
                        self.setting.gravity_m_s2(),
                    );
                    let Some(flight) = flight else {
                        counts.add(Stage::Flight, options.rolls as u64);
                        continue;
                    };
                    for roll in 0..options.rolls {
                        let hand = HandLaw::constant(-PI + TAU * roll as f64 / options.rolls as f64);
                        self.release(&flight, &hand, &mut clear, &mut best, &mut counts);
                    }
                }
            }
        }
        (best, counts)
    }

    /// Tests one release in all postures; keeps it if it is better than `best`.
    fn release(
        &self,
        flight: &Parabola,
        hand: &HandLaw,
        clear: &mut Clear<'_>,
        best: &mut Option<Candidate>,
        counts: &mut StageCounts,
    ) {
        let at_release = hand.at(flight, 0.0);
        let postures = self.reach.all(&at_release.x_wb);
        if postures.is_empty() {
            counts.add(Stage::Reach, 1);
        }
        for q in postures {
            match self.posture(flight, hand, q, clear, best.as_ref()) {
                Ok(Some(candidate)) => {
                    counts.add(Stage::Feasible, 1);
                    *best = Some(candidate);
                }
                Ok(None) => counts.add(Stage::Dominated, 1),
                Err(stage) => counts.add(stage, 1),
            }
        }
    }

    /// `Ok(None)` for a release that is not better than `best`, whatever follows.
    fn posture(
        &self,
        flight: &Parabola,
        hand: &HandLaw,
        q: Axes,
        clear: &mut Clear<'_>,
        best: Option<&Candidate>,
    ) -> Result<Option<Candidate>, Stage> {
        let options = self.options;
        let release = self.reach.rates(q, &hand.at(flight, 0.0)).ok_or(Stage::Singular)?;
        if !self.within_speed(&release) {
            return Err(Stage::Speed);
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
        let (window, at) = self.follow(flight, hand, release, clear);
        let candidate = Candidate {
            flight: *flight,
            hand: *hand,
            j2: j2(j1, window.len(), &options.g),
            window,
            release: at,
            j1,
        };
        if best.is_some_and(|best| !candidate.better_than(best, options.criterion)) {
            return Ok(None);
        }
        let found = self.motion(&candidate);
        let used =
            Peaks::of(&found.commands(self.setting.lag_s), found.period_s).use_of(&self.setting.limits);
        if used.iter().any(|u| *u > 1.0) {
            return Err(Stage::CutOut);
        }
        let (first_flight, landing_s) = self.flight_of_window(&candidate);
        match clear.first_contact(&found, &first_flight, landing_s) {
            None => Ok(Some(candidate)),
            Some(contact) => Err(Stage::of(&contact)),
        }
    }

    fn within_speed(&self, posture: &Posture) -> bool {
        posture.qd.iter().zip(self.setting.limits.v_max_rad_s.iter()).all(|(v, max)| v.abs() <= *max)
    }

    fn within_range(&self, q: &Axes) -> bool {
        let limits = &self.setting.limits;
        (0..AXES).all(|i| q[i] >= limits.q_min_rad[i] && q[i] <= limits.q_max_rad[i])
    }

    fn above_floor(&self, q: &Axes, clear: &Clear<'_>) -> bool {
        clear.height_m(&self.setting.arm.fk(q)) >= clear.margins().floor_m
    }

    fn start_reachable(&self, edge: &Posture, clear: &Clear<'_>) -> Result<(), Stage> {
        let rest = Ramps::start(edge, self.ramps, &self.setting.limits).rest();
        if !self.within_range(&rest) {
            return Err(Stage::StartRange);
        }
        if self.above_floor(&rest, clear) { Ok(()) } else { Err(Stage::StartFloor) }
    }

    fn stop_reachable(&self, edge: &Posture, clear: &Clear<'_>) -> Result<(), Stage> {
        let rest = Ramps::stop(edge, self.ramps, &self.setting.limits).rest();
        if !self.within_range(&rest) {
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
        (gentle && self.within_speed(&next) && self.within_range(&next.q)).then_some(next)
    }

    fn motion(&self, candidate: &Candidate) -> Motion {
        let window = &candidate.window;
        let limits = &self.setting.limits;
        let start = Ramps::start(&window[0], self.ramps, limits);
        let stop = Ramps::stop(&window[window.len() - 1], self.ramps, limits);
        Motion::around(window, &start, &stop, self.setting.period_s)
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

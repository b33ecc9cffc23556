//! Resolution, weights and limits of the form of the paper.

use std::f64::consts::{PI, TAU};

use serde::{Deserialize, Serialize};

use super::Release;
use crate::follow::limits::AXES;

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
    /// Places are up to this angle away from the azimuth of the target, in rad; π: all around.
    pub sector_rad: f64,
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
    /// How often the steps of the grid are halved around the best releases; 0: the grid alone.
    pub refinements: u32,
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
            sector_rad: PI,
            beta_deg: GridAxis { from: -30.0, to: 75.0, count: values(15.0) },
            rolls: values(24.0),
            w: [1.0; AXES],
            g: [1.0; 2],
            ramps: RampTiming::Synchronised,
            criterion: Criterion::J2,
            refinements: 0,
        }
    }

    /// Angles about A1 from the azimuth of the target. All around, the last is one step before the first.
    pub(super) fn places_rad(&self) -> (impl Iterator<Item = f64> + use<>, f64) {
        let (count, sector_rad) = (self.places, self.sector_rad.min(PI));
        let all_around = sector_rad >= PI;
        let from = if all_around { 0.0 } else { -sector_rad };
        let gaps = if all_around { count } else { count.saturating_sub(1) };
        let step = 2.0 * sector_rad / gaps.max(1) as f64;
        ((0..count).map(move |k| from + step * k as f64), step)
    }

    /// Steps of the grid.
    pub(super) fn steps(&self) -> Release {
        let step = |axis: &GridAxis| (axis.to - axis.from) / (axis.count.max(2) - 1) as f64;
        Release {
            place_rad: self.places_rad().1,
            radius_m: step(&self.radius_m),
            height_m: step(&self.height_m),
            beta_deg: step(&self.beta_deg),
            roll_rad: TAU / self.rolls as f64,
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

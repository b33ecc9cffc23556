//! Releases to start from: drawn evenly, the most promising kept.

use std::f64::consts::{PI, TAU};

use nalgebra::Vector3;
use rayon::prelude::*;
use robot_model::{Family, radical_inverse};

use super::BestOptions;
use super::excess::Excess;
use super::variables::Variables;
use crate::follow::clear::Scenes;
use crate::follow::found::{Stage, StageCounts};
use crate::follow::limits::{AXES, Axes};
use crate::follow::posture::{Reach, reach_m};
use crate::follow::setting::Setting;

/// A release with its posture.
pub(super) struct Seed {
    pub(super) x: Variables,
    pub(super) q: Axes,
    cost: f64,
}

/// Joint speeds up to this share of the limits may still be brought inside.
const SPEED_USE_MAX: f64 = 1.6;
/// Shares of the draws for arms whose postures are searched by iteration, about a thousand times as slow.
const NUMERIC_SHARE: usize = 20;
/// Points of the window by which seeds are judged.
const POINTS: usize = 3;
/// Seeds whose joints all differ by less than this are one, in rad.
const SAME_RAD: f64 = 0.25;
/// Draws that one task handles.
const CHUNK: usize = 250;

/// The best seeds, at most `count`, and how many draws were refused by what.
pub(super) fn draw(setting: &Setting<'_>, options: &BestOptions, count: usize) -> (Vec<Seed>, StageCounts) {
    let numeric = matches!(setting.arm.family(), Family::General);
    let draws = if numeric { options.draws.div_ceil(NUMERIC_SHARE) } else { options.draws };
    let chunks: Vec<_> = (0..draws).step_by(CHUNK).map(|from| from..(from + CHUNK).min(draws)).collect();
    let drawn: Vec<(Vec<Seed>, StageCounts)> =
        chunks.into_par_iter().map(|chunk| draw_some(setting, options, chunk)).collect();
    let mut counts = StageCounts::default();
    let mut seeds: Vec<Seed> = Vec::new();
    for (some, counted) in drawn {
        counts = counts.plus(&counted);
        seeds.extend(some);
    }
    seeds.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    let mut kept: Vec<Seed> = Vec::new();
    for seed in seeds {
        if kept.len() >= count {
            break;
        }
        if kept.iter().all(|k| (k.q - seed.q).amax() > SAME_RAD) {
            kept.push(seed);
        }
    }
    (kept, counts)
}

fn draw_some(
    setting: &Setting<'_>,
    options: &BestOptions,
    numbers: std::ops::Range<usize>,
) -> (Vec<Seed>, StageCounts) {
    let scenes = Scenes::new();
    let mut excess = Excess::new(setting, options.hand, &scenes);
    let (mut seeds, mut counts) = (Vec::new(), StageCounts::default());
    let reach = Reach::new(setting.arm);
    let base = base(setting);
    let reach_m = reach_m(setting.arm);
    let floor_z_m = setting.arm.world().floor_z_m;
    for number in numbers {
        let u = |base: u32| radical_inverse(number as u64 + 100 * options.seed, base);
        let (radius, place) = (reach_m * (0.15 + 0.8 * u(2)), TAU * u(3));
        let height = (base.z + reach_m * (1.6 * u(5) - 0.7)).max(floor_z_m + setting.margins.floor_m);
        let p = Vector3::new(radius * place.cos(), radius * place.sin(), height);
        let x = Variables::release(
            p,
            0.15 + 1.1 * u(7),
            PI * (2.0 * u(11) - 1.0),
            options.hand,
            excess.blend_s(),
        );
        let state = x.hand().at(&x.flight(setting), 0.0);
        let postures = reach.all(&state.x_wb);
        if postures.is_empty() {
            counts.add(Stage::Reach, 1);
        }
        for q in postures {
            let Some(posture) = reach.rates(q, &state) else {
                counts.add(Stage::Singular, 1);
                continue;
            };
            let too_fast =
                (0..AXES).any(|i| posture.qd[i].abs() > SPEED_USE_MAX * setting.limits.v_max_rad_s[i]);
            if too_fast {
                counts.add(Stage::Speed, 1);
                continue;
            }
            match excess.window_around(&x, &q, POINTS).map(|window| excess.residuals(&x, &window)) {
                Some(r) => seeds.push(Seed { x, q, cost: r.iter().map(|r| r * r).sum() }),
                None => counts.add(Stage::Reach, 1),
            }
        }
    }
    (seeds, counts)
}

/// Where the first joint is, m.
pub(super) fn base(setting: &Setting<'_>) -> Vector3<f64> {
    setting.arm.fk(&Axes::zeros(AXES)).origin(0)
}

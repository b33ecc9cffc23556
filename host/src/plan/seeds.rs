//! The stored throws that come with the program, and how they are made.
//!
//! A table over (range, height) of the target: random starts in every cell, then neighbours pass their throws on until
//! nothing improves. `cubectl plan seeds` makes it again. It is only a set of starts: the planner works without it (for
//! another robot, or another form) from random starts, only slower, and every throw is solved and checked afresh.

use std::path::Path;

use nalgebra::Vector3;
use rayon::prelude::*;

use super::problem::{Options, Problem};
use super::rng::SplitMix64;
use super::search::Planner;
use super::throw::Arm;
use crate::store::{Index, Record, file, robot_fingerprint};

/// The built-in tables, one per robot that has one.
const TABLES: [&[u8]; 1] = [include_bytes!("../../robots/powercube6.seeds")];

/// The built-in throws for a robot; empty if there are none for it (or for this version of its file).
#[must_use]
pub fn built_in(arm: &Arm) -> Index {
    let robot = robot_fingerprint(arm);
    let records = TABLES
        .iter()
        .find_map(|bytes| file::parse(Path::new("built-in seeds"), bytes, robot).ok())
        .map_or_else(Vec::new, |(records, _)| records);
    Index::new(records)
}

/// Grid of a table.
#[derive(Debug, Clone, Copy)]
pub struct Grid {
    /// Step in range and height in m.
    pub step_m: f64,
    /// Largest range in m.
    pub range_max_m: f64,
    /// Largest height in m; the lowest is the floor.
    pub height_max_m: f64,
    /// Random starts per cell and per trial.
    pub starts: u64,
    /// Distinct throws kept per cell.
    pub keep: usize,
    /// Rounds in which neighbours pass on their throws.
    pub sweeps: usize,
    /// Random targets at which the finished table is tried; where it does badly, a throw is added.
    pub trials: u64,
}

/// Makes the table of one set of options. `progress` hears the share that is done.
#[must_use]
pub fn make(
    arm: &Arm,
    options: &Options,
    grid: &Grid,
    seed: u64,
    progress: &(dyn Fn(f64) + Sync),
) -> Vec<Record> {
    let floor = arm.world().floor_z_m;
    let columns = (grid.range_max_m / grid.step_m).round() as i32;
    let rows = ((grid.height_max_m - floor) / grid.step_m).round() as i32;
    let cells: Vec<(i32, i32)> = (1..=columns).flat_map(|c| (0..=rows).map(move |r| (c, r))).collect();
    let target = |(c, r): (i32, i32)| {
        Vector3::new(f64::from(c) * grid.step_m, 0.0, floor + f64::from(r) * grid.step_m)
    };
    let passes = 2 + grid.sweeps;
    let mut table: Vec<Vec<Record>> = cells
        .par_iter()
        .enumerate()
        .map(|(i, cell)| {
            let Ok(problem) = Problem::new(arm, target(*cell), options.clone()) else { return Vec::new() };
            let planner = Planner::new(&problem);
            let mut kept = Vec::new();
            for k in 0..grid.starts {
                if let Some(found) = planner.random_start(seed, (i as u64) << 16 | k) {
                    keep(&mut kept, planner.record(&found), grid.keep);
                }
            }
            if i % 16 == 0 {
                progress(i as f64 / cells.len() as f64 / passes as f64);
            }
            kept
        })
        .collect();
    let at = |(c, r): (i32, i32)| {
        ((1..=columns).contains(&c) && (0..=rows).contains(&r)).then(|| ((c - 1) * (rows + 1) + r) as usize)
    };
    for sweep in 0..grid.sweeps {
        let before = table.clone();
        table = cells
            .par_iter()
            .enumerate()
            .map(|(i, &(c, r))| {
                let Ok(problem) = Problem::new(arm, target((c, r)), options.clone()) else {
                    return Vec::new();
                };
                let planner = Planner::new(&problem);
                let mut kept = before[i].clone();
                for (dc, dr) in [(-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (1, 1), (-1, 1), (1, -1)] {
                    let Some(neighbour) = at((c + dc, r + dr)) else { continue };
                    for record in &before[neighbour] {
                        if let Some(found) = planner.from_record(record) {
                            keep(&mut kept, planner.record(&found), grid.keep);
                        }
                    }
                }
                if i % 16 == 0 {
                    progress((1.0 + sweep as f64 + i as f64 / cells.len() as f64) / passes as f64);
                }
                kept
            })
            .collect();
    }
    let edge = edge(arm, options, &cells, &table, &target, &at);
    let records = table.into_iter().flatten().chain(edge).collect();
    let last = |share| progress((1.0 + grid.sweeps as f64 + share) / passes as f64);
    improve(arm, options, grid, seed, Index::new(records), &last)
}

/// Tries the table at random targets and adds a throw where the quick pass finds none or a dearer one than a search.
///
/// The price has cliffs (from letting the ball drop to really throwing it), where a uniform grid is too coarse.
/// `progress` hears the share that is done.
#[must_use]
pub fn improve(
    arm: &Arm,
    options: &Options,
    grid: &Grid,
    seed: u64,
    mut index: Index,
    progress: &(dyn Fn(f64) + Sync),
) -> Vec<Record> {
    let floor = arm.world().floor_z_m;
    let mut trial = 0;
    while trial < grid.trials {
        let next = (trial + TRIALS_PER_ROUND).min(grid.trials);
        let found: Vec<Record> = (trial..next)
            .into_par_iter()
            .filter_map(|k| {
                let mut rng = SplitMix64::stream(seed ^ 0x7472_6961_6C73, k);
                let range_m = grid.range_max_m * rng.unit();
                let height_m = floor + (grid.height_max_m - floor) * rng.unit();
                let problem =
                    Problem::new(arm, Vector3::new(range_m, 0.0, height_m), options.clone()).ok()?;
                let planner = Planner::new(&problem);
                let quick = planner.from_index_quickly(&index, TRIAL_TRIES);
                let patient = planner.from_index(&index, 2 * TRIAL_TRIES)?;
                let random = (0..grid.starts).filter_map(|s| planner.random_start(seed ^ k << 16, s));
                let best = random.chain([patient]).min_by(|a, b| a.objective.total_cmp(&b.objective))?;
                let good = quick.is_some_and(|q| q.objective <= TRIAL_GAP * best.objective);
                (!good).then(|| planner.record(&best))
            })
            .collect();
        for record in found {
            index.insert(record);
        }
        trial = next;
        progress(trial as f64 / grid.trials as f64);
    }
    index.records().to_vec()
}

/// See [`improve`]: targets between two updates of the table, stored throws per target, and the share of the price that
/// is not worth another throw.
const TRIALS_PER_ROUND: u64 = 128;
const TRIAL_TRIES: usize = 3;
const TRIAL_GAP: f64 = 1.005;

/// Throws on the edge of the reach: cells beyond it are pulled in from their neighbours' throws until they are reached.
///
/// Without them a target between the last cell in reach and the edge has starts on one side only.
fn edge(
    arm: &Arm,
    options: &Options,
    cells: &[(i32, i32)],
    table: &[Vec<Record>],
    target: &(dyn Fn((i32, i32)) -> Vector3<f64> + Sync),
    at: &(dyn Fn((i32, i32)) -> Option<usize> + Sync),
) -> Vec<Record> {
    cells
        .par_iter()
        .zip(table)
        .filter(|(_, own)| own.is_empty())
        .filter_map(|(&(c, r), _)| {
            let problem = Problem::new(arm, target((c, r)), options.clone()).ok()?;
            let planner = Planner::new(&problem);
            let steps = [(-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (1, 1), (-1, 1), (1, -1)];
            let starts = steps.into_iter().filter_map(|(dc, dr)| table.get(at((c + dc, r + dr))?)?.first());
            let nearest = starts
                .filter_map(|record| planner.nearest_from_throw(&record.throw, [true, false, true]))
                .min_by(|a, b| a.shift_m.norm().total_cmp(&b.shift_m.norm()))?;
            // A hair inside, where the price has a slope.
            let inside = problem.target() + nearest.shift_m * (1.0 + 2e-3 / nearest.shift_m.norm().max(1e-6));
            let problem = Problem::new(arm, inside, options.clone()).ok()?;
            let planner = Planner::new(&problem);
            Some(planner.record(&planner.from_throw(&nearest.throw)?))
        })
        .collect()
}

/// See [`keep`].
const DEARER: f64 = 1.06;

/// Keeps the best few throws that differ by more than rounding.
fn keep(kept: &mut Vec<Record>, new: Record, most: usize) {
    // Much dearer ones will not be the best in the neighbouring cell either.
    if kept.first().is_some_and(|best| new.objective > DEARER * best.objective) {
        return;
    }
    // Mirror images and wrist twins have the same price; one of them is enough.
    if let Some(same) = kept.iter_mut().find(|k| (k.objective - new.objective).abs() < 1e-3 * new.objective) {
        if new.objective < same.objective - 1e-6 {
            *same = new;
        }
    } else {
        kept.push(new);
    }
    kept.sort_by(|a, b| a.objective.total_cmp(&b.objective));
    kept.truncate(most);
}

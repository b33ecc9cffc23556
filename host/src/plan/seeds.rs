//! The stored throws that come with the program, and how they are made.
//!
//! A table over (range, height) of the target: random starts in every cell, then neighbours pass their throws on until
//! nothing improves. `cubectl plan seeds` makes it again. It is only a set of starts: the planner works without it (for
//! another robot, or another form) from random starts, only slower, and every throw is solved and checked afresh.

use std::path::Path;

use nalgebra::Vector3;
use rayon::prelude::*;

use super::problem::{Options, Problem};
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
    /// Random starts per cell.
    pub starts: u64,
    /// Distinct throws kept per cell.
    pub keep: usize,
    /// Rounds in which neighbours pass on their throws.
    pub sweeps: usize,
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
    let passes = 1 + grid.sweeps;
    let mut table: Vec<Vec<Record>> = cells
        .par_iter()
        .enumerate()
        .map(|(i, cell)| {
            let Ok(problem) = Problem::new(arm, target(*cell), options.clone()) else { return Vec::new() };
            let planner = Planner::new(&problem);
            let mut kept = Vec::new();
            for k in 0..grid.starts {
                if let Some(found) = planner.random_start(seed, (i as u64) << 16 | k) {
                    keep(&mut kept, planner.record(&found.throw, found.objective), grid.keep);
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
                        if let Some(found) = planner.from_throw(&record.throw) {
                            keep(&mut kept, planner.record(&found.throw, found.objective), grid.keep);
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
    table.into_iter().flatten().collect()
}

/// Keeps the best few throws that differ by more than rounding.
fn keep(kept: &mut Vec<Record>, new: Record, most: usize) {
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

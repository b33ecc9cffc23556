//! Makes the table of stored throws of a robot: over range and height of the target, for several sets of options.
//!
//! For every set of options: random starts in every cell of a grid, neighbours pass their throws on, every throw is
//! finished, throws are carried to cells beyond the edge, and random targets (any azimuth) show where the table
//! needs more. Such a target often adds a throw in a local optimum that a whole region lacks. So neighbours pass
//! throws on after every few targets too. The work is cut into steps. A step depends only on the records so far and
//! its number, so a preparation can be stopped between any two steps and continued later: the table is the same.

use robot_model::RobotModel;
use std::f64::consts::PI;

use nalgebra::Vector3;

use super::problem::{Options, Problem};
use super::rng::SplitMix64;
use super::search::{Budget, Planner, Watch, kind_of};
use crate::parallel::each;
use crate::store::{Index, Record};

/// Grid of a table and effort for it.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Grid {
    /// Step in range and height in m.
    pub step_m: f64,
    /// Largest range in m; the grid ends before it where nothing is in reach.
    pub range_max_m: f64,
    /// Largest height in m; the lowest is the floor.
    pub height_max_m: f64,
    /// Random starts per cell and per trial.
    pub starts: u64,
    /// Distinct throws kept per cell.
    pub keep: usize,
    /// Rounds in which neighbours pass on their throws.
    pub sweeps: usize,
    /// Random targets at which the table is tried; where it does badly, a throw is added.
    pub trials: u64,
}

/// A preparation: what is prepared, and its steps.
#[derive(Debug, Clone)]
pub struct Preparation<'a> {
    arm: &'a RobotModel,
    options: Vec<Options>,
    grid: Grid,
    seed: u64,
}

/// What a step does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Work {
    /// Random starts in some columns of the grid.
    Starts(usize),
    /// Neighbours pass on their throws.
    Sweep,
    /// Every throw is solved to its end.
    Finish,
    /// Cells beyond the edge are pulled in.
    Edge,
    /// Random targets.
    Trials(u64),
}

/// Columns of the grid per step of random starts.
const COLUMNS: usize = 4;
/// Targets between two updates of the table.
const TRIALS_PER_STEP: u64 = 128;
/// Updates of the table between two sweeps.
const ROUNDS_PER_SWEEP: u64 = 4;
/// A throw is passed on over this many steps of the grid, and at most this many throws to a cell.
const PASSED_STEPS: f64 = 1.5;
const PASSED_MAX: usize = 16;
/// Stored throws per trial, and the share of the price that is not worth another throw.
const TRIAL_TRIES: usize = 6;
const TRIAL_GAP: f64 = 1.003;
/// A throw this much dearer than the best of its cell is not kept: it will not be the best in the neighbouring cell.
const DEARER: f64 = 1.06;
const NEIGHBOURS: [(i32, i32); 8] = [(-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (1, 1), (-1, 1), (1, -1)];

impl<'a> Preparation<'a> {
    /// For an arm and the sets of options in the order in which they are prepared. Later sets start from the throws of
    /// earlier ones too, so the easiest set comes first.
    #[must_use]
    pub fn new(arm: &'a RobotModel, options: Vec<Options>, grid: Grid, seed: u64) -> Self {
        Self { arm, options, grid, seed }
    }

    fn work(&self) -> Vec<Work> {
        let columns = self.columns() as usize;
        let mut work: Vec<Work> = (0..columns.div_ceil(COLUMNS)).map(Work::Starts).collect();
        work.extend(std::iter::repeat_n(Work::Sweep, self.grid.sweeps));
        work.extend([Work::Finish, Work::Edge]);
        let rounds = self.grid.trials.div_ceil(TRIALS_PER_STEP);
        for round in 0..rounds {
            work.push(Work::Trials(round));
            if round % ROUNDS_PER_SWEEP == ROUNDS_PER_SWEEP - 1 || round == rounds - 1 {
                work.push(Work::Sweep);
            }
        }
        work.push(Work::Finish);
        work
    }

    /// Number of steps.
    #[must_use]
    pub fn steps(&self) -> usize {
        self.options.len() * self.work().len()
    }

    /// Does step number `step` on the records so far. `stopped` ends it early; `None` then.
    #[must_use]
    pub fn step(
        &self,
        step: usize,
        records: Vec<Record>,
        stopped: &(dyn Fn() -> bool + Sync),
    ) -> Option<Vec<Record>> {
        let work = self.work();
        let (Some(options), Some(what)) = (self.options.get(step / work.len()), work.get(step % work.len()))
        else {
            return Some(records);
        };
        let kind = kind_of(options);
        let (own, others): (Vec<Record>, Vec<Record>) = records.into_iter().partition(|r| r.kind == kind);
        let task = Step { prepared: self, options, others: &others, stopped };
        let made = match *what {
            Work::Starts(chunk) => task.starts(chunk, own),
            Work::Sweep => task.sweep(&own),
            Work::Finish => task.finish(&own),
            Work::Edge => task.edge(own),
            Work::Trials(round) => task.trials(round, own),
        };
        // Rounded as in a file, so that a continued preparation sees the same numbers.
        let rounded = made.iter().filter_map(|r| Record::from_bytes(r.throw.joints(), &r.to_bytes()));
        let all: Vec<Record> = others.iter().copied().chain(rounded).collect();
        (!stopped()).then_some(all)
    }

    fn columns(&self) -> i32 {
        (self.grid.range_max_m / self.grid.step_m).round() as i32
    }

    fn rows(&self) -> i32 {
        ((self.grid.height_max_m - self.arm.world().floor_z_m) / self.grid.step_m).round() as i32
    }

    fn target(&self, (column, row): (i32, i32)) -> Vector3<f64> {
        let (step, floor) = (self.grid.step_m, self.arm.world().floor_z_m);
        Vector3::new(f64::from(column) * step, 0.0, floor + f64::from(row) * step)
    }

    /// The cell whose target a record is for, if it is for one.
    fn cell_of(&self, record: &Record) -> Option<(i32, i32)> {
        let (step, floor) = (self.grid.step_m, self.arm.world().floor_z_m);
        let (column, row) = (record.range_m / step, (record.height_m - floor) / step);
        let on = |x: f64| (x - x.round()).abs() < 1e-4;
        (on(column) && on(row)).then(|| (column.round() as i32, row.round() as i32))
    }
}

/// One step on the records of one set of options.
struct Step<'t, 'a> {
    prepared: &'t Preparation<'a>,
    options: &'t Options,
    others: &'t [Record],
    stopped: &'t (dyn Fn() -> bool + Sync),
}

impl Step<'_, '_> {
    fn problem(&self, target: Vector3<f64>) -> Option<Problem<'_>> {
        if (self.stopped)() {
            return None;
        }
        Problem::new(self.prepared.arm, target, self.options.clone()).ok()
    }

    fn by_cell(&self, records: &[Record]) -> std::collections::BTreeMap<(i32, i32), Vec<Record>> {
        let mut cells = std::collections::BTreeMap::<_, Vec<Record>>::new();
        for record in records {
            if let Some(cell) = self.prepared.cell_of(record) {
                cells.entry(cell).or_default().push(*record);
            }
        }
        cells
    }

    fn cells(&self, columns: std::ops::RangeInclusive<i32>) -> Vec<(i32, i32)> {
        columns.flat_map(|c| (0..=self.prepared.rows()).map(move |r| (c, r))).collect()
    }

    fn starts(&self, chunk: usize, own: Vec<Record>) -> Vec<Record> {
        let p = self.prepared;
        let first = 1 + (chunk * COLUMNS) as i32;
        // There is no cell beyond the last column with a throw.
        let reached = |r: &Record| r.range_m > (f64::from(first) - 1.5 - COLUMNS as f64) * p.grid.step_m;
        if chunk > 0 && !own.is_empty() && !own.iter().any(reached) {
            return own;
        }
        let others = self.by_cell(self.others);
        let cells = self.cells(first..=p.columns().min(first + COLUMNS as i32 - 1));
        let made = each(&cells, |cell| {
            let mut kept = Vec::new();
            let Some(problem) = self.problem(p.target(*cell)) else { return kept };
            let planner = Planner::new(&problem).persistent();
            let stream = (cell.0 as u64) << 32 | (cell.1 as u64) << 16;
            let random = (0..p.grid.starts).map(|k| planner.random_start(p.seed, stream | k));
            let carried = others.get(cell).into_iter().flatten().map(|r| planner.from_throw(&r.throw));
            for found in random.chain(carried).flatten() {
                keep(&mut kept, planner.record(&found), p.grid.keep);
                if (self.stopped)() {
                    break;
                }
            }
            kept
        });
        own.into_iter().chain(made.into_iter().flatten()).collect()
    }

    fn sweep(&self, own: &[Record]) -> Vec<Record> {
        let p = self.prepared;
        let before = self.by_cell(own);
        let farthest = before.keys().map(|c| c.0).max().unwrap_or(0);
        let made = each(&self.cells(1..=(farthest + 1).min(p.columns())), |cell| {
            let mut kept = before.get(cell).cloned().unwrap_or_default();
            let at = p.target(*cell);
            let Some(problem) = self.problem(at) else { return kept };
            let planner = Planner::new(&problem).persistent();
            for record in around(own, at.x, at.z, PASSED_STEPS * p.grid.step_m) {
                // Where nothing is known yet, also the long way from the neighbour's throw.
                let anew = || kept.is_empty().then(|| planner.from_throw(&record.throw)).flatten();
                if let Some(found) = planner.from_record(record).or_else(anew) {
                    keep(&mut kept, planner.record(&found), p.grid.keep);
                }
            }
            kept
        });
        let rest = own.iter().copied().filter(|r| p.cell_of(r).is_none());
        made.into_iter().flatten().chain(rest).collect()
    }

    fn finish(&self, own: &[Record]) -> Vec<Record> {
        each(own, |record| {
            let Some(problem) = self.problem(Vector3::new(record.range_m, 0.0, record.height_m)) else {
                return *record;
            };
            let planner = Planner::new(&problem).persistent();
            match planner.finished(&record.throw) {
                Some(found) if found.objective < record.objective => planner.record(&found),
                _ => *record,
            }
        })
    }

    /// Throws on the edge of the reach: neighbours' throws are carried to cells beyond it until they are reached.
    /// Without them a target between the last cell in reach and the edge has starts on one side only.
    fn edge(&self, own: Vec<Record>) -> Vec<Record> {
        let p = self.prepared;
        let table = self.by_cell(&own);
        let farthest = table.keys().map(|c| c.0).max().unwrap_or(0);
        let empty: Vec<_> = self
            .cells(1..=(farthest + 1).min(p.columns()))
            .into_iter()
            .filter(|c| !table.contains_key(c))
            .collect();
        let edge = each(&empty, |&(c, r)| {
            let problem = self.problem(p.target((c, r)))?;
            let planner = Planner::new(&problem).persistent();
            let starts = NEIGHBOURS.iter().filter_map(|(dc, dr)| table.get(&(c + dc, r + dr))?.first());
            let nearest = starts
                .filter_map(|record| planner.nearest_from_throw(&record.throw, [true, false, true]))
                .min_by(|a, b| a.shift_m.norm().total_cmp(&b.shift_m.norm()))?;
            // A hair inside, where the price has a slope.
            let inside = problem.target() + nearest.shift_m * (1.0 + 2e-3 / nearest.shift_m.norm().max(1e-6));
            let problem = self.problem(inside)?;
            let planner = Planner::new(&problem).persistent();
            Some(planner.record(&planner.from_throw(&nearest.throw)?))
        });
        own.into_iter().chain(edge.into_iter().flatten()).collect()
    }

    /// Tries the table at random targets and adds a throw where the quick pass finds none or a dearer one than a search.
    ///
    /// The price has cliffs (between a ball that is dropped and one that is thrown), where a uniform grid is too
    /// coarse, and behind the arm joint 1 ends.
    fn trials(&self, round: u64, own: Vec<Record>) -> Vec<Record> {
        let p = self.prepared;
        let floor = p.arm.world().floor_z_m;
        let farthest = own.iter().map(|r| r.range_m).fold(0.0, f64::max);
        let index = Index::new(own);
        let trials: Vec<u64> =
            (round * TRIALS_PER_STEP..((round + 1) * TRIALS_PER_STEP).min(p.grid.trials)).collect();
        let added = each(&trials, |&k| {
            let mut rng = SplitMix64::stream(p.seed ^ 0x7472_6961_6C73, k);
            let range_m = farthest * rng.unit();
            let height_m = floor + (p.grid.height_max_m - floor) * rng.unit();
            let azimuth_rad = PI * (2.0 * rng.unit() - 1.0);
            let (sin, cos) = azimuth_rad.sin_cos();
            let problem = self.problem(Vector3::new(range_m * cos, range_m * sin, height_m))?;
            let planner = Planner::new(&problem).persistent();
            let quick = planner.from_index_quickly(&index, TRIAL_TRIES);
            let budget = Budget { starts: p.grid.starts as usize, all: false, time: None, seed: p.seed ^ k };
            let best = planner.attempt(&index, &budget, &Watch::default()).ok()?.found;
            let good = quick.is_some_and(|q| q.objective <= TRIAL_GAP * best.objective);
            (!good).then(|| planner.record(&best))
        });
        index.records().iter().copied().chain(added.into_iter().flatten()).collect()
    }
}

/// Throws for targets within a distance of one in m, but not for that one; those that promise the lowest price there first.
fn around(records: &[Record], range_m: f64, height_m: f64, within_m: f64) -> Vec<&Record> {
    let away = |r: &Record| (range_m - r.range_m).hypot(height_m - r.height_m);
    let promised = |r: &Record| {
        r.objective + r.slope_per_m[0] * (range_m - r.range_m) + r.slope_per_m[1] * (height_m - r.height_m)
    };
    let mut near: Vec<&Record> = records.iter().filter(|r| (1e-4..=within_m).contains(&away(r))).collect();
    near.sort_by(|a, b| promised(a).total_cmp(&promised(b)));
    near.truncate(PASSED_MAX);
    near
}

/// Keeps the best few throws that differ by more than rounding.
fn keep(kept: &mut Vec<Record>, new: Record, most: usize) {
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

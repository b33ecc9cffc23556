//! The shards of `cubectl plan sweep`: throws to many targets as CSV part files.
//!
//! A row is what `plan throw` with the same words finds for its target. It follows from the study and the row alone, so a part has
//! the same bytes whoever makes it.

use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use serde_json::json;

use super::grid::Grid;
use super::options::Starts;
use super::search::{Draws, Landings, NOT_FAST, Progress, SearchOptions, Solved, Watcher, watched_with};
use crate::error::ExpectedError;
use crate::exit;
use crate::report::reach::{self, Cell};
use crate::tables::folder::{Folder, Study};
use crate::tables::shard::Shard;
use crate::tables::summary::Summary;
use crate::tables::targets::{Rows, TargetList, TargetRow};
use planner::parallel::try_each;
use planner::plan::Watch;
use planner::plan::file::PlanFile;
use planner::plan::rng::SplitMix64;
use planner::store::robot_fingerprint;
use robot_model::RobotModel;

/// Version of the columns and of the file format. A part of another version belongs to another sweep and is refused.
const FORMAT: &str = "2";
/// Most targets of a picture.
const PICTURE_MAX: u64 = 100_000;
/// Most disturbed throws per target.
pub(super) const DRAWS_MAX: usize = 1_000_000;

#[derive(Debug, Clone)]
pub(super) enum Targets {
    Grid(Grid),
    List(Box<TargetList>),
}

impl Targets {
    pub(super) fn count(&self) -> u64 {
        match self {
            Self::Grid(grid) => grid.count(),
            Self::List(list) => list.count(),
        }
    }

    fn in_words(&self) -> String {
        match self {
            Self::Grid(grid) => format!("{grid:?}"),
            Self::List(list) => format!("list with CRC-32 {:08x}", list.crc32()),
        }
    }

    fn rows_from(&self, from: u64) -> Result<Rows, ExpectedError> {
        match self {
            Self::Grid(grid) => {
                let grid = *grid;
                Ok(Box::new((from..grid.count()).map(move |row| Ok(TargetRow::point(grid.target(row))))))
            }
            Self::List(list) => list.rows_from(from),
        }
    }
}

#[derive(Debug)]
pub(super) struct Sweep<'a> {
    pub(super) arm: &'a RobotModel,
    pub(super) search: &'a SearchOptions,
    pub(super) seed: u64,
    pub(super) fast: bool,
    pub(super) draws: usize,
    pub(super) targets: Targets,
}

/// What came of the shards.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Made {
    /// Shards that were made now.
    pub made: u32,
    /// Shards that were there.
    pub there: u32,
}

impl Sweep<'_> {
    /// Makes those of the shards that are not there yet.
    ///
    /// # Errors
    /// Options are refused, the folder has another sweep, a file cannot be read or written, or it was stopped.
    pub(super) fn make(
        &self,
        out: &Path,
        shards: &[Shard],
        watcher: Watcher<'_>,
    ) -> Result<Made, ExpectedError> {
        self.refuse_what_depends_on_the_moment()?;
        self.search.require_sound()?;
        let count = shards.first().map_or(1, Shard::count);
        let starts = self.search.options.starts(self.arm);
        let study = self.study(count, &starts)?;
        let folder = Folder::for_study(out, study)?;
        let mut made = Made::default();
        let mut missing = Vec::new();
        for shard in shards {
            if folder.has(*shard)? {
                made.there += 1;
            } else {
                missing.push(*shard);
            }
        }
        let rows: u64 =
            missing.iter().map(|shard| shard.rows(self.targets.count())).map(|r| r.end - r.start).sum();
        watched(rows, watcher, |watch, done| {
            let mut source = None;
            for shard in missing {
                // Another process may have made it since.
                if folder.has(shard)? {
                    made.there += 1;
                } else if self.make_one(&folder, shard, &mut source, &starts, watch, done)? {
                    made.made += 1;
                } else {
                    return Err(ExpectedError::new(
                        exit::INTERRUPTED,
                        format!(
                            "stopped; {} of {} shards are in {}",
                            made.made + made.there,
                            shards.len(),
                            out.display()
                        ),
                    )
                    .next("run the same command again, it continues there"));
                }
            }
            Ok(made)
        })
    }

    /// Refuses a bound by the clock: how long a search takes differs between machines, and parts must not.
    fn refuse_what_depends_on_the_moment(&self) -> Result<(), ExpectedError> {
        if self.search.time_budget_s.is_none() {
            return Ok(());
        }
        Err(ExpectedError::bad_input(
            &"--time-budget-s does not go with a sweep: how long a search takes differs between machines, \
                     and parts must not depend on that",
        )
        .next("leave --time-budget-s out; --starts bounds a search"))
    }

    /// Everything that the rows follow from, by name.
    fn study(&self, shards: u32, starts: &Starts) -> Result<Study, ExpectedError> {
        let mut crc = crc32fast::Hasher::new();
        starts.index.records().iter().for_each(|record| crc.update(&record.to_bytes()));
        let words = [
            ("format", FORMAT.to_owned()),
            ("program", env!("CARGO_PKG_VERSION").to_owned()),
            ("robot", format!("{} {:016x}", self.arm.name(), robot_fingerprint(self.arm))),
            ("robot file", self.search.options.robot.clone()),
            ("options", self.search.in_words()?),
            ("seed", self.seed.to_string()),
            ("fast", self.fast.to_string()),
            ("draws", self.draws.to_string()),
            ("target list", self.targets.in_words()),
            ("stored throws", format!("{}, CRC-32 {:08x}", starts.sources.join(", "), crc.finalize())),
        ];
        let words = words.into_iter().map(|(name, word)| (name.to_owned(), word)).collect();
        Ok(Study::new(words, self.targets.count(), shards))
    }

    /// Makes a shard; `false` if it was stopped. `source` has the targets behind those of the shard before: a list is not read from its
    /// begin again.
    fn make_one(
        &self,
        folder: &Folder,
        shard: Shard,
        source: &mut Option<(u64, Rows)>,
        starts: &Starts,
        watch: &Watch,
        done: &AtomicU64,
    ) -> Result<bool, ExpectedError> {
        let own = shard.rows(self.targets.count());
        let mut targets = match source.take() {
            Some((next, targets)) if next == own.start => targets,
            _ => self.targets.rows_from(own.start)?,
        };
        let stopped = || watch.stop.load(Ordering::Relaxed);
        let made = folder.make(shard, &columns(self.arm.n()), |rows| {
            let batch: Vec<(u64, TargetRow)> = rows
                .clone()
                .zip(targets.by_ref())
                .map(|(number, target)| Ok((number, target?)))
                .collect::<Result<_, ExpectedError>>()?;
            if batch.len() as u64 != rows.end - rows.start {
                return Err(ExpectedError::bad_input("the list of targets has changed while it was read"));
            }
            let made: Result<Vec<Option<Vec<String>>>, ExpectedError> =
                try_each(&batch, |(number, target)| {
                    if stopped() {
                        return Ok(None);
                    }
                    let row = self.row(*number, target, starts, watch)?;
                    done.fetch_add(1, Ordering::Relaxed);
                    Ok(Some(row))
                });
            let made: Option<Vec<Vec<String>>> = made?.into_iter().collect();
            // A search that was stopped has found less than it would have.
            Ok(made.filter(|_| !stopped()))
        });
        *source = Some((own.end, targets));
        made
    }

    fn row(
        &self,
        number: u64,
        target: &TargetRow,
        starts: &Starts,
        watch: &Watch,
    ) -> Result<Vec<String>, ExpectedError> {
        let draws = (self.draws > 0)
            .then(|| Draws { count: self.draws, seed: SplitMix64::stream(self.seed, number).next_u64() });
        let own = self.search.with_target(target);
        let solved = own.solve(
            self.arm,
            starts,
            target.target_m,
            (self.seed, self.fast),
            Watcher::Caller(watch),
            draws,
        );
        let head = [number as f64].into_iter().chain(target.target_m).map(|value| value.to_string());
        let (outcome, numbers, note) = match solved {
            Ok(Solved { plan, note, searched, landings, .. }) => {
                let outcome = if note.is_some() { "relaxed" } else { "thrown" };
                let notes = note.into_iter().chain(searched.then_some(NOT_FAST)).collect::<Vec<_>>();
                (outcome, of_plan(&plan, landings), notes.join("; "))
            }
            Err(e) if [exit::NO_THROW, exit::BAD_INPUT].contains(&e.code) => {
                ("refused", none(self.arm.n()), e.what)
            }
            // A search that was stopped; the row is dropped.
            Err(e) if e.code == exit::INTERRUPTED => ("refused", none(self.arm.n()), "stopped".to_owned()),
            Err(e) => return Err(e),
        };
        Ok(head.chain([outcome.to_owned()]).chain(numbers).chain([note]).collect())
    }
}

/// Names of the columns for an arm of `joints` joints: number and target, outcome, those of [`of_plan`], note.
fn columns(joints: usize) -> Vec<String> {
    let list = |names: &str| names.split(' ').map(str::to_owned).collect::<Vec<_>>();
    let joint = |name: &str, unit: &str| (1..=joints).map(|j| format!("release_{name}{j}_{unit}")).collect();
    [
        list("row x_m y_m z_m outcome"),
        list("objective release_s duration_s flight_s speed_m_s spread_m hit_probability"),
        list("release_x_m release_y_m release_z_m release_vx_m_s release_vy_m_s release_vz_m_s"),
        joint("q", "rad"),
        joint("qd", "rad_s"),
        joint("qdd", "rad_s2"),
        list("plan_crc32 draws_landed draws_hit draws_miss_rms_m draws_miss_max_m note"),
    ]
    .concat()
}

/// The columns of a plan where there is none.
fn none(joints: usize) -> Vec<String> {
    vec![String::new(); columns(joints).len() - 6]
}

fn of_plan(plan: &PlanFile, landings: Option<Landings>) -> Vec<String> {
    let (release, landing) = (&plan.release, &plan.landing);
    let [[xx, _], [_, yy]] = landing.covariance_m2;
    let speed_m_s = release.velocity_m_s.iter().map(|v| v * v).sum::<f64>().sqrt();
    let text = plan.to_json() + "\n";
    let some = |value: f64| Some(value);
    let first = [plan.objective.value, plan.release_time_s, plan.end_time_s, landing.flight_s, speed_m_s];
    let joints = release.q_rad.iter().chain(&release.qd_rad_s).chain(&release.qdd_rad_s2);
    let count = |count: u64| count as f64;
    let numbers = first
        .map(some)
        .into_iter()
        .chain([Some((xx + yy).sqrt()), landing.hit_probability])
        .chain(release.position_m.map(some))
        .chain(release.velocity_m_s.map(some))
        .chain(joints.map(|value| Some(*value)))
        .chain([
            Some(f64::from(crc32fast::hash(text.as_bytes()))),
            landings.map(|l| count(l.landed)),
            landings.and_then(|l| l.hits).map(count),
            landings.and_then(|l| l.miss_rms_m),
            landings.and_then(|l| l.miss_max_m),
        ]);
    numbers.map(|value| value.map_or_else(String::new, |value| value.to_string())).collect()
}

/// Runs the sweep with a watch that the watcher stops; on a terminal a progress bar appears after a second.
fn watched<T: Send>(rows: u64, watcher: Watcher<'_>, work: impl FnOnce(&Watch, &AtomicU64) -> T + Send) -> T {
    let (own, done) = (Watch::default(), AtomicU64::new(0));
    let watch = if let Watcher::Caller(watch) = watcher { watch } else { &own };
    let progress = Progress {
        total: rows,
        template: "{bar:30} {pos}/{len} targets, {elapsed}, {eta} left",
        show: &|bar| bar.set_position(done.load(Ordering::Relaxed)),
    };
    watched_with(watch, &progress, watcher, || work(watch, &done))
}

pub(super) fn summary(folder: &Path) -> Result<(Summary, serde_json::Value), ExpectedError> {
    let folder = Folder::open(folder)?;
    let s = Summary::of(&folder)?;
    let [least, mean, most] = s.objective.map_or([None; 3], |values| values.map(Some));
    let reported = json!({
        "targets": s.targets,
        "shards": s.shards,
        "missing_shards": s.missing,
        "thrown": s.thrown,
        "relaxed": s.relaxed,
        "refused": s.refused,
        "objective": { "least": least, "mean": mean, "most": most },
        "draws_landed": s.landed,
        "draws_hit": s.hits,
        "draws_miss_rms_m": s.miss_rms_m,
        "crc32": format!("{:08x}", s.crc32),
    });
    Ok((s, reported))
}

/// Page with the reach, from the parts that are there.
///
/// # Errors
/// There is no sweep, a part cannot be read, or there are too many targets.
pub(super) fn picture(folder: &Path) -> Result<String, ExpectedError> {
    let folder = Folder::open(folder)?;
    let targets = folder.study().targets();
    if targets > PICTURE_MAX {
        return Err(ExpectedError::bad_input(&format!(
            "--picture: {targets} targets; a picture has at most {PICTURE_MAX}"
        ))
        .next("plan a coarser grid, or draw the CSV parts with another program"));
    }
    let mut cells = Vec::new();
    for shard in Shard::all(folder.study().shards()) {
        if folder.has(shard)? {
            let read = folder.read(shard, |column| {
                let number = |name| column(name).parse().ok();
                let target = ["x_m", "y_m", "z_m"].map(|name| number(name).unwrap_or_default());
                cells.push(Cell { target, objective: number("objective") });
            });
            read?;
        }
    }
    Ok(reach::html(&cells, folder.study().word("robot")))
}

pub(super) fn summary_in_words(s: &Summary, folder: &Path) -> String {
    let rows = s.thrown + s.relaxed + s.refused;
    let mut text = format!(
        "{} of {} shards in {}, {rows} of {} targets\n{} throws with all that was asked for, {} without some of it, {} refused\n",
        s.shards - s.missing.len() as u32,
        s.shards,
        folder.display(),
        s.targets,
        s.thrown,
        s.relaxed,
        s.refused
    );
    if let Some([least, mean, most]) = s.objective {
        text += &format!("objective {least:.4} to {most:.4}, mean {mean:.4}\n");
    }
    if let Some(landed) = s.landed {
        let hits = s.hits.map_or_else(String::new, |hits| format!(", {hits} hits"));
        let miss =
            s.miss_rms_m.map_or_else(String::new, |m| format!(", root mean square miss {:.2} mm", m * 1e3));
        text += &format!("{landed} disturbed throws landed{hits}{miss}\n");
    }
    text += &format!("CRC-32 of the parts in order: {:08x}\n", s.crc32);
    if !s.missing.is_empty() {
        let first: Vec<String> = s.missing.iter().take(20).map(u32::to_string).collect();
        let more = if s.missing.len() > first.len() { ", ..." } else { "" };
        text += &format!(
            "missing shards: {}{more}\n  next: run the command of the sweep again, it makes those\n",
            first.join(", ")
        );
    }
    text
}

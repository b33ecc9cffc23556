//! `cubectl plan sweep --shard I/N`: the throws to many targets as Parquet part files, on one machine or on many.
//!
//! A row is what `plan throw` with the same words finds for its target. It follows from the study and the row alone, so a part has
//! the same bytes whoever makes it.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use serde_json::json;

use super::grid::Grid;
use super::options::Starts;
use super::search::{Draws, Progress, SearchOptions, Solved, Watcher, watched_with};
use crate::error::ExpectedError;
use crate::exit;
use planner::parallel::try_each;
use planner::plan::Watch;
use planner::plan::rng::SplitMix64;
use planner::request::Plans;
use planner::store::robot_fingerprint;
use robot_model::RobotModel;
use throw_tables::{Folder, Outcome, Row, Shard, Study, Summary, TableError, TargetList, TargetRow, Thrown};

/// Version of the columns and of the file format. A part of another version belongs to another sweep and is refused.
const FORMAT: &str = "1";
/// Most disturbed throws per target.
pub(super) const DRAWS_MAX: usize = 1_000_000;

/// The targets of a sweep.
#[derive(Debug, Clone)]
pub(super) enum Targets {
    Grid(Grid),
    List(Box<TargetList>),
}

impl Targets {
    fn count(&self) -> u64 {
        match self {
            Self::Grid(grid) => grid.count(),
            Self::List(list) => list.len(),
        }
    }

    fn in_words(&self) -> String {
        match self {
            Self::Grid(grid) => format!("{grid:?}"),
            Self::List(list) => format!("list with CRC-32 {:08x}", list.crc32()),
        }
    }

    /// The targets from row `from` on.
    fn rows_from(&self, from: u64) -> Result<throw_tables::targets::Rows, TableError> {
        match self {
            Self::Grid(grid) => {
                let grid = *grid;
                Ok(Box::new((from..grid.count()).map(move |row| Ok(TargetRow::point(grid.target(row))))))
            }
            Self::List(list) => list.rows_from(from),
        }
    }
}

/// A sweep.
#[derive(Debug)]
pub(super) struct Sweep<'a, const N: usize> {
    pub(super) arm: &'a RobotModel<N>,
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

/// As an error of the program.
pub(super) fn table_error(error: TableError) -> ExpectedError {
    match error {
        TableError::Refused(what) => ExpectedError::bad_input(&what),
        TableError::Read { path, source } => ExpectedError::io(&path, &source),
        TableError::Write { path, source } => ExpectedError::output(&path, &source),
    }
}

impl<const N: usize> Sweep<'_, N>
where
    RobotModel<N>: Plans<N>,
{
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
        let starts = self.search.options.starts(self.arm)?;
        let study = self.study(count, &starts)?;
        let folder = Folder::for_study(out, study).map_err(table_error)?;
        let mut made = Made::default();
        let mut missing = Vec::new();
        for shard in shards {
            if folder.has(*shard).map_err(table_error)? {
                made.there += 1;
            } else {
                missing.push(*shard);
            }
        }
        let rows: u64 =
            missing.iter().map(|shard| shard.rows(self.targets.count())).map(|r| r.end - r.start).sum();
        watched(rows, watcher, |watch, done| {
            for shard in missing {
                // Another process may have made it since.
                if folder.has(shard).map_err(table_error)? {
                    made.there += 1;
                } else if self.make_one(&folder, shard, &starts, watch, done)? {
                    made.made += 1;
                } else {
                    return Err(ExpectedError::new(
                        exit::INTERRUPTED,
                        format!(
                            "stopped; {} of {} shards are in {}\n  next: run the same command again, it continues there",
                            made.made + made.there,
                            shards.len(),
                            out.display()
                        ),
                    ));
                }
            }
            Ok(made)
        })
    }

    fn refuse_what_depends_on_the_moment(&self) -> Result<(), ExpectedError> {
        let given = [
            (
                self.search.time_budget.is_some(),
                "--time-budget",
                "how long a search takes differs between machines",
            ),
            (self.search.options.store.is_some(), "--store", "a store grows while the sweep runs"),
        ];
        match given.into_iter().find(|(given, ..)| *given) {
            None => Ok(()),
            Some((_, option, why)) => Err(ExpectedError::bad_input(&format!(
                "{option} does not go with --shard and --shards: {why}, and parts must not depend on that\n  next: leave {option} out; --starts bounds a search, `plan prepare` makes stored throws"
            ))),
        }
    }

    fn study(&self, shards: u32, starts: &Starts<N>) -> Result<Study, ExpectedError> {
        let mut words = words_of(self.search, self.arm, (self.seed, self.fast), starts)?;
        words.insert("draws".to_owned(), self.draws.to_string());
        words.insert("target list".to_owned(), self.targets.in_words());
        Ok(Study::new(words, self.targets.count(), shards, N))
    }

    /// Makes a shard; `false` if it was stopped.
    fn make_one(
        &self,
        folder: &Folder,
        shard: Shard,
        starts: &Starts<N>,
        watch: &Watch,
        done: &AtomicU64,
    ) -> Result<bool, ExpectedError> {
        let first = shard.rows(self.targets.count()).start;
        let mut targets = self.targets.rows_from(first).map_err(table_error)?;
        let stopped = || watch.stop.load(Ordering::Relaxed);
        let made = folder.make(shard, |rows| {
            let batch: Vec<(u64, TargetRow)> = rows
                .clone()
                .zip(targets.by_ref())
                .map(|(number, target)| Ok((number, target?)))
                .collect::<Result<_, TableError>>()?;
            if batch.len() as u64 != rows.end - rows.start {
                return Err(TableError::Refused(
                    "the list of targets has changed while it was read".to_owned(),
                )
                .into());
            }
            let made: Result<Vec<Option<Row>>, ExpectedError> = try_each(&batch, |(number, target)| {
                if stopped() {
                    return Ok(None);
                }
                let row = self.row(*number, target, starts, watch)?;
                done.fetch_add(1, Ordering::Relaxed);
                Ok(Some(row))
            });
            let made: Option<Vec<Row>> = made.map_err(Failure::Planning)?.into_iter().collect();
            // A search that was stopped has found less than it would have.
            Ok(made.filter(|_| !stopped()))
        });
        made.map_err(|failure| match failure {
            Failure::Table(error) => table_error(error),
            Failure::Planning(error) => error,
        })
    }

    fn row(
        &self,
        number: u64,
        target: &TargetRow,
        starts: &Starts<N>,
        watch: &Watch,
    ) -> Result<Row, ExpectedError> {
        let draws = (self.draws > 0)
            .then(|| Draws { count: self.draws, seed: SplitMix64::stream(self.seed, number).next_u64() });
        let own = self.search.with_target(target);
        let solved = own.solve(
            self.arm,
            &starts.index,
            target.target_m,
            (self.seed, self.fast),
            Watcher::Caller(watch),
            draws,
        );
        let row = |outcome, note: &str, throw| Row {
            number,
            target_m: target.target_m,
            outcome,
            note: note.to_owned(),
            throw,
        };
        match solved {
            Ok(Solved { mut plan, note, landings, .. }) => {
                plan.search.stored.clone_from(&starts.sources);
                let text = plan.to_json() + "\n";
                let [[xx, _], [_, yy]] = plan.landing.covariance_m2;
                let throw = Thrown {
                    objective: plan.objective.value,
                    release_s: plan.release_time_s,
                    duration_s: plan.end_time_s,
                    flight_s: plan.landing.flight_s,
                    spread_m: (xx + yy).sqrt(),
                    hit_probability: plan.landing.hit_probability,
                    position_m: plan.release.position_m,
                    velocity_m_s: plan.release.velocity_m_s,
                    q_rad: plan.release.q_rad,
                    qd_rad_s: plan.release.qd_rad_s,
                    qdd_rad_s2: plan.release.qdd_rad_s2,
                    plan_crc32: crc32fast::hash(text.as_bytes()),
                    landings,
                };
                let outcome = if note.is_some() { Outcome::Relaxed } else { Outcome::Thrown };
                Ok(row(outcome, note.unwrap_or_default(), Some(throw)))
            }
            Err(e) if [exit::NO_THROW, exit::BAD_INPUT].contains(&e.code) => {
                Ok(row(Outcome::Refused, e.message.lines().next().unwrap_or_default(), None))
            }
            // A search that was stopped; the row is dropped.
            Err(e) if e.code == exit::INTERRUPTED => Ok(row(Outcome::Refused, "stopped", None)),
            Err(e) => Err(e),
        }
    }
}

/// Everything that the rows to given targets follow from, by name. A store grows with each row, so of it only the place counts.
///
/// # Errors
/// Options are refused.
pub(super) fn words_of<const N: usize>(
    search: &SearchOptions,
    arm: &RobotModel<N>,
    (seed, fast): (u64, bool),
    starts: &Starts<N>,
) -> Result<BTreeMap<String, String>, ExpectedError> {
    let mut crc = crc32fast::Hasher::new();
    if starts.store.is_none() {
        for record in starts.index.records() {
            crc.update(&record.to_bytes());
        }
    }
    let words = [
        ("format", FORMAT.to_owned()),
        ("program", env!("CARGO_PKG_VERSION").to_owned()),
        ("robot", format!("{} {:016x}", arm.name(), robot_fingerprint(arm))),
        ("robot file", search.options.robot.clone()),
        ("options", search.in_words()?),
        ("seed", seed.to_string()),
        ("fast", fast.to_string()),
        ("library", search.options.library.is_some().to_string()),
        ("stored throws", format!("{}, CRC-32 {:08x}", starts.sources.join(", "), crc.finalize())),
    ];
    Ok(words.into_iter().map(|(name, word)| (name.to_owned(), word)).collect())
}

/// Why a shard was not made.
#[derive(Debug)]
enum Failure {
    Table(TableError),
    Planning(ExpectedError),
}

impl From<TableError> for Failure {
    fn from(error: TableError) -> Self {
        Self::Table(error)
    }
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

/// The summary of a folder, as JSON.
///
/// # Errors
/// There is no sweep, or a part cannot be read.
pub(super) fn summary(folder: &Path) -> Result<(Summary, serde_json::Value), ExpectedError> {
    let folder = Folder::open(folder).map_err(table_error)?;
    let s = Summary::of(&folder).map_err(table_error)?;
    let [least, mean, most] = s.objective.map_or([None; 3], |values| values.map(Some));
    let told = json!({
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
    Ok((s, told))
}

/// The summary in words.
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

//! `cubectl plan sweep`: a grid of targets to a table and a picture; or many targets to part files.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::Ordering;

use nalgebra::Vector3;

use super::grid::{Axis, Grid};
use super::options::note;
use super::require_writable;
use super::search::{SearchOptions, Watcher, watched};
use super::shards::{self, DRAWS_MAX, Made, Sweep, Targets, words_of};
use super::table::{append, continued, write_rows};
use crate::cmd::meaning::{Deed, Given};
use crate::error::ExpectedError;
use crate::exit;
use crate::report::reach::{self, Cell};
use planner::parallel::try_each;
use planner::plan::search::{Budget, Watch};
use planner::plan::{Found, Options};
use planner::request::{Answer, Origin, Plans, Refusal, Request};
use planner::store::Index;
use robot_model::{RobotModel, for_any_robot};
use throw_tables::shard::SHARDS_MAX;
use throw_tables::{Shard, TargetList};

/// Arguments.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl plan sweep --x 0.5,2.2,0.1 --z=-1,0.4,0.1 --out reach.csv\n  cubectl plan sweep --library arm.table --targets targets.parquet --shards 100 --out sweep\n  cubectl plan sweep --library arm.table --targets targets.parquet --shard 3/100 --out sweep\n  cubectl plan sweep --summary sweep"
)]
pub struct Args {
    /// What stands on the command line.
    #[command(flatten)]
    pub given: Given,
    #[command(flatten)]
    search: SearchOptions,
    /// Range of x: from, to, step in m.
    #[arg(long, value_name = "FROM,TO,STEP", allow_hyphen_values = true, value_parser = Axis::read, required_unless_present_any = ["targets", "summary"], help_heading = "Targets and results")]
    pub x: Option<Axis>,
    /// Range of y.
    #[arg(long, value_name = "FROM,TO,STEP", allow_hyphen_values = true, value_parser = Axis::read, default_value = "0,0,1", help_heading = "Targets and results")]
    pub y: Axis,
    /// Range of z.
    #[arg(long, value_name = "FROM,TO,STEP", allow_hyphen_values = true, value_parser = Axis::read, required_unless_present_any = ["targets", "summary"], help_heading = "Targets and results")]
    pub z: Option<Axis>,
    /// A list of targets instead of a grid, as of `plan throw --targets`: a CSV or Parquet file. For --shard and --shards.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["x", "y", "z"], help_heading = "Targets and results")]
    pub targets: Option<PathBuf>,
    /// Table to write; if it exists, only missing targets are planned. With --shard and --shards a folder of Parquet files.
    #[arg(long, required_unless_present = "summary", help_heading = "Targets and results")]
    pub out: Option<PathBuf>,
    /// Picture (SVG) to write; by default beside the table.
    #[arg(long, conflicts_with_all = ["shard", "shards"], help_heading = "Targets and results")]
    pub picture: Option<PathBuf>,
    /// Make shard I of N, from 1, and leave the others to other processes: one file of the folder --out, with the rows of its
    /// share of the targets. A shard that is there is not made again.
    #[arg(long, value_name = "I/N", conflicts_with = "shards", help_heading = "Shards")]
    pub shard: Option<Shard>,
    /// Make all of N shards, one after the other. The files are those of --shard.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(SHARDS_MAX)), help_heading = "Shards")]
    pub shards: Option<u32>,
    /// Draw so many disturbed throws to each target (Monte Carlo): columns with how many landed and hit, and the miss. The
    /// draws follow from the seed and the row.
    #[arg(long, value_name = "N", default_value_t = 0, help_heading = "Shards")]
    pub draws: usize,
    /// Tell what the parts in this folder say together, and which are missing.
    #[arg(long, value_name = "FOLDER", conflicts_with_all = ["x", "z", "targets", "out", "shard", "shards"], help_heading = "Shards")]
    pub summary: Option<PathBuf>,
    /// Print the summary as JSON.
    #[arg(long, requires = "summary", help_heading = "Shards")]
    pub json: bool,
    /// Answer from stored throws alone if they suffice, in about a millisecond.
    #[arg(long)]
    pub fast: bool,
    /// Seed.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

impl Args {
    fn grid(&self) -> Option<Grid> {
        Some(Grid { x: self.x?, y: self.y, z: self.z? })
    }

    /// The shards that are asked for; none for a table.
    fn asked_shards(&self) -> Option<Vec<Shard>> {
        match (self.shard, self.shards) {
            (Some(shard), _) => Some(vec![shard]),
            (None, Some(count)) => Some(Shard::all(count).collect()),
            (None, None) => None,
        }
    }
}

/// Random starts per target of a table, at most, if no number is asked for.
const TABLE_STARTS: usize = 32;

/// Outcomes of a target, as in the part files: a throw with all that was asked for, one without some of it, none.
const THROWN: &str = "thrown";
const RELAXED: &str = "relaxed";
const REFUSED: &str = "refused";

const HEADER: &str = "x_m,y_m,z_m,outcome,objective,flight_s,duration_s,speed_m_s,note";

/// One row of the table.
#[derive(Debug, Clone, PartialEq)]
struct Row {
    cell: Cell,
    text: String,
}

impl Row {
    /// Whether the throw was found without some of what was asked for.
    fn relaxed(&self) -> bool {
        self.text.split(',').nth(3) == Some(RELAXED)
    }
}

/// Writes the table again: rows of this grid in its order, then those of other grids in theirs.
fn write_in_order(path: &Path, targets: &[[f64; 3]], rows: &BTreeMap<[i64; 3], Row>) -> std::io::Result<()> {
    let own: std::collections::BTreeSet<[i64; 3]> = targets.iter().map(key).collect();
    let others = rows.iter().filter(|(k, _)| !own.contains(*k)).map(|(_, row)| row);
    let wanted = targets.iter().filter_map(|t| rows.get(&key(t)));
    write_rows(path, HEADER, wanted.chain(others).map(|row| row.text.as_str()))
}

/// Runs the verb.
///
/// # Errors
/// If input is refused or the table cannot be written.
pub fn run(args: &Args) -> Result<(), ExpectedError> {
    if let Some(folder) = &args.summary {
        args.given.require_meaning(&[Deed::Summary])?;
        let (summary, json) = shards::summary(folder)?;
        if args.json {
            console::line!("{json}");
        } else {
            console::text!("{}", shards::summary_in_words(&summary, folder));
        }
        return Ok(());
    }
    if args.asked_shards().is_some() {
        let Made { made, there } = make_shards(args, Watcher::Terminal)?;
        let out = args.out.clone().unwrap_or_default();
        console::line!("{made} shards made, {there} were there: {}", out.display());
        console::line!("next: cubectl plan sweep --summary {}", out.display());
        return Ok(());
    }
    let robot = crate::cmd::robot(&args.search.options.robot)?;
    for_any_robot!(&robot, arm => run_for(arm, args))
}

/// Makes the shards that are asked for.
///
/// # Errors
/// Input is refused, a file cannot be read or written, or it was stopped.
pub(super) fn make_shards(args: &Args, watcher: Watcher<'_>) -> Result<Made, ExpectedError> {
    let (Some(asked), Some(out)) = (args.asked_shards(), &args.out) else {
        return Err(ExpectedError::bad_input(
            &"name a shard with --shard I/N, or all with --shards N, and --out FOLDER",
        ));
    };
    args.given.require_meaning(&args.search.options.deeds(true))?;
    if args.draws > DRAWS_MAX {
        return Err(ExpectedError::bad_input(&format!(
            "--draws {}: at most {DRAWS_MAX} per target; a list may have the same target several times",
            args.draws
        )));
    }
    let targets = match (&args.targets, args.grid()) {
        (Some(list), _) => Targets::List(Box::new(TargetList::open(list).map_err(shards::table_error)?)),
        (None, Some(grid)) => Targets::Grid(grid),
        (None, None) => {
            return Err(ExpectedError::bad_input(&"name targets with --targets, or with --x and --z"));
        }
    };
    let robot = crate::cmd::robot(&args.search.options.robot)?;
    let (search, seed, fast, draws) = (&args.search, args.seed, args.fast, args.draws);
    for_any_robot!(&robot, arm => Sweep { arm, search, seed, fast, draws, targets }.make(out, &asked, watcher))
}

fn run_for<const N: usize>(arm: &RobotModel<N>, args: &Args) -> Result<(), ExpectedError>
where
    RobotModel<N>: Plans<N>,
{
    let (Some(grid), Some(out)) = (args.grid(), &args.out) else {
        return Err(ExpectedError::bad_input(
            &"a list of targets makes part files: add --shards N, or use `plan throw --targets` for one CSV table",
        ));
    };
    args.given.require_meaning(&[vec![Deed::Picture], args.search.options.deeds(true)].concat())?;
    let asked = args.search.options.resolve();
    let starts = args.search.options.starts(arm)?;
    let words = words_of(&args.search, arm, (args.seed, args.fast), &starts)?;
    let index = starts.index;
    let picture = args.picture.clone().unwrap_or_else(|| out.with_extension("svg"));
    require_writable(&picture)?;
    let (file, lines) = continued(out, HEADER, &words)?;
    let mut rows = read(&lines);
    let targets: Vec<[f64; 3]> = grid.targets().collect();
    let missing: Vec<[f64; 3]> = targets.iter().copied().filter(|t| !rows.contains_key(&key(t))).collect();
    console::line!(
        "{} targets, {} already in {}",
        targets.len(),
        targets.len() - missing.len(),
        out.display()
    );
    let file = Mutex::new(file);
    let watch = Watch::default();
    let bar = Budget { starts: missing.len(), all: false, time: None, seed: args.seed };
    let done: Result<Vec<Option<Row>>, std::io::Error> = watched(&watch, &bar, Watcher::Terminal, || {
        try_each(&missing, |target| {
            if watch.stop.load(Ordering::Relaxed) {
                return Ok(None);
            }
            let row = plan(arm, target, &asked, &index, args);
            watch.done.fetch_add(1, Ordering::Relaxed);
            watch.solved.fetch_add(usize::from(row.cell.objective.is_some()), Ordering::Relaxed);
            // A thread that panicked while holding the lock has written whole lines or nothing.
            append(&file.lock().unwrap_or_else(std::sync::PoisonError::into_inner), &row.text)?;
            Ok(Some(row))
        })
    });
    for row in done.map_err(|e| ExpectedError::output(out, &e))?.into_iter().flatten() {
        rows.insert(key(&row.cell.target), row);
    }
    let wanted: Vec<Row> = targets.iter().filter_map(|t| rows.get(&key(t)).cloned()).collect();
    write_in_order(out, &targets, &rows).map_err(|e| ExpectedError::output(out, &e))?;
    let cells: Vec<Cell> = wanted.iter().map(|row| row.cell.clone()).collect();
    std::fs::write(&picture, reach::svg(&targets, &cells, arm.name()))
        .map_err(|e| ExpectedError::output(&picture, &e))?;
    let solved = wanted.iter().filter(|r| r.cell.objective.is_some()).count();
    let relaxed = wanted.iter().filter(|r| r.relaxed()).count();
    console::line!(
        "{} of {} targets in reach with all that was asked for, {relaxed} more without some of it (see the notes); picture {}",
        solved - relaxed,
        wanted.len(),
        picture.display()
    );
    if wanted.len() < targets.len() {
        return Err(ExpectedError::new(
            exit::INTERRUPTED,
            format!(
                "stopped after {} of {} targets; the same command continues there",
                wanted.len(),
                targets.len()
            ),
        ));
    }
    Ok(())
}

fn key(t: &[f64; 3]) -> [i64; 3] {
    t.map(|v| (v * 1e6).round() as i64)
}

fn plan<const N: usize>(
    arm: &RobotModel<N>,
    target: &[f64; 3],
    asked: &Options,
    index: &Index<N>,
    args: &Args,
) -> Row
where
    RobotModel<N>: Plans<N>,
{
    let [x, y, z] = *target;
    let clean = |note: &str| note.replace([',', '"'], " ");
    let refused = |note: &str| Row {
        cell: Cell { target: *target, objective: None },
        text: format!("{x},{y},{z},{REFUSED},,,,,{}", clean(note)),
    };
    let budget = Budget {
        starts: args.search.starts.unwrap_or(TABLE_STARTS),
        all: false,
        time: None,
        seed: args.seed,
    };
    let request = Request {
        target: Vector3::from(*target),
        options: asked,
        kept: args.search.options.kept(),
        from: Origin::Search { quick: None },
        budget,
    };
    match arm.search(index, &request, &Watch::default()) {
        Ok(Answer { given_up, best, .. }) => {
            let Found { throw, objective, .. } = best.found;
            let speed = throw.ball_at_release(arm).1.norm();
            let (flight_s, duration_s) = (throw.flight_s, throw.duration_s());
            let note = clean(note(given_up).unwrap_or_default());
            let outcome = if note.is_empty() { THROWN } else { RELAXED };
            Row {
                cell: Cell { target: *target, objective: Some(objective) },
                text: format!("{x},{y},{z},{outcome},{objective},{flight_s},{duration_s},{speed},{note}"),
            }
        }
        Err(Refusal::NoThrow(none)) => refused(
            &none
                .nearest
                .map_or_else(String::new, |n| format!("{:.3} m short: {}", n.distance_m, n.constraint)),
        ),
        Err(e) => refused(&e.to_string()),
    }
}

/// Rows of an earlier run.
fn read(lines: &[String]) -> BTreeMap<[i64; 3], Row> {
    let mut rows = BTreeMap::new();
    for line in lines {
        let fields: Vec<&str> = line.splitn(9, ',').collect();
        let number = |i: usize| fields.get(i).and_then(|f: &&str| f.parse::<f64>().ok());
        if let (9, Some(x), Some(y), Some(z)) = (fields.len(), number(0), number(1), number(2)) {
            let target = [x, y, z];
            rows.insert(
                key(&target),
                Row { cell: Cell { target, objective: number(4) }, text: line.clone() },
            );
        }
    }
    rows
}

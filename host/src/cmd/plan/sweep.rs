//! `cubectl plan sweep`: a grid of targets to a table and a picture.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::Ordering;

use nalgebra::Vector3;
use rayon::prelude::*;

use super::options::{PlanOptions, note};
use super::require_writable;
use super::search::{Watcher, watched};
use crate::error::ExpectedError;
use crate::exit;
use crate::report::reach::{self, Cell};
use planner::plan::ladder::{Ladder, Settled};
use planner::plan::search::{Budget, Watch};
use planner::plan::{Found, Options};
use planner::store::Index;
use robot_model::{RobotModel, for_any_robot};

/// Arguments.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  cubectl plan sweep --x 0.5,2.2,0.1 --z=-1,0.4,0.1 --out reach.csv")]
pub struct Args {
    #[command(flatten)]
    options: PlanOptions,
    /// Range of x: from, to, step in m.
    #[arg(long, value_name = "FROM,TO,STEP", allow_hyphen_values = true, value_parser = axis)]
    pub x: Axis,
    /// Range of y.
    #[arg(long, value_name = "FROM,TO,STEP", allow_hyphen_values = true, value_parser = axis, default_value = "0,0,1")]
    pub y: Axis,
    /// Range of z.
    #[arg(long, value_name = "FROM,TO,STEP", allow_hyphen_values = true, value_parser = axis)]
    pub z: Axis,
    /// Table to write; if it exists, only missing targets are planned.
    #[arg(long)]
    pub out: PathBuf,
    /// Picture (SVG) to write; by default beside the table.
    #[arg(long)]
    pub picture: Option<PathBuf>,
    /// Random starts per target after the stored ones.
    #[arg(long, default_value_t = 32)]
    pub starts: usize,
    /// Seed.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

/// Values along one axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Axis {
    from: f64,
    to: f64,
    step: f64,
}

impl Axis {
    fn values(&self) -> Vec<f64> {
        let count = ((self.to - self.from) / self.step + 1e-9).floor() as usize;
        // Rounded, so that the same target has the same name in every run.
        (0..=count).map(|i| ((self.from + i as f64 * self.step) * 1e6).round() / 1e6).collect()
    }
}

fn axis(text: &str) -> Result<Axis, String> {
    let p: Vec<f64> = text
        .split(',')
        .map(|p| p.trim().parse().map_err(|_| format!("\"{p}\" is not a number")))
        .collect::<Result<_, _>>()?;
    let [from, to, step] = p[..] else { return Err("expected FROM,TO,STEP".to_owned()) };
    let sensible = from.is_finite() && to >= from && step > 0.0 && (to - from) / step <= 1e4;
    if sensible {
        Ok(Axis { from, to, step })
    } else {
        Err(format!("range from {from} to {to} in steps of {step}"))
    }
}

/// Longest table that is read, bytes: a million targets.
const TABLE_MAX_BYTES: u64 = 256 << 20;

const HEADER: &str = "x_m,y_m,z_m,solved,objective,flight_s,duration_s,speed_m_s,note";

/// One row of the table.
#[derive(Debug, Clone, PartialEq)]
struct Row {
    cell: Cell,
    text: String,
}

impl Row {
    /// Whether the throw was found without some of what was asked for.
    fn relaxed(&self) -> bool {
        self.cell.objective.is_some() && self.text.splitn(9, ',').nth(8).is_some_and(|note| !note.is_empty())
    }
}

/// Writes the table again: rows of this grid in its order, then those of other grids in theirs.
fn write_in_order(path: &Path, targets: &[[f64; 3]], rows: &BTreeMap<[i64; 3], Row>) -> std::io::Result<()> {
    let own: std::collections::BTreeSet<[i64; 3]> = targets.iter().map(key).collect();
    let others = rows.iter().filter(|(k, _)| !own.contains(*k)).map(|(_, row)| row);
    let wanted = targets.iter().filter_map(|t| rows.get(&key(t)));
    let mut text = format!("{HEADER}\n");
    for row in wanted.chain(others) {
        text.push_str(&row.text);
        text.push('\n');
    }
    planner::store::file::write_whole(path, text.as_bytes())
}

/// Runs the verb.
///
/// # Errors
/// If input is refused or the table cannot be written.
pub fn run(args: &Args) -> Result<(), ExpectedError> {
    let robot = crate::cmd::robot(&args.options.robot)?;
    for_any_robot!(&robot, arm => run_for(arm, args))
}

fn run_for<const N: usize>(arm: &RobotModel<N>, args: &Args) -> Result<(), ExpectedError> {
    let asked = args.options.resolve();
    let index = args.options.starts(arm)?.index;
    let picture = args.picture.clone().unwrap_or_else(|| args.out.with_extension("svg"));
    require_writable(&picture)?;
    let mut rows = read(&args.out)?;
    let mut targets = Vec::new();
    for z in args.z.values() {
        for y in args.y.values() {
            targets.extend(args.x.values().into_iter().map(|x| [x, y, z]));
        }
    }
    let missing: Vec<[f64; 3]> = targets.iter().copied().filter(|t| !rows.contains_key(&key(t))).collect();
    console::line!(
        "{} targets, {} already in {}",
        targets.len(),
        targets.len() - missing.len(),
        args.out.display()
    );
    let fresh = rows.is_empty();
    let mut file = OpenOptions::new()
        .create(true)
        .append(true)
        .open(&args.out)
        .map_err(|e| ExpectedError::output(&args.out, &e))?;
    if fresh {
        writeln!(file, "{HEADER}").map_err(|e| ExpectedError::output(&args.out, &e))?;
    }
    let file = Mutex::new(file);
    let watch = Watch::default();
    let bar = Budget { starts: missing.len(), all: false, time: None, seed: args.seed };
    let done: Result<Vec<Row>, std::io::Error> = watched(&watch, &bar, Watcher::Terminal, || {
        missing
            .par_iter()
            .filter(|_| !watch.stop.load(Ordering::Relaxed))
            .map(|target| {
                let row = plan(arm, target, &asked, &index, args);
                watch.done.fetch_add(1, Ordering::Relaxed);
                watch.solved.fetch_add(usize::from(row.cell.objective.is_some()), Ordering::Relaxed);
                append(&file, &row)?;
                Ok(row)
            })
            .collect()
    });
    for row in done.map_err(|e| ExpectedError::output(&args.out, &e))? {
        rows.insert(key(&row.cell.target), row);
    }
    let wanted: Vec<Row> = targets.iter().filter_map(|t| rows.get(&key(t)).cloned()).collect();
    write_in_order(&args.out, &targets, &rows).map_err(|e| ExpectedError::output(&args.out, &e))?;
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

fn append(file: &Mutex<File>, row: &Row) -> std::io::Result<()> {
    // A thread that panicked while holding the lock has written whole lines or nothing.
    let mut file = file.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    file.write_all(format!("{}\n", row.text).as_bytes())
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
) -> Row {
    let [x, y, z] = *target;
    let clean = |note: &str| note.replace([',', '"'], " ");
    let refused = |note: &str| Row {
        cell: Cell { target: *target, objective: None },
        text: format!("{x},{y},{z},0,,,,,{}", clean(note)),
    };
    let ladder = match Ladder::new(arm, Vector3::from(*target), asked, args.options.kept()) {
        Ok(ladder) => ladder,
        Err(e) => return refused(&e.to_string()),
    };
    let budget = Budget { starts: args.starts, all: false, time: None, seed: args.seed };
    match ladder.search(index, &budget, &Watch::default(), None) {
        Ok(Settled { given_up, best, .. }) => {
            let Found { throw, objective, .. } = best.found;
            let speed = throw.ball_at_release(arm).1.norm();
            let (flight_s, duration_s) = (throw.flight_s, throw.duration_s());
            let note = clean(note(given_up).unwrap_or_default());
            Row {
                cell: Cell { target: *target, objective: Some(objective) },
                text: format!("{x},{y},{z},1,{objective},{flight_s},{duration_s},{speed},{note}"),
            }
        }
        Err(none) => refused(
            &none
                .nearest
                .map_or_else(String::new, |n| format!("{:.3} m short: {}", n.distance_m, n.constraint)),
        ),
    }
}

/// Rows of an earlier run; a torn last line is left out and planned again.
fn read(path: &Path) -> Result<BTreeMap<[i64; 3], Row>, ExpectedError> {
    let text = match toml_reader::read_text(path, TABLE_MAX_BYTES) {
        Ok(text) => text,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(BTreeMap::new()),
        Err(e) => return Err(ExpectedError::io(path, &e)),
    };
    let mut lines = text.lines();
    match lines.next() {
        None => return Ok(BTreeMap::new()),
        Some(HEADER) => {}
        Some(_) => {
            return Err(ExpectedError::bad_input(&format!(
                "{} exists and is not a table of a sweep: name another file",
                path.display()
            )));
        }
    }
    let mut rows = BTreeMap::new();
    let complete = text.ends_with('\n');
    let lines: Vec<&str> = lines.collect();
    for (i, line) in lines.iter().enumerate() {
        if !complete && i + 1 == lines.len() {
            continue;
        }
        let fields: Vec<&str> = line.splitn(9, ',').collect();
        let number = |i: usize| fields.get(i).and_then(|f: &&str| f.parse::<f64>().ok());
        if let (9, Some(x), Some(y), Some(z)) = (fields.len(), number(0), number(1), number(2)) {
            let target = [x, y, z];
            rows.insert(
                key(&target),
                Row { cell: Cell { target, objective: number(4) }, text: (*line).to_owned() },
            );
        }
    }
    if !complete {
        // Put the table into a state that can be appended to.
        let kept: String = std::iter::once(HEADER.to_owned())
            .chain(rows.values().map(|r| r.text.clone()))
            .map(|l| l + "\n")
            .collect();
        std::fs::write(path, kept).map_err(|e| ExpectedError::output(path, &e))?;
    }
    Ok(rows)
}

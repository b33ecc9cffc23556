//! `cubectl plan prepare ROBOT`: makes the table of stored throws of a robot.

use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

use indicatif::{ProgressBar, ProgressStyle};

use super::options::{PlanOptions, default_table};
use super::require_writable;
use crate::cmd::meaning::{Deed, Given};
use crate::error::ExpectedError;
use crate::exit;
use operator::interrupt::interrupt;
use planner::plan::ladder;
use planner::plan::prepare::{Grid, Preparation};
use planner::plan::search::kind_of;
use planner::request::Plans;
use planner::store::{Record, file, robot_fingerprint};
use robot_model::{RobotModel, for_any_robot};

/// Arguments.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:\n  cubectl plan prepare my_arm.toml\n\nThe table is used by every later plan for this robot. Ctrl-C stops; the same command continues."
)]
pub struct Args {
    /// What stands on the command line.
    #[command(flatten)]
    pub given: Given,
    /// Robot, by name or file [default: that of --robot].
    pub name: Option<String>,
    #[command(flatten)]
    options: PlanOptions,
    /// File to write; throws of other forms in it are kept [default: in the user's data folder, where plans look for it].
    #[arg(long)]
    pub out: Option<PathBuf>,
    /// Step of the grid in range and height, in m.
    #[arg(long, default_value_t = 0.1)]
    pub step_m: f64,
    /// Largest range in m; the grid ends before it where nothing is in reach.
    #[arg(long, default_value_t = 6.0)]
    pub range_max_m: f64,
    /// Largest height in m.
    #[arg(long, default_value_t = 0.9)]
    pub height_max_m: f64,
    /// Random starts per cell of the grid and per trial.
    #[arg(long, default_value_t = 10)]
    pub starts: u64,
    /// Rounds in which neighbours pass on their throws.
    #[arg(long, default_value_t = 3)]
    pub sweeps: usize,
    /// Random targets at which the table is tried and, where it does badly, completed.
    #[arg(long, default_value_t = 1024)]
    pub trials: u64,
    /// Seed.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

/// Where a preparation stands: the first line of its file of progress, followed by the records as in a store.
#[derive(Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct Stand {
    robot: String,
    options: String,
    grid: Grid,
    seed: u64,
    step: usize,
}

/// Runs the verb.
///
/// # Errors
/// If the robot or a number is refused, a file cannot be written, or Ctrl-C stops it.
pub fn run(args: &Args) -> Result<(), ExpectedError> {
    let robot = crate::cmd::robot(args.name.as_ref().unwrap_or(&args.options.robot))?;
    for_any_robot!(&robot, arm => run_for(arm, args))
}

fn run_for<const N: usize>(arm: &RobotModel<N>, args: &Args) -> Result<(), ExpectedError>
where
    RobotModel<N>: Plans<N>,
{
    let grid = grid(args, arm.world().floor_z_m)?;
    let out = args.out.clone().or_else(|| default_table(arm)).ok_or_else(|| {
        ExpectedError::bad_input(
            &"no data folder is known (neither XDG_DATA_HOME nor HOME is set): add --out FILE",
        )
    })?;
    if let Some(folder) = out.parent().filter(|p| !p.as_os_str().is_empty()) {
        std::fs::create_dir_all(folder).map_err(|e| ExpectedError::output(folder, &e))?;
    }
    require_writable(&out)?;
    let robot = robot_fingerprint(arm);
    args.given.require_meaning(&[Deed::StoredThrows])?;
    // The easiest set of options first: throws to it are starts for the others.
    let rungs = ladder::rungs(&args.options.resolve(), args.options.kept());
    let sets: Vec<_> = rungs.into_iter().rev().map(|(_, options)| options).collect();
    let kinds: Vec<u32> = sets.iter().map(kind_of).collect();
    let mut stand = Stand {
        robot: format!("{robot:016x}"),
        options: format!("{sets:?}"),
        grid,
        seed: args.seed,
        step: 0,
    };
    let progress = out.with_extension("progress");
    let mut records = Vec::new();
    if let Some((step, so_far)) = continued(&progress, &stand, robot) {
        console::line!("continues {} at step {step}", progress.display());
        (stand.step, records) = (step, so_far);
    }
    let preparation = Preparation::new(arm, sets, grid, args.seed);
    let stop = interrupt();
    let bar = ProgressBar::new(preparation.steps() as u64).with_style(
        ProgressStyle::with_template("{bar:30} step {pos} of {len}, {msg} throws, {elapsed}")
            .unwrap_or_else(|_| ProgressStyle::default_bar()),
    );
    while stand.step < preparation.steps() {
        bar.set_position(stand.step as u64);
        bar.set_message(records.len().to_string());
        let stopped = || stop.load(Ordering::Relaxed);
        let Some(next) = RobotModel::prepare_step(&preparation, stand.step, records, &stopped) else {
            bar.finish_and_clear();
            return Err(ExpectedError::new(
                exit::INTERRUPTED,
                format!(
                    "stopped at step {} of {}; what is done is in {}\n  next: run the same command again, it continues there",
                    stand.step,
                    preparation.steps(),
                    progress.display()
                ),
            ));
        };
        records = next;
        stand.step += 1;
        save(&progress, &stand, robot, &records).map_err(|e| ExpectedError::output(&progress, &e))?;
    }
    bar.finish_and_clear();
    let count = records.len();
    let all: Vec<Record<N>> = others(&out, robot, &kinds)?.into_iter().chain(records).collect();
    file::write_all(&out, robot, &all).map_err(|e| ExpectedError::output(&out, &e))?;
    // The table has everything that is in it.
    let _ = std::fs::remove_file(&progress);
    console::line!("{count} throws made, {} in {}", all.len(), out.display());
    Ok(())
}

fn grid(args: &Args, floor_z_m: f64) -> Result<Grid, ExpectedError> {
    let cells = args.range_max_m / args.step_m * ((args.height_max_m - floor_z_m) / args.step_m);
    let sensible = args.step_m >= 0.02
        && args.range_max_m >= args.step_m
        && args.range_max_m <= 50.0
        && args.height_max_m > floor_z_m
        && cells <= 1e5;
    if !sensible {
        return Err(ExpectedError::bad_input(&format!(
            "the grid needs a step of at least 0.02 m, a range of at most 50 m, a height above the floor at {floor_z_m} m, and at most 100000 cells"
        )));
    }
    if args.starts > 10_000 || args.sweeps > 100 || args.trials > 1_000_000 {
        return Err(ExpectedError::bad_input(
            &"at most 10000 starts, 100 sweeps and 1000000 trials: a preparation has to end",
        ));
    }
    Ok(Grid {
        step_m: args.step_m,
        range_max_m: args.range_max_m,
        height_max_m: args.height_max_m,
        starts: args.starts,
        keep: KEEP,
        sweeps: args.sweeps,
        trials: args.trials,
    })
}

/// Distinct throws kept per cell.
const KEEP: usize = 3;

/// Records of other kinds in the table that is written.
fn others<const N: usize>(out: &Path, robot: u64, kinds: &[u32]) -> Result<Vec<Record<N>>, ExpectedError> {
    match std::fs::read(out) {
        Ok(bytes) if !bytes.is_empty() => match file::parse(out, &bytes, robot) {
            Ok((records, _)) => Ok(records.into_iter().filter(|r| !kinds.contains(&r.kind)).collect()),
            // A table of an older robot file or format is replaced as a whole.
            Err(file::StoreError::OtherRobot { .. } | file::StoreError::Older { .. }) => Ok(Vec::new()),
            Err(e) => Err(ExpectedError::bad_input(&e)),
        },
        _ => Ok(Vec::new()),
    }
}

fn save<const N: usize>(
    path: &Path,
    stand: &Stand,
    robot: u64,
    records: &[Record<N>],
) -> std::io::Result<()> {
    let mut bytes = serde_json::to_vec(stand)?;
    bytes.push(b'\n');
    bytes.extend_from_slice(&file::to_bytes(robot, records));
    file::write_whole(path, &bytes)
}

/// Step and records of an earlier run with the same arguments; nothing if there is none or it is damaged.
fn continued<const N: usize>(path: &Path, wanted: &Stand, robot: u64) -> Option<(usize, Vec<Record<N>>)> {
    let bytes = std::fs::read(path).ok()?;
    let end = bytes.iter().position(|b| *b == b'\n')?;
    let found: Stand = serde_json::from_slice(&bytes[..end]).ok()?;
    let step = found.step;
    if (Stand { step: wanted.step, ..found }) != *wanted {
        return None;
    }
    match file::parse(path, &bytes[end + 1..], robot) {
        Ok((records, 0)) => Some((step, records)),
        _ => None,
    }
}

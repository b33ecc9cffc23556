//! `cubectl plan seeds`: makes the built-in table of starting throws.

use std::path::PathBuf;

use indicatif::ProgressBar;

use super::options::PlanOptions;
use super::require_writable;
use crate::error::ExpectedError;
use crate::plan::search::kind_of;
use crate::plan::seeds::{Grid, improve, make};
use crate::store::{Index, Record, file, robot_fingerprint};

/// Arguments.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  cubectl plan seeds --robot my_arm.toml --out my_arm.seeds")]
pub struct Args {
    #[command(flatten)]
    options: PlanOptions,
    /// File to write; throws of other forms in it are kept.
    #[arg(long)]
    pub out: PathBuf,
    /// Step of the grid in range and height, in m.
    #[arg(long, default_value_t = 0.1)]
    pub step_m: f64,
    /// Largest range in m.
    #[arg(long, default_value_t = 2.3)]
    pub range_max_m: f64,
    /// Largest height in m.
    #[arg(long, default_value_t = 1.6)]
    pub height_max_m: f64,
    /// Random starts per cell of the grid and per trial.
    #[arg(long, default_value_t = 10)]
    pub starts: u64,
    /// Rounds in which neighbours pass on their throws.
    #[arg(long, default_value_t = 4)]
    pub sweeps: usize,
    /// Random targets at which the table is tried and, where it does badly, completed.
    #[arg(long, default_value_t = 1024)]
    pub trials: u64,
    /// Keep the throws of this form that the file has, and only try and complete them: needs another seed each time.
    #[arg(long)]
    pub complete: bool,
    /// Seed.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

/// Runs the verb.
///
/// # Errors
/// If the robot or a number is refused, or the file cannot be written.
pub fn run(args: &Args) -> Result<(), ExpectedError> {
    let arm = crate::cmd::arm(&args.options.robot)?;
    let sensible = args.step_m >= 0.02
        && args.range_max_m >= args.step_m
        && args.range_max_m <= 20.0
        && args.height_max_m.abs() <= 20.0;
    if !sensible {
        return Err(ExpectedError::bad_input(
            &"the grid needs a step of at least 0.02 m and a range and height of at most 20 m",
        ));
    }
    require_writable(&args.out)?;
    let options = args.options.resolve();
    let grid = Grid {
        step_m: args.step_m,
        range_max_m: args.range_max_m,
        height_max_m: args.height_max_m,
        starts: args.starts,
        keep: 3,
        sweeps: args.sweeps,
        trials: args.trials,
    };
    let robot = robot_fingerprint(&arm);
    let before = match std::fs::read(&args.out) {
        Ok(bytes) if !bytes.is_empty() => match file::parse(&args.out, &bytes, robot) {
            Ok((records, _)) => records,
            // A table of an older robot file or format is replaced as a whole.
            Err(file::StoreError::OtherRobot { .. } | file::StoreError::Older { .. }) => Vec::new(),
            Err(e) => return Err(ExpectedError::bad_input(&e)),
        },
        _ => Vec::new(),
    };
    let kind = kind_of(&options);
    let (own, others): (Vec<Record>, Vec<Record>) = before.into_iter().partition(|r| r.kind == kind);
    let bar = ProgressBar::new(1000);
    let progress = |share: f64| {
        if (share * 1000.0) as u64 > bar.position() {
            bar.set_position((share * 1000.0) as u64);
        }
    };
    let made = if args.complete {
        improve(&arm, &options, &grid, args.seed, Index::new(own), &progress)
    } else {
        make(&arm, &options, &grid, args.seed, &progress)
    };
    bar.finish_and_clear();
    let count = made.len();
    let all: Vec<Record> = others.into_iter().chain(made).collect();
    file::write_all(&args.out, robot, &all).map_err(|e| ExpectedError::output(&args.out, &e))?;
    say::line!("{count} throws made, {} in {}", all.len(), args.out.display());
    Ok(())
}

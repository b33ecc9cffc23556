//! `cubectl plan sweep`: many targets to CSV part files, on one machine or on many.

use std::path::{Path, PathBuf};

use super::grid::{Axis, Grid};
use super::require_writable;
use super::search::{SearchOptions, Watcher};
use super::shards::{self, DRAWS_MAX, Made, Sweep, Targets};
use crate::cmd::meaning::{Deed, Given};
use crate::cmd::request::readers;
use crate::error::ExpectedError;
use crate::tables::shard::{SHARDS_MAX, Shard};
use crate::tables::targets::TargetList;

#[derive(Debug, clap::Args, serde::Deserialize)]
#[command(
    after_help = "Examples:\n  cubectl plan sweep --x 0.5,2.2,0.1 --z=-1,0.4,0.1 --out reach\n  cubectl plan sweep --summary reach --picture reach.html\n  cubectl plan sweep --fast --targets targets.csv --shard 3/100 --out sweep"
)]
pub struct Args {
    #[command(flatten)]
    #[serde(rename = "+given")]
    pub given: Given,
    #[command(flatten)]
    #[serde(rename = "+search")]
    search: SearchOptions,
    /// Range of x: from, to, step in m.
    #[arg(long, value_name = "FROM,TO,STEP", allow_hyphen_values = true, value_parser = Axis::read, required_unless_present_any = ["targets", "summary"], help_heading = "Targets and results")]
    #[serde(default, deserialize_with = "axis_of")]
    x: Option<Axis>,
    /// Range of y.
    #[arg(long, value_name = "FROM,TO,STEP", allow_hyphen_values = true, value_parser = Axis::read, default_value = "0,0,1", help_heading = "Targets and results")]
    #[serde(deserialize_with = "axis_of")]
    y: Axis,
    /// Range of z.
    #[arg(long, value_name = "FROM,TO,STEP", allow_hyphen_values = true, value_parser = Axis::read, required_unless_present_any = ["targets", "summary"], help_heading = "Targets and results")]
    #[serde(default, deserialize_with = "axis_of")]
    z: Option<Axis>,
    /// A list of targets instead of a grid: a CSV file with the columns x_m, y_m, z_m, for openings also nx, ny, nz, radius_m and, if
    /// wanted, incidence_max_deg, for moving targets vx_m_s, vy_m_s, vz_m_s.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["x", "y", "z"], help_heading = "Targets and results")]
    targets: Option<PathBuf>,
    /// Folder of CSV part files. The same command continues a sweep that was stopped: parts that are there are not made again.
    #[arg(
        long,
        value_name = "FOLDER",
        required_unless_present = "summary",
        help_heading = "Targets and results"
    )]
    out: Option<PathBuf>,
    /// Make shard I of N, from 1, and leave the others to other processes: one part file with the rows of its share of the targets.
    #[arg(long, value_name = "I/N", conflicts_with = "shards", help_heading = "Shards")]
    #[serde(default, deserialize_with = "shard_of")]
    shard: Option<Shard>,
    /// Make all of N shards, one after the other; the files are those of --shard [default: a shard for 100 targets].
    #[arg(long, value_name = "N", value_parser = shards, help_heading = "Shards")]
    #[serde(default, deserialize_with = "shards_of")]
    shards: Option<u32>,
    /// Draw so many disturbed throws to each target (Monte Carlo): columns with how many landed and hit, and the miss. The
    /// draws follow from the seed and the row.
    #[arg(long, value_name = "N", default_value_t = 0, help_heading = "Shards")]
    draws: usize,
    /// Report what the parts in this folder say together, and which are missing.
    #[arg(long, value_name = "FOLDER", conflicts_with_all = ["x", "z", "targets", "out", "shard", "shards"], help_heading = "Shards")]
    #[serde(skip)]
    summary: Option<PathBuf>,
    /// Page (HTML) with the reach to draw with --summary.
    #[arg(long, value_name = "FILE", requires = "summary", help_heading = "Shards")]
    #[serde(skip)]
    picture: Option<PathBuf>,
    /// Print the summary as JSON.
    #[arg(long, requires = "summary", help_heading = "Shards")]
    #[serde(skip)]
    json: bool,
    /// Take the first stored throw that leads there, in about a millisecond; it may cost 8 % more than the best one. If none does, a
    /// search follows, and the answer says so.
    #[arg(long)]
    fast: bool,
    /// Seed.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// Targets of a shard if nobody says how many shards there are: an interruption loses one shard at most.
const SHARD_TARGETS: u64 = 100;

readers! {
    axis_of: Axis::read => Axis;
    shard_of: str::parse => Shard;
    shards_of: shards => u32;
}

fn shards(text: &str) -> Result<u32, String> {
    let count = text.parse().ok().filter(|count| (1..=SHARDS_MAX).contains(count));
    count.ok_or_else(|| format!("must be a whole number from 1 to {SHARDS_MAX}"))
}

pub fn run(args: &Args) -> Result<(), ExpectedError> {
    if let Some(folder) = &args.summary {
        return summary(args, folder);
    }
    let Made { made, there } = make_shards(args, Watcher::Terminal)?;
    let out = args.out.clone().unwrap_or_default();
    console::line!("{made} shards made, {there} were there: {}", out.display());
    console::line!("next: cubectl plan sweep --summary {}", out.display());
    Ok(())
}

fn summary(args: &Args, folder: &Path) -> Result<(), ExpectedError> {
    args.given.require_meaning(&[Deed::Summary])?;
    if let Some(picture) = &args.picture {
        require_writable(picture)?;
        let page = shards::picture(folder)?;
        std::fs::write(picture, page).map_err(|e| ExpectedError::output(picture, &e))?;
    }
    let (summary, json) = shards::summary(folder)?;
    if args.json {
        console::line!("{json}");
    } else {
        console::text!("{}", shards::summary_in_words(&summary, folder));
    }
    Ok(())
}

pub(super) fn make_shards(args: &Args, watcher: Watcher<'_>) -> Result<Made, ExpectedError> {
    let Some(out) = &args.out else {
        return Err(ExpectedError::bad_input(&"name the folder of the parts with --out FOLDER"));
    };
    args.given.require_meaning(&args.search.options.deeds(true))?;
    if args.draws > DRAWS_MAX {
        return Err(ExpectedError::bad_input(&format!(
            "--draws {}: at most {DRAWS_MAX} per target; a list may have the same target several times",
            args.draws
        )));
    }
    let targets = match (&args.targets, args.x, args.z) {
        (Some(list), ..) => Targets::List(Box::new(TargetList::open(list)?)),
        (None, Some(x), Some(z)) => Targets::Grid(Grid { x, y: args.y, z }),
        _ => {
            return Err(ExpectedError::bad_input(&"name targets with --targets, or with --x and --z"));
        }
    };
    let asked: Vec<Shard> = match (args.shard, args.shards) {
        (Some(shard), _) => vec![shard],
        (None, Some(count)) => Shard::all(count).collect(),
        (None, None) => {
            let count = targets.count().div_ceil(SHARD_TARGETS).min(u64::from(SHARDS_MAX));
            Shard::all(u32::try_from(count).unwrap_or(SHARDS_MAX)).collect()
        }
    };
    let robot = crate::cmd::robot(&args.search.options.robot)?;
    let (search, seed, fast, draws) = (&args.search, args.seed, args.fast, args.draws);
    Sweep { arm: &robot, search, seed, fast, draws, targets }.make(out, &asked, watcher)
}

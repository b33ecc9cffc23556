//! Best known throws to random targets: the reference for a search.
//!
//! ```text
//! cargo run --release -p planner --example best_known -- ROBOT FILE [TARGETS] [STARTS|search] [RANGE_MIN,RANGE_MAX] [SEED]
//! ```
//!
//! With a number, the best of that many random starts without stored throws; with `search`, the result of the
//! default search, with the table that comes with the program. The targets do not depend on the seed: it is for the
//! starts.
//!
//! One row per target, in order. An incomplete file is continued: its rows are not computed again. In a complete
//! file every row is computed once more with the given seed, and the better of the two throws is kept. Throws that
//! the verifier refuses do not count, neither new nor old ones.
//! A target without a throw under every limit of the default form is tried without limits of the landing's shift, then
//! without nulling. `benches/best_known/rows.rs` has the columns.

use std::error::Error;
use std::f64::consts::PI;
use std::fs::OpenOptions;
use std::io::Write;

use nalgebra::Vector3;
use planner::plan::rng::SplitMix64;
use planner::plan::{Budget, Kept, Options, Watch, seeds};
use planner::request::Request;
use planner::store::Index;
use robot_model::RobotModel;

#[path = "../benches/best_known/judge.rs"]
mod judge;
#[path = "../benches/best_known/rows.rs"]
#[allow(dead_code, reason = "other examples use the rest")]
mod rows;
use judge::judge;
use rows::{Row, throw_column};

const HEADER: &str = "index,x_m,y_m,z_m,level,objective,starts,solved,at_best,throw";
/// Heights of the targets above the floor, in m.
const HEIGHT_M: [f64; 2] = [0.0, 1.5];
/// The targets of all files are those of this seed.
const TARGETS_SEED: u64 = 1;
/// Prices that differ by less than this share are one price; the throws of the files are rounded.
const SAME_SHARE: f64 = 1e-9;

/// Arguments, in the order of the command line.
struct Asked {
    targets: usize,
    /// Random starts; `None`: the default search.
    starts: Option<usize>,
    range_m: [f64; 2],
    seed: u64,
}

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [robot, file, rest @ ..] = &args[..] else {
        return Err("expected ROBOT FILE [TARGETS] [STARTS|search] [RANGE_MIN,RANGE_MAX] [SEED]".into());
    };
    let text = |i: usize, default: &str| rest.get(i).cloned().unwrap_or_else(|| default.to_owned());
    let range = text(2, "0.4,4.2");
    let (near, far) = range.split_once(',').ok_or("a range is two numbers with a comma between")?;
    let starts = text(1, "2000");
    let asked = Asked {
        targets: text(0, "200").parse()?,
        starts: if starts == "search" { None } else { Some(starts.parse()?) },
        range_m: [near.parse()?, far.parse()?],
        seed: text(3, "1").parse()?,
    };
    let robot = RobotModel::load(robot)?;
    fill(&robot, file, &asked)
}

/// Target number `index` above an arm: range and height uniform, any azimuth.
fn target(arm: &RobotModel, range_m: [f64; 2], index: u64) -> Vector3<f64> {
    let mut rng = SplitMix64::stream(TARGETS_SEED, index);
    let azimuth_rad = (rng.unit() * 2.0 - 1.0) * PI;
    let range_m = range_m[0] + (range_m[1] - range_m[0]) * rng.unit();
    let height_m = HEIGHT_M[0] + (HEIGHT_M[1] - HEIGHT_M[0]) * rng.unit();
    Vector3::new(range_m * azimuth_rad.cos(), range_m * azimuth_rad.sin(), arm.world().floor_z_m + height_m)
}

fn fill(arm: &RobotModel, file: &str, asked: &Asked) -> Result<(), Box<dyn Error>> {
    let table = if asked.starts.is_none() { seeds::built_in(arm) } else { Index::default() };
    let before = std::fs::read_to_string(file).unwrap_or_default();
    // A torn last line is computed again.
    let whole = before.rfind('\n').map_or("", |end| &before[..=end]);
    let rows: Vec<&str> = whole.lines().skip(1).collect();
    if rows.len() >= asked.targets {
        let better: Vec<String> = rows
            .iter()
            .zip(0..)
            .map(|(old, index)| better(arm, old, row(arm, asked, &table, index)))
            .collect::<Result<_, _>>()?;
        return Ok(std::fs::write(file, format!("{HEADER}\n{}\n", better.join("\n")))?);
    }
    let mut out = OpenOptions::new().create(true).write(true).truncate(true).open(file)?;
    out.write_all(if whole.is_empty() { format!("{HEADER}\n") } else { whole.to_owned() }.as_bytes())?;
    for index in rows.len()..asked.targets {
        writeln!(out, "{}", row(arm, asked, &table, index as u64))?;
    }
    Ok(())
}

/// The better one of two rows for one target: the stricter relaxation level, then the lower price.
fn better(arm: &RobotModel, old: &str, new: String) -> Result<String, Box<dyn Error>> {
    let before = Row::read(old)?;
    let known =
        before.known.filter(|(level, _)| before.throw.is_empty() || judge(arm, &before, *level).is_ok());
    Ok(match (known, Row::read(&new)?.known) {
        (None, _) => new,
        (Some((old_level, old_price)), Some((level, price)))
            if level < old_level || level == old_level && price < old_price * (1.0 - SAME_SHARE) =>
        {
            new
        }
        _ => old.to_owned(),
    })
}

fn row(arm: &RobotModel, asked: &Asked, table: &Index, index: u64) -> String {
    let target = target(arm, asked.range_m, index);
    let head = format!("{index},{},{},{}", target.x, target.y, target.z);
    let usual = Budget { seed: asked.seed ^ index << 20, ..Budget::default() };
    let budget = asked.starts.map_or(usual, |starts| Budget { starts, all: true, ..usual });
    let none = format!("{head},,,{},0,0,", 3 * budget.starts);
    let request = Request { target, options: &Options::best(), kept: Kept::default(), quick: None, budget };
    let Ok(answer) = request.search(arm, table, &Watch::default()) else { return none };
    let (level, best) = (answer.given_up as usize, answer.best);
    let (price, hits) = (best.found.objective, best.confidence.at_best);
    let throw = throw_column(&best.found.throw);
    let line = format!("{head},{level},{price},{},{},{hits},{throw}", best.starts, best.solved);
    match Row::read(&line).and_then(|row| judge(arm, &row, level)) {
        Ok(_) => line,
        Err(why) => {
            eprintln!("row {index}: the verifier refuses the throw that was found: {why}");
            none
        }
    }
}

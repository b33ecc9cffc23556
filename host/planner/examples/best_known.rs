//! Best known throws to random targets by very many random starts, without any stored throw: what a search is measured
//! against.
//!
//! ```text
//! cargo run --release -p planner --example best_known -- ROBOT FILE [TARGETS] [STARTS] [RANGE_MIN,RANGE_MAX] [SEED]
//! ```
//!
//! One row per target, in order. A file that is there is continued: rows that are in it are not computed again.
//! A target without a throw under every limit of the default form is tried without limits of the landing's shift, then
//! without nulling; `rung` says which of the three it was, and is empty where none of the starts ended in a throw.

use std::error::Error;
use std::f64::consts::PI;
use std::fs::OpenOptions;
use std::io::Write;

use nalgebra::Vector3;
use planner::plan::ladder::rungs;
use planner::plan::rng::SplitMix64;
use planner::plan::search::{Budget, Planner, Watch};
use planner::plan::{Kept, Options, Problem};
use planner::store::Index;
use robot_model::{AnyRobot, RobotModel, for_any_robot};

const HEADER: &str = "index,x_m,y_m,z_m,rung,objective,starts,solved,at_best";
/// Heights of the targets above the floor, in m.
const HEIGHT_M: [f64; 2] = [0.0, 1.5];

/// What is asked for, in the order of the command line.
struct Asked {
    targets: u64,
    starts: usize,
    range_m: [f64; 2],
    seed: u64,
}

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [robot, file, rest @ ..] = &args[..] else {
        return Err("expected ROBOT FILE [TARGETS] [STARTS] [RANGE_MIN,RANGE_MAX] [SEED]".into());
    };
    let text = |i: usize, default: &str| rest.get(i).cloned().unwrap_or_else(|| default.to_owned());
    let range = text(2, "0.4,4.2");
    let (near, far) = range.split_once(',').ok_or("a range is two numbers with a comma between")?;
    let asked = Asked {
        targets: text(0, "200").parse()?,
        starts: text(1, "2000").parse()?,
        range_m: [near.parse()?, far.parse()?],
        seed: text(3, "1").parse()?,
    };
    let robot = AnyRobot::load(robot)?;
    for_any_robot!(&robot, arm => fill(arm, file, &asked))
}

/// Target number `index` above an arm: range and height uniform, any azimuth.
fn target<const N: usize>(arm: &RobotModel<N>, asked: &Asked, index: u64) -> Vector3<f64> {
    let mut rng = SplitMix64::stream(asked.seed, index);
    let azimuth_rad = (rng.unit() * 2.0 - 1.0) * PI;
    let range_m = asked.range_m[0] + (asked.range_m[1] - asked.range_m[0]) * rng.unit();
    let height_m = HEIGHT_M[0] + (HEIGHT_M[1] - HEIGHT_M[0]) * rng.unit();
    Vector3::new(range_m * azimuth_rad.cos(), range_m * azimuth_rad.sin(), arm.world().floor_z_m + height_m)
}

fn fill<const N: usize>(arm: &RobotModel<N>, file: &str, asked: &Asked) -> Result<(), Box<dyn Error>> {
    let before = std::fs::read_to_string(file).unwrap_or_default();
    // A torn last line is computed again.
    let whole = before.rfind('\n').map_or("", |end| &before[..=end]);
    let done = whole.lines().skip(1).count() as u64;
    let mut out = OpenOptions::new().create(true).write(true).truncate(true).open(file)?;
    out.write_all(if whole.is_empty() { format!("{HEADER}\n") } else { whole.to_owned() }.as_bytes())?;
    for index in done..asked.targets {
        writeln!(out, "{}", row(arm, asked, index))?;
    }
    Ok(())
}

fn row<const N: usize>(arm: &RobotModel<N>, asked: &Asked, index: u64) -> String {
    let at = target(arm, asked, index);
    let head = format!("{index},{},{},{}", at.x, at.y, at.z);
    for (given_up, options) in rungs(&Options::best(), Kept::default()) {
        let Ok(problem) = Problem::new(arm, at, options) else { continue };
        let rung = given_up as usize;
        let budget = Budget { starts: asked.starts, all: true, time: None, seed: asked.seed ^ index << 20 };
        if let Ok(best) = Planner::new(&problem).attempt(&Index::default(), &budget, &Watch::default()) {
            let (price, hits) = (best.found.objective, best.confidence.at_best);
            return format!("{head},{rung},{price},{},{},{hits}", best.starts, best.solved);
        }
    }
    format!("{head},,,{},0,0", 3 * asked.starts)
}

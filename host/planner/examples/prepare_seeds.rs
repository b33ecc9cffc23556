//! Makes the table of stored throws of a robot, such as those in `host/planner/seeds`.
//!
//! ```text
//! cargo run --release -p planner --example prepare_seeds -- ROBOT OUT.seeds [NAME=VALUE ...]
//! ```
//!
//! Names: `form` (`best` or `paper`), `step_m`, `range_max_m`, `height_max_m`, `starts`, `sweeps`, `trials`,
//! `seed`. Throws of other forms in OUT are kept. The same arguments give the same table.

use std::error::Error;
use std::path::Path;

use planner::plan::prepare::{Grid, Preparation};
use planner::plan::relaxation::levels;
use planner::plan::search::kind_of;
use planner::plan::{Kept, Options};
use planner::store::{file, robot_fingerprint};
use robot_model::RobotModel;

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [robot, out, words @ ..] = &args[..] else {
        return Err("expected ROBOT OUT.seeds [NAME=VALUE ...]".into());
    };
    let mut options = Options::best();
    let mut seed = 1;
    let mut grid = Grid {
        step_m: 0.1,
        range_max_m: 6.0,
        height_max_m: 0.9,
        starts: 10,
        keep: 3,
        sweeps: 3,
        trials: 1024,
    };
    for word in words {
        let (name, value) = word.split_once('=').ok_or("expected NAME=VALUE")?;
        match name {
            "form" if value == "paper" => options = Options::paper(),
            "form" if value == "best" => options = Options::best(),
            "step_m" => grid.step_m = value.parse()?,
            "range_max_m" => grid.range_max_m = value.parse()?,
            "height_max_m" => grid.height_max_m = value.parse()?,
            "starts" => grid.starts = value.parse()?,
            "sweeps" => grid.sweeps = value.parse()?,
            "trials" => grid.trials = value.parse()?,
            "seed" => seed = value.parse()?,
            _ => return Err(format!("{word}: not a name and value that this example knows").into()),
        }
    }
    let robot = RobotModel::load(robot)?;
    make(&robot, Path::new(out), &options, grid, seed)
}

fn make(
    arm: &RobotModel,
    out: &Path,
    options: &Options,
    grid: Grid,
    seed: u64,
) -> Result<(), Box<dyn Error>> {
    // The easiest set of options first: throws to it are starts for the others.
    let sets: Vec<Options> =
        levels(options, Kept::default()).into_iter().rev().map(|(_, options)| options).collect();
    let kinds: Vec<u32> = sets.iter().map(kind_of).collect();
    let robot = robot_fingerprint(arm);
    let mut all = match std::fs::read(out) {
        Ok(bytes) => {
            file::parse(&bytes, robot, arm.n()).ok_or("OUT is not a table of this robot: remove it")?
        }
        Err(_) => Vec::new(),
    };
    all.retain(|record| !kinds.contains(&record.kind));
    let preparation = Preparation::new(arm, sets, grid, seed);
    let mut made = Vec::new();
    for step in 0..preparation.steps() {
        made = preparation.step(step, made, &|| false).ok_or("stopped")?;
        println!("step {} of {}: {} throws", step + 1, preparation.steps(), made.len());
    }
    all.extend(made);
    file::write_whole(out, &file::to_bytes(robot, &all))?;
    println!("{} throws in {}", all.len(), out.display());
    Ok(())
}

//! Quality and speed of the default search, compared with best known throws (see the example `best_known`).
//!
//! ```text
//! cargo run --release -p planner --example search_quality -- ROBOT BEST_KNOWN.csv [SEEDS] [TARGETS] [TABLE]
//! ```
//!
//! For every target with a throw in the file: the search as `plan throw` makes it, through the same relaxation
//! levels, with a table of stored throws (by default the one that comes with the program), and without a table.
//! Times are CPU time of one core.

use std::error::Error;
use std::time::Duration;

use nalgebra::Vector3;
use nix::time::{ClockId, clock_gettime};
use planner::plan::seeds::built_in;
use planner::plan::{Budget, Kept, Options, Watch};
use planner::request::Request;
use planner::store::{Index, file, robot_fingerprint};
use robot_model::RobotModel;

#[path = "../benches/best_known/rows.rs"]
#[allow(dead_code, reason = "other examples use the rest")]
mod rows;
use rows::Row;

/// A target with the best throw that is known.
struct Known {
    target: Vector3<f64>,
    /// Relaxation level.
    level: usize,
    objective: f64,
}

/// What one way of searching made of all targets.
#[derive(Default)]
struct Result {
    /// Share of the price above the best known one, where the same limits were kept.
    gaps: Vec<f64>,
    /// Fewer limits kept than the best known throw keeps, and more.
    relaxed: usize,
    stricter: usize,
    refused: usize,
    seconds: Vec<f64>,
    /// Targets whose throw is dearer than the best known one by 1 %, or keeps less.
    lost: Vec<String>,
}

fn main() -> std::result::Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [robot, file, rest @ ..] = &args[..] else {
        return Err("expected ROBOT BEST_KNOWN.csv [SEEDS] [TARGETS] [TABLE]".into());
    };
    let number = |i: usize, default: u64| rest.get(i).map_or(Ok(default), |text| text.parse());
    let (seeds, targets) = (number(0, 1)?, number(1, u64::MAX)?);
    let all = Row::read_all(&std::fs::read_to_string(file)?)?;
    let drawn = all.len();
    let known = all.iter().filter_map(|row| {
        let (level, objective) = row.known?;
        Some(Known { target: row.target, level, objective })
    });
    let known: Vec<Known> = known.take(targets as usize).collect();
    println!("{robot}: {} of {drawn} targets have a known throw", known.len());
    for within_m in [2.2, 4.2, f64::INFINITY] {
        let near: Vec<&Known> = known.iter().filter(|k| k.target.xy().norm() <= within_m).collect();
        let kept = near.iter().filter(|k| k.level == 0).count();
        println!("  to {within_m} m: {kept} of {} keep both limits of the landing's shift", near.len());
    }
    // Times are those of one core.
    rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build_global()?;
    let robot = RobotModel::load(robot)?;
    let table = match rest.get(2) {
        Some(path) => {
            let records = file::parse(&std::fs::read(path)?, robot_fingerprint(&robot), robot.n());
            Index::new(records.ok_or("not a table of this robot")?)
        }
        None => built_in(&robot),
    };
    of_arm(&robot, &known, &table, seeds);
    Ok(())
}

fn of_arm(arm: &RobotModel, known: &[Known], table: &Index, seeds: u64) {
    let (of_table, none) = ((arm, table), (arm, &Index::default()));
    if !table.records().is_empty() {
        for seed in 1..=seeds {
            print(&format!("search with the table, seed {seed}"), &judge(known, of_table, seed));
        }
    }
    for seed in 1..=seeds {
        print(&format!("search without a table, seed {seed}"), &judge(known, none, seed));
    }
}

fn judge(known: &[Known], (arm, table): (&RobotModel, &Index), seed: u64) -> Result {
    let (options, watch) = (Options::best(), Watch::default());
    let budget = Budget { seed, ..Budget::default() };
    let mut result = Result::default();
    for k in known {
        let began = cpu();
        let request =
            Request { target: k.target, options: &options, kept: Kept::default(), quick: None, budget };
        let answer = request.search(arm, table, &watch).ok();
        let found = answer.map(|answer| (answer.given_up as usize, answer.best.found.objective));
        result.seconds.push((cpu() - began).as_secs_f64());
        let lost = match found {
            None => Some("refused".to_owned()),
            Some((level, _)) if level > k.level => {
                Some(format!("relaxation level {level} instead of {}", k.level))
            }
            Some((level, objective)) if level == k.level && objective > 1.01 * k.objective => {
                Some(format!("{objective:.4} instead of {:.4}", k.objective))
            }
            Some(_) => None,
        };
        let [x, y, z] = k.target.into();
        result.lost.extend(lost.map(|why| format!("{x},{y},{z}: {why}")));
        match found {
            None => result.refused += 1,
            Some((level, _)) if level > k.level => result.relaxed += 1,
            Some((level, _)) if level < k.level => result.stricter += 1,
            Some((_, objective)) => result.gaps.push(objective / k.objective - 1.0),
        }
    }
    result.gaps.sort_by(f64::total_cmp);
    result.seconds.sort_by(f64::total_cmp);
    result
}

fn print(what: &str, r: &Result) {
    r.lost.iter().for_each(|line| println!("    {line}"));
    let quantile = |sorted: &[f64], share: f64| {
        let at = ((sorted.len().max(1) - 1) as f64 * share).round() as usize;
        sorted.get(at).copied().unwrap_or(f64::NAN)
    };
    let within = |share: f64| r.gaps.iter().filter(|g| **g <= share).count();
    println!(
        "  {what}: {} within 1 %, {} within 2 %, {} above, {} relaxed, {} refused, {} under more limits; gap best {:.2} %, median {:.3} %, worst {:.2} %; {} better by 0.1 %; CPU time p50 {:.2} ms, p99 {:.2} ms, mean {:.2} ms",
        within(0.01),
        within(0.02),
        r.gaps.len() - within(0.02),
        r.relaxed,
        r.refused,
        r.stricter,
        1e2 * quantile(&r.gaps, 0.0),
        1e2 * quantile(&r.gaps, 0.5),
        1e2 * quantile(&r.gaps, 1.0),
        r.gaps.iter().filter(|g| **g < -1e-3).count(),
        1e3 * quantile(&r.seconds, 0.5),
        1e3 * quantile(&r.seconds, 0.99),
        1e3 * r.seconds.iter().sum::<f64>() / r.seconds.len().max(1) as f64,
    );
}

fn cpu() -> Duration {
    clock_gettime(ClockId::CLOCK_PROCESS_CPUTIME_ID).map_or(Duration::ZERO, Duration::from)
}

//! How late or early a gripper may open, by the distance of the target, and which limits bound that.
//!
//! ```text
//! cargo run --release -p planner --example release_window -- ROBOT BEST_KNOWN.csv [STEP]
//! ```
//!
//! For one target in STEP of the file that has a throw with nulling: the widest window over which the landing moves by at most
//! [`SHIFT_M`], by local solves from that throw with wider and wider windows, and the limits that the last throw is at.

use std::collections::BTreeMap;
use std::error::Error;

use planner::plan::{DelayWindow, Margins, Options, Planner, Problem, Throw};
use robot_model::{JointVec, RobotModel};

#[path = "../benches/best_known/rows.rs"]
#[allow(dead_code, reason = "other examples use the rest")]
mod rows;
use rows::Row;

/// Largest shift of the landing, as the default options have it for 25 ms.
const SHIFT_M: f64 = 0.010;
/// First window and first step in s; a step that fails is halved down to the last one.
const FIRST_S: f64 = 0.002;
const STEP_S: f64 = 0.004;
const LAST_STEP_S: f64 = 1.25e-4;
/// The planner takes no wider one.
const WIDEST_S: f64 = 0.1;
/// Width of a row of the table in m.
const BIN_M: f64 = 0.4;
/// A limit of which less than this share is left counts as reached.
const REACHED_SHARE: f64 = 2e-3;

/// Targets of one row of the table.
#[derive(Default)]
struct Bin {
    widths_s: Vec<f64>,
    /// How many throws are at a limit.
    reached: BTreeMap<&'static str, usize>,
}

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [robot, file, rest @ ..] = &args[..] else {
        return Err("expected ROBOT BEST_KNOWN.csv [STEP]".into());
    };
    let step = rest.first().map_or(Ok(1), |text| text.parse())?;
    let arm = RobotModel::load(robot)?;
    let mut bins = BTreeMap::<i64, Bin>::new();
    let rows = Row::read_all(&std::fs::read_to_string(file)?)?;
    for row in rows.iter().filter(|row| row.known.is_some_and(|(level, _)| level < 2)).step_by(step) {
        let throw = row.throw(arm.n()).ok_or("a row without a throw")?;
        let Some((width_s, throw)) = widest(&arm, row, &throw)? else { continue };
        let bin = bins.entry((row.target.xy().norm() / BIN_M) as i64).or_default();
        bin.widths_s.push(width_s);
        for limit in reached(&arm, row, width_s, &throw)? {
            *bin.reached.entry(limit).or_default() += 1;
        }
    }
    for (number, mut bin) in bins {
        bin.widths_s.sort_by(f64::total_cmp);
        let n = bin.widths_s.len();
        let at_m = number as f64 * BIN_M;
        let wide = bin.widths_s.iter().filter(|w| **w >= 0.025).count();
        let quantile = |share: f64| 1e3 * bin.widths_s[((n - 1) as f64 * share).round() as usize];
        let reached: Vec<String> =
            bin.reached.iter().map(|(limit, count)| format!("{limit} {}", 100 * count / n)).collect();
        println!(
            "{at_m:.1} to {:.1} m: {n} targets, 25 ms for {wide}; window in ms p10 {:.1}, median {:.1}, p90 {:.1}; at a limit in %: {}",
            at_m + BIN_M,
            quantile(0.1),
            quantile(0.5),
            quantile(0.9),
            reached.join(", ")
        );
    }
    Ok(())
}

fn problem<'a>(arm: &'a RobotModel, row: &Row, delay_s: f64) -> Result<Problem<'a>, Box<dyn Error>> {
    let delay_windows = vec![DelayWindow { delay_s, shift_m: SHIFT_M }];
    Ok(Problem::new(arm, row.target, Options { delay_windows, ..Options::best() })?)
}

/// The widest window with its throw; `None` if there is no throw even with the first one.
fn widest(arm: &RobotModel, row: &Row, known: &Throw) -> Result<Option<(f64, Throw)>, Box<dyn Error>> {
    let solved = |delay_s: f64, from: &Throw| -> Result<Option<Throw>, Box<dyn Error>> {
        let problem = problem(arm, row, delay_s)?;
        let planner = Planner::new(&problem).persistent();
        let found = planner.from_throw(from).or_else(|| planner.from_throw(known));
        Ok(found.map(|found| found.throw))
    };
    let Some(mut throw) = solved(FIRST_S, known)? else { return Ok(None) };
    let (mut width_s, mut step_s) = (FIRST_S, STEP_S);
    while step_s >= LAST_STEP_S && width_s + step_s <= WIDEST_S {
        match solved(width_s + step_s, &throw)? {
            Some(wider) => (width_s, throw) = (width_s + step_s, wider),
            None => step_s *= 0.5,
        }
    }
    Ok(Some((width_s, throw)))
}

/// Kinds of limits that a throw is at.
fn reached(
    arm: &RobotModel,
    row: &Row,
    delay_s: f64,
    throw: &Throw,
) -> Result<Vec<&'static str>, Box<dyn Error>> {
    let problem = problem(arm, row, delay_s)?;
    let o = Options::best();
    let left = Margins::of(&problem, throw);
    let least = |v: &JointVec| v.iter().copied().fold(f64::INFINITY, f64::min);
    let motor = left.motor.as_ref().map_or(f64::INFINITY, least);
    let supply = left.supply.iter().copied().fold(f64::INFINITY, f64::min);
    let wrist = JointVec::from_slice(&left.speed[3..]);
    let main = JointVec::from_slice(&left.speed[..3]);
    let all = [
        ("range", least(&left.position_rad) - o.range_margin_rad),
        ("speed of joints 1 to 3", least(&main) - (1.0 - o.speed_use)),
        ("speed of the wrist", least(&wrist) - (1.0 - o.speed_use)),
        ("acceleration", least(&left.acceleration) - (1.0 - o.acceleration_use)),
        ("jerk", least(&left.jerk)),
        ("motor current at the release", motor),
        ("supply current at the release", supply),
    ];
    Ok(all.into_iter().filter(|(_, spare)| *spare < REACHED_SHARE).map(|(name, _)| name).collect())
}

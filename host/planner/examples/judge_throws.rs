//! Judges throws from any source to the targets of the benchmark: whether they are valid, and how far above the best known
//! price.
//!
//! ```text
//! cargo run --release -p planner --example judge_throws -- ROBOT THROWS.csv [BEST_KNOWN.csv]
//! ```
//!
//! `THROWS.csv` has the columns of a file of best known throws (`benches/best_known/rows.rs`), one row per target,
//! in the order of the targets, and a throw in each row that has a relaxation level (column `level`). The program makes a
//! plan of each throw, and the verifier checks it under the limits of that level. The verifier has its own code for
//! limits, currents, clearances and the flight. The price is computed from the throw. The program ends with an
//! error if a throw is not valid, or if its price is not the one in the file.

use std::error::Error;

use robot_model::RobotModel;

#[path = "../benches/best_known/judge.rs"]
mod judge;
#[path = "../benches/best_known/rows.rs"]
#[allow(dead_code, reason = "other examples use the rest")]
mod rows;
use judge::judge;
use rows::Row;

/// A stated price may differ from the computed one by this share: the throws of a file are rounded.
const TOLD_SHARE: f64 = 1e-6;

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [robot, file, rest @ ..] = &args[..] else {
        return Err("expected ROBOT THROWS.csv [BEST_KNOWN.csv]".into());
    };
    let theirs = Row::read_all(&std::fs::read_to_string(file)?)?;
    let known = match rest.first() {
        Some(path) => Row::read_all(&std::fs::read_to_string(path)?)?,
        None => theirs.clone(),
    };
    if theirs.len() != known.len() || theirs.iter().zip(&known).any(|(a, b)| a.target != b.target) {
        return Err("the two files are not for the same targets in the same order".into());
    }
    let robot = RobotModel::load(robot)?;
    judge_all(&robot, &theirs, &known)
}

fn judge_all(arm: &RobotModel, theirs: &[Row], known: &[Row]) -> Result<(), Box<dyn Error>> {
    let (mut invalid, mut missing, mut relaxed, mut stricter) = (0, 0, 0, 0);
    let mut gaps: Vec<f64> = Vec::new();
    for (index, (row, best)) in theirs.iter().zip(known).enumerate() {
        let Some((level, reported)) = row.known else {
            missing += usize::from(best.known.is_some());
            continue;
        };
        let price = match judge(arm, row, level) {
            Ok(price) if (price / reported - 1.0).abs() <= TOLD_SHARE => price,
            Ok(price) => {
                println!("row {index}: its price is {price}, not {reported}");
                invalid += 1;
                continue;
            }
            Err(why) => {
                println!("row {index}: {why}");
                invalid += 1;
                continue;
            }
        };
        match best.known {
            Some((best_level, _)) if level > best_level => relaxed += 1,
            Some((best_level, best_price)) if level == best_level => gaps.push(price / best_price - 1.0),
            _ => stricter += 1,
        }
    }
    gaps.sort_by(f64::total_cmp);
    let quantile = |share: f64| {
        gaps.get(((gaps.len().max(1) - 1) as f64 * share).round() as usize).map_or(f64::NAN, |gap| 1e2 * gap)
    };
    println!(
        "{} of {} targets have a valid throw: {} at the level of the best known one ({} within 2 %; gap median {:.3} %, p99 {:.2} %, worst {:.2} %), {relaxed} keep less, {stricter} keep more; {missing} missing",
        gaps.len() + relaxed + stricter,
        theirs.len(),
        gaps.len(),
        gaps.iter().filter(|gap| **gap <= 0.02).count(),
        quantile(0.5),
        quantile(0.99),
        quantile(1.0),
    );
    if invalid > 0 {
        return Err(format!("{invalid} throws are not what their rows say").into());
    }
    Ok(())
}

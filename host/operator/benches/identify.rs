//! Identification measured: how often the stated interval holds the constant that the simulator was given, and
//! whether the estimates lie evenly about it.
//!
//! `cargo bench -p operator --bench identify [-- SEEDS [JOINT ...]]`, 100 seeds and every joint by default. SEEDS is a number or a
//! range as `200..400`: what was suspected on some seeds is to be confirmed on others. Each seed is one whole
//! `cubectl arm identify` on the simulated cell, in virtual time. Prints a table; nothing is asserted.

use std::ops::Range;
use std::time::Instant;

use operator::bus::BusArgs;
use operator::bus::args::CellArgs;
use operator::identify::experiment::Bounds;
use operator::identify::joint::{JointExperiments, identify};
use operator::identify::mounting::Mounting;
use rayon::prelude::*;
use robot_model::RobotModel;
use tuner::identify::current::CurrentConstant;
use tuner::identify::regression::Estimate;

const LEVEL: f64 = 0.95;
const NOISE_A: f64 = 0.05;
/// K_B and K_M of each joint's drive, Table III. Where gravity loads a joint too little, K_M is not measured.
const DRIVES: [(f64, f64); 6] = [
    (2.9116, 0.1419),
    (2.9116, 0.1419),
    (2.9116, 0.1419),
    (0.7347, 0.0567),
    (0.4871, 0.013),
    (0.1572, 0.025),
];

/// What one seed brought: K_B and K_M, where they were concluded; `None` for a refusal.
#[derive(Clone, Copy, Default)]
struct Run {
    k_b: Option<Estimate>,
    /// `Some(None)`: loads were measured and the conclusion refused.
    k_m: Option<Option<Estimate>>,
}

fn one(robot: &RobotModel, joint: usize, seed: u64) -> Option<Run> {
    let mut cell = CellArgs { seed: Some(seed), ..CellArgs::default() }.load().ok()?;
    cell.setup.cell.drive.starts_homed = true;
    cell.setup.cell.drive.current_noise_a = NOISE_A;
    let mut session = BusArgs::default().open_cell(&cell, None).ok()?;
    let bounds = Bounds { current_share: 0.8, speed_share: 0.8, bit_rate_bit_s: 1e6 };
    let found = identify(
        &mut session,
        robot,
        &Mounting::assumed(),
        &JointExperiments { joint, bounds, level: LEVEL },
        &mut |_, _| {},
    )
    .ok()?;
    let of = |constant: CurrentConstant| constant.k;
    Some(Run { k_b: found.k_b.ok().map(of), k_m: found.k_m.map(|k_m| k_m.ok().map(of)) })
}

/// One row of the table: `asked` runs, of which these concluded.
fn row(joint: usize, name: &str, truth: f64, asked: usize, found: &[Estimate]) {
    if asked == 0 {
        println!("| {joint} | {name} | not loaded | | | | | |");
        return;
    }
    let n = found.len().max(1) as f64;
    let covered = found.iter().filter(|e| e.covers(truth)).count();
    let sigma = (LEVEL * (1.0 - LEVEL) * n).sqrt();
    let mean = found.iter().map(|e| e.value).sum::<f64>() / n;
    let scatter = (found.iter().map(|e| (e.value - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0)).sqrt();
    let width = found.iter().map(|e| e.half_width).sum::<f64>() / n;
    let percent = |x: f64| 100.0 * x / truth;
    println!(
        "| {joint} | {name} | {}/{asked} | {covered} | {:.0} +- {:.1} | {:+.3} +- {:.3} | {:.3} | {:.3} |",
        found.len(),
        LEVEL * n,
        2.0 * sigma,
        percent(mean - truth),
        percent(2.0 * scatter / n.sqrt()),
        percent(scatter),
        percent(width)
    );
}

/// `N` or `FROM..TO`.
fn seeds(text: &str) -> Range<u64> {
    let (from, to) = text.split_once("..").unwrap_or(("0", text));
    match (from.parse(), to.parse()) {
        (Ok(from), Ok(to)) => from..to,
        _ => panic!("seeds are a number or a range as 200..400, not {text:?}"),
    }
}

fn main() {
    let mut arguments = std::env::args().skip(1).filter(|a| a.starts_with(|c: char| c.is_ascii_digit()));
    let seeds = seeds(&arguments.next().unwrap_or_else(|| "100".to_owned()));
    let joints: Vec<usize> = arguments.filter_map(|a| a.parse().ok()).collect();
    let wanted = |joint: usize| joints.is_empty() || joints.contains(&joint);
    let robot = match RobotModel::load("powercube6") {
        Ok(robot) => robot,
        Err(error) => panic!("built-in robot: {error}"),
    };
    println!("seeds {seeds:?}, noise {NOISE_A} A per reading, intervals of {:.0} %", 100.0 * LEVEL);
    println!(
        "| joint | constant | concluded | interval holds the truth | expected (2 sigma) | bias % (2 sigma) | scatter % | \
         half width % |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    let start = Instant::now();
    let mut lost = 0;
    for (joint, (k_b, k_m)) in (1..).zip(DRIVES).filter(|(joint, _)| wanted(*joint)) {
        let runs: Vec<Run> =
            seeds.clone().into_par_iter().filter_map(|seed| one(&robot, joint, seed)).collect();
        lost += seeds.clone().count() - runs.len();
        let found: Vec<Estimate> = runs.iter().filter_map(|r| r.k_b).collect();
        row(joint, "K_B", k_b, runs.len(), &found);
        let loaded: Vec<Option<Estimate>> = runs.iter().filter_map(|r| r.k_m).collect();
        let found: Vec<Estimate> = loaded.iter().copied().flatten().collect();
        row(joint, "K_M", k_m, loaded.len(), &found);
    }
    println!("experiments that did not end: {lost}; {:.1} s", start.elapsed().as_secs_f64());
}

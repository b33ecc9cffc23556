//! Identification measured: how often the stated interval holds the constant that the simulator was given.
//!
//! `cargo bench -p host --bench identify [-- SEEDS]`, 100 seeds by default. Prints a table; nothing is asserted.

use std::time::Instant;

use host::bus::BusArgs;
use host::bus::args::CellArgs;
use host::identify::experiment::Bounds;
use host::identify::joint::{Wish, identify};
use rayon::prelude::*;
use robot_model::AnyRobot;

const LEVEL: f64 = 0.95;
const NOISE_A: f64 = 0.05;
/// Joint, K_B and K_M of Table III. Joints 1, 5 and 6 carry no load that could be measured.
const JOINTS: [(usize, f64, Option<f64>); 3] =
    [(2, 2.9116, Some(0.1419)), (4, 0.7347, Some(0.0567)), (6, 0.1572, None)];

/// Per seed: K_B covered and its relative half width, the same for K_M.
type Row = (Option<(bool, f64)>, Option<(bool, f64)>);

fn one(robot: &AnyRobot, joint: usize, truth: (f64, Option<f64>), seed: u64) -> Row {
    let loaded = CellArgs { seed: Some(seed), ..CellArgs::default() }.load();
    let Ok(mut cell) = loaded else { return (None, None) };
    cell.setup.cell.drive.starts_homed = true;
    cell.setup.cell.drive.current_noise_a = NOISE_A;
    let Ok(mut session) = BusArgs::default().open_cell(&cell, None) else { return (None, None) };
    let bounds = Bounds { current_share: 0.8, speed_share: 0.8, bit_rate_bit_s: 1e6 };
    let wish = Wish { joint, bounds, level: LEVEL };
    let Ok(found) = identify(&mut session, robot, &wish, &mut |_, _| {}) else { return (None, None) };
    let b = found.k_b.ok().map(|k| (k.k.covers(truth.0), k.k.half_width / k.k.value));
    let m = match (found.k_m, truth.1) {
        (Some(Ok(k)), Some(truth)) => Some((k.k.covers(truth), k.k.half_width / k.k.value)),
        _ => None,
    };
    (b, m)
}

fn main() {
    let seeds = std::env::args().filter_map(|a| a.parse::<u64>().ok()).next().unwrap_or(100);
    let robot = match AnyRobot::load("powercube6") {
        Ok(robot) => robot,
        Err(error) => panic!("built-in robot: {error}"),
    };
    println!("{seeds} seeds, noise {NOISE_A} A per reading, intervals of {:.0} %", 100.0 * LEVEL);
    println!("| joint | constant | concluded | interval holds the truth | expected | mean half width |");
    println!("|---|---|---|---|---|---|");
    let start = Instant::now();
    for (joint, k_b, k_m) in JOINTS {
        let rows: Vec<Row> =
            (0..seeds).into_par_iter().map(|seed| one(&robot, joint, (k_b, k_m), seed)).collect();
        for (name, cells) in [
            ("K_B", rows.iter().filter_map(|r| r.0).collect::<Vec<_>>()),
            ("K_M", rows.iter().filter_map(|r| r.1).collect()),
        ] {
            if name == "K_M" && k_m.is_none() {
                continue;
            }
            let (n, covered) = (cells.len(), cells.iter().filter(|c| c.0).count());
            let expected = LEVEL * n as f64;
            let sigma = (expected * (1.0 - LEVEL)).sqrt();
            let width = cells.iter().map(|c| c.1).sum::<f64>() / n.max(1) as f64;
            println!(
                "| {joint} | {name} | {n}/{seeds} | {covered} | {expected:.0} +- {:.1} (2 sigma) | {:.2} % |",
                2.0 * sigma,
                100.0 * width
            );
        }
    }
    println!("{:.1} s", start.elapsed().as_secs_f64());
}

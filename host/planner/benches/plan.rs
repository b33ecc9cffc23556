//! Figures of the throw planner: `cargo bench -p planner --bench plan [-- section …]`.
//!
//! Sections: `parts`, `starts`, `cold`, `targets`, `best`, `tail`, `store`, `delay`, `landing`, `spread`, `reach`; all without
//! arguments. Times are CPU time of one thread, so that other work on the machine counts less; targets and starts
//! follow from the seeds below. `PLAN_BENCH_NAME=n` makes a section shorter or longer (`STARTS`, `COLD`, `TARGETS`, `BEST`,
//! `TAIL`, `DELAY`, `DRAWS`, `SPREAD`, `FREE`, `REFERENCE_STARTS`); `PLAN_BENCH_WORST=1` lists the worst targets.
//!
//! The section `arms` (only when named) prints how often throws of other arms are found.
//!
//! The targets and their reference objectives are in `plan_targets.csv` (the planner was tuned with them) and
//! `plan_targets_held_out.csv` (it was not). The sections `reference` and `reference-held-out` (only when named)
//! make the files again: a target is in reach if a multi-start without a table finds a throw to it, or the table
//! does.

#[path = "plan/arms.rs"]
mod arms;
#[path = "plan/landing.rs"]
mod landing;
#[path = "plan/reach.rs"]
mod reach;
#[path = "plan/speed.rs"]
mod speed;

use std::time::{Duration, Instant};

use nalgebra::Vector3;
use nix::time::{ClockId, clock_gettime};
use planner::plan::rng::SplitMix64;
use planner::plan::{Arm, seeds};

/// Seeds of the targets: range 0.4 to 2.2 m, height -1 to 0.5 m, any azimuth, uniform.
const TARGET_SEED: u64 = 77;
const HELD_OUT_SEED: u64 = 78;
/// Seed of the random starts.
const START_SEED: u64 = 3;
/// Local solves from stored throws in the first pass.
const TRIES: usize = 6;

fn cpu() -> Duration {
    clock_gettime(ClockId::CLOCK_THREAD_CPUTIME_ID).map_or(Duration::ZERO, Duration::from)
}

fn timed<T>(work: impl FnOnce() -> T) -> (T, f64) {
    let began = cpu();
    let out = work();
    (out, (cpu() - began).as_secs_f64())
}

fn quantile(sorted: &[f64], share: f64) -> f64 {
    sorted.get(((sorted.len().max(1) - 1) as f64 * share).round() as usize).copied().unwrap_or(f64::NAN)
}

fn target(seed: u64, index: u64) -> Vector3<f64> {
    let mut rng = SplitMix64::stream(seed, index);
    let azimuth = (rng.unit() * 2.0 - 1.0) * std::f64::consts::PI;
    let (range, z) = (0.4 + 1.8 * rng.unit(), -1.0 + 1.5 * rng.unit());
    Vector3::new(range * azimuth.cos(), range * azimuth.sin(), z)
}

/// A number from the environment, for shorter or longer runs.
fn count(name: &str, default: u64) -> u64 {
    let key = format!("PLAN_BENCH_{}", name.to_uppercase());
    std::env::var(key).ok().and_then(|v| v.parse().ok()).unwrap_or(default)
}

fn main() {
    let wanted: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with('-')).collect();
    let named = |name: &str| wanted.iter().any(|w| w == name);
    let run = |name: &str| wanted.is_empty() || named(name) || named("all");
    let arm = Arm::load("powercube6").expect("built in");
    let index = seeds::built_in(&arm);
    println!("{} built-in throws; times are CPU time of one thread", index.records().len());
    let section = |name: &str, work: &dyn Fn()| {
        if run(name) {
            let began = Instant::now();
            work();
            println!("  [{name}: {:.1} s]", began.elapsed().as_secs_f64());
        }
    };
    section("parts", &|| speed::parts(&arm));
    section("starts", &|| speed::starts(&arm, count("starts", 400)));
    section("cold", &|| speed::cold(&arm, count("cold", 100)));
    section("targets", &|| {
        for set in [speed::TUNED, speed::HELD_OUT] {
            speed::targets(&arm, &index, &set, count("targets", 1000) as usize);
        }
    });
    section("best", &|| speed::best_form(&arm, &index, count("best", 60) as usize));
    for (name, set) in [("reference", speed::TUNED), ("reference-held-out", speed::HELD_OUT)] {
        if named(name) {
            let (targets, starts) = (count("targets", 1000) as usize, count("reference_starts", 64));
            speed::reference(&arm, &index, &set, targets, starts);
        }
    }
    section("tail", &|| speed::tail(&arm, &index, count("tail", 2) as usize));
    section("store", &|| speed::store(&arm, &index));
    section("delay", &|| landing::delay(&arm, &index, count("delay", 30)));
    section("landing", &|| landing::landing_statistics(&arm, &index, 20, count("draws", 100_000) as usize));
    section("spread", &|| landing::spread(&arm, &index, count("spread", 6)));
    if named("arms") {
        section("arms", &|| arms::arms(count("arms", 40), count("reference_starts", 500) as usize));
    }
    section("reach", &|| {
        reach::free_spin(&arm, &index, count("free", 320) as usize);
        reach::reach(&arm, &index);
    });
}

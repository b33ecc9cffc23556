//! `hil-sim swarm --seeds N`: many random situations.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Instant as WallClock;

use hil_sim::scenario::Scenario;
use hil_sim::scenario::build::limits_of;
use hil_sim::swarm::{self, SeedResult};
use protocol::Duration;
use rayon::prelude::*;

use super::exit::{Code, Failure};
use super::progress::{self, Interrupt};

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Number of seeds.
    #[arg(long, default_value_t = 100)]
    seeds: u64,
    /// First seed.
    #[arg(long, default_value_t = 0)]
    first: u64,
    /// Simulated time of each, seconds.
    #[arg(long, default_value_t = 0.3)]
    duration_s: f64,
    /// Scenario that gives robot, bus and options where they are not drawn.
    #[arg(long)]
    scenario: Option<PathBuf>,
    /// Print the options of every seed before its run (always done for a single seed).
    #[arg(long, short)]
    verbose: bool,
    /// Print one JSON object per seed.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &Args) -> Result<(), Failure> {
    let mut base = match &args.scenario {
        Some(path) => Scenario::load(path)?,
        None => Scenario::default(),
    };
    if !(1e-3..=1e6).contains(&args.duration_s) {
        return Err(Failure::new(Code::BadFile, &"--duration-s must be within 0.001 and 1e6 s"));
    }
    base.duration = Duration::from_secs_f64(args.duration_s);
    let modules: Vec<_> = limits_of(&base.cell()?).iter().map(|limits| limits.module).collect();
    let interrupt = Interrupt::listen();
    let bar = progress::bar(args.seeds, args.json);
    let verbose = args.verbose || args.seeds == 1;
    let start = WallClock::now();
    let mut results: Vec<(SeedResult, f64)> = (args.first..args.first.saturating_add(args.seeds))
        .into_par_iter()
        .filter_map(|seed| {
            if interrupt.came() {
                return None;
            }
            let scenario = swarm::scenario(&base, seed, &modules);
            if verbose && !args.json {
                console::line!("seed {seed}: {scenario:?}");
            }
            let began = WallClock::now();
            let result = swarm::run(&scenario);
            bar.inc(1);
            Some((result, began.elapsed().as_secs_f64()))
        })
        .collect();
    bar.finish_and_clear();
    results.sort_by_key(|(result, _)| result.seed);
    print(args, &results, start.elapsed().as_secs_f64())?;
    if results.iter().any(|(result, _)| result.failure.is_some()) {
        return Err(Failure::silent(Code::NotAsExpected));
    }
    Ok(())
}

fn print(args: &Args, results: &[(SeedResult, f64)], wall_s: f64) -> Result<(), Failure> {
    if args.json {
        for (result, _) in results {
            console::line!("{}", serde_json::to_string(result).map_err(|e| Failure::new(Code::Output, &e))?);
        }
        return Ok(());
    }
    for (result, _) in results {
        if let Some(failure) = &result.failure {
            console::line!("seed {}: {failure}", result.seed);
            console::line!(
                "  repeat: hil-sim swarm --first {} --seeds 1 --duration-s {}",
                result.seed,
                args.duration_s
            );
        }
    }
    let frames: u64 = results.iter().map(|(result, _)| result.frames).sum();
    let mut kinds: BTreeMap<&str, u64> = BTreeMap::new();
    for (kind, count) in results.iter().flat_map(|(result, _)| &result.faults) {
        *kinds.entry(kind).or_default() += count;
    }
    let kinds: Vec<String> = kinds.iter().map(|(kind, count)| format!("{kind} {count}")).collect();
    console::line!("faults: {}", kinds.join(", "));
    let failed = results.iter().filter(|(result, _)| result.failure.is_some()).count();
    let slowest = results.iter().max_by(|a, b| a.1.total_cmp(&b.1));
    console::line!(
        "{} seeds of {} s, {frames} frames, {failed} failed; {wall_s:.1} s in all, slowest seed {} took {:.2} s",
        results.len(),
        args.duration_s,
        slowest.map_or(0, |(result, _)| result.seed),
        slowest.map_or(0.0, |(_, took)| *took)
    );
    Ok(())
}

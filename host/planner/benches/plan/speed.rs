//! Speed: pieces of a solve, random starts, seeded targets, cold starts, near-target queries.

use std::time::Duration;

use nalgebra::Vector3;
use planner::plan::problem::{Options, Problem};
use planner::plan::rng::SplitMix64;
use planner::plan::search::{Budget, Planner, Watch};
use planner::plan::{Arm, PaperParameters};
use planner::store::Index;
use rayon::prelude::*;

use super::{HELD_OUT_SEED, START_SEED, TARGET_SEED, TRIES, cpu, quantile, target, timed};

/// Pieces of a local solve.
pub(crate) fn parts(arm: &Arm) {
    let problem = Problem::new(arm, Vector3::new(1.0, 1.0, -1.0), Options::paper()).expect("valid");
    let planner = Planner::new(&problem);
    let h = PaperParameters::from_array([0.493, -0.465, 0.858, 0.583, -1.098, 0.586, 0.920, 0.391]);
    let throw = h.throws(&problem)[0].throw;
    let n = 20_000;
    let per = |work: &mut dyn FnMut()| {
        let (mut best, rounds) = (f64::INFINITY, 5);
        for _ in 0..rounds {
            best = best.min(timed(|| (0..n).for_each(|_| work())).1 / f64::from(n));
        }
        best * 1e6
    };
    let mut sink = 0.0;
    let pose = arm.ee_at(&throw.q_rad);
    println!(
        "one evaluation of objective and constraints with gradients: {:.2} us",
        per(&mut || sink += planner.evaluate(std::hint::black_box(&throw)))
    );
    println!(
        "inverse kinematics, all branches: {:.2} us",
        per(&mut || sink += arm.ik(std::hint::black_box(&pose)).map_or(0.0, |s| s.len() as f64))
    );
    println!(
        "inverse dynamics (RNEA), the unit of the published baseline: {:.2} us",
        per(&mut || sink += arm.bias_torques(std::hint::black_box(&throw.q_rad), &throw.qd_rad_s)[1])
    );
    std::hint::black_box(sink);
}

/// Random starts: share that ends in a throw, share that ends at the best.
pub(crate) fn starts(arm: &Arm, n: u64) {
    println!("\nrandom starts ({n} per target, seed {START_SEED}), paper's form");
    println!(
        "target               solved  best found  reach best (0.1 %)  median solved   per start   time per best"
    );
    for t in [[1.0, 1.0, -1.0], [1.5, 0.0, -0.5], [2.0, 0.0, -1.0]] {
        let problem = Problem::new(arm, Vector3::from(t), Options::paper()).expect("valid");
        let planner = Planner::new(&problem);
        let (mut total, mut times, mut found) = (0.0, Vec::new(), Vec::new());
        for k in 0..n {
            let (result, s) = timed(|| planner.random_start(START_SEED, k));
            total += s;
            if let Some(f) = result {
                times.push(s);
                found.push(f.objective);
            }
        }
        times.sort_by(f64::total_cmp);
        let best = found.iter().copied().fold(f64::INFINITY, f64::min);
        let hits = found.iter().filter(|j| **j <= best * 1.001).count();
        println!(
            "{:20} {:5.1} %  {best:10.4}  {:17.1} %  {:9.2} ms  {:6.2} ms  {:10.1} ms",
            format!("{t:?}"),
            100.0 * found.len() as f64 / n as f64,
            100.0 * hits as f64 / n as f64,
            quantile(&times, 0.5) * 1e3,
            total * 1e3 / n as f64,
            total * 1e3 / hits.max(1) as f64
        );
    }
}

/// A target with the best objective that a long search found.
struct Reference {
    target: Vector3<f64>,
    objective: f64,
}

/// A set of targets with their references.
#[derive(Clone, Copy)]
pub(crate) struct Set {
    pub(crate) name: &'static str,
    pub(crate) seed: u64,
    file: &'static str,
    text: &'static str,
}

/// What the planner was tuned with.
pub(crate) const TUNED: Set = Set {
    name: "tuned with",
    seed: TARGET_SEED,
    file: "plan_targets.csv",
    text: include_str!("../plan_targets.csv"),
};
/// What it has never been tuned with.
pub(crate) const HELD_OUT: Set = Set {
    name: "held out",
    seed: HELD_OUT_SEED,
    file: "plan_targets_held_out.csv",
    text: include_str!("../plan_targets_held_out.csv"),
};

fn references(set: &Set) -> Vec<Reference> {
    set.text
        .lines()
        .filter_map(|line| {
            let n: Vec<f64> = line.split(',').filter_map(|f| f.parse().ok()).collect();
            let [x, y, z, objective, ..] = n[..] else { return None };
            Some(Reference { target: Vector3::new(x, y, z), objective })
        })
        .collect()
}

/// Makes the file of reference objectives: `n` targets in reach, `starts` random starts each, table on top.
pub(crate) fn reference(arm: &Arm, index: &Index, set: &Set, n: usize, starts: u64) {
    let draws: Vec<u64> = (0..2 * n as u64).collect();
    let mut rows: Vec<Option<String>> = Vec::new();
    for chunk in draws.chunks(64) {
        if rows.iter().flatten().count() >= n {
            break;
        }
        let done: Vec<Option<String>> = chunk
            .par_iter()
            .map(|k| {
                let at = target(set.seed, *k);
                let problem = Problem::new(arm, at, Options::paper()).ok()?;
                let planner = Planner::new(&problem);
                let random: Vec<f64> = (0..starts)
                    .filter_map(|s| planner.random_start(START_SEED ^ k << 8, s))
                    .map(|f| f.objective)
                    .collect();
                let budget = Budget { starts: 0, all: false, time: None, seed: START_SEED };
                let stored = planner.attempt(index, &budget, &Watch::default()).map(|b| b.found.objective);
                let best = random.iter().copied().chain(stored.ok()).fold(f64::INFINITY, f64::min);
                let hits = random.iter().filter(|j| **j <= best * 1.001).count();
                best.is_finite().then(|| format!("{},{},{},{best},{},{hits}", at.x, at.y, at.z, random.len()))
            })
            .collect();
        rows.extend(done);
        eprintln!("{} drawn, {} in reach", rows.len(), rows.iter().flatten().count());
    }
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("benches").join(set.file);
    let head = "x_m,y_m,z_m,objective,random_starts_solved,random_starts_at_best";
    let body: Vec<String> = rows.into_iter().flatten().take(n).collect();
    match std::fs::write(&path, format!("{head}\n{}\n", body.join("\n"))) {
        Ok(()) => println!("{} targets in {}", body.len(), path.display()),
        Err(e) => println!("{}: {e}", path.display()),
    }
}

/// Seeded reachable targets from the table, compared with the reference; a random start if the table has no throw.
pub(crate) fn targets(arm: &Arm, index: &Index, set: &Set, n: usize) {
    let references = references(set);
    let n = n.min(references.len());
    println!("\n{n} reachable targets, {} (seed {}), paper's form, from the table", set.name, set.seed);
    let (mut times, mut gaps, mut missed, mut worst) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for r in &references[..n] {
        let problem = Problem::new(arm, r.target, Options::paper()).expect("valid");
        let (found, s) = timed(|| Planner::new(&problem).from_index_or_random(index, TRIES, 64, START_SEED));
        times.push(s * 1e3);
        worst.push((s * 1e3, r.target, found.map(|f| f.objective), r.objective));
        match found {
            Some(f) => gaps.push(f.objective / r.objective - 1.0),
            None => missed.push(r.target),
        }
    }
    times.sort_by(f64::total_cmp);
    gaps.sort_by(f64::total_cmp);
    println!("  solved {} of {n}", n - missed.len());
    println!(
        "  time p50 {:.3} ms, p90 {:.3} ms, p99 {:.3} ms, worst {:.2} ms",
        quantile(&times, 0.5),
        quantile(&times, 0.9),
        quantile(&times, 0.99),
        quantile(&times, 1.0)
    );
    println!(
        "  gap to the reference: p50 {:.4} %, p90 {:.3} %, p99 {:.2} %, worst {:.2} %; within 2 %: {:.1} %; better than it: {}",
        quantile(&gaps, 0.5) * 100.0,
        quantile(&gaps, 0.9) * 100.0,
        quantile(&gaps, 0.99) * 100.0,
        quantile(&gaps, 1.0) * 100.0,
        100.0 * gaps.iter().filter(|g| **g <= 0.02).count() as f64 / n as f64,
        gaps.iter().filter(|g| **g < -1e-3).count()
    );
    for at in missed {
        println!("  missed: range {:.3} m, height {:.3} m", at.xy().norm(), at.z);
    }
    if std::env::var_os("PLAN_BENCH_WORST").is_some() {
        worst.sort_by(|a, b| b.0.total_cmp(&a.0));
        for (ms, at, found, best) in worst.iter().take(25) {
            println!(
                "  {ms:.2} ms: range {:.3} m, height {:.3} m: {found:.2?}, reference {best:.2}",
                at.xy().norm(),
                at.z
            );
        }
        worst.sort_by(|a, b| (b.2.unwrap_or(0.0) / b.3).total_cmp(&(a.2.unwrap_or(0.0) / a.3)));
        for (ms, at, found, best) in worst.iter().take(25) {
            println!(
                "  {ms:.2} ms: range {:.3} m, height {:.3} m: {found:.2?}, reference {best:.2}",
                at.xy().norm(),
                at.z
            );
        }
    }
}

/// The best form from the table, compared with a search of stored and 16 random starts, which decides what is in reach.
pub(crate) fn best_form(arm: &Arm, index: &Index, n: usize) {
    println!("\nour form, {n} of the targets in reach, from the table");
    let (mut times, mut gaps, mut missed, mut k) = (Vec::new(), Vec::new(), 0, 0);
    while times.len() < n {
        let at = target(TARGET_SEED, k);
        k += 1;
        let Ok(problem) = Problem::new(arm, at, Options::best()) else { continue };
        let planner = Planner::new(&problem);
        let budget = Budget { starts: 16, all: false, time: None, seed: START_SEED };
        let Ok(best) = planner.attempt(index, &budget, &Watch::default()) else { continue };
        let (found, s) = timed(|| planner.from_index(index, TRIES));
        times.push(s * 1e3);
        match found {
            Some(f) => gaps.push(f.objective / best.found.objective - 1.0),
            None => missed += 1,
        }
    }
    times.sort_by(f64::total_cmp);
    gaps.sort_by(f64::total_cmp);
    println!(
        "  solved {} of {n}; time p50 {:.2} ms, p90 {:.2} ms, worst {:.2} ms; gap to the search p50 {:.3} %, p90 {:.2} %, worst {:.2} %",
        n - missed,
        quantile(&times, 0.5),
        quantile(&times, 0.9),
        quantile(&times, 1.0),
        quantile(&gaps, 0.5) * 100.0,
        quantile(&gaps, 0.9) * 100.0,
        quantile(&gaps, 1.0) * 100.0
    );
}

/// Reference and table against multi-starts of ten seconds, on the first `n` targets.
pub(crate) fn tail(arm: &Arm, index: &Index, n: usize) {
    println!(
        "\nten seconds of random starts on one core, for {n} of the targets, against the reference and the table"
    );
    let lines: Vec<String> = references(&TUNED)[..n]
        .par_iter()
        .map(|r| {
            let problem = Problem::new(arm, r.target, Options::paper()).expect("valid");
            let planner = Planner::new(&problem);
            let (began, mut best, mut k) = (cpu(), f64::INFINITY, 0);
            while cpu() - began < Duration::from_secs(10) {
                best = planner.random_start(START_SEED, k).map_or(best, |f| best.min(f.objective));
                k += 1;
            }
            let table = planner.from_index(index, TRIES).map_or(f64::NAN, |f| f.objective);
            let gap = |j: f64| (j / best - 1.0) * 100.0;
            format!(
                "  range {:.3} m, height {:.3} m: {best:.4} from {k} starts, reference {:+.3} %, table {:+.3} %",
                r.target.xy().norm(),
                r.target.z,
                gap(r.objective),
                gap(table)
            )
        })
        .collect();
    println!("{}", lines.join("\n"));
}

/// From nothing to within 0.1 % of the best known objective: random starts one after the other.
pub(crate) fn cold(arm: &Arm, runs: u64) {
    println!("\ncold start to the best objective (0.1 %), {runs} runs, no table, one core");
    for (t, best) in [([1.0, 1.0, -1.0], 31.264), ([1.5, 0.0, -0.5], 34.698), ([2.0, 0.0, -1.0], 38.237)] {
        let problem = Problem::new(arm, Vector3::from(t), Options::paper()).expect("valid");
        let mut times: Vec<f64> = (0..runs)
            .map(|run| {
                let planner = Planner::new(&problem);
                let hit = |k: &u64| {
                    planner
                        .random_start(START_SEED ^ (run + 1) << 20, *k)
                        .is_some_and(|f| f.objective <= best * 1.001)
                };
                timed(|| (0..400).find(hit)).1 * 1e3
            })
            .collect();
        times.sort_by(f64::total_cmp);
        println!(
            "  {:20} p50 {:.1} ms, p90 {:.1} ms, mean {:.1} ms",
            format!("{t:?}"),
            quantile(&times, 0.5),
            quantile(&times, 0.9),
            times.iter().sum::<f64>() / times.len() as f64
        );
    }
}

/// A target a few centimetres from a stored one.
pub(crate) fn store(arm: &Arm, index: &Index) {
    let first = Problem::new(arm, Vector3::new(1.23, 0.41, -0.87), Options::paper()).expect("valid");
    let planner = Planner::new(&first);
    let found = planner.from_index(index, TRIES).expect("in reach");
    let mut own = Index::default();
    own.insert(planner.record(&found));
    let mut times = Vec::new();
    let mut rng = SplitMix64::new(9);
    for _ in 0..200 {
        let mut step = || 0.04 * (rng.unit() - 0.5);
        let near = Vector3::new(1.23 + step(), 0.41 + step(), -0.87 + step());
        let problem = Problem::new(arm, near, Options::paper()).expect("valid");
        let planner = Planner::new(&problem);
        let (found, s) = timed(|| planner.from_index(&own, 1));
        if found.is_some() {
            times.push(s * 1e3);
        }
    }
    times.sort_by(f64::total_cmp);
    println!(
        "\nnear-target query (within 2 cm of a stored throw): {} of 200 solved, p50 {:.3} ms, p99 {:.3} ms",
        times.len(),
        quantile(&times, 0.5),
        quantile(&times, 0.99)
    );
}

//! Figures of the throw planner: `cargo bench -p host --bench plan [-- section …]`.
//!
//! Sections: `parts`, `starts`, `targets`, `tail`, `store`, `delay`, `landing`, `reach`; all without arguments. Times are
//! CPU time of one thread, so that other work on the machine counts less; targets and starts follow from the seeds below.
//!
//! The targets and their reference objectives are in `plan_targets.csv`; the section `reference` (only when named) makes
//! the file again: a target is in reach if a multi-start without any table finds a throw to it, or the table does.

use std::time::Duration;

use host::plan::problem::{Options, Problem};
use host::plan::rng::SplitMix64;
use host::plan::search::{Budget, Planner, Watch};
use host::plan::statistics::{Noise, landing_with_delay, monte_carlo, predict};
use host::plan::{Arm, Found, Margins, PaperParameters, Throw, seeds};
use host::store::Index;
use nalgebra::{Matrix2, Vector2, Vector3};
use nix::time::{ClockId, clock_gettime};
use rayon::prelude::*;

/// Seed of the targets: range 0.4 to 2.2 m, height -1 to 0.5 m, any azimuth, uniform.
const TARGET_SEED: u64 = 77;
/// Seed of the random starts.
const START_SEED: u64 = 3;

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

fn target(index: u64) -> Vector3<f64> {
    let mut rng = SplitMix64::stream(TARGET_SEED, index);
    let azimuth = (rng.unit() * 2.0 - 1.0) * std::f64::consts::PI;
    let (range, z) = (0.4 + 1.8 * rng.unit(), -1.0 + 1.5 * rng.unit());
    Vector3::new(range * azimuth.cos(), range * azimuth.sin(), z)
}

fn main() {
    let wanted: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with('-')).collect();
    let count = |name: &str, default: u64| {
        std::env::var(format!("PLAN_BENCH_{}", name.to_uppercase()))
            .ok()
            .and_then(|v| v.parse().ok())
            .unwrap_or(default)
    };
    let arm = Arm::load("powercube6").expect("built in");
    let index = seeds::built_in(&arm);
    println!("{} built-in throws; times are CPU time of one thread", index.records().len());
    let run = |name: &str| wanted.is_empty() || wanted.iter().any(|w| w == name);
    if run("parts") {
        parts(&arm);
    }
    if run("starts") {
        starts(&arm, count("starts", 400));
    }
    if run("targets") {
        targets(&arm, &index, count("targets", 1000) as usize);
    }
    if wanted.iter().any(|w| w == "reference") {
        reference(&arm, &index, count("targets", 1000) as usize, count("reference_starts", 64));
    }
    if run("tail") {
        tail(&arm, count("tail", 10) as usize);
    }
    if run("store") {
        store(&arm, &index);
    }
    if run("delay") {
        delay(&arm, &index, count("delay", 30));
    }
    if run("landing") {
        landing(&arm, &index, 20, 100_000);
    }
    if run("reach") {
        reach(&arm, &index);
    }
}

/// Pieces of a local solve.
fn parts(arm: &Arm) {
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
fn starts(arm: &Arm, n: u64) {
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

fn references() -> Vec<Reference> {
    include_str!("plan_targets.csv")
        .lines()
        .filter_map(|line| {
            let n: Vec<f64> = line.split(',').filter_map(|f| f.parse().ok()).collect();
            let [x, y, z, objective, ..] = n[..] else { return None };
            Some(Reference { target: Vector3::new(x, y, z), objective })
        })
        .collect()
}

/// Makes the file of reference objectives: `n` targets in reach, `starts` random starts each, table on top.
fn reference(arm: &Arm, index: &Index, n: usize, starts: u64) {
    let draws: Vec<u64> = (0..2 * n as u64).collect();
    let mut rows: Vec<Option<String>> = Vec::new();
    for chunk in draws.chunks(64) {
        if rows.iter().flatten().count() >= n {
            break;
        }
        let done: Vec<Option<String>> = chunk
            .par_iter()
            .map(|k| {
                let at = target(*k);
                let problem = Problem::new(arm, at, Options::paper()).ok()?;
                let planner = Planner::new(&problem);
                let random: Vec<f64> = (0..starts)
                    .filter_map(|s| planner.random_start(START_SEED ^ k << 8, s))
                    .map(|f| f.objective)
                    .collect();
                let budget = Budget { starts: 0, time: None, seed: START_SEED };
                let stored = planner.search(index, &budget, &Watch::default()).map(|b| b.found.objective);
                let best = random.iter().copied().chain(stored.ok()).fold(f64::INFINITY, f64::min);
                let hits = random.iter().filter(|j| **j <= best * 1.001).count();
                best.is_finite().then(|| format!("{},{},{},{best},{},{hits}", at.x, at.y, at.z, random.len()))
            })
            .collect();
        rows.extend(done);
        eprintln!("{} drawn, {} in reach", rows.len(), rows.iter().flatten().count());
    }
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/plan_targets.csv");
    let head = "x_m,y_m,z_m,objective,random_starts_solved,random_starts_at_best";
    let body: Vec<String> = rows.into_iter().flatten().take(n).collect();
    match std::fs::write(&path, format!("{head}\n{}\n", body.join("\n"))) {
        Ok(()) => println!("{} targets in {}", body.len(), path.display()),
        Err(e) => println!("{}: {e}", path.display()),
    }
}

/// Seeded reachable targets from the table alone, against the reference.
fn targets(arm: &Arm, index: &Index, n: usize) {
    let references = references();
    let n = n.min(references.len());
    println!("\n{n} reachable targets (seed {TARGET_SEED}), paper's form, from the table alone");
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

/// The reference against multi-starts of ten seconds, on the first `n` targets.
fn tail(arm: &Arm, n: usize) {
    println!("\nten seconds of random starts on one core, for {n} of the targets");
    for r in references().iter().take(n) {
        let problem = Problem::new(arm, r.target, Options::paper()).expect("valid");
        let planner = Planner::new(&problem);
        let (began, mut best, mut k) = (cpu(), f64::INFINITY, 0);
        while cpu() - began < Duration::from_secs(10) {
            best = planner.random_start(START_SEED, k).map_or(best, |f| best.min(f.objective));
            k += 1;
        }
        println!(
            "  range {:.3} m, height {:.3} m: {best:.4} from {k} starts, reference {:.4} ({:+.3} %)",
            r.target.xy().norm(),
            r.target.z,
            r.objective,
            (r.objective / best - 1.0) * 100.0
        );
    }
}

/// Local solves from stored throws before a target counts as missed.
const TRIES: usize = 6;

/// A target a few centimetres from a stored one.
fn store(arm: &Arm, index: &Index) {
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

fn worst_shift(problem: &Problem<'_>, throw: &Throw, ms: f64) -> f64 {
    let Some(on_time) = landing_with_delay(problem, throw, 0.0) else { return f64::INFINITY };
    [-1.0, -0.5, 0.5, 1.0]
        .into_iter()
        .map(|s| {
            landing_with_delay(problem, throw, s * ms * 1e-3).map_or(f64::INFINITY, |l| (l - on_time).norm())
        })
        .fold(0.0, f64::max)
}

/// One way of throwing in the comparison of late releases.
struct Late {
    objective: f64,
    slope_mm_ms: f64,
    shift_10_mm: f64,
    shift_25_mm: f64,
}

impl Late {
    fn new(problem: &Problem<'_>, found: &Found) -> Self {
        let slope = predict(problem, &found.throw, &Noise::default());
        Self {
            objective: found.objective,
            slope_mm_ms: slope.map_or(f64::INFINITY, |p| p.delay_sensitivity_m_s.norm()),
            shift_10_mm: worst_shift(problem, &found.throw, 10.0) * 1e3,
            shift_25_mm: worst_shift(problem, &found.throw, 25.0) * 1e3,
        }
    }

    fn kept(&self) -> bool {
        self.slope_mm_ms <= 0.1 && self.shift_10_mm <= 2.0 && self.shift_25_mm <= 10.0
    }
}

/// Release-delay nulling side by side with the plain cubic, all else as in our form.
fn delay(arm: &Arm, index: &Index, n: u64) {
    println!("\nrelease delay, {n} seeded targets that the plain cubic (free spin, our limits) reaches");
    println!(
        "range  height |  plain J  mm/ms   10 ms   25 ms |   ours J  mm/ms   10 ms   25 ms  (shifts in mm)"
    );
    let plain = Options { null_delay: false, delay_windows: Vec::new(), ..Options::best() };
    let best = |problem: &Problem<'_>, starts: usize| {
        let budget = Budget { starts, time: None, seed: START_SEED };
        Planner::new(problem).attempt(index, &budget, &Watch::default()).ok().map(|b| b.found)
    };
    let (mut cubics, mut ours, mut kept, mut k) = (Vec::new(), Vec::new(), 0, 0);
    while (cubics.len() as u64) < n {
        let at = target(k);
        k += 1;
        let Ok(a) = Problem::new(arm, at, plain.clone()) else { continue };
        let Some(cubic) = best(&a, 8).map(|f| Late::new(&a, &f)) else { continue };
        let b = Problem::new(arm, at, Options::best()).expect("the target was accepted before");
        let nulled = best(&b, 16).map(|f| (Late::new(&b, &f), Margins::of(&b, &f.throw).violation()));
        let text = |l: &Late| {
            let (slope, short, long) = (l.slope_mm_ms, l.shift_10_mm, l.shift_25_mm);
            format!("{:8.2} {slope:6.3} {short:7.2} {long:7.2}", l.objective)
        };
        let right = nulled.as_ref().map_or_else(|| "none".to_owned(), |(l, _)| text(l));
        println!("{:5.2} {:7.2} | {} | {right}", at.xy().norm(), at.z, text(&cubic));
        cubics.push(cubic);
        if let Some((late, violation)) = nulled {
            kept += u64::from(late.kept() && violation <= 1e-6);
            ours.push(late);
        }
    }
    println!(
        "  within all limits, <= 0.1 mm/ms, <= 2 mm over 10 ms and <= 10 mm over 25 ms: ours {kept} of {n}, plain {} of {n}",
        cubics.iter().filter(|l| l.kept()).count()
    );
    for (name, of) in [
        ("|dL/d delay| in mm/ms", (|l| l.slope_mm_ms) as fn(&Late) -> f64),
        ("worst shift over 10 ms in mm", |l| l.shift_10_mm),
        ("worst shift over 25 ms in mm", |l| l.shift_25_mm),
    ] {
        let sorted = |from: &[Late]| {
            let mut values: Vec<f64> = from.iter().map(of).collect();
            values.sort_by(f64::total_cmp);
            values
        };
        let (a, b) = (sorted(&cubics), sorted(&ours));
        println!(
            "  {name}: plain p50 {:.3} p90 {:.3}, ours p50 {:.4} p90 {:.4}",
            quantile(&a, 0.5),
            quantile(&a, 0.9),
            quantile(&b, 0.5),
            quantile(&b, 0.9)
        );
    }
}

/// Predicted covariance against Monte Carlo.
fn landing(arm: &Arm, index: &Index, n: usize, draws: usize) {
    println!("\nlanding covariance, {n} targets, {draws} draws each: relative Frobenius distance");
    let (mut off, mut k) = (Vec::new(), 0);
    let noise = Noise::default();
    while off.len() < n {
        let options = if off.len() % 2 == 0 { Options::best() } else { Options::paper() };
        let at = target(k);
        k += 1;
        let Ok(problem) = Problem::new(arm, at, options) else { continue };
        let Some(found) = Planner::new(&problem).from_index(index, TRIES) else { continue };
        let Some(predicted) = predict(&problem, &found.throw, &noise) else { continue };
        let landings = monte_carlo(&problem, &found.throw, &noise, draws, 1000 + k);
        let count = landings.len() as f64;
        let mean = landings.iter().sum::<Vector2<f64>>() / count;
        let c = landings.iter().map(|l| (l - mean) * (l - mean).transpose()).sum::<Matrix2<f64>>()
            / (count - 1.0);
        off.push((c - predicted.covariance_m2).norm() / c.norm());
    }
    off.sort_by(f64::total_cmp);
    println!("  p50 {:.2} %, worst {:.2} %", quantile(&off, 0.5) * 100.0, quantile(&off, 1.0) * 100.0);
}

/// Farthest floor targets: the target is pulled outwards from the best start.
fn reach(arm: &Arm, index: &Index) {
    println!("\nfarthest floor target (z = -1 m)");
    let free =
        Options { free_spin: true, current_over_motion: true, clean_release: true, ..Options::paper() };
    for (name, options, from) in [
        ("paper's form", Options::paper(), 2.1),
        ("free spin, all checks, full acceleration", free, 2.6),
        ("our form", Options::best(), 2.0),
    ] {
        for azimuth_deg in [0.0_f64, 90.0] {
            let (s, c) = azimuth_deg.to_radians().sin_cos();
            let point = |r: f64| Vector3::new(r * c, r * s, -1.0);
            let mut best = 0.0_f64;
            let mut start: Option<Throw> = None;
            if let Ok(problem) = Problem::new(arm, point(from), options.clone()) {
                let budget = Budget { starts: 64, time: None, seed: START_SEED };
                if let Ok(found) = Planner::new(&problem).attempt(index, &budget, &Watch::default()) {
                    best = from;
                    start = Some(found.found.throw);
                    // Every throw to the near target is pulled outwards step by step; the farthest counts.
                    let axes = [c.abs() > 0.5, s.abs() > 0.5, false];
                    for other in found.others.iter().take(12) {
                        let (mut throw, mut reached) = (other.throw, from);
                        for _ in 0..20 {
                            let far =
                                Problem::new(arm, point(reached + 0.2), options.clone()).expect("valid");
                            let Some(n) = Planner::new(&far).nearest_from_throw(&throw, axes) else { break };
                            let now = (far.target() + n.shift_m).xy().norm();
                            if now < reached + 1e-4 {
                                break;
                            }
                            (throw, reached) = (n.throw, now);
                        }
                        best = best.max(reached);
                    }
                }
            }
            println!(
                "  {name}, azimuth {azimuth_deg} deg: {}",
                if start.is_some() { format!("{best:.3} m") } else { "no throw to start from".to_owned() }
            );
        }
    }
}

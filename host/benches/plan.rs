//! Figures of the throw planner: `cargo bench -p host --bench plan [-- section …]`.
//!
//! Sections: `parts`, `starts`, `targets`, `store`, `delay`, `landing`, `reach`; all without arguments. Times are CPU
//! time of one thread, so that other work on the machine counts less; targets and starts follow from the seeds below.

use std::time::Duration;

use host::plan::problem::{Options, Problem};
use host::plan::rng::SplitMix64;
use host::plan::search::{Budget, Planner, Watch};
use host::plan::statistics::{Noise, landing_with_delay, monte_carlo, predict};
use host::plan::{Arm, PaperParameters, Throw, seeds};
use host::store::Index;
use nalgebra::{Matrix2, Vector2, Vector3};
use nix::time::{ClockId, clock_gettime};

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
        targets(&arm, &index, count("targets", 1000), count("reference_starts", 32) as usize);
    }
    if run("store") {
        store(&arm, &index);
    }
    if run("delay") {
        delay(&arm, &index, count("delay", 100));
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

/// Seeded reachable targets from the table alone, against a search with many starts.
fn targets(arm: &Arm, index: &Index, n: u64, reference_starts: usize) {
    println!(
        "\n{n} reachable targets (seed {TARGET_SEED}), paper's form, table alone; reference: table + {reference_starts} random starts"
    );
    let (mut times, mut gaps, mut missed, mut tried, mut k) = (Vec::new(), Vec::new(), 0, 0, 0);
    let mut wall = Vec::new();
    while tried < n {
        let at = target(k);
        k += 1;
        let Ok(problem) = Problem::new(arm, at, Options::paper()) else { continue };
        let began = std::time::Instant::now();
        let (found, s) = timed(|| Planner::new(&problem).from_index(index, TRIES));
        let elapsed = began.elapsed().as_secs_f64();
        let budget = Budget { starts: reference_starts, time: None, seed: START_SEED };
        let Ok(reference) = Planner::new(&problem).search(index, &budget, &Watch::default()) else {
            continue;
        };
        tried += 1;
        times.push(s * 1e3);
        wall.push(elapsed * 1e3);
        match found {
            Some(f) => gaps.push(f.objective / reference.objective.min(f.objective) - 1.0),
            None => missed += 1,
        }
    }
    for v in [&mut times, &mut gaps, &mut wall] {
        v.sort_by(f64::total_cmp);
    }
    println!("  solved {:.1} % ({missed} missed; {k} drawn)", 100.0 * (n - missed) as f64 / n as f64);
    println!(
        "  time p50 {:.3} ms, p90 {:.3} ms, p99 {:.3} ms (wall: {:.3}, {:.3}, {:.3})",
        quantile(&times, 0.5),
        quantile(&times, 0.9),
        quantile(&times, 0.99),
        quantile(&wall, 0.5),
        quantile(&wall, 0.9),
        quantile(&wall, 0.99)
    );
    println!(
        "  gap p50 {:.4} %, p90 {:.3} %, p99 {:.2} %; within 2 %: {:.1} %",
        quantile(&gaps, 0.5) * 100.0,
        quantile(&gaps, 0.9) * 100.0,
        quantile(&gaps, 0.99) * 100.0,
        100.0 * gaps.iter().filter(|g| **g <= 0.02).count() as f64 / n as f64
    );
}

/// Local solves from stored throws before a target counts as missed.
const TRIES: usize = 6;

/// A target a few centimetres from a stored one.
fn store(arm: &Arm, index: &Index) {
    let first = Problem::new(arm, Vector3::new(1.23, 0.41, -0.87), Options::paper()).expect("valid");
    let planner = Planner::new(&first);
    let found = planner.from_index(index, TRIES).expect("in reach");
    let mut own = Index::default();
    own.insert(planner.record(&found.throw, found.objective));
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

/// Release-delay nulling side by side with the plain cubic, all else as in our form.
fn delay(arm: &Arm, index: &Index, n: u64) {
    println!("\nrelease delay, {n} seeded targets that the plain cubic (free spin, our limits) reaches");
    let plain = Options { null_delay: false, ..Options::best() };
    let (mut throwable, mut nulled, mut kept, mut k) = (0, 0, 0, 0);
    let mut rows: [Vec<f64>; 6] = Default::default();
    let noise = Noise::default();
    while throwable < n {
        let at = target(k);
        k += 1;
        let budget = Budget { starts: 12, time: None, seed: START_SEED };
        let Ok(a) = Problem::new(arm, at, plain.clone()) else { continue };
        let Ok(cubic) = Planner::new(&a).search(index, &budget, &Watch::default()) else { continue };
        throwable += 1;
        let Ok(b) = Problem::new(arm, at, Options::best()) else { continue };
        let Ok(ours) = Planner::new(&b).search(index, &budget, &Watch::default()) else { continue };
        nulled += 1;
        let slope =
            predict(&b, &ours.throw, &noise).map_or(f64::INFINITY, |p| p.delay_sensitivity_m_s.norm());
        let (s10, s25) = (worst_shift(&b, &ours.throw, 10.0), worst_shift(&b, &ours.throw, 25.0));
        kept += u64::from(slope <= 0.1 && s10 <= 2e-3 && s25 <= 10e-3);
        let slope_plain =
            predict(&a, &cubic.throw, &noise).map_or(f64::INFINITY, |p| p.delay_sensitivity_m_s.norm());
        let values = [
            slope_plain,
            slope,
            worst_shift(&a, &cubic.throw, 10.0) * 1e3,
            s10 * 1e3,
            worst_shift(&a, &cubic.throw, 25.0) * 1e3,
            s25 * 1e3,
        ];
        for (row, value) in rows.iter_mut().zip(values) {
            row.push(value);
        }
    }
    println!(
        "  nulled within all limits: {nulled} of {throwable}; |dL/d delay| <= 0.1 mm/ms, <= 2 mm over 10 ms and <= 10 mm over 25 ms: {kept}"
    );
    for (name, at) in [
        ("|dL/d delay| in mm/ms", 0),
        ("worst shift over 10 ms in mm", 2),
        ("worst shift over 25 ms in mm", 4),
    ] {
        for row in &mut rows[at..at + 2] {
            row.sort_by(f64::total_cmp);
        }
        println!(
            "  {name}: plain p50 {:.3} p90 {:.3}, nulled p50 {:.4} p90 {:.4}",
            quantile(&rows[at], 0.5),
            quantile(&rows[at], 0.9),
            quantile(&rows[at + 1], 0.5),
            quantile(&rows[at + 1], 0.9)
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
                if let Ok(found) = Planner::new(&problem).search(index, &budget, &Watch::default()) {
                    best = from;
                    start = Some(found.throw);
                    // Every throw to the near target is pulled outwards; the farthest counts.
                    for (throw, _) in found.others.iter().take(24) {
                        let Ok(far) = Problem::new(arm, point(from + 4.0), options.clone()) else { continue };
                        let axes = [c.abs() > 0.5, s.abs() > 0.5, false];
                        if let Some(n) = Planner::new(&far).nearest_from_throw(throw, axes) {
                            best = best.max((far.target() + n.shift_m).xy().norm());
                        }
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

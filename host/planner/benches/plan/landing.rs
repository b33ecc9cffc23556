//! Landing: late releases, predicted spread against Monte Carlo, planning for the spread.

use std::f64::consts::PI;
use std::time::Instant;

use nalgebra::{Matrix2, Vector2};
use planner::flight::landing;
use planner::plan::problem::{Options, Problem};
use planner::plan::search::{Budget, Planner, Watch};
use planner::plan::statistics::{Noise, Region, landing_with_delay, monte_carlo, predict};
use planner::plan::{Arm, Found, Goal, Margins, Throw};
use planner::store::Index;
use rayon::prelude::*;

use super::{START_SEED, TARGET_SEED, TRIES, quantile, target};

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
pub(crate) fn delay(arm: &Arm, index: &Index, n: u64) {
    println!("\nrelease delay, {n} seeded targets that the plain cubic (free spin, our limits) reaches");
    println!(
        "range  height |  plain J  mm/ms   10 ms   25 ms |   ours J  mm/ms   10 ms   25 ms  (shifts in mm)"
    );
    let plain = Options { null_delay: false, delay_windows: Vec::new(), ..Options::best() };
    let best = |problem: &Problem<'_>, starts: usize| {
        let budget = Budget { starts, all: false, time: None, seed: START_SEED };
        Planner::new(problem).attempt(index, &budget, &Watch::default()).ok().map(|b| b.found)
    };
    let (mut cubics, mut ours, mut kept, mut k) = (Vec::new(), Vec::new(), 0, 0);
    while (cubics.len() as u64) < n {
        let at = target(TARGET_SEED, k);
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

/// Predicted covariance and hit probability against Monte Carlo.
pub(crate) fn landing_statistics(arm: &Arm, index: &Index, n: usize, draws: usize) {
    println!("\nlanding with noise, {n} targets, {draws} draws each; predicted / drawn");
    println!(
        "range  height form  | semi-axes in mm     ratios         turned   covariance off | hit of a disc of 1.5 x the rms"
    );
    let noise = Noise::default();
    let (mut throws, mut k) = (Vec::new(), 0);
    while throws.len() < n {
        let (form, options) =
            if throws.len() % 2 == 0 { ("best", Options::best()) } else { ("paper", Options::paper()) };
        let at = target(TARGET_SEED, k);
        k += 1;
        let Ok(problem) = Problem::new(arm, at, options) else { continue };
        let Some(found) = Planner::new(&problem).from_index(index, TRIES) else { continue };
        let Some(predicted) = predict(&problem, &found.throw, &noise) else { continue };
        throws.push((form, problem, found.throw, predicted, 1000 + k));
    }
    let drawn: Vec<Vec<Vector2<f64>>> = throws
        .par_iter()
        .map(|(_, problem, throw, _, seed)| monte_carlo(problem, throw, &noise, draws, *seed))
        .collect();
    let mut off = Vec::new();
    for ((form, problem, _, predicted, _), landings) in throws.iter().zip(&drawn) {
        let at = problem.target();
        let (_, c) = moments(landings);
        let (a, b, turn) = landing::ellipse(&predicted.covariance_m2);
        let (ma, mb, mturn) = landing::ellipse(&c);
        let mut turned = (turn - mturn).abs() % PI;
        turned = turned.min(PI - turned);
        let radius_m = 1.5 * c.trace().sqrt();
        let p = predicted.hit_probability(&at.xy(), &Region::Disc { radius_m });
        let hits = landings.iter().filter(|l| (*l - at.xy()).norm() <= radius_m).count();
        let frobenius = (c - predicted.covariance_m2).norm() / c.norm();
        println!(
            "{:5.2} {:7.2} {form:5} | {a:6.1} x {b:5.1}      {:.3} {:.3}   {:5.2} deg   {:6.2} %        | {:.4} / {:.4}",
            at.xy().norm(),
            at.z,
            a / ma,
            b / mb,
            turned.to_degrees(),
            frobenius * 100.0,
            p,
            hits as f64 / landings.len() as f64,
            a = a * 1e3,
            b = b * 1e3,
        );
        off.push(frobenius);
    }
    off.sort_by(f64::total_cmp);
    println!(
        "  covariance off (Frobenius): p50 {:.2} %, worst {:.2} %",
        quantile(&off, 0.5) * 100.0,
        quantile(&off, 1.0) * 100.0
    );
}

fn moments(landings: &[Vector2<f64>]) -> (Vector2<f64>, Matrix2<f64>) {
    let count = landings.len() as f64;
    let mean = landings.iter().sum::<Vector2<f64>>() / count;
    let c = landings.iter().map(|l| (l - mean) * (l - mean).transpose()).sum::<Matrix2<f64>>();
    (mean, c / (count - 1.0))
}

/// Root of the mean squared distance from the target, drawn, in mm.
fn drawn_rms_mm(problem: &Problem<'_>, found: &Found, noise: &Noise, draws: usize) -> f64 {
    let landings = monte_carlo(problem, &found.throw, noise, draws, 77);
    let sum: f64 = landings.iter().map(|l| (l - problem.target().xy()).norm_squared()).sum();
    (sum / landings.len() as f64).sqrt() * 1e3
}

/// Planning for the landing against planning for the effort.
pub(crate) fn spread(arm: &Arm, index: &Index, n: u64) {
    let noise = Noise::default();
    println!("\nrms miss in mm, predicted / drawn ({n} targets per form, 20000 draws); J in brackets");
    println!(
        "range  height form  |        cheapest         |  most exact of the found |   planned for the spread   | time"
    );
    for (form, options) in [("best", Options::best()), ("paper", Options::paper())] {
        let (mut gains, mut k) = (Vec::new(), 0);
        while (gains.len() as u64) < n {
            let at = target(TARGET_SEED, k);
            k += 1;
            let Ok(effort) = Problem::new(arm, at, options.clone()) else { continue };
            let budget = Budget { starts: 16, all: false, time: None, seed: START_SEED };
            let planner = Planner::new(&effort);
            let Ok(best) = planner.attempt(index, &budget, &Watch::default()) else { continue };
            let miss = |f: &Found| planner.rms_miss_m(&f.throw, &noise).unwrap_or(f64::INFINITY) * 1e3;
            let Some(exact) = best.others.iter().min_by(|a, b| miss(a).total_cmp(&miss(b))) else { continue };
            let options = Options { goal: Goal::Spread(noise), ..options.clone() };
            let Ok(spread) = Problem::new(arm, at, options) else { continue };
            let began = Instant::now();
            let found = Planner::new(&spread).attempt(index, &budget, &Watch::default());
            let s = began.elapsed().as_secs_f64();
            let Ok(found) = found.map(|b| b.found) else { continue };
            let text = |f: &Found| {
                let drawn = drawn_rms_mm(&effort, f, &noise, 20_000);
                format!("{:6.2} /{drawn:6.2} ({:6.1})", miss(f), effort.objective(&f.throw))
            };
            println!(
                "{:5.2} {:7.2} {form:5} | {} | {} | {} | {:.0} ms",
                at.xy().norm(),
                at.z,
                text(&best.found),
                text(exact),
                text(&found),
                s * 1e3
            );
            gains.push(miss(&found) / miss(exact));
        }
        gains.sort_by(f64::total_cmp);
        println!(
            "  {form}: planned for the spread / most exact of the found: p50 {:.3}, best {:.3}, worst {:.3}",
            quantile(&gains, 0.5),
            quantile(&gains, 0.0),
            quantile(&gains, 1.0)
        );
    }
}

//! A library of throws: time of a look-up, and of a look-up with its local solve and its check by other means.

use planner::plan::file::PlanFile;
use planner::plan::problem::{Options, Problem};
use planner::plan::search::{Budget, Planner, Watch, kind_of};
use planner::plan::statistics::Noise;
use planner::plan::{Arm, Best};
use planner::store::Index;
use planner::verify;

use super::{HELD_OUT_SEED, START_SEED, quantile, target, timed};

/// Look-ups that are timed together: one alone is shorter than the clock's step.
const REPEATED: u32 = 20;
/// Random starts that decide, with the table, whether a target is in reach.
const STARTS: usize = 8;

/// Targets in reach, drawn anew; each looked up, solved and checked.
pub(crate) fn library(arm: &Arm, index: &Index, n: usize) {
    for (name, options) in [("paper's form", Options::paper()), ("our form", Options::best())] {
        let of_kind = index.records().iter().filter(|r| r.kind == kind_of(&options)).count();
        println!("\nlibrary of {of_kind} throws, {name}, {n} targets in reach");
        let (mut query, mut whole, mut check) = (Vec::new(), Vec::new(), Vec::new());
        let (mut gaps, mut missed, mut refused, mut k) = (Vec::new(), 0, 0, 0);
        while query.len() < n {
            let at = target(HELD_OUT_SEED ^ 0x6C69, k);
            k += 1;
            let Ok(problem) = Problem::new(arm, at, options.clone()) else { continue };
            let planner = Planner::new(&problem);
            let budget = Budget { starts: STARTS, all: false, time: None, seed: START_SEED };
            let Ok(best) = planner.attempt(index, &budget, &Watch::default()) else { continue };
            let look = || planner.look_up(std::hint::black_box(index));
            let (_, s) = timed(|| (0..REPEATED).for_each(|_| drop(std::hint::black_box(look()))));
            query.push(s / f64::from(REPEATED) * 1e6);
            let (found, s) = timed(|| planner.from_look_up(&look()));
            whole.push(s * 1e3);
            let Some(found) = found else {
                missed += 1;
                continue;
            };
            gaps.push(found.objective / best.found.objective - 1.0);
            let plan =
                PlanFile::of(&problem, &Best::alone(found), arm.name(), START_SEED, &Noise::default(), None);
            let Some(plan) = plan else {
                refused += 1;
                continue;
            };
            let (report, s) = timed(|| verify::check(arm, &plan));
            check.push(s * 1e3);
            refused += u32::from(!report.ok());
        }
        for values in [&mut query, &mut whole, &mut check, &mut gaps] {
            values.sort_by(f64::total_cmp);
        }
        println!("  look-up: p50 {:.2} us, p99 {:.2} us", quantile(&query, 0.5), quantile(&query, 0.99));
        println!(
            "  with the local solve: p50 {:.3} ms, p99 {:.3} ms, worst {:.3} ms; {missed} of {n} not reached from the library",
            quantile(&whole, 0.5),
            quantile(&whole, 0.99),
            quantile(&whole, 1.0)
        );
        println!(
            "  check by other means: p50 {:.2} ms; {refused} refused; gap to a search p50 {:.4} %, p99 {:.2} %",
            quantile(&check, 0.5),
            quantile(&gaps, 0.5) * 100.0,
            quantile(&gaps, 0.99) * 100.0
        );
    }
}

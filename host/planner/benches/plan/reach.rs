//! Reach: farthest floor targets, and the gain by a free spin of the hand.

use nalgebra::Vector3;
use planner::plan::problem::{Options, Problem};
use planner::plan::search::{Budget, Planner, Watch};
use planner::plan::{Arm, Throw};
use planner::store::Index;

use super::START_SEED;

/// Farthest floor targets: the target is pulled outwards from the best start.
pub(crate) fn reach(arm: &Arm, index: &Index) {
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
                let budget = Budget { starts: 64, all: false, time: None, seed: START_SEED };
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

/// Best objectives with a free spin, without collision, against the known ones (robot-models 1.8).
pub(crate) fn free_spin(arm: &Arm, index: &Index, starts: usize) {
    println!("\nfree spin of the hand, no collision checks, {starts} random starts");
    let options = Options { free_spin: true, avoid_collisions: false, ..Options::paper() };
    for (t, known) in [([1.0, 1.0, -1.0], 22.66), ([2.0, 0.0, 0.0], 29.65)] {
        let problem = Problem::new(arm, Vector3::from(t), options.clone()).expect("valid");
        let budget = Budget { starts, all: false, time: None, seed: START_SEED };
        match Planner::new(&problem).attempt(index, &budget, &Watch::default()) {
            Ok(best) => println!(
                "  {t:?}: J = {:.3}, known {known}; {} of {} starts ended in a throw",
                best.found.objective, best.solved, best.starts
            ),
            Err(none) => println!("  {t:?}: {none}"),
        }
    }
}

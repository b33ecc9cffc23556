//! Continuation: a stored throw is carried to a target in steps, over range and height at the target's azimuth.

use nalgebra::Vector3;

use super::local::Found;
use super::planner::Planner;
use super::problem::Problem;
use crate::solve::sqp::Settings;
use crate::store::{Index, Record};
use crate::throw::Throw;

/// Local solves on the way.
const SOLVES_MAX: usize = 16;
/// Shortest step, as a share of the way.
const STEP_MIN: f64 = 0.03;
/// Throws of every other kind that are tried.
const OTHERS_PER_KIND: usize = 2;
/// Throws of another kind are taken from targets within this distance, in m.
const OTHERS_WITHIN_M: f64 = 0.3;

impl Planner<'_, '_> {
    /// From a stored target to this one: a step that fails is halved, one that succeeds doubles the next.
    pub(super) fn walk_to_target(&self, record: &Record, stopped: &dyn Fn() -> bool) -> Option<Found> {
        let (sin, cos) = self.azimuth_rad.sin_cos();
        let from = Vector3::new(record.range_m * cos, record.range_m * sin, record.height_m);
        let way = self.problem.target - from;
        let mut throw = self.place(&record.throw)?;
        let (mut share, mut step) = (0.0, 0.5);
        for _ in 0..SOLVES_MAX {
            if stopped() {
                return None;
            }
            let next: f64 = share + step;
            if next >= 1.0 {
                let found = self.solve(&throw, self.anywhere(), &Settings::default(), usize::MAX);
                if found.is_some() {
                    return found;
                }
            } else if let Some(there) = self.at_other_target(from + way * next, &throw) {
                (share, throw) = (next, there);
                step = (2.0 * step).min(1.0 - share);
                continue;
            }
            step = 0.5 * step.min(1.0 - share);
            if step < STEP_MIN {
                return None;
            }
        }
        None
    }

    fn at_other_target(&self, target: Vector3<f64>, start: &Throw) -> Option<Throw> {
        let problem = Problem::new(self.problem.arm, target, self.problem.options.clone()).ok()?;
        let planner = Planner { persistent: self.persistent, ..Planner::new(&problem) };
        Some(planner.solve(start, self.anywhere(), &Settings::default(), usize::MAX)?.throw)
    }

    /// Throws that were stored for other constraints, near this target: a throw that lets the landing move with the delay
    /// is often near one that does not.
    pub(super) fn other_kinds(&self, index: &Index, kind: u32) -> Vec<Throw> {
        let mut near: Vec<&Record> =
            index.records().iter().filter(|r| r.kind != kind && self.away_m(r) <= OTHERS_WITHIN_M).collect();
        near.sort_by(|a, b| a.kind.cmp(&b.kind).then(self.away_m(a).total_cmp(&self.away_m(b))));
        let mut out = Vec::new();
        for group in near.chunk_by(|a, b| a.kind == b.kind) {
            out.extend(group.iter().take(OTHERS_PER_KIND).filter_map(|r| self.place(&r.throw)));
        }
        out
    }
}

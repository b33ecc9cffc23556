//! Continuation: a stored throw is carried to a target in steps, over range and height at the target's azimuth.

use nalgebra::Vector3;

use super::basins::Basins;
use super::local::Found;
use super::outcome::Watch;
use super::planner::{Planner, kind_of};
use super::problem::Problem;
use super::search::counted;
use crate::parallel::each;
use crate::solve::sqp::Settings;
use crate::store::{Index, Record};
use crate::throw::Throw;

/// Local solves on the way.
const SOLVES_MAX: usize = 16;
/// Shortest step, as a share of the way.
const STEP_MIN: f64 = 0.03;
/// Throws of every other kind that are tried.
const OTHERS_PER_KIND: usize = 2;
/// Stored throws that are walked from where a search has found none.
const NEAREST_WALKED: usize = 24;
/// Throws of another kind, and those that are walked from, are taken from targets within this distance, in m.
const WITHIN_M: f64 = 0.3;

impl<const N: usize> Planner<'_, '_, N> {
    /// From a stored target to this one: a step that fails is halved, one that succeeds doubles the next.
    pub(super) fn walk_to_target(&self, record: &Record<N>, stopped: &dyn Fn() -> bool) -> Option<Found<N>> {
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

    /// Walks to the target from the stored throws nearest to it, whatever they are expected to cost there.
    ///
    /// A kind of throw that reaches farther is often dearer than the one that ends before the target. Stored throws of the
    /// cheaper one are tried first and all end at the edge of its reach.
    pub(super) fn walk_from_nearest(
        &self,
        index: &Index<N>,
        stopped: &(dyn Fn() -> bool + Sync),
        watch: &Watch,
    ) -> Basins<N> {
        let kind = kind_of(&self.problem.options);
        let mut near = self.records_within(index, |record| record.kind == kind);
        near.sort_by(|a, b| self.away_m(a).total_cmp(&self.away_m(b)));
        near.truncate(NEAREST_WALKED);
        let walked =
            each(&near, |record| (!stopped()).then(|| counted(watch, self.walk_to_target(record, stopped))));
        let mut basins = Basins::default();
        walked.into_iter().flatten().for_each(|found| basins.add_stored(found));
        basins
    }

    fn at_other_target(&self, target: Vector3<f64>, start: &Throw<N>) -> Option<Throw<N>> {
        let problem = Problem::new(self.problem.arm, target, self.problem.options.clone()).ok()?;
        let planner = Planner { persistent: self.persistent, ..Planner::new(&problem) };
        Some(planner.solve(start, self.anywhere(), &Settings::default(), usize::MAX)?.throw)
    }

    /// Throws that were stored for other constraints, near this target: a throw that lets the landing move with the delay
    /// is often near one that does not.
    pub(super) fn other_kinds(&self, index: &Index<N>, kind: u32) -> Vec<Throw<N>> {
        let mut near = self.records_within(index, |record| record.kind != kind);
        near.sort_by(|a, b| a.kind.cmp(&b.kind).then(self.away_m(a).total_cmp(&self.away_m(b))));
        let mut out = Vec::new();
        for group in near.chunk_by(|a, b| a.kind == b.kind) {
            out.extend(group.iter().take(OTHERS_PER_KIND).filter_map(|r| self.place(&r.throw)));
        }
        out
    }

    /// Distance between the target of a stored throw and this one in m, over range and height.
    fn away_m(&self, record: &Record<N>) -> f64 {
        (record.range_m - self.range_m).hypot(record.height_m - self.problem.target.z)
    }

    fn records_within<'i>(
        &self,
        index: &'i Index<N>,
        wanted: impl Fn(&Record<N>) -> bool,
    ) -> Vec<&'i Record<N>> {
        index.records().iter().filter(|record| wanted(record) && self.away_m(record) <= WITHIN_M).collect()
    }
}

//! Requirements of a search on the landing when the gripper opens late, and which of them it gives up if no throw keeps them.
//!
//! The relaxation levels are, strictest first: nulling with limits of the landing's shift, nulling to
//! first order, no nulling. A search tries one level after the other until a level has a throw. Random starts often
//! miss the few local optima of a strict level: to some targets of a UR5 one start in thirty ends in one. So a
//! level without a throw is tried again if the next level has some: from the throws of that level, then, without a
//! table of this robot, from more random starts.

use nalgebra::Vector3;
use robot_model::RobotModel;

use super::local::Found;
use super::optima::Optima;
use super::options::Options;
use super::outcome::{Best, Budget, NoThrow, Watch};
use super::planner::Planner;
use super::problem::{Problem, ProblemError};
use super::search::counted;
use crate::parallel::each;
use crate::store::Index;

/// Throws of one level that are carried to the stricter one.
const CARRIED_MAX: usize = 12;
/// Random starts of the second try over those of the first: one start in thirty is then missed by one search in 10 000.
const SECOND_CHANCE: usize = 2;
/// Sets the random starts of the second chance apart.
const SECOND_SEED: u64 = 0x5ec0_4dc4_a4ce_0001;

/// What a search gave up to find a throw.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum GivenUp {
    /// The throw keeps the whole request.
    Nothing,
    /// The limits of the landing's shift; it is zero to first order.
    ShiftLimits,
    /// The nulling too; the landing moves with the delay.
    Nulling,
}

/// Requirements that a search must keep, because they were requested by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Kept {
    /// The limits of the landing's shift, and with them the nulling.
    pub shift_limits: bool,
    pub nulling: bool,
}

/// The options of all relaxation levels, strictest first: `asked`, and what may be given up of it.
#[must_use]
pub fn levels(asked: &Options, kept: Kept) -> Vec<(GivenUp, Options)> {
    let mut levels = vec![(GivenUp::Nothing, asked.clone())];
    if !kept.shift_limits && !asked.delay_windows.is_empty() {
        let nulled = Options { delay_windows: Vec::new(), ..asked.clone() };
        levels.push((GivenUp::ShiftLimits, nulled.clone()));
        if !kept.nulling {
            levels.push((GivenUp::Nulling, Options { null_delay: false, ..nulled }));
        }
    }
    levels
}

/// A target with the problems of all relaxation levels.
#[derive(Debug, Clone)]
pub struct Relaxation<'a> {
    /// Strictest first; never empty.
    levels: Vec<(GivenUp, Problem<'a>)>,
}

/// The throw of a search over the levels.
#[derive(Debug, Clone)]
pub struct Settled<'l, 'a> {
    /// The problem that the throw solves.
    pub problem: &'l Problem<'a>,
    /// Requirements that it does not keep.
    pub given_up: GivenUp,
    /// The best throw.
    pub best: Best,
    /// True if the first tries of stored throws were not enough, or not requested.
    pub searched: bool,
}

impl<'a> Relaxation<'a> {
    /// The relaxation levels for a target, in m.
    ///
    /// # Errors
    /// The options are refused.
    pub fn new(
        arm: &'a RobotModel,
        target: Vector3<f64>,
        asked: &Options,
        kept: Kept,
    ) -> Result<Self, ProblemError> {
        let mut problems = Vec::new();
        for (given_up, options) in levels(asked, kept) {
            problems.push((given_up, Problem::new(arm, target, options)?));
        }
        Ok(Self { levels: problems })
    }

    /// The best throw within a budget, at the strictest level that has a throw.
    ///
    /// Every level has the whole budget of starts. With `quick`, this many stored throws of each level are tried
    /// first, and the first that leads to the target ends the search of that level. A target clearly out of reach
    /// is refused at once.
    ///
    /// # Errors
    /// [`NoThrow`] if no level has a throw; with the nearest reachable target of the last level unless the search was stopped.
    pub fn search(
        &self,
        index: &Index,
        budget: &Budget,
        watch: &Watch,
        quick: Option<usize>,
    ) -> Result<Settled<'_, 'a>, NoThrow> {
        let last = Planner::new(&self.levels[self.levels.len() - 1].1);
        if let Some(none) = last.refused_at_once(index, budget, watch) {
            return Err(none);
        }
        let (mut at, mut searched) = (0, false);
        let best = loop {
            let planner = Planner::new(&self.levels[at].1);
            if let Some(best) = quick.and_then(|tries| stored_alone(&planner, index, tries)) {
                break best;
            }
            searched = true;
            if at + 1 == self.levels.len() {
                break planner.search(index, budget, watch)?;
            }
            match planner.attempt(index, budget, watch) {
                Ok(best) => break best,
                Err(none) if none.interrupted => return Err(none),
                Err(_) => at += 1,
            }
        };
        Ok(Settled { searched, ..self.climb(at, best, index, budget, watch) })
    }

    /// Tries the levels stricter than one that has throws again, the nearest first.
    fn climb(&self, at: usize, best: Best, index: &Index, budget: &Budget, watch: &Watch) -> Settled<'_, 'a> {
        let (mut at, mut best) = (at, best);
        // A requested number of starts is kept.
        let more = (!budget.all && !index.is_own()).then_some(Budget {
            starts: SECOND_CHANCE * budget.starts,
            seed: budget.seed ^ SECOND_SEED,
            ..*budget
        });
        for above in (0..at).rev() {
            let planner = Planner::new(&self.levels[above].1);
            let again = || planner.attempt(index, &more?, watch).ok();
            let Some(found) = carry(&planner, &best.others, watch).or_else(again) else { continue };
            best = Best { starts: best.starts + found.starts, ..found };
            at = above;
        }
        let (given_up, problem) = &self.levels[at];
        Settled { problem, given_up: *given_up, best, searched: true }
    }
}

fn stored_alone(planner: &Planner<'_, '_>, index: &Index, tries: usize) -> Option<Best> {
    planner.from_index(index, tries).map(Best::alone)
}

/// The best throw that local solves from throws of another level end in.
fn carry(planner: &Planner<'_, '_>, from: &[Found], watch: &Watch) -> Option<Best> {
    let stopped = || watch.stop.load(std::sync::atomic::Ordering::Relaxed);
    let carried = each(&from[..from.len().min(CARRIED_MAX)], |found| {
        (!stopped()).then(|| counted(watch, planner.solve_from_throw(&found.throw)))
    });
    let mut optima = Optima::default();
    carried.into_iter().flatten().for_each(|found| optima.add_stored(found));
    planner.best_of(&optima, &stopped)
}

//! What the search for throws to one target has in common: the problem, a start, one local solve.

use robot_model::JointVec;

use super::goal::Goal;
use super::local::{Begin, Found, solve_from};
use super::options::Options;
use super::posture::{launching_start, mirror_signs, resting_start, varied_start};
use super::problem::Problem;
use super::rng::SplitMix64;
use super::scan::Scanner;
use crate::solve::sqp::Settings;
use crate::store::Record;
use crate::throw::Throw;

/// Which constraints a stored throw was made for; only the same kind is offered as a start first.
#[must_use]
pub fn kind_of(options: &Options) -> u32 {
    u32::from(options.free_spin)
        | u32::from(options.null_delay) << 1
        | u32::from(options.clean_release) << 2
        | u32::from(!options.avoid_collisions) << 3
        | u32::from(!options.delay_windows.is_empty()) << 4
}

/// Plans throws for one problem; holds what depends on the problem but not on the start.
#[derive(Debug, Clone)]
pub struct Planner<'p, 'a> {
    pub(super) problem: &'p Problem<'a>,
    /// The problem with the paper's objective, if `problem` has another: every start is solved for it first.
    pub(super) effort: Option<Problem<'a>>,
    pub(super) scanner: Scanner,
    pub(super) azimuth_rad: f64,
    pub(super) range_m: f64,
    pub(super) mirror: Option<JointVec>,
    pub(super) persistent: bool,
}

impl<'p, 'a> Planner<'p, 'a> {
    #[must_use]
    pub fn new(problem: &'p Problem<'a>) -> Self {
        // Stored throws are for targets at rest: for one that moves, its later position is used.
        let t = &problem.aim.point_at(USUAL_FLIGHT_S);
        let effort = (problem.options.goal != Goal::Effort).then(|| {
            let mut effort = problem.clone();
            effort.options.goal = Goal::Effort;
            effort
        });
        Self {
            problem,
            effort,
            scanner: Scanner::new(problem),
            azimuth_rad: t.y.atan2(t.x),
            range_m: t.x.hypot(t.y),
            mirror: mirror_signs(problem),
            persistent: false,
        }
    }

    /// A start that runs into a collision begins again with its rows: more starts end in a throw, and each takes longer.
    #[must_use]
    pub fn persistent(self) -> Self {
        Self { persistent: true, ..self }
    }

    /// Distance from the target of a stored throw in m, over range and height.
    pub(super) fn away_m(&self, record: &Record) -> f64 {
        (record.range_m - self.range_m).hypot(record.height_m - self.problem.target.z)
    }

    /// A local solve from random start number `index`: an arm at rest. Without a table, `known` are the throws so far, and
    /// every second start moves: it launches the ball, or varies one of the cheapest throws.
    pub(super) fn solve_random(&self, seed: u64, index: u64, known: Option<&[Found]>) -> Option<Found> {
        let mut rng = SplitMix64::stream(seed, index);
        let (start, begin) = match known.filter(|_| index % 2 == 1) {
            None => (resting_start(self.problem, &mut rng), Begin::Rest { again: self.persistent }),
            Some(known) => {
                let known = &known[..known.len().min(VARIED)];
                let from = known.get((rng.unit() * known.len() as f64) as usize).filter(|_| index % 4 == 3);
                let start = match from {
                    Some(from) => varied_start(self.problem, &from.throw, &mut rng),
                    None => launching_start(self.problem, &mut rng),
                };
                (start, self.anywhere())
            }
        };
        let whole = self.effort.as_ref().unwrap_or(self.problem);
        let mut inside = whole.clone();
        inside.window_share = INSIDE_SHARE;
        let found =
            solve_from(&inside, &self.scanner, &start, begin, &Settings::default(), usize::MAX).ok()?;
        if whole.options.delay_windows.is_empty() {
            return Some(found);
        }
        Some(self.solve_from_throw(&found.throw).filter(|f| f.objective < found.objective).unwrap_or(found))
    }

    /// Of a start of which nothing is known.
    pub(super) fn anywhere(&self) -> Begin {
        Begin::Anywhere { again: self.persistent }
    }

    pub(super) fn solve(
        &self,
        start: &Throw,
        begin: Begin,
        settings: &Settings,
        most: usize,
    ) -> Option<Found> {
        let problem = self.effort.as_ref().unwrap_or(self.problem);
        solve_from(problem, &self.scanner, start, begin, settings, most).ok()
    }
}

/// Random starts first use this share of the limits of the landing's shift, then all of it. The number of them that
/// end in a throw changes erratically with it, for an unknown reason: to (1.5, 1, -1) 28 of 60 with this share, 13
/// with all of it (docs/measured/search-quality.md).
const INSIDE_SHARE: f64 = 0.98;
/// Throws that random starts vary.
const VARIED: usize = 4;
/// About the time of flight of a throw, in s.
const USUAL_FLIGHT_S: f64 = 0.6;

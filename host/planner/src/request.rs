//! Throws for a calling program.

use std::time::{Duration, Instant};

use nalgebra::{Vector2, Vector3};
use robot_model::RobotModel;

use crate::plan::file::PlanFile;
use crate::plan::finger_release::monte_carlo_with_fingers;
use crate::plan::relaxation::Settled;
use crate::plan::statistics::{Noise, Region, monte_carlo};
use crate::plan::{
    Best, Budget, Found, GivenUp, Kept, NoThrow, Options, Problem, ProblemError, Relaxation, Watch,
};
use crate::store::Index;
use crate::throw::Throw;

/// A requested throw.
#[derive(Debug, Clone, Copy)]
pub struct Request<'a> {
    /// Centre of the target in m, world frame.
    pub target: Vector3<f64>,
    /// What may be thrown how.
    pub options: &'a Options,
    /// What must not be given up.
    pub kept: Kept,
    /// This many stored throws are tried first; the first that leads to the target ends the search.
    pub quick: Option<usize>,
    /// Random starts, time and seed.
    pub budget: Budget,
}

/// What is wanted besides the throw.
#[derive(Debug, Clone, Copy)]
pub struct Wanted<'a> {
    /// Name or file of the robot, for the plan file.
    pub robot: &'a str,
    /// What varies from throw to throw.
    pub noise: &'a Noise,
    /// What counts as a hit; without one, the opening of the target.
    pub region: Option<Region>,
    /// Number and seed of disturbed throws to draw.
    pub draws: Option<(usize, u64)>,
}

/// The throw of a request.
#[derive(Debug, Clone)]
pub struct Answer {
    /// Requirements that it does not keep.
    pub given_up: GivenUp,
    /// The best throw.
    pub best: Best,
    /// Whether more was done than trying [`Request::quick`] stored throws.
    pub searched: bool,
    /// Time of the search.
    pub took: Duration,
}

/// The throw of a request with what was wanted besides.
#[derive(Debug, Clone)]
pub struct Planned {
    /// The throw.
    pub answer: Answer,
    /// `None` if the ball of the throw never comes down on the plane of the target, or stays in the fingers.
    pub plan: Option<PlanFile>,
    /// What counts as a hit.
    pub region: Option<Region>,
    /// The target in m in its plane.
    pub centre: Vector2<f64>,
    /// Landings of the disturbed throws in m in the plane of the target, if any were wanted.
    pub landings: Option<Vec<Vector2<f64>>>,
}

/// Why there is no throw.
#[derive(Debug, Clone, thiserror::Error)]
pub enum Refusal {
    #[error(transparent)]
    Options(#[from] ProblemError),
    #[error(transparent)]
    NoThrow(#[from] NoThrow),
}

impl Request<'_> {
    /// The best throw from the stored ones of `index` and from random starts.
    ///
    /// # Errors
    /// [`Refusal`].
    pub fn search(&self, arm: &RobotModel, index: &Index, watch: &Watch) -> Result<Answer, Refusal> {
        self.settle(&self.relaxation(arm)?, index, watch).map(|(answer, _)| answer)
    }

    /// As [`Request::search`], with the plan file.
    ///
    /// # Errors
    /// [`Refusal`].
    pub fn plan(
        &self,
        arm: &RobotModel,
        index: &Index,
        wanted: &Wanted<'_>,
        watch: &Watch,
    ) -> Result<Planned, Refusal> {
        let relaxation = self.relaxation(arm)?;
        let (answer, problem) = self.settle(&relaxation, index, watch)?;
        let Found { throw, .. } = &answer.best.found;
        let Wanted { robot, noise, .. } = wanted;
        let region = wanted.region.or_else(|| problem.region_of_opening(throw));
        let landings =
            wanted.draws.map(|(count, seed)| match arm.fingers().filter(|_| self.options.finger_release) {
                None => monte_carlo(problem, throw, noise, count, seed),
                Some(fingers) => monte_carlo_with_fingers(problem, throw, fingers, noise, count, seed),
            });
        let plan = PlanFile::of(problem, &answer.best, robot, self.budget.seed, noise, region);
        let centre = problem.aim().centre();
        Ok(Planned { answer, plan, region, centre, landings })
    }

    fn relaxation<'a>(&self, arm: &'a RobotModel) -> Result<Relaxation<'a>, ProblemError> {
        Relaxation::new(arm, self.target, self.options, self.kept)
    }

    fn settle<'l, 'a>(
        &self,
        relaxation: &'l Relaxation<'a>,
        index: &Index,
        watch: &Watch,
    ) -> Result<(Answer, &'l Problem<'a>), Refusal> {
        let began = Instant::now();
        let Settled { problem, given_up, best, searched } =
            relaxation.search(index, &self.budget, watch, self.quick)?;
        Ok((Answer { given_up, best, searched, took: began.elapsed() }, problem))
    }
}

/// The plan file of a throw that is already known, which need not keep any limit. `None` if its ball never comes down on the
/// plane of the target, or stays in the fingers.
///
/// # Errors
/// The options are refused.
pub fn plan_of(
    arm: &RobotModel,
    throw: &Throw,
    target: Vector3<f64>,
    options: &Options,
) -> Result<Option<PlanFile>, ProblemError> {
    let problem = Problem::new(arm, target, options.clone())?;
    let objective = options.goal.value(&problem, throw);
    let found =
        Found { throw: *throw, objective, iterations: 0, slope_per_m: Vector3::zeros(), touches: false };
    Ok(PlanFile::of(&problem, &Best::alone(found), arm.name(), 0, &Noise::default(), None))
}

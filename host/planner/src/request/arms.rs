//! The search compiled for each number of joints.

use std::time::Instant;

use nalgebra::Vector3;
use robot_model::RobotModel;

use super::{Answer, Planned, Plans, Refusal, Request, Wanted};
use crate::plan::file::PlanFile;
use crate::plan::finger_release::monte_carlo_with_fingers;
use crate::plan::ladder::{Ladder, Settled};
use crate::plan::prepare::Preparation;
use crate::plan::statistics::{Noise, monte_carlo};
use crate::plan::{Best, Found, Options, Problem, ProblemError, Watch};
use crate::store::{Index, Record};
use crate::throw::Throw;
use crate::verify;

macro_rules! plans {
    ($($joints:literal)*) => {$(
        impl Plans<$joints> for RobotModel<$joints> {
            fn search(
                &self,
                index: &Index<$joints>,
                request: &Request<'_>,
                watch: &Watch,
            ) -> Result<Answer<$joints>, Refusal> {
                settle(&ladder(self, request)?, index, request, watch).map(|(answer, _)| answer)
            }

            fn plan(
                &self,
                index: &Index<$joints>,
                request: &Request<'_>,
                wanted: &Wanted<'_>,
                watch: &Watch,
            ) -> Result<Planned<$joints>, Refusal> {
                plan(self, index, request, wanted, watch)
            }

            fn plan_of(
                &self,
                throw: &Throw<$joints>,
                target: Vector3<f64>,
                options: &Options,
            ) -> Result<Option<PlanFile>, ProblemError> {
                plan_of(self, throw, target, options)
            }

            fn prepare_step(
                preparation: &Preparation<'_, $joints>,
                step: usize,
                records: Vec<Record<$joints>>,
                stopped: &(dyn Fn() -> bool + Sync),
            ) -> Option<Vec<Record<$joints>>> {
                preparation.step(step, records, stopped)
            }

            fn check(&self, plan: &PlanFile) -> verify::Report {
                verify::check(self, plan)
            }
        }
    )*};
}
// The unit tests need no search. To compile it for all four numbers of joints would take them 20 s longer.
#[cfg(not(test))]
plans!(4 5 6 7);
#[cfg(test)]
plans!(6);

fn ladder<'a, const N: usize>(
    arm: &'a RobotModel<N>,
    request: &Request<'_>,
) -> Result<Ladder<'a, N>, ProblemError> {
    Ladder::new(arm, request.target, request.options, request.kept)
}

fn settle<'l, 'a, const N: usize>(
    ladder: &'l Ladder<'a, N>,
    index: &Index<N>,
    request: &Request<'_>,
    watch: &Watch,
) -> Result<(Answer<N>, &'l Problem<'a, N>), Refusal> {
    let began = Instant::now();
    let Settled { problem, given_up, best } = ladder.search(index, &request.budget, watch, request.quick)?;
    Ok((Answer { given_up, best, took: began.elapsed() }, problem))
}

fn plan<const N: usize>(
    arm: &RobotModel<N>,
    index: &Index<N>,
    request: &Request<'_>,
    wanted: &Wanted<'_>,
    watch: &Watch,
) -> Result<Planned<N>, Refusal> {
    let ladder = ladder(arm, request)?;
    let (answer, problem) = settle(&ladder, index, request, watch)?;
    let Found { throw, .. } = &answer.best.found;
    let Wanted { robot, noise, .. } = wanted;
    let region = wanted.region.or_else(|| problem.region_of_opening(throw));
    let landings =
        wanted.draws.map(|(count, seed)| match arm.fingers().filter(|_| request.options.finger_release) {
            None => monte_carlo(problem, throw, noise, count, seed),
            Some(fingers) => monte_carlo_with_fingers(problem, throw, fingers, noise, count, seed),
        });
    let plan = PlanFile::of(problem, &answer.best, robot, request.budget.seed, noise, region);
    let centre = problem.aim().centre();
    Ok(Planned { answer, plan, region, centre, landings })
}

fn plan_of<const N: usize>(
    arm: &RobotModel<N>,
    throw: &Throw<N>,
    target: Vector3<f64>,
    options: &Options,
) -> Result<Option<PlanFile>, ProblemError> {
    let problem = Problem::new(arm, target, options.clone())?;
    let objective = options.goal.value(&problem, throw);
    let found =
        Found { throw: *throw, objective, iterations: 0, slope_per_m: Vector3::zeros(), touches: false };
    Ok(PlanFile::of(&problem, &Best::alone(found), arm.name(), 0, &Noise::default(), None))
}

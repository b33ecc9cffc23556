//! Throws as a program asks for them, for arms of four to seven joints.
//!
//! The search is generic in the number of joints, so a package that calls it compiles it again, four times. [`Plans`] is implemented
//! for each number in `arms`, so what it calls is compiled here only.

// Unit tests name their numbers of joints themselves: to compile all of them again would take a minute.
#[cfg(not(test))]
mod arms;

use std::time::Duration;

use nalgebra::{Vector2, Vector3};

use crate::plan::file::PlanFile;
use crate::plan::prepare::Preparation;
use crate::plan::statistics::{Noise, Region};
use crate::plan::{Best, Budget, GivenUp, Kept, NoThrow, Options, ProblemError, Watch};
use crate::store::{Index, Record};
use crate::throw::Throw;
use crate::verify;

/// A throw that is asked for.
#[derive(Debug, Clone, Copy)]
pub struct Request<'a> {
    /// Centre of the target in m, world frame.
    pub target: Vector3<f64>,
    /// What may be thrown how.
    pub options: &'a Options,
    /// What must not be given up.
    pub kept: Kept,
    /// So many stored throws are tried first; the first that leads to the target ends the search.
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
pub struct Answer<const N: usize> {
    /// What it does not keep of what was asked for.
    pub given_up: GivenUp,
    /// The best throw.
    pub best: Best<N>,
    /// Time of the search.
    pub took: Duration,
}

/// The throw of a request with what was wanted besides.
#[derive(Debug, Clone)]
pub struct Planned<const N: usize> {
    /// The throw.
    pub answer: Answer<N>,
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

/// An arm of `N` joints that throws are planned for.
pub trait Plans<const N: usize> {
    /// The best throw from the stored ones of `index` and from random starts.
    ///
    /// # Errors
    /// [`Refusal`].
    fn search(&self, index: &Index<N>, request: &Request<'_>, watch: &Watch) -> Result<Answer<N>, Refusal>;

    /// As [`Plans::search`], with the plan file.
    ///
    /// # Errors
    /// [`Refusal`].
    fn plan(
        &self,
        index: &Index<N>,
        request: &Request<'_>,
        wanted: &Wanted<'_>,
        watch: &Watch,
    ) -> Result<Planned<N>, Refusal>;

    /// The plan file of a throw that is already known, which need not keep any limit. `None` if its ball never comes down on the
    /// plane of the target, or stays in the fingers.
    ///
    /// # Errors
    /// The options are refused.
    fn plan_of(
        &self,
        throw: &Throw<N>,
        target: Vector3<f64>,
        options: &Options,
    ) -> Result<Option<PlanFile>, ProblemError>;

    /// [`Preparation::step`].
    fn prepare_step(
        preparation: &Preparation<'_, N>,
        step: usize,
        records: Vec<Record<N>>,
        stopped: &(dyn Fn() -> bool + Sync),
    ) -> Option<Vec<Record<N>>>;

    /// [`verify::check()`].
    fn check(&self, plan: &PlanFile) -> verify::Report;
}

//! `cubectl plan …`

pub mod options;
pub mod seeds;
pub mod sweep;
pub mod throw;

use crate::error::ExpectedError;

/// Kinds of planning.
#[derive(Debug, clap::Subcommand)]
pub enum PlanVerb {
    /// Find the best throw to a target.
    Throw(throw::Args),
    /// Plan throws to a grid of targets: a table and a picture of the reach.
    Sweep(sweep::Args),
    /// Make the table of starting throws of a robot again.
    Seeds(seeds::Args),
}

/// Runs the verb.
///
/// # Errors
/// As the verbs.
pub fn run(verb: PlanVerb) -> Result<(), ExpectedError> {
    match verb {
        PlanVerb::Throw(args) => throw::run(&args),
        PlanVerb::Sweep(args) => sweep::run(&args),
        PlanVerb::Seeds(args) => seeds::run(&args),
    }
}

//! `cubectl plan …`

pub mod args;
pub mod check;
pub mod export;
pub mod follow;
pub mod follow_options;
pub mod for_programs;
pub mod grid;
pub mod options;
pub mod search;
pub mod shards;
pub mod sweep;
pub mod throw;

use std::path::Path;

use crate::error::ExpectedError;

/// Kinds of planning.
#[derive(Debug, clap::Subcommand)]
pub enum PlanVerb {
    /// Find the best throw to a target.
    Throw(Box<args::Args>),
    /// Plan throws to many targets, a grid or a list: CSV part files, made on one machine or on many.
    Sweep(Box<sweep::Args>),
    /// Check a plan file again, by other means than the planner's.
    Check(check::Args),
    /// Write the joint motion of a plan as a table.
    Export(export::Args),
    /// Print the JSON schema of plan files of every kind.
    #[command(after_help = "Example:\n  cubectl plan schema > plan.schema.json")]
    Schema,
}

/// Refuses a file that could not be written after the search, before it.
fn require_writable(path: &Path) -> Result<(), ExpectedError> {
    let there = path.exists();
    let opened = std::fs::OpenOptions::new().append(true).create(true).open(path);
    opened.map_err(|e| ExpectedError::output(path, &e))?;
    if !there {
        // Nothing was in it.
        std::fs::remove_file(path).map_err(|e| ExpectedError::output(path, &e))?;
    }
    Ok(())
}

pub fn run(verb: PlanVerb) -> Result<(), ExpectedError> {
    match verb {
        PlanVerb::Throw(args) => throw::run(&args),
        PlanVerb::Sweep(args) => sweep::run(&args),
        PlanVerb::Check(args) => check::run(&args),
        PlanVerb::Export(args) => export::run(&args),
        PlanVerb::Schema => {
            console::line!("{}", planner::record::schema_json().trim_end());
            Ok(())
        }
    }
}

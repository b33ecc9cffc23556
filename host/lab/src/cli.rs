//! Command line of `cubelab`: which verb, with which arguments.

use clap::{Parser, Subcommand};
use host::cmd::completions;
use host::error::ExpectedError;
use host::program;

use crate::cmd;

/// Environment variable by which a completion script asks this program.
pub const COMPLETE_VARIABLE: &str = "CUBELAB_COMPLETE";

/// Study throws and catches: rallies of two arms, random throws with faults.
#[derive(Debug, Parser)]
#[command(name = "cubelab", version, about, after_help = program::after_help(EXAMPLES))]
pub struct Cli {
    #[command(subcommand)]
    pub verb: Verb,
}

const EXAMPLES: &str = "Examples:
  cubelab rally --throws 20 --report rally.html
  cubelab place --distance-m 3 --hand matched --out placed.toml
  cubelab swarm --seeds 200";

#[derive(Debug, Subcommand)]
pub enum Verb {
    /// Let two arms throw a ball to each other and catch it.
    Rally(Box<cmd::rally::Args>),
    /// Find where two arms stand so that most of the balls that they throw to each other can be caught.
    Place(Box<cmd::place::Args>),
    /// Throw in random simulated cells with faults, and judge each throw from the plant.
    Swarm(cmd::swarm::Args),
    /// Write a completion script for a shell.
    #[command(after_help = completions::after_help("cubelab"))]
    Completions(completions::Args),
}

pub fn run(cli: Cli) -> Result<(), ExpectedError> {
    match cli.verb {
        Verb::Rally(args) => cmd::rally::run(&args),
        Verb::Place(args) => cmd::place::run(&args),
        Verb::Swarm(args) => cmd::swarm::run(&args),
        Verb::Completions(args) => completions::run(&args, "cubelab", COMPLETE_VARIABLE),
    }
}

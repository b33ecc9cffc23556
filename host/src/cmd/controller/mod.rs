//! `cubectl controller …`: run a controller, and change what one keeps.

pub mod clear;
pub mod key;
pub mod registers;
pub mod run;
pub mod unlock;
pub mod upload;

use crate::error::ExpectedError;

/// What is done with the controller.
#[derive(Debug, clap::Subcommand)]
pub enum ControllerVerb {
    /// Run the controller as a program on this machine, on any bus.
    Run(run::Args),
    /// Let the controller forget a latched fault and look at the drives again; nothing moves.
    Clear(clear::Args),
    /// Store a trajectory file in the controller and commit it; nothing moves.
    Upload(upload::Args),
    /// Show, set, list and export the settings of a controller.
    #[command(subcommand)]
    Registers(Box<registers::RegistersVerb>),
    /// Make, set and remove the key of a controller.
    #[command(subcommand)]
    Key(key::KeyVerb),
    /// Let a controller take limits beyond those of its robot for a while.
    Unlock(unlock::Args),
}

pub fn run(verb: &ControllerVerb) -> Result<(), ExpectedError> {
    match verb {
        ControllerVerb::Run(args) => run::run(args),
        ControllerVerb::Clear(args) => clear::run(args),
        ControllerVerb::Upload(args) => upload::run(args),
        ControllerVerb::Registers(verb) => registers::run(verb),
        ControllerVerb::Key(verb) => key::run(verb),
        ControllerVerb::Unlock(args) => unlock::run(args),
    }
}

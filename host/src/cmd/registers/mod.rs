//! `cubectl registers get|set|list|export`: the settings of a controller, by name and with their units.

mod export;
mod get;
mod list;
mod set;
mod value;

use crate::error::ExpectedError;

/// What to do with the registers of a controller.
#[derive(Debug, clap::Subcommand)]
pub enum RegistersVerb {
    /// Show what registers hold.
    Get(get::Args),
    /// Write registers, by name or from a file of `export`, and look whether each value was taken.
    Set(set::Args),
    /// Show all registers with type, range and meaning.
    List(list::Args),
    /// Write all registers that can be set to a file that `set --file` reads.
    Export(export::Args),
}

/// Runs the verb.
///
/// # Errors
/// A name or value, a file, the bus, or a controller that refuses.
pub fn run(verb: &RegistersVerb) -> Result<(), ExpectedError> {
    match verb {
        RegistersVerb::Get(args) => get::run(args),
        RegistersVerb::Set(args) => set::run(args),
        RegistersVerb::List(args) => list::run(args),
        RegistersVerb::Export(args) => export::run(args),
    }
}

//! `cubectl controller registers get|set|list|export`: the settings of a controller, by name and with their units.

mod export;
mod get;
mod list;
mod set;
mod value;

use std::path::Path;

use operator::dialogue::operator::OperatorError;
use operator::dialogue::registers::Numbers;
use operator::identify::mounting::{Mounting, Source};

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

pub fn run(verb: &RegistersVerb) -> Result<(), ExpectedError> {
    match verb {
        RegistersVerb::Get(args) => get::run(args),
        RegistersVerb::Set(args) => set::run(args),
        RegistersVerb::List(args) => list::run(args),
        RegistersVerb::Export(args) => export::run(args),
    }
}

/// How a file of `export` says that the drives are mounted.
///
/// # Errors
/// The file, or a register that is missing in it or holds what no controller does.
pub(in crate::cmd) fn mounting_in(path: &Path, source: Source) -> Result<Mounting, ExpectedError> {
    let found = set::read(path)?;
    Mounting::of(source, &mut |name| {
        let missing = || OperatorError::NoRegister { name: name.to_owned() };
        let (_, texts) = found.iter().find(|(other, _)| other == name).ok_or_else(missing)?;
        let like = match name {
            "joint.inverted" => Numbers::Bit(vec![false; texts.len()]),
            "joint.offset_rad" => Numbers::Real(vec![0.0; texts.len()]),
            _ => Numbers::Natural(vec![0; texts.len()]),
        };
        value::parse(&like, texts.iter().map(String::as_str)).map_err(|_| missing())
    })
    .map_err(|error| match error {
        OperatorError::NoRegister { name } => {
            ExpectedError::bad_input(&format!("{}: no usable {name}", path.display()))
                .next("use a file of `cubectl controller registers export`")
        }
        error => error.into(),
    })
}

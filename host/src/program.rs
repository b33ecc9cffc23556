//! What surrounds the verbs of a program, `cubectl` and `cubelab`: completions, the command line, and how it ends.

use std::process::ExitCode;

use clap::{CommandFactory, FromArgMatches};
use clap_complete::CompleteEnv;

use crate::advice::{self, Place};
use crate::cmd::meaning;
use crate::error::ExpectedError;
use crate::{complete, exit};

/// Runs the program with the command line `C`. `complete_variable` is the environment variable by which its completion script asks it.
pub fn run<C: CommandFactory + FromArgMatches>(
    complete_variable: &'static str,
    verb: fn(C) -> Result<(), ExpectedError>,
) -> ExitCode {
    // Ends the program if a shell asks for completions.
    CompleteEnv::with_factory(complete::command::<C>).var(complete_variable).complete();
    let mut command = C::command();
    let matches = command.get_matches_mut();
    let cli = C::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    let ended = meaning::require_on_bus(&command, &matches).and_then(|()| {
        if let Some(note) = advice::on_simulated_cell(&matches) {
            console::note!("{note}");
        }
        verb(cli)
    });
    match ended.and_then(|()| output_is_whole()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            console::note!("{}: {}", command.get_name(), Place::of_matches(&matches).told(&error.message));
            ExitCode::from(error.code)
        }
    }
}

/// Whether everything that was written to standard output is there.
///
/// # Errors
/// Part of it could not be written, as to a full disk. A closed reader is no error.
fn output_is_whole() -> Result<(), ExpectedError> {
    console::lost().map_or(Ok(()), |error| {
        Err(ExpectedError::new(
            exit::OUTPUT,
            format!(
                "standard output is not whole: {error}\n  next: free space where it goes to, and run again"
            ),
        ))
    })
}

/// What stands below the list of verbs: examples and exit codes.
pub fn after_help(examples: &str) -> String {
    let mut text = format!("{examples}\n\nExit codes:\n");
    for (code, meaning, _) in exit::TABLE {
        text += &format!("  {code:2}  {meaning}\n");
    }
    text + "`cubectl explain exit` says what to do next."
}

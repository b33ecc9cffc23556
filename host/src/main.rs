//! `cubectl`: wiring only; the work is in the library.

#![warn(clippy::print_stdout, clippy::print_stderr)]

use std::process::ExitCode;

use clap::{CommandFactory, FromArgMatches};
use host::advice::Place;
use host::cli::Cli;

fn main() -> ExitCode {
    // Ends the program if a shell asks for completions.
    clap_complete::CompleteEnv::with_factory(host::complete::command)
        .var(host::cmd::completions::VARIABLE)
        .complete();
    let mut program = Cli::command();
    let matches = program.get_matches_mut();
    let cli = Cli::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    let ended = host::cli::run(cli, &program, &matches);
    match ended.and_then(|()| host::cli::output_is_whole()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            console::note!("cubectl: {}", Place::of_matches(&matches).told(&error.message));
            ExitCode::from(error.code)
        }
    }
}

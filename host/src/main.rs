//! `cubectl`: wiring only; the work is in the library.

#![warn(clippy::print_stdout, clippy::print_stderr)]

use std::process::ExitCode;

use clap::Parser;

fn main() -> ExitCode {
    // Ends the program if a shell asks for completions.
    clap_complete::CompleteEnv::with_factory(host::complete::command)
        .var(host::cmd::completions::VARIABLE)
        .complete();
    let ended = host::cli::run(host::cli::Cli::parse());
    match ended.and_then(|()| host::cli::output_is_whole()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            console::note!("cubectl: {error}");
            ExitCode::from(error.code)
        }
    }
}

//! `cubectl`: wiring only; the work is in the library.

use std::process::ExitCode;

use clap::Parser;

fn main() -> ExitCode {
    match host::cli::run(host::cli::Cli::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("cubectl: {error}");
            ExitCode::from(error.code)
        }
    }
}

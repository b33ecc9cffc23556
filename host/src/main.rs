//! `cubectl`: wiring only; the work is in the library.

use std::process::ExitCode;

fn main() -> ExitCode {
    let words = host::cli::full_names(std::env::args_os().collect());
    host::program::run(words, host::cli::COMPLETE_VARIABLE, host::cli::run)
}

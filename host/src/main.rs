//! `cubectl`: wiring only; the work is in the library.

use std::process::ExitCode;

fn main() -> ExitCode {
    host::program::run(host::cli::COMPLETE_VARIABLE, host::cli::run)
}

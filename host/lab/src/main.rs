//! `cubelab`: wiring only; the work is in the library.

use std::process::ExitCode;

fn main() -> ExitCode {
    host::program::run(std::env::args_os().collect(), lab::cli::COMPLETE_VARIABLE, lab::cli::run)
}

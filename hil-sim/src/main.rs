//! `hil-sim`: the simulated cell as a program.

#![warn(clippy::print_stdout, clippy::print_stderr)]

mod cmd;

use std::process::ExitCode;

fn main() -> ExitCode {
    cmd::main()
}

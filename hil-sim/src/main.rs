//! `hil-sim`: the simulated cell as a program.

mod cmd;

use std::process::ExitCode;

fn main() -> ExitCode {
    cmd::main()
}

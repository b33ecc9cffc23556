//! `cubectl completions`

use std::io::Write;

use clap::Command;
use clap_complete::{Shell, generate};

use crate::error::ExpectedError;
use crate::exit;

/// Arguments.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl completions bash > ~/.local/share/bash-completion/completions/cubectl\n  cubectl completions zsh > ~/.zfunc/_cubectl\n  cubectl completions fish > ~/.config/fish/completions/cubectl.fish"
)]
pub struct Args {
    /// Which shell.
    pub shell: Shell,
}

/// Runs the verb for the command line `cli`.
///
/// # Errors
/// The terminal cannot be written to.
pub fn run(args: &Args, mut cli: Command) -> Result<(), ExpectedError> {
    let mut script = Vec::new();
    generate(args.shell, &mut cli, "cubectl", &mut script);
    to_terminal(&script)
}

/// Writes to standard output; a reader that has seen enough is no error.
pub(super) fn to_terminal(bytes: &[u8]) -> Result<(), ExpectedError> {
    match std::io::stdout().write_all(bytes) {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => {
            Err(ExpectedError::new(exit::OUTPUT, format!("terminal: {error}")))
        }
        _ => Ok(()),
    }
}

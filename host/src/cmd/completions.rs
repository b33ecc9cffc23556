//! `cubectl completions`

use std::io::Write;

use clap::ValueEnum as _;
use clap_complete::Shell;
use clap_complete::env::Shells;

use crate::error::ExpectedError;
use crate::exit;

/// Arguments.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl completions bash > ~/.local/share/bash-completion/completions/cubectl\n  cubectl completions zsh > ~/.zfunc/_cubectl\n  cubectl completions fish > ~/.config/fish/completions/cubectl.fish\n\nThe script asks `cubectl`, which must be in the search path, for what fits: verbs, options, robots, the buses of this machine,\nfault numbers and files."
)]
pub struct Args {
    /// Which shell.
    pub shell: Shell,
}

/// Environment variable by which a completion script asks this program.
pub const VARIABLE: &str = "CUBECTL_COMPLETE";

/// Runs the verb.
///
/// # Errors
/// The terminal cannot be written to.
pub fn run(args: &Args) -> Result<(), ExpectedError> {
    let shell = args.shell.to_possible_value();
    let shells = Shells::builtins();
    let completer = shell.as_ref().and_then(|shell| shells.completer(shell.get_name()));
    let completer = completer.ok_or_else(|| {
        ExpectedError::new(
            exit::USAGE,
            format!(
                "no completions for {}\n  next: one of {}",
                args.shell,
                shells.names().collect::<Vec<_>>().join(", ")
            ),
        )
    })?;
    let mut script = Vec::new();
    completer
        .write_registration(VARIABLE, "cubectl", "cubectl", "cubectl", &mut script)
        .map_err(|error| ExpectedError::new(exit::OUTPUT, format!("completion script: {error}")))?;
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

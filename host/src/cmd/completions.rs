//! `completions` of each program

use std::io::Write;

use clap::ValueEnum as _;
use clap_complete::Shell;
use clap_complete::env::Shells;

use crate::error::ExpectedError;
use crate::exit;

#[derive(Debug, clap::Args)]
pub struct Args {
    /// Which shell.
    pub shell: Shell,
}

/// Examples of this verb of `program`.
pub fn after_help(program: &str) -> String {
    format!(
        "Examples:
  {program} completions bash > ~/.local/share/bash-completion/completions/{program}
  {program} completions zsh > ~/.zfunc/_{program}
  {program} completions fish > ~/.config/fish/completions/{program}.fish

The script asks `{program}`, which must be in the search path, for what fits: verbs, options, robots, the buses of this machine,
fault numbers and files."
    )
}

/// Writes the script of `program`, which is asked through the environment variable `variable`.
pub fn run(args: &Args, program: &str, variable: &str) -> Result<(), ExpectedError> {
    let shell = args.shell.to_possible_value();
    let shells = Shells::builtins();
    let completer = shell.as_ref().and_then(|shell| shells.completer(shell.get_name()));
    let completer = completer.ok_or_else(|| {
        ExpectedError::new(exit::USAGE, format!("no completions for {}", args.shell))
            .next(format!("one of {}", shells.names().collect::<Vec<_>>().join(", ")))
    })?;
    let mut script = Vec::new();
    completer
        .write_registration(variable, program, program, program, &mut script)
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

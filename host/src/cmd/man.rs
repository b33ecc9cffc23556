//! `cubectl man`

use std::fmt::Write as _;
use std::io;
use std::path::{Path, PathBuf};

use clap::Command;
use clap_mangen::Man;

use super::completions::to_terminal;
use crate::error::ExpectedError;
use crate::exit;

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl man | man -l -\n  cubectl man --dir ~/.local/share/man/man1      # one page per verb"
)]
pub struct Args {
    /// Write cubectl.1 and a page for each verb into this folder instead of the main page to the terminal.
    #[arg(long, value_name = "DIR")]
    pub dir: Option<PathBuf>,
}

/// Runs the verb for the command line `command`.
pub fn run(args: &Args, mut command: Command) -> Result<(), ExpectedError> {
    command.build();
    let Some(dir) = &args.dir else {
        return to_terminal(
            &page(&command).map_err(|error| ExpectedError::output(Path::new("terminal"), &error))?,
        );
    };
    std::fs::create_dir_all(dir).map_err(|error| ExpectedError::output(dir, &error))?;
    let count = write_pages(dir, &command)?;
    console::line!("{count} pages in {}", dir.display());
    Ok(())
}

/// The page of a command and those of the verbs below it; how many.
fn write_pages(dir: &Path, command: &Command) -> Result<usize, ExpectedError> {
    let name = command.get_display_name().unwrap_or_else(|| command.get_name()).to_owned();
    let path = dir.join(format!("{name}.1"));
    let bytes = page(command).map_err(|error| ExpectedError::output(&path, &error))?;
    std::fs::write(&path, bytes).map_err(|error| ExpectedError::output(&path, &error))?;
    let mut count = 1;
    for verb in command.get_subcommands().filter(|verb| !verb.is_hide_set() && verb.get_name() != "help") {
        count += write_pages(dir, verb)?;
    }
    Ok(count)
}

/// One page, with the exit codes that all verbs share.
fn page(command: &Command) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    Man::new(command.clone()).render(&mut bytes)?;
    bytes.extend_from_slice(exit_status().as_bytes());
    Ok(bytes)
}

/// Section with the exit codes, in roff.
fn exit_status() -> String {
    let mut section = ".SH \"EXIT STATUS\"\n".to_owned();
    for (code, meaning, next) in exit::TABLE {
        let _ = writeln!(section, ".TP\n\\fB{code}\\fR\n{}. Next: {}.", roff(meaning), roff(next));
    }
    section
}

/// Text in which nothing is a roff request.
fn roff(text: &str) -> String {
    text.replace('\\', "\\\\").replace('-', "\\-").replace('`', "\\(ga").replace('\'', "\\(aq")
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;
    use crate::cli::Cli;

    #[test]
    fn every_page_names_the_exit_codes() {
        let text = String::from_utf8(page(&Cli::command()).unwrap()).unwrap();
        assert!(text.contains(".SH \"EXIT STATUS\"") && text.contains("\\fB10\\fR"));
    }
}

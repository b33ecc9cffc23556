//! Verbs that are in `cubelab` now. Their names stay here for version 0.1 only.

use crate::advice::quoted;
use crate::error::ExpectedError;
use crate::exit;

/// Whatever followed the verb.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    words: Vec<String>,
}

/// Where the verb is now, with the command line that was meant.
pub(crate) fn to_lab(verb: &str, args: &Args) -> ExpectedError {
    let words: String = args.words.iter().map(|word| format!(" {}", quoted(word))).collect();
    ExpectedError::new(exit::USAGE, format!("{verb} is in cubelab now"))
        .next(format!("`cargo run --release -p lab --bin cubelab -- {verb}{words}`"))
}

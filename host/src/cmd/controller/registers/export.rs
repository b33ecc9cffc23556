//! `cubectl controller registers export`

use std::fmt::Write as _;
use std::path::PathBuf;

use super::value;
use crate::cmd::target::Target;
use crate::error::ExpectedError;
use operator::dialogue::registers::{Numbers, RegisterEntry};

pub(super) const SCHEMA_VERSION: i64 = 1;

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl controller registers export --bus can0 --out arm.registers.toml\n  cubectl controller registers set --file arm.registers.toml --bus can0 --save\n\nThe key of a controller is never register, and is not in the file."
)]
pub struct Args {
    /// Where to. A file that exists is not overwritten. Default: standard output.
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    #[command(flatten)]
    pub target: Target,
}

/// Runs the verb.
///
/// # Errors
/// The bus, or the file.
pub(super) fn run(args: &Args) -> Result<(), ExpectedError> {
    let (mut session, node) = args.target.open()?;
    let mut found = Vec::new();
    for name in session.register_names(node)? {
        found.push(session.reported_register(node, &name)?);
    }
    session.finish()?;
    let text = file(&found);
    let Some(path) = &args.out else {
        console::text!("{text}");
        return Ok(());
    };
    let failed = |error: std::io::Error| ExpectedError::output(path, &error);
    let mut out = std::fs::File::create_new(path).map_err(failed)?;
    std::io::Write::write_all(&mut out, text.as_bytes()).and_then(|()| out.sync_all()).map_err(failed)?;
    console::line!("{}: registers of controller {}", path.display(), node.get());
    Ok(())
}

/// The file: what can be written, in the order of the controller.
fn file(found: &[RegisterEntry]) -> String {
    let mut text = format!("schema_version = {SCHEMA_VERSION}\n\n[registers]\n");
    for register in
        found.iter().filter(|register| register.mutable && !matches!(register.value, Numbers::Text(_)))
    {
        let _ = writeln!(text, "\"{}\" = {}", register.name, value::toml(&register.value));
    }
    text
}

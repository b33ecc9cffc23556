//! `cubectl robot …`: robot files, from the first draft to a picture.

pub mod check;
pub mod import;
pub mod show;

use crate::error::ExpectedError;

/// The verbs.
#[derive(Debug, clap::Subcommand)]
pub enum RobotVerb {
    /// Make a robot file from a URDF file of a serial arm.
    Import(import::Args),
    /// Name what is missing, assumed or implausible in a robot file.
    Check(check::Args),
    /// Draw a robot: frames, limits and collision boxes, at zero and in a pose.
    Show(show::Args),
}

pub fn run(verb: &RobotVerb) -> Result<(), ExpectedError> {
    match verb {
        RobotVerb::Import(args) => import::run(args),
        RobotVerb::Check(args) => check::run(args),
        RobotVerb::Show(args) => show::run(args),
    }
}

/// The refusal of a result whose file is there already.
pub(super) fn is_there(path: &std::path::Path) -> ExpectedError {
    ExpectedError::new(crate::exit::OUTPUT, format!("{}: the file is there already", path.display()))
}

/// Writes a result: a file of that name is kept unless `force` is set.
fn write(path: &std::path::Path, text: &str, force: bool) -> Result<(), ExpectedError> {
    use std::io::Write as _;
    let mut options = std::fs::OpenOptions::new();
    let options = options.write(true).create(true).truncate(true).create_new(!force);
    let written = options.open(path).and_then(|mut file| file.write_all(text.as_bytes()));
    written.map_err(|e| match e.kind() {
        std::io::ErrorKind::AlreadyExists => {
            is_there(path).next("--force overwrites it, --out names another")
        }
        _ => ExpectedError::output(path, &e),
    })
}

//! `cubectl robot import ARM.urdf`

use std::path::PathBuf;

use robot_model::urdf::{UrdfOptions, robot_file_from_urdf};
use toml_reader::{DESCRIPTION_MAX_BYTES, read_text};

use crate::error::ExpectedError;

/// Arguments.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:
  cubectl robot import arm.urdf --end-effector tool0
  cubectl robot check arm.toml          # what URDF did not say

URDF has no accelerations, jerks, drives, gripper or ball. They are filled in with a mark `# assumed: …`, which
`cubectl robot check` lists until it is removed.")]
pub struct Args {
    /// URDF file; a xacro file must be expanded first.
    pub urdf: PathBuf,
    /// Robot file to write; by default beside the URDF file, with the ending `.toml`.
    #[arg(long)]
    pub out: Option<PathBuf>,
    /// Link whose frame is the end effector; by default the last link that moves.
    #[arg(long)]
    pub end_effector: Option<String>,
    /// Height of the floor in m; negative if the arm stands on something.
    #[arg(long, allow_hyphen_values = true)]
    pub floor_z_m: Option<f64>,
    /// Overwrite the robot file.
    #[arg(long)]
    pub force: bool,
}

/// Runs the verb.
///
/// # Errors
/// If the file cannot be read, is no serial arm of revolute joints, or the robot file cannot be written.
pub fn run(args: &Args) -> Result<(), ExpectedError> {
    let text = read_text(&args.urdf, DESCRIPTION_MAX_BYTES).map_err(|e| ExpectedError::io(&args.urdf, &e))?;
    let floor_z_m = args.floor_z_m.unwrap_or(0.0);
    if !floor_z_m.is_finite() {
        return Err(ExpectedError::bad_input(&format!("a floor at {floor_z_m} m: give a height in metres")));
    }
    let options =
        UrdfOptions { end_effector: args.end_effector.clone(), floor_z_m, ..UrdfOptions::default() };
    let name = args.urdf.display().to_string();
    let made = robot_file_from_urdf(&name, &text, &options).map_err(|e| ExpectedError::bad_input(&e))?;
    let out = args.out.clone().unwrap_or_else(|| args.urdf.with_extension("toml"));
    super::write(&out, &made.toml, args.force)?;
    console::line!("{}: {} joints from {name}", out.display(), made.joints);
    for note in &made.notes {
        console::line!("  {note}");
    }
    console::line!("next: cubectl robot check {}", out.display());
    Ok(())
}

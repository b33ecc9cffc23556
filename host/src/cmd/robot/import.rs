//! `cubectl robot import ARM.urdf`

use std::path::{Path, PathBuf};

use robot_model::urdf::{UrdfOptions, robot_file_with_meshes};
use toml_reader::{DESCRIPTION_MAX_BYTES, read_text};

use crate::error::ExpectedError;

#[derive(Debug, clap::Args)]
#[command(after_help = "Example:
  cubectl robot import arm.urdf --end-effector tool0
  cubectl robot check arm.toml          # what URDF did not say
  cubectl robot import arm.urdf --package arm_description=/opt/arm/description

URDF has no accelerations, jerks, drives, gripper or ball. They are filled in with a mark `# assumed: …`, which
`cubectl robot check` lists until it is removed. Meshes (stl, obj, dae) become boxes around them. `package://NAME/…` is looked for
in --package, in ROS_PACKAGE_PATH, and in the folders above the URDF file.")]
pub struct Args {
    /// URDF file; a xacro file must be expanded first.
    pub urdf: PathBuf,
    /// Robot file to write; by default beside the URDF file, with the ending `.toml`.
    #[arg(long)]
    pub out: Option<PathBuf>,
    /// Link at which the arm ends and whose frame is the end effector; what is behind it is held at zero. Default: the last link
    /// before a gripper.
    #[arg(long)]
    pub end_effector: Option<String>,
    /// Height of the floor in m; negative if the arm stands on something. Default: 0, or so low that the arm starts free of it.
    #[arg(long, allow_hyphen_values = true)]
    pub floor_z_m: Option<f64>,
    /// Folder of a ROS package that meshes are in; may be given several times.
    #[arg(long, value_name = "NAME=DIR", value_parser = package)]
    pub package: Vec<(String, PathBuf)>,
    /// Overwrite the robot file.
    #[arg(long)]
    pub force: bool,
}

pub fn run(args: &Args) -> Result<(), ExpectedError> {
    let text = read_text(&args.urdf, DESCRIPTION_MAX_BYTES).map_err(|e| ExpectedError::io(&args.urdf, &e))?;
    let floor_z_m = args.floor_z_m;
    if let Some(floor_z_m) = floor_z_m.filter(|z| !z.is_finite()) {
        return Err(ExpectedError::bad_input(&format!("a floor at {floor_z_m} m: give a height in metres")));
    }
    let options =
        UrdfOptions { end_effector: args.end_effector.clone(), floor_z_m, ..UrdfOptions::default() };
    let name = args.urdf.display().to_string();
    let made = robot_file_with_meshes(&name, &text, &options, &|mesh| args.mesh(mesh))
        .map_err(|e| ExpectedError::bad_input(&e))?;
    let out = args.out.clone().unwrap_or_else(|| args.urdf.with_extension("toml"));
    super::write(&out, &made.toml, args.force)?;
    console::line!("{}: {} joints from {name}", out.display(), made.joints);
    for note in &made.notes {
        console::line!("  {note}");
    }
    console::line!("next: cubectl robot check {}", out.display());
    Ok(())
}

/// Largest mesh file that is read.
const MESH_MAX_BYTES: u64 = 256 << 20;

impl Args {
    /// A mesh file by its name in the URDF file.
    fn mesh(&self, name: &str) -> Result<Vec<u8>, String> {
        let path = self.place_of(name)?;
        let read = std::fs::metadata(&path).and_then(|about| match about.len() {
            ..=MESH_MAX_BYTES => std::fs::read(&path),
            _ => Err(std::io::ErrorKind::FileTooLarge.into()),
        });
        read.map_err(|e| format!("{} cannot be read: {e}", path.display()))
    }

    fn place_of(&self, name: &str) -> Result<PathBuf, String> {
        let folder = std::path::absolute(&self.urdf).unwrap_or_default();
        let above = || folder.ancestors().skip(1);
        let Some(rest) = name.strip_prefix("package://") else {
            let path = Path::new(name.strip_prefix("file://").unwrap_or(name));
            return Ok(above().next().unwrap_or(Path::new("")).join(path));
        };
        let (package, inside) = rest.split_once('/').unwrap_or((rest, ""));
        let given = self.package.iter().filter(|(known, _)| known == package).map(|(_, dir)| dir.clone());
        let ros: Vec<PathBuf> = std::env::var_os("ROS_PACKAGE_PATH").map_or_else(Vec::new, |paths| {
            std::env::split_paths(&paths).map(|dir| dir.join(package)).collect()
        });
        let named =
            above().filter(|dir| dir.file_name().is_some_and(|own| own == package)).map(Path::to_owned);
        let beside = above().map(|dir| dir.join(package));
        let mut places = given.chain(ros).chain(named).chain(beside).map(|dir| dir.join(inside));
        places.find(|path| path.is_file()).ok_or_else(|| {
            format!("{name} was not found; `--package {package}=DIR` names the folder of the package")
        })
    }
}

fn package(text: &str) -> Result<(String, PathBuf), String> {
    let (name, dir) = text.split_once('=').ok_or("must be NAME=DIR")?;
    Ok((name.to_owned(), dir.into()))
}

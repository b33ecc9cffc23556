//! Named poses: a TOML file that people may edit.
//!
//! ```toml
//! schema_version = 1
//!
//! [[pose]]
//! name = "above the box"
//! robot = "powercube6"
//! q_rad = [0.1, -0.7, 1.2, 0.0, 0.5, 0.0]
//! ```

use std::path::{Path, PathBuf};

use planner::store::file::write_whole;
use serde::{Deserialize, Serialize};
use toml_reader::{DESCRIPTION_MAX_BYTES, read_text};

use crate::error::ExpectedError;

const SCHEMA_VERSION: u32 = 1;

/// Which file the named poses are in.
#[derive(Debug, Clone, clap::Args)]
pub struct PosesArgs {
    /// File of named poses; `cubectl arm pose save` writes it [default: poses.toml].
    #[arg(long, value_name = "FILE")]
    pub poses: Option<PathBuf>,
}

impl PosesArgs {
    pub(super) fn path(&self) -> &Path {
        self.poses.as_deref().unwrap_or(Path::new("poses.toml"))
    }
}

#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Poses {
    schema_version: u32,
    #[serde(default, rename = "pose")]
    pub(super) poses: Vec<NamedPose>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct NamedPose {
    pub(super) name: String,
    pub(super) robot: String,
    pub(super) q_rad: Vec<f64>,
}

impl Poses {
    /// Those of a file; none if there is no such file.
    pub(super) fn read(path: &Path) -> Result<Self, ExpectedError> {
        if !path.exists() {
            return Ok(Self { schema_version: SCHEMA_VERSION, poses: Vec::new() });
        }
        let text = read_text(path, DESCRIPTION_MAX_BYTES).map_err(|error| ExpectedError::io(path, &error))?;
        let refused = |what: &dyn std::fmt::Display| {
            ExpectedError::bad_input(&format!("{}: {what}", path.display()))
                .next("mend the file, or name another with --poses")
        };
        let read: Self = toml::from_str(&text).map_err(|error| refused(&error.to_string().trim_end()))?;
        if read.schema_version != SCHEMA_VERSION {
            let found = read.schema_version;
            return Err(refused(&format!("schema_version is {found}, this program reads {SCHEMA_VERSION}")));
        }
        match read.poses.iter().find(|pose| !pose.q_rad.iter().all(|q| q.is_finite())) {
            Some(pose) => Err(refused(&format!("pose \"{}\": an angle is not finite", pose.name))),
            None => Ok(read),
        }
    }

    /// Writes the file, whole or not at all.
    pub(super) fn write(&self, path: &Path) -> Result<(), ExpectedError> {
        let text = toml::to_string(self).map_err(|error| ExpectedError::bad_input(&error))?;
        write_whole(path, text.as_bytes()).map_err(|error| ExpectedError::output(path, &error))
    }

    /// The angles of a pose of this robot, rad.
    pub(super) fn of(&self, name: &str, robot: &str) -> Result<&[f64], ExpectedError> {
        let of_robot = || self.poses.iter().filter(|pose| pose.robot == robot);
        if let Some(found) = of_robot().find(|pose| pose.name == name) {
            return Ok(&found.q_rad);
        }
        let known: Vec<String> = of_robot().map(|pose| format!("\"{}\"", pose.name)).collect();
        let known = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
        Err(ExpectedError::bad_input(&format!("no pose \"{name}\" of {robot}; known: {known}"))
            .next("`cubectl arm pose save NAME` saves where the arm stands"))
    }

    /// Puts a pose there, in the place of one of the same name and robot; whether there was one.
    pub(super) fn put(&mut self, pose: NamedPose) -> bool {
        match self.poses.iter_mut().find(|old| old.name == pose.name && old.robot == pose.robot) {
            Some(old) => {
                *old = pose;
                true
            }
            None => {
                self.poses.push(pose);
                false
            }
        }
    }
}

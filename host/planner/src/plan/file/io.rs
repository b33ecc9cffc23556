//! Reading and writing plan files.

use std::path::{Path, PathBuf};

use nalgebra::{Matrix3, Vector3};
use robot_model::{Pose, RobotModel};
use toml_reader::read_text;

use super::{FORMAT, KIND, ObstacleInfo, PlanFile, VERSION};
use crate::store::{file::write_whole, robot_fingerprint};

/// Longest plan file that is read, bytes. Six joints and a few segments take 20 kB.
pub const FILE_MAX_BYTES: u64 = 16 << 20;

/// A plan file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum PlanFileError {
    /// Reading or writing failed.
    #[error("plan {path}: {source}")]
    Io {
        /// File.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Not JSON, or not a plan.
    #[error("plan {path} is damaged or not a plan file: {reason}")]
    Damaged {
        /// File.
        path: PathBuf,
        /// Where and why.
        reason: String,
    },
    /// From a newer program.
    #[error(
        "plan {path} has version {found}, this program reads up to {VERSION}: update cubectl or plan again"
    )]
    Newer {
        /// File.
        path: PathBuf,
        /// Its version.
        found: u64,
    },
    /// For another robot.
    #[error(
        "plan {path} is for robot \"{found}\" ({found_fingerprint}), not for \"{wanted}\" ({wanted_fingerprint}): plan again, or name the robot with --robot"
    )]
    OtherRobot {
        /// File.
        path: PathBuf,
        /// Robot in the file.
        found: String,
        /// Its fingerprint.
        found_fingerprint: String,
        /// Robot in use.
        wanted: String,
        /// Its fingerprint.
        wanted_fingerprint: String,
    },
}

impl ObstacleInfo {
    /// Centre and axes in the world.
    #[must_use]
    pub fn pose(&self) -> Pose {
        Pose { rot: Matrix3::from_fn(|i, j| self.x_wo[i][j]), pos: Vector3::from_fn(|i, _| self.x_wo[i][3]) }
    }
}

impl PlanFile {
    /// Writes the file; it appears complete or not at all.
    ///
    /// # Errors
    /// If the folder or file cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), PlanFileError> {
        let fail = |source| PlanFileError::Io { path: path.to_owned(), source };
        write_whole(path, (self.to_json() + "\n").as_bytes()).map_err(fail)
    }

    /// As JSON.
    #[must_use]
    pub fn to_json(&self) -> String {
        // Every field is a number, text or list of them; writing those to a string cannot fail.
        serde_json::to_string_pretty(self).unwrap_or_default()
    }

    /// Reads a file.
    ///
    /// # Errors
    /// [`PlanFileError`] for a file that cannot be read, is damaged, or is of a newer version.
    pub fn read(path: &Path) -> Result<Self, PlanFileError> {
        let text = read_text(path, FILE_MAX_BYTES)
            .map_err(|source| PlanFileError::Io { path: path.to_owned(), source })?;
        Self::from_json(path, &text)
    }

    /// Reads JSON; `path` is for messages.
    ///
    /// # Errors
    /// As [`PlanFile::read`].
    pub fn from_json(path: &Path, text: &str) -> Result<Self, PlanFileError> {
        let damaged = |reason: String| PlanFileError::Damaged { path: path.to_owned(), reason };
        let value: serde_json::Value = serde_json::from_str(text).map_err(|e| damaged(e.to_string()))?;
        if value.get("format").and_then(|f| f.as_str()) != Some(FORMAT) {
            return Err(damaged(format!("the field \"format\" is not \"{FORMAT}\"")));
        }
        // The version comes before the fields: those of a newer version may be anything.
        match value.get("version").and_then(serde_json::Value::as_u64) {
            Some(v) if v > u64::from(VERSION) => {
                return Err(PlanFileError::Newer { path: path.to_owned(), found: v });
            }
            Some(1..) => {}
            _ => return Err(damaged("the field \"version\" is not a positive whole number".to_owned())),
        }
        let plan: Self = serde_json::from_str(text).map_err(|e| damaged(e.to_string()))?;
        plan.sound().map_err(damaged)?;
        Ok(plan)
    }

    /// Refuses the plan for any other robot than the one it was made for.
    ///
    /// # Errors
    /// [`PlanFileError::OtherRobot`].
    pub fn require_robot<const N: usize>(
        &self,
        path: &Path,
        arm: &RobotModel<N>,
    ) -> Result<(), PlanFileError> {
        let wanted = format!("{:016x}", robot_fingerprint(arm));
        if self.robot.fingerprint == wanted && self.joints.len() == N {
            return Ok(());
        }
        Err(PlanFileError::OtherRobot {
            path: path.to_owned(),
            found: self.robot.name.clone(),
            found_fingerprint: self.robot.fingerprint.clone(),
            wanted: arm.name().to_owned(),
            wanted_fingerprint: wanted,
        })
    }

    /// Whether every list has a number per joint.
    fn lists(&self) -> Result<(), String> {
        let joints = self.joints.len();
        if !(4..=7).contains(&joints) {
            return Err(format!("{joints} joints, expected four to seven"));
        }
        let (release, margins, currents) = (&self.release, &self.margins, &self.currents);
        let lists = [
            ("release.q_rad", Some(&release.q_rad)),
            ("release.qd_rad_s", Some(&release.qd_rad_s)),
            ("release.qdd_rad_s2", Some(&release.qdd_rad_s2)),
            ("margins.position_rad", Some(&margins.position_rad)),
            ("margins.speed_share", Some(&margins.speed_share)),
            ("margins.acceleration_share", Some(&margins.acceleration_share)),
            ("margins.jerk_share", Some(&margins.jerk_share)),
            ("margins.motor_current_share", margins.motor_current_share.as_ref()),
            ("currents.motor_release_a", currents.motor_release_a.as_ref()),
            ("currents.motor_peak_a", currents.motor_peak_a.as_ref()),
        ];
        match lists.iter().find(|(_, list)| list.is_some_and(|l| l.len() != joints)) {
            Some((name, list)) => {
                Err(format!("{name} has {} numbers, expected {joints}", list.map_or(0, Vec::len)))
            }
            None => Ok(()),
        }
    }

    /// What the types cannot say.
    fn sound(&self) -> Result<(), String> {
        if self.kind != KIND {
            return Err(format!(
                "its kind is \"{}\"; this program runs plans of kind \"{KIND}\" only",
                self.kind
            ));
        }
        self.lists()?;
        let inside = self.release_time_s > 0.0 && self.release_time_s < self.end_time_s;
        if !inside {
            return Err(format!(
                "release at {} s is not inside the motion of {} s",
                self.release_time_s, self.end_time_s
            ));
        }
        for obstacle in &self.obstacles {
            let pose = obstacle.pose();
            let turned = (pose.rot * pose.rot.transpose() - Matrix3::identity()).amax();
            let sizes = obstacle.half_m.iter().all(|h| *h > 0.0 && h.is_finite());
            if !sizes || turned.is_nan() || turned > 1e-6 {
                return Err(format!("obstacle \"{}\" is not a box", obstacle.name));
            }
        }
        for joint in &self.joints {
            let mut t = 0.0;
            if joint.segments.is_empty() {
                return Err(format!("{} has no segments", joint.name));
            }
            for segment in &joint.segments {
                let follows = (segment.t_start_s - t).abs() <= 1e-9 && segment.t_end_s > segment.t_start_s;
                if !follows {
                    return Err(format!(
                        "{}: a segment from {} to {} s does not follow {t} s",
                        joint.name, segment.t_start_s, segment.t_end_s
                    ));
                }
                if segment.coefficients_rad.is_empty() || segment.coefficients_rad.len() > 8 {
                    return Err(format!("{}: {} coefficients", joint.name, segment.coefficients_rad.len()));
                }
                t = segment.t_end_s;
            }
            if (t - self.end_time_s).abs() > 1e-9 {
                return Err(format!("{} ends at {t} s, the motion at {} s", joint.name, self.end_time_s));
            }
        }
        Ok(())
    }
}

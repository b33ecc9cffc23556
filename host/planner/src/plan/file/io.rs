//! Reading and writing plan files.

use std::path::{Path, PathBuf};

use nalgebra::{Matrix3, Vector3};
use robot_model::{Pose, RobotModel};
use serde::{Serialize, de::DeserializeOwned};
use serde_json::Value;
use toml_reader::read_text;

use super::motion::upgrade;
use super::{FORMAT, Kind, ObstacleInfo, PlanFile, RobotId, Target, VERSION};
use crate::flight::{Aim, Course};
use crate::store::{file::write_whole, fingerprint_of};

/// Longest plan file that is read, bytes. Six joints and a few segments take 20 kB.
pub const FILE_MAX_BYTES: u64 = 16 << 20;

/// First field of plans that follow a flight, before version 6 of the common format.
const OLD_FOLLOW_FORMAT: &str = "cubectl-follow-plan";
/// Times nearer than this are the same, s.
const SAME_TIME_S: f64 = 1e-7;
/// First version whose throws have knots, and not polynomials in absolute time.
const FIRST_WITH_KNOTS: u64 = 6;

/// A plan file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum PlanFileError {
    #[error("plan {path}: {source}")]
    Io { path: PathBuf, source: std::io::Error },
    #[error("plan {path} is damaged or not a plan file: {reason}")]
    Damaged { path: PathBuf, reason: String },
    #[error(
        "plan {path} has version {found}, this program reads up to {VERSION}: update cubectl or plan again"
    )]
    Newer { path: PathBuf, found: u64 },
    #[error(
        "plan {path} is for a thing with an attitude at its arrival (target.attitude), and only balls are thrown"
    )]
    NotABall { path: PathBuf },
    #[error("plan {path} is of kind \"{}\", here one of kind \"{}\" is wanted", .found.name(), .wanted.name())]
    OtherKind { path: PathBuf, found: Kind, wanted: Kind },
    #[error(
        "plan {path} is for robot \"{found}\" ({found_fingerprint}), not for \"{wanted}\" ({wanted_fingerprint}): plan again, or name the robot with --robot"
    )]
    OtherRobot {
        path: PathBuf,
        found: String,
        found_fingerprint: String,
        wanted: String,
        wanted_fingerprint: String,
    },
}

impl PlanFileError {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        Some(match self {
            Self::Io { source, .. } => return toml_reader::next_of_file(source).map(str::to_owned),
            Self::NotABall { .. } => "plan again for a ball, with `cubectl plan throw`".to_owned(),
            Self::OtherKind { found, .. } => next_for(*found).to_owned(),
            _ => return None,
        })
    }
}

const fn next_for(kind: Kind) -> &'static str {
    match kind {
        Kind::Throw => "`cubectl plan check`, `run` and `throw --plan` take it",
        Kind::Follow => "`cubectl plan check` and `cubectl throw --robot ROBOT --plan` take it",
        Kind::Move => "`cubectl run` takes it",
    }
}

/// The JSON of a plan file of any kind: format, version and kind are known, and older versions are brought to this one.
///
/// # Errors
/// [`PlanFileError::Damaged`], [`PlanFileError::Newer`].
pub fn parse(path: &Path, text: &str) -> Result<(Kind, Value), PlanFileError> {
    let damaged = |reason: String| PlanFileError::Damaged { path: path.to_owned(), reason };
    let mut value: Value = serde_json::from_str(text).map_err(|e| damaged(e.to_string()))?;
    let is_old_follow = value.get("format").and_then(Value::as_str) == Some(OLD_FOLLOW_FORMAT);
    if !is_old_follow && value.get("format").and_then(Value::as_str) != Some(FORMAT) {
        return Err(damaged(format!("the field \"format\" is not \"{FORMAT}\"")));
    }
    // The version comes before the fields: those of a newer version may be anything.
    let version = match value.get("version").and_then(Value::as_u64) {
        Some(v) if v > u64::from(VERSION) => {
            return Err(PlanFileError::Newer { path: path.to_owned(), found: v });
        }
        Some(v @ 1..) => v,
        _ => return Err(damaged("the field \"version\" is not a positive whole number".to_owned())),
    };
    let fields = value.as_object_mut().ok_or_else(|| damaged("it is not an object".to_owned()))?;
    let kind = if is_old_follow {
        fields.insert("format".to_owned(), FORMAT.into());
        fields.insert("version".to_owned(), VERSION.into());
        Kind::Follow
    } else {
        let name = fields.remove("kind");
        let name = name.as_ref().and_then(Value::as_str);
        let name = name.ok_or_else(|| damaged("it has no field \"kind\" with a name".to_owned()))?;
        let known = || Kind::ALL.map(Kind::name).join(", ");
        Kind::of_name(name)
            .ok_or_else(|| damaged(format!("its kind is \"{name}\"; this program knows {}", known())))?
    };
    if kind == Kind::Throw && version < FIRST_WITH_KNOTS {
        upgrade(&mut value).map_err(damaged)?;
    }
    // Versions 8 to 10 had it.
    if value.pointer("/target/attitude").is_some() {
        return Err(PlanFileError::NotABall { path: path.to_owned() });
    }
    Ok((kind, value))
}

/// The fields of a plan from what [`parse`] gives.
///
/// # Errors
/// [`PlanFileError::Damaged`] with the field.
pub fn fields<T: DeserializeOwned>(path: &Path, value: Value) -> Result<T, PlanFileError> {
    serde_json::from_value(value)
        .map_err(|e| PlanFileError::Damaged { path: path.to_owned(), reason: e.to_string() })
}

/// A plan as JSON, its kind before its fields.
#[must_use]
pub fn tagged_json(kind: Kind, plan: &impl Serialize) -> String {
    #[derive(Serialize)]
    struct Tagged<'a, T> {
        kind: &'static str,
        #[serde(flatten)]
        plan: &'a T,
    }
    // Every field is a number, text or list of them; writing those to a string cannot fail.
    serde_json::to_string_pretty(&Tagged { kind: kind.name(), plan }).unwrap_or_default()
}

/// Refuses a plan of `joints` joints for `robot` if `arm` is another one.
///
/// # Errors
/// [`PlanFileError::OtherRobot`].
pub fn require_robot(
    path: &Path,
    robot: &RobotId,
    joints: usize,
    arm: &RobotModel,
) -> Result<(), PlanFileError> {
    let wanted = fingerprint_of(arm);
    if robot.fingerprint == wanted && joints == arm.n() {
        return Ok(());
    }
    Err(PlanFileError::OtherRobot {
        path: path.to_owned(),
        found: robot.name.clone(),
        found_fingerprint: robot.fingerprint.clone(),
        wanted: arm.name().to_owned(),
        wanted_fingerprint: wanted,
    })
}

impl ObstacleInfo {
    /// Centre and axes in the world.
    #[must_use]
    pub fn pose(&self) -> Pose {
        Pose { rot: Matrix3::from_fn(|i, j| self.x_wo[i][j]), pos: Vector3::from_fn(|i, _| self.x_wo[i][3]) }
    }
}

impl Target {
    /// The point with its plane and its course. A normal without direction, or a course with too many coefficients,
    /// is ignored.
    #[must_use]
    pub fn aim(&self) -> Aim {
        let normal = self.opening.map(|o| Vector3::from(o.normal)).filter(|n| n.norm() > 1e-9);
        let course = Course::new(&self.course).unwrap_or_default();
        Aim::new(Vector3::from(self.position_m), &normal.unwrap_or(Vector3::z()), course)
    }

    /// Coordinates on the plane of the target, of a point `since_release_s` after the planned release: x and y of the
    /// world for a target at rest without an opening.
    #[must_use]
    pub fn coordinates(&self, p_m: [f64; 3], since_release_s: f64) -> [f64; 2] {
        self.aim().coordinates(&Vector3::from(p_m), since_release_s).into()
    }
}

impl PlanFile {
    /// Where the ball meets the target, in m: the target itself if that is at rest.
    #[must_use]
    pub fn meeting_m(&self) -> [f64; 3] {
        if self.target.course.is_empty() { self.target.position_m } else { self.landing.position_m }
    }

    /// Writes the file; it appears complete or not at all.
    ///
    /// # Errors
    /// If the folder or file cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), PlanFileError> {
        let fail = |source| PlanFileError::Io { path: path.to_owned(), source };
        write_whole(path, (self.to_json() + "\n").as_bytes()).map_err(fail)
    }

    #[must_use]
    pub fn to_json(&self) -> String {
        tagged_json(Kind::Throw, self)
    }

    /// Reads a file.
    ///
    /// # Errors
    /// [`PlanFileError`] for a file that cannot be read, is damaged, of a newer version, or of another kind.
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
        let (kind, value) = parse(path, text)?;
        if kind != Kind::Throw {
            return Err(PlanFileError::OtherKind { path: path.to_owned(), found: kind, wanted: Kind::Throw });
        }
        Self::from_value(path, value)
    }

    /// From what [`parse`] gives.
    ///
    /// # Errors
    /// [`PlanFileError::Damaged`].
    pub fn from_value(path: &Path, value: Value) -> Result<Self, PlanFileError> {
        let plan: Self = fields(path, value)?;
        plan.sound().map_err(|reason| PlanFileError::Damaged { path: path.to_owned(), reason })?;
        Ok(plan)
    }

    /// Refuses the plan for any other robot than the one it was made for.
    ///
    /// # Errors
    /// [`PlanFileError::OtherRobot`].
    pub fn require_robot(&self, path: &Path, arm: &RobotModel) -> Result<(), PlanFileError> {
        require_robot(path, &self.robot, self.motion.joints.len(), arm)
    }

    /// Whether every list has a number per joint.
    fn lists(&self) -> Result<(), String> {
        let joints = self.motion.joints.len();
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

    /// Conditions that the types cannot express.
    fn sound(&self) -> Result<(), String> {
        self.lists()?;
        self.ranges()?;
        self.motion.sound()?;
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
        let end_s = self.motion.duration_s();
        if (end_s - self.end_time_s).abs() > SAME_TIME_S {
            return Err(format!("its last knot is at {end_s} s, the motion ends at {} s", self.end_time_s));
        }
        let opens_s = self.motion.to_motion().release_s();
        if !opens_s.is_some_and(|t_s| (t_s - self.release_time_s).abs() <= SAME_TIME_S) {
            return Err(format!(
                "its gripper opens at {} s, the release is at {} s",
                opens_s.map_or("no time of 0 to the end of its motion,".to_owned(), |t_s| t_s.to_string()),
                self.release_time_s
            ));
        }
        Ok(())
    }
}

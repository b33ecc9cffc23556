//! A robot whose number of joints is known only when its file has been read.

use crate::error::LoadError;
use crate::load;
use crate::model::RobotModel;

/// Does the same with a robot of any number of joints: `for_any_robot!(&robot, arm => arm.name())`.
///
/// `arm` is a [`RobotModel`](crate::RobotModel) with its number of joints in the type.
#[macro_export]
macro_rules! for_any_robot {
    ($robot:expr, $arm:ident => $body:expr) => {
        match $robot {
            $crate::AnyRobot::Four($arm) => $body,
            $crate::AnyRobot::Five($arm) => $body,
            $crate::AnyRobot::Six($arm) => $body,
            $crate::AnyRobot::Seven($arm) => $body,
        }
    };
}

/// A robot with as many joints as its file says.
#[derive(Debug, Clone)]
pub enum AnyRobot {
    /// Four joints, like the Pincher.
    Four(Box<RobotModel<4>>),
    /// Five joints.
    Five(Box<RobotModel<5>>),
    /// Six joints, like the PowerCube arm and the KR 16.
    Six(Box<RobotModel<6>>),
    /// Seven joints.
    Seven(Box<RobotModel<7>>),
}

impl AnyRobot {
    /// Reads a built-in robot by name, or a robot file by path.
    ///
    /// # Errors
    /// [`LoadError`], also for robots with fewer than four or more than seven joints.
    pub fn load(name_or_path: &str) -> Result<Self, LoadError> {
        let (file, text) = load::text_of(name_or_path)?;
        Self::from_toml(&file, &text)
    }

    /// Reads a robot from TOML text; `file` is only used in error messages.
    ///
    /// # Errors
    /// As [`AnyRobot::load`].
    pub fn from_toml(file: &str, text: &str) -> Result<Self, LoadError> {
        match load::joint_count(file, text)? {
            4 => RobotModel::from_toml(file, text).map(|m| Self::Four(Box::new(m))),
            5 => RobotModel::from_toml(file, text).map(|m| Self::Five(Box::new(m))),
            6 => RobotModel::from_toml(file, text).map(|m| Self::Six(Box::new(m))),
            7 => RobotModel::from_toml(file, text).map(|m| Self::Seven(Box::new(m))),
            found => {
                let problem = toml_reader::Problem::OutOfRange { value: found as f64, min: 4.0, max: 7.0 };
                Err(LoadError { key: "joint".to_owned(), ..LoadError::of_file(file, problem) })
            }
        }
    }

    /// Name of the robot.
    #[must_use]
    pub fn name(&self) -> &str {
        for_any_robot!(self, arm => arm.name())
    }

    /// Number of joints.
    #[must_use]
    pub fn joints(&self) -> usize {
        for_any_robot!(self, arm => arm.joints().len())
    }
}

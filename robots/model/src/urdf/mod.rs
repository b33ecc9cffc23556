//! URDF, the robot description most other tools read: export of any robot, import of serial arms.

mod export;
mod import;
mod parts;
mod toml_text;
mod tree;

pub use import::{UrdfRobot, robot_file_from_urdf};
pub use parts::UrdfOptions;
pub use tree::{UrdfError, UrdfProblem};

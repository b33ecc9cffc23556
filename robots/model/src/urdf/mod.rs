//! URDF, the robot description most other tools read: export of any robot, import of serial arms.

mod arm;
mod export;
mod hand;
mod import;
mod mesh;
mod mesh_boxes;
mod parts;
mod toml_text;
mod tree;

pub use import::{UrdfRobot, robot_file_from_urdf, robot_file_with_meshes};
pub use mesh::MeshFiles;
pub use parts::UrdfOptions;
pub use tree::{UrdfError, UrdfProblem};

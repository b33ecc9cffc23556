//! Messages of this project: DSDL namespace `cubecell` (`protocol/dsdl/cubecell`), bit for bit.
//!
//! The `.dsdl` files are the definition; the Rust types here are checked against them by vectors
//! that `pycyphal` makes (`protocol/tests/cyphal_vectors.txt`). Subjects are chosen by the
//! integrator: the constants here are the defaults of the registers `uavcan.pub.*.id` and
//! `uavcan.sub.*.id`.

pub mod authorization;
pub mod command;
pub mod group_state;
pub mod history;
pub mod joint_state;
pub mod stop;
pub mod target;

/// Path under which the controller takes a trajectory file (`file.Write`) and gives it back.
pub const TRAJECTORY_PATH: &[u8] = b"trajectory";

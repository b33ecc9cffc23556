//! One verb of `cubelab` per file: arguments and `run`.

mod on_wire;
pub mod place;
pub mod rally;
pub mod swarm;

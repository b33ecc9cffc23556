//! One verb of `cubelab` per file: arguments and `run`.

mod on_wire;
pub mod rally;
pub mod swarm;

//! The stored throws that come with the program.
//!
//! A table is only a set of starts: the planner works without it from random starts, only slower, and every throw is
//! solved and checked afresh. [`super::prepare`] makes tables.

use robot_model::RobotModel;

use crate::store::{Index, file, robot_fingerprint};

/// The built-in tables, one per robot that has one.
const TABLES: [&[u8]; 3] = [
    include_bytes!("../../seeds/powercube6.seeds"),
    include_bytes!("../../seeds/kr16_2.seeds"),
    include_bytes!("../../seeds/pincher4.seeds"),
];

/// The built-in throws for a robot; empty if there are none for it (or for this version of its file).
#[must_use]
pub fn built_in(arm: &RobotModel) -> Index {
    let robot = robot_fingerprint(arm);
    let records = TABLES.iter().find_map(|bytes| file::parse(bytes, robot, arm.n())).unwrap_or_default();
    Index::new(records)
}

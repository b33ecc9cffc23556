//! The stored throws that come with the program.
//!
//! A table is only a set of starts: the planner works without it from random starts, only slower, and every throw
//! is solved and checked again. [`super::prepare`] makes tables.

use robot_model::RobotModel;

use crate::store::{Index, file, robot_fingerprint};

/// The built-in tables, each with the built-in robot that it was made for.
const TABLES: [(&str, &[u8]); 3] = [
    ("powercube6", include_bytes!("../../seeds/powercube6.seeds")),
    ("kr16_2", include_bytes!("../../seeds/kr16_2.seeds")),
    ("pincher4", include_bytes!("../../seeds/pincher4.seeds")),
];

/// Postures in which two robots are compared.
const COMPARED: usize = 16;
/// Two robots are similar if the ball is never farther apart than this share of its largest distance from the shoulder.
const SIMILAR_SHARE: f64 = 0.05;

/// The built-in throws for a robot: its own, or else those of a similar one with other limits, masses, drives or boxes; empty
/// if there is neither.
#[must_use]
pub fn built_in(arm: &RobotModel) -> Index {
    let (robot, n) = (robot_fingerprint(arm), arm.n());
    if let Some(own) = TABLES.iter().find_map(|(_, bytes)| file::parse(bytes, robot, n)) {
        return Index::new(own);
    }
    let lent = |&(name, bytes): &(&'static str, &[u8])| {
        let records = file::parse_any(bytes, n)?;
        let lender = RobotModel::load(name).ok()?;
        similar(arm, &lender).then(|| Index::lent(records, name))
    };
    TABLES.iter().find_map(lent).unwrap_or_default()
}

/// Whether equal joint angles hold the ball at nearly the same place.
fn similar(arm: &RobotModel, other: &RobotModel) -> bool {
    let postures = (0..COMPARED).map(|k| other.spread_configuration(k));
    let (mut apart_m, mut reach_m) = (0.0_f64, 0.0_f64);
    for q in postures {
        let (frames, others) = (arm.fk(&q), other.fk(&q));
        let (ball, other_ball) = (arm.ball(&frames).pos, other.ball(&others).pos);
        apart_m = apart_m.max((ball - other_ball).norm());
        reach_m = reach_m.max((other_ball - others.origin(1)).norm());
    }
    apart_m <= SIMILAR_SHARE * reach_m
}

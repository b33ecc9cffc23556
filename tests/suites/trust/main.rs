//! Every kind of fault in every phase of a throw, judged from the plant.
//!
//! The whole matrix: `cargo test --release -p cell-tests --test trust -- --ignored --nocapture`. In the environment,
//! `KIND=encoder` and `PHASE=brake` choose a part of it, `STEP=10` every tenth run, `FAMILY=Cia402` one of the families that follow positions.

mod matrix;
mod motions;
mod page;
mod scenarios;
mod swarm;

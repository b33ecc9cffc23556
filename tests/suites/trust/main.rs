//! Every kind of fault in every phase of a throw, judged from the plant.
//!
//! The whole matrix: `cargo test --release -p cell-tests --test trust -- --ignored --nocapture`.

mod matrix;

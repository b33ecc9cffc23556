//! The experiment on one joint that measures the parameters of its drive.
//!
//! | file | is | must not |
//! |---|---|---|
//! | [`experiment`] | turns the joint within bounds and takes the samples | conclude |
//! | [`joint`] | all experiments on one joint, in order, and the way back | know how a current is measured |
//! | [`mounting`] | which angle of a joint a drive reads, and the source of this | move |
//!
//! The evaluation of the samples: `tuner::identify`.

pub mod experiment;
pub mod joint;
pub mod mounting;
#[cfg(test)]
mod tests;

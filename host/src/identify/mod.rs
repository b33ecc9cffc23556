//! Drive parameters from measurements, with confidence intervals, or a refusal (paper section VI-C).
//!
//! | layer | files | is | must not |
//! |---|---|---|---|
//! | conclusions | [`regression`], [`student`], [`current`], [`lag`] | pure functions over samples: estimates with intervals, or why there are none | know a bus |
//! | planning | [`poses`] | free ways and poses that load a joint, from the robot model | move |
//! | experiment | [`experiment`], [`joint`] | turns the joint within bounds and takes the samples | conclude |
//! | result | [`findings`], [`report`] | text, patch of the robot file, HTML | measure |

pub mod current;
pub mod experiment;
pub mod findings;
pub mod joint;
pub mod lag;
mod noise;
pub mod poses;
pub mod regression;
pub mod report;
pub mod student;
#[cfg(test)]
mod tests;

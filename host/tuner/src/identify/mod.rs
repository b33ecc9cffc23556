//! Drive parameters from measurements, with confidence intervals, or a refusal (paper section VI-C).
//!
//! | layer | files | is | must not |
//! |---|---|---|---|
//! | conclusions | [`regression`], `student`, [`current`], [`lag`] | pure functions over samples: estimates with intervals, or why there is no estimate | know a bus |
//! | planning | [`poses`] | free ways and poses that load a joint, from the robot model | move |
//! | data | [`samples`] | the samples of an experiment | conclude |
//! | result | [`findings`] | text, patch of the robot file | measure |
//!
//! The experiment that takes the samples needs a bus; it is in the package `operator`.

pub mod current;
pub mod findings;
pub mod lag;
pub mod poses;
pub mod regression;
pub mod samples;
mod student;

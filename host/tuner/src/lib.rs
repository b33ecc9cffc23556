//! Feedback gains with a certificate (paper 002), and drive parameters from measurements.
//!
//! # Map
//! An arrow goes from user to used; none goes up.
//!
//! ```text
//! gains      identify     gains for a robot, designed and certified; drive parameters from samples
//!      \      /
//!       v    v
//!       model             the tracking error of one joint, sampled exactly: drive, position loop, delay
//! ```

pub mod gains;
pub mod identify;
pub mod model;
mod noise;

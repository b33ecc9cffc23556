//! Feedback gains with a certificate.
#[cfg(test)]
mod barrier;
pub mod lmi;
pub mod model;
pub mod paper;
pub mod problem;
pub mod rigor;

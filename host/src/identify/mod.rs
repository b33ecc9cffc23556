//! Drive parameters from measurements, with confidence intervals, or a refusal.
//!
//! Pure functions over samples that have been taken already; the experiment itself (bus, bounds,
//! progress) is elsewhere.
//!
//! | file | holds |
//! |---|---|
//! | [`regression`] | least squares with standard errors; what makes data too poor to conclude from |
//! | [`student`] | quantiles of Student's t distribution |
//! | [`current`] | K_B, K_M and friction current (paper section VI-C, eq. 9) |
//! | [`lag`] | delay, natural frequency and damping of a drive from an acceleration step |

pub mod current;
pub mod lag;
pub mod regression;
pub mod student;

#[cfg(test)]
pub(crate) mod noise;

//! Groups of drives: one module per family, each behind [`DriveGroup`](crate::group::DriveGroup). A board links those that
//! its [`Controller`](crate::Controller) names.

mod answers;
pub mod cia402;
pub mod dynamics;
mod leading;
pub mod mit;
pub mod odrive;
mod position;
pub mod powercube;
pub mod rsi;
mod shape;

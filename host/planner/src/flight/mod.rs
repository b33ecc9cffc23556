//! Flight of the ball: from the release to the plane in which the target lies.
//!
//! # Map
//! | module | holds |
//! |---|---|
//! | [`model`] | forces on the ball: gravity, quadratic drag, Magnus force |
//! | [`launch`] | the velocity that carries the ball from the hand to the target in a given time, with derivatives |
//! | [`landing`] | where and when a released ball meets a plane, with its 2 × 6 Jacobian; late release |
//!
//! Vacuum is a closed form. Everything else is integrated together with its variational equation, so derivatives are
//! those of the integrated flight and the landing is solved for, never corrected afterwards.

pub mod landing;
pub mod launch;
pub mod model;

pub use landing::{Landing, LandingJacobian};
pub use launch::{Launch, LaunchError};
pub use model::{FlightModel, FlightModelError};

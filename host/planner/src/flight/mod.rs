//! Flight of the ball: from the release to the plane in which the target lies.
//!
//! # Map
//! | module | holds |
//! |---|---|
//! | [`aim`] | the plane on which the ball is to meet a target: horizontal or not, at rest or moving |
//! | [`model`] | forces on the ball: gravity, quadratic drag, Magnus force |
//! | [`launch`] | the velocity that carries the ball from the hand to the target in a given time, with derivatives |
//! | [`landing`] | where and when a released ball meets a plane, with its 2 × 6 Jacobian; late release |
//!
//! Vacuum is a closed form. Otherwise the flight is integrated together with its variational equation, so
//! derivatives are those of the integrated flight. The landing is solved for, never corrected afterwards.

pub mod aim;
pub mod landing;
pub mod launch;
pub mod model;

pub use aim::{Aim, COURSE_MAX, Course};
pub use landing::{Landing, LandingJacobian};
pub use launch::{Launch, LaunchError};
pub use model::{FlightModel, FlightModelError};

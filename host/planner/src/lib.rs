//! Plans what a robot arm does.
//!
//! Map:
//! - [`follow`]: a hand that follows the flight parabola of the ball (paper 000).
//! - [`disc`]: catching a flying disc (paper 001).

pub mod disc;
pub mod follow;

//! Collision: boxes around the arm, obstacles, the floor, and the ball.
//!
//! * `checker`: one configuration: does anything touch, and how near is the nearest pair?
//! * `motion`: a whole motion, proven free between the samples as well.

mod checker;
mod motion;

pub use checker::{Body, Clearance, CollisionChecker, Scene};
pub use motion::{MotionVerdict, StraightMove, Travel};

pub use crate::boxes::{BodyBox, CollisionModel, Obb, PairRule, Proximity, aligned_box};

//! Collision: boxes around the arm, obstacles, the floor, and the ball.
//!
//! * `checker`: one configuration: is there a contact, and how near is the nearest pair?
//! * `motion`: a whole motion, proven free also between the samples.

mod checker;
mod motion;

pub use checker::{Body, Clearance, CollisionChecker, Scene};
pub use motion::{MotionVerdict, StraightMove, Travel};

pub use crate::boxes::{BodyBox, CollisionModel, Obb, PairRule, Proximity, aligned_box};

//! A hand that follows the flight parabola while the gripper opens (paper 000).
//!
//! The motion has three phases: ramps from rest, a window in which the ball is exactly on its flight parabola with the
//! speed of the flight, ramps to rest. Inside the window the instant of the opening does not matter.
//!
//! # Map
//! An arrow goes from user to used. `plan` is the result of this module; `verify` judges it by its steps alone;
//! `landing` computes how the landing depends on the instant of the opening.
//!
//! ```text
//!  search           one of the two forms with its options
//!    v
//!  best             longest window under the limits of what is commanded
//!  paper            form of the paper: grid of releases, criteria j1 and j2
//!   |    v    found     result of a search, or the tests that refused its candidates
//!    v    found     what a search found, or what refused its candidates
//!  clear            floor, boxes, flying ball against arm and hand
//!    v
//!  motion           ramps + window + ramps in steps of the controller; commands and their differences
//!    v     \
//!  ramp    posture  one axis to rest; joints for a state of the hand
//!            v
//!          hand     how the hand turns on the flight
//!            v
//!          parabola the flight
//!  setting, limits  the request, the limits of the robot
//! ```

pub mod best;
pub mod clear;
pub mod found;
pub mod hand;
pub mod landing;
pub mod limits;
pub mod motion;
pub mod paper;
pub mod parabola;
pub mod plan;
pub mod posture;
pub mod ramp;
pub mod search;
pub mod setting;
pub mod verify;

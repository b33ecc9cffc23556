//! Plans motions of a robot arm.
//!
//! # Map
//! An arrow goes from user to used; none goes up.
//!
//! ```text
//! request                 throws for a calling program
//! record                  a plan file of any kind, and the schema of all of them
//!   |
//!   v
//! follow   disc   catch   a hand that follows the flight parabola (paper 000); catching a flying disc (paper 001), a ball
//!    \      /      /
//!     v    v
//!     verify           second opinion on a plan file; shares only the file and the form of a throw
//!       |
//!       v
//!      plan            throw planner: search, limits, statistics of the landing, plan file
//!    /   |   \
//!   v    v    v
//! store flight solve   throws found earlier, as starts; the ball after its release; local solver of any task
//!   |
//!   | way   waypoints    the way of the arm from pose to pose; files of waypoints
//!   |  | \
//!   |  |  servo          a stream of commands as a motion that can always be stopped
//!   |  v
//! timing             positions of the arm on a path over time, within limits of speed, acceleration and jerk
//!   v  v
//! motion               knots, the cubics between them, events
//!   |
//!   v
//! throw                one throw: cubic splines of all joints through one release
//! motion_law           one joint from a state to an angle and a speed in a given time
//! parallel             work on all cores
//! ```
//!
//! Arms have four to seven joints: every vector of joints carries its length. `follow` is for arms of six.

pub mod catch;
pub mod disc;
pub mod flight;
pub mod follow;
pub mod motion;
pub mod motion_law;
pub mod parallel;
pub mod plan;
pub mod record;
pub mod request;
pub mod servo;
pub mod solve;
pub mod store;
pub mod throw;
pub mod timing;
pub mod verify;
pub mod way;
pub mod waypoints;

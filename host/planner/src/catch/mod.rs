//! Catching a ball in flight with an open cup on the tool axis.
//!
//! The ball's flight comes as a [`forecast`]: where it will be, how fast, how surely. For every new forecast some thousand
//! candidates are judged: when, cup direction, posture; hand at rest (*hold*) or moving with the ball (*matched*). The best one that
//! keeps every limit over the whole motion, braking included, replaces the motion under way.
//!
//! | module | holds |
//! |---|---|
//! | [`forecast`] | the flight to come, with its covariance |
//! | [`cup`] | the cup, and what it does to a ball that touches it |
//! | [`arm`] | the arm with its cup, where it stands, its limits |
//! | [`motion`] | motion of all joints; the check of a whole motion |
//! | [`task`] | what counts as a catch, why there is none, where a search starts |
//! | `slot` | the times of a search: ball, reach of the joints, probability |
//! | `candidates` | postures at these times, judged |
//! | `bounce` | whether a ball that enters the cup stays in it |
//! | `edge` | how many of the flights that a ball may take are in reach |
//! | [`rates`] | joint rates that move the hand with the ball |
//! | [`search`] | the best candidate, or why there is none |
//! | [`clear`] | out of the way of a ball that will not be caught |
//! | [`online`] | a catch in progress: forecasts in, motions out |
//! | [`draw`] | throws of another arm that come by, at random |
//!
//! World frame: that of the two arms' common floor plan; SI units, radians.

pub mod arm;
mod bounce;
mod candidates;
pub mod clear;
pub mod cup;
pub mod draw;
mod edge;
pub mod forecast;
pub mod motion;
pub mod online;
pub mod rates;
pub mod search;
mod slot;
pub mod task;

/// Angles, speeds or accelerations of the six joints.
pub type Joints = robot_model::JointVec;

//! Second opinion on a plan file: everything computed again by other means than the planner's.
//!
//! # Map
//! | module | the planner's way | here |
//! |---|---|---|
//! | [`motion`] | closed form in phases | the file's polynomials in absolute time, dense grid |
//! | [`chain`] | frame by frame, Jacobians | product of exponentials; velocities by differences in time |
//! | [`forces`] | recursive Newton-Euler | momentum of every body by differences in time, summed in the world frame |
//! | [`boxes`] | separating axes, features | alternating projections between convex sets |
//! | [`ball`] | closed form, Runge-Kutta with variations | Heun in small steps |
//! | [`target`] | one plane, closed forms | powers summed, differences in time, distances from the circle |
//! | [`finding`] | | result of one check |
//! | [`mod@check`] | rows and margins | one pass over the grid, findings with time and place |
//!
//! Values that follow from the rest of the file (spread, margins, currents, parameters) have no second method: they
//! are computed again and compared, `PlanFile::false_claim`.
//!
//! The verifier takes a tenth of a second. It uses simple formulas instead of fast ones, so that a reader can check them.

pub mod ball;
pub mod boxes;
pub mod chain;
pub mod check;
pub mod finding;
pub mod forces;
pub mod motion;
pub mod target;

pub use check::{RELEASED_BALL, Report, check};
pub use finding::Finding;

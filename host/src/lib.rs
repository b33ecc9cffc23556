//! Host tools (in work): planner, gain design, bus access.

pub mod cmd;
pub mod identify;
pub mod tune;

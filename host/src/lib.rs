//! Host tools (in work): planner, gain design, bus access.

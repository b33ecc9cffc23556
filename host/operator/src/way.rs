//! The way of an arm from one rest to another, as jobs use it: planned by [`planner::way`].

pub use planner::way::{WayError as NoWay, way};

/// How an arm goes.
pub type Travel = planner::way::Travel;

/// What people do where there is no way.
pub(crate) fn next(why: &NoWay) -> &'static str {
    match why {
        NoWay::Blocked { at_start: true, .. } => "jog the arm free with `cubectl jog`",
        NoWay::Share { .. } => "give a share above 0 and at most 1",
        _ => "jog the arm nearer to the start of the plan, or plan another",
    }
}

//! One verb of `cubectl` per file: arguments and `run`; the verbs first, then what several of them use.

pub mod arm;
pub mod catch;
pub mod completions;
pub mod controller;
pub mod explain;
pub mod log;
pub mod man;
pub mod modules;
mod modules_show;
pub mod move_arm;
pub mod moved;
pub mod plan;
pub mod robot;
pub mod run;
pub mod servo;
pub mod sim;
pub mod sim_robot;
pub mod teach;
pub mod throw;
pub mod tracker;
pub mod tune;

mod bus_errors;
pub mod connected;
pub mod consent;
mod controlled;
pub mod ended;
pub(crate) mod finding;
mod folder;
mod goal;
mod held_key;
mod last_look;
pub mod link;
pub mod meaning;
mod path_file;
mod poses;
pub mod program_file;
mod program_record;
pub mod program_run;
pub mod progress;
mod request;
mod results;
mod rows;
pub mod rsi;
mod survey;
pub mod target;
pub mod values;
pub mod web;

use robot_model::RobotModel;

use crate::error::ExpectedError;
use planner::follow::limits::AXES;

pub(crate) fn robot(robot: &str) -> Result<RobotModel, ExpectedError> {
    RobotModel::load(robot).map_err(|e| ExpectedError::bad_input(&e))
}

/// The robot of a file for what leads six axes: motions that follow the flight, and RSI.
pub(crate) fn six_axes(robot: &str) -> Result<RobotModel, ExpectedError> {
    RobotModel::load_with_joints(robot, AXES).map_err(|e| ExpectedError::bad_input(&e))
}

/// `1 module`, `6 modules`.
pub(crate) fn counted(count: usize, what: &str) -> String {
    format!("{count} {what}{}", if count == 1 { "" } else { "s" })
}

/// A number with fixed digits; what rounds to zero has no sign.
pub(crate) fn fixed(value: f64, digits: usize) -> String {
    let text = format!("{value:.digits$}");
    match text.strip_prefix('-') {
        Some(rest) if rest.bytes().all(|byte| matches!(byte, b'0' | b'.')) => rest.to_owned(),
        _ => text,
    }
}

pub fn print_json(value: &serde_json::Value) {
    console::line!("{value:#}");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_rounds_to_zero_has_no_sign() {
        let texts = [-0.000_04, 0.0, -0.000_06, -1.5].map(|value| fixed(value, 4));
        assert_eq!(texts, ["0.0000", "0.0000", "-0.0001", "-1.5000"]);
    }

    #[test]
    fn one_thing_is_told_in_the_singular() {
        assert_eq!([0, 1, 2].map(|count| counted(count, "module")), ["0 modules", "1 module", "2 modules"]);
    }
}

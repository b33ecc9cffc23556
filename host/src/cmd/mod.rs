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

use crate::cli::{COMPLETE_VARIABLE, Cli};
use crate::error::ExpectedError;
use crate::program;
use planner::follow::limits::AXES;

/// The verbs of `cubectl`: what moves the arm, what plans and tunes, what looks and keeps.
#[derive(Debug, clap::Subcommand)]
pub enum Verb {
    /// Plan a throw, run it on the arm or the simulated cell, and report where the ball landed.
    Throw(Box<throw::Args>),
    /// Catch a flying disc with a four-axis arm, or a ball with a six-axis arm.
    Catch(Box<catch::Args>),
    /// Move the arm to a pose, around everything in the way.
    Move(Box<move_arm::Args>),
    /// Run a trajectory, a plan or a program of moves, and follow it to its end.
    Run(run::Args),
    /// Follow a stream of commands: joint angles or speeds, or the hand.
    Servo(servo::Args),
    /// Lead the arm with keys and save the steps of a program.
    Teach(teach::Args),
    /// Look at the arm and its modules, home and jog joints, stop.
    #[command(subcommand)]
    Arm(Box<arm::ArmVerb>),
    /// Plan throws, check and export plans.
    #[command(subcommand)]
    Plan(Box<plan::PlanVerb>),
    /// Design gains with a certificate.
    Tune(tune::Args),
    /// Run a controller, and change what one keeps: settings, trajectory, key.
    #[command(subcommand)]
    Controller(Box<controller::ControllerVerb>),
    /// Save, compare and restore the parameters of modules.
    #[command(subcommand)]
    Modules(modules::ModulesVerb),
    /// Record a bus, replay a recording, show a recorded run.
    #[command(subcommand)]
    Log(log::LogVerb),
    /// Make, check and draw robot files.
    #[command(subcommand)]
    Robot(robot::RobotVerb),
    /// Targets and calibration from an optical tracker.
    #[command(subcommand)]
    Tracker(tracker::TrackerVerb),
    /// Serve the simulated cell to other programs, in real time.
    Sim(sim::Args),
    /// Explain a fault number, an exit code, a word of a module's state, or the faults that a scenario can have.
    Explain(explain::Args),
    /// Write a completion script for a shell.
    #[command(after_help = completions::after_help("cubectl"))]
    Completions(completions::Args),
    /// Show the manual page, or write the pages of all verbs.
    Man(man::Args),
    /// In `cubelab` now.
    #[command(hide = true, disable_help_flag = true)]
    Rally(moved::Args),
    /// In `cubelab` now.
    #[command(hide = true, disable_help_flag = true)]
    Swarm(moved::Args),
}

impl Verb {
    pub(crate) fn run(self) -> Result<(), ExpectedError> {
        match self {
            Self::Throw(args) => throw::run(&args),
            Self::Catch(args) => catch::run(&args),
            Self::Move(args) => move_arm::run(&args),
            Self::Run(args) => run::run(&args),
            Self::Servo(args) => servo::run(&args),
            Self::Teach(args) => teach::run(&args),
            Self::Arm(verb) => arm::run(&verb),
            Self::Plan(verb) => plan::run(*verb),
            Self::Tune(args) => tune::run(&args),
            Self::Controller(verb) => controller::run(&verb),
            Self::Modules(verb) => modules::run(&verb),
            Self::Log(verb) => log::run(&verb),
            Self::Robot(verb) => robot::run(&verb),
            Self::Tracker(verb) => tracker::run(&verb),
            Self::Sim(args) => sim::run(&args),
            Self::Explain(args) => explain::run(&args),
            Self::Completions(args) => completions::run(&args, "cubectl", COMPLETE_VARIABLE),
            Self::Man(args) => man::run(&args, program::command::<Cli>()),
            Self::Rally(args) => Err(moved::to_lab("rally", &args)),
            Self::Swarm(args) => Err(moved::to_lab("swarm", &args)),
        }
    }
}

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
    fn one_thing_is_reported_in_the_singular() {
        assert_eq!([0, 1, 2].map(|count| counted(count, "module")), ["0 modules", "1 module", "2 modules"]);
    }
}

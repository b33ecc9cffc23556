//! Command line of `cubectl`: which verb, with which arguments.

use std::ffi::OsString;

use clap::{Command, Parser, Subcommand};

use crate::cmd::{self, completions};
use crate::error::ExpectedError;
use crate::program;

/// Environment variable by which a completion script asks this program.
pub const COMPLETE_VARIABLE: &str = "CUBECTL_COMPLETE";

/// Plan, check and run throws with PowerCube arms.
#[derive(Debug, Parser)]
#[command(name = "cubectl", version, about, after_help = program::after_help(EXAMPLES))]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub verb: Verb,
}

const EXAMPLES: &str = "Examples:
  cubectl plan throw --target 1.0,1.0,-1.0 --report plan.html
  cubectl doctor --bus can0                      # what is wrong, and what to do
  cubectl home --bus can0 && cubectl jog 6 --bus can0
  cubectl log report throw1                      # look at a recorded run

The bus is `sim` unless --bus says otherwise: a simulated cell inside this program, in virtual time.

Short names: doctor, home, jog, status and stop, without `arm`.";

/// The verbs: what moves the arm, what plans and tunes, what looks and keeps.
#[derive(Debug, Subcommand)]
pub enum Verb {
    /// Plan a throw, run it on the arm or the simulated cell, and report where the ball landed.
    Throw(Box<cmd::throw::Args>),
    /// Catch a flying disc with a four-axis arm, or a ball with a six-axis arm.
    Catch(Box<cmd::catch::Args>),
    /// Move the arm to a pose, around everything in the way.
    Move(Box<cmd::move_arm::Args>),
    /// Run a trajectory, a plan or a program of moves, and follow it to its end.
    Run(cmd::run::Args),
    /// Follow a stream of commands: joint angles or speeds, or the hand.
    Servo(cmd::servo::Args),
    /// Lead the arm with keys and save the steps of a program.
    Teach(cmd::teach::Args),
    /// Look at the arm and its modules, home and jog joints, stop.
    #[command(subcommand)]
    Arm(Box<cmd::arm::ArmVerb>),
    /// Plan throws, check and export plans.
    #[command(subcommand)]
    Plan(Box<cmd::plan::PlanVerb>),
    /// Design gains with a certificate.
    Tune(cmd::tune::Args),
    /// Run a controller, and change what one keeps: settings, trajectory, key.
    #[command(subcommand)]
    Controller(Box<cmd::controller::ControllerVerb>),
    /// Save, compare and restore the parameters of modules.
    #[command(subcommand)]
    Modules(cmd::modules::ModulesVerb),
    /// Record a bus, replay a recording, show a recorded run.
    #[command(subcommand)]
    Log(cmd::log::LogVerb),
    /// Make, check and draw robot files.
    #[command(subcommand)]
    Robot(cmd::robot::RobotVerb),
    /// Targets and calibration from an optical tracker.
    #[command(subcommand)]
    Tracker(cmd::tracker::TrackerVerb),
    /// Serve the simulated cell to other programs, in real time.
    Sim(cmd::sim::Args),
    /// Explain a fault number, an exit code, a word of a module's state, or the faults that a scenario can have.
    Explain(cmd::explain::Args),
    /// Write a completion script for a shell.
    #[command(after_help = completions::after_help("cubectl"))]
    Completions(completions::Args),
    /// Show the manual page, or write the pages of all verbs.
    Man(cmd::man::Args),
    /// In `cubelab` now.
    #[command(hide = true, disable_help_flag = true)]
    Rally(cmd::moved::Args),
    /// In `cubelab` now.
    #[command(hide = true, disable_help_flag = true)]
    Swarm(cmd::moved::Args),
}

/// Short names of verbs: a hand in a hurry types them.
pub(crate) const SHORT_NAMES: [(&str, &str); 5] = [
    ("doctor", "arm doctor"),
    ("home", "arm home"),
    ("jog", "arm jog"),
    ("status", "arm status"),
    ("stop", "arm stop"),
];

/// Names that verbs had in version 0.1.
const OLD_NAMES: [(&str, &str); 15] = [
    ("check", "plan check"),
    ("clear", "controller clear"),
    ("config", "modules"),
    ("export", "plan export"),
    ("identify", "arm identify"),
    ("key", "controller key"),
    ("monitor", "arm monitor"),
    ("pose", "arm pose"),
    ("record", "log record"),
    ("registers", "controller registers"),
    ("replay", "log replay"),
    ("report", "log report"),
    ("scan", "arm status"),
    ("unlock", "controller unlock"),
    ("upload", "controller upload"),
];

/// The command line with short names as verbs of their own: for completion, which sees no full names.
#[must_use]
pub fn with_short_names(command: Command) -> Command {
    let find = |(short, full): &(&'static str, &str)| {
        let verb = full.split(' ').try_fold(&command, |verb, word| verb.find_subcommand(word));
        verb.map(|verb| verb.clone().name(*short))
    };
    let short: Vec<Command> = SHORT_NAMES.iter().filter_map(find).collect();
    command.subcommands(short)
}

/// The words of a command line with the verb's full name; an old name is noted on standard error.
pub fn full_names(mut words: Vec<OsString>) -> Vec<OsString> {
    let Some(name) = words.get(1).and_then(|word| word.to_str()) else { return words };
    let named = |names: &[(&str, &'static str)]| {
        names.iter().find(|(short, _)| *short == name).map(|(_, full)| *full)
    };
    // Version 0.1 had no verbs below it.
    let is_bare = name == "controller"
        && words
            .get(2)
            .is_none_or(|word| word.to_str().is_some_and(|word| word.starts_with("--") && word != "--help"));
    let old = named(&OLD_NAMES).or(is_bare.then_some("controller run"));
    if let Some(full) = old {
        console::note!("`cubectl {name}` is `cubectl {full}` now");
    }
    if let Some(full) = old.or_else(|| named(&SHORT_NAMES)) {
        words.splice(1..2, full.split(' ').map(OsString::from));
    }
    words
}

pub fn run(cli: Cli) -> Result<(), ExpectedError> {
    match cli.verb {
        Verb::Throw(args) => cmd::throw::run(&args),
        Verb::Catch(args) => cmd::catch::run(&args),
        Verb::Move(args) => cmd::move_arm::run(&args),
        Verb::Run(args) => cmd::run::run(&args),
        Verb::Servo(args) => cmd::servo::run(&args),
        Verb::Teach(args) => cmd::teach::run(&args),
        Verb::Arm(verb) => cmd::arm::run(&verb),
        Verb::Plan(verb) => cmd::plan::run(*verb),
        Verb::Tune(args) => cmd::tune::run(&args),
        Verb::Controller(verb) => cmd::controller::run(&verb),
        Verb::Modules(verb) => cmd::modules::run(&verb),
        Verb::Log(verb) => cmd::log::run(&verb),
        Verb::Robot(verb) => cmd::robot::run(&verb),
        Verb::Tracker(verb) => cmd::tracker::run(&verb),
        Verb::Sim(args) => cmd::sim::run(&args),
        Verb::Explain(args) => cmd::explain::run(&args),
        Verb::Completions(args) => completions::run(&args, "cubectl", COMPLETE_VARIABLE),
        Verb::Man(args) => cmd::man::run(&args, program::command::<Cli>()),
        Verb::Rally(args) => Err(cmd::moved::to_lab("rally", &args)),
        Verb::Swarm(args) => Err(cmd::moved::to_lab("swarm", &args)),
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    fn named(line: &str) -> String {
        let words = full_names(line.split(' ').map(OsString::from).collect());
        words.iter().map(|word| word.to_string_lossy()).collect::<Vec<_>>().join(" ")
    }

    #[test]
    fn short_and_old_names_lead_to_verbs_that_are_there() {
        for (name, full) in SHORT_NAMES.iter().chain(&OLD_NAMES) {
            assert_eq!(named(&format!("cubectl {name} --json")), format!("cubectl {full} --json"));
            let mut verb = &Cli::command();
            for word in full.split(' ') {
                verb = verb.find_subcommand(word).unwrap_or_else(|| panic!("{full}"));
            }
            assert!(Cli::command().find_subcommand(name).is_none(), "{name} is a verb");
        }
    }

    #[test]
    fn a_controller_without_a_verb_is_run_as_in_version_0_1() {
        assert_eq!(named("cubectl controller"), "cubectl controller run");
        assert_eq!(named("cubectl controller --bus can0"), "cubectl controller run --bus can0");
        for line in
            ["cubectl controller --help", "cubectl controller clear", "cubectl throw --plan home", "cubectl"]
        {
            assert_eq!(named(line), line);
        }
    }
}

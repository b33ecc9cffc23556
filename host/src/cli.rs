//! Command line of `cubectl`: which verb, with which arguments.

use clap::{Parser, Subcommand};

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
  cubectl report throw1                          # look at a recorded run

The bus is `sim` unless --bus says otherwise: a simulated cell inside this program, in virtual time.";

/// The verbs.
#[derive(Debug, Subcommand)]
pub enum Verb {
    /// Plan a throw, run it on the arm or the simulated cell, and tell where the ball landed.
    Throw(Box<cmd::throw::Args>),
    /// Plan motions.
    #[command(subcommand)]
    Plan(Box<cmd::plan::PlanVerb>),
    /// Move the arm to a pose, around everything in the way.
    Move(Box<cmd::move_arm::Args>),
    /// Follow a stream of commands: joint angles or speeds, or the hand.
    Servo(cmd::servo::Args),
    /// Lead the arm with keys and save the steps of a program.
    Teach(cmd::teach::Args),
    /// Save, show and remove named poses.
    #[command(subcommand)]
    Pose(cmd::pose::PoseVerb),
    /// Catch a flying disc with a four-axis arm, or a ball with a six-axis arm.
    Catch(Box<cmd::catch::Args>),
    /// Check a plan file again, by other means than the planner's.
    Check(cmd::check::Args),
    /// Make, check and draw robot files.
    #[command(subcommand)]
    Robot(cmd::robot::RobotVerb),
    /// Write the joint motion of a plan as a table.
    Export(cmd::export::Args),
    /// Find the modules on a bus: address, serial number, firmware, state.
    Scan(cmd::scan::Args),
    /// Show state, position, current and supply of each module.
    Status(cmd::status::Args),
    /// Look at the bus and at each module, and say what is wrong and what to do.
    Doctor(cmd::doctor::Args),
    /// Let joints find their zeros: reduced speed, bounded in time and current.
    Home(cmd::home::Args),
    /// Move one joint while a key is held, or for a time, at reduced speed.
    Jog(cmd::jog::Args),
    /// Halt everything on the bus.
    Stop(cmd::stop::Args),
    /// Let the controller forget a latched fault and look at the drives again; nothing moves.
    Clear(cmd::clear::Args),
    /// Store a trajectory file in the controller and commit it; nothing moves.
    Upload(cmd::upload::Args),
    /// Upload a trajectory, arm, run it and follow it to its end.
    Run(cmd::run::Args),
    /// Run the controller as a program on this machine, on any bus.
    Controller(cmd::controller::Args),
    /// Targets and calibration from an optical tracker.
    #[command(subcommand)]
    Tracker(cmd::tracker::TrackerVerb),
    /// Serve the simulated cell to other programs, in real time.
    Sim(cmd::sim::Args),
    /// Write what passes on the bus to a candump and an MCAP file.
    Record(cmd::record::Args),
    /// Run the controller on a recording: it must send the recorded frames, bit for bit.
    Replay(cmd::replay::Args),
    /// Show a recorded run against its plan: one HTML file.
    Report(cmd::report::Args),
    /// Watch the modules: positions, currents, states, bus load.
    Monitor(cmd::monitor::Args),
    /// Save, compare and restore the parameters of modules.
    #[command(subcommand)]
    Config(cmd::config::ConfigVerb),
    /// Show, set, list and export the settings of a controller.
    #[command(subcommand)]
    Registers(Box<cmd::registers::RegistersVerb>),
    /// Make, set and remove the key of a controller.
    #[command(subcommand)]
    Key(cmd::key::KeyVerb),
    /// Let a controller take limits beyond those of its robot for a while.
    Unlock(cmd::unlock::Args),
    /// Explain a fault number, an exit code, a word of a module's state, or the faults that a scenario can have.
    Explain(cmd::explain::Args),
    /// Write a completion script for a shell.
    #[command(after_help = completions::after_help("cubectl"))]
    Completions(completions::Args),
    /// Show the manual page, or write the pages of all verbs.
    Man(cmd::man::Args),
    /// Measure the constants of a joint's drive: current per speed and torque, friction, lag, delay.
    Identify(cmd::identify::Args),
    /// Design gains with a certificate.
    Tune(cmd::tune::Args),
    /// In `cubelab` now.
    #[command(hide = true, disable_help_flag = true)]
    Rally(cmd::moved::Args),
    /// In `cubelab` now.
    #[command(hide = true, disable_help_flag = true)]
    Swarm(cmd::moved::Args),
}

/// Runs the verb.
///
/// # Errors
/// [`ExpectedError`] with the exit code.
pub fn run(cli: Cli) -> Result<(), ExpectedError> {
    match cli.verb {
        Verb::Throw(args) => cmd::throw::run(&args),
        Verb::Plan(verb) => cmd::plan::run(*verb),
        Verb::Move(args) => cmd::move_arm::run(&args),
        Verb::Servo(args) => cmd::servo::run(&args),
        Verb::Teach(args) => cmd::teach::run(&args),
        Verb::Pose(verb) => cmd::pose::run(&verb),
        Verb::Catch(args) => cmd::catch::run(&args),
        Verb::Check(args) => cmd::check::run(&args),
        Verb::Robot(verb) => cmd::robot::run(&verb),
        Verb::Export(args) => cmd::export::run(&args),
        Verb::Scan(args) => cmd::scan::run(&args),
        Verb::Status(args) => cmd::status::run(&args),
        Verb::Doctor(args) => cmd::doctor::run(&args),
        Verb::Home(args) => cmd::home::run(&args),
        Verb::Jog(args) => cmd::jog::run(&args),
        Verb::Stop(args) => cmd::stop::run(&args),
        Verb::Clear(args) => cmd::clear::run(&args),
        Verb::Upload(args) => cmd::upload::run(&args),
        Verb::Run(args) => cmd::run::run(&args),
        Verb::Controller(args) => cmd::controller::run(&args),
        Verb::Tracker(verb) => cmd::tracker::run(&verb),
        Verb::Sim(args) => cmd::sim::run(&args),
        Verb::Record(args) => cmd::record::run(&args),
        Verb::Replay(args) => cmd::replay::run(&args),
        Verb::Report(args) => cmd::report::run(&args),
        Verb::Monitor(args) => cmd::monitor::run(&args),
        Verb::Config(verb) => cmd::config::run(&verb),
        Verb::Registers(verb) => cmd::registers::run(&verb),
        Verb::Key(verb) => cmd::key::run(&verb),
        Verb::Unlock(args) => cmd::unlock::run(&args),
        Verb::Completions(args) => completions::run(&args, "cubectl", COMPLETE_VARIABLE),
        Verb::Man(args) => cmd::man::run(&args, program::command::<Cli>()),
        Verb::Explain(args) => cmd::explain::run(&args),
        Verb::Identify(args) => cmd::identify::run(&args),
        Verb::Tune(args) => cmd::tune::run(&args),
        Verb::Rally(args) => Err(cmd::moved::to_lab("rally", &args)),
        Verb::Swarm(args) => Err(cmd::moved::to_lab("swarm", &args)),
    }
}

//! `cubectl arm …`: look at an arm and its modules, move single joints, stop.

pub mod doctor;
pub mod home;
pub mod identify;
pub mod jog;
pub mod monitor;
pub mod pose;
pub mod status;
pub mod stop;

use crate::error::ExpectedError;

/// What is done with the arm.
#[derive(Debug, clap::Subcommand)]
pub enum ArmVerb {
    /// Show the modules: address, serial number, firmware, position, current, supply, state.
    Status(status::Args),
    /// Look at the bus and at each module, and say what is wrong and what to do.
    Doctor(doctor::Args),
    /// Let joints find their zeros: reduced speed, bounded in time and current.
    Home(home::Args),
    /// Move one joint while a key is held, or for a time, at reduced speed.
    Jog(jog::Args),
    /// Halt everything on the bus.
    Stop(stop::Args),
    /// Watch the modules: positions, currents, states, bus load.
    Monitor(monitor::Args),
    /// Measure the constants of a joint's drive: current per speed and torque, friction, lag, delay.
    Identify(identify::Args),
    /// Save, show and remove named poses.
    #[command(subcommand)]
    Pose(pose::PoseVerb),
}

pub fn run(verb: &ArmVerb) -> Result<(), ExpectedError> {
    match verb {
        ArmVerb::Status(args) => status::run(args),
        ArmVerb::Doctor(args) => doctor::run(args),
        ArmVerb::Home(args) => home::run(args),
        ArmVerb::Jog(args) => jog::run(args),
        ArmVerb::Stop(args) => stop::run(args),
        ArmVerb::Monitor(args) => monitor::run(args),
        ArmVerb::Identify(args) => identify::run(args),
        ArmVerb::Pose(verb) => pose::run(verb),
    }
}

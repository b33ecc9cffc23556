//! Command line: one verb per file.

mod exit;
mod faults;
mod progress;
mod run;
mod serve;
mod serve_krc;
mod serve_motors;
mod serve_tracker;
mod serve_two_arms;
mod swarm;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// Six PowerCube drives, an arm and a CAN bus, simulated behind the wire.
#[derive(Debug, Parser)]
#[command(name = "hil-sim", version, about, after_help = exit::HELP)]
struct Args {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    /// Serve or join a bus in real time, so that other programs can use the drives.
    Serve(serve::Args),
    /// Serve two arms with a ball between them, each on a bus of its own, and the tracker that watches, in real time.
    #[command(alias = "serve-court")]
    ServeTwoArms(serve_two_arms::Args),
    /// Serve a robot controller behind Ethernet RSI, in real time or in lock step with its client.
    ServeKrc(serve_krc::Args),
    /// Serve Damiao motors and ODrive axes, each with an inertia at its shaft, in real time.
    ServeMotors(serve_motors::Args),
    /// Serve an optical tracker: DTrack data over UDP, commands over TCP.
    ServeTracker(serve_tracker::Args),
    /// Run a scenario in virtual time: same seed, same log.
    Run(run::Args),
    /// Run many random situations and look for panics, hangs and NaN.
    Swarm(swarm::Args),
    /// List the kinds of faults with their keys.
    Faults,
}

/// Parses the arguments, does the verb, prints what went wrong.
pub(crate) fn main() -> ExitCode {
    let result = match Args::parse().verb {
        Verb::Serve(args) => serve::run(&args),
        Verb::ServeTwoArms(args) => serve_two_arms::run(&args),
        Verb::ServeKrc(args) => serve_krc::run(&args),
        Verb::ServeMotors(args) => serve_motors::run(&args),
        Verb::ServeTracker(args) => serve_tracker::run(&args),
        Verb::Run(args) => run::run(&args),
        Verb::Swarm(args) => swarm::run(&args),
        Verb::Faults => faults::run(),
    };
    match result.and_then(|()| output_is_whole()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            failure.print();
            failure.code.into()
        }
    }
}

/// Whether everything that was written to standard output is there; a reader that left is no failure.
fn output_is_whole() -> Result<(), exit::Failure> {
    console::lost().map_or(Ok(()), |error| {
        Err(exit::Failure::new(exit::Code::Output, &format!("standard output is not whole: {error}"))
            .next("free space where it goes to, and run again".to_owned()))
    })
}

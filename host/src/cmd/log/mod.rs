//! `cubectl log …`: record a bus, run the controller on a recording, show a recorded run.

pub mod record;
pub mod replay;
pub mod report;

use crate::error::ExpectedError;

/// What is done with a log.
#[derive(Debug, clap::Subcommand)]
pub enum LogVerb {
    /// Write what passes on the bus to a candump and an MCAP file.
    Record(record::Args),
    /// Run the controller on a recording: it must send the recorded frames, bit for bit.
    Replay(replay::Args),
    /// Show a recorded run against its plan: one HTML file.
    Report(report::Args),
}

pub fn run(verb: &LogVerb) -> Result<(), ExpectedError> {
    match verb {
        LogVerb::Record(args) => record::run(args),
        LogVerb::Replay(args) => replay::run(args),
        LogVerb::Report(args) => report::run(args),
    }
}

//! `hil-sim replay LOG`: requests of a log against the drives of today.

use std::path::PathBuf;

use hil_sim::replay::{Compare, Log, ReplayError, replay};
use hil_sim::scenario::Scenario;

use super::exit::{Code, Failure};

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Log in the form of `candump -L`.
    log: PathBuf,
    /// Scenario with the options and the seed of the drives; its actions are left out.
    #[arg(long)]
    scenario: Option<PathBuf>,
    /// Robot instead of the scenario's.
    #[arg(long)]
    robot: Option<String>,
    /// Seed instead of the scenario's.
    #[arg(long)]
    seed: Option<u64>,
    /// Compare only id, length, command and parameter: for logs of other drives.
    #[arg(long)]
    ignore_values: bool,
    /// Print the outcome as JSON.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &Args) -> Result<(), Failure> {
    let mut scenario = match &args.scenario {
        Some(path) => Scenario::load(path)?,
        None => Scenario::default(),
    };
    if let Some(robot) = &args.robot {
        scenario.robot.clone_from(robot);
    }
    if let Some(seed) = args.seed {
        scenario.seed = seed;
    }
    let log = Log::load(&args.log).map_err(|error| Failure::new(Code::BadFile, &error))?;
    let compare = if args.ignore_values { Compare::Form } else { Compare::Bytes };
    let outcome = replay(&scenario, &log, compare).map_err(|error| match error {
        ReplayError::Build(error) => Failure::from(error),
        ReplayError::Run(error) => Failure::from(error),
    })?;
    if args.json {
        console::line!(
            "{}",
            serde_json::to_string_pretty(&outcome).map_err(|e| Failure::new(Code::Output, &e))?
        );
    } else {
        console::line!(
            "{} frames sent again; {} answers in the log, {} now, {} agree, times differ by at most {} us",
            outcome.sent,
            outcome.logged,
            outcome.replayed,
            outcome.agreed,
            outcome.time_difference_max_us
        );
        if log.left_out > 0 {
            console::line!("{} error or CAN FD frames of the log were left out", log.left_out);
        }
    }
    match outcome.first_difference {
        None => Ok(()),
        Some(difference) => {
            if !args.json {
                console::line!("first difference: {difference}");
            }
            Err(Failure::silent(Code::NotAsExpected))
        }
    }
}

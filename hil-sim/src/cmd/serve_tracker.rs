//! `hil-sim serve-tracker`: an optical tracker for programs that want targets.

use std::net::{SocketAddr, ToSocketAddrs};
use std::path::PathBuf;

use hil_sim::tracker::serve::Sockets;
use hil_sim::tracker::{Tracker, TrackerScenario};
use protocol::{Duration, Instant};

use super::exit::{Code, Failure};
use super::progress::Interrupt;

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Scenario with tracker, bodies and faults; see `hil-sim/scenarios/tracker`.
    #[arg(long)]
    scenario: PathBuf,
    /// Where to listen for commands.
    #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:50105")]
    listen: String,
    /// Send the data of channel 1 there and measure at once, without waiting for commands.
    #[arg(long, value_name = "HOST:PORT")]
    data: Option<String>,
    /// Seed instead of the scenario's.
    #[arg(long)]
    seed: Option<u64>,
    /// End after this many seconds.
    #[arg(long, value_name = "SECONDS")]
    duration_s: Option<f64>,
    /// Print the report as JSON.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &Args) -> Result<(), Failure> {
    let mut scenario =
        TrackerScenario::load(&args.scenario).map_err(|error| Failure::new(Code::BadFile, &error))?;
    let data = args.data.as_deref().map(address).transpose()?;
    scenario.options.running |= data.is_some();
    let mut tracker = Tracker::new(scenario.options, args.seed.unwrap_or(scenario.seed));
    tracker.set_output(1, data);
    let mut sockets = Sockets::bind(address(&args.listen)?)
        .map_err(|error| Failure::new(Code::Bus, &error).next(error.next()))?;
    let listens = sockets.command_address().map_err(|error| Failure::new(Code::Bus, &error))?;
    let interrupt = Interrupt::listen();
    if args.json {
        console::line!("{}", serde_json::json!({ "event": "serving", "commands": listens.to_string() }));
    } else {
        console::note!("serving: commands at {listens}");
    }
    let until = args.duration_s.map_or(Instant::FAR_FUTURE, |s| Instant::ZERO + Duration::from_secs_f64(s));
    sockets.run(&mut tracker, until, &|| !interrupt.came());
    let served = sockets.served();
    if args.json {
        let report = serde_json::json!({
            "event": "report",
            "datagrams": served.datagrams,
            "unsent": served.unsent,
            "connections": served.connections,
        });
        console::line!("{report}");
    } else {
        console::line!(
            "datagrams: {}, unsent: {}, command connections: {}",
            served.datagrams,
            served.unsent,
            served.connections
        );
    }
    Ok(())
}

/// Address of `HOST:PORT`.
pub(super) fn address(text: &str) -> Result<SocketAddr, Failure> {
    let wrong = |why: String| {
        Failure::new(Code::Bus, &format!("{text}: {why}"))
            .next("give HOST:PORT, for example 127.0.0.1:5000".to_owned())
    };
    let mut found = text.to_socket_addrs().map_err(|error| wrong(error.to_string()))?;
    found.next().ok_or_else(|| wrong("no address".to_owned()))
}

//! `hil-sim serve-krc`: a robot controller behind Ethernet RSI, for programs that lead a robot.

use std::cell::RefCell;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::net::{SocketAddr, ToSocketAddrs};
use std::path::PathBuf;

use can_link::{Role, Urgent};
use hil_sim::krc::bench::RobotFaults;
use hil_sim::krc::serve::{Mode, ServeError, ServeOptions, Served, serve};
use hil_sim::krc::{Krc, KrcEvent, KrcScenario};
use protocol::Duration;

use super::exit::{Code, Failure};
use super::progress::{Interrupt, say};

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Scenario with controller, robot, configuration file and faults; see `hil-sim/scenarios/krc`.
    #[arg(long)]
    scenario: PathBuf,
    /// Address of the client instead of IP_NUMBER and PORT of the configuration file. Start the client first.
    #[arg(long, value_name = "HOST:PORT")]
    pc: Option<String>,
    /// Let the robot's time be its cycle count: it waits for each answer.
    #[arg(long)]
    lock_step: bool,
    /// In lock step: give up after this long without an answer.
    #[arg(long, value_name = "SECONDS", default_value_t = 10.0)]
    answer_limit_s: f64,
    /// End after this many telegrams.
    #[arg(long)]
    cycles: Option<u64>,
    /// Seed instead of the scenario's.
    #[arg(long)]
    seed: Option<u64>,
    /// Write every event to this file, one line each.
    #[arg(long, value_name = "FILE")]
    log: Option<PathBuf>,
    /// Print events and the report as JSON lines.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &Args) -> Result<(), Failure> {
    let mut scenario =
        KrcScenario::load(&args.scenario).map_err(|error| Failure::new(Code::BadFile, &error))?;
    if let Some(seed) = args.seed {
        scenario.seed = seed;
    }
    let mut krc =
        scenario.controller().map_err(|error| Failure::new(Code::BadFile, &error).next(error.next()))?;
    let pc = client(args, &scenario)?;
    let mode = if args.lock_step { Mode::LockStep } else { Mode::RealTime };
    let limit = Duration::from_secs_f64(args.answer_limit_s);
    let options = ServeOptions { pc, mode, cycles: args.cycles, answer_limit: limit };
    let mut log = match &args.log {
        Some(path) => {
            let file = File::create(path)
                .map_err(|error| Failure::new(Code::Output, &format!("{}: {error}", path.display())))?;
            Some(BufWriter::new(file))
        }
        None => None,
    };
    let interrupt = Interrupt::listen();
    let urgent = (mode == Mode::RealTime).then(|| Urgent::request(Role::Plant));
    let protocol = krc.config().protocol;
    say(
        args.json,
        "serving",
        &format!("{pc} ({protocol:?}, robot {}, seed {})", scenario.robot, scenario.seed),
    );
    if let Some(urgent) = &urgent {
        say(args.json, "real time", &urgent.granted().to_string());
    }
    let written = RefCell::new(Ok(()));
    let mut observe = |event: &KrcEvent| {
        if let Some(log) = &mut log {
            let line = writeln!(log, "{event}");
            if written.borrow().is_ok() {
                *written.borrow_mut() = line;
            }
        }
        if !matches!(event, KrcEvent::Cycle(_) | KrcEvent::Refused { .. } | KrcEvent::Late { .. }) {
            say(args.json, "event", &event.to_string());
        }
    };
    let mut link = scenario.link();
    let mut faults = RobotFaults::new(&scenario.robot_faults);
    let goes_on = || !interrupt.came() && written.borrow().is_ok();
    let served = serve(&mut krc, &mut link, &mut faults, &options, &goes_on, &mut observe);
    let flushed = log.map_or(Ok(()), |mut log| log.flush());
    let served = served.map_err(|error| {
        let code = if matches!(error, ServeError::Start(_)) { Code::Defect } else { Code::Bus };
        Failure::new(code, &error).next(error.next())
    })?;
    report(args, &krc, &served)?;
    written.into_inner().and(flushed).map_err(|error| {
        let path = args.log.as_ref().map(|path| path.display().to_string()).unwrap_or_default();
        Failure::new(Code::Output, &format!("{path}: {error}"))
    })?;
    match served.fault {
        Some(_) => Err(Failure::silent(Code::NotAsExpected)),
        None => Ok(()),
    }
}

fn client(args: &Args, scenario: &KrcScenario) -> Result<SocketAddr, Failure> {
    let text =
        args.pc.clone().unwrap_or_else(|| format!("{}:{}", scenario.config.ip_number, scenario.config.port));
    let wrong = |why: &str| {
        Failure::new(Code::Bus, &format!("{text}: {why}"))
            .next("give --pc HOST:PORT, for example 127.0.0.1:49152".to_owned())
    };
    let mut found = text.to_socket_addrs().map_err(|error| wrong(&error.to_string()))?;
    found.next().ok_or_else(|| wrong("no address"))
}

fn report(args: &Args, krc: &Krc, served: &Served) -> Result<(), Failure> {
    let landing = krc.landing();
    if args.json {
        let us = |share| served.answer_time(share).map(Duration::as_micros);
        let report = serde_json::json!({
            "event": "report",
            "telegrams": served.telegrams,
            "late": served.late,
            "refused": served.refused,
            "held_up": served.held_up,
            "events_lost": served.events_lost,
            "fault": served.fault.map(hil_sim::krc::FaultCause::name),
            "answer_us": { "count": served.answer_times_us.len(), "median": us(0.5), "p99": us(0.99), "p999": us(0.999), "max": us(1.0) },
            "landing_m": landing.map(|landing| [landing.p_m.x, landing.p_m.y, landing.p_m.z]),
        });
        console::line!(
            "{}",
            serde_json::to_string(&report).map_err(|error| Failure::new(Code::Output, &error))?
        );
        return Ok(());
    }
    console::line!(
        "telegrams: {}, late answers: {}, refused: {}",
        served.telegrams,
        served.late,
        served.refused
    );
    if let (Some(median), Some(p99), Some(max)) =
        (served.answer_time(0.5), served.answer_time(0.99), served.answer_time(1.0))
    {
        console::line!("answers: median {median}, 99 % within {p99}, {max} at most");
    }
    if served.held_up > 0 {
        console::line!(
            "the machine held this program up {} times; the robot's time stood still meanwhile",
            served.held_up
        );
    }
    if served.events_lost > 0 {
        console::line!("{} events are not in the log: the client sent too much at once", served.events_lost);
    }
    if let Some(landing) = landing {
        let p = landing.p_m;
        console::line!("ball: lands at ({:.4}, {:.4}, {:.4}) m", p.x, p.y, p.z);
    }
    if let Some(cause) = served.fault {
        console::line!("fault: {cause}");
    }
    Ok(())
}

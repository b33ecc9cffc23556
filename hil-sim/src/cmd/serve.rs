//! `hil-sim serve`: real time, for programs that want drives.

use std::io::IsTerminal;
use std::path::PathBuf;

use can_link::{BusSpec, Role, Urgent};
use console::{Fetched, TypedInput};
use hil_sim::cell::Cell;
use hil_sim::participants::Solo;
use hil_sim::realtime::{Endpoint, Realtime, RealtimeError, Visit, shared_time};
use hil_sim::report::{DriveRow, ThrowRow};
use hil_sim::scenario::{Scenario, ScriptedHost, fault_from_line};
use protocol::{Duration, Instant};

use super::exit::{Code, Failure};
use super::progress::Interrupt;

/// Time between two status lines.
const STATUS_EVERY: Duration = Duration::from_secs(1);

/// Falling behind by this much is reported when it happens: a controller with a cycle of 3 ms loses two answers in a row.
const LAG_TOLD: Duration = Duration::from_millis(5);

/// What can be typed while it runs.
const COMMANDS: &str = "commands: fault KEYS (as in a scenario, on one line: fault kind = \"silent\", target = \"module 3\", \
length_s = 1), report, quit";

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Where: socketcand://127.0.0.1:29536/can0 and slcan://127.0.0.1:3333 serve that port, slcan:/dev/ptmx makes a
    /// pseudo-terminal, vcan0 joins that interface; lockstep://127.0.0.1:29536/can0?clients=2 serves programs in virtual
    /// time, which stands while fewer than two take part. Given several times, all of them lead to the same bus. A port takes 32
    /// clients; one more gets a message and is disconnected (SLCAN: BELL). A client that has not opened the bus within 5 s, or
    /// reads nothing for 10 s while frames wait for it, is disconnected.
    #[arg(long, value_parser = can_link::bus_of_option, default_value = "socketcand://127.0.0.1:29536/can0")]
    bus: Vec<BusSpec>,
    /// Robot: a built-in name or a file.
    #[arg(long)]
    robot: Option<String>,
    /// Scenario with options, faults and actions; its duration is not used.
    #[arg(long)]
    scenario: Option<PathBuf>,
    /// Seed instead of the scenario's.
    #[arg(long)]
    seed: Option<u64>,
    /// End after this many seconds.
    #[arg(long, value_name = "SECONDS")]
    duration_s: Option<f64>,
    /// Print events and the report as JSON lines.
    #[arg(long)]
    json: bool,
}

type Cells = (Cell, Solo<ScriptedHost>);

pub(super) fn run(args: &Args) -> Result<(), Failure> {
    let mut scenario = match &args.scenario {
        Some(path) => Scenario::load(path)?,
        None => Scenario { name: "serve".to_owned(), ..Scenario::default() },
    };
    if let Some(robot) = &args.robot {
        scenario.robot.clone_from(robot);
    }
    if let Some(seed) = args.seed {
        scenario.seed = seed;
    }
    let cell = scenario.cell()?;
    let host = Solo::new("script", ScriptedHost::new(&scenario.actions));
    let (clock, in_step) =
        shared_time(&args.bus).map_err(|error| Failure::new(Code::BadFile, &error).next(error.next()))?;
    let endpoints: Vec<Endpoint> = args
        .bus
        .iter()
        .map(|spec| {
            Endpoint::open(spec, clock).map_err(|error| Failure::new(Code::Bus, &error).next(error.next()))
        })
        .collect::<Result<_, _>>()?;
    let end = args.duration_s.map(|s| Instant::ZERO + Duration::from_secs_f64(s));
    let faults = scenario.faults.clone();
    let mut realtime = Realtime::new((cell, host), scenario.bus, scenario.seed, faults, endpoints, clock)
        .map_err(|error| Failure::new(Code::BadFile, &error))?;
    if let Some(end) = end {
        realtime = realtime.ending_at(end);
    }
    if let Some(clients) = in_step {
        realtime = realtime.in_lock_step(clients);
    }
    let interrupt = Interrupt::listen();
    let mut commands = console::typed_lines();
    for endpoint in realtime.endpoints() {
        say(
            args,
            "serving",
            &format!("{} (robot {}, seed {})", endpoint.name(), scenario.robot, scenario.seed),
        );
    }
    let urgent = Urgent::request(Role::Plant);
    say(args, "real time", &urgent.granted().to_string());
    if !args.json && std::io::stdin().is_terminal() {
        console::note!("{COMMANDS}; Ctrl-C ends");
    }
    let result = live(args, &mut realtime, &interrupt, &mut commands, end);
    report(args, &scenario, &realtime)?;
    result
}

fn live(
    args: &Args,
    realtime: &mut Realtime<Cells>,
    interrupt: &Interrupt,
    commands: &mut TypedInput<String>,
    end: Option<Instant>,
) -> Result<(), Failure> {
    let mut status_at = Instant::ZERO + STATUS_EVERY;
    let mut faults_typed = 0;
    while !interrupt.came() && end.is_none_or(|end| realtime.world().now() < end) {
        let until = end.map_or(status_at, |end| end.min(status_at));
        realtime.turn(until, &mut ()).map_err(|error| match error {
            RealtimeError::Run(error) => Failure::from(error),
            other => Failure::new(Code::Bus, &other).next(other.next()),
        })?;
        for visit in realtime.visits() {
            match visit {
                Visit::Joined(peer) => say(args, "client", &format!("{peer} connected")),
                Visit::InStep(turn) => say(args, "client", &format!("takes turn {turn} in lock step")),
                Visit::Left(reason) => say(args, "client", &format!("gone: {reason}")),
            }
        }
        match commands.fetch() {
            Fetched::Item(line) if matches!(line.trim(), "quit" | "exit") => return Ok(()),
            Fetched::Item(line) => command(args, realtime, line.trim(), &mut faults_typed),
            Fetched::Nothing | Fetched::Ended => {}
        }
        if realtime.world().now() >= status_at {
            let worst = realtime.take_worst_lag();
            if worst > LAG_TOLD {
                say(args, "late", &format!("the machine held the simulation up for {worst}"));
            }
            status(args, realtime);
            status_at = realtime.world().now() + STATUS_EVERY;
        }
    }
    Ok(())
}

fn command(args: &Args, realtime: &mut Realtime<Cells>, line: &str, faults_typed: &mut usize) {
    match line.split_once(' ').unwrap_or((line, "")) {
        ("", _) => {}
        ("fault", keys) => {
            let taken = fault_from_line(keys, *faults_typed).map_err(|error| error.to_string()).and_then(
                |mut fault| {
                    *faults_typed += 1;
                    let label = format!("typed {} ({})", faults_typed, fault.label);
                    fault.label.clone_from(&label);
                    // Times of typed faults count from now.
                    fault.start = realtime.world().now() + fault.start.saturating_since(Instant::ZERO);
                    realtime.world_mut().add_fault(fault).map_err(|error| error.to_string())?;
                    Ok(label)
                },
            );
            match taken {
                Ok(label) => say(args, "fault", &format!("{label} taken")),
                Err(error) => say(args, "refused", &error),
            }
        }
        ("report", _) => console::line!("{}", realtime.world().bus_report()),
        _ => say(args, "refused", &format!("'{line}'; {COMMANDS}")),
    }
}

/// One line that overwrites itself on a terminal; nothing elsewhere.
fn status(args: &Args, realtime: &Realtime<Cells>) {
    if args.json || !std::io::stderr().is_terminal() {
        return;
    }
    let world = realtime.world();
    let active: Vec<&str> = world.faults().active().collect();
    let faults = if active.is_empty() { String::new() } else { format!(", faults: {}", active.join(", ")) };
    console::note_text!(
        "\r\x1b[K{} s, {} clients, {} frames, bus {:.1} %, behind by {}{faults}",
        world.now().as_micros() / 1_000_000,
        realtime.endpoints().map(Endpoint::clients).sum::<usize>(),
        world.stats().frames,
        100.0 * world.bus().busy_ns() as f64 / world.bus().now_ns().max(1) as f64,
        realtime.lag(),
    );
}

fn say(args: &Args, what: &str, text: &str) {
    if args.json {
        console::line!("{}", serde_json::json!({ "event": what, "text": text }));
    } else {
        // Over the status line, if there is one.
        let clear = if std::io::stderr().is_terminal() { "\r\x1b[K" } else { "" };
        console::note!("{clear}{what}: {text}");
    }
}

fn report(args: &Args, scenario: &Scenario, realtime: &Realtime<Cells>) -> Result<(), Failure> {
    let world = realtime.world();
    let cell = &world.participants().0.0;
    if args.json {
        let us = |share| realtime.latency().percentile(share).map(Duration::as_micros);
        let report = serde_json::json!({
            "event": "report",
            "name": scenario.name,
            "seed": scenario.seed,
            "simulated_s": world.now().as_secs_f64(),
            "world": world.stats(),
            "bus": world.bus_report(),
            "drives": DriveRow::of(cell),
            "throw": ThrowRow::of(cell),
            "faults": world.faults().counts(),
            "latency_us": {
                "count": realtime.latency().count(),
                "median": us(0.5), "p99": us(0.99),
                "max": realtime.latency().max().map(Duration::as_micros),
            },
            "lateness_us": {
                "median": realtime.lateness().percentile(0.5).map(Duration::as_micros),
                "max": realtime.lateness().max().map(Duration::as_micros),
            },
            "lag_us": {
                "p99": realtime.lag().turns.percentile(0.99).map(Duration::as_micros),
                "max": realtime.lag().turns.max().map(Duration::as_micros),
                "turns": realtime.lag().turns.count(),
                "turns_late": realtime.lag().late,
            },
            "lost": realtime.lost(),
            "turns": realtime.turns(),
        });
        console::line!("{}", serde_json::to_string(&report).map_err(|e| Failure::new(Code::Output, &e))?);
        return Ok(());
    }
    console::line!();
    console::text!("{}", world.bus_report());
    console::line!("answers: {}", realtime.latency());
    console::line!("late against the simulated bus: {}", realtime.lateness());
    console::line!("behind the clock: {}", realtime.lag());
    if realtime.lost() > 0 {
        console::line!("{} frames lost: the link did not take them", realtime.lost());
    }
    Ok(())
}

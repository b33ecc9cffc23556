//! `cubectl sim`

use std::path::PathBuf;

use can_link::{BusSpec, Role, Urgent};
use hil_sim::participants::Solo;
use hil_sim::realtime::{Endpoint, Realtime, RealtimeError, Visit, shared_time};
use hil_sim::scenario::{Scenario, ScriptedHost};
use protocol::{Duration, Instant};
use robot_model::RobotModel;

use super::sim_robot::RobotRun;
use crate::error::ExpectedError;
use crate::exit;
use operator::bus::BusFailure;
use operator::bus::period::settings_with_gains;
use operator::bus::sim::{controller_node, no_other_nodes};
use operator::drives::CanDrives;
use operator::interrupt::interrupt;

/// Time between two looks at how late the machine was, and the lag that is printed at once: a controller with a cycle
/// of 3 ms loses two answers in a row.
const LAG_LOOK: Duration = Duration::from_secs(1);
const LAG_TOLD: Duration = Duration::from_millis(5);
/// Time between two looks at Ctrl-C.
const LOOK: Duration = Duration::from_millis(50);

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl sim                                  # then: cubectl status --bus socketcand://127.0.0.1:29536/can0\n  cubectl sim --bus slcan:/dev/ptmx --controller\n  cubectl sim --bus vcan0 --scenario hil-sim/scenarios/silent_joint.toml\n  cubectl sim --robot kr16_2 --rsi udp://127.0.0.1:49152 --tracker 127.0.0.1:5000"
)]
pub struct Args {
    /// Where: socketcand://127.0.0.1:29536/can0 and slcan://127.0.0.1:3333 serve that port, slcan:/dev/ptmx makes a
    /// pseudo-terminal, vcan0 joins that interface; lockstep://127.0.0.1:29536/can0?clients=2 serves programs in virtual
    /// time, which stands while fewer than two take part. Given several times, all of them lead to the same bus. A port takes 32
    /// clients; one more gets that answer and is disconnected (SLCAN: BELL). A client that has not opened the bus within 5 s, or
    /// reads nothing for 10 s while frames wait for it, is disconnected.
    #[arg(long, value_parser = can_link::bus_of_option, default_value = "socketcand://127.0.0.1:29536/can0", value_name = "SPEC")]
    pub bus: Vec<BusSpec>,
    /// Robot: a built-in name or a file.
    #[arg(long, value_name = "ROBOT")]
    pub robot: Option<String>,
    /// Scenario with options, faults and actions.
    #[arg(long)]
    pub scenario: Option<PathBuf>,
    /// Seed instead of the scenario's.
    #[arg(long)]
    pub seed: Option<u64>,
    /// Put the soft controller on the bus too.
    #[arg(long)]
    pub controller: bool,
    /// End after this many seconds.
    #[arg(long = "for-s", alias = "for", value_name = "SECONDS", value_parser = super::values::positive)]
    pub time: Option<f64>,
    /// An industrial robot instead of the cell.
    #[command(flatten)]
    pub industrial: super::sim_robot::RobotArgs,
}

pub fn run(args: &Args) -> Result<(), ExpectedError> {
    if let Some(spec) = &args.industrial.rsi {
        let run = RobotRun {
            industrial: &args.industrial,
            robot: args.robot.as_deref(),
            scenario: args.scenario.as_deref(),
            seed: args.seed,
            time_s: args.time,
        };
        return super::sim_robot::run(&run, spec);
    }
    let mut scenario = match &args.scenario {
        Some(path) => Scenario::load(path).map_err(|error| ExpectedError::bad_input(&error))?,
        None => Scenario { name: "sim".to_owned(), ..Scenario::default() },
    };
    if let Some(robot) = &args.robot {
        scenario.robot.clone_from(robot);
    }
    scenario.seed = args.seed.unwrap_or(scenario.seed);
    let cell = scenario.cell().map_err(|error| ExpectedError::bad_input(&error))?;
    let others = if args.controller {
        let robot = RobotModel::load(&scenario.robot).map_err(|error| ExpectedError::bad_input(&error))?;
        let settings = settings_with_gains(&robot, &scenario.clone().into())
            .map_err(|error| ExpectedError::bad_input(&error))?;
        let drives = CanDrives::of(&robot).map_err(|error| ExpectedError::bad_input(&error))?;
        controller_node(&settings, drives, std::rc::Rc::default())
    } else {
        no_other_nodes()
    };
    let script = Solo::new("script", ScriptedHost::new(&scenario.actions));
    let (clock, in_step) = shared_time(&args.bus).map_err(|error| ExpectedError::bad_input(&error))?;
    let endpoints: Vec<Endpoint> = args
        .bus
        .iter()
        .map(|spec| Endpoint::open(spec, clock).map_err(BusFailure::from))
        .collect::<Result<_, _>>()?;
    let participants = ((cell, script), others);
    let faults = scenario.faults.clone();
    let mut realtime = Realtime::new(participants, scenario.bus, scenario.seed, faults, endpoints, clock)
        .map_err(|error| ExpectedError::bad_input(&error))?;
    if let Some(clients) = in_step {
        realtime = realtime.in_lock_step(clients);
    }
    let stop = interrupt();
    for endpoint in realtime.endpoints() {
        console::line!(
            "serving {} (robot {}, seed {}); Ctrl-C ends",
            endpoint.name(),
            scenario.robot,
            scenario.seed
        );
    }
    let urgent = Urgent::request(Role::Plant);
    console::note!("simulated drives in real time: {}", urgent.granted());
    let mut lag_at = realtime.world().now() + LAG_LOOK;
    let end = args.time.map_or(Instant::FAR_FUTURE, |s| Instant::ZERO + Duration::from_secs_f64(s));
    while !stop.load(std::sync::atomic::Ordering::Relaxed) && realtime.world().now() < end {
        let until = (realtime.world().now() + LOOK).min(end);
        realtime.turn(until, &mut ()).map_err(|error| {
            let code = if matches!(error, RealtimeError::Run(_)) { exit::BUG } else { exit::BUS };
            ExpectedError::of(code, &error)
        })?;
        if realtime.world().now() >= lag_at {
            lag_at = realtime.world().now() + LAG_LOOK;
            let worst = realtime.take_worst_lag();
            if worst > LAG_TOLD {
                console::note!("late: the machine held the simulation up for {worst}");
            }
        }
        for visit in realtime.visits() {
            match visit {
                Visit::Joined(peer) => console::note!("client {peer} connected"),
                Visit::InStep(turn) => console::note!("client takes turn {turn} in lock step"),
                Visit::Left(reason) => console::note!("client gone: {reason}"),
            }
        }
    }
    console::text!("{}", realtime.world().bus_report());
    console::line!("answers: {}", realtime.latency());
    console::line!("behind the clock: {}", realtime.lag());
    Ok(())
}

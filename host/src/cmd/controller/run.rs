//! `cubectl controller run`

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};

use can_link::{BusSpec, CanLink, Clock, Role, RunError, Runner, Urgent};
use firmware::ControllerNode;
use firmware::fault::Fault;
use firmware::group::DriveGroup as _;
use firmware::host_link::Identity;
use firmware::orders::Order;
use firmware::settings::Settings;
use firmware::spline::Spline;
use firmware::state::State;
use firmware::store::{RamStorage, Storage, load_settings};
use protocol::Duration;
use protocol::cyphal::crc::Crc64;
use protocol::cyphal::id::NodeId;
use robot_model::RobotModel;

use crate::cmd::throw::{period_request, period_us, read_gains};
use crate::cmd::values::node_id;
use crate::error::ExpectedError;
use crate::exit;
use operator::bus::BusFailure;
use operator::bus::cycle_timing;
use operator::bus::entropy;
use operator::bus::period::{NoPeriod, apply, choose};
use operator::bus::settings::settings_of;
use operator::bus::soft::SoftReport;
use operator::bus::storage::FileStorage;
use operator::drives::{CanDrives, difference_text};
use operator::interrupt::interrupt;

/// Time between two looks at the state of the group.
const LOOK: Duration = Duration::from_millis(20);
/// Longest time that a stop gets after Ctrl-C; the longest path stop and a quick stop after it fit.
const STOP_TIME: Duration = Duration::from_secs(3);
/// Time for the halt to leave.
const HALT_TIME: Duration = Duration::from_millis(50);

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl controller run --bus can0 --storage arm.storage\n  cubectl controller run --bus socketcand://127.0.0.1:29536/can0 --period-ms 17\n  cubectl controller run --bus can0 --robot my_arm.toml --gains gains.toml\n  cubectl throw --target 1,1,-1 --bus can0 --controller 10   # in another terminal\n\nThe period is that of the storage, or --period-ms, or the shortest one that this machine and this bus hold: a second of\nquestions to the drives tells. One that does not hold is refused before anything moves. A real-time priority is\nasked for and used where the system allows it (limits.conf: rtprio, memlock).\n\nCtrl-C stops the arm along its path and halts the drives; another Ctrl-C half a second later ends at once, the drives'\nwatchdogs then stop them."
)]
pub struct Args {
    #[arg(long, help = format!("Bus: {}", can_link::LIVE_BUSES), value_parser = can_link::bus_of_option, value_name = "SPEC")]
    pub bus: BusSpec,
    /// Cyphal node-ID. Default: the stored one, else 10.
    #[arg(long, value_name = "NODE-ID", value_parser = node_id)]
    pub node_id: Option<NodeId>,
    /// File for settings and trajectories; made if it is not there. Without it they are forgotten in the end.
    #[arg(long, value_name = "FILE")]
    pub storage: Option<PathBuf>,
    /// Robot: a built-in name or a file.
    #[arg(long, value_name = "ROBOT", default_value = "powercube6")]
    pub robot: String,
    /// Control period, ms: 3, 5, 10, 17 or 30. What is stored goes before.
    #[arg(long = "period-ms", alias = "period", id = "period_ms", value_name = "MS", value_parser = period_us)]
    pub period: Option<u32>,
    /// Gains with their certificate, from `cubectl tune`; the controller runs at their period. What is stored goes before.
    /// Default: those that come with the program for powercube6, and a design made on the way for any other robot.
    #[arg(long, value_name = "FILE", conflicts_with = "period_ms")]
    pub gains: Option<PathBuf>,
    /// Begin with period and gains of the paper, 17 ms, whatever the machine holds; only for powercube6. What is stored
    /// goes before.
    #[arg(long, conflicts_with_all = ["period_ms", "gains"])]
    pub paper: bool,
    /// End after this many seconds, as by Ctrl-C.
    #[arg(long = "for-s", alias = "for", value_name = "SECONDS", value_parser = crate::cmd::values::positive)]
    pub time: Option<f64>,
}

pub fn run(args: &Args) -> Result<(), ExpectedError> {
    match &args.storage {
        None => with_storage(args, RamStorage::new()),
        Some(path) => {
            let storage = FileStorage::open(path).map_err(|error| ExpectedError::io(path, &error))?;
            with_storage(args, storage)
        }
    }
}

fn with_storage(args: &Args, storage: impl Storage) -> Result<(), ExpectedError> {
    let clock = args.bus.clock();
    let mut link = can_link::open(&args.bus, clock).map_err(BusFailure::from)?;
    let robot = RobotModel::load(&args.robot).map_err(|error| ExpectedError::bad_input(&error))?;
    let defaults = defaults(args, &robot, &storage, &mut *link, clock)?;
    let drives = CanDrives::of(&robot).map_err(|error| ExpectedError::bad_input(&error))?;
    let seed = entropy::seed(clock)?;
    let mut node = ControllerNode::with_group(clock.now(), storage, drives, &defaults, identity(), seed);
    let settings = *node.controller().settings();
    if args.node_id.is_some_and(|id| u32::from(id.get()) != settings.node_id) {
        return Err(ExpectedError::bad_input(&format!(
            "the storage says node-ID {}, --node-id another one",
            settings.node_id
        ))
        .next("leave --node-id out, or write register uavcan.node.id and save"));
    }
    let urgent = Urgent::request(Role::Controller);
    console::note!(
        "controller {} on {}: {} joints, {} us; Ctrl-C stops the arm and ends",
        settings.node_id,
        args.bus,
        settings.joints,
        settings.cycle_period_us,
    );
    let until = args.time.map(|s| clock.now() + Duration::from_secs_f64(s));
    let stop = interrupt();
    // Its first deadline lies before the measurement: it is not counted as late.
    Runner::new(&mut *link, clock).step(&mut [&mut node], Some(clock.now())).map_err(failure)?;
    let mut runner = Runner::new(&mut *link, clock);
    let mut shown = None;
    while !stop.load(Ordering::Relaxed) && until.is_none_or(|until| clock.now() < until) {
        let look = clock.now() + LOOK;
        runner.run(&mut [&mut node], &stop, Some(look)).map_err(failure)?;
        show(&node, &mut shown);
    }
    come_to_rest(&mut runner, &mut node, clock)?;
    show(&node, &mut shown);
    let stats = runner.stats();
    console::line!(
        "{} frames received, {} sent, {} not taken by the bus",
        stats.received,
        stats.sent,
        stats.dropped
    );
    console::line!("{}", SoftReport::of(stats, 0, urgent.granted()));
    let counters = node.controller().counters();
    console::line!(
        "{} control cycles, {} late, {} replies missed",
        counters.cycles,
        counters.cycles_late,
        counters.replies_missed
    );
    match node.controller().state() {
        State::Fault { fault, .. } => Err(ended_in(fault)),
        _ => Ok(()),
    }
}

/// What whoever started the controller must know if it ends while a fault is latched.
fn ended_in(fault: &Fault) -> ExpectedError {
    let code = fault.cause.code();
    ExpectedError::new(exit::FINDINGS, format!("ended in the state Fault: {}", in_words(fault)))
        .next(format!("`cubectl explain {code}`; a new start looks at the drives again"))
}

/// Name, code and joint of a fault.
fn in_words(fault: &Fault) -> String {
    let joint = fault.joint.map_or(String::new(), |joint| format!(" at joint {}", joint.get() + 1));
    format!("{} ({}){joint}", fault.cause.name(), fault.cause.code())
}

/// Settings to begin with, at a period that holds here.
fn defaults(
    args: &Args,
    robot: &RobotModel,
    storage: &impl Storage,
    link: &mut dyn CanLink,
    clock: Clock,
) -> Result<Settings, ExpectedError> {
    let mut settings = settings_of(robot).map_err(|error| ExpectedError::bad_input(&error))?;
    let given = args.gains.as_ref().map(|path| read_gains(path, robot.name())).transpose()?;
    if args.paper {
        settings = paper(&settings)?;
    }
    if let Some(id) = args.node_id {
        settings.node_id = id.get().into();
    }
    let modules: Vec<_> = settings.joints().map(|joint| settings.joint.at(joint).module()).collect();
    let timing = cycle_timing::measure(link, clock, &modules).map_err(failure)?;
    if timing.foreign_requests > 0 {
        return Err(ExpectedError::new(
            exit::BUS,
            format!(
                "{}: another controller or host speaks to the modules; two of them destroy each other's frames",
                args.bus
            ),
        )
        .next("end it; nothing has moved"));
    }
    console::note!("{timing}; {}", timing.granted);
    if args.paper {
        return Ok(settings);
    }
    let stored = load_settings(storage, &settings);
    if stored != settings {
        let period = stored.cycle_period();
        // Its gains are stored too, and need no others.
        return if timing.holds(period) {
            Ok(settings)
        } else {
            let next =
                "write register cycle.period_us and gains for it, or begin with another --storage".to_owned();
            Err(NoPeriod::TooShort { period_us: stored.cycle_period_us, timing: Box::new(timing), next }
                .into())
        };
    }
    let choice = choose(period_request(given, args.period), Some(&timing), robot, settings.cycle_period_us)?;
    console::note!("control period {} ms ({})", f64::from(choice.period_us) * 1e-3, choice.why);
    apply(&choice, &mut settings);
    Ok(settings)
}

/// The settings of the paper, for the robot they are for.
fn paper(settings: &Settings) -> Result<Settings, ExpectedError> {
    let paper = Settings::powercube6_paper();
    let near = |a: f32, b: f32| (a - b).abs() <= 1e-4 * b.abs();
    let same = settings.joints == paper.joints
        && settings.joints().all(|joint| {
            let (a, b) = (settings.joint.at(joint), paper.joint.at(joint));
            a.address == b.address
                && near(a.a_max_rad_s2, b.a_max_rad_s2)
                && near(a.v_max_rad_s, b.v_max_rad_s)
                && near(a.q_min_rad, b.q_min_rad)
                && near(a.q_max_rad, b.q_max_rad)
        });
    if same {
        return Ok(paper);
    }
    Err(ExpectedError::bad_input(
        &"the settings of the paper are for powercube6, and this robot has other joints",
    )
    .next("leave --paper out, then gains are designed for the robot, or --robot"))
}

/// A moving arm stops along its path; in the end the drives are halted.
fn come_to_rest<S: Storage>(
    runner: &mut Runner<'_>,
    node: &mut ControllerNode<S, Spline, CanDrives>,
    clock: Clock,
) -> Result<(), ExpectedError> {
    let never = AtomicBool::new(false);
    let limit = clock.now() + STOP_TIME;
    // A stop is taken in every state.
    let _ = node.order(clock.now(), Order::Stop);
    while node.controller().state().kind().may_move() && clock.now() < limit {
        runner.run(&mut [&mut *node], &never, Some(clock.now() + LOOK)).map_err(failure)?;
    }
    if node.controller().state().kind().may_move() {
        node.stop_now(clock.now());
    }
    runner.run(&mut [node], &never, Some(clock.now() + HALT_TIME)).map_err(failure)
}

fn failure(error: RunError) -> ExpectedError {
    match error {
        RunError::Link(_) | RunError::Wait(_) => ExpectedError::of(exit::BUS, &error).also(
            ExpectedError::new(exit::BUS, "  the drives stop by their watchdogs")
                .next("restore the bus and start again"),
        ),
        other => ExpectedError::of(exit::BUG, &other),
    }
}

/// A line for each new state.
fn show<S: Storage>(node: &ControllerNode<S, Spline, CanDrives>, shown: &mut Option<State>) {
    let state = *node.controller().state();
    if shown.is_some_and(|last| last.kind() == state.kind() && last.fault() == state.fault()) {
        return;
    }
    let why = match state.fault() {
        Some(fault) => format!(": {}; `cubectl explain {}`", in_words(&fault), fault.cause.code()),
        None => String::new(),
    };
    console::note!("{:?}{why}", state.kind());
    if let (Some(_), Some((joint, reported))) = (state.fault(), node.controller().group().difference()) {
        let what = difference_text(reported).unwrap_or_default();
        console::note!("  joint {}: {what}", joint.get() + 1);
    }
    *shown = Some(state);
}

/// The same computer is the same node each time; another one another.
fn identity() -> Identity {
    let machine = std::fs::read("/etc/machine-id").unwrap_or_default();
    let (mut low, mut high) = (Crc64::new(), Crc64::new());
    low.update(&machine);
    high.update(b"cubectl controller");
    high.update(&machine);
    let mut unique_id = [0; 16];
    for (to, from) in
        unique_id.iter_mut().zip(low.get().to_le_bytes().into_iter().chain(high.get().to_le_bytes()))
    {
        *to = from;
    }
    Identity { unique_id, hardware: (1, 0) }
}

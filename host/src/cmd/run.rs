//! `cubectl run`

use std::path::PathBuf;

use protocol::cyphal::cubecell::group_state::State;
use protocol::cyphal::id::NodeId;
use protocol::{Duration, Instant};

use super::consent::Consent;
use super::controlled::tell_warnings;
use super::print_json;
use super::upload::{bytes_for, node_id, read, send, settle};
use crate::error::ExpectedError;
use crate::exit;
use operator::bus::key_file::KeyArgs;
use operator::bus::{BusArgs, Session};
use operator::dialogue::clock::ControllerClock;
use operator::dialogue::operator::OperatorError;
use operator::interrupt::interrupt;

/// Longest time that a run is ordered ahead, s: the controller takes 30 s, of which the order needs a little.
const START_IN_MAX_S: f64 = 29.0;

/// Arguments.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:\n  cubectl run plan.json --bus can0 --record throw1\n\nThe arm must be homed and stand where the plan begins (`cubectl throw --plan` moves it\nthere). On every bus but `sim` it asks first; without a terminal it needs --yes. Ctrl-C stops it along its path."
)]
pub struct Args {
    /// Plan (JSON), or trajectory file of a controller.
    pub file: PathBuf,
    /// Bus options; on the bus `sim` a soft controller is in the cell.
    #[command(flatten)]
    pub bus: BusArgs,
    /// Key of the controller.
    #[command(flatten)]
    pub key: KeyArgs,
    /// Cyphal node-ID of the controller. Default: the one that is heard.
    #[arg(long, value_name = "NODE-ID", value_parser = node_id)]
    pub controller: Option<NodeId>,
    /// Home what is not homed first.
    #[arg(long)]
    pub home: bool,
    /// Begin the plan this many seconds after the order, at a time of the controller's clock; it waits armed.
    #[arg(long, value_name = "SECONDS", value_parser = start_in)]
    pub start_in: Option<f64>,
    /// Do not ask before the arm moves.
    #[arg(long)]
    pub yes: bool,
    /// Longest time for the run, s.
    #[arg(long, default_value_t = 60.0, value_name = "SECONDS", value_parser = super::home::positive)]
    pub timeout: f64,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

fn start_in(text: &str) -> Result<f64, String> {
    let seconds = super::home::positive(text)?;
    if seconds <= START_IN_MAX_S { Ok(seconds) } else { Err(format!("must be at most {START_IN_MAX_S} s")) }
}

/// Runs the verb.
///
/// # Errors
/// The file, the bus, no controller, its refusal, or a stop or fault on the way.
pub fn run(args: &Args) -> Result<(), ExpectedError> {
    Consent::on(&args.bus.bus, args.yes)?
        .require("The arm follows the trajectory. Nobody near?", &interrupt())?;
    let source = read(&args.file, args.bus.cell.robot.as_deref())?;
    let key = args.key.load()?;
    let mut session = args.bus.open_with_controller()?;
    session.set_key(key);
    session.watch_stops();
    let node = session.find_controller(args.controller)?;
    settle(&mut session)?;
    let group = session.group().unwrap_or_default();
    if group.state == State::Idle {
        if !args.home {
            return Err(ExpectedError::new(
                exit::DRIVE,
                "not all joints are homed; nothing moved\n  next: `cubectl run --home`, or `cubectl home` first",
            ));
        }
        let joints = session.measured_pose(node)?.len().min(protocol::JOINTS_MAX);
        let all = ((1_u16 << joints) - 1) as u8;
        session.home_group(node, all & !group.homed_mask, Duration::from_secs(120))?;
    }
    let bytes = bytes_for(&mut session, node, &source)?;
    let name = send(&mut session, node, &bytes)?;
    session.arm(node, &name)?;
    if !args.json {
        console::note!(
            "controller {}: armed for {:016x}; running, Ctrl-C stops",
            node.get(),
            name.trajectory_crc64
        );
    }
    let begun = session.now();
    let start = args.start_in.map(|seconds| start_time(&mut session, node, seconds)).transpose()?;
    if let (Some((at, off)), false) = (start, args.json) {
        console::note!("the plan begins at {at} of its clock, which is known to {off} here");
    }
    let limit = Duration::from_secs_f64(args.timeout + args.start_in.unwrap_or(0.0));
    let start_at = start.map(|(at, _)| at);
    let ended = session.run_trajectory_at(node, &name, start_at, limit, &mut |_, _| {});
    tell_warnings(&mut session);
    let end = ended?;
    let took_s = session.now().saturating_since(begun).as_secs_f64();
    session.finish()?;
    if args.json {
        print_json(&serde_json::json!({
            "controller": node.get(),
            "trajectory_crc64": format!("{:016x}", name.trajectory_crc64),
            "took_s": took_s,
            "start_controller_s": start.map(|(at, _)| at.as_secs_f64()),
            "start_known_to_s": start.map(|(_, off)| off.as_secs_f64()),
            "cycle_us": end.cycle_us,
            "cycle_jitter_us": end.cycle_jitter_us,
            "cycles_late": end.cycles_late,
            "replies_missed": end.replies_missed,
            "cycles_saturated": end.cycles_saturated,
            "bus_load_permille": end.bus_load_permille,
        }));
    } else {
        console::line!(
            "done in {took_s:.2} s; {} late cycles, {} missed replies, {} saturated cycles",
            end.cycles_late,
            end.replies_missed,
            end.cycles_saturated
        );
    }
    Ok(())
}

/// The time of the controller this many seconds from now, and to what it is known.
fn start_time(
    session: &mut Session,
    node: NodeId,
    seconds: f64,
) -> Result<(Instant, Duration), OperatorError> {
    let mut clock = ControllerClock::default();
    session.read_clock(node, &mut clock)?;
    let ours = session.now() + Duration::from_secs_f64(seconds);
    // There is a reading: the last line made one.
    clock.controller_time(ours).ok_or(OperatorError::Unreadable { node })
}

//! `cubectl upload`

use std::io::IsTerminal;
use std::path::{Path, PathBuf};

use indicatif::ProgressBar;
use protocol::cyphal::cubecell::command::Trajectory;
use protocol::cyphal::id::NodeId;

use crate::error::ExpectedError;
use operator::bus::key_file::KeyArgs;
use operator::bus::{BusArgs, Session};
use operator::dialogue::operator::{FINDING_MAX, OperatorError};
use operator::throw::trajectory::{encode, robot_crc32};
use planner::motion::Motion;
use planner::plan::file::{Kind, PlanFileError, require_robot};
use planner::record::PlanRecord;

/// Arguments.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:\n  cubectl upload plan.json --bus can0\n\nThe file is a plan, or the controller's binary form of one. It is checked in the controller before it is committed."
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
}

/// A Cyphal node-ID on the command line.
pub(super) fn node_id(text: &str) -> Result<NodeId, String> {
    text.parse::<u8>()
        .ok()
        .and_then(|id| NodeId::new(id).ok())
        .ok_or("must be a number from 0 to 127".to_owned())
}

/// Runs the verb.
///
/// # Errors
/// The file, the bus, no controller, or its refusal with the cause.
pub fn run(args: &Args) -> Result<(), ExpectedError> {
    let source = read(&args.file, args.bus.cell.robot.as_deref())?;
    let key = args.key.load()?;
    let mut session = args.bus.open_with_controller()?;
    session.set_key(key);
    let node = session.find_controller(args.controller)?;
    settle(&mut session)?;
    let bytes = bytes_for(&mut session, node, &source)?;
    let name = send(&mut session, node, &bytes)?;
    session.finish()?;
    console::line!(
        "controller {}: {} bytes stored and committed, hash {:016x}",
        node.get(),
        bytes.len(),
        name.trajectory_crc64
    );
    Ok(())
}

/// What a file holds that can be run.
pub(super) enum Source {
    /// A controller's trajectory file, as it is.
    Controller(Vec<u8>),
    /// A plan: its motion, and the fingerprint of its robot.
    Plan(Box<Motion>, String),
}

/// Reads a trajectory file of a controller or a plan; a plan must be for `robot`, if that is given.
pub(super) fn read(path: &Path, robot: Option<&str>) -> Result<Source, ExpectedError> {
    let bytes = toml_reader::read_bytes(path, planner::plan::file::FILE_MAX_BYTES)
        .map_err(|error| ExpectedError::io(path, &error))?;
    if bytes.starts_with(&firmware::trajectory_format::MAGIC) {
        return Ok(Source::Controller(bytes));
    }
    if !bytes.trim_ascii_start().starts_with(b"{") {
        return Err(ExpectedError::bad_input(&format!(
            "{}: neither a plan (JSON) nor a trajectory file of a controller (it does not begin with CTRJ)\n  next: \
             `cubectl plan throw --out FILE` makes a plan",
            path.display()
        )));
    }
    let bad = |error: &PlanFileError| ExpectedError::bad_input(error);
    let plan = PlanRecord::read(path).map_err(|error| bad(&error))?;
    let id = plan.robot().clone();
    let arm = super::robot(robot.unwrap_or(&id.source))?;
    let motion = match &plan {
        PlanRecord::Throw(plan) => &plan.motion,
        PlanRecord::Move(plan) => &plan.motion,
        PlanRecord::Follow(_) => {
            let (found, wanted) = (Kind::Follow, Kind::Throw);
            return Err(bad(&PlanFileError::OtherKind { path: path.to_owned(), found, wanted }));
        }
    };
    require_robot(path, &id, motion.joints.len(), &arm).map_err(|error| bad(&error))?;
    Ok(Source::Plan(Box::new(motion.to_motion()), id.fingerprint))
}

/// The controller's form of it: a plan is made into one for the period of `node`.
pub(super) fn bytes_for(
    session: &mut Session,
    node: NodeId,
    source: &Source,
) -> Result<Vec<u8>, ExpectedError> {
    match source {
        Source::Controller(bytes) => Ok(bytes.clone()),
        Source::Plan(motion, fingerprint) => {
            let period_us = session.natural(node, "cycle.period_us")? as u32;
            encode(motion, period_us, robot_crc32(fingerprint), None)
                .map_err(|error| ExpectedError::bad_input(&error))
        }
    }
}

/// Waits until the controller has found its drives.
pub(super) fn settle(session: &mut Session) -> Result<(), OperatorError> {
    use protocol::cyphal::cubecell::group_state::State;
    session.wait_for(FINDING_MAX, &|state| state != State::Boot)
}

/// Uploads with a progress bar on a terminal.
pub(super) fn send(session: &mut Session, node: NodeId, bytes: &[u8]) -> Result<Trajectory, OperatorError> {
    let bar = if std::io::stderr().is_terminal() {
        ProgressBar::new(bytes.len() as u64).with_message("upload")
    } else {
        ProgressBar::hidden()
    };
    let name = session.upload(node, bytes, &mut |done, _| bar.set_position(done as u64));
    bar.finish_and_clear();
    name
}

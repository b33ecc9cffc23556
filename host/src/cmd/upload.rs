//! `cubectl upload`

use std::io::IsTerminal;
use std::path::{Path, PathBuf};

use indicatif::ProgressBar;
use protocol::cyphal::cubecell::command::Trajectory;
use protocol::cyphal::id::NodeId;

use crate::bus::operator::OperatorError;
use crate::bus::{BusArgs, Session};
use crate::error::ExpectedError;

/// Arguments.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:\n  cubectl upload throw.ctrj --bus can0\n\nThe file is the controller's binary form of a plan. It is checked in the controller before it is committed."
)]
pub struct Args {
    /// Trajectory file of a controller.
    pub file: PathBuf,
    /// Bus options; on the bus `sim` a soft controller is in the cell.
    #[command(flatten)]
    pub bus: BusArgs,
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
    let bytes = read(&args.file)?;
    let mut session = args.bus.open_with_controller()?;
    let node = session.find_controller(args.controller)?;
    settle(&mut session)?;
    let name = send(&mut session, node, &bytes)?;
    session.finish()?;
    println!(
        "controller {}: {} bytes stored and committed, hash {:016x}",
        node.get(),
        bytes.len(),
        name.trajectory_crc64
    );
    Ok(())
}

/// The bytes of a file, which must not be empty.
pub(super) fn read(path: &Path) -> Result<Vec<u8>, ExpectedError> {
    let bytes = std::fs::read(path).map_err(|error| ExpectedError::io(path, &error))?;
    if !bytes.starts_with(&firmware::trajectory_format::MAGIC) {
        return Err(ExpectedError::bad_input(&format!(
            "{}: not a trajectory file of a controller (it does not begin with CTRJ)",
            path.display()
        )));
    }
    Ok(bytes)
}

/// Waits until the controller has found its drives.
pub(super) fn settle(session: &mut Session) -> Result<(), OperatorError> {
    use protocol::cyphal::cubecell::group_state::State;
    session.wait_for(protocol::Duration::from_secs(10), &|state| state != State::Boot)
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

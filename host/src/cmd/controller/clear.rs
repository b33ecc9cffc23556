//! `cubectl controller clear`

use protocol::ModuleId;
use protocol::cyphal::cubecell::group_state::State;
use protocol::cyphal::id::NodeId;
use protocol::powercube::SimpleCommand;

use crate::cmd::survey::{require_alone, require_powercubes, survey_with_progress};
use crate::cmd::values::node_id;
use crate::error::ExpectedError;
use crate::exit;
use operator::bus::{BusArgs, Session};
use operator::dialogue::operator::OperatorError;

/// Time that a module gets to obey a reset.
const SETTLE: protocol::Duration = protocol::Duration::from_millis(200);

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl explain 101                # first: what happened, and what to do about it\n  cubectl controller clear --bus can0\n\nNothing moves. The controller forgets its latched fault and looks at every drive again; a fault whose cause is\nstill there comes back and is reported. Without a controller on the bus, modules that are halted or report an error\nare reset. After either, a motion needs its orders again: home, upload, arm, run."
)]
pub struct Args {
    #[command(flatten)]
    pub bus: BusArgs,
    /// Cyphal node-ID of the controller. Default: the one that is heard.
    #[arg(long, value_name = "NODE-ID", value_parser = node_id)]
    pub controller: Option<NodeId>,
}

pub fn run(args: &Args) -> Result<(), ExpectedError> {
    let mut session = args.bus.open()?;
    let text = match session.find_controller(args.controller) {
        Ok(node) => of_controller(&mut session, node)?,
        Err(OperatorError::NoController) if args.controller.is_none() => {
            require_powercubes(&mut session, &args.bus, &args.bus.cell.load()?.robot)?;
            of_modules(&mut session, args.bus.beside)?
        }
        Err(error) => return Err(error.into()),
    };
    session.finish()?;
    console::line!("{text}");
    Ok(())
}

fn of_controller(session: &mut Session, node: NodeId) -> Result<String, ExpectedError> {
    let group = session.group().unwrap_or_default();
    if group.state != State::Fault {
        let next = if group.state == State::Stopped { "; the next motion ends the stop" } else { "" };
        return Ok(format!("controller {}: no fault to clear, it is {:?}{next}", node.get(), group.state));
    }
    session.clear_fault(node, group.fault_cause)?;
    let state = session.group().unwrap_or_default().state;
    Ok(format!(
        "controller {}: fault {} forgotten, all drives read again, now {state:?}",
        node.get(),
        group.fault_cause
    ))
}

fn of_modules(session: &mut Session, beside: bool) -> Result<String, ExpectedError> {
    require_alone(session, beside)?;
    let all: Vec<ModuleId> = ModuleId::all().collect();
    let found = survey_with_progress(session, &all)?;
    if found.is_empty() {
        return Err(crate::cmd::survey::nobody(session.name()));
    }
    let stopped: Vec<ModuleId> =
        found.iter().filter(|report| report.is_stopped()).map(|report| report.module).collect();
    for module in &stopped {
        session.command(*module, SimpleCommand::Reset)?;
    }
    session.sleep_until(session.now() + SETTLE)?;
    let still: Vec<String> = survey_with_progress(session, &stopped)?
        .iter()
        .filter(|report| report.is_stopped())
        .map(|report| format!("module {}: {}", report.module, report.condition()))
        .collect();
    if !still.is_empty() {
        return Err(ExpectedError::new(exit::DRIVE, still.join("; "))
            .next("remove the cause; `cubectl doctor` says more"));
    }
    Ok(format!("no controller is heard; {} modules answer, {} of them reset", found.len(), stopped.len()))
}

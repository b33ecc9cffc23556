//! `cubectl stop`

use std::sync::{Arc, Mutex, PoisonError};

use protocol::cyphal::cubecell::stop::Reason;
use protocol::powercube::CubeState;
use protocol::{Duration, ModuleId};

use super::modules::survey_with_progress;
use super::report::BIT_RATE;
use crate::error::ExpectedError;
use crate::exit;
use operator::bus::{BusArgs, Session};
use operator::live::stopping::JUDGED_AFTER;
use operator::live::{LiveState, LiveTap};
use operator::machine::Machine;

/// How often the halt is said, 5 ms apart: a frame may be lost.
pub(super) const TIMES: usize = 3;

/// Arguments.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:\n  cubectl stop --bus can0\n\nThe halt is sent before anything else; only then is looked who obeyed."
)]
pub struct Args {
    /// Bus options.
    #[command(flatten)]
    pub bus: BusArgs,
}

/// Halts everything on the bus.
pub(super) fn halt(session: &mut Session) -> Result<(), ExpectedError> {
    for _ in 0..TIMES {
        session.halt(Reason::OPERATOR)?;
        session.pass(Duration::from_millis(5))?;
    }
    Ok(())
}

/// Runs the verb.
///
/// # Errors
/// The bus cannot be reached, or a module still moves.
pub fn run(args: &Args) -> Result<(), ExpectedError> {
    let cell = args.bus.cell.load()?;
    let mut session = args.bus.open_cell(&cell, None)?;
    let live = LiveState::new(Machine::of(&cell.robot), session.zero_unix(), BIT_RATE);
    let live = Arc::new(Mutex::new(live));
    session.add_tap(Box::new(LiveTap(Arc::clone(&live))));
    halt(&mut session)?;
    if !args.bus.beside && session.hears_other_host()? {
        // Our questions would destroy its frames: what they ask is followed.
        let view = || live.lock().unwrap_or_else(PoisonError::into_inner).snapshot(0).stop;
        let until = session.now() + JUDGED_AFTER;
        session.run(until, &mut |_| view().is_none_or(|stop| stop.settled))?;
        let obeyed = view();
        let name = session.name().to_owned();
        session.finish()?;
        if let Some(stop) = obeyed.as_ref().filter(|stop| !stop.moving.is_empty()) {
            let text = format!(
                "{name}: halt and stop message were sent; {}\n  next: switch the motor supply off",
                stop.text
            );
            return Err(ExpectedError::new(exit::DRIVE, text));
        }
        let obeyed = obeyed.map_or_else(|| "the stop is over already".to_owned(), |stop| stop.text);
        console::line!(
            "{name}: halt and stop message sent {TIMES} times; a controller or host is on the bus and was not disturbed further\n{obeyed}"
        );
        return Ok(());
    }
    let all: Vec<ModuleId> = ModuleId::all().collect();
    let found = survey_with_progress(&mut session, &all)?;
    let name = session.name().to_owned();
    session.finish()?;
    let moving: Vec<String> = found
        .iter()
        .filter(|report| report.state.is_none_or(|state| state.intersects(CubeState::MOTION)))
        .map(|report| report.module.to_string())
        .collect();
    if !moving.is_empty() {
        return Err(ExpectedError::new(
            exit::DRIVE,
            format!(
                "{name}: the halt was sent, but module {} still moves or does not tell\n  next: switch the motor \
                 supply off",
                moving.join(", ")
            ),
        ));
    }
    let halted = found.iter().filter(|report| report.is_stopped()).count();
    console::line!(
        "{name}: halt sent {TIMES} times; {} modules answer, {halted} of them halted, none moves",
        found.len()
    );
    Ok(())
}

//! `cubectl stop`

use std::sync::{Arc, Mutex, PoisonError};

use protocol::cyphal::cubecell::stop::Reason;
use protocol::powercube::CubeState;
use protocol::{Duration, ModuleId};

use crate::cmd::survey::survey_with_progress;
use crate::error::ExpectedError;
use crate::exit;
use can_link::BusSpec;
use operator::bus::{BusArgs, BusFailure, Session};
use operator::live::stopping::JUDGED_AFTER;
use operator::live::{LiveState, LiveTap};
use operator::machine::Machine;

/// How often the halt is said, 5 ms apart: a frame may be lost.
pub(in crate::cmd) const TIMES: usize = 3;

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:\n  cubectl stop --bus can0\n\nThe halt is sent before anything else; only then it looks which joints stand. A robot file, a scenario or a recording \
that cannot be opened is reported after the halt."
)]
pub struct Args {
    #[command(flatten)]
    pub bus: BusArgs,
}

/// Halts everything on the bus.
pub(in crate::cmd) fn halt(session: &mut Session) -> Result<(), ExpectedError> {
    for _ in 0..TIMES {
        session.halt(Reason::OPERATOR)?;
        session.pass(Duration::from_millis(5))?;
    }
    Ok(())
}

/// Opens the session. On a real bus it opens without robot file and recording if these fail, so that the halt is sent; the failure is
/// returned beside it.
fn open(bus: &BusArgs) -> Result<(Session, Machine, Option<BusFailure>), BusFailure> {
    let whole = |bus: &BusArgs| {
        let cell = bus.cell.load()?;
        Ok((bus.open_cell(&cell, None)?, Machine::of(&cell.robot)))
    };
    match whole(bus) {
        Ok((session, machine)) => Ok((session, machine, None)),
        Err(error) if bus.bus == BusSpec::Sim => Err(error),
        Err(error) => {
            let bare = BusArgs { bus: bus.bus.clone(), beside: bus.beside, ..BusArgs::default() };
            whole(&bare).map(|(session, machine)| (session, machine, Some(error)))
        }
    }
}

/// Runs the verb.
///
/// # Errors
/// The bus cannot be reached, a module still moves, or a file that was named cannot be opened: the halt was sent all the same.
pub fn run(args: &Args) -> Result<(), ExpectedError> {
    let (session, machine, unopened) = open(&args.bus)?;
    stop(session, machine, args.bus.beside)?;
    unopened.map_or(Ok(()), |error| Err(error.into()))
}

fn stop(mut session: Session, machine: Machine, beside: bool) -> Result<(), ExpectedError> {
    let live = LiveState::new(machine, session.zero_unix(), session.bit_rate_bit_s());
    let live = Arc::new(Mutex::new(live));
    session.add_tap(Box::new(LiveTap(Arc::clone(&live))));
    halt(&mut session)?;
    if !beside && session.hears_other_host()? {
        // Our questions would destroy its frames: what they ask is followed.
        let view = || live.lock().unwrap_or_else(PoisonError::into_inner).snapshot(0).stop;
        let until = session.now() + JUDGED_AFTER;
        session.run(until, &mut |_| view().is_none_or(|stop| stop.settled))?;
        let obeyed = view();
        let name = session.name().to_owned();
        session.finish()?;
        if let Some(stop) = obeyed.as_ref().filter(|stop| !stop.moving.is_empty()) {
            let what = format!("{name}: halt and stop message were sent; {}", stop.text);
            return Err(ExpectedError::new(exit::DRIVE, what).next("switch the motor supply off"));
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
                "{name}: the halt was sent, but module {} still moves or does not report its state",
                moving.join(", ")
            ),
        )
        .next("switch the motor supply off"));
    }
    let halted = found.iter().filter(|report| report.is_stopped()).count();
    console::line!(
        "{name}: halt sent {TIMES} times; {} modules answer, {halted} of them halted, none moves",
        found.len()
    );
    Ok(())
}

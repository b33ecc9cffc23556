//! The modules a verb is about: named or found, alone with them or not, told as JSON.

use std::io::IsTerminal;

use indicatif::{ProgressBar, ProgressStyle};
use protocol::ModuleId;

use crate::error::ExpectedError;
use crate::exit;
use operator::bus::{BusArgs, Session};
use operator::dialogue::survey::{ModuleReport, survey};

/// The addresses of an option.
#[derive(Clone, Debug)]
pub struct Modules(pub Vec<ModuleId>);

impl std::str::FromStr for Modules {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        operator::bus::args::parse_modules(text).map(Self)
    }
}

/// Nobody answered.
pub(super) fn nobody(bus: &str) -> ExpectedError {
    ExpectedError::new(
        exit::DRIVE,
        format!(
            "{bus}: no module answers\n  next: check the supply of the modules and the cable, and that the bus runs \
             at their bit rate (1000, 500 or 250 kbit/s); `cubectl doctor` tells silence from errors"
        ),
    )
}

/// Some of the modules that were named are silent.
pub(super) fn missing(bus: &str, modules: &[ModuleId]) -> ExpectedError {
    let list: Vec<String> = modules.iter().map(ToString::to_string).collect();
    ExpectedError::new(
        exit::DRIVE,
        format!(
            "{bus}: module {} does not answer\n  next: check its supply, its plug and its address; `cubectl scan` \
             shows who is there",
            list.join(", ")
        ),
    )
}

/// Refuses to ask modules that somebody else asks.
pub(super) fn require_alone(session: &mut Session, beside: bool) -> Result<(), ExpectedError> {
    if !beside && session.hears_other_host()? {
        return Err(ExpectedError::new(
            exit::BUS,
            format!(
                "{}: another host or a controller speaks to the modules; nothing was sent, because our questions would \
                 destroy its frames\n  next: `cubectl monitor --listen` watches, `cubectl stop` stops; end the other \
                 program, or add --beside",
                session.name()
            ),
        ));
    }
    Ok(())
}

/// A survey of `candidates` with a progress bar on a terminal.
pub(super) fn look(
    session: &mut Session,
    candidates: &[ModuleId],
) -> Result<Vec<ModuleReport>, ExpectedError> {
    let bar = if std::io::stderr().is_terminal() { ProgressBar::new(0) } else { ProgressBar::hidden() };
    if let Ok(style) = ProgressStyle::with_template("{msg} {bar:31} {pos}/{len}") {
        bar.set_style(style);
    }
    let found = survey(session, candidates.iter().copied(), &mut |what, done, all| {
        bar.set_message(what);
        bar.set_length(all as u64);
        bar.set_position(done as u64);
    });
    bar.finish_and_clear();
    Ok(found?)
}

/// The modules a verb is about: those named, all of which must answer, or all that are there.
pub(super) fn modules_on(
    session: &mut Session,
    named: Option<&[ModuleId]>,
    beside: bool,
) -> Result<Vec<ModuleReport>, ExpectedError> {
    require_alone(session, beside)?;
    let all: Vec<ModuleId> = ModuleId::all().collect();
    let found = look(session, named.unwrap_or(&all))?;
    if let Some(named) = named {
        let silent: Vec<ModuleId> =
            named.iter().copied().filter(|id| !found.iter().any(|report| report.module == *id)).collect();
        if !silent.is_empty() {
            return Err(missing(session.name(), &silent));
        }
    }
    if found.is_empty() {
        return Err(nobody(session.name()));
    }
    Ok(found)
}

/// A report of a module as JSON, units in the keys.
pub(super) fn module_json(report: &ModuleReport) -> serde_json::Value {
    serde_json::json!({
        "module": report.module.get(),
        "serial": report.serial,
        "firmware": report.version.to_string(),
        "kind": report.kind(),
        "absolute": report.is_absolute(),
        "homed": report.is_homed(),
        "state": report.state.map(|state| state.to_string()),
        "state_bits": report.state.map(protocol::powercube::CubeState::bits),
        "position_rad": report.position_rad,
        "current_a": report.current_a,
        "motor_v": report.motor_v,
        "logic_v": report.logic_v,
        "temperature_c": report.temperature_c,
        "unanswered": report.unanswered.iter().map(|p| p.name()).collect::<Vec<_>>(),
    })
}

/// Opens the bus and looks for the modules.
pub(super) fn open(
    bus: &BusArgs,
    named: Option<&Modules>,
) -> Result<(Session, Vec<ModuleReport>), ExpectedError> {
    let mut session = bus.open()?;
    let found = modules_on(&mut session, named.map(|modules| modules.0.as_slice()), bus.beside)?;
    Ok((session, found))
}

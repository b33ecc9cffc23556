//! The modules a verb is about: named, found or missing, alone with them or not, as JSON.

use std::io::IsTerminal;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use can_link::BusSpec;
use firmware::fault::Cause;
use indicatif::{ProgressBar, ProgressStyle};
use protocol::cyphal::cubecell::group_state::GroupState;
use protocol::powercube::CubeState;
use protocol::{Duration, Instant, ModuleId};
use robot_model::RobotModel;

use crate::error::ExpectedError;
use crate::exit;
use operator::bus::{BusArgs, Session};
use operator::dialogue::presence::Presence;
use operator::dialogue::survey::{ModuleReport, survey};
use operator::node::host_node::Heard;

/// A controller at rest has read position, state and current of every drive several times by then.
const BESIDE_LISTEN: Duration = Duration::from_millis(1_500);

/// The addresses of an option.
#[derive(Clone, Debug)]
pub struct Modules(pub Vec<ModuleId>);

impl std::str::FromStr for Modules {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        operator::bus::args::parse_modules(text).map(Self)
    }
}

pub(super) fn nobody(bus: &str) -> ExpectedError {
    ExpectedError::new(exit::DRIVE, format!("{bus}: no module answers")).next(
        "check the supply of the modules and the cable, and that the bus runs \
             at their bit rate (1000, 500 or 250 kbit/s); `cubectl doctor` distinguishes silence from errors; motors with MIT frames, CANopen servos and ODrives \
             answer a controller only: `cubectl home --robot FILE`",
    )
}

/// Refuses to ask drives that answer a controller only, unless somebody else speaks on the bus, to whom a verb listens.
pub(super) fn require_powercubes(
    session: &mut Session,
    bus: &BusArgs,
    robot: &RobotModel,
) -> Result<(), ExpectedError> {
    let Some(drives) = robot.drives_of_controller() else { return Ok(()) };
    if !bus.beside && session.hears_other_host()? {
        return Ok(());
    }
    let (name, file) = (robot.name(), bus.cell.robot.as_deref().unwrap_or("FILE"));
    let on = if bus.bus == BusSpec::Sim { String::new() } else { format!(" --bus {}", bus.bus) };
    Err(ExpectedError::new(
        exit::DRIVE,
        format!("the drives of robot {name} are {drives}: they answer a controller only, and nothing was asked"),
    )
    .next(format!(
        "`cubectl home --robot {file}{on}` starts a controller, which finds the drives, compares their settings and names the one \
         that is wrong; `cubectl run` and `cubectl move` report what the drives measured"
    )))
}

/// Some of the modules that were named are silent.
pub(super) fn missing(bus: &str, modules: &[ModuleId]) -> ExpectedError {
    let wanted = Wanted::named(modules);
    ExpectedError::new(exit::DRIVE, format!("{bus}: {} not answer", do_not(modules)))
        .next(wanted.next_for_missing())
}

/// `module 3`, `modules 3, 4`.
fn list(modules: &[ModuleId]) -> String {
    let list: Vec<String> = modules.iter().map(ToString::to_string).collect();
    format!("module{} {}", if modules.len() == 1 { "" } else { "s" }, list.join(", "))
}

/// `module 3 does`, `modules 3, 4 do`.
fn do_not(modules: &[ModuleId]) -> String {
    format!("{} {}", list(modules), if modules.len() == 1 { "does" } else { "do" })
}

/// Modules that must be there.
pub struct Wanted {
    pub(super) modules: Vec<ModuleId>,
    /// Name of the robot that has them, unless they were named.
    robot: Option<String>,
}

impl Wanted {
    pub(super) fn named(modules: &[ModuleId]) -> Self {
        Self { modules: modules.to_vec(), robot: None }
    }

    /// The drives of a robot; none if its file describes none.
    #[must_use]
    pub fn of_robot(robot: &RobotModel) -> Self {
        let drives = robot.drives().into_iter().flatten();
        let modules = drives.filter_map(|drive| ModuleId::new(drive.address).ok()).collect();
        Self { modules, robot: Some(robot.name().to_owned()) }
    }

    /// Those that are not among the modules that were found.
    pub(super) fn missing(&self, found: &[ModuleReport]) -> Vec<ModuleId> {
        let is_there = |module: &ModuleId| found.iter().any(|report| report.module == *module);
        self.modules.iter().copied().filter(|module| !is_there(module)).collect()
    }

    /// What to do about one that is not there.
    pub(super) fn next_for_missing(&self) -> String {
        match &self.robot {
            Some(robot) => format!(
                "robot {robot} has it: check its supply, its plug and its address (two modules may have got the same one); \
                 if other modules are on this bus, name them with --modules or their robot with --robot"
            ),
            None => "check its supply, its plug and its address (two modules may have got the same one); `cubectl status` shows \
                     who is there"
                .to_owned(),
        }
    }
}

/// What is known of the modules on a bus.
pub(super) struct Look {
    /// The bus as a person would name it.
    pub(super) bus: String,
    pub(super) seen: Seen,
    wanted: Wanted,
    /// Nobody said which modules must be there: those of the usual robot are.
    guessed: bool,
}

/// How it is known.
pub(super) enum Seen {
    /// Another node speaks to the modules: nothing was sent.
    Heard(Beside),
    /// They were asked.
    Asked(Vec<ModuleReport>),
}

/// Looks for the modules on a bus, or listens if another node speaks to them. `named` are those that must be there; without names
/// those of the robot. With `shows` a progress bar appears on a terminal.
pub(super) fn look(
    bus: &BusArgs,
    named: Option<&Modules>,
    shows: bool,
    stop: Arc<AtomicBool>,
) -> Result<Look, ExpectedError> {
    let cell = bus.cell.load()?;
    let guessed = named.is_none() && bus.bus != BusSpec::Sim && bus.cell.robot.is_none();
    let named = named.map(|modules| modules.0.as_slice());
    let wanted = named.map_or_else(|| Wanted::of_robot(&cell.robot), Wanted::named);
    let mut session = bus.open_cell_until(&cell, None, stop)?;
    let name = session.name().to_owned();
    require_powercubes(&mut session, bus, &cell.robot)?;
    let seen = match listen_beside(&mut session, named, bus.beside)? {
        Some(beside) => Seen::Heard(beside),
        None => {
            let all: Vec<ModuleId> = ModuleId::all().collect();
            let found = survey_shown(&mut session, named.unwrap_or(&all), shows)?;
            if found.is_empty() {
                return Err(nobody(&name));
            }
            Seen::Asked(found)
        }
    };
    session.finish()?;
    Ok(Look { bus: name, seen, wanted, guessed })
}

impl Look {
    /// Modules that must be there and are not.
    pub(super) fn missing(&self) -> Vec<ModuleId> {
        match &self.seen {
            Seen::Asked(found) => self.wanted.missing(found),
            Seen::Heard(beside) => {
                let is_there = |module: &ModuleId| beside.modules.iter().any(|(there, _)| there == module);
                self.wanted.modules.iter().copied().filter(|module| !is_there(module)).collect()
            }
        }
    }

    /// That modules are missing, with what to do; `None` if none is.
    pub(super) fn reported_missing(&self) -> Option<ExpectedError> {
        let missing = self.missing();
        if missing.is_empty() {
            return None;
        }
        let next = self.wanted.next_for_missing();
        let (what, next) = match &self.seen {
            Seen::Asked(_) => (format!("{}: {} not answer", self.bus, do_not(&missing)), next),
            Seen::Heard(_) => {
                let is = if missing.len() == 1 { "is" } else { "are" };
                let what = format!(
                    "{}: {} {is} not heard, and nothing was asked, because a controller or another host speaks to the modules",
                    self.bus,
                    list(&missing)
                );
                let more =
                    "`cubectl arm monitor`; end the other program, or add --beside to ask all the same";
                (what, format!("{next}; {more}"))
            }
        };
        Some(ExpectedError::new(exit::DRIVE, what).next(next))
    }

    /// Which modules must be there is only a guess: a missing one is no error.
    pub(super) const fn is_guess(&self) -> bool {
        self.guessed
    }

    /// As JSON, units in the keys.
    pub(super) fn json(&self) -> serde_json::Value {
        let mut modules = match &self.seen {
            Seen::Heard(beside) => beside.json(&self.bus),
            Seen::Asked(found) => {
                let modules: Vec<_> = found.iter().map(module_json).collect();
                serde_json::json!({ "bus": self.bus, "modules": modules })
            }
        };
        modules["missing"] = self.missing().iter().map(|module| module.get()).collect();
        modules
    }
}

/// Refuses to ask modules that another node asks.
pub(super) fn require_alone(session: &mut Session, beside: bool) -> Result<(), ExpectedError> {
    if !beside && session.hears_other_host()? && session.claim()?.drives_are_asked {
        return Err(ExpectedError::new(
            exit::BUS,
            format!(
                "{}: another host or a controller speaks to the modules; they were not asked, because our \
                     questions would destroy its frames",
                session.name()
            ),
        )
        .next(
            "`cubectl status` and `cubectl arm monitor` listen, `cubectl stop` stops; end \
                     the other program, or add --beside",
        ));
    }
    Ok(())
}

/// Modules as they are heard beside a controller or another host.
pub(super) struct Beside {
    /// Who else is there.
    pub(super) presence: Presence,
    /// The last state of the group that the controller sent.
    group: Option<GroupState>,
    pub(super) modules: Vec<(ModuleId, Heard)>,
    /// When the listening ended.
    at: Instant,
}

/// Listens instead of asking, if another node speaks to the modules and `beside` does not say to ask all the same; `None`
/// if nobody does. Only the `named` modules are returned.
pub(super) fn listen_beside(
    session: &mut Session,
    named: Option<&[ModuleId]>,
    beside: bool,
) -> Result<Option<Beside>, ExpectedError> {
    if beside || !session.hears_other_host()? {
        return Ok(None);
    }
    let presence = session.listen_for(BESIDE_LISTEN, false)?;
    let (at, group) = (session.now(), session.group());
    let heard = session.host_node().heard();
    let wanted = |module: &ModuleId| named.is_none_or(|named| named.contains(module));
    let modules: Vec<_> =
        heard.iter().filter(|(module, _)| wanted(module)).map(|(m, heard)| (*m, *heard)).collect();
    Ok(Some(Beside { presence, group, modules, at }))
}

impl Beside {
    /// The last state of the group that the controller sent.
    pub(super) const fn group(&self) -> Option<&GroupState> {
        self.group.as_ref()
    }

    /// Who is there, in a line.
    pub(super) fn line(&self) -> String {
        match (self.presence.controller, &self.group) {
            (Some(node), Some(group)) => {
                let fault = Cause::from_code(group.fault_cause).map_or("no fault", Cause::name);
                let host = if group.host_alive { "a host is alive" } else { "no host" };
                format!("controller {}: {}, {fault}, {host}", node.get(), group.state)
            }
            _ => "another host speaks to the modules".to_owned(),
        }
    }

    /// As JSON, units in the keys; what only a request would answer is null.
    pub(super) fn json(&self, bus: &str) -> serde_json::Value {
        let modules: Vec<_> =
            self.modules.iter().map(|(module, heard)| self.module_json(*module, heard)).collect();
        let controller = self.presence.controller.zip(self.group).map(|(node, group)| {
            serde_json::json!({
                "node_id": node.get(),
                "state": group.state.to_string(),
                "fault_cause": group.fault_cause,
                "fault_joint": group.fault_joint,
                "homed_mask": group.homed_mask,
                "host_alive": group.host_alive,
            })
        });
        serde_json::json!({ "bus": bus, "asked": false, "controller": controller, "modules": modules })
    }

    fn module_json(&self, module: ModuleId, heard: &Heard) -> serde_json::Value {
        serde_json::json!({
            "module": module.get(),
            "serial": null,
            "firmware": null,
            "homed": heard.state.map(|state| state.contains(CubeState::HOME_OK)),
            "state": heard.state.map(|state| state.to_string()),
            "state_bits": heard.state.map(CubeState::bits),
            "position_rad": heard.position_rad,
            "current_a": heard.current_a,
            "heard_s_ago": self.at.saturating_since(heard.at).as_secs_f64(),
        })
    }
}

/// A survey of `candidates` with a progress bar on a terminal.
pub(super) fn survey_with_progress(
    session: &mut Session,
    candidates: &[ModuleId],
) -> Result<Vec<ModuleReport>, ExpectedError> {
    survey_shown(session, candidates, true)
}

fn survey_shown(
    session: &mut Session,
    candidates: &[ModuleId],
    shows: bool,
) -> Result<Vec<ModuleReport>, ExpectedError> {
    let bar =
        if shows && std::io::stderr().is_terminal() { ProgressBar::new(0) } else { ProgressBar::hidden() };
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
    let found = survey_with_progress(session, named.unwrap_or(&all))?;
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
        "state_bits": report.state.map(CubeState::bits),
        "position_rad": report.position_rad,
        "current_a": report.current_a,
        "motor_v": report.motor_v,
        "logic_v": report.logic_v,
        "temperature_c": report.temperature_c,
        "unanswered": report.unanswered.iter().map(|p| p.name()).collect::<Vec<_>>(),
    })
}

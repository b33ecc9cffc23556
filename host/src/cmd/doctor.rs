//! `cubectl doctor`

use can_link::Cause;
use protocol::powercube::{Address, Config, CubeState, Parameter, Request};
use protocol::{Duration, Frame, ModuleId};

use super::modules::{look, module_json};
use super::print_json;
use crate::error::ExpectedError;
use crate::exit;
use operator::bus::{BusArgs, Session};
use operator::dialogue::ask::AskError;
use operator::dialogue::survey::ModuleReport;
use operator::node::drive_client::Policy;
use operator::node::inbox::NODE_ID;

/// How long to listen before the first word: another controller or host betrays itself.
const LISTEN: Duration = Duration::from_millis(300);
/// Time in which a second drive of the same address answers.
const SECOND_ANSWER: Duration = Duration::from_millis(15);
/// Rounds of questions that look for a second drive.
const DUPLICATE_ROUNDS: usize = 3;
/// 29-bit frames of the probe.
const PROBE_FRAMES: usize = 5;
/// Motor voltage below which the motors are off, V.
const MOTOR_OFF_V: f64 = 5.0;

/// Arguments.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl doctor --bus can0 --modules 1-6\n  cubectl doctor --bus can0 --probe-29-bit   # motors off!\n\nNothing is set in motion. With findings of the level PROBLEM the exit code is 9."
)]
pub struct Args {
    /// Bus options.
    #[command(flatten)]
    pub bus: BusArgs,
    /// Modules that must be there.
    #[arg(long)]
    pub modules: Option<super::modules::Modules>,
    /// Also find out whether frames with 29-bit ids (the host link) disturb the modules. Switch the motor supply off
    /// first: very old CAN chips answer them with error frames.
    #[arg(long = "probe-29-bit")]
    pub probe: bool,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// How bad.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// As it should be.
    Ok,
    /// Worth knowing.
    Note,
    /// Wrong.
    Problem,
}

impl Level {
    const fn word(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Note => "note",
            Self::Problem => "PROBLEM",
        }
    }
}

/// One thing that was looked at.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// How bad.
    pub level: Level,
    /// Name of the check, stable.
    pub check: &'static str,
    /// What was found.
    pub what: String,
    /// What to do; empty if nothing.
    pub next: String,
}

fn finding(level: Level, check: &'static str, what: impl Into<String>, next: impl Into<String>) -> Finding {
    Finding { level, check, what: what.into(), next: next.into() }
}

/// Runs the verb.
///
/// # Errors
/// The bus cannot be reached, or something is wrong.
pub fn run(args: &Args) -> Result<(), ExpectedError> {
    let mut session = args.bus.open()?;
    let wanted = args.modules.as_ref().map(|modules| modules.0.as_slice());
    let (modules, findings) = examine(&mut session, wanted, args.probe, args.bus.beside)?;
    let name = session.name().to_owned();
    session.finish()?;
    if args.json {
        let rows: Vec<_> = findings
            .iter()
            .map(|f| serde_json::json!({ "level": f.level.word(), "check": f.check, "what": f.what, "next": f.next }))
            .collect();
        let modules: Vec<_> = modules.iter().map(module_json).collect();
        print_json(&serde_json::json!({ "bus": name, "modules": modules, "findings": rows }));
    } else {
        say::line!("{name}");
        for f in &findings {
            say::line!("{:<7}  {}: {}", f.level.word(), f.check, f.what);
            if !f.next.is_empty() {
                say::line!("         next: {}", f.next);
            }
        }
    }
    let problems = findings.iter().filter(|f| f.level == Level::Problem).count();
    if problems == 0 {
        return Ok(());
    }
    let plural = if problems == 1 { "problem" } else { "problems" };
    Err(ExpectedError::new(exit::FINDINGS, format!("{name}: {problems} {plural} found (listed above)")))
}

/// Looks at everything; if somebody else speaks to the modules, only listens unless `beside`.
fn examine(
    session: &mut Session,
    wanted: Option<&[ModuleId]>,
    probe: bool,
    beside: bool,
) -> Result<(Vec<ModuleReport>, Vec<Finding>), ExpectedError> {
    let mut findings = Vec::new();
    session.sleep_until(session.now() + LISTEN)?;
    findings.push(others(session));
    if !beside && session.desk().tally().foreign_requests > 0 {
        // A motion may be running: our questions would destroy its frames.
        findings.extend(errors(session));
        return Ok((Vec::new(), findings));
    }
    let (modules, found) = examine_modules(session, wanted)?;
    findings.extend(found);
    findings.extend(pace(session, &modules)?);
    findings.push(if probe {
        probe_29_bit(session, &modules)?
    } else {
        finding(
            Level::Note,
            "29-bit probe",
            "not done",
            "with the motors off: `cubectl doctor --probe-29-bit`",
        )
    });
    Ok((modules, findings))
}

/// Looks at the modules alone, whoever else is on the bus: which answer, collisions, errors, and what each says of itself.
///
/// # Errors
/// The bus is gone, or Ctrl-C; what is wrong with modules is in the findings.
pub fn examine_modules(
    session: &mut Session,
    wanted: Option<&[ModuleId]>,
) -> Result<(Vec<ModuleReport>, Vec<Finding>), ExpectedError> {
    let all: Vec<ModuleId> = ModuleId::all().collect();
    let modules = look(session, &all)?;
    let mut findings = presence(session, &modules, wanted);
    findings.extend(errors(session));
    findings.push(duplicates(session, &modules)?);
    for report in &modules {
        findings.extend(module_findings(report));
    }
    Ok((modules, findings))
}

fn others(session: &mut Session) -> Finding {
    let tally = session.desk().tally();
    if tally.received == 0 {
        return finding(Level::Ok, "traffic", "nobody else speaks", "");
    }
    let what = format!(
        "{} frames in {LISTEN} from others, {} of them with 29-bit ids, {} requests to modules",
        tally.received, tally.extended, tally.foreign_requests
    );
    if tally.foreign_requests > 0 {
        let next = "another host or a controller speaks to the modules, which were therefore not asked; end it for the \
                    other checks, or add --beside while nothing moves";
        return finding(Level::Problem, "traffic", what, next);
    }
    finding(Level::Note, "traffic", what, "somebody else is on this bus")
}

fn presence(session: &Session, modules: &[ModuleReport], wanted: Option<&[ModuleId]>) -> Vec<Finding> {
    let mut findings = Vec::new();
    if modules.is_empty() {
        let no_ack = session
            .bus_errors()
            .iter()
            .any(|(_, error)| error.causes().any(|cause| cause == Cause::NoAcknowledge));
        let (what, next) = if no_ack {
            (
                "no module answers, and nobody acknowledges our frames",
                "we are alone on the wire: check plug, supply and termination (60 ohm between CAN-H and CAN-L), then \
                 the bit rate",
            )
        } else {
            (
                "no module answers",
                "check the supply of the modules and the bit rate: `ip link set can0 down`, then `ip link set can0 type \
                 can bitrate 500000` (or 250000, 1000000), `ip link set can0 up`",
            )
        };
        findings.push(finding(Level::Problem, "modules", what, next));
    } else {
        let list: Vec<String> = modules.iter().map(|report| report.module.to_string()).collect();
        findings.push(finding(
            Level::Ok,
            "modules",
            format!("{} answer: {}", modules.len(), list.join(", ")),
            "",
        ));
    }
    for module in wanted.unwrap_or_default() {
        if !modules.iter().any(|report| report.module == *module) {
            findings.push(finding(
                Level::Problem,
                "modules",
                format!("module {module} does not answer"),
                "check its supply, its plug and its address; two modules may have got the same address",
            ));
        }
    }
    findings
}

fn errors(session: &Session) -> Vec<Finding> {
    let errors = session.bus_errors();
    if errors.is_empty() {
        return vec![finding(Level::Ok, "bus errors", "none reported", "")];
    }
    let has =
        |wanted: &dyn Fn(&Cause) -> bool| errors.iter().any(|(_, e)| e.causes().any(|cause| wanted(&cause)));
    let (tec, rec) = errors
        .iter()
        .filter_map(|(_, error)| error.counters())
        .fold((0, 0), |(a, b), (tec, rec)| (a.max(tec), b.max(rec)));
    let counters = format!("{} reports, counters up to {tec} (transmit) and {rec} (receive)", errors.len());
    let mut findings = Vec::new();
    if has(&|cause| *cause == Cause::BusOff) {
        findings.push(finding(
            Level::Problem,
            "bus errors",
            format!("bus-off: the adapter left the bus ({counters})"),
            "wrong bit rate, or CAN-H and CAN-L short or swapped; then restart the interface: `ip link set can0 down && \
             ip link set can0 up`",
        ));
    }
    if has(&|cause| *cause == Cause::NoAcknowledge) {
        findings.push(finding(
            Level::Problem,
            "bus errors",
            format!("frames were not acknowledged ({counters})"),
            "nobody else is on the bus at this bit rate: check plug, supply and rate",
        ));
    }
    if has(&|cause| {
        matches!(cause, Cause::Protocol { .. } | Cause::BusError | Cause::ErrorPassive | Cause::ErrorWarning)
    }) {
        findings.push(finding(
            Level::Problem,
            "bus errors",
            format!("frames were destroyed on the wire ({counters})"),
            "check termination and cable; one participant may have another bit rate, or two modules one address",
        ));
    }
    if findings.is_empty() {
        findings.push(finding(Level::Note, "bus errors", counters, ""));
    }
    findings
}

/// Asks each module for its serial number a few times and waits for a second answer.
fn duplicates(session: &mut Session, modules: &[ModuleReport]) -> Result<Finding, AskError> {
    let before = session.desk().drives.policy();
    session.desk().drives.set_policy(Policy { linger: SECOND_ANSWER, tries: 1, ..before });
    let (mut serials, errors_before) = (vec![Vec::new(); modules.len()], session.bus_errors().len());
    for _ in 0..DUPLICATE_ROUNDS {
        let questions: Vec<_> =
            modules.iter().map(|report| (report.module, Request::Get(Parameter::DefSerialNo))).collect();
        for (list, answer) in serials.iter_mut().zip(session.ask_all(&questions)?) {
            if let Ok(protocol::powercube::Reply::Value(_, value)) = answer {
                let serial = value.as_f64().unwrap_or(0.0);
                if !list.contains(&serial) {
                    list.push(serial);
                }
            }
        }
        session.sleep_until(session.now() + SECOND_ANSWER)?;
    }
    session.desk().drives.set_policy(before);
    let twice: Vec<String> = modules
        .iter()
        .zip(&serials)
        .filter(|(report, serials)| {
            serials.len() > 1 || session.desk().drives.extra_answers(report.module) > 0
        })
        .map(|(report, _)| report.module.to_string())
        .collect();
    let collided = session.bus_errors().len() > errors_before;
    Ok(if !twice.is_empty() {
        finding(
            Level::Problem,
            "addresses",
            format!("two modules answer at address {}", twice.join(", ")),
            "unplug one of them and give the other a free address (parameter DefAddress, or the maker's tool)",
        )
    } else if collided {
        finding(
            Level::Problem,
            "addresses",
            "answers to the question for serial numbers collide on the wire",
            "two modules may have the same address: plug them in one at a time and `cubectl scan`",
        )
    } else {
        finding(Level::Ok, "addresses", "every address answers once", "")
    })
}

fn module_findings(report: &ModuleReport) -> Vec<Finding> {
    let id = report.module;
    let mut findings = Vec::new();
    if !Parameter::PosStateDio.info().readable(report.version) {
        findings.push(finding(
            Level::Problem,
            "firmware",
            format!("module {id}: firmware {} does not report position with its state", report.version),
            "the controller needs 2518..2FFF or 3518 and newer; scan, home and jog work",
        ));
    }
    let Some(state) = report.state else {
        findings.push(finding(
            Level::Problem,
            "state",
            format!("module {id} does not tell its state"),
            "scan again",
        ));
        return findings;
    };
    let causes = CubeState::from_bits(state.bits() & CubeState::CAUSES.bits());
    if state.contains(CubeState::ERROR) || causes != CubeState::EMPTY {
        let next = if causes.intersects(CubeState::NEEDS_POWER_CYCLE) {
            "only switching the module off clears it; find the cause first"
        } else {
            "remove the cause; `cubectl home` and `cubectl jog` reset it"
        };
        findings.push(finding(Level::Problem, "state", format!("module {id}: {causes}"), next));
    } else if state.contains(CubeState::HALTED) {
        findings.push(finding(
            Level::Note,
            "state",
            format!("module {id} is halted"),
            "`cubectl home` and `cubectl jog` reset it",
        ));
    }
    if !report.is_homed() {
        let next = if report.is_absolute() { "switch it off and on" } else { "`cubectl home`" };
        findings.push(finding(Level::Note, "homing", format!("module {id} is not homed"), next));
    }
    match report.config {
        Some(config) if !config.contains(Config::WATCHDOG_ENABLE) => findings.push(finding(
            Level::Note,
            "watchdog",
            format!("module {id}: its watchdog is off; it would go on moving if the host died"),
            "the controller switches it on when it starts",
        )),
        Some(config) if config.contains(Config::DISABLE_ACK) => findings.push(finding(
            Level::Problem,
            "configuration",
            format!("module {id} does not acknowledge commands (DISABLE_ACK)"),
            "clear bit 26 of its configuration word",
        )),
        _ => {}
    }
    if !report.unanswered.is_empty() {
        let list: Vec<&str> = report.unanswered.iter().map(|parameter| parameter.name()).collect();
        findings.push(finding(
            Level::Problem,
            "answers",
            format!("module {id} left questions unanswered: {}", list.join(", ")),
            "frames are lost: check cable and termination",
        ));
    }
    if findings.iter().all(|f| f.level != Level::Problem) {
        let serial = report.serial.map_or("?".to_owned(), |serial| serial.to_string());
        findings.push(finding(
            Level::Ok,
            "module",
            format!("module {id}: serial {serial}, firmware {}, {}", report.version, report.condition()),
            "",
        ));
    }
    findings
}

/// Whether a controller in this program would keep its cycle here; nothing in virtual time.
fn pace(session: &mut Session, modules: &[ModuleReport]) -> Result<Vec<Finding>, ExpectedError> {
    const NAME: &str = "control period";
    if modules.is_empty() {
        return Ok(Vec::new());
    }
    let asked: Vec<ModuleId> = modules.iter().map(|report| report.module).collect();
    let Some(pace) = session.measure_pace(&asked)? else { return Ok(Vec::new()) };
    let shortest_ms = 1e3 * pace.shortest().as_secs_f64();
    let what = format!("a controller in this program needs {shortest_ms:.1} ms or more: {pace}");
    let next = "`cubectl throw` chooses a period that holds; a quieter machine or real-time priority makes it shorter";
    let system = if pace.granted.priority.is_some() && pace.granted.memory { Level::Ok } else { Level::Note };
    Ok(vec![
        if shortest_ms <= 3.0 {
            finding(Level::Ok, NAME, what, "")
        } else {
            finding(Level::Note, NAME, what, next)
        },
        finding(system, "real time", pace.granted.to_string(), ""),
    ])
}

/// Sends frames with 29-bit ids of the lowest priority and looks whether the bus and the modules bear it.
fn probe_29_bit(session: &mut Session, modules: &[ModuleReport]) -> Result<Finding, ExpectedError> {
    const NAME: &str = "29-bit probe";
    if modules.iter().any(|report| report.state.is_none_or(|state| state.contains(CubeState::MOTION))) {
        return Ok(finding(
            Level::Problem,
            NAME,
            "not done: a module moves",
            "`cubectl stop`, motors off, then again",
        ));
    }
    if let Some(live) = modules.iter().find(|report| report.motor_v.is_some_and(|v| v > MOTOR_OFF_V)) {
        let v = live.motor_v.unwrap_or(0.0);
        if !session.is_simulated() {
            return Ok(finding(
                Level::Problem,
                NAME,
                format!("not done: module {} has {v:.1} V on its motor", live.module),
                "switch the motor supply off, then again",
            ));
        }
    }
    let errors_before = session.bus_errors().len();
    for _ in 0..PROBE_FRAMES {
        session.desk().send(probe_frame());
        session.sleep_until(session.now() + Duration::from_millis(10))?;
    }
    let questions: Vec<_> =
        modules.iter().map(|report| (report.module, Request::Get(Parameter::CubeState))).collect();
    let silent: Vec<String> = session
        .ask_all(&questions)?
        .iter()
        .zip(modules)
        .filter(|(answer, _)| answer.is_err())
        .map(|(_, report)| report.module.to_string())
        .collect();
    let disturbed = session.bus_errors().len() > errors_before;
    Ok(if disturbed || !silent.is_empty() {
        finding(
            Level::Problem,
            NAME,
            if silent.is_empty() {
                "frames with 29-bit ids cause errors on this bus".to_owned()
            } else {
                format!("after frames with 29-bit ids module {} is silent", silent.join(", "))
            },
            "an old CAN chip is on the bus: put the host link of the controller on a second bus",
        )
    } else {
        finding(Level::Ok, NAME, format!("{PROBE_FRAMES} frames with 29-bit ids did no harm"), "")
    })
}

/// A Cyphal heartbeat of the lowest priority: the most harmless frame of the host link.
fn probe_frame() -> Frame {
    use protocol::cyphal::id::{Priority, Route, SubjectId, Tail, TransferId};
    let route = Route::Message { source: NODE_ID, subject: SubjectId::from_low_bits(7509) };
    let tail = Tail { start: true, end: true, toggle: true, transfer_id: TransferId::ZERO };
    let frame = Frame::from_array(route.can_id(Priority::Optional), [0, 0, 0, 0, 0, 0, 0, tail.byte()]);
    debug_assert!(Address::of(frame.id()).is_none());
    frame
}

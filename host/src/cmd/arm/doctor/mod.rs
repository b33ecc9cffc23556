//! `cubectl doctor`

mod beside;
mod damiao;
mod kind;
mod losses;

use can_link::Cause;
use protocol::powercube::{Address, Config, CubeState, Parameter, Request};
use protocol::{Duration, Frame, ModuleId};

use crate::advice::Place;
use crate::cmd::finding::{Finding, Level, finding, grouped, of_modules};
use crate::cmd::print_json;
use crate::cmd::survey::{Wanted, listen_beside, module_json, require_powercubes, survey_with_progress};
use crate::error::ExpectedError;
use crate::exit;
use operator::bus::period::PERIOD_MAX_US;
use operator::bus::{BusArgs, Session};
use operator::dialogue::ask::AskError;
use operator::dialogue::survey::ModuleReport;
use operator::node::drive_client::Policy;

/// How long to listen before the first word: another controller or host betrays itself.
const LISTEN: Duration = Duration::from_millis(300);
/// Time in which a second drive of the same address answers.
const SECOND_ANSWER: Duration = Duration::from_millis(15);
/// Rounds of questions that look for a second drive.
const DUPLICATE_ROUNDS: usize = 3;
/// Further surveys of a module of the robot that is not found: one that loses frames answers one of them, and its losses are
/// counted then; one that is silent answers none.
const PATIENT_SURVEYS: usize = 5;
/// 29-bit frames of the probe.
const PROBE_FRAMES: usize = 5;
/// Control period of the settings.
const PERIOD_USUAL: Duration = Duration::from_millis(3);
/// Motor voltage below which the motors are off, V.
const MOTOR_OFF_V: f64 = 5.0;

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl doctor --bus can0\n  cubectl doctor --bus can0 --modules 1-2    # only these are plugged in\n  cubectl doctor --robot robots/openarm7.toml --bus can0    # motors: classical CAN or CAN FD?\n  cubectl doctor --robot kr16_2 --bus rsi:udp://0.0.0.0:49152\n  cubectl doctor --bus can0 --probe-29-bit   # motors off!\n\nNothing is set in motion. Beside a controller nothing is asked: its fault is reported, and the modules as they are heard.\nWith findings of the level PROBLEM the exit code is 9. `cubectl explain WORD` says what a word of a state means."
)]
pub struct Args {
    #[command(flatten)]
    pub bus: BusArgs,
    /// Modules that must be there. Default: those of the robot.
    #[arg(long)]
    pub modules: Option<crate::cmd::survey::Modules>,
    /// Also find out whether frames with 29-bit ids (the host link) disturb the modules. Switch the motor supply off
    /// first: very old CAN chips answer them with error frames.
    #[arg(long = "probe-29-bit")]
    pub probe: bool,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

pub fn run(args: &Args) -> Result<(), ExpectedError> {
    if let Some((spec, described, arm)) = crate::cmd::rsi::robot_on(&args.bus)? {
        return crate::cmd::rsi::doctor(&spec, &described, &arm, args.json);
    }
    let cell = args.bus.cell.load()?;
    let names_modules = args.modules.is_some() || args.probe || args.bus.beside;
    if cell.robot.mit_motors().is_some() && names_modules {
        let what = "--modules, --probe-29-bit and --beside are about PowerCubes, and this robot has motors with MIT frames";
        return Err(ExpectedError::new(exit::USAGE, what).next("leave them out"));
    }
    let wanted = match &args.modules {
        Some(modules) => Wanted::named(&modules.0),
        None => Wanted::of_robot(&cell.robot),
    };
    let mut session = args.bus.open_cell(&cell, None)?;
    let (modules, mut findings) = match cell.robot.mit_motors() {
        Some(motors) => (Vec::new(), damiao::find(&mut session, motors)?),
        None => {
            require_powercubes(&mut session, &args.bus, &cell.robot)?;
            look(&mut session, &wanted, args.probe, args.bus.beside)?
        }
    };
    let place = Place::of_bus(&args.bus);
    for found in &mut findings {
        found.next = place.complete(&found.next);
    }
    let name = session.name().to_owned();
    session.finish()?;
    if args.json {
        let rows: Vec<_> = findings.iter().map(Finding::to_json).collect();
        let modules: Vec<_> = modules.iter().map(module_json).collect();
        print_json(&serde_json::json!({ "bus": name, "modules": modules, "findings": rows }));
    } else {
        console::line!("{name}");
        for f in &findings {
            console::line!("{:<7}  {}: {}", f.level.word(), f.check, f.text());
            if !f.next.is_empty() {
                console::line!("         next: {}", f.next);
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

/// Looks at everything; if another node speaks to the modules, only listens unless `beside`.
fn look(
    session: &mut Session,
    wanted: &Wanted,
    probe: bool,
    beside: bool,
) -> Result<(Vec<ModuleReport>, Vec<Finding>), ExpectedError> {
    let mut findings = Vec::new();
    session.sleep_until(session.now() + LISTEN)?;
    let shared = session.host_node().tally().foreign_requests > 0;
    findings.push(others(session, beside));
    if let Some(heard) = listen_beside(session, None, beside)? {
        findings.extend(beside::find(session, &heard, wanted));
        return Ok((Vec::new(), findings));
    }
    let (modules, found) = examine(session, wanted, shared)?;
    findings.extend(found);
    findings.extend(if shared { Vec::new() } else { timing(session, &modules)? });
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

/// Looks at the modules alone, whoever else is on the bus: which answer and how surely, collisions, errors, and what each
/// says of itself. Equal findings of several modules are one.
///
/// # Errors
/// The bus is gone, or Ctrl-C; what is wrong with modules is in the findings.
pub fn examine_modules(
    session: &mut Session,
    wanted: &Wanted,
) -> Result<(Vec<ModuleReport>, Vec<Finding>), ExpectedError> {
    examine(session, wanted, false)
}

/// As [`examine_modules`]. On a `shared` bus our questions and those of the other host destroy each other.
fn examine(
    session: &mut Session,
    wanted: &Wanted,
    shared: bool,
) -> Result<(Vec<ModuleReport>, Vec<Finding>), ExpectedError> {
    let all: Vec<ModuleId> = ModuleId::all().collect();
    let mut modules = survey_with_progress(session, &all)?;
    for _ in 0..PATIENT_SURVEYS {
        let missing = wanted.missing(&modules);
        if missing.is_empty() {
            break;
        }
        modules.extend(survey_with_progress(session, &missing)?);
    }
    modules.sort_by_key(|report| report.module);
    let mut findings = presence(session, &modules, wanted);
    findings.push(duplicates(session, &modules, shared)?);
    findings.extend(losses::find(session, &modules)?);
    findings.extend(errors(session, shared));
    for report in &modules {
        findings.extend(module_findings(report));
    }
    Ok((modules, grouped(findings)))
}

fn others(session: &mut Session, beside: bool) -> Finding {
    let tally = session.host_node().tally();
    if tally.received == 0 {
        return finding(Level::Ok, "traffic", "nobody else speaks", "");
    }
    let what = format!(
        "{} frames in {:.1} s from others, {} of them with 29-bit ids, {} requests to modules",
        tally.received,
        LISTEN.as_secs_f64(),
        tally.extended,
        tally.foreign_requests
    );
    if tally.foreign_requests > 0 {
        let next = if beside {
            "questions of ours and of the other host destroy each other: end it to look for losses, collisions and addresses"
        } else {
            "a controller or another host speaks to the modules, so nothing was asked, and this is what was heard; end it for \
             the other checks, or add --beside while nothing moves"
        };
        return finding(Level::Note, "traffic", what, next);
    }
    finding(Level::Note, "traffic", what, "somebody else is on this bus")
}

fn presence(session: &Session, modules: &[ModuleReport], wanted: &Wanted) -> Vec<Finding> {
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
                 the bit rate"
                    .to_owned(),
            )
        } else {
            ("no module answers", kind::no_answer(session))
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
    // That nobody answers has been said.
    if !modules.is_empty() {
        let next = wanted.next_for_missing();
        let silent = wanted.missing(modules).into_iter();
        findings.extend(
            silent.map(|module| of_modules(Level::Problem, "modules", &[module], "no answer", next.as_str())),
        );
    }
    findings
}

fn errors(session: &Session, shared: bool) -> Vec<Finding> {
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
    if shared {
        let next = "questions of two hosts destroy each other, up to bus-off: end the other one, then again";
        return vec![finding(Level::Note, "bus errors", counters, next)];
    }
    let mut findings = Vec::new();
    if has(&|cause| *cause == Cause::BusOff) {
        findings.push(finding(
            Level::Problem,
            "bus errors",
            format!("bus-off: the adapter left the bus ({counters})"),
            kind::after_bus_off(session),
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
fn duplicates(session: &mut Session, modules: &[ModuleReport], shared: bool) -> Result<Finding, AskError> {
    if shared {
        return Ok(finding(Level::Note, "addresses", "not looked at", "end the other host, then again"));
    }
    let before = session.host_node().drives.policy();
    session.host_node().drives.set_policy(Policy { linger: SECOND_ANSWER, tries: 1, ..before });
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
    session.host_node().drives.set_policy(before);
    let twice: Vec<String> = modules
        .iter()
        .zip(&serials)
        .filter(|(report, serials)| {
            serials.len() > 1 || session.host_node().drives.extra_answers(report.module) > 0
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
            "two modules may have the same address: plug them in one at a time and `cubectl status`",
        )
    } else {
        finding(Level::Ok, "addresses", "every address answers once", "")
    })
}

fn module_findings(report: &ModuleReport) -> Vec<Finding> {
    let of = |level, check, what: String, next: &str| of_modules(level, check, &[report.module], what, next);
    let mut findings = Vec::new();
    if !Parameter::PosStateDio.info().readable(report.version) {
        findings.push(of(
            Level::Problem,
            "firmware",
            format!("firmware {} does not report position with its state", report.version),
            "the controller needs 2518..2FFF or 3518 and newer; status, home and jog work",
        ));
    }
    let Some(state) = report.state else {
        findings.push(of(Level::Problem, "state", "does not report its state".to_owned(), "scan again"));
        return findings;
    };
    findings.extend(state_finding(report.module, state));
    if !report.is_homed() {
        let next = if report.is_absolute() { "switch it off and on" } else { "`cubectl home`" };
        findings.push(of(Level::Note, "homing", "not homed".to_owned(), next));
    }
    match report.config {
        Some(config) if !config.contains(Config::WATCHDOG_ENABLE) => findings.push(of(
            Level::Note,
            "watchdog",
            "watchdog off: a motion would go on if the host died".to_owned(),
            "the controller switches it on when it starts",
        )),
        Some(config) if config.contains(Config::DISABLE_ACK) => findings.push(of(
            Level::Problem,
            "configuration",
            "does not acknowledge commands (DISABLE_ACK)".to_owned(),
            "clear bit 26 of its configuration word",
        )),
        _ => {}
    }
    if !report.unanswered.is_empty() {
        let list: Vec<&str> = report.unanswered.iter().map(|parameter| parameter.name()).collect();
        findings.push(of(
            Level::Problem,
            "answers",
            format!("left questions unanswered: {}", list.join(", ")),
            "frames are lost: check cable and termination",
        ));
    }
    if findings.iter().all(|f| f.level != Level::Problem) {
        let serial = report.serial.map_or("?".to_owned(), |serial| serial.to_string());
        findings.push(of(
            Level::Ok,
            "module",
            format!("serial {serial}, firmware {}, {}", report.version, report.condition()),
            "",
        ));
    }
    findings
}

/// An error or a halt.
fn state_finding(module: ModuleId, state: CubeState) -> Option<Finding> {
    let causes = CubeState::from_bits(state.bits() & CubeState::CAUSES.bits());
    if state.contains(CubeState::ERROR) || causes != CubeState::EMPTY {
        let next = if causes.intersects(CubeState::NEEDS_POWER_CYCLE) {
            format!("`cubectl explain '{causes}'`; only switching the module off and on clears it")
        } else {
            format!("`cubectl explain '{causes}'`; remove the cause, then `cubectl controller clear`")
        };
        return Some(of_modules(Level::Problem, "state", &[module], causes.to_string(), next));
    }
    let next = "`cubectl controller clear`; `cubectl home` and `cubectl jog` reset it too";
    state.contains(CubeState::HALTED).then(|| of_modules(Level::Note, "state", &[module], "halted", next))
}

/// Whether a controller in this program would keep its cycle here; nothing in virtual time.
fn timing(session: &mut Session, modules: &[ModuleReport]) -> Result<Vec<Finding>, ExpectedError> {
    const NAME: &str = "control period";
    if modules.is_empty() {
        return Ok(Vec::new());
    }
    let asked: Vec<ModuleId> = modules.iter().map(|report| report.module).collect();
    let Some(timing) = session.measure_cycle_timing(&asked)? else { return Ok(Vec::new()) };
    let shortest = timing.shortest();
    let needs = format!(
        "a controller in this program needs {:.1} ms or more: {timing}",
        1e3 * shortest.as_secs_f64()
    );
    let longest_ms = PERIOD_MAX_US / 1_000;
    let period = if timing.lost > 0 {
        finding(
            Level::Problem,
            NAME,
            format!("none holds while answers are lost: {timing}"),
            "find out why answers are lost; then ask again",
        )
    } else if shortest > Duration::from_micros(PERIOD_MAX_US.into()) {
        finding(
            Level::Note,
            NAME,
            format!("no controller in this program holds one here, the longest is {longest_ms} ms: {timing}"),
            "end what else runs on this machine, or let a controller of its own close the loop (`cubectl throw --controller \
             NODE-ID`)",
        )
    } else if shortest > PERIOD_USUAL {
        let next = "`cubectl throw` chooses a period that holds; a quieter machine or real-time priority makes it shorter";
        finding(Level::Note, NAME, needs, next)
    } else {
        finding(Level::Ok, NAME, needs, "")
    };
    let system =
        if timing.granted.priority.is_some() && timing.granted.memory { Level::Ok } else { Level::Note };
    Ok(vec![period, finding(system, "real time", timing.granted.to_string(), "")])
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
        session.host_node().send(probe_frame());
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
    use protocol::cyphal::id::{NodeId, Priority, Route, SubjectId, Tail, TransferId};
    // Not the node-ID of a host: a controller would take it for that one started again.
    let source = NodeId::from_low_bits(127);
    let route = Route::Message { source, subject: SubjectId::from_low_bits(7509) };
    let tail = Tail { start: true, end: true, toggle: true, transfer_id: TransferId::ZERO };
    let frame = Frame::from_array(route.can_id(Priority::Optional), [0, 0, 0, 0, 0, 0, 0, tail.byte()]);
    assert!(Address::of(frame.id()).is_none());
    frame
}

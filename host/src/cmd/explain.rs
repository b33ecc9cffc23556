//! `cubectl explain`

use std::path::{Path, PathBuf};

use firmware::fault::{Cause, Reaction};
use protocol::cyphal::cubecell::history::TraceEntry;
use protocol::cyphal::id::NodeId;
use protocol::powercube::state::BitInfo;
use protocol::powercube::{Config, CubeState, Setup, ShortState};

use super::rsi;
use super::values::node_id;
use crate::error::ExpectedError;
use crate::exit;
use operator::bus::BusArgs;
use operator::dialogue::history::{Frozen, describe, events, table};

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl explain 502\n  cubectl explain DriveTowError\n  cubectl explain COMM_ERROR            # a word of a module's state\n  cubectl explain not homed\n  cubectl explain exit 7\n  cubectl explain faults                # what a scenario of the simulated cell can do\n  cubectl explain all\n  cubectl explain --last --bus can0    # freeze frame and last events of the controller\n  cubectl explain --last kr16          # the same of a throw over RSI, from its folder"
)]
pub struct Args {
    /// Number or name of a fault, a word of the state of a module (`COMM_ERROR`, `TOW_ERROR|HALTED`, `not homed`), `exit`
    /// (with or without a code), `faults` (what a scenario of the simulated cell can do), or `all`.
    #[arg(required_unless_present = "last", num_args = 1..=4, value_name = "CODE")]
    pub code: Vec<String>,
    /// What happened last: the latched fault of the controller with every joint at that moment, and the last events. With the
    /// folder of a throw or recording over RSI: of the controller that ran in this program then.
    #[arg(long, conflicts_with = "code", num_args = 0..=1, value_name = "FOLDER")]
    pub last: Option<Option<PathBuf>>,
    #[command(flatten)]
    pub bus: BusArgs,
    /// Cyphal node-ID of the controller. Default: the one that is heard.
    #[arg(long, value_name = "NODE-ID", value_parser = node_id)]
    pub controller: Option<NodeId>,
}

/// Runs the verb.
///
/// # Errors
/// No such number or name; with `--last` the bus, or no controller.
pub fn run(args: &Args) -> Result<(), ExpectedError> {
    match &args.last {
        Some(Some(folder)) => {
            console::text!("{}", last_of_recording(folder)?);
            return Ok(());
        }
        Some(None) => {
            console::text!("{}", last(args)?);
            return Ok(());
        }
        None => {}
    }
    let words: Vec<&str> = args.code.iter().map(String::as_str).collect();
    console::text!("{}", explain(&words)?);
    Ok(())
}

fn last(args: &Args) -> Result<String, ExpectedError> {
    let mut session = args.bus.open_with_controller()?;
    let node = session.find_controller(args.controller)?;
    let frozen = session.freeze_frame(node)?;
    let trace = session.trace(node)?;
    session.finish()?;
    Ok(history(frozen.as_ref(), &trace, &format!("controller {}", node.get())))
}

/// Of the controller of a throw or recording over RSI, which is gone, from its folder.
fn last_of_recording(folder: &Path) -> Result<String, ExpectedError> {
    if !rsi::is_recording(folder) {
        return Err(ExpectedError::bad_input(&format!(
            "{} is no folder of a throw or recording over RSI",
            folder.display()
        ))
        .next("name one (it has log.rsi), or leave it out and name the bus of a controller with --bus"));
    }
    let [freeze, trace] = rsi::history(folder)?;
    Ok(history(
        Frozen::read(&freeze).as_ref(),
        &events(&trace).unwrap_or_default(),
        &folder.display().to_string(),
    ))
}

fn history(frozen: Option<&Frozen>, trace: &[TraceEntry], whose: &str) -> String {
    let mut text = match frozen {
        Some(frozen) => {
            let code = frozen.head.fault_cause.to_string();
            table(frozen) + &explain(&[&code]).unwrap_or_default()
        }
        None => format!("{whose}: no fault is latched\n"),
    };
    if trace.is_empty() {
        return text + "last events: none\n";
    }
    text += "last events, s after the start of the controller:\n";
    for entry in trace {
        text += &format!("{:>14.6}  {}\n", entry.at_us as f64 * 1e-6, describe(entry));
    }
    text
}

pub fn explain(words: &[&str]) -> Result<String, ExpectedError> {
    match words {
        ["exit"] => Ok(exit::TABLE.iter().map(exit_line).collect()),
        ["exit", code] => {
            let row = code.parse::<u8>().ok().and_then(|code| exit::TABLE.iter().find(|row| row.0 == code));
            row.map(exit_line).ok_or_else(|| unknown(&format!("exit {code}")))
        }
        ["faults"] => Ok(hil_sim::scenario::faults::HELP.to_owned()),
        ["all"] => Ok(Cause::TABLE
            .iter()
            .map(|info| format!("{}  {}: {}\n", info.code, info.name, info.what))
            .collect()),
        [code] => {
            let by_number = code.parse::<u16>().ok();
            let info = Cause::TABLE
                .iter()
                .find(|info| by_number == Some(info.code) || info.name.eq_ignore_ascii_case(code));
            let Some(info) = info else { return word(code).ok_or_else(|| unknown(code)) };
            let reaction = match info.reaction {
                Reaction::Refuse => "nothing moves because of it; the order or file was refused",
                Reaction::PathStop => "the group ramps down along its path, then all drives are halted",
                Reaction::QuickStop => "every joint brakes as hard as allowed, then all drives are halted",
                Reaction::Halt => "all drives are halted at once",
            };
            Ok(format!(
                "fault {} {}\n  what:     {}\n  reaction: {reaction}\n  next:     {}\n",
                info.code, info.name, info.what, info.recovery
            ))
        }
        _ => word(&words.join(" ")).ok_or_else(|| unknown(&words.join(" "))),
    }
}

/// What `status` and `doctor` say of a module in plain words, with the bit that says so.
const PLAIN: &[(&str, CubeState, &str)] = &[
    ("homed", CubeState::HOME_OK, "nothing; it knows its zero"),
    (
        "not homed",
        CubeState::HOME_OK,
        "`cubectl home`; a module with an absolute encoder: switch it off and on",
    ),
    (
        "halted",
        CubeState::HALTED,
        "`cubectl controller clear`; `cubectl home` and `cubectl jog` reset it too",
    ),
    ("moving", CubeState::MOTION, "wait until it stands, or `cubectl stop`"),
];

/// What `status`, `arm monitor` and `doctor` say of a controller and of modules that report nothing: word, meaning, next step.
const TOLD: &[(&str, &str, &str)] = &[
    (
        "boot",
        "the controller looks for its drives and tries their watchdogs",
        "wait; if it lasts, `cubectl doctor` names the drives that do not answer",
    ),
    ("idle", "the controller has found its drives; not all joints are homed", "`cubectl home`"),
    ("homing", "a joint looks for its zero", "wait, or `cubectl stop`"),
    ("ready", "all joints are homed and at rest, nothing is armed", "none needed"),
    ("armed", "a run may begin until the arming expires", "keep clear of the arm; `cubectl stop` disarms"),
    ("running", "the joints track a trajectory", "keep clear of the arm; `cubectl stop` stops it"),
    ("stopping", "the joints come to rest after a stop or a fault", "wait"),
    ("stopped", "at rest after a stop; the next run needs a new arming", "none needed"),
    (
        "fault",
        "at rest because of a latched fault",
        "`cubectl explain --last`; remove the cause, then `cubectl controller clear`",
    ),
    ("jogging", "a joint moves while its key is held", "none needed; it stops 0.2 s after the last order"),
    ("no fault", "the controller has latched no fault", "none needed"),
    ("no host", "the controller hears no heartbeat of a host; at rest it needs none", "none needed"),
    ("a host is alive", "the controller hears the heartbeat of a host", "none needed"),
    (
        "no answer",
        "the module has answered no question",
        "check its supply, its plug and its address; `cubectl status` shows who answers",
    ),
    (
        "state unknown",
        "the module is there, and has not reported its state",
        "ask again; `cubectl doctor` counts lost answers",
    ),
];

/// What to do about each cause of an error of a module.
const CAUSES: &[(CubeState, &str)] = &[
    (CubeState::POWERFAULT, "the bits beside it (POW_...) say why; do what they say"),
    (CubeState::TOW_ERROR, "free the joint, lessen load or acceleration"),
    (
        CubeState::COMM_ERROR,
        "nobody spoke to the module in time: see that host or controller run, and look at cable and bus load",
    ),
    (CubeState::POW_VOLT_ERR, "check the motor supply and the contactor"),
    (CubeState::POW_FET_TEMP, "let it cool, lessen the load"),
    (CubeState::POW_WDG_TEMP, "let it cool, lessen the load"),
    (CubeState::POW_SHORTCUR, "check the motor cable; if it comes again the module needs repair"),
    (CubeState::POW_HALLERR, "check the motor cable; if it comes again the module needs repair"),
    (CubeState::POW_INTEGRALERR, "let it cool, lessen load or acceleration"),
    (CubeState::CPU_OVERLOAD, "lessen the traffic to the module; if it comes again the module needs repair"),
    (CubeState::BEYOND_HARD, "drive the joint back from the limit by the maker's procedure"),
    (CubeState::BEYOND_SOFT, "`cubectl jog` the joint back inside its limits"),
    (CubeState::SETUP_OR_LOGIC_VOLT, "check the logic supply and the settings (`cubectl modules diff`)"),
];

/// A word of a module's state, or several with `|` between them; `None` if one is unknown.
fn word(text: &str) -> Option<String> {
    if let Some((name, bit, next)) = PLAIN.iter().find(|row| row.0.eq_ignore_ascii_case(text)) {
        let info = CubeState::BITS.iter().find(|info| bit.bits() == 1 << info.bit)?;
        let set = if name.starts_with("not ") { "not set" } else { "set" };
        return Some(format!(
            "{name}: bit {} ({}) of the module's state is {set}\n  what:     {}\n  next:     {next}\n",
            info.bit, info.name, info.meaning
        ));
    }
    if let Some((name, what, next)) = TOLD.iter().find(|row| row.0.eq_ignore_ascii_case(text)) {
        return Some(format!("{name}:\n  what:     {what}\n  next:     {next}\n"));
    }
    let words: Option<Vec<String>> = text.split('|').map(|word| bit(word.trim())).collect();
    words.map(|words| words.concat())
}

fn bit(name: &str) -> Option<String> {
    let tables: [(&str, &[BitInfo]); 4] = [
        ("state of a module", CubeState::BITS),
        ("short state of a module", ShortState::BITS),
        ("configuration of a module", Config::BITS),
        ("set-up of a module", Setup::BITS),
    ];
    let lines: Vec<String> = tables
        .iter()
        .filter_map(|(word, bits)| {
            let info = bits.iter().find(|info| info.name.eq_ignore_ascii_case(name))?;
            let mut text = format!("{}: {word}, bit {}\n  what:     {}\n", info.name, info.bit, info.meaning);
            if *word == "state of a module" {
                text += &next_of(CubeState::from_bits(1 << info.bit));
            }
            Some(text)
        })
        .collect();
    // The short state repeats bits of the state.
    let shown = if lines.len() > 1 && lines[0].contains("state of a module") { 1 } else { lines.len() };
    (!lines.is_empty()).then(|| lines[..shown].concat())
}

fn next_of(bit: CubeState) -> String {
    let cause = CAUSES.iter().find(|row| row.0 == bit).map(|row| row.1);
    let next = match cause {
        Some(cause) if CubeState::NEEDS_POWER_CYCLE.contains(bit) => {
            format!("{cause}; then switch the module off and on, nothing else clears it")
        }
        Some(cause) => format!("{cause}; then `cubectl controller clear`"),
        None if bit == CubeState::ERROR => "the other words of the state name the cause".to_owned(),
        None if bit == CubeState::HALTED => {
            "`cubectl controller clear`; `cubectl home` and `cubectl jog` reset it too".to_owned()
        }
        None => "none needed".to_owned(),
    };
    format!("  next:     {next}\n")
}

fn exit_line(row: &(u8, &str, &str)) -> String {
    format!("exit {:>2}  {}; next: {}\n", row.0, row.1, row.2)
}

fn unknown(code: &str) -> ExpectedError {
    ExpectedError::bad_input(&format!("no fault, exit code or word of a state is '{code}'"))
        .next("`cubectl explain all` lists the faults, `cubectl explain exit` the exit codes")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_fault_is_explained_by_number_and_by_name() {
        for info in Cause::TABLE {
            let text = explain(&[&info.code.to_string()]).unwrap();
            assert!(text.contains(info.what) && text.contains(info.recovery));
            assert_eq!(explain(&[info.name]).unwrap(), text);
        }
    }

    #[test]
    fn every_word_of_the_state_of_a_module_is_explained_alone_and_joined() {
        for info in CubeState::BITS {
            let text = explain(&[info.name]).unwrap();
            assert!(text.contains(info.meaning) && text.contains("next: "), "{text}");
            assert_eq!(explain(&[&info.name.to_lowercase()]).unwrap(), text);
        }
        for info in ShortState::BITS.iter().chain(Config::BITS).chain(Setup::BITS) {
            assert!(explain(&[info.name]).is_ok(), "{}", info.name);
        }
        let causes: Vec<_> =
            CubeState::BITS.iter().filter(|i| CubeState::CAUSES.bits() >> i.bit & 1 != 0).collect();
        assert_eq!(causes.len(), CAUSES.len());
        for info in causes {
            let text = explain(&[info.name]).unwrap();
            let clears = text.contains("`cubectl controller clear`");
            let off_and_on = CubeState::NEEDS_POWER_CYCLE.bits() >> info.bit & 1 != 0;
            assert_eq!(clears, !off_and_on, "{text}");
        }
        let joined = explain(&["TOW_ERROR|COMM_ERROR"]).unwrap();
        assert_eq!(joined, explain(&["TOW_ERROR"]).unwrap() + &explain(&["COMM_ERROR"]).unwrap());
    }

    #[test]
    fn every_state_of_a_controller_is_explained_with_a_next_step() {
        for state in protocol::cyphal::cubecell::group_state::State::ALL {
            let text = explain(&[&state.to_string()]).unwrap();
            assert!(text.contains("what: ") && text.contains("next: "), "{text}");
        }
        for words in [&["no", "answer"][..], &["no", "fault"], &["no", "host"], &["a", "host", "is", "alive"]]
        {
            assert!(explain(words).unwrap().contains("next: "), "{words:?}");
        }
    }

    /// The condition that `status` and `doctor` print, for each bit of the state set alone and none set, and for a
    /// module that has not reported its state.
    #[test]
    fn every_word_that_status_prints_is_explained() {
        let bits = CubeState::BITS.iter().map(|info| 1 << info.bit).chain([0]);
        let states = bits.map(|bit| Some(CubeState::from_bits(bit | CubeState::ERROR.bits())));
        for state in states.chain([None]) {
            let report = operator::dialogue::survey::ModuleReport {
                module: protocol::ModuleId::new(1).unwrap(),
                version: protocol::powercube::FirmwareVersion(0x3519),
                serial: None,
                config: None,
                setup: None,
                state,
                position_rad: None,
                current_a: None,
                motor_v: None,
                logic_v: None,
                temperature_c: None,
                unanswered: Vec::new(),
            };
            for part in report.condition().split(", ") {
                // `error TOW_ERROR`, or `error -` where the module names no cause.
                let words = part.strip_prefix("error ").unwrap_or(part);
                if words != "-" {
                    let words: Vec<&str> = words.split(' ').collect();
                    assert!(explain(&words).is_ok(), "{part}");
                }
            }
        }
    }

    #[test]
    fn unknown_codes_name_the_next_step() {
        for words in [&["9999"][..], &["exit", "99"], &["a", "b"]] {
            let error = explain(words).unwrap_err();
            assert_eq!(error.code, exit::BAD_INPUT);
            assert!(!error.next.is_empty(), "{error}");
        }
    }
}

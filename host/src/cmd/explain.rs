//! `cubectl explain`

use firmware::fault::{Cause, Reaction};
use protocol::cyphal::id::NodeId;

use super::upload::node_id;
use crate::error::ExpectedError;
use crate::exit;
use operator::bus::BusArgs;
use operator::dialogue::history::{describe, table};

/// Arguments.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl explain 502\n  cubectl explain DriveTowError\n  cubectl explain exit 7\n  cubectl explain all\n  cubectl explain --last --bus can0    # freeze frame and last events of the controller"
)]
pub struct Args {
    /// Number or name of a fault, `exit` (with or without a code), or `all`.
    #[arg(required_unless_present = "last", num_args = 1..=2, value_name = "CODE")]
    pub code: Vec<String>,
    /// What happened last: the latched fault of the controller with every joint at that moment, and the last events.
    #[arg(long, conflicts_with = "code")]
    pub last: bool,
    /// Bus options.
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
    if args.last {
        say::text!("{}", last(args)?);
        return Ok(());
    }
    let words: Vec<&str> = args.code.iter().map(String::as_str).collect();
    say::text!("{}", explain(&words)?);
    Ok(())
}

fn last(args: &Args) -> Result<String, ExpectedError> {
    let mut session = args.bus.open_with_controller()?;
    let node = session.find_controller(args.controller)?;
    let frozen = session.freeze_frame(node)?;
    let trace = session.trace(node)?;
    session.finish()?;
    let mut text = match &frozen {
        Some(frozen) => {
            let code = frozen.head.fault_cause.to_string();
            table(frozen) + &explain(&[&code]).unwrap_or_default()
        }
        None => format!("controller {}: no fault is latched\n", node.get()),
    };
    text += "last events, s after the start of the controller:\n";
    for entry in &trace {
        text += &format!("{:>14.6}  {}\n", entry.at_us as f64 * 1e-6, describe(entry));
    }
    Ok(text)
}

/// The text for `words`.
///
/// # Errors
/// No such number or name.
pub fn explain(words: &[&str]) -> Result<String, ExpectedError> {
    match words {
        ["exit"] => Ok(exit::TABLE.iter().map(exit_line).collect()),
        ["exit", code] => {
            let row = code.parse::<u8>().ok().and_then(|code| exit::TABLE.iter().find(|row| row.0 == code));
            row.map(exit_line).ok_or_else(|| unknown(&format!("exit {code}")))
        }
        ["all"] => Ok(Cause::TABLE
            .iter()
            .map(|info| format!("{}  {}: {}\n", info.code, info.name, info.what))
            .collect()),
        [code] => {
            let by_number = code.parse::<u16>().ok();
            let info = Cause::TABLE
                .iter()
                .find(|info| by_number == Some(info.code) || info.name.eq_ignore_ascii_case(code));
            let info = info.ok_or_else(|| unknown(code))?;
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
        _ => Err(unknown(&words.join(" "))),
    }
}

fn exit_line(row: &(u8, &str, &str)) -> String {
    format!("exit {:>2}  {}; next: {}\n", row.0, row.1, row.2)
}

fn unknown(code: &str) -> ExpectedError {
    ExpectedError::bad_input(&format!(
        "no fault or exit code '{code}'\n  next: `cubectl explain all` lists the faults, `cubectl explain exit` the \
         exit codes"
    ))
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
    fn unknown_codes_name_the_next_step() {
        for words in [&["9999"][..], &["exit", "99"], &["a", "b"]] {
            let error = explain(words).unwrap_err();
            assert_eq!(error.code, exit::BAD_INPUT);
            assert!(error.message.contains("next: "), "{error}");
        }
    }
}

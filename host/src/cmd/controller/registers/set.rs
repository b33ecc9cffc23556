//! `cubectl controller registers set`

use std::path::{Path, PathBuf};

use protocol::Duration;
use protocol::cyphal::cubecell::group_state::State;
use protocol::cyphal::id::NodeId;
use protocol::cyphal::uavcan::command::standard::STORE_PERSISTENT_STATES;

use super::export::SCHEMA_VERSION;
use super::value;
use crate::cmd::target::Target;
use crate::error::ExpectedError;
use crate::exit;
use operator::bus::Session;
use operator::dialogue::operator::OperatorError;
use operator::dialogue::registers::Numbers;

/// Longest time in which a controller looks for its drives again.
const BOOT_MAX: Duration = Duration::from_secs(20);

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl controller registers set telemetry.period_us=50000\n  cubectl controller registers set joint.jog_v_rad_s=0.1 --bus can0 --save      # one value: for all joints\n  cubectl controller registers set joint.q_min_rad=-2.7,-1.9,-2.5,-1.5,-1.5,-3.1 --bus can0\n  cubectl controller registers set --file arm.registers.toml --bus can0 --save\n\nWhat shapes motion is taken only at rest, from the host that holds the session, and with the key where the controller\nhas one. Limits beyond those it was started with need `cubectl controller unlock`. Values that depend on each other may be given\nin any order. Exit code 8: some were not taken; the message names each."
)]
pub struct Args {
    /// Registers and their values, one per joint or one for all.
    #[arg(value_name = "NAME=VALUE,...", value_parser = assignment, required_unless_present = "file")]
    pub set: Vec<(String, String)>,
    /// A file of `cubectl controller registers export`; written before what is given by name.
    #[arg(long, value_name = "FILE")]
    pub file: Option<PathBuf>,
    /// Let the controller keep its settings when it is switched off.
    #[arg(long)]
    pub save: bool,
    #[command(flatten)]
    pub target: Target,
}

fn assignment(text: &str) -> Result<(String, String), String> {
    let (name, values) = text.split_once('=').ok_or("must be NAME=VALUE,...")?;
    Ok((name.trim().to_owned(), values.to_owned()))
}

/// Runs the verb.
///
/// # Errors
/// A name or value, the file, the bus, or a controller that keeps another value.
pub(super) fn run(args: &Args) -> Result<(), ExpectedError> {
    let mut texts: Vec<(String, Vec<String>)> = args.file.as_deref().map_or(Ok(Vec::new()), read)?;
    let split = |values: &str| values.split(',').map(str::to_owned).collect();
    texts.extend(args.set.iter().map(|(name, values)| (name.clone(), split(values))));
    let (mut session, node) = args.target.open()?;
    // All are read before one is written.
    let mut wanted: Vec<(String, Numbers)> = Vec::new();
    for (name, values) in texts {
        let like = session.register(node, &name)?;
        let value = value::parse(&like, values.iter().map(String::as_str));
        let value =
            value.map_err(|why| ExpectedError::bad_input(&format!("{name}: {why}; nothing was set")))?;
        wanted.retain(|(other, _)| *other != name);
        wanted.push((name, value));
    }
    let taken = write(&mut session, node, &wanted)?;
    if args.save {
        session.order(node, "to save the settings", STORE_PERSISTENT_STATES, &())?;
    }
    session.finish()?;
    console::line!(
        "controller {}: {} registers as wanted, {taken} of them changed{}",
        node.get(),
        wanted.len(),
        if args.save { "; saved" } else { "" }
    );
    Ok(())
}

/// Writes what differs until all is as wanted, or nothing changes any more: a value may have to wait for another one.
/// Returns how many were changed.
fn write(session: &mut Session, node: NodeId, wanted: &[(String, Numbers)]) -> Result<usize, ExpectedError> {
    let mut changed = std::collections::BTreeSet::new();
    // Each round but the last brings at least one value to its place.
    for _ in 0..=wanted.len() {
        let (mut refused, mut progress) = (Vec::new(), false);
        for (name, value) in wanted {
            if session.register(node, name)? == *value {
                continue;
            }
            match session.set_register(node, name, value) {
                Ok(()) => {
                    progress |= changed.insert(name.clone());
                    // Some make the controller look for its drives again.
                    session.pass(Duration::from_millis(20))?;
                    session.wait_for(BOOT_MAX, &|state| state != State::Boot)?;
                }
                Err(OperatorError::RegisterRefused { found, .. }) => {
                    refused.push(format!("{name} = {}, it keeps {found}", value::toml(value)));
                }
                Err(error) => return Err(error.into()),
            }
        }
        let stands = refused.is_empty() && all_stand(session, node, wanted)?;
        if stands {
            return Ok(changed.len());
        }
        if !progress && !refused.is_empty() {
            let what = format!("controller {} does not take {}", node.get(), refused.join("; "));
            return Err(ExpectedError::new(exit::DRIVE, what).next(
                "`cubectl controller registers list` shows ranges and when each may be written; nothing may move or be armed, another host \
                 may hold the session, and a controller with a key wants --key-file",
            ));
        }
    }
    Err(ExpectedError::new(exit::DRIVE, "some registers change each other and cannot all have these values")
        .next("set them one after the other"))
}

/// A value that was taken may have been changed by a later one, as a certificate by a gain.
fn all_stand(
    session: &mut Session,
    node: NodeId,
    wanted: &[(String, Numbers)],
) -> Result<bool, OperatorError> {
    for (name, value) in wanted {
        if session.register(node, name)? != *value {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Names and values of a file.
pub(super) fn read(path: &Path) -> Result<Vec<(String, Vec<String>)>, ExpectedError> {
    let refuse = |what: String| ExpectedError::bad_input(&format!("{}: {what}", path.display()));
    let text = toml_reader::read_text(path, toml_reader::DESCRIPTION_MAX_BYTES)
        .map_err(|error| ExpectedError::io(path, &error))?;
    let file: toml::Table = toml::from_str(&text).map_err(|error| refuse(error.to_string()))?;
    if file.get("schema_version").and_then(toml::Value::as_integer) != Some(SCHEMA_VERSION) {
        let refused = refuse(format!("schema_version is not {SCHEMA_VERSION}"));
        return Err(refused.next("use a file of `cubectl controller registers export`"));
    }
    let registers = file.get("registers").and_then(toml::Value::as_table);
    let registers = registers.ok_or_else(|| refuse("no table [registers]".to_owned()))?;
    let element = |value: &toml::Value| match value {
        toml::Value::Integer(x) => Some(x.to_string()),
        toml::Value::Float(x) => Some(format!("{x:?}")),
        toml::Value::Boolean(x) => Some(x.to_string()),
        _ => None,
    };
    registers
        .iter()
        .map(|(name, value)| {
            let all = match value {
                toml::Value::Array(all) => all.iter().map(element).collect(),
                one => element(one).map(|one| vec![one]),
            };
            let all: Vec<String> = all.ok_or_else(|| {
                refuse(format!("{name}: must be numbers or truth values, one or one per joint"))
            })?;
            Ok((name.clone(), all))
        })
        .collect()
}

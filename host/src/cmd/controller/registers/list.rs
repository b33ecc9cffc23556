//! `cubectl controller registers list`

use firmware::registers::{RegisterInfo, Wider, Writable};

use super::value;
use crate::cmd::print_json;
use crate::cmd::target::Target;
use crate::error::ExpectedError;

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl controller registers list\n  cubectl controller registers list joint. --bus can0\n\nNames and values are the controller's; range, time and meaning are those that this program knows."
)]
pub struct Args {
    /// Only names that begin so.
    #[arg(value_name = "PREFIX", default_value = "")]
    pub prefix: String,
    #[command(flatten)]
    pub target: Target,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// When a register may be written, as text.
fn when(info: &RegisterInfo) -> String {
    let mut text = match info.writable {
        Writable::Never => "never",
        Writable::Always => "at any time",
        Writable::AtRest => "at rest",
        Writable::NextStart => "at rest, not after a stop or in a fault; the drives are looked for again",
        Writable::NextPowerOn => "at rest; in force after save and restart",
    }
    .to_owned();
    text += match info.wider {
        Wider::No => "",
        Wider::More => "; more than at the start only while unlocked",
        Wider::Less => "; less than at the start only while unlocked",
        Wider::Other => "; only while unlocked",
    };
    text += if info.is_limit() { "; voids the commit" } else { "" };
    text + if info.is_proven { "; voids the certificate" } else { "" }
}

fn known(name: &str) -> Option<(&'static RegisterInfo, &'static str)> {
    operator::dialogue::registers::known().find(|(info, _)| info.name == name)
}

pub(super) fn run(args: &Args) -> Result<(), ExpectedError> {
    let (mut session, node) = args.target.open()?;
    let mut found = Vec::new();
    for name in session.register_names(node)? {
        if name.starts_with(&args.prefix) {
            found.push(session.reported_register(node, &name)?);
        }
    }
    session.finish()?;
    if args.json {
        let rows: Vec<_> = found
            .iter()
            .map(|register| {
                let info = known(&register.name);
                serde_json::json!({
                    "name": register.name,
                    "kind": value::kind(&register.value),
                    "value": value::json(&register.value),
                    "mutable": register.mutable,
                    "per_joint": info.map(|(info, _)| info.per_joint),
                    "min": info.map(|(info, _)| info.min),
                    "max": info.map(|(info, _)| info.max),
                    "writable": info.map(|(info, _)| when(info)),
                    "meaning": info.map(|(_, meaning)| meaning),
                })
            })
            .collect();
        print_json(&serde_json::json!({ "controller": node.get(), "registers": rows }));
        return Ok(());
    }
    for register in &found {
        console::line!("{} = {}", register.name, value::text(&register.value));
        if let Some((info, meaning)) = known(&register.name) {
            let range = if value::kind(&register.value) == "bit" {
                String::new()
            } else {
                format!("; {} to {}", info.min, info.max)
            };
            console::line!("    {meaning}{range}; {}", when(info));
        }
    }
    Ok(())
}

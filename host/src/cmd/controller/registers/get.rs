//! `cubectl controller registers get`

use super::value;
use crate::cmd::print_json;
use crate::cmd::target::Target;
use crate::error::ExpectedError;

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl controller registers get cycle.period_us\n  cubectl controller registers get joint.v_max_rad_s joint.a_max_rad_s2 --bus can0 --json\n\nUnits are in the names; a register of the joints holds one value per joint, base first."
)]
pub struct Args {
    /// Names.
    #[arg(required = true, value_name = "NAME")]
    pub names: Vec<String>,
    #[command(flatten)]
    pub target: Target,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// Runs the verb.
///
/// # Errors
/// The bus, or a name that the controller does not know.
pub(super) fn run(args: &Args) -> Result<(), ExpectedError> {
    let (mut session, node) = args.target.open()?;
    let mut found = Vec::new();
    for name in &args.names {
        found.push(session.reported_register(node, name)?);
    }
    session.finish()?;
    if args.json {
        let object: serde_json::Map<_, _> =
            found.iter().map(|register| (register.name.clone(), value::json(&register.value))).collect();
        print_json(&object.into());
        return Ok(());
    }
    for register in &found {
        console::line!("{} = {}", register.name, value::text(&register.value));
    }
    Ok(())
}

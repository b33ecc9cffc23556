//! `cubectl scan`

use protocol::ModuleId;

use super::modules::{Modules, look, module_json, nobody, require_alone};
use super::print_json;
use crate::error::ExpectedError;
use operator::bus::BusArgs;

/// Arguments.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl scan\n  cubectl scan --bus can0\n  cubectl scan --bus slcan:/dev/ttyACM0 --modules 1-6 --json"
)]
pub struct Args {
    /// Bus options.
    #[command(flatten)]
    pub bus: BusArgs,
    /// Look for these addresses only, for example 1-6 or 1,3,7.
    #[arg(long)]
    pub modules: Option<Modules>,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// Runs the verb.
///
/// # Errors
/// The bus cannot be reached, or nobody answers.
pub fn run(args: &Args) -> Result<(), ExpectedError> {
    let mut session = args.bus.open()?;
    require_alone(&mut session, args.bus.beside)?;
    let all: Vec<ModuleId> = ModuleId::all().collect();
    let found = look(&mut session, args.modules.as_ref().map_or(&all, |modules| &modules.0))?;
    let name = session.name().to_owned();
    session.finish()?;
    if args.json {
        let modules: Vec<_> = found.iter().map(module_json).collect();
        print_json(&serde_json::json!({ "bus": name, "modules": modules }));
    } else if !found.is_empty() {
        say::line!("{name}: {} module{}", found.len(), if found.len() == 1 { "" } else { "s" });
        say::line!("id  serial      firmware  kind    position_rad  state");
        for report in &found {
            let serial = report.serial.map_or("?".to_owned(), |serial| serial.to_string());
            let position = report.position_rad.map_or("?".to_owned(), |rad| format!("{rad:.4}"));
            say::line!(
                "{:>2}  {serial:<10}  {:<8}  {:<6}  {position:>12}  {}",
                report.module,
                report.version.to_string(),
                report.kind(),
                report.condition(),
            );
        }
    }
    if found.is_empty() { Err(nobody(&name)) } else { Ok(()) }
}

//! `cubectl scan`

use protocol::ModuleId;

use super::modules::{Beside, Modules, listen_beside, module_json, nobody, survey_with_progress};
use super::{counted, fixed, print_json};
use crate::error::ExpectedError;
use operator::bus::BusArgs;
use operator::dialogue::survey::condition;

/// Arguments.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl scan\n  cubectl scan --bus can0\n  cubectl scan --bus slcan:/dev/ttyACM0 --modules 1-6 --json\n\nBeside a controller or another host nothing is sent: the modules that they speak to are heard and told."
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

/// Tells which modules were heard beside somebody who speaks to them.
fn heard(json: bool, name: &str, beside: &Beside) -> Result<(), ExpectedError> {
    if json {
        print_json(&beside.json(name));
        return Ok(());
    }
    console::line!("{name}: {} heard; nothing was sent", counted(beside.modules.len(), "module"));
    console::line!("{}", beside.line());
    console::line!("id  position_rad  state");
    for (module, heard) in &beside.modules {
        let position = heard.position_rad.map_or("?".to_owned(), |rad| fixed(rad.into(), 4));
        console::line!("{module:>2}  {position:>12}  {}", condition(heard.state));
    }
    Ok(())
}

/// Runs the verb.
///
/// # Errors
/// The bus cannot be reached, or nobody answers.
pub fn run(args: &Args) -> Result<(), ExpectedError> {
    let mut session = args.bus.open()?;
    let named = args.modules.as_ref().map(|modules| modules.0.as_slice());
    if let Some(beside) = listen_beside(&mut session, named, args.bus.beside)? {
        let name = session.name().to_owned();
        session.finish()?;
        return heard(args.json, &name, &beside);
    }
    let all: Vec<ModuleId> = ModuleId::all().collect();
    let found = survey_with_progress(&mut session, args.modules.as_ref().map_or(&all, |modules| &modules.0))?;
    let name = session.name().to_owned();
    session.finish()?;
    if args.json {
        let modules: Vec<_> = found.iter().map(module_json).collect();
        print_json(&serde_json::json!({ "bus": name, "modules": modules }));
    } else if !found.is_empty() {
        console::line!("{name}: {}", counted(found.len(), "module"));
        console::line!("id  serial      firmware  kind    position_rad  state");
        for report in &found {
            let serial = report.serial.map_or("?".to_owned(), |serial| serial.to_string());
            let position = report.position_rad.map_or("?".to_owned(), |rad| fixed(rad, 4));
            console::line!(
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

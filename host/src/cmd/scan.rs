//! `cubectl scan`

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use super::modules::{Beside, Modules, Seen, look};
use super::{counted, fixed, print_json};
use crate::advice::Place;
use crate::error::ExpectedError;
use operator::bus::BusArgs;
use operator::dialogue::survey::{ModuleReport, condition};
use operator::interrupt::interrupt;

/// Arguments.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl scan\n  cubectl scan --bus can0\n  cubectl scan --bus slcan:/dev/ttyACM0 --modules 1-6 --json\n\nBeside a controller or another host nothing is sent: the modules that they speak to are heard and told.\nModules of the robot that do not answer are told too; the exit code is 0 as long as anybody answers."
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
    let look = look(&args.bus, args.modules.as_ref(), true, interrupt())?;
    if args.json {
        print_json(&look.json());
    } else {
        match &look.seen {
            Seen::Heard(beside) => heard(&look.bus, beside),
            Seen::Asked(found) => answered(&look.bus, found),
        }
    }
    // Whether the robot is whole is for `status` and `doctor` to judge.
    if let Some(missing) = look.told_missing() {
        console::note!("{}", missing.on(&Place::of_bus(&args.bus)));
    }
    Ok(())
}

/// What `cubectl scan --json` tells, from words of its command line; nothing is printed. `stop`, once set, ends it.
///
/// # Errors
/// A word is refused (exit code 2 of the program), the bus cannot be reached, or nobody answers.
pub fn for_programs(words: &[String], stop: &Arc<AtomicBool>) -> Result<serde_json::Value, ExpectedError> {
    let args: Args = super::words::parse("scan", words)?;
    Ok(look(&args.bus, args.modules.as_ref(), false, Arc::clone(stop))?.json())
}

/// Tells which modules were heard beside somebody who speaks to them.
fn heard(bus: &str, beside: &Beside) {
    console::line!("{bus}: {} heard; nothing was sent", counted(beside.modules.len(), "module"));
    console::line!("{}", beside.line());
    console::line!("id  position_rad  state");
    for (module, heard) in &beside.modules {
        let position = heard.position_rad.map_or("?".to_owned(), |rad| fixed(rad.into(), 4));
        console::line!("{module:>2}  {position:>12}  {}", condition(heard.state));
    }
}

/// Tells which modules answered.
fn answered(bus: &str, found: &[ModuleReport]) {
    console::line!("{bus}: {}", counted(found.len(), "module"));
    console::line!("id  serial      firmware  kind    position_rad  state");
    for report in found {
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

//! `cubectl arm status`

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use crate::advice::Place;
pub use crate::cmd::survey::Modules;
use crate::cmd::survey::{Beside, Seen, look};
use crate::cmd::{counted, fixed, print_json};
use crate::error::ExpectedError;
use operator::bus::BusArgs;
use operator::dialogue::survey::{ModuleReport, condition};
use operator::interrupt::interrupt;

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl arm status --bus can0\n  cubectl arm status --bus slcan:/dev/ttyACM0 --modules 1-6 --json\n\nBeside a controller or another host nothing is sent: what they ask the modules is heard and printed.\nIf a module that must answer does not, the table of the others is followed by an error, code 8. On a real bus for which no robot\nwas named with --robot the modules of powercube6 are only a guess: then a note names what is missing, code 0."
)]
pub struct Args {
    #[command(flatten)]
    pub bus: BusArgs,
    /// These modules; each must answer. Default: all that are there; those of the robot must answer.
    #[arg(long)]
    pub modules: Option<Modules>,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

pub fn run(args: &Args) -> Result<(), ExpectedError> {
    if let Some((spec, described, arm)) = crate::cmd::rsi::robot_on(&args.bus)? {
        return crate::cmd::rsi::status(&spec, &described, &arm, args.json);
    }
    let look = look(&args.bus, args.modules.as_ref(), true, interrupt())?;
    if args.json {
        print_json(&look.json());
    } else {
        match &look.seen {
            Seen::Heard(beside) => heard(&look.bus, beside),
            Seen::Asked(found) => answered(&look.bus, found),
        }
    }
    match look.reported_missing() {
        Some(missing) if look.is_guess() => {
            console::note!("{}", missing.on(&Place::of_bus(&args.bus)));
        }
        Some(missing) => return Err(missing),
        None => {}
    }
    Ok(())
}

/// What `cubectl arm status --json` prints; nothing is printed. `stop`, once set, ends it. With
/// `all_must_answer` a module that must be there and does not answer is an error, as for the verb.
///
/// # Errors
/// The bus cannot be reached, nobody answers, or a module that must be there does not.
pub fn for_programs(
    bus: &BusArgs,
    modules: Option<&Modules>,
    all_must_answer: bool,
    stop: &Arc<AtomicBool>,
) -> Result<serde_json::Value, ExpectedError> {
    let look = look(bus, modules, false, Arc::clone(stop))?;
    match look.reported_missing().filter(|_| all_must_answer && !look.is_guess()) {
        Some(missing) => Err(missing),
        None => Ok(look.json()),
    }
}

/// Prints what was heard of the modules beside somebody who speaks to them.
fn heard(bus: &str, beside: &Beside) {
    let number = |value: Option<f32>, digits| value.map_or("-".to_owned(), |v| fixed(v.into(), digits));
    console::line!("{bus}: {} heard; nothing was sent", counted(beside.modules.len(), "module"));
    console::line!("{}", beside.line());
    console::line!("id  position_rad  current_a  state");
    for (module, heard) in &beside.modules {
        let (position, current) = (number(heard.position_rad, 4), number(heard.current_a, 2));
        console::line!("{module:>2}  {position:>12}  {current:>9}  {}", condition(heard.state));
    }
}

fn answered(bus: &str, found: &[ModuleReport]) {
    let number = |value: Option<f64>, digits| value.map_or("-".to_owned(), |v| fixed(v, digits));
    console::line!("{bus}: {}", counted(found.len(), "module"));
    console::line!("id  serial    firmware  kind   position_rad  current_a  motor_v  logic_v  temp_c  state");
    for report in found {
        console::line!(
            "{:>2}  {:<8}  {:<8}  {:<5}  {:>12}  {:>9}  {:>7}  {:>7}  {:>6}  {}",
            report.module,
            report.serial.map_or("-".to_owned(), |serial| serial.to_string()),
            report.version.to_string(),
            report.kind(),
            number(report.position_rad, 4),
            number(report.current_a, 2),
            number(report.motor_v, 1),
            number(report.logic_v, 1),
            number(report.temperature_c, 0),
            report.condition(),
        );
    }
}

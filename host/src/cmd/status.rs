//! `cubectl status`

use super::modules::{Modules, module_json, open};
use super::print_json;
use crate::error::ExpectedError;
use operator::bus::BusArgs;

/// Arguments.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl status --bus can0\n  cubectl status --bus can0 --modules 1-6 --json"
)]
pub struct Args {
    /// Bus options.
    #[command(flatten)]
    pub bus: BusArgs,
    /// These modules; each must answer. Default: all that are there.
    #[arg(long)]
    pub modules: Option<Modules>,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// Runs the verb.
///
/// # Errors
/// The bus cannot be reached, nobody answers, or one that was named does not.
pub fn run(args: &Args) -> Result<(), ExpectedError> {
    let (session, found) = open(&args.bus, args.modules.as_ref())?;
    let name = session.name().to_owned();
    session.finish()?;
    if args.json {
        let modules: Vec<_> = found.iter().map(module_json).collect();
        print_json(&serde_json::json!({ "bus": name, "modules": modules }));
        return Ok(());
    }
    let number =
        |value: Option<f64>, digits: usize| value.map_or("-".to_owned(), |v| format!("{v:.digits$}"));
    say::line!("id  position_rad  current_a  motor_v  logic_v  temp_c  state");
    for report in &found {
        say::line!(
            "{:>2}  {:>12}  {:>9}  {:>7}  {:>7}  {:>6}  {}",
            report.module,
            number(report.position_rad, 4),
            number(report.current_a, 2),
            number(report.motor_v, 1),
            number(report.logic_v, 1),
            number(report.temperature_c, 0),
            report.condition(),
        );
    }
    Ok(())
}

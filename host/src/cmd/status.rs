//! `cubectl status`

use super::modules::{Beside, Modules, listen_beside, module_json, modules_on};
use super::{fixed, print_json};
use crate::error::ExpectedError;
use operator::bus::BusArgs;
use operator::dialogue::survey::condition;

/// Arguments.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl status --bus can0\n  cubectl status --bus can0 --modules 1-6 --json\n\nBeside a controller or another host nothing is sent: what they ask the modules is heard and told."
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

/// Tells what was heard of the modules beside somebody who speaks to them.
fn heard(json: bool, name: &str, beside: &Beside) {
    if json {
        print_json(&beside.json(name));
        return;
    }
    let number = |value: Option<f32>, digits| value.map_or("-".to_owned(), |v| fixed(v.into(), digits));
    console::line!("{}; nothing was sent, this is what was heard", beside.line());
    console::line!("id  position_rad  current_a  state");
    for (module, heard) in &beside.modules {
        let (position, current) = (number(heard.position_rad, 4), number(heard.current_a, 2));
        console::line!("{module:>2}  {position:>12}  {current:>9}  {}", condition(heard.state));
    }
}

/// Runs the verb.
///
/// # Errors
/// The bus cannot be reached, nobody answers, or one that was named does not.
pub fn run(args: &Args) -> Result<(), ExpectedError> {
    if let Some((spec, described, arm)) = super::rsi::robot_on(&args.bus)? {
        return super::rsi::status(&spec, &described, &arm, args.json);
    }
    let mut session = args.bus.open()?;
    let named = args.modules.as_ref().map(|modules| modules.0.as_slice());
    if let Some(beside) = listen_beside(&mut session, named, args.bus.beside)? {
        let name = session.name().to_owned();
        session.finish()?;
        heard(args.json, &name, &beside);
        return Ok(());
    }
    let found = modules_on(&mut session, named, true)?;
    let name = session.name().to_owned();
    session.finish()?;
    if args.json {
        let modules: Vec<_> = found.iter().map(module_json).collect();
        print_json(&serde_json::json!({ "bus": name, "modules": modules }));
        return Ok(());
    }
    let number = |value: Option<f64>, digits| value.map_or("-".to_owned(), |v| fixed(v, digits));
    console::line!("id  position_rad  current_a  motor_v  logic_v  temp_c  state");
    for report in &found {
        console::line!(
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

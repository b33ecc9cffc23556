//! `cubectl home`

use protocol::Duration;
use protocol::powercube::Parameter;

use super::modules::{Modules, open};
use super::print_json;
use crate::bus::BusArgs;
use crate::bus::motion::{HomingBounds, home};
use crate::error::ExpectedError;

/// Arguments.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl home\n  cubectl home --bus can0 --modules 6\n  cubectl home --bus can0 --speed 0.1 --force\n\nOne module after the other, highest address first (the hand before the base).\nModules with absolute encoders and modules that are homed already are left alone.\nCtrl-C halts everything."
)]
pub struct Args {
    /// Bus options.
    #[command(flatten)]
    pub bus: BusArgs,
    /// These modules. Default: all that are there.
    #[arg(long)]
    pub modules: Option<Modules>,
    /// Home also what is homed.
    #[arg(long)]
    pub force: bool,
    /// Largest speed, rad/s.
    #[arg(long, default_value_t = 0.2, value_name = "RAD_S", value_parser = positive)]
    pub speed: f64,
    /// Largest current as a share of the module's own maximum.
    #[arg(long, default_value_t = 0.8, value_name = "SHARE", value_parser = share)]
    pub current: f64,
    /// Longest time for each module, s.
    #[arg(long, default_value_t = 40.0, value_name = "SECONDS", value_parser = positive)]
    pub timeout: f64,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// A number above zero.
pub(super) fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        _ => Err("must be a number above 0".to_owned()),
    }
}

/// A number above zero, at most one.
pub(super) fn share(text: &str) -> Result<f64, String> {
    positive(text)
        .and_then(|value| if value <= 1.0 { Ok(value) } else { Err(String::new()) })
        .map_err(|_| "must be above 0 and at most 1".to_owned())
}

/// Runs the verb.
///
/// # Errors
/// The bus, a module that does not answer, does not find its zero, or draws too much current.
pub fn run(args: &Args) -> Result<(), ExpectedError> {
    let (mut session, mut found) = open(&args.bus, args.modules.as_ref())?;
    found.sort_by_key(|report| std::cmp::Reverse(report.module));
    let bounds = HomingBounds {
        speed_max_rad_s: args.speed,
        current_share: args.current,
        time: Duration::from_secs_f64(args.timeout),
    };
    let mut rows = Vec::new();
    for report in &found {
        let skip = if report.is_absolute() {
            Some("absolute encoder")
        } else if report.is_homed() && !args.force {
            Some("homed already")
        } else {
            None
        };
        if let Some(why) = skip {
            if !args.json {
                say::line!("module {}: {why}", report.module);
            }
            rows.push(serde_json::json!({ "module": report.module.get(), "skipped": why }));
            continue;
        }
        if !args.json {
            say::note!("module {}: homing at up to {} rad/s; Ctrl-C halts", report.module, args.speed);
        }
        let has_home_vel = Parameter::HomeVel.info().writable(report.version);
        let homed = home(&mut session, report.module, &bounds, has_home_vel)?;
        if !args.json {
            say::line!(
                "module {}: zero found in {:.1} s, stands at {:.4} rad, at most {:.1} A",
                report.module,
                homed.took.as_secs_f64(),
                homed.position_rad,
                homed.current_max_a
            );
        }
        rows.push(serde_json::json!({
            "module": report.module.get(),
            "took_s": homed.took.as_secs_f64(),
            "position_rad": homed.position_rad,
            "current_max_a": homed.current_max_a,
        }));
    }
    session.finish()?;
    if args.json {
        print_json(&serde_json::json!({ "modules": rows }));
    }
    Ok(())
}

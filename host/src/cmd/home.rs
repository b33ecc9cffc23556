//! `cubectl home`

use protocol::Duration;
use protocol::powercube::Parameter;

use super::modules::{Modules, open};
use super::print_json;
use crate::error::ExpectedError;
use crate::exit;
use operator::bus::BusArgs;
use operator::dialogue::motion::{Homed, HomingBounds, home};

/// Arguments.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl home\n  cubectl home --bus can0 --modules 6\n  cubectl home --bus can0 --speed 0.1 --force\n  cubectl home --bus can0 --verify             # have drives lost encoder counts?\n\nOne module after the other, highest address first (the hand before the base).\nModules with absolute encoders and modules that are homed already are left alone.\nCtrl-C halts everything.\n\nA drive knows its position only from counting. If counts are lost (a loose encoder cable, a dip of its supply) it tells a\nwrong position, follows every path with small errors, and its limits are off by as much. Nothing in its answers shows\nthat until the switch is found again: --verify compares then. With an offset the exit code is 9."
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
    /// Home also what is homed, and compare each reading before with the zero that the switch gives: a drive that has lost
    /// encoder counts shows it here, and only here.
    #[arg(long)]
    pub verify: bool,
    /// An offset above this is a finding of --verify, rad; at least the resolution of the comparison counts.
    #[arg(long, default_value_t = 0.005, value_name = "RAD", value_parser = positive)]
    pub offset_max: f64,
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
    let (mut rows, mut findings) = (Vec::new(), Vec::new());
    for report in &found {
        let skip = if report.is_absolute() {
            Some("absolute encoder")
        } else if report.is_homed() && !args.force && !args.verify {
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
        // Without a zero before there is nothing to compare; without a known speed no step stands out.
        let looks_at_zero = args.verify && report.is_homed() && has_home_vel;
        let homed = home(&mut session, report.module, &bounds, has_home_vel, looks_at_zero)?;
        if !args.json {
            say::line!(
                "module {}: zero found in {:.1} s, stands at {:.4} rad, at most {:.1} A",
                report.module,
                homed.took.as_secs_f64(),
                homed.position_rad,
                homed.current_max_a
            );
        }
        let verdict = if args.verify { compared(&homed, args.offset_max) } else { Compared::default() };
        if let Some(text) = &verdict.text
            && !args.json
        {
            say::line!("module {}: {text}", report.module);
        }
        findings.extend(verdict.finding.map(|text| format!("module {}: {text}", report.module)));
        rows.push(serde_json::json!({
            "zero_offset_rad": homed.zero.map(|zero| zero.offset_rad),
            "zero_resolution_rad": homed.zero.map(|zero| zero.resolution_rad),
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
    if findings.is_empty() {
        return Ok(());
    }
    Err(ExpectedError::new(
        exit::FINDINGS,
        format!(
            "{}\n  next: what was thrown or taught since that zero is off by as much. Home once more with --verify: the second \
             run must agree. Look at the encoder's cable and supply if it comes again",
            findings.join("\n")
        ),
    ))
}

/// What `--verify` says of one module.
#[derive(Default)]
struct Compared {
    text: Option<String>,
    finding: Option<String>,
}

fn compared(homed: &Homed, offset_max_rad: f64) -> Compared {
    let Some(zero) = homed.zero else {
        let text =
            "the reading before cannot be compared: there was no zero, or its homing speed is not known";
        return Compared { text: Some(text.to_owned()), finding: None };
    };
    let (off, least) = (zero.offset_rad.to_degrees(), zero.resolution_rad.to_degrees());
    if zero.offset_rad.abs() > offset_max_rad.max(zero.resolution_rad) {
        let text = format!("its reading was off by {off:.2}° (± {least:.2}°): it had lost encoder counts");
        return Compared { text: None, finding: Some(text) };
    }
    let text = format!("the reading before agrees with the zero within {:.2}°", off.abs().max(least));
    Compared { text: Some(text), finding: None }
}

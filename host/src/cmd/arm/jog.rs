//! `cubectl jog`

use std::io::IsTerminal;
use std::time::Instant as WallTime;

use protocol::{Duration, Instant, JointIndex, ModuleId};

use crate::cmd::arm::home::at;
use crate::cmd::controlled::{Controlled, ControllerArgs};
use crate::cmd::held_key::{Keys, Pace, Pressed, wait};
use crate::cmd::print_json;
use crate::error::ExpectedError;
use crate::exit;
use operator::bus::BusArgs;
use operator::dialogue::jogging::Jogged;
use operator::dialogue::operator::OperatorError;
use operator::dialogue::registers::Numbers;

/// Fastest jog, rad/s: slow enough to step aside.
pub const SPEED_MAX_RAD_S: f64 = 0.25;

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl jog 3 --bus can0               # hold a key: + or l up, - or h down; any other key or Ctrl-C ends\n  cubectl jog 3 --bus can0 --for-s 1.5 --speed-rad-s -0.1\n\nA controller does it: one that is heard on the bus, else one in this program, for this module alone. The module moves only\nwhile the key is held. If this program dies it stops within 0.2 s by itself."
)]
pub struct Args {
    /// Address of the module.
    #[arg(value_parser = address)]
    pub module: ModuleId,
    /// Bus options; `--robot` names the arm where the controller runs in this program.
    #[command(flatten)]
    pub bus: BusArgs,
    #[command(flatten)]
    pub controller: ControllerArgs,
    /// Speed, rad/s, at most 0.25; with --for-s the sign is the direction.
    #[arg(long = "speed-rad-s", alias = "speed", default_value_t = 0.1, value_name = "RAD_S", allow_hyphen_values = true, value_parser = speed)]
    pub speed: f64,
    /// Move for this many seconds instead of while a key is held.
    #[arg(long = "for-s", alias = "for", value_name = "SECONDS", value_parser = crate::cmd::values::positive)]
    pub time: Option<f64>,
    /// Print JSON (with --for-s).
    #[arg(long)]
    pub json: bool,
}

fn address(text: &str) -> Result<ModuleId, String> {
    let number: u8 = text.parse().map_err(|_| "must be an address, 1 to 31".to_owned())?;
    ModuleId::new(number).map_err(|error| error.to_string())
}

fn speed(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if v != 0.0 && v.abs() <= SPEED_MAX_RAD_S => Ok(v),
        _ => Err(format!("must be a number other than 0, at most {SPEED_MAX_RAD_S} rad/s either way")),
    }
}

pub fn run(args: &Args) -> Result<(), ExpectedError> {
    if args.time.is_none() && !std::io::stdin().is_terminal() {
        return Err(ExpectedError::new(
            exit::USAGE,
            "a jog goes on while a key is held, and there is no terminal; nothing has moved",
        )
        .next("run it in a terminal, or name the time with --for-s SECONDS"));
    }
    let named = [args.module];
    let mut controlled = Controlled::open(&args.bus, &args.controller, Some(&named), &|_| {})?;
    let Some((joint, _)) = controlled.select(Some(&named))?.first().copied() else { return Ok(()) };
    require_speed(&mut controlled, joint, args.speed)?;
    let Some(seconds) = args.time else { return by_keys(args, controlled, joint) };
    // It counts from the first order.
    let mut until = None;
    let span = Duration::from_secs_f64(seconds);
    let jogged =
        jog(&mut controlled, (joint, args), args.speed, &mut |now| now < *until.get_or_insert(now + span))?;
    let interrupted = controlled.session.is_interrupted();
    end(controlled)?;
    if args.json {
        print_json(&serde_json::json!({
            "module": args.module.get(),
            "from_rad": jogged.from_rad,
            "to_rad": jogged.to_rad,
            "held_s": jogged.held.as_secs_f64(),
            "at_limit": jogged.at_limit,
            "interrupted": interrupted,
        }));
    } else {
        report(args.module, &jogged);
    }
    if interrupted { Err(stands()) } else { Ok(()) }
}

fn stands() -> ExpectedError {
    ExpectedError::new(exit::INTERRUPTED, "interrupted; the module stands still")
}

/// Ends in order; after Ctrl-C the controller is not asked for anything more.
fn end(controlled: Controlled) -> Result<(), ExpectedError> {
    if controlled.session.is_interrupted() { Ok(controlled.session.finish()?) } else { controlled.finish() }
}

fn jog(
    controlled: &mut Controlled,
    (joint, args): (JointIndex, &Args),
    speed_rad_s: f64,
    held: &mut dyn FnMut(Instant) -> bool,
) -> Result<Jogged, ExpectedError> {
    let node = controlled.node;
    let jogged = controlled.session.jog_joint(node, joint, speed_rad_s, held);
    jogged.map_err(|error| at(args.module, controlled.renumbered(error)))
}

/// A controller jogs no faster than it is set to; a slower jog than the order is not reported as done.
fn require_speed(
    controlled: &mut Controlled,
    joint: JointIndex,
    speed_rad_s: f64,
) -> Result<(), ExpectedError> {
    let node = controlled.node;
    let Numbers::Real(speeds) = controlled.session.register(node, "joint.jog_v_rad_s")? else {
        return Err(OperatorError::Unreadable { node }.into());
    };
    let most_rad_s = speeds.get(joint.get()).copied().unwrap_or(0.0);
    if speed_rad_s.abs() as f32 <= most_rad_s {
        return Ok(());
    }
    Err(ExpectedError::bad_input(&format!(
        "controller {} jogs this joint at most at {most_rad_s} rad/s; nothing moved",
        node.get()
    ))
    .next(format!("--speed-rad-s {most_rad_s}, or register joint.jog_v_rad_s")))
}

fn report(module: ModuleId, jogged: &Jogged) {
    let limit = if jogged.at_limit { ", at its soft limit" } else { "" };
    console::line!("module {module}: {:.4} rad -> {:.4} rad{limit}", jogged.from_rad, jogged.to_rad);
}

fn by_keys(args: &Args, mut controlled: Controlled, joint: JointIndex) -> Result<(), ExpectedError> {
    let mut keys = Keys::of_terminal();
    console::note!("module {}: hold + or l to move up, - or h to move down; any other key ends", args.module);
    loop {
        match keys.fetch(WallTime::now()) {
            Pressed::Other(b'\n' | b'\r') => {}
            Pressed::Other(_) | Pressed::Ended => break,
            Pressed::Nothing if controlled.session.is_interrupted() => break,
            Pressed::Nothing => wait(&mut controlled.session)?,
            Pressed::Held(sign) => {
                let (mut last, mut pace) = (Pressed::Held(sign), Pace::default());
                let jogged = jog(&mut controlled, (joint, args), sign * args.speed.abs(), &mut |now| {
                    pace.keep(now.as_secs_f64());
                    last = keys.fetch(WallTime::now());
                    last == Pressed::Held(sign)
                })?;
                report(args.module, &jogged);
                let is_interrupted = controlled.session.is_interrupted();
                if is_interrupted || matches!(last, Pressed::Other(_) | Pressed::Ended) {
                    break;
                }
                if jogged.at_limit {
                    keys.let_go();
                }
            }
        }
    }
    drop(keys);
    let interrupted = controlled.session.is_interrupted();
    end(controlled)?;
    if interrupted { Err(stands()) } else { Ok(()) }
}

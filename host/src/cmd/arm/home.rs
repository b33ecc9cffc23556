//! `cubectl home`

use firmware::groups::powercube::settings::{HOME_V_RAD_S, SLOW_CURRENT_A};
use firmware::settings::{JointSettings, Settings};
use protocol::{Duration, JointIndex, ModuleId};

use crate::cmd::controlled::{Controlled, ControllerArgs};
use crate::cmd::print_json;
use crate::cmd::progress::while_working;
use crate::cmd::survey::Modules;
use crate::cmd::values::{at_most, positive, share, within};
use crate::error::ExpectedError;
use crate::exit;
use operator::bus::BusArgs;
use operator::dialogue::homing::Homed;
use operator::dialogue::operator::OperatorError;
use operator::dialogue::registers::Numbers;
use operator::dialogue::zero_check::ZeroCheck;

/// Period of looking at the drives while a zero is compared, µs: the shortest one.
const VERIFY_MONITOR_US: u32 = 4_000;

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl home\n  cubectl home --bus can0 --modules 6\n  cubectl home --bus can0 --speed-rad-s 0.05 --force\n  cubectl home --bus can0 --verify             # have drives lost encoder counts?\n\nA controller does it: one that is heard on the bus, else one in this program. One joint after the other, the hand before\nthe base, at reduced speed and with the current of each drive limited. Joints that are homed already are left alone; drives\nwith absolute encoders always are homed. Ctrl-C halts everything; so does the controller if this program dies.\n\nA drive knows its position only from counting. If counts are lost (a loose encoder cable, a dip of its supply) it reports a\nwrong position, follows every path with small errors, and its limits are off by as much. Nothing in its answers shows\nthat until the switch is found again: --verify compares then. With an offset the exit code is 9."
)]
pub struct Args {
    /// Bus options; `--robot` names the arm where the controller runs in this program.
    #[command(flatten)]
    pub bus: BusArgs,
    #[command(flatten)]
    pub controller: ControllerArgs,
    /// The joints of these modules. Default: all. A controller in this program then needs no others to be there.
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
    #[arg(long = "offset-max-rad", alias = "offset-max", default_value_t = 0.005, value_name = "RAD", value_parser = positive)]
    pub offset_max: f64,
    /// Speed, rad/s, at most 0.5. Default: the controller's.
    #[arg(long = "speed-rad-s", alias = "speed", value_name = "RAD_S", value_parser = at_most(0.5, "rad/s"))]
    pub speed: Option<f64>,
    /// Largest current as a share of the drive's own maximum. Default: the controller's. A controller on the bus takes no
    /// more than it was started with.
    #[arg(long = "current-share", alias = "current", value_name = "SHARE", value_parser = share)]
    pub current: Option<f64>,
    /// Longest time for each joint, s, from 1 to 60.
    #[arg(long = "timeout-s", alias = "timeout", default_value_t = 60.0, value_name = "SECONDS", value_parser = within(1.0..=60.0, "s"))]
    pub timeout: f64,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

impl Args {
    fn timeout_us(&self) -> u32 {
        (1e6 * self.timeout).round() as u32
    }

    /// What a controller of this program begins with.
    fn adjust(&self, settings: &mut Settings) {
        settings.home_timeout_us = self.timeout_us();
        if self.verify {
            settings.monitor_period_us = VERIFY_MONITOR_US;
        }
        for joint in JointIndex::first(settings.joints as usize) {
            let JointSettings { v_max_rad_s, current_max_a, .. } = *settings.joint.at(joint);
            if let Some(v) = self.speed {
                let v_rad_s = (v as f32).min(v_max_rad_s).copysign(HOME_V_RAD_S.at(settings, joint));
                HOME_V_RAD_S.set_at(settings, joint, v_rad_s);
            }
            if let Some(share) = self.current {
                SLOW_CURRENT_A.set_at(settings, joint, share as f32 * current_max_a);
            }
        }
    }

    /// Speed of homing of each joint, with its direction; `None`: these drives know their position without a motion.
    fn speeds(&self, controlled: &mut Controlled) -> Result<Option<Vec<f32>>, ExpectedError> {
        let node = controlled.node;
        match controlled.session.find_register(node, "joint.home_v_rad_s")? {
            Some(Numbers::Real(speeds)) => Ok(Some(speeds)),
            Some(_) => Err(OperatorError::Unreadable { node }.into()),
            None if self.verify || self.speed.is_some() || self.current.is_some() => {
                Err(ExpectedError::bad_input(
                    &"these drives do not move to find their zero: --verify, --speed-rad-s and --current-share mean nothing",
                )
                .next("leave these options out; nothing has moved"))
            }
            None => Ok(None),
        }
    }

    /// What is asked for, as registers of a controller that has others.
    fn wishes(&self, controlled: &mut Controlled) -> Result<Vec<(&'static str, Numbers)>, OperatorError> {
        let node = controlled.node;
        let mut real = |name| match controlled.session.register(node, name)? {
            Numbers::Real(numbers) => Ok(numbers),
            _ => Err(OperatorError::Unreadable { node }),
        };
        let mut wishes = vec![("home.timeout_us", self.timeout_us().into())];
        if self.verify {
            wishes.push(("cycle.monitor_us", VERIFY_MONITOR_US.into()));
        }
        if let Some(v) = self.speed {
            let signed = real("joint.home_v_rad_s")?.into_iter().map(|before| (v as f32).copysign(before));
            wishes.push(("joint.home_v_rad_s", Numbers::Real(signed.collect())));
        }
        if let Some(share) = self.current {
            let slow = real("joint.current_max_a")?.into_iter().map(|max_a| share as f32 * max_a);
            wishes.push(("joint.slow_current_a", Numbers::Real(slow.collect())));
        }
        Ok(wishes)
    }
}

/// Runs the verb.
///
/// # Errors
/// The bus, a controller that refuses, a drive that does not find its zero; lost counts with `--verify`.
pub fn run(args: &Args) -> Result<(), ExpectedError> {
    let named = args.modules.as_ref().map(|modules| modules.0.as_slice());
    let adjust = |settings: &mut Settings| args.adjust(settings);
    let mut controlled = Controlled::open(&args.bus, &args.controller, named, &adjust)?;
    let mut joints = controlled.select(named)?;
    joints.sort_by_key(|(joint, _)| std::cmp::Reverse(joint.get()));
    // Refuses before anything moves.
    args.speeds(&mut controlled)?;
    // A controller of this program began with them.
    let wishes = if controlled.soft { Vec::new() } else { args.wishes(&mut controlled)? };
    let homed = controlled
        .change(wishes)
        .map_err(ExpectedError::from)
        .and_then(|()| home_all(args, &mut controlled, &joints));
    // A controller that is on the bus for others gets its own values back, also after a failure.
    let (rows, findings) = match (homed, controlled.put_back()) {
        (Err(why), Err(left)) => {
            return Err(why.also(left));
        }
        (homed, put_back) => {
            let homed = homed?;
            put_back?;
            homed
        }
    };
    controlled.finish()?;
    if args.json {
        print_json(&serde_json::json!({ "modules": rows }));
    }
    if findings.is_empty() {
        return Ok(());
    }
    Err(ExpectedError::new(
        exit::FINDINGS,
findings.join("\n")).next("what was thrown or taught since that zero is off by as much. Home once more with --verify: the second \
             run must agree. Look at the encoder's cable and supply if it comes again"))
}

/// Homes what is not homed, as `cubectl home` does, before a verb that speaks to the drives itself.
pub(in crate::cmd) fn home_first(bus: &BusArgs) -> Result<(), ExpectedError> {
    let args = Args {
        bus: BusArgs { record: None, ..bus.clone() },
        controller: ControllerArgs::default(),
        modules: None,
        force: false,
        verify: false,
        offset_max: 0.005,
        speed: None,
        current: None,
        timeout: 60.0,
        json: false,
    };
    run(&args)
}

/// What was done with each joint, and what was found.
type Rows = (Vec<serde_json::Value>, Vec<String>);

fn home_all(
    args: &Args,
    controlled: &mut Controlled,
    joints: &[(JointIndex, ModuleId)],
) -> Result<Rows, ExpectedError> {
    let node = controlled.node;
    let speeds = args.speeds(controlled)?;
    let limit = Duration::from_secs_f64(args.timeout);
    let (mut rows, mut findings) = (Vec::new(), Vec::new());
    for &(joint, module) in joints {
        let number = controlled.number(joint);
        let is_homed = controlled.session.group().is_some_and(|group| group.homed_mask & joint.bit() != 0);
        if is_homed && !args.force && !args.verify {
            if !args.json {
                console::line!("module {module}: homed already");
            }
            rows.push(
                serde_json::json!({ "module": module.get(), "joint": number, "skipped": "homed already" }),
            );
            continue;
        }
        let v_rad_s = speeds.as_ref().and_then(|speeds| speeds.get(joint.get())).map(|v| f64::from(v.abs()));
        if !args.json {
            let speed = v_rad_s.map_or(String::new(), |v_rad_s| format!(" at {v_rad_s:.2} rad/s"));
            console::note!("module {module}: homing{speed}; Ctrl-C halts");
        }
        // Without a zero before there is nothing to compare.
        let zero = v_rad_s.filter(|_| args.verify && is_homed).map(ZeroCheck::new);
        let what = format!("module {module}: looking for its zero");
        let at_most = format!("up to {:.0} s of the arm", args.timeout);
        let homed = while_working(&what, &at_most, |_| {
            controlled.session.home_joint(node, (joint, module), limit, zero)
        });
        let homed = homed.map_err(|error| at(module, controlled.renumbered(error)))?;
        if !args.json {
            console::line!(
                "module {module}: zero found in {:.1} s, stands at {:.4} rad, at most {:.1} A",
                homed.took.as_secs_f64(),
                homed.position_rad,
                homed.current_max_a
            );
        }
        let verdict = if args.verify { compared(&homed, args.offset_max) } else { Compared::default() };
        if let Some(text) = &verdict.text
            && !args.json
        {
            console::line!("module {module}: {text}");
        }
        findings.extend(verdict.finding.map(|text| format!("module {module}: {text}")));
        rows.push(serde_json::json!({
            "zero_offset_rad": homed.zero.map(|zero| zero.offset_rad),
            "zero_resolution_rad": homed.zero.map(|zero| zero.resolution_rad),
            "module": module.get(),
            "joint": number,
            "took_s": homed.took.as_secs_f64(),
            "position_rad": homed.position_rad,
            "current_max_a": homed.current_max_a,
        }));
    }
    Ok((rows, findings))
}

pub(in crate::cmd) fn at(module: ModuleId, error: OperatorError) -> ExpectedError {
    let stopped = matches!(error, OperatorError::Stopped { .. });
    let mut expected = ExpectedError::from(error);
    if stopped {
        expected.what = format!("module {module}: everything was halted; {}", expected.what);
    }
    expected
}

/// What `--verify` says of one module.
#[derive(Default)]
struct Compared {
    text: Option<String>,
    finding: Option<String>,
}

fn compared(homed: &Homed, offset_max_rad: f64) -> Compared {
    let Some(zero) = homed.zero else {
        let text = "the reading before cannot be compared: there was no zero, or the drive is not heard";
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

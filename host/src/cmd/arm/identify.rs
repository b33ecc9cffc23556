//! `cubectl arm identify`

use std::io::IsTerminal;
use std::path::PathBuf;

use can_link::BusSpec;
use indicatif::{ProgressBar, ProgressStyle};
use robot_model::RobotModel;

use crate::cmd::arm::home::home_first;
use crate::cmd::consent::Consent;
use crate::cmd::controller::registers;
use crate::cmd::meaning::{Deed, Given};
use crate::cmd::plan::follow::is_industrial;
use crate::cmd::print_json;
use crate::cmd::rsi::RobotIdentification;
use crate::cmd::survey::{modules_on, require_powercubes};
use crate::cmd::values::{positive, share, within};
use crate::error::ExpectedError;
use crate::exit;
use crate::report::identify as report;
use operator::bus::{BusArgs, Session};
use operator::identify::experiment::{Bounds, ExperimentError};
use operator::identify::joint::{JointError, JointExperiments, identify};
use operator::identify::mounting::{Mounting, Source};
use operator::interrupt::interrupt;
use planner::follow::limits::AXES;
use planner::plan::Arm;
use tuner::identify::findings::Findings;

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl arm identify --joint 2\n  cubectl arm identify --joint 2 --bus can0 --home --out joint2.toml --report joint2.html\n  cubectl arm identify --robot kr16_2 --bus rsi:udp://0.0.0.0:49152 --out robot.toml   # lag and gripper; empty hand\n\nThe joint turns to and fro at up to --speed-share of its largest speed, within its soft limits and where the robot model shows\nno collision; for K_M the others may be brought to a pose in which gravity loads it. Keep clear. On every bus but `sim` it asks\nfirst; without a terminal it needs --yes. Ctrl-C halts everything.\nExit code 9: something could not be concluded; the text says what and why."
)]
pub struct Args {
    #[command(flatten)]
    pub given: Given,
    /// Joint number from 1; not for an industrial robot, whose axes are measured together.
    #[arg(long)]
    pub joint: Option<usize>,
    /// Largest swing of the axes of an industrial robot, degrees.
    #[arg(long, default_value_t = 6.0, value_name = "DEG", value_parser = positive)]
    pub wiggle_deg: f64,
    /// Bus options; `--robot` names the model of the arm.
    #[command(flatten)]
    pub bus: BusArgs,
    /// Do not ask before the arm moves.
    #[arg(long)]
    pub yes: bool,
    /// Home what is not homed first.
    #[arg(long)]
    pub home: bool,
    /// Confidence level of the intervals [default: 0.95].
    #[arg(long, value_name = "SHARE", value_parser = below_one)]
    pub level: Option<f64>,
    /// Fastest run, as a share of the joint's largest speed [default: 0.8].
    #[arg(long = "speed-share", alias = "speed", id = "speed_share", value_name = "SHARE", value_parser = within(0.02..=1.0, ""))]
    pub speed: Option<f64>,
    /// Largest current, as a share of the module's own maximum [default: 0.8].
    #[arg(long = "current-share", alias = "current", id = "current_share", value_name = "SHARE", value_parser = share)]
    pub current: Option<f64>,
    /// Bit rate of the bus in bit/s, for the length of frames in the answer delay [default: 1000000].
    #[arg(long, value_name = "BIT_S", value_parser = positive)]
    pub bit_rate: Option<f64>,
    /// A file of `cubectl controller registers export` that says how the drives sit on their joints (joint.inverted, joint.offset_rad). Without
    /// it a controller that is heard is asked, with --beside; else every drive is taken to read the angle of its joint.
    #[arg(long, value_name = "FILE")]
    pub registers: Option<PathBuf>,
    /// Noise of the current readings on the bus `sim`, standard deviation in A [default: 0.05].
    #[arg(long = "sim-noise-a", alias = "sim-noise", id = "sim_noise_a", value_name = "A", value_parser = within(0.0..=f64::MAX, "A"))]
    pub sim_noise: Option<f64>,
    /// Write the changed keys of the robot file here (TOML).
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Write a report with scatter plots and residuals here (HTML).
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

fn below_one(text: &str) -> Result<f64, String> {
    positive(text).ok().filter(|value| *value < 1.0).ok_or("must be above 0 and below 1".to_owned())
}

impl From<JointError> for ExpectedError {
    fn from(error: JointError) -> Self {
        match error {
            JointError::Experiment(ExperimentError::Ask(operator::dialogue::ask::AskError::Interrupted)) => {
                Self::new(exit::INTERRUPTED, "interrupted; everything on the bus was halted")
            }
            JointError::Experiment(ExperimentError::Ask(error)) => error.into(),
            JointError::Experiment(error) => Self::of(exit::DRIVE, &error),
            JointError::NoDrives { .. } | JointError::NoSuchJoint { .. } | JointError::NoSuchDrive { .. } => {
                Self::bad_input(&error)
            }
        }
    }
}

/// The arm, if it is one that is led over RSI.
fn industrial(args: &Args) -> Result<Option<Arm>, ExpectedError> {
    let named = args.bus.cell.robot.as_deref();
    if matches!(args.bus.bus, BusSpec::Rsi(_)) {
        return crate::cmd::six_axes(named.unwrap_or("kr16_2")).map(Some);
    }
    match named.map(crate::cmd::robot).transpose()? {
        Some(arm) if arm.n() == AXES && is_industrial(&arm) => Ok(Some(arm)),
        _ => Ok(None),
    }
}

/// Runs the verb.
///
/// # Errors
/// Robot or joint, the bus, a drive, a blocked joint; or data that are too poor to conclude from (after the
/// report is written).
pub fn run(args: &Args) -> Result<(), ExpectedError> {
    let mut consent = Consent::on(&args.bus.bus, args.yes)?;
    if let Some(arm) = industrial(args)? {
        args.given.require_meaning(&[Deed::AllAxes])?;
        consent.require(
            "The robot swings all its axes as soon as its program runs. Hand empty, nobody near?",
            &interrupt(),
        )?;
        let Args { bus, wiggle_deg, out, json, .. } = args;
        let asked =
            RobotIdentification { bus, swing_rad: wiggle_deg.to_radians(), out: out.as_deref(), json: *json };
        return asked.run(&arm);
    }
    let joint = args
        .joint
        .ok_or_else(|| ExpectedError::bad_input(&"--joint is missing").next("name the joint, from 1"))?;
    consent.require("The joint turns to and fro, and others may move for it. Nobody near?", &interrupt())?;
    // Drives of the simulated cell are homed.
    if args.home && args.bus.bus != BusSpec::Sim {
        home_first(&args.bus)?;
    }
    let (mut session, robot) = open(args)?;
    session.watch_stops();
    require_powercubes(&mut session, &args.bus, &robot)?;
    modules_on(&mut session, None, args.bus.beside)?;
    let mounting = mounting(args, &mut session)?;
    let wish = JointExperiments {
        joint,
        bounds: Bounds {
            current_share: args.current.unwrap_or(0.8),
            speed_share: args.speed.unwrap_or(0.8),
            bit_rate_bit_s: args.bit_rate.unwrap_or(1e6),
        },
        level: args.level.unwrap_or(0.95),
    };
    let bar = progress_bar(args.json);
    let findings = identify(&mut session, &robot, &mounting, &wish, &mut |what, parts| {
        bar.set_length(parts as u64);
        bar.set_message(what.to_owned());
        bar.inc(1);
    });
    bar.finish_and_clear();
    let findings = findings?;
    session.finish()?;
    print(args, &findings)?;
    let refusals = findings.refusals();
    if refusals.is_empty() { Ok(()) } else { Err(ExpectedError::new(exit::FINDINGS, refusals.join("\n"))) }
}

/// The session and the robot; drives of the simulated cell are homed.
fn open(args: &Args) -> Result<(Session, RobotModel), ExpectedError> {
    let mut cell = args.bus.cell.load()?;
    if args.bus.bus == BusSpec::Sim {
        cell.setup.cell.drive.starts_homed = true;
        cell.setup.cell.drive.current_noise_a = args.sim_noise.unwrap_or(0.05);
    }
    let session = args.bus.open_cell(&cell, None)?;
    Ok((session, cell.robot))
}

/// How the drives sit on their joints: of a file, of a controller that is heard, or as the robot file has them.
fn mounting(args: &Args, session: &mut Session) -> Result<Mounting, ExpectedError> {
    if let Some(path) = &args.registers {
        let source = Source::File(path.display().to_string());
        return registers::mounting_in(path, source);
    }
    // Without --beside no controller is on the bus.
    let controller = if args.bus.beside { session.listen()?.controller } else { None };
    Ok(match controller {
        Some(node) => Mounting::of_controller(session, node)?,
        None => Mounting::assumed(),
    })
}

fn progress_bar(quiet: bool) -> ProgressBar {
    if quiet || !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new(0);
    if let Ok(style) = ProgressStyle::with_template("{bar:31} {pos}/{len} {msg}") {
        bar.set_style(style);
    }
    bar
}

/// Text or JSON, patch and report.
fn print(args: &Args, findings: &Findings) -> Result<(), ExpectedError> {
    let write = |path: &PathBuf, text: &str| {
        std::fs::write(path, text).map_err(|cause| ExpectedError::output(path, &cause))
    };
    if args.json {
        print_json(&json(findings));
    } else {
        console::text!("{}", findings.text());
    }
    if let Some(path) = &args.out {
        write(path, &findings.patch())?;
        console::note!("wrote {}", path.display());
    }
    if let Some(path) = &args.report {
        write(path, &report::html(findings))?;
        console::note!("wrote {}", path.display());
    }
    Ok(())
}

fn json(findings: &Findings) -> serde_json::Value {
    let estimate = |e: Option<&tuner::identify::regression::Estimate>| {
        e.map(|e| serde_json::json!({ "value": e.value, "half_width": e.half_width }))
    };
    let k_m = findings.k_m.as_ref().and_then(|k_m| k_m.as_ref().ok());
    let answer = findings.answer.as_ref().ok();
    serde_json::json!({
        "joint": findings.subject.joint,
        "joint_angles": findings.subject.mounting,
        "level": findings.level,
        "k_b_a_s_rad": estimate(findings.k_b.as_ref().ok().map(|k_b| &k_b.k)),
        "k_m_a_nm": estimate(k_m.map(|k_m| &k_m.k)),
        "friction_moving_a": estimate(findings.friction_a().as_ref()),
        "friction_holding_a": estimate(k_m.map(|k_m| &k_m.friction_a)),
        "natural_frequency_rad_s": estimate(answer.map(|a| &a.wn_rad_s)),
        "damping_ratio": estimate(answer.map(|a| &a.zeta)),
        "command_delay_s": estimate(answer.map(|a| &a.delay_s)),
        "total_lag_s": estimate(answer.map(|a| &a.total_lag_s)),
        "answer_delay_s": findings.answer_time.map(|t| serde_json::json!({
            "min": t.min_s, "mean": t.mean_s, "max": t.max_s, "count": t.count,
        })),
        "k_m_not_measured": findings.no_load(),
        "refused": findings.refusals(),
    })
}

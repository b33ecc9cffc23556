//! `cubectl tune`: feedback gains with a certificate.

mod apply;
mod trial;

use std::fmt::Write as _;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};

use can_link::BusSpec;
use indicatif::ProgressBar;
use protocol::cyphal::id::NodeId;
use rayon::prelude::*;
use robot_model::RobotModel;
use toml_reader::{DESCRIPTION_MAX_BYTES, read_text};

use crate::error::ExpectedError;
use crate::exit;
pub(in crate::cmd) use apply::InForce;
use apply::{ApplyError, OnBus, put};
use operator::bus::key_file::KeyArgs;
use operator::bus::settings::crc32_of;
use operator::bus::{BusArgs, Session};
use planner::plan::file::PlanFile;
use trial::built_in;
use tuner::gains::design::{Design, Tuned, tune};
use tuner::gains::gains_file::{FORMAT, GainsFile, GainsFileError};
use tuner::gains::machine::{Demand, Machine, MachineError, ReferenceProfile, inputs, usual_jitter};
use tuner::gains::picture;
use tuner::gains::trial::TrialMotion;
use tuner::model::Estimator;

/// Which design to use.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum DesignArg {
    /// Theorem 1 of the paper: continuous time, never saturates.
    Paper,
    /// Discrete time with delay and drive lag, saturation certified.
    Saturated,
}

/// Joints to tune: `all` or a number from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Joints {
    /// Every joint.
    All,
    /// One, from 1.
    One(usize),
}

impl std::str::FromStr for Joints {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "all" => Ok(Self::All),
            _ => match text.parse() {
                Ok(n) if n >= 1 => Ok(Self::One(n)),
                _ => Err("expected `all` or a joint number from 1".into()),
            },
        }
    }
}

/// Arguments of `cubectl tune`.
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl tune --plan throw.json --out gains.toml --pictures pictures\n  cubectl tune --period 17 --joint 2 --design paper\n  cubectl tune --plan throw.json --apply --bus can0\n  cubectl tune --rollback gains-before.toml --bus can0\n\n--apply keeps the gains from before in --backup; the controller takes gains only while nothing moves\nand nothing is armed."
)]
pub struct Args {
    /// Bus of the controller; `--robot` names the robot model.
    #[command(flatten)]
    pub bus: BusArgs,
    /// Key of the controller.
    #[command(flatten)]
    pub key: KeyArgs,
    /// Joint number from 1, or `all`.
    #[arg(long, default_value = "all")]
    pub joint: Joints,
    /// Command period in ms; the firmware refuses gains for another one.
    #[arg(long = "period", default_value_t = 3.0, value_name = "MS", allow_negative_numbers = true, value_parser = milliseconds)]
    pub period_ms: f64,
    /// Relative jitter of the period that the certificate covers [default: 2 ms, at least 0.1 and at most 0.25].
    #[arg(long, value_name = "RATIO", allow_negative_numbers = true)]
    pub jitter: Option<f64>,
    /// Largest delay from position sample to action of the command in ms [default: one period].
    #[arg(long = "delay", value_name = "MS", allow_negative_numbers = true, value_parser = milliseconds)]
    pub delay_ms: Option<f64>,
    /// Smallest delay in ms [default: the largest less the jitter].
    #[arg(long = "delay-min", value_name = "MS", allow_negative_numbers = true, value_parser = milliseconds)]
    pub delay_min_ms: Option<f64>,
    /// Weight of a measurement on the position error in the controller's estimator, above 0 to 1 [default: 0.6, from a
    /// period of 10 ms on 1].
    #[arg(long, value_name = "WEIGHT", allow_negative_numbers = true)]
    pub estimator_alpha: Option<f64>,
    /// Weight on the rate of the error [default: 0.2, from a period of 10 ms on 1].
    #[arg(long, value_name = "WEIGHT", allow_negative_numbers = true)]
    pub estimator_beta: Option<f64>,
    /// Plan whose accelerations are set aside for the reference (file of `cubectl plan throw`).
    #[arg(long, value_name = "PLAN", conflicts_with = "reference_share")]
    pub plan: Option<PathBuf>,
    /// Without a plan: share of the acceleration for control that a motion uses.
    #[arg(long, default_value_t = 0.8, value_name = "RATIO", allow_negative_numbers = true)]
    pub reference_share: f64,
    /// Initial position error to recover from, in rad.
    #[arg(long, default_value_t = 0.1, value_name = "RAD", allow_negative_numbers = true)]
    pub error_position: f64,
    /// Initial velocity error to recover from, in rad/s.
    #[arg(long, default_value_t = 0.1, value_name = "RAD_S", allow_negative_numbers = true)]
    pub error_velocity: f64,
    /// Design.
    #[arg(long, value_enum, default_value_t = DesignArg::Saturated)]
    pub design: DesignArg,
    /// Gains file to write.
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Folder for one picture per joint (SVG); made if it is not there.
    #[arg(long, value_name = "FOLDER")]
    pub pictures: Option<PathBuf>,
    /// Do not try the gains on the simulated cell.
    #[arg(long)]
    pub no_trial: bool,
    /// Write the gains to the controller on the bus, and read them back.
    #[arg(long)]
    pub apply: bool,
    /// Cyphal node-ID of the controller. Default: the one that is heard.
    #[arg(long, value_name = "NODE-ID", value_parser = super::upload::node_id)]
    pub controller: Option<NodeId>,
    /// Where --apply keeps the gains from before.
    #[arg(long, value_name = "FILE", default_value = "gains-before.toml")]
    pub backup: PathBuf,
    /// Put the gains of such a file back; nothing is designed.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["apply", "out", "pictures", "plan"])]
    pub rollback: Option<PathBuf>,
}

/// A time in ms. One that can only be meant in seconds is refused here; the rest is judged with the machine.
fn milliseconds(text: &str) -> Result<f64, String> {
    let ms: f64 = text.parse().map_err(|_| "not a number".to_owned())?;
    if ms > 0.0 && ms < 0.1 {
        return Err(format!("times are given in ms; {ms} s would be {}", 1e3 * ms));
    }
    Ok(ms)
}

/// Why `cubectl tune` stops.
#[derive(Debug, thiserror::Error)]
pub enum TuneError {
    /// Robot and motion.
    #[error(transparent)]
    Machine(#[from] MachineError),
    /// No such joint.
    #[error("robot {robot} has joints 1 to {joints}, not {asked}")]
    NoSuchJoint {
        /// Robot.
        robot: String,
        /// Joints it has.
        joints: usize,
        /// Asked for.
        asked: usize,
    },
    /// The share of the motion.
    #[error("--reference-share is {0}; it must be at least 0 and below 1")]
    Share(f64),
    /// A joint.
    #[error(transparent)]
    Design(#[from] tuner::gains::design::DesignError),
    /// The file just written does not read back.
    #[error("the gains do not verify after rounding to text: {0}; please report this")]
    File(#[from] GainsFileError),
    /// Writing.
    #[error("cannot write {path}: {cause}")]
    Write {
        /// File.
        path: PathBuf,
        /// From the system.
        cause: std::io::Error,
    },
    /// Drawing.
    #[error("cannot draw joint {joint}: {cause}")]
    Picture {
        /// Joint number.
        joint: usize,
        /// From the library.
        cause: String,
    },
}

impl From<TuneError> for ExpectedError {
    fn from(error: TuneError) -> Self {
        match error {
            TuneError::Write { .. } => Self::new(exit::OUTPUT, error.to_string()),
            TuneError::File(_) | TuneError::Picture { .. } => Self::new(exit::BUG, error.to_string()),
            _ => Self::bad_input(&error),
        }
    }
}

impl From<ApplyError> for ExpectedError {
    fn from(error: ApplyError) -> Self {
        Self::new(exit::DRIVE, error.to_string())
    }
}

/// Runs the verb.
///
/// # Errors
/// Bad input, a joint that cannot be tuned with the binding condition, files, or the controller.
pub fn run(args: &Args) -> Result<(), ExpectedError> {
    if let Some(path) = &args.rollback {
        return roll_back(args, path);
    }
    let work = Work::new(args)?;
    let bar = if std::io::stderr().is_terminal() { ProgressBar::no_length() } else { ProgressBar::hidden() };
    let tuned = work.design(args, &bar.with_message("designing"))?;
    console::text!("{}", table(&work.machine.robot, &work.demand, &tuned));
    let file = work.file(&tuned);
    write_files(args, &file, &tuned)?;
    let mut link =
        if args.apply || args.bus.bus != BusSpec::Sim { Some(ControllerOnBus::open(args)?) } else { None };
    let before = match &mut link {
        Some(link) => link.gains()?,
        None => built_in(),
    };
    if !args.no_trial {
        match trial::compare(&work.robot, &before, &file, &work.trial) {
            Ok(text) => console::text!("{text}"),
            Err(why) => console::line!("not tried on the simulated cell: {why}"),
        }
    }
    match link {
        Some(mut link) if args.apply => {
            let robot_crc32 = crc32_of(&work.robot);
            link.apply(&before, &before.with(&file, robot_crc32)?, &args.backup)?;
            Ok(link.session.finish()?)
        }
        Some(link) => Ok(link.session.finish()?),
        None => Ok(()),
    }
}

/// The gains file of `cubectl tune` with these words of its command line, for programs: nothing is printed, written or tried.
///
/// # Errors
/// A word is refused (exit code 2 of the program), bad input, or a joint that cannot be tuned, with the binding condition.
pub fn gains(words: &[String]) -> Result<GainsFile, ExpectedError> {
    let args: Args = super::words::parse("tune", words)?;
    if args.apply || args.rollback.is_some() || args.out.is_some() || args.pictures.is_some() {
        return Err(ExpectedError::bad_input(
            &"--apply, --rollback, --out and --pictures are for the program: run `cubectl tune`",
        ));
    }
    let work = Work::new(&args)?;
    let file = work.file(&work.design(&args, &ProgressBar::hidden())?);
    // As what is written to a file: what the text says must prove.
    Ok(GainsFile::from_toml(&file.to_toml(), &file.robot).map_err(TuneError::from)?)
}

/// What is designed for.
struct Work {
    robot: RobotModel,
    machine: Machine,
    motion: ReferenceProfile,
    demand: Demand,
    trial: TrialMotion,
}

/// Errors from which no feedback recovers: a whole turn, and more speed than any joint has.
const ERROR_MAX_RAD: f64 = 6.3;
const ERROR_MAX_RAD_S: f64 = 20.0;

impl Work {
    fn new(args: &Args) -> Result<Self, ExpectedError> {
        let cell = args.bus.cell.load()?;
        let (robot, source) = (cell.robot, cell.robot_source);
        let machine = Machine::from_robot(&robot).map_err(|e| ExpectedError::bad_input(&e))?;
        if !(0.0..1.0).contains(&args.reference_share) {
            return Err(TuneError::Share(args.reference_share).into());
        }
        if let Joints::One(asked) = args.joint
            && asked > machine.joints.len()
        {
            let (robot, joints) = (machine.robot, machine.joints.len());
            return Err(TuneError::NoSuchJoint { robot, joints, asked }.into());
        }
        let (motion, trial) = match &args.plan {
            Some(path) => {
                let plan = PlanFile::read(path).map_err(|e| ExpectedError::bad_input(&e))?;
                let arm = super::robot(&source)?;
                plan.require_robot(path, &arm).map_err(|e| ExpectedError::bad_input(&e))?;
                (trial::demands(&plan), trial::of_plan(&plan))
            }
            None => {
                let motion = ReferenceProfile::with_share(&machine, args.reference_share);
                let trial = trial::of_share(&robot, args.reference_share);
                (motion, trial)
            }
        };
        let period_s = 1e-3 * args.period_ms;
        let high_s = args.delay_ms.map_or(period_s, |ms| 1e-3 * ms);
        let jitter = args.jitter.unwrap_or_else(|| usual_jitter(period_s));
        let low_s = args.delay_min_ms.map_or((1.0 - jitter.clamp(0.0, 0.5)) * high_s, |ms| 1e-3 * ms);
        let usual = Estimator::usual(period_s);
        for (option, value, most) in [
            ("--error-position", args.error_position, ERROR_MAX_RAD),
            ("--error-velocity", args.error_velocity, ERROR_MAX_RAD_S),
        ] {
            if value > most {
                return Err(ExpectedError::bad_input(&format!("{option} {value} is above {most}")));
            }
        }
        let demand = Demand {
            period_s,
            period_jitter: jitter,
            delay_s: (low_s, high_s),
            estimator: Estimator {
                alpha: args.estimator_alpha.unwrap_or(usual.alpha),
                beta: args.estimator_beta.unwrap_or(usual.beta),
            },
            error_position_rad: args.error_position,
            error_velocity_rad_s: args.error_velocity,
        };
        Ok(Self { robot, machine, motion, demand, trial })
    }

    /// The designed gains as a file.
    fn file(&self, tuned: &[Tuned]) -> GainsFile {
        GainsFile {
            format: FORMAT,
            robot: self.machine.robot.clone(),
            period_s: self.demand.period_s,
            estimator: self.demand.estimator,
            joint: tuned.iter().map(Tuned::entry).collect(),
        }
    }

    /// Designs the joints asked for; the bar counts them.
    fn design(&self, args: &Args, bar: &ProgressBar) -> Result<Vec<Tuned>, TuneError> {
        let design = match args.design {
            DesignArg::Paper => Design::Paper,
            DesignArg::Saturated => Design::Saturated,
        };
        let wanted = |joint: usize| matches!(args.joint, Joints::All) || args.joint == Joints::One(joint);
        let all = inputs(&self.machine, &self.motion, &self.demand)?;
        let chosen: Vec<_> = all.iter().filter(|input| wanted(input.joint)).collect();
        bar.set_length(chosen.len() as u64);
        let tuned = chosen.into_par_iter().map(|input| {
            let tuned = tune(input, design);
            bar.inc(1);
            tuned
        });
        // All are awaited, so that the first joint that fails is the one reported.
        let tuned: Vec<_> = tuned.collect();
        bar.finish_and_clear();
        Ok(tuned.into_iter().collect::<Result<Vec<_>, _>>()?)
    }
}

/// Gains file and pictures.
fn write_files(args: &Args, file: &GainsFile, tuned: &[Tuned]) -> Result<(), TuneError> {
    if let Some(path) = &args.out {
        let toml = file.to_toml();
        // What is on disk must prove, not what was in memory.
        GainsFile::from_toml(&toml, &file.robot)?;
        std::fs::write(path, toml).map_err(|cause| TuneError::Write { path: path.clone(), cause })?;
        console::line!("wrote {} ({} joints, certificates verified)", path.display(), tuned.len());
    }
    if let Some(folder) = &args.pictures {
        std::fs::create_dir_all(folder).map_err(|cause| TuneError::Write { path: folder.clone(), cause })?;
        for joint in tuned {
            let number = joint.input.joint;
            let svg = picture::svg(joint).map_err(|cause| TuneError::Picture { joint: number, cause })?;
            let path = folder.join(format!("joint{number}.svg"));
            std::fs::write(&path, svg).map_err(|cause| TuneError::Write { path: path.clone(), cause })?;
            console::line!("wrote {}", path.display());
        }
    }
    Ok(())
}

/// A controller on the bus.
struct ControllerOnBus {
    session: Session,
    node: NodeId,
}

impl ControllerOnBus {
    fn open(args: &Args) -> Result<Self, ExpectedError> {
        let key = args.key.load()?;
        let mut session = args.bus.open_with_controller()?;
        session.set_key(key);
        let node = session.find_controller(args.controller)?;
        session.find_drives()?;
        Ok(Self { session, node })
    }

    fn registers(&mut self) -> OnBus<'_> {
        OnBus { session: &mut self.session, node: self.node }
    }

    fn gains(&mut self) -> Result<InForce, ExpectedError> {
        InForce::read(&mut self.registers()).map_err(|cause| ApplyError::Untouched(cause).into())
    }

    /// Keeps `before` in a file, then puts `wanted` in force.
    fn apply(&mut self, before: &InForce, wanted: &InForce, backup: &Path) -> Result<(), ExpectedError> {
        std::fs::write(backup, before.to_toml()).map_err(|cause| {
            let cause = format!("{}: {cause}; nothing was changed", backup.display());
            ExpectedError::new(exit::OUTPUT, cause)
        })?;
        put(&mut self.registers(), before, wanted)?;
        console::line!(
            "controller {}: gains in force and read back; from before: {} (--rollback {})",
            self.node.get(),
            backup.display(),
            backup.display()
        );
        Ok(())
    }
}

fn roll_back(args: &Args, path: &Path) -> Result<(), ExpectedError> {
    let text = read_text(path, DESCRIPTION_MAX_BYTES).map_err(|cause| ExpectedError::io(path, &cause))?;
    let wanted = InForce::from_toml(&text)
        .map_err(|cause| ExpectedError::bad_input(&format!("{}: {cause}", path.display())))?;
    let mut link = ControllerOnBus::open(args)?;
    let before = link.gains()?;
    let InForce { lags_us, a_max_rad_s2, .. } = before.clone();
    let wanted = InForce { lags_us, a_max_rad_s2, ..wanted };
    put(&mut link.registers(), &before, &wanted)?;
    console::line!(
        "controller {}: the gains of {} are in force and read back",
        link.node.get(),
        path.display()
    );
    Ok(link.session.finish()?)
}

/// Table for the terminal.
pub fn table(robot: &str, demand: &Demand, tuned: &[Tuned]) -> String {
    let mut t = format!(
        "{robot}, period {} ms +-{:.0} %, delay {:.2} to {:.2} ms, initial errors {} rad and {} rad/s\n",
        demand.period_s * 1e3,
        demand.period_jitter * 1e2,
        demand.delay_s.0 * 1e3,
        demand.delay_s.1 * 1e3,
        demand.error_position_rad,
        demand.error_velocity_rad_s
    );
    t += "joint    k_pos    k_vel   k_last  left rad/s2  decay 1/s  overshoot  settles s  delay margin ms   margin\n";
    for joint in tuned {
        let left = joint.problem.phases().iter().map(|p| p.u_max_rad_s2).fold(f64::INFINITY, f64::min);
        let (overshoot, settling) = match &joint.evidence {
            Some(e) => (format!("{:.1} %", 100.0 * e.overshoot), format!("{:.3}", e.settling_s)),
            None => ("-".into(), "-".into()),
        };
        let _ = writeln!(
            t,
            "{:>5} {:>8.2} {:>8.3} {:>8.4} {:>12.2} {:>10.2} {:>10} {:>10} {:>16.1} {:>8.1e}",
            joint.input.joint,
            joint.gains[0],
            joint.gains[1],
            joint.gains[2],
            left,
            joint.decay_1_s(),
            overshoot,
            settling,
            1e3 * joint.figures.delay_margin_s,
            joint.margin()
        );
    }
    t
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(clap::Parser)]
    struct Cli {
        #[command(flatten)]
        args: Args,
    }

    fn args(line: &str) -> Args {
        Cli::try_parse_from(std::iter::once("tune").chain(line.split_whitespace())).unwrap().args
    }

    /// Design and files, without a trial; the table.
    fn run_files(args: &Args) -> Result<String, ExpectedError> {
        let work = Work::new(args)?;
        let tuned = work.design(args, &ProgressBar::hidden())?;
        let (robot, demand) = (work.machine.robot.clone(), &work.demand);
        let (period_s, estimator) = (demand.period_s, demand.estimator);
        let joint = tuned.iter().map(Tuned::entry).collect();
        write_files(args, &GainsFile { format: FORMAT, robot, period_s, estimator, joint }, &tuned)?;
        Ok(table(&work.machine.robot, &work.demand, &tuned))
    }

    #[test]
    fn bad_arguments_end_in_a_sentence_that_names_them() {
        let table = [
            ("--period 0", "period is 0"),
            ("--period NaN", "period is not a finite number"),
            ("--period 10 --delay 11", "longer than the period"),
            ("--delay NaN", "largest delay is not a finite number"),
            ("--delay -1", "largest delay is -0.001"),
            ("--reference-share 1", "--reference-share is 1"),
            ("--reference-share NaN", "--reference-share is NaN"),
            ("--joint 7", "has joints 1 to 6, not 7"),
            ("--error-position -0.1", "initial position error is -0.1"),
            ("--jitter -1", "period jitter is -1"),
            ("--estimator-beta 1.5", "weight beta of the estimator is 1.5"),
            ("--robot nowhere.toml", "nowhere"),
        ];
        for (line, want) in table {
            let args = args(line);
            let message = match Work::new(&args) {
                Ok(work) => work.design(&args, &ProgressBar::hidden()).unwrap_err().to_string(),
                Err(error) => error.to_string(),
            };
            assert!(message.contains(want), "{line}: {message}");
        }
        for line in ["--joint 0", "--joint x", "--design best", "--period fast", "--period 0.003"] {
            assert!(Cli::try_parse_from(std::iter::once("tune").chain(line.split(' '))).is_err(), "{line}");
        }
    }

    #[test]
    fn one_joint_is_tuned_written_and_drawn() {
        let folder = std::env::temp_dir().join(format!("cubectl-tune-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let out = folder.join("gains.toml");
        let mut args = args("--joint 1 --period 17 --design paper --reference-share 0.5");
        // The folder for the pictures is made.
        let pictures = folder.join("new").join("pictures");
        (args.out, args.pictures) = (Some(out.clone()), Some(pictures.clone()));
        let text = run_files(&args).unwrap();
        assert_eq!(text.lines().filter(|l| l.trim_start().starts_with("1 ")).count(), 1, "{text}");
        let file = GainsFile::from_toml(&std::fs::read_to_string(&out).unwrap(), "powercube6").unwrap();
        assert_eq!(file.joint.len(), 1);
        assert!(std::fs::read_to_string(pictures.join("joint1.svg")).unwrap().starts_with("<svg"));
        args.out = Some(folder.join("missing").join("gains.toml"));
        assert_eq!(run_files(&args).unwrap_err().code, exit::OUTPUT);
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn gains_reach_the_soft_controller_and_the_old_ones_are_kept() {
        let folder = std::env::temp_dir().join(format!("cubectl-apply-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let backup = folder.join("before.toml");
        let mut args = args("--joint 4 --design paper --reference-share 0.5 --no-trial --apply");
        args.backup = backup.clone();
        run(&args).unwrap();
        let before = InForce::from_toml(&std::fs::read_to_string(&backup).unwrap()).unwrap();
        assert_eq!(before, built_in());
        // In another cell the rollback writes the values of the backup.
        args.rollback = Some(backup);
        run(&args).unwrap();
        // The soft controller runs at 3 ms.
        args.rollback = None;
        (args.period_ms, args.joint) = (17.0, Joints::All);
        let refused = run(&args).unwrap_err();
        assert!(refused.code == exit::DRIVE && refused.message.contains("3000 us"), "{refused}");
        std::fs::remove_dir_all(&folder).unwrap();
    }
}

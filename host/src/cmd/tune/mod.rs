//! `cubectl tune`: feedback gains with a certificate.

mod apply;
mod args;
mod compare;
mod shown;
mod trial;

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
pub use args::{Args, DesignArg, Joints};
use operator::bus::Session;
use operator::bus::settings::{crc32_of, settings_of};
use planner::plan::file::PlanFile;
use trial::{Named, Row, Throw};
use tuner::gains::choose::gains_for;
use tuner::gains::design::{Design, DesignError, Tuned, tune};
use tuner::gains::gains_file::{FORMAT, GainsFile, GainsFileError};
use tuner::gains::machine::{
    Demand, Machine, MachineError, ReferenceProfile, START_ERROR, inputs, usual_jitter,
};
use tuner::gains::saturated::SaturatedError;
use tuner::model::Estimator;

/// Why `cubectl tune` stops.
#[derive(Debug, thiserror::Error)]
pub enum TuneError {
    /// Robot and motion.
    #[error(transparent)]
    Machine(#[from] MachineError),
    #[error("robot {robot} has joints 1 to {joints}, not {asked}")]
    NoSuchJoint { robot: String, joints: usize, asked: usize },
    #[error("--reference-share is {0}; it must be at least 0 and below 1")]
    Share(f64),
    /// A joint.
    #[error(transparent)]
    Design(#[from] DesignError),
    /// The file just written does not read back.
    #[error("the gains do not verify after rounding to text: {0}; please report this")]
    File(#[from] GainsFileError),
    #[error("cannot write {path}: {cause}")]
    Write {
        /// File.
        path: PathBuf,
        /// From the system.
        cause: std::io::Error,
    },
}

impl From<TuneError> for ExpectedError {
    fn from(error: TuneError) -> Self {
        match error {
            TuneError::Write { ref cause, .. } => Self::new(exit::OUTPUT, error.to_string()).next_of(cause),
            TuneError::File(_) => Self::new(exit::BUG, error.to_string()),
            _ => Self::bad_input(&error.to_string()),
        }
    }
}

impl From<ApplyError> for ExpectedError {
    fn from(error: ApplyError) -> Self {
        Self { next: error.next().into_iter().collect(), ..Self::new(exit::DRIVE, error.to_string()) }
    }
}

pub fn run(args: &Args) -> Result<(), ExpectedError> {
    if let Some(path) = &args.rollback {
        return roll_back(args, path);
    }
    if !args.compare.is_empty() {
        return compare::run(args);
    }
    let bar = if std::io::stderr().is_terminal() { ProgressBar::no_length() } else { ProgressBar::hidden() };
    let (work, tuned, short) = Work::new(args)?.design_nearest(args, &bar.with_message("designing"))?;
    if !args.json {
        console::text!("{}", shown::table(&work.machine.robot, &work.demand, &tuned));
    }
    let file = work.file(&tuned);
    write_files(args, &file, &tuned)?;
    let apply = args.apply && short.is_none();
    let mut link =
        if apply || args.on.bus.bus != BusSpec::Sim { Some(ControllerOnBus::open(args)?) } else { None };
    let before = match &mut link {
        Some(link) => Some(("in the controller", link.gains()?)),
        None => work.shipped().map(|gains| ("shipped", gains)),
    };
    let tried = if args.no_trial { None } else { Some(work.try_out(before.as_ref(), &file)) };
    if args.json {
        super::print_json(&shown::json(&work, &tuned, tried.as_ref().and_then(|rows| rows.as_deref().ok())));
    } else {
        match &tried {
            Some(Ok(rows)) => console::text!("\n{}", trial::text(rows)),
            Some(Err(why)) => console::line!("not tried on the simulated cell: {why}"),
            None => {}
        }
    }
    if let Some(path) = &args.report {
        let rows = tried.and_then(Result::ok);
        let html = shown::page(&work, &tuned, short.as_ref(), rows.as_deref());
        std::fs::write(path, html).map_err(|cause| TuneError::Write { path: path.clone(), cause })?;
        console::note!("wrote {}", path.display());
    }
    match (link, before) {
        (Some(mut link), Some((_, before))) if apply => {
            let robot_crc32 = crc32_of(&work.robot);
            link.apply(&before, &before.with(&file, robot_crc32)?, &args.backup)?;
            link.session.finish()?;
        }
        (Some(link), _) => link.session.finish()?,
        (None, _) => {}
    }
    short.map_or(Ok(()), Err)
}

/// The gains file of `cubectl tune` for a robot and a request as JSON, for programs: nothing is printed, written or tried.
///
/// # Errors
/// A field is refused (exit code 2 of the program), bad input, or a joint that cannot be tuned, with the binding condition.
pub fn gains(robot: &str, request: &str) -> Result<GainsFile, ExpectedError> {
    let mut args: Args = super::request::read("tune", request)?;
    args.on.bus.cell.robot = Some(robot.to_owned());
    let work = Work::new(&args)?;
    let file = work.file(&work.design(&args, &ProgressBar::hidden())?);
    // As what is written to a file: what the text says must prove.
    Ok(GainsFile::from_toml(&file.to_toml(), &file.robot).map_err(TuneError::from)?)
}

/// What is designed for.
struct Work {
    /// Name or file of the robot.
    source: String,
    robot: RobotModel,
    machine: Machine,
    motion: ReferenceProfile,
    demand: Demand,
    trial: Throw,
}

/// Errors from which no feedback recovers: a whole turn, and more speed than any joint has.
const ERROR_MAX_RAD: f64 = 6.3;
const ERROR_MAX_RAD_S: f64 = 20.0;

impl Work {
    fn new(args: &Args) -> Result<Self, ExpectedError> {
        let cell = args.on.bus.cell.load()?;
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
                let name = path.display().to_string();
                (trial::demands(&plan), Throw { name, motion: trial::of_plan(&plan) })
            }
            None => {
                let motion = ReferenceProfile::with_share(&machine, args.reference_share);
                let name = format!("swing, {:.0} %", 1e2 * args.reference_share);
                (motion, Throw { name, motion: trial::of_share(&robot, args.reference_share) })
            }
        };
        let period_s = 1e-3 * args.period_ms;
        let high_s = args.delay_ms.map_or(period_s, |ms| 1e-3 * ms);
        let jitter = args.jitter.unwrap_or_else(|| usual_jitter(period_s));
        let low_s = args.delay_min_ms.map_or((1.0 - jitter.clamp(0.0, 0.5)) * high_s, |ms| 1e-3 * ms);
        let usual = Estimator::usual(period_s);
        let position_rad = args.error.first().copied().unwrap_or(START_ERROR);
        let velocity_rad_s = args.error.get(1).copied().unwrap_or(position_rad);
        for (value, most, unit) in
            [(position_rad, ERROR_MAX_RAD, "rad"), (velocity_rad_s, ERROR_MAX_RAD_S, "rad/s")]
        {
            if value > most {
                return Err(ExpectedError::bad_input(&format!(
                    "--error {value} {unit} is above {most} {unit}"
                )));
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
            error_position_rad: position_rad,
            error_velocity_rad_s: velocity_rad_s,
        };
        Ok(Self { source, robot, machine, motion, demand, trial })
    }

    /// What `throw` takes for this robot at this period; `None` where it has nothing.
    fn shipped(&self) -> Option<InForce> {
        let us = (1e6 * self.demand.period_s).round() as u32;
        let (file, _) = gains_for(&self.robot, us).ok()?;
        InForce::of(&settings_of(&self.robot).ok()?).with(&file, crc32_of(&self.robot)).ok()
    }

    /// The design, what it replaces and the yardsticks in the same throw on the simulated cell.
    fn try_out(&self, before: Option<&(&str, InForce)>, file: &GainsFile) -> Result<Vec<Row>, ExpectedError> {
        let of_robot = settings_of(&self.robot).map_err(|why| ExpectedError::bad_input(&why))?;
        let under = before.map_or_else(|| InForce::of(&of_robot), |(_, gains)| gains.clone());
        let after = under.with(file, crc32_of(&self.robot)).map_err(ExpectedError::from)?;
        let named = |name: &str, gains: &InForce| Named { name: name.to_owned(), gains: gains.clone() };
        let mut sets: Vec<Named> = before.map(|(name, gains)| named(name, gains)).into_iter().collect();
        sets.push(named("this design", &after));
        sets.extend(trial::yardsticks(&after, file));
        Ok(trial::simulate(&self.robot, &of_robot, &sets, std::slice::from_ref(&self.trial)))
    }

    fn file(&self, tuned: &[Tuned]) -> GainsFile {
        GainsFile {
            format: FORMAT,
            robot: self.machine.robot.clone(),
            period_s: self.demand.period_s,
            estimator: self.demand.estimator,
            joint: tuned.iter().map(Tuned::entry).collect(),
        }
    }

    /// The design as asked; where the errors are too large for it, that for the largest ones that can be certified, with what
    /// to report at the end.
    fn design_nearest(
        mut self,
        args: &Args,
        bar: &ProgressBar,
    ) -> Result<(Self, Vec<Tuned>, Option<ExpectedError>), TuneError> {
        let mut first: Option<String> = None;
        loop {
            let why = match self.design(args, bar) {
                Ok(tuned) => {
                    let short = first.map(|cause| short_of(&self.demand, &cause));
                    return Ok((self, tuned, short));
                }
                Err(why) => why,
            };
            let TuneError::Design(DesignError::Saturated(SaturatedError::SaturationBinds {
                radius_rad,
                feasible_radius_rad,
                ..
            })) = &why
            else {
                return Err(why);
            };
            // Three figures to type. What they stand for is designed and proven before it is named.
            let figures = 10f64.powf(2.0 - feasible_radius_rad.log10().floor());
            let nearest_rad = (feasible_radius_rad * figures).floor() / figures;
            self.demand.error_velocity_rad_s *= nearest_rad / radius_rad;
            self.demand.error_position_rad = nearest_rad;
            first.get_or_insert_with(|| why.to_string());
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

/// What is reported when the gains are for smaller errors than asked for.
fn short_of(demand: &Demand, cause: &str) -> ExpectedError {
    let (position_rad, velocity_rad_s) = (demand.error_position_rad, demand.error_velocity_rad_s);
    let next = format!(
        "the gains above are certified for {position_rad} rad and {velocity_rad_s:.4} rad/s, the largest errors of that shape; take \
         them with --error {position_rad} {velocity_rad_s:.4}, or plan a slower motion"
    );
    ExpectedError::new(exit::FINDINGS, cause).next(next)
}

fn write_files(args: &Args, file: &GainsFile, tuned: &[Tuned]) -> Result<(), TuneError> {
    if let Some(path) = &args.out {
        let toml = file.to_toml();
        // What is on disk must prove, not what was in memory.
        GainsFile::from_toml(&toml, &file.robot)?;
        std::fs::write(path, toml).map_err(|cause| TuneError::Write { path: path.clone(), cause })?;
        console::note!("wrote {} ({} joints, certificates verified)", path.display(), tuned.len());
    }
    Ok(())
}

struct ControllerOnBus {
    session: Session,
    node: NodeId,
}

impl ControllerOnBus {
    fn open(args: &Args) -> Result<Self, ExpectedError> {
        let (session, node) = args.on.open()?;
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
            let what = format!("{}: {cause}; nothing was changed", backup.display());
            ExpectedError::new(exit::OUTPUT, what).next_of(&cause)
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

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(clap::Parser)]
    struct Cli {
        #[command(flatten)]
        args: Args,
    }

    pub(super) fn args(line: &str) -> Args {
        Cli::try_parse_from(std::iter::once("tune").chain(line.split_whitespace())).unwrap().args
    }

    /// The design of a command line.
    pub(super) fn designed(args: &Args) -> (Work, GainsFile) {
        let work = Work::new(args).unwrap();
        let file = work.file(&work.design(args, &ProgressBar::hidden()).unwrap());
        (work, file)
    }

    /// Design and files, without a trial; the table.
    fn run_files(args: &Args) -> Result<String, ExpectedError> {
        let work = Work::new(args)?;
        let tuned = work.design(args, &ProgressBar::hidden())?;
        let (robot, demand) = (work.machine.robot.clone(), &work.demand);
        let (period_s, estimator) = (demand.period_s, demand.estimator);
        let joint = tuned.iter().map(Tuned::entry).collect();
        write_files(args, &GainsFile { format: FORMAT, robot, period_s, estimator, joint }, &tuned)?;
        Ok(shown::table(&work.machine.robot, &work.demand, &tuned))
    }

    #[test]
    fn bad_arguments_end_in_a_sentence_that_names_them() {
        let table = [
            ("--period-ms 0", "period is 0"),
            ("--period-ms NaN", "period is not a finite number"),
            ("--period-ms 10 --delay-ms 11", "longer than the period"),
            ("--delay-ms NaN", "largest delay is not a finite number"),
            ("--delay-ms -1", "largest delay is -0.001"),
            ("--reference-share 1", "--reference-share is 1"),
            ("--reference-share NaN", "--reference-share is NaN"),
            ("--joint 7", "has joints 1 to 6, not 7"),
            ("--error -0.1", "initial position error is -0.1"),
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
        for line in ["--joint 0", "--joint x", "--design best", "--period-ms fast", "--period-ms 0.003"] {
            assert!(Cli::try_parse_from(std::iter::once("tune").chain(line.split(' '))).is_err(), "{line}");
        }
    }

    #[test]
    fn one_joint_is_tuned_and_written() {
        let folder = std::env::temp_dir().join(format!("cubectl-tune-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let out = folder.join("gains.toml");
        let mut args = args("--joint 1 --period-ms 17 --design paper --reference-share 0.5");
        args.out = Some(out.clone());
        let text = run_files(&args).unwrap();
        assert_eq!(text.lines().filter(|l| l.trim_start().starts_with("1 ")).count(), 1, "{text}");
        let file = GainsFile::from_toml(&std::fs::read_to_string(&out).unwrap(), "powercube6").unwrap();
        assert_eq!(file.joint.len(), 1);
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
        assert_eq!(before, InForce::of(&firmware::settings::Settings::powercube6()));
        // In another cell the rollback writes the values of the backup.
        args.rollback = Some(backup);
        run(&args).unwrap();
        // The soft controller runs at 3 ms.
        args.rollback = None;
        (args.period_ms, args.joint) = (17.0, Joints::All);
        let refused = run(&args).unwrap_err();
        assert!(refused.code == exit::DRIVE && refused.what.contains("3000 us"), "{refused}");
        std::fs::remove_dir_all(&folder).unwrap();
    }
}

//! `cubectl tune`: feedback gains with a certificate.

use crate::tune::design::{Design, Tuned, tune};
use crate::tune::gains_file::{FORMAT, GainsFile, GainsFileError};
use crate::tune::machine::{Demand, Machine, MachineError, Motion, inputs};
use crate::tune::picture;
use crate::tune::saturated::Gains;
use robot_model::AnyRobot;
use std::fmt::Write as _;
use std::path::PathBuf;

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
#[command(after_help = "Examples:\n  cubectl tune --joint all\n  cubectl tune --joint 2 --period 0.017")]
pub struct Args {
    /// Robot: built-in name or path of a robot file.
    #[arg(long, default_value = "powercube6")]
    pub robot: String,
    /// Joint number from 1, or `all`.
    #[arg(long, default_value = "all")]
    pub joint: Joints,
    /// Command period in s; the firmware refuses gains for another one.
    #[arg(long, default_value_t = 0.003, value_name = "S")]
    pub period: f64,
    /// Relative jitter of the period.
    #[arg(long, default_value_t = 0.02, value_name = "RATIO")]
    pub jitter: f64,
    /// Largest delay from position sample to action of the command in s [default: one period].
    #[arg(long, value_name = "S")]
    pub delay: Option<f64>,
    /// Smallest delay in s [default: 95 % of the largest].
    #[arg(long, value_name = "S")]
    pub delay_min: Option<f64>,
    /// Share of the acceleration for control that the motion uses.
    #[arg(long, default_value_t = 0.8, value_name = "RATIO")]
    pub reference_share: f64,
    /// Initial position error to recover from, in rad.
    #[arg(long, default_value_t = 0.1, value_name = "RAD")]
    pub error_position: f64,
    /// Initial velocity error to recover from, in rad/s.
    #[arg(long, default_value_t = 0.1, value_name = "RAD_S")]
    pub error_velocity: f64,
    /// Design.
    #[arg(long, value_enum, default_value_t = DesignArg::Saturated)]
    pub design: DesignArg,
    /// Gains file to write.
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Folder for one picture per joint (SVG).
    #[arg(long, value_name = "FOLDER")]
    pub pictures: Option<PathBuf>,
}

/// Where finished gains go: registers of a controller, a simulated cell, a file.
///
/// Writing is bumpless on the other side (the controller changes gains between two commands and
/// keeps the last command as its state); this side verifies by reading back and rolls back.
pub trait GainsTarget {
    /// What goes wrong on the way.
    type Error: std::fmt::Display;
    /// Period the target runs at, s.
    ///
    /// # Errors
    /// Of the transport.
    fn period_s(&mut self) -> Result<f64, Self::Error>;
    /// Gains in force.
    ///
    /// # Errors
    /// Of the transport.
    fn read(&mut self, joint: usize) -> Result<Gains, Self::Error>;
    /// Puts gains in force.
    ///
    /// # Errors
    /// Of the transport.
    fn write(&mut self, joint: usize, gains: Gains) -> Result<(), Self::Error>;
}

/// Why gains are not in force.
#[derive(Debug, PartialEq, thiserror::Error)]
pub enum ApplyError {
    /// The target runs at another period.
    #[error("the controller runs at {found} s, the gains are for {wanted} s; tune with --period {found}")]
    Period {
        /// Of the controller.
        found: f64,
        /// Of the gains.
        wanted: f64,
    },
    /// Writing or reading back failed; the gains from before are in force again.
    #[error("joint {joint}: {cause}; the gains from before are in force again")]
    RolledBack {
        /// Joint number.
        joint: usize,
        /// What happened.
        cause: String,
    },
    /// As before, and the way back failed too.
    #[error(
        "joint {joint}: {cause}; rolling back failed as well ({second}): the joints hold mixed gains, do not arm"
    )]
    Mixed {
        /// Joint number.
        joint: usize,
        /// What happened first.
        cause: String,
        /// What happened on the way back.
        second: String,
    },
    /// Nothing was written.
    #[error("nothing was changed: {0}")]
    Untouched(String),
}

/// Writes all gains of a verified file, reads each back, and restores the old ones on any failure.
///
/// # Errors
/// [`ApplyError`] says what is in force.
pub fn apply<T: GainsTarget>(file: &GainsFile, target: &mut T) -> Result<(), ApplyError> {
    let untouched = |e: T::Error| ApplyError::Untouched(e.to_string());
    let found = target.period_s().map_err(untouched)?;
    // Registers hold f32: equal up to its rounding.
    if (found - file.period_s).abs() > 1e-6 * file.period_s {
        return Err(ApplyError::Period { found, wanted: file.period_s });
    }
    let mut before = Vec::with_capacity(file.joint.len());
    for joint in &file.joint {
        before.push((
            joint.number,
            target.read(joint.number).map_err(|e| ApplyError::Untouched(e.to_string()))?,
        ));
    }
    for (i, joint) in file.joint.iter().enumerate() {
        let outcome =
            target.write(joint.number, joint.gains()).map_err(|e| e.to_string()).and_then(|()| match target
                .read(joint.number)
            {
                Ok(back) if back == joint.gains() => Ok(()),
                Ok(back) => Err(format!("reads back {back:?} instead of {:?}", joint.gains())),
                Err(e) => Err(e.to_string()),
            });
        if let Err(cause) = outcome {
            // The failed joint may hold either: it is restored as well.
            for (number, gains) in &before[..=i] {
                if let Err(second) = target.write(*number, *gains) {
                    return Err(ApplyError::Mixed { joint: joint.number, cause, second: second.to_string() });
                }
            }
            return Err(ApplyError::RolledBack { joint: joint.number, cause });
        }
    }
    Ok(())
}

/// Why `cubectl tune` stops.
#[derive(Debug, thiserror::Error)]
pub enum TuneError {
    /// The robot file.
    #[error(transparent)]
    Robot(#[from] robot_model::LoadError),
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
    Design(#[from] crate::tune::design::DesignError),
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

/// Tunes, writes the files asked for and returns the text for the terminal.
///
/// # Errors
/// [`TuneError`].
pub fn run(args: &Args) -> Result<String, TuneError> {
    let machine = Machine::from_robot(&AnyRobot::load(&args.robot)?)?;
    if !(0.0..1.0).contains(&args.reference_share) {
        return Err(TuneError::Share(args.reference_share));
    }
    let motion = Motion::with_share(&machine, args.reference_share);
    run_for(args, &machine, &motion)
}

/// As [`run`], for a machine and a motion at hand.
///
/// # Errors
/// [`TuneError`].
pub fn run_for(args: &Args, machine: &Machine, motion: &Motion) -> Result<String, TuneError> {
    let high = args.delay.unwrap_or(args.period);
    let demand = Demand {
        period_s: args.period,
        period_jitter: args.jitter,
        delay_s: (args.delay_min.unwrap_or(0.95 * high), high),
        error_position_rad: args.error_position,
        error_velocity_rad_s: args.error_velocity,
    };
    let design = match args.design {
        DesignArg::Paper => Design::Paper,
        DesignArg::Saturated => Design::Saturated,
    };
    if let Joints::One(asked) = args.joint
        && asked > machine.joints.len()
    {
        return Err(TuneError::NoSuchJoint {
            robot: machine.robot.clone(),
            joints: machine.joints.len(),
            asked,
        });
    }
    let wanted = |joint: usize| matches!(args.joint, Joints::All) || args.joint == Joints::One(joint);
    let mut tuned = Vec::new();
    for input in inputs(machine, motion, &demand)?.iter().filter(|i| wanted(i.joint)) {
        tuned.push(tune(input, design)?);
    }
    let mut text = table(&machine.robot, &demand, &tuned);
    if let Some(path) = &args.out {
        let joint = tuned.iter().map(Tuned::entry).collect();
        let file =
            GainsFile { format: FORMAT, robot: machine.robot.clone(), period_s: demand.period_s, joint };
        let toml = file.to_toml();
        // What is on disk must prove, not what was in memory.
        GainsFile::from_toml(&toml, &machine.robot)?;
        std::fs::write(path, toml).map_err(|cause| TuneError::Write { path: path.clone(), cause })?;
        let _ = writeln!(text, "wrote {} ({} joints, certificates verified)", path.display(), tuned.len());
    }
    if let Some(folder) = &args.pictures {
        for joint in &tuned {
            let number = joint.input.joint;
            let svg = picture::svg(joint).map_err(|cause| TuneError::Picture { joint: number, cause })?;
            let path = folder.join(format!("joint{number}.svg"));
            std::fs::write(&path, svg).map_err(|cause| TuneError::Write { path: path.clone(), cause })?;
            let _ = writeln!(text, "wrote {}", path.display());
        }
    }
    Ok(text)
}

/// Table for the terminal.
pub fn table(robot: &str, demand: &Demand, tuned: &[Tuned]) -> String {
    let mut t = format!(
        "{robot}, period {} ms +-{} %, delay {:.2} to {:.2} ms, initial errors {} rad and {} rad/s\n",
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

    #[test]
    fn bad_arguments_end_in_a_sentence_that_names_them() {
        let table = [
            ("--period 0", "period is 0"),
            ("--period NaN", "period is not a finite number"),
            ("--period 0.01 --delay 0.011", "longer than the period"),
            ("--reference-share 1", "--reference-share is 1"),
            ("--reference-share NaN", "--reference-share is NaN"),
            ("--joint 7", "has joints 1 to 6, not 7"),
            ("--error-position=-0.1", "initial position error is -0.1"),
            ("--jitter=-1", "period jitter is -1"),
            ("--robot nowhere.toml", "nowhere"),
        ];
        for (line, want) in table {
            let message = run(&args(line)).unwrap_err().to_string();
            assert!(message.contains(want), "{line}: {message}");
        }
        for line in ["--joint 0", "--joint x", "--design best", "--period fast"] {
            assert!(Cli::try_parse_from(std::iter::once("tune").chain(line.split(' '))).is_err(), "{line}");
        }
    }

    #[test]
    fn one_joint_is_tuned_written_and_drawn() {
        let folder = std::env::temp_dir().join(format!("cubectl-tune-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let out = folder.join("gains.toml");
        let mut args = args("--joint 1 --period 0.017 --design paper --reference-share 0.5");
        (args.out, args.pictures) = (Some(out.clone()), Some(folder.clone()));
        let text = run(&args).unwrap();
        assert_eq!(text.lines().filter(|l| l.trim_start().starts_with("1 ")).count(), 1, "{text}");
        let file = GainsFile::from_toml(&std::fs::read_to_string(&out).unwrap(), "powercube6").unwrap();
        assert_eq!(file.joint.len(), 1);
        assert!(std::fs::read_to_string(folder.join("joint1.svg")).unwrap().starts_with("<svg"));
        args.out = Some(folder.join("missing").join("gains.toml"));
        assert!(matches!(run(&args), Err(TuneError::Write { .. })));
        std::fs::remove_dir_all(&folder).unwrap();
    }

    /// Registers in memory with faults on demand.
    struct Registers {
        period_s: f64,
        gains: [Gains; 2],
        /// Writes left before one fails.
        writes_left: usize,
        /// Joint whose register does not take what is written.
        deaf: Option<usize>,
    }

    impl GainsTarget for Registers {
        type Error = String;

        fn period_s(&mut self) -> Result<f64, String> {
            Ok(self.period_s)
        }

        fn read(&mut self, joint: usize) -> Result<Gains, String> {
            self.gains.get(joint - 1).copied().ok_or_else(|| "no answer".into())
        }

        fn write(&mut self, joint: usize, gains: Gains) -> Result<(), String> {
            self.writes_left = self.writes_left.checked_sub(1).ok_or("no answer")?;
            if self.deaf != Some(joint) {
                self.gains[joint - 1] = gains;
            }
            Ok(())
        }
    }

    fn two_joints() -> GainsFile {
        let machine = Machine::from_robot(&AnyRobot::load("powercube6").unwrap()).unwrap();
        let motion = Motion::with_share(&machine, 0.5);
        let data = inputs(&machine, &motion, &Demand::with_period(0.017)).unwrap();
        let joint = data[..2].iter().map(|i| tune(i, Design::Paper).unwrap().entry()).collect();
        GainsFile { format: FORMAT, robot: machine.robot, period_s: 0.017, joint }
    }

    #[test]
    fn gains_go_in_together_or_not_at_all() {
        let file = two_joints();
        let old = [[-1.0, -2.0, 0.0], [-3.0, -4.0, 0.0]];
        let fresh = || Registers { period_s: f64::from(0.017f32), gains: old, writes_left: 9, deaf: None };

        let mut target = fresh();
        apply(&file, &mut target).unwrap();
        assert_eq!(target.gains, [file.joint[0].gains(), file.joint[1].gains()]);

        let mut target = Registers { period_s: 0.003, ..fresh() };
        assert!(matches!(apply(&file, &mut target), Err(ApplyError::Period { .. })));
        assert_eq!(target.gains, old);

        let mut target = Registers { deaf: Some(2), ..fresh() };
        assert!(matches!(apply(&file, &mut target), Err(ApplyError::RolledBack { joint: 2, .. })));
        assert_eq!(target.gains, old);

        // The link breaks for good after the first write: nobody can roll back, and it is said.
        let mut target = Registers { writes_left: 1, ..fresh() };
        assert!(matches!(apply(&file, &mut target), Err(ApplyError::Mixed { joint: 2, .. })));
    }
}

//! All experiments on one joint, in order, and the way back.

use firmware::settings::JointSettings;
use robot_model::RobotModel;
use robot_model::collision::Scene;

use super::experiment::{Bounds, Experiment, ExperimentError};
use super::mounting::Mounting;
use crate::bus::Session;
use tuner::identify::findings::{Findings, Holds, Measured, Subject};
use tuner::identify::poses::{HOLDS, Ways};
use tuner::model::DriveLag;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointExperiments {
    /// Joint number from 1.
    pub joint: usize,
    /// Bounds of the motion.
    pub bounds: Bounds,
    /// Confidence level of the intervals.
    pub level: f64,
}

/// Why nothing was measured.
#[derive(Debug, thiserror::Error)]
pub enum JointError {
    /// On the bus.
    #[error(transparent)]
    Experiment(#[from] ExperimentError),
    #[error("robot {robot} has no drives; give each [[joint]] of its file a [joint.drive] table")]
    NoDrives { robot: String },
    #[error("robot {robot} has joints 1 to {joints}, not {asked}")]
    NoSuchJoint { robot: String, joints: usize, asked: usize },
    /// The settings are of another arm.
    #[error(
        "{source_of_it} know no drive of address {address}, which robot {robot} has at joint {joint}; nothing moved"
    )]
    NoSuchDrive { source_of_it: String, robot: String, joint: usize, address: u8 },
}

impl JointError {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        Some(match self {
            Self::NoSuchDrive { .. } => "name the \
         robot of this arm with --robot, or the settings of its controller with --registers"
                .to_owned(),
            Self::Experiment(error) => return error.next(),
            _ => return None,
        })
    }
}

/// Measures and evaluates; `progress` gets the part that begins and the largest number of parts.
///
/// The arm ends where it began. `mounting` gives the angle of a joint that a drive reads.
///
/// # Errors
/// [`JointError`]; what moved was halted.
pub fn identify(
    session: &mut Session,
    model: &RobotModel,
    mounting: &Mounting,
    wish: &JointExperiments,
    progress: &mut dyn FnMut(&str, usize),
) -> Result<Findings, JointError> {
    let robot = model.name().to_owned();
    let no_drives = || JointError::NoDrives { robot: robot.clone() };
    let drives = model.drives().ok_or_else(no_drives)?;
    let n = model.n();
    if !(1..=n).contains(&wish.joint) {
        return Err(JointError::NoSuchJoint { robot, joints: n, asked: wish.joint });
    }
    let joint = wish.joint - 1;
    let mounted: Vec<JointSettings> = drives
        .iter()
        .zip(1..)
        .map(|(drive, number)| {
            mounting.joint(drive.address).ok_or_else(|| JointError::NoSuchDrive {
                source_of_it: mounting.source().to_string(),
                robot: robot.clone(),
                joint: number,
                address: drive.address,
            })
        })
        .collect::<Result<_, _>>()?;
    let bus = session.name().to_owned();
    let mut parts = Experiment::parts(true, n);
    let mut begun = 0;
    let mut report = |what: &str| {
        begun += 1;
        parts = parts.max(begun);
        progress(what, parts);
    };
    let mut experiment = Experiment::new(session, model, mounted, joint, wish.bounds, &mut report)?;
    let measured = match measure(&mut experiment, model, joint) {
        Ok(measured) => {
            experiment.finish();
            measured
        }
        Err(error) => return Err(experiment.abort(error).into()),
    };
    let drive = model.drive_loop().map_or(DriveLag::POWERCUBE, |servo| DriveLag {
        wn_rad_s: servo.natural_frequency_rad_s,
        zeta: servo.damping_ratio,
    });
    let subject = Subject {
        robot,
        bus,
        joint: wish.joint,
        name: model.joints()[joint].name.clone(),
        module: drives[joint].module.clone(),
        address: drives[joint].address,
        mounting: mounting.to_string(),
        k_b_a_s_rad: drives[joint].k_b_a_s_rad,
        k_m_a_nm: drives[joint].k_m_a_nm,
        drive,
    };
    Ok(Findings::of(subject, measured, wish.level))
}

fn measure(
    experiment: &mut Experiment<'_>,
    model: &RobotModel,
    joint: usize,
) -> Result<Measured, ExperimentError> {
    let scene = Scene::default();
    let mut ways = Ways::new(model, &scene);
    let start = experiment.positions()?;
    let sweep = ways.sweep(&start, joint);
    let scatter_a = experiment.scatter_a()?;
    let steps = experiment.steps(&sweep)?;
    let speeds = experiment.speeds(&sweep)?;
    let speed_load_nm = ways.mean_load_nm(&start, joint, &speeds.stretch);
    experiment.go(&start, &[joint])?;
    let k_m_a_nm = model.drives().map_or(0.0, |drives| drives[joint].k_m_a_nm);
    let (loading, largest_nm) = ways.loading(&start, joint);
    let holds = match loading {
        None => Holds::NotLoaded,
        Some(_) if !Holds::are_worth(largest_nm, k_m_a_nm, scatter_a, 2 * HOLDS) => {
            Holds::BelowNoise { largest_nm, expected_a: k_m_a_nm * largest_nm, scatter_a }
        }
        Some(loading) => {
            experiment.go(&loading.pose, &loading.order)?;
            let samples = experiment.holds(&loading.holds_rad)?;
            experiment.go(&start, &[joint])?;
            let back: Vec<usize> = loading.order.iter().rev().copied().collect();
            experiment.go(&start, &back)?;
            Holds::Measured { samples, largest_nm }
        }
    };
    let speed_max_rad_s = model.joints()[joint].limits.v_max_rad_s;
    Ok(Measured { speeds, speed_load_nm, speed_max_rad_s, holds, steps })
}

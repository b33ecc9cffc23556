//! `gains.toml`: gains with their certificates, versioned, refused unless everything proves again.

use super::certificate::{Region, SaturatedCertificate, SaturatedRefusal};
use super::law::{Gains, Weights};
use super::paper::{PaperCertificate, PaperRefusal, System, largest_decay};
use super::problem::{JointInput, PhaseInput, Problem, ProblemError};
use crate::model::{DriveLag, Estimator, STATES, StateRow, StateVector};
use firmware::registers::certificate_crc32;
use firmware::settings::Settings;
use nalgebra::allocator::Allocator;
use nalgebra::{DMatrix, DefaultAllocator, Dim, OMatrix, SMatrix};
use protocol::JointIndex;
use robot_model::RobotModel;
use serde::{Deserialize, Serialize};

/// Version this program writes and reads.
pub const FORMAT: u32 = 2;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GainsFile {
    /// [`FORMAT`].
    pub format: u32,
    /// Robot model the gains are for.
    pub robot: String,
    /// Period the firmware must run at, s.
    pub period_s: f64,
    /// Weights of the estimator that the firmware must use.
    pub estimator: Estimator,
    /// One per joint, in order; joints that were not tuned are missing.
    pub joint: Vec<JointGains>,
}

/// One joint: gains, the problem they solve, the proof.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JointGains {
    /// Joint number from 1.
    pub number: usize,
    /// On the position error.
    pub k_pos_1_s2: f32,
    /// On the differenced position error.
    pub k_vel_1_s: f32,
    /// On the last command.
    pub k_last: f32,
    /// What was designed for.
    pub problem: ProblemTable,
    /// Why it is safe.
    pub certificate: CertificateTable,
}

/// [`JointInput`] in a file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProblemTable {
    pub period_jitter_ratio: f64,
    pub delay_min_s: f64,
    pub delay_max_s: f64,
    pub drive_wn_rad_s: f64,
    pub drive_zeta: f64,
    pub acceleration_max_rad_s2: f64,
    pub error_position_rad: f64,
    pub error_velocity_rad_s: f64,
    pub phase: Vec<PhaseInput>,
}

/// Proof by either design.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "design", rename_all = "lowercase", deny_unknown_fields)]
pub enum CertificateTable {
    /// `PaperCertificate`; symmetric matrices as upper triangles by columns, errors scaled to the unit ball.
    Paper { alpha_1_s: f64, q: Vec<f64>, y_rad_s2: Vec<f64> },
    /// `SaturatedCertificate`.
    Saturated { weight_velocity: f64, weight_input: f64, weight_floor: f64, region: Vec<RegionTable> },
}

/// `Region` in a file: state order and units as in the model of the design.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RegionTable {
    pub u_max_rad_s2: f64,
    pub decay_1_s: f64,
    pub cost_rate: f64,
    pub scale: [f64; STATES],
    pub slow_row: [f64; STATES],
    pub p: Vec<f64>,
}

/// Why a file is refused.
#[derive(Debug, PartialEq, thiserror::Error)]
pub enum GainsFileError {
    /// Not this format.
    #[error("not a gains file: {0}")]
    Syntax(String),
    /// Written by another version.
    #[error("gains file has format {found}, this program reads format {FORMAT}; tune again")]
    Format {
        /// As in the file.
        found: u32,
    },
    /// For another machine.
    #[error("gains are for robot {found}, this is {expected}; tune for {expected}")]
    OtherRobot {
        /// As in the file.
        found: String,
        expected: String,
    },
    /// The robot has this name, but its file differs from the one that the gains were designed for.
    #[error(
        "joint {joint}: the gains were designed for {what} = {found}, the robot file says {expected}; tune for this robot"
    )]
    OtherMachine {
        joint: usize,
        /// Key of the gains file.
        what: &'static str,
        /// In the gains file.
        found: f64,
        /// Of the robot.
        expected: f64,
    },
    /// Joint numbers must rise from 1.
    #[error("joint {0} is listed twice or out of order")]
    JointOrder(usize),
    /// A gain the firmware cannot use.
    #[error("joint {joint}: {what} is {value}; gains must be finite and not positive")]
    Gain {
        joint: usize,
        /// Key.
        what: &'static str,
        /// As in the file.
        value: f32,
    },
    /// A matrix of the wrong size.
    #[error("joint {joint}: {what} has {found} numbers, {expected} are needed")]
    Size {
        joint: usize,
        /// Key.
        what: &'static str,
        /// As in the file.
        found: usize,
        expected: usize,
    },
    /// The problem itself is refused.
    #[error(transparent)]
    Problem(#[from] ProblemError),
    /// The gains are not those of the certificate.
    #[error("joint {joint}: the gains are not those the certificate was made for")]
    GainsChanged { joint: usize },
    /// The proof of the saturated design fails.
    #[error("joint {joint}: {refusal}; the file was changed or damaged, tune again")]
    Saturated {
        joint: usize,
        /// What fails.
        refusal: SaturatedRefusal,
    },
    /// The proof of the paper's design fails.
    #[error("joint {joint}: {refusal}; the file was changed or damaged, tune again")]
    Paper {
        joint: usize,
        /// What fails.
        refusal: PaperRefusal,
    },
}

/// Upper triangle by columns.
fn upper<D: Dim>(m: &OMatrix<f64, D, D>) -> Vec<f64>
where
    DefaultAllocator: Allocator<D, D>,
{
    (0..m.ncols()).flat_map(|j| (0..=j).map(move |i| m[(i, j)])).collect()
}

/// The symmetric matrix of an upper triangle.
fn symmetric<const N: usize>(
    joint: usize,
    what: &'static str,
    v: &[f64],
) -> Result<SMatrix<f64, N, N>, GainsFileError> {
    let expected = N * (N + 1) / 2;
    if v.len() != expected {
        return Err(GainsFileError::Size { joint, what, found: v.len(), expected });
    }
    Ok(SMatrix::from_fn(|i, j| v[i.max(j) * (i.max(j) + 1) / 2 + i.min(j)]))
}

/// Registers of a controller that take gains, in the order in which they are written: a change of one voids the certificate.
pub const REGISTERS: [&str; 10] = [
    "estimator.alpha",
    "estimator.beta",
    "joint.k_error_1_s2",
    "joint.k_rate_1_s",
    "joint.k_last",
    "gains.period_us",
    "gains.delay_min_us",
    "gains.delay_max_us",
    "gains.robot_crc32",
    "gains.certificate_crc32",
];

impl GainsFile {
    /// Puts gains and certificate into settings, for the robot `robot_crc32`. The certificate is about the accelerations and the
    /// lag that the gains were designed for: a controller with others does not arm. Gains for some joints only keep the
    /// certificate of the others, if they have one.
    pub fn enter(&self, robot_crc32: u32, settings: &mut Settings) {
        let us = |s: f64| (s * 1e6).round() as u32;
        let was_proven = settings.gains_certificate_crc32 == certificate_crc32(settings);
        let is_whole = settings.joints().all(|j| self.joint.iter().any(|tuned| tuned.number == j.get() + 1));
        let delays =
            self.joint.iter().map(|tuned| (us(tuned.problem.delay_min_s), us(tuned.problem.delay_max_s)));
        let others = (!is_whole).then_some((settings.gains_delay_min_us, settings.gains_delay_max_us));
        // What holds for all joints.
        let delay = delays.chain(others).reduce(|a, b| (a.0.max(b.0), a.1.min(b.1)));
        (settings.gains_delay_min_us, settings.gains_delay_max_us) = delay.unwrap_or((0, 0));
        settings.gains_period_us = us(self.period_s);
        settings.gains_robot_crc32 = robot_crc32;
        (settings.estimator_alpha, settings.estimator_beta) =
            (self.estimator.alpha as f32, self.estimator.beta as f32);
        let index = |tuned: &JointGains| tuned.number.checked_sub(1).and_then(|n| JointIndex::new(n).ok());
        for (tuned, at) in self.joint.iter().filter_map(|tuned| Some((tuned, index(tuned)?))) {
            let joint = settings.joint.at_mut(at);
            [joint.k_error_1_s2, joint.k_rate_1_s, joint.k_last] = tuned.gains();
        }
        let mut proven = *settings;
        for (tuned, at) in self.joint.iter().filter_map(|tuned| Some((tuned, index(tuned)?))) {
            let problem = &tuned.problem;
            proven.drive_lag_us = us(2.0 * problem.drive_zeta / problem.drive_wn_rad_s);
            proven.joint.at_mut(at).a_max_rad_s2 = problem.acceleration_max_rad_s2 as f32;
        }
        settings.gains_certificate_crc32 =
            if is_whole || was_proven { certificate_crc32(&proven) } else { 0 };
    }

    /// Checks that the gains were designed for the data of this robot's file: a robot is identified by its numbers, not by its
    /// name.
    ///
    /// # Errors
    /// [`GainsFileError::OtherMachine`] for the first number that differs.
    pub fn check_robot(&self, model: &RobotModel) -> Result<(), GainsFileError> {
        for tuned in &self.joint {
            let joint = tuned.number;
            let Some(limits) = joint.checked_sub(1).and_then(|i| model.joints().get(i)) else {
                return Err(GainsFileError::JointOrder(joint));
            };
            let problem = &tuned.problem;
            let (wn, zeta) = model
                .drive_loop()
                .map_or((f64::NAN, f64::NAN), |drive| (drive.natural_frequency_rad_s, drive.damping_ratio));
            for (what, found, expected) in [
                (
                    "acceleration_max_rad_s2",
                    problem.acceleration_max_rad_s2,
                    limits.limits.a_control_max_rad_s2,
                ),
                ("drive_wn_rad_s", problem.drive_wn_rad_s, wn),
                ("drive_zeta", problem.drive_zeta, zeta),
            ] {
                // Written so that NaN fails.
                let same = (found - expected).abs() <= 1e-9 * expected.abs();
                if !same {
                    return Err(GainsFileError::OtherMachine { joint, what, found, expected });
                }
            }
        }
        Ok(())
    }
}

impl JointGains {
    /// Entry of a saturated design.
    pub fn saturated(input: &JointInput, c: &SaturatedCertificate) -> Self {
        let region = c.regions.iter().map(|r| RegionTable {
            u_max_rad_s2: r.u_max_rad_s2,
            decay_1_s: r.decay_1_s,
            cost_rate: r.cost_rate,
            scale: r.scales.into(),
            slow_row: std::array::from_fn(|i| r.slow[i]),
            p: upper(&r.p),
        });
        let certificate = CertificateTable::Saturated {
            weight_velocity: c.weights.velocity,
            weight_input: c.weights.input,
            weight_floor: c.weights.floor,
            region: region.collect(),
        };
        Self::entry(input, c.gains, certificate)
    }

    /// Entry of the paper's design; `c` is about the errors scaled to the unit ball.
    pub fn paper(input: &JointInput, gains: Gains, c: &PaperCertificate) -> Self {
        let certificate = CertificateTable::Paper {
            alpha_1_s: c.alpha,
            q: upper(&c.q),
            y_rad_s2: c.y.iter().copied().collect(),
        };
        Self::entry(input, gains, certificate)
    }

    fn entry(input: &JointInput, gains: Gains, certificate: CertificateTable) -> Self {
        Self {
            number: input.joint,
            k_pos_1_s2: gains[0],
            k_vel_1_s: gains[1],
            k_last: gains[2],
            problem: ProblemTable {
                period_jitter_ratio: input.period_jitter,
                delay_min_s: input.delay_s.0,
                delay_max_s: input.delay_s.1,
                drive_wn_rad_s: input.drive.wn_rad_s,
                drive_zeta: input.drive.zeta,
                acceleration_max_rad_s2: input.acceleration_max_rad_s2,
                error_position_rad: input.error_position_rad,
                error_velocity_rad_s: input.error_velocity_rad_s,
                phase: input.phases.clone(),
            },
            certificate,
        }
    }

    /// [k_pos, k_vel, k_last] as the firmware takes them.
    pub fn gains(&self) -> Gains {
        [self.k_pos_1_s2, self.k_vel_1_s, self.k_last]
    }

    /// Result of Theorem 1 of the paper for the same problem; `None` without a proof.
    pub fn theorem_1(&self, period_s: f64, estimator: Estimator) -> Option<Gains> {
        let problem = self.problem(period_s, estimator).ok()?;
        largest_decay(&System::of(&problem)).ok()?.gains(&problem)
    }

    fn problem(&self, period_s: f64, estimator: Estimator) -> Result<Problem, ProblemError> {
        let t = &self.problem;
        Problem::new(&JointInput {
            joint: self.number,
            period_s,
            period_jitter: t.period_jitter_ratio,
            delay_s: (t.delay_min_s, t.delay_max_s),
            drive: DriveLag { wn_rad_s: t.drive_wn_rad_s, zeta: t.drive_zeta },
            estimator,
            acceleration_max_rad_s2: t.acceleration_max_rad_s2,
            phases: t.phase.clone(),
            error_position_rad: t.error_position_rad,
            error_velocity_rad_s: t.error_velocity_rad_s,
        })
    }

    /// Proves the entry again.
    fn verify(&self, period_s: f64, estimator: Estimator) -> Result<(), GainsFileError> {
        let joint = self.number;
        for (what, value) in ["k_pos_1_s2", "k_vel_1_s", "k_last"].into_iter().zip(self.gains()) {
            if !value.is_finite() || value > 0.0 {
                return Err(GainsFileError::Gain { joint, what, value });
            }
        }
        let problem = self.problem(period_s, estimator)?;
        match &self.certificate {
            CertificateTable::Saturated { weight_velocity, weight_input, weight_floor, region } => {
                let regions = region.iter().map(|r| {
                    Ok(Region {
                        u_max_rad_s2: r.u_max_rad_s2,
                        scales: StateVector::from(r.scale),
                        slow: StateRow::from_row_slice(&r.slow_row),
                        p: symmetric(joint, "p", &r.p)?,
                        cost_rate: r.cost_rate,
                        decay_1_s: r.decay_1_s,
                    })
                });
                let certificate = SaturatedCertificate {
                    gains: self.gains(),
                    weights: Weights {
                        velocity: *weight_velocity,
                        input: *weight_input,
                        floor: *weight_floor,
                    },
                    regions: regions.collect::<Result<_, GainsFileError>>()?,
                };
                certificate
                    .check(&problem)
                    .map_err(|refusal| GainsFileError::Saturated { joint, refusal })?;
            }
            CertificateTable::Paper { alpha_1_s, q, y_rad_s2 } => {
                if y_rad_s2.len() != 2 {
                    let found = y_rad_s2.len();
                    return Err(GainsFileError::Size { joint, what: "y_rad_s2", found, expected: 2 });
                }
                let certificate = PaperCertificate {
                    alpha: *alpha_1_s,
                    q: DMatrix::from_column_slice(2, 2, symmetric::<2>(joint, "q", q)?.as_slice()),
                    y: DMatrix::from_row_slice(1, 2, y_rad_s2),
                };
                let system = System::of(&problem);
                certificate.check(&system).map_err(|refusal| GainsFileError::Paper { joint, refusal })?;
                if certificate.gains(&problem) != Some(self.gains()) {
                    return Err(GainsFileError::GainsChanged { joint });
                }
            }
        }
        Ok(())
    }
}

impl GainsFile {
    /// TOML text with a heading.
    pub fn to_toml(&self) -> String {
        let body = toml::to_string(self).unwrap_or_default();
        format!(
            "# Feedback gains with certificate, written by `cubectl tune`. Units are in the key names; an \
             edited number is\n# refused, because the certificate no longer proves it.\n{body}"
        )
    }

    /// Reads a file and proves every joint again.
    ///
    /// # Errors
    /// [`GainsFileError`]: syntax, version, another robot, or a claim that is no longer proven.
    pub fn from_toml(text: &str, robot: &str) -> Result<Self, GainsFileError> {
        let file: Self = toml::from_str(text).map_err(|e| GainsFileError::Syntax(e.to_string()))?;
        if file.format != FORMAT {
            return Err(GainsFileError::Format { found: file.format });
        }
        if file.robot != robot {
            return Err(GainsFileError::OtherRobot { found: file.robot, expected: robot.to_owned() });
        }
        let mut before = 0;
        for joint in &file.joint {
            if joint.number <= before {
                return Err(GainsFileError::JointOrder(joint.number));
            }
            before = joint.number;
            joint.verify(file.period_s, file.estimator)?;
        }
        Ok(file)
    }
}

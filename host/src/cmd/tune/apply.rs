//! Gains into the registers of a controller: read, write, read back, and back again if anything is wrong.
//!
//! The controller takes gains only while nothing moves and nothing is armed. The registers of the joints hold the gains of
//! all of them, so three writes change all joints. Each change voids the certificate, which is written last.

use crate::error::{Cause, ExpectedError};
use crate::exit;
use firmware::settings::{JointSettings, Settings};
use protocol::cyphal::bits::Decode;
use protocol::cyphal::client::Policy;
use protocol::cyphal::id::NodeId;
use protocol::cyphal::uavcan::register::{ACCESS, AccessRequest, AccessResponse};
use protocol::cyphal::uavcan::value::{ValueBuf, ValueType};
use serde::{Deserialize, Serialize};

use operator::bus::Session;
use operator::bus::period::set_period;
use operator::dialogue::operator::OperatorError;
use tuner::gains::gains_file::{GainsFile, REGISTERS};
use tuner::model::Estimator;

/// Least and largest delay they are for, µs.
const DELAY: [&str; 2] = ["gains.delay_min_us", "gains.delay_max_us"];
/// What their certificate is about beside them: age of a reply and lag, µs.
const LAGS: [&str; 2] = ["reply.age_us", "drives.lag_us"];
/// And the accelerations of the joints, rad/s².
const ACCELERATION: &str = "joint.a_max_rad_s2";
/// Registers of the gain row, in its order.
const GAINS: [&str; 3] = ["joint.k_error_1_s2", "joint.k_rate_1_s", "joint.k_last"];
/// Weights of the estimator that the gains count on.
const ESTIMATOR: [&str; 2] = ["estimator.alpha", "estimator.beta"];
/// Period the gains are for, µs.
const GAINS_PERIOD: &str = "gains.period_us";
/// Checksum of the robot they are for.
const ROBOT: &str = "gains.robot_crc32";
/// Checksum of their certificate.
const CERTIFICATE: &str = "gains.certificate_crc32";
/// Period at which the controller runs, µs.
const CYCLE_PERIOD: &str = "cycle.period_us";

/// Named numbers of a controller.
pub(super) trait Registers {
    /// What goes wrong on the way.
    type Error: Cause;
    /// Numbers of a register; empty for an unknown one.
    fn floats(&mut self, name: &str) -> Result<Vec<f32>, Self::Error>;
    /// Writes numbers; returns what the register holds then.
    fn set_floats(&mut self, name: &str, values: &[f32]) -> Result<Vec<f32>, Self::Error>;
    /// A whole number; `None` for an unknown register.
    fn natural(&mut self, name: &str) -> Result<Option<u32>, Self::Error>;
    /// Writes a whole number; returns what the register holds then.
    fn set_natural(&mut self, name: &str, value: u32) -> Result<Option<u32>, Self::Error>;
}

pub(super) struct OnBus<'a> {
    pub(super) session: &'a mut Session,
    pub(super) node: NodeId,
}

impl OnBus<'_> {
    fn access(&mut self, name: &str, value: &ValueBuf) -> Result<ValueBuf, OperatorError> {
        let value = value.as_value();
        if value.kind() != ValueType::Empty {
            self.session.authorize_register(self.node, name, &value)?;
        }
        let request = AccessRequest { name: name.as_bytes(), value };
        let payload = self.session.request(self.node, ACCESS, Policy::default(), &request)?;
        let response = AccessResponse::from_bytes(&payload)
            .map_err(|_| OperatorError::Unreadable { node: self.node })?;
        Ok(response.value.into())
    }
}

fn floats_of(value: &ValueBuf) -> Vec<f32> {
    let value = value.as_value();
    (0..value.len()).filter_map(|i| value.f32(i)).collect()
}

fn natural_of(value: &ValueBuf) -> Option<u32> {
    value.as_value().u64(0).and_then(|x| u32::try_from(x).ok())
}

impl Registers for OnBus<'_> {
    type Error = OperatorError;

    fn floats(&mut self, name: &str) -> Result<Vec<f32>, OperatorError> {
        Ok(floats_of(&self.access(name, &ValueBuf::EMPTY)?))
    }

    fn set_floats(&mut self, name: &str, values: &[f32]) -> Result<Vec<f32>, OperatorError> {
        // Eight numbers at most fit in any case.
        let value = ValueBuf::try_from(values).unwrap_or(ValueBuf::EMPTY);
        Ok(floats_of(&self.access(name, &value)?))
    }

    fn natural(&mut self, name: &str) -> Result<Option<u32>, OperatorError> {
        Ok(natural_of(&self.access(name, &ValueBuf::EMPTY)?))
    }

    fn set_natural(&mut self, name: &str, value: u32) -> Result<Option<u32>, OperatorError> {
        Ok(natural_of(&self.access(name, &ValueBuf::from(value))?))
    }
}

/// Gains of a controller, as its registers hold them; also the form of the file that rolls back.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::cmd) struct InForce {
    pub(in crate::cmd) period_us: u32,
    /// Least and largest delay they are for, µs; 0 in files of earlier versions: not known, as all that has a default.
    #[serde(default)]
    pub(in crate::cmd) delay_us: [u32; 2],
    /// Age of a reply and lag of the drives that they are for, µs.
    #[serde(default)]
    pub(in crate::cmd) lags_us: [u32; 2],
    #[serde(default)]
    pub(in crate::cmd) a_max_rad_s2: Vec<f32>,
    #[serde(default)]
    pub(in crate::cmd) robot_crc32: u32,
    /// Checksum of their certificate, 0 for none.
    pub(in crate::cmd) certificate_crc32: u32,
    /// Weight of a measurement on the position error.
    pub(in crate::cmd) estimator_alpha: f32,
    /// Weight on its rate.
    pub(in crate::cmd) estimator_beta: f32,
    /// On the position error, joint by joint, 1/s2.
    pub(in crate::cmd) k_pos_1_s2: Vec<f32>,
    /// On its rate, 1/s.
    pub(in crate::cmd) k_vel_1_s: Vec<f32>,
    /// On the last command.
    pub(in crate::cmd) k_last: Vec<f32>,
}

/// Why gains are not in force.
#[derive(Debug, PartialEq, thiserror::Error)]
pub(super) enum ApplyError {
    /// The controller runs at another period.
    #[error("the controller runs at {found_us} us, the gains are for {wanted_us} us; nothing was changed")]
    Period {
        /// Of the controller.
        found_us: u32,
        /// Of the gains.
        wanted_us: u32,
    },
    /// Gains for some joints only, at another period than the rest.
    #[error(
        "the gains in the controller are for {found_us} us, the new ones for {wanted_us} us and not for all joints; nothing \
         was changed"
    )]
    SomeJoints {
        /// Of the gains in force.
        found_us: u32,
        /// Of the new ones.
        wanted_us: u32,
    },
    /// Gains for some joints only, for another estimator than the rest.
    #[error("the gains in the controller are for estimator weights {} and {}, the new ones for {} and {} and not for all joints; \
         nothing was changed", found.alpha, found.beta, wanted.alpha, wanted.beta)]
    SomeEstimators {
        /// Of the gains in force.
        found: Estimator,
        /// Of the new ones.
        wanted: Estimator,
    },
    /// The controller has other joints.
    #[error("the controller has {found} joints, the gains are for joint {wanted}; nothing was changed")]
    Joints {
        /// In the controller.
        found: usize,
        /// Number in the file.
        wanted: usize,
    },
    /// Nothing was written.
    #[error("nothing was changed: {}", .0.what)]
    Untouched(ExpectedError),
    /// Writing or reading back failed; the gains from before are in force again, as read back.
    #[error("{cause}; the gains from before are in force again")]
    RolledBack { cause: String },
    /// As before, and the way back failed too.
    #[error("{cause}; writing the old gains back failed too: {second}\n  registers: {held}")]
    Mixed {
        /// What happened first.
        cause: String,
        /// What happened on the way back.
        second: String,
        /// What is where.
        held: String,
    },
}

impl ApplyError {
    /// What to do.
    #[must_use]
    pub(crate) fn next(&self) -> Option<String> {
        Some(match self {
            Self::Period { .. } => "tune with that \
         --period-ms, or change cycle.period_us of the controller".to_owned(),
            Self::SomeJoints { .. } => "tune all joints".to_owned(),
            Self::SomeEstimators { .. } => "tune all joints, or with the --estimator-alpha and --estimator-beta of the controller".to_owned(),
            Self::Untouched(error) => return error.next.first().cloned(),
            Self::Mixed { .. } => "do not arm; `cubectl tune --rollback` with \
         the gains from before, once the controller answers again (after a restart it holds what it has stored)".to_owned(),
            _ => return None,
        })
    }
}

/// A write that ended early.
struct Broken {
    /// Registers that were read back as wanted.
    done: Vec<&'static str>,
    /// Register at which it ended; what it holds is not known.
    at: &'static str,
    cause: String,
}

/// What each register holds after a write and the way back both ended early.
fn held(forth: &Broken, back: &Broken) -> String {
    let is = |name: &str| match name {
        _ if name == back.at => "unknown",
        _ if back.done.contains(&name) => "old",
        _ if name == forth.at => "unknown",
        CERTIFICATE if forth.done.contains(&name) => "none",
        _ if forth.done.contains(&name) => "new",
        _ => "old",
    };
    REGISTERS.map(|name| format!("{name} {}", is(name))).join(", ")
}

impl InForce {
    /// Reads them.
    ///
    /// # Errors
    /// The transport, or a register that is not there.
    pub(super) fn read<T: Registers>(target: &mut T) -> Result<Self, ExpectedError> {
        let mut rows: Vec<Vec<f32>> = Vec::new();
        for name in GAINS {
            let row = target.floats(name).map_err(unread)?;
            if row.is_empty() || rows.first().is_some_and(|first| first.len() != row.len()) {
                return Err(unread(format!(
                    "the controller's register {name} does not hold the gains of its joints"
                )));
            }
            rows.push(row);
        }
        let [mut estimator_alpha, mut estimator_beta] = [0.0; 2];
        for (name, weight) in ESTIMATOR.into_iter().zip([&mut estimator_alpha, &mut estimator_beta]) {
            *weight = match target.floats(name).map_err(unread)?.as_slice() {
                [weight] => *weight,
                _ => return Err(unread(format!("the controller has no register {name}"))),
            };
        }
        let mut natural = |name: &str| match target.natural(name) {
            Ok(Some(value)) => Ok(value),
            Ok(None) => Err(unread(format!("the controller has no register {name}"))),
            Err(e) => Err(unread(e)),
        };
        let (period_us, robot_crc32, certificate_crc32) =
            (natural(GAINS_PERIOD)?, natural(ROBOT)?, natural(CERTIFICATE)?);
        let delay_us = [natural(DELAY[0])?, natural(DELAY[1])?];
        let lags_us = [natural(LAGS[0])?, natural(LAGS[1])?];
        let a_max_rad_s2 = target.floats(ACCELERATION).map_err(unread)?;
        let mut rows = rows.into_iter();
        let mut next = || rows.next().unwrap_or_default();
        let (k_pos_1_s2, k_vel_1_s, k_last) = (next(), next(), next());
        Ok(Self {
            period_us,
            delay_us,
            lags_us,
            a_max_rad_s2,
            robot_crc32,
            certificate_crc32,
            estimator_alpha,
            estimator_beta,
            k_pos_1_s2,
            k_vel_1_s,
            k_last,
        })
    }

    pub(in crate::cmd) fn of(settings: &Settings) -> Self {
        let of = |pick: fn(&JointSettings) -> f32| {
            settings.joints().map(|joint| pick(settings.joint.at(joint))).collect()
        };
        Self {
            period_us: settings.gains_period_us,
            delay_us: [settings.gains_delay_min_us, settings.gains_delay_max_us],
            lags_us: [settings.reply_age_us, settings.drive_lag_us],
            a_max_rad_s2: of(|j| j.a_max_rad_s2),
            robot_crc32: settings.gains_robot_crc32,
            certificate_crc32: settings.gains_certificate_crc32,
            estimator_alpha: settings.estimator_alpha,
            estimator_beta: settings.estimator_beta,
            k_pos_1_s2: of(|j| j.k_error_1_s2),
            k_vel_1_s: of(|j| j.k_rate_1_s),
            k_last: of(|j| j.k_last),
        }
    }

    /// Settings that hold them, and what their certificate is about; the others as built in.
    fn settings(&self) -> Settings {
        let mut settings = Settings::powercube6();
        settings.joints = self.k_pos_1_s2.len() as u32;
        self.begin(&mut settings);
        [settings.reply_age_us, settings.drive_lag_us] = self.lags_us;
        for (joint, a_max) in settings.joint.0.iter_mut().zip(&self.a_max_rad_s2) {
            joint.a_max_rad_s2 = *a_max;
        }
        settings
    }

    /// These gains with those of a verified file for the robot `robot_crc32` in place of its joints.
    ///
    /// # Errors
    /// [`ApplyError::Joints`], [`ApplyError::SomeJoints`].
    pub(super) fn with(&self, file: &GainsFile, robot_crc32: u32) -> Result<Self, ApplyError> {
        let wanted_us = (file.period_s * 1e6).round() as u32;
        let joints = self.k_pos_1_s2.len();
        if file.joint.len() < joints && wanted_us != self.period_us {
            return Err(ApplyError::SomeJoints { found_us: self.period_us, wanted_us });
        }
        let wanted = file.estimator;
        // The controller keeps single precision.
        let same = [wanted.alpha as f32, wanted.beta as f32] == [self.estimator_alpha, self.estimator_beta];
        if file.joint.len() < joints && !same {
            return Err(ApplyError::SomeEstimators { found: self.estimator(), wanted });
        }
        if let Some(joint) = file.joint.iter().find(|joint| !(1..=joints).contains(&joint.number)) {
            return Err(ApplyError::Joints { found: joints, wanted: joint.number });
        }
        let mut settings = self.settings();
        file.enter(robot_crc32, &mut settings);
        Ok(Self::of(&settings))
    }

    pub(in crate::cmd) fn estimator(&self) -> Estimator {
        Estimator { alpha: self.estimator_alpha.into(), beta: self.estimator_beta.into() }
    }

    /// Lets a controller begin with these gains, at their period.
    pub(in crate::cmd) fn begin(&self, settings: &mut Settings) {
        set_period(settings, self.period_us);
        [settings.gains_delay_min_us, settings.gains_delay_max_us] = self.delay_us;
        settings.gains_certificate_crc32 = self.certificate_crc32;
        settings.gains_robot_crc32 = self.robot_crc32;
        (settings.estimator_alpha, settings.estimator_beta) = (self.estimator_alpha, self.estimator_beta);
        let rows = self.k_pos_1_s2.iter().zip(&self.k_vel_1_s).zip(&self.k_last);
        for (joint, ((k_pos, k_vel), k_last)) in settings.joint.0.iter_mut().zip(rows) {
            (joint.k_error_1_s2, joint.k_rate_1_s, joint.k_last) = (*k_pos, *k_vel, *k_last);
        }
    }

    /// TOML text with a heading.
    pub(in crate::cmd) fn to_toml(&self) -> String {
        let body = toml::to_string(self).unwrap_or_default();
        format!(
            "# Gains that a controller held; `cubectl tune --rollback` with this file puts them back.\n{body}"
        )
    }

    /// Reads the file of [`InForce::to_toml`].
    pub(in crate::cmd) fn from_toml(text: &str) -> Result<Self, String> {
        let read: Self = toml::from_str(text).map_err(|e| e.to_string())?;
        let n = read.k_pos_1_s2.len();
        let all = || read.k_pos_1_s2.iter().chain(&read.k_vel_1_s).chain(&read.k_last);
        if n == 0 || read.k_vel_1_s.len() != n || read.k_last.len() != n || !all().all(|k| k.is_finite()) {
            return Err(
                "the lists of gains differ in length, are empty, or hold what is no number".to_owned()
            );
        }
        Ok(read)
    }

    /// Writes every register and compares what each holds then, bit for bit. The certificate goes first and comes back
    /// last: a mixture has none.
    fn write<T: Registers>(&self, target: &mut T) -> Result<(), Broken> {
        let mut done = Vec::new();
        let mut step = |at: &'static str, outcome: Result<(), String>| match outcome {
            Ok(()) => {
                done.push(at);
                Ok(())
            }
            Err(cause) => Err(Broken { done: std::mem::take(&mut done), at, cause }),
        };
        step(CERTIFICATE, write_natural(target, CERTIFICATE, 0))?;
        for (name, weight) in ESTIMATOR.into_iter().zip([self.estimator_alpha, self.estimator_beta]) {
            let right = target.floats(name).is_ok_and(|held| held == [weight]);
            step(name, if right { Ok(()) } else { write_floats(target, name, &[weight]) })?;
        }
        for (name, row) in GAINS.into_iter().zip([&self.k_pos_1_s2, &self.k_vel_1_s, &self.k_last]) {
            step(name, write_floats(target, name, row))?;
        }
        step(GAINS_PERIOD, write_natural(target, GAINS_PERIOD, self.period_us))?;
        for (name, us) in DELAY.into_iter().zip(self.delay_us) {
            step(name, write_natural(target, name, us))?;
        }
        step(ROBOT, write_natural(target, ROBOT, self.robot_crc32))?;
        step(CERTIFICATE, write_natural(target, CERTIFICATE, self.certificate_crc32))
    }
}

/// Why a register is not read.
#[allow(clippy::needless_pass_by_value)]
fn unread(error: impl Cause) -> ExpectedError {
    ExpectedError::of(exit::DRIVE, &error)
}

fn write_floats<T: Registers>(target: &mut T, name: &str, wanted: &[f32]) -> Result<(), String> {
    let back = target.set_floats(name, wanted).map_err(|e| e.to_string())?;
    if back == wanted { Ok(()) } else { Err(format!("{name} reads back {back:?} instead of {wanted:?}")) }
}

fn write_natural<T: Registers>(target: &mut T, name: &str, wanted: u32) -> Result<(), String> {
    let back = target.set_natural(name, wanted).map_err(|e| e.to_string())?;
    if back == Some(wanted) { Ok(()) } else { Err(format!("{name} reads back {back:?} instead of {wanted}")) }
}

/// Puts `wanted` in force, all of it or nothing: every register is read back, at once and all together at the end;
/// on any difference `before` is written back.
///
/// # Errors
/// [`ApplyError`] says what is in force.
pub(super) fn put<T: Registers>(
    target: &mut T,
    before: &InForce,
    wanted: &InForce,
) -> Result<(), ApplyError> {
    let found = target.natural(CYCLE_PERIOD).map_err(|e| ApplyError::Untouched(unread(e)))?;
    match found {
        Some(found_us) if found_us != wanted.period_us => {
            return Err(ApplyError::Period { found_us, wanted_us: wanted.period_us });
        }
        _ => {}
    }
    let outcome = wanted.write(target).and_then(|()| {
        let cause = match InForce::read(target) {
            Ok(all) if all == *wanted => return Ok(()),
            Ok(all) => format!("the controller holds {all:?} instead of {wanted:?}"),
            Err(error) => error.what,
        };
        Err(Broken { done: REGISTERS.to_vec(), at: CERTIFICATE, cause })
    });
    let Err(forth) = outcome else { return Ok(()) };
    match before.write(target) {
        Ok(()) => Err(ApplyError::RolledBack { cause: forth.cause }),
        Err(back) => {
            let held = held(&forth, &back);
            Err(ApplyError::Mixed { cause: forth.cause, second: back.cause, held })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    /// Registers in memory with faults on demand.
    struct Memory {
        floats: BTreeMap<String, Vec<f32>>,
        naturals: BTreeMap<String, u32>,
        /// Writes left before the link breaks.
        writes_left: usize,
        /// Register that does not take what is written.
        deaf: &'static str,
    }

    fn memory() -> Memory {
        let mut floats: BTreeMap<_, _> = GAINS.map(|name| (name.to_owned(), vec![-1.0, -2.0])).into();
        floats.extend(ESTIMATOR.map(|name| (name.to_owned(), vec![0.5])));
        floats.insert(ACCELERATION.to_owned(), vec![10.0, 20.0]);
        let naturals = [(GAINS_PERIOD, 3000), (ROBOT, 5), (CERTIFICATE, 7), (CYCLE_PERIOD, 3000)];
        let beside = [(DELAY[0], 2250), (DELAY[1], 3000), (LAGS[0], 130), (LAGS[1], 5000)];
        let naturals =
            naturals.into_iter().chain(beside).map(|(name, number)| (name.to_owned(), number)).collect();
        Memory { floats, naturals, writes_left: 99, deaf: "" }
    }

    impl Registers for Memory {
        type Error = String;

        fn floats(&mut self, name: &str) -> Result<Vec<f32>, String> {
            Ok(self.floats.get(name).cloned().unwrap_or_default())
        }

        fn set_floats(&mut self, name: &str, values: &[f32]) -> Result<Vec<f32>, String> {
            self.writes_left = self.writes_left.checked_sub(1).ok_or("no answer")?;
            if name != self.deaf {
                self.floats.insert(name.to_owned(), values.to_vec());
            }
            self.floats(name)
        }

        fn natural(&mut self, name: &str) -> Result<Option<u32>, String> {
            Ok(self.naturals.get(name).copied())
        }

        fn set_natural(&mut self, name: &str, value: u32) -> Result<Option<u32>, String> {
            self.writes_left = self.writes_left.checked_sub(1).ok_or("no answer")?;
            if name != self.deaf {
                self.naturals.insert(name.to_owned(), value);
            }
            self.natural(name)
        }
    }

    fn wanted() -> InForce {
        let (k_pos_1_s2, k_vel_1_s) = (vec![-400.0, -500.0], vec![-30.0, -35.0]);
        InForce {
            period_us: 3000,
            delay_us: [2400, 3000],
            lags_us: [130, 5000],
            a_max_rad_s2: vec![10.0, 20.0],
            robot_crc32: 5,
            certificate_crc32: 9,
            estimator_alpha: 0.6,
            estimator_beta: 0.25,
            k_pos_1_s2,
            k_vel_1_s,
            k_last: vec![-0.2, -0.3],
        }
    }

    #[test]
    fn gains_go_in_together_or_not_at_all() {
        let mut target = memory();
        let before = InForce::read(&mut target).unwrap();
        put(&mut target, &before, &wanted()).unwrap();
        assert_eq!(InForce::read(&mut target), Ok(wanted()));

        for deaf in [ESTIMATOR[1], GAINS[0], GAINS[2]] {
            let mut target = Memory { deaf, ..memory() };
            let refused = put(&mut target, &before, &wanted());
            assert!(matches!(refused, Err(ApplyError::RolledBack { .. })), "{deaf}: {refused:?}");
            assert_eq!(InForce::read(&mut target), Ok(before.clone()), "{deaf}");
        }
        // The link breaks for good after some writes: nobody can roll back, and it is said.
        let mut target = Memory { writes_left: 4, ..memory() };
        let Err(ApplyError::Mixed { held, .. }) = put(&mut target, &before, &wanted()) else {
            panic!("nobody can roll back")
        };
        // Certificate, two weights and the first row were written; the second row may have been.
        for said in [
            "certificate_crc32 unknown",
            "estimator.beta new",
            "k_error_1_s2 new",
            "k_rate_1_s unknown",
            "k_last old",
        ] {
            assert!(held.contains(said), "{said}: {held}");
        }
        assert_eq!(target.naturals[CERTIFICATE], 0, "a mixture has no certificate");
    }

    #[test]
    fn another_period_is_refused_before_anything_is_written() {
        let mut target = memory();
        let before = InForce::read(&mut target).unwrap();
        let slow = InForce { period_us: 17_000, ..wanted() };
        let refused = put(&mut target, &before, &slow);
        assert_eq!(refused, Err(ApplyError::Period { found_us: 3000, wanted_us: 17_000 }));
        assert_eq!(InForce::read(&mut target), Ok(before));
    }

    #[test]
    fn file_for_rolling_back_survives_and_damaged_ones_are_refused() {
        let text = wanted().to_toml();
        assert_eq!(InForce::from_toml(&text), Ok(wanted()));
        assert!(InForce::from_toml(&text.replace("-400.0, ", "")).is_err());
        assert!(InForce::from_toml(&text.replace("-0.2,", "nan,")).is_err());
        assert!(InForce::from_toml("period_us = 1").is_err());
    }
}

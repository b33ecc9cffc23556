//! Gains for a robot at a period: those that come with the program, or a design made on the way.

use firmware::settings::Settings;
use robot_model::RobotModel;

use crate::gains::design::{Design, DesignError, Tuned, tune};
use crate::gains::gains_file::{FORMAT, GainsFile};
use crate::gains::machine::{Demand, Machine, MachineError, ReferenceProfile, inputs};

/// Gains of `powercube6` that come with the program, shortest period first. Each is the certified saturated design of
/// `cubectl tune --period-ms …` for the initial errors of the firmware's start tolerance.
const BUILT_IN: [(u32, &str); 5] = [
    (3_000, include_str!("../../gains/powercube6-3ms.toml")),
    (5_000, include_str!("../../gains/powercube6-5ms.toml")),
    (10_000, include_str!("../../gains/powercube6-10ms.toml")),
    (17_000, include_str!("../../gains/powercube6-17ms.toml")),
    (30_000, include_str!("../../gains/powercube6-30ms.toml")),
];

/// Gains of the emulated board, which has them built in.
const EMULATED_BOARD: &str = include_str!("../../gains/powercube6-34ms.toml");

/// The file of the certificate that `held` names, if it came with the program.
#[must_use]
pub fn built_in_of(held: &Settings) -> Option<GainsFile> {
    let is_of = |file: &GainsFile| {
        let mut settings = *held;
        file.enter(held.gains_robot_crc32, &mut settings);
        settings == *held
    };
    let texts = BUILT_IN.iter().map(|(_, text)| *text).chain([EMULATED_BOARD]);
    texts.filter_map(|text| GainsFile::from_toml(text, "powercube6").ok()).find(is_of)
}

/// Control periods for which there are gains, µs, shortest first.
pub const PERIODS_US: [u32; 5] = [BUILT_IN[0].0, BUILT_IN[1].0, BUILT_IN[2].0, BUILT_IN[3].0, BUILT_IN[4].0];

/// Share of the acceleration for control that it sets aside for the motion.
const REFERENCE_SHARE: f64 = 0.8;

/// Where gains come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum GainsFrom {
    /// They come with the program, for this robot.
    BuiltIn,
    /// Designed and certified just now, for this robot.
    Designed,
    /// From a file.
    Given,
    /// The controller on the bus has its own.
    #[default]
    Controller,
}

impl GainsFrom {
    /// Field `gains_from` of `summary.json`.
    #[must_use]
    pub const fn json_name(self) -> &'static str {
        match self {
            Self::BuiltIn => "built_in",
            Self::Designed => "designed",
            Self::Given => "given",
            Self::Controller => "controller",
        }
    }
}

/// Why there are no gains.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NoGains {
    /// The program designs for its own periods only.
    #[error("the program has no gains for {} ms and {robot}", f64::from(*.period_us) * 1e-3)]
    Period {
        /// Requested period, µs.
        period_us: u32,
        robot: String,
    },
    /// The robot file has too little data.
    #[error("{0}")]
    Machine(#[from] MachineError),
    /// The design fails.
    #[error("no gains for {robot} at {} ms: {cause}", f64::from(*.period_us) * 1e-3)]
    Design {
        period_us: u32,
        robot: String,
        /// Binding condition.
        cause: Box<DesignError>,
    },
}

impl NoGains {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        Some(match self {
            Self::Period { period_us, .. } => format!(
                "`cubectl tune --robot FILE --period-ms {} --out gains.toml`, \
         then `--gains gains.toml`; or one of its periods: 3, 5, 10, 17 or 30 ms",
                f64::from(*period_us) * 1e-3
            ),
            Self::Machine(..) => {
                "describe the drives in the robot file; without gains of its own the arm cannot be armed"
                    .to_owned()
            }
            Self::Design { period_us, .. } => format!(
                "try the options of `cubectl tune --robot FILE --period-ms {} --out \
         gains.toml` that the cause names, then `--gains gains.toml`",
                f64::from(*period_us) * 1e-3
            ),
        })
    }
}

/// Certified gains for `robot` at a period: the built-in ones if they were designed for exactly the data of its
/// file, otherwise a new design.
pub fn gains_for(robot: &RobotModel, period_us: u32) -> Result<(GainsFile, GainsFrom), NoGains> {
    let (_, text) = BUILT_IN
        .iter()
        .find(|(us, _)| *us == period_us)
        .ok_or_else(|| NoGains::Period { period_us, robot: robot.name().to_owned() })?;
    let machine = Machine::from_robot(robot)?;
    let built_in = GainsFile::from_toml(text, robot.name()).ok();
    if let Some(gains) = built_in.filter(|gains| is_for(gains, &machine)) {
        return Ok((gains, GainsFrom::BuiltIn));
    }
    let period_s = f64::from(period_us) * 1e-6;
    let demand = Demand::with_period(period_s);
    let all = inputs(&machine, &ReferenceProfile::with_share(&machine, REFERENCE_SHARE), &demand)?;
    let mut joint = Vec::new();
    for input in &all {
        let tuned = tune(input, Design::Saturated).map_err(|cause| NoGains::Design {
            period_us,
            robot: machine.robot.clone(),
            cause: Box::new(cause),
        })?;
        joint.push(Tuned::entry(&tuned));
    }
    let estimator = demand.estimator;
    let file = GainsFile { format: FORMAT, robot: machine.robot, period_s, estimator, joint };
    Ok((file, GainsFrom::Designed))
}

/// The gains were designed for the accelerations and drives of this machine, joint by joint.
fn is_for(gains: &GainsFile, machine: &Machine) -> bool {
    let same = |a: f64, b: f64| (a - b).abs() <= 1e-9 * b.abs();
    gains.joint.len() == machine.joints.len()
        && gains.joint.iter().zip(&machine.joints).all(|(tuned, plant)| {
            same(tuned.problem.acceleration_max_rad_s2, plant.acceleration_max_rad_s2)
                && same(tuned.problem.drive_wn_rad_s, plant.drive.wn_rad_s)
                && same(tuned.problem.drive_zeta, plant.drive.zeta)
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn powercube6() -> RobotModel {
        RobotModel::load("powercube6").unwrap()
    }

    #[test]
    fn every_built_in_file_proves_and_is_for_its_period_and_all_joints() {
        for us in PERIODS_US {
            let (gains, from) = gains_for(&powercube6(), us).unwrap();
            assert_eq!((from, (gains.period_s * 1e6).round() as u32), (GainsFrom::BuiltIn, us));
            assert!(gains.joint.iter().map(|joint| joint.number).eq(1..=6));
        }
        assert_eq!(PERIODS_US[0], Settings::powercube6().cycle_period_us);
        assert!(PERIODS_US.is_sorted());
    }

    #[test]
    fn a_built_in_certificate_is_known_by_what_it_is_about() {
        for us in PERIODS_US {
            let (gains, _) = gains_for(&powercube6(), us).unwrap();
            let mut held = Settings::powercube6();
            gains.enter(held.gains_robot_crc32, &mut held);
            assert_eq!(held.gains_certificate_crc32, firmware::registers::certificate_crc32(&held), "{us}");
            assert_eq!(built_in_of(&held), Some(gains));
            held.joint.0[0].k_last *= 0.5;
            assert_eq!(built_in_of(&held), None, "the number alone proves nothing");
        }
        assert_eq!(built_in_of(&Settings::powercube6()).map(|file| file.period_s), Some(0.003));
        assert_eq!(built_in_of(&Settings::powercube6_paper()).map(|file| file.period_s), Some(0.017));
    }

    #[test]
    fn a_robot_that_differs_in_name_or_acceleration_gets_a_certified_design_of_its_own() {
        let text = robot_model::built_in_text("powercube6").unwrap();
        let renamed = text.replacen("name = \"powercube6\"", "name = \"my_arm\"", 1);
        let slower =
            text.replace("control_acceleration_max_rad_s2 = 10.4", "control_acceleration_max_rad_s2 = 8.0");
        let (built_in, _) = gains_for(&powercube6(), 3_000).unwrap();
        for (text, a_max) in [(renamed, 10.4), (slower, 8.0)] {
            let robot = RobotModel::from_toml("my_arm.toml", &text).unwrap();
            for us in PERIODS_US {
                let (gains, from) = gains_for(&robot, us).unwrap();
                assert_eq!(from, GainsFrom::Designed);
                assert_eq!(gains.joint[0].problem.acceleration_max_rad_s2, a_max);
                // The gains written into the folder are proven again when they are read.
                let read = GainsFile::from_toml(&gains.to_toml(), robot.name()).unwrap();
                assert_eq!(read, gains);
                assert_ne!(gains.to_toml(), built_in.to_toml());
            }
        }
    }

    #[test]
    fn a_robot_without_drives_is_refused_with_the_next_step() {
        let error = gains_for(&RobotModel::load("kr16_2").unwrap(), 3_000).unwrap_err();
        assert!(matches!(error, NoGains::Machine(_)) && error.next().is_some(), "{error}");
    }
}

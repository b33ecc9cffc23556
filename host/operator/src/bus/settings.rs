//! Settings of a soft controller, from a robot file.

use firmware::crc::Crc32;
use firmware::groups::powercube::settings::{GRIPPER_ADDRESS, SLOW_CURRENT_A};
use firmware::joints::PerJoint;
use firmware::settings::{JointSettings, Settings};
use protocol::{JointIndex, ModuleId};
use robot_model::RobotModel;

use planner::store::fingerprint_of;

use crate::drives::{CanDrives, group_of};

/// Share of a drive's current that homing and jogging may use.
const SLOW_CURRENT_SHARE: f64 = 0.5;

/// Why there are no settings for a robot.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoSettings {
    /// Its file describes no drives.
    #[error("robot {robot} has no drives to control")]
    NoDrives { robot: String },
    /// A module that is the drive of no joint.
    #[error("module {module} is the drive of no joint of this robot")]
    NoSuchModule { module: ModuleId },
    /// Limits that do not go together.
    #[error("the limits of robot {robot} make no settings of a controller: {cause}")]
    Invalid {
        robot: String,
        /// Reason that the controller gives.
        cause: String,
    },
}

impl NoSettings {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        Some(match self {
            Self::NoDrives { .. } => {
                let others = robot_model::motor_tables();
                format!(
                    "give each [[joint]] of its file a [joint.drive] table with address and current, or a {others} table"
                )
            }
            Self::NoSuchModule { .. } => "name the robot of this arm with --robot; `cubectl status` \
         shows which modules are there"
                .to_owned(),
            _ => return None,
        })
    }
}

impl CanDrives {
    /// The drives of `robot`. PowerCubes are those that the settings name; an arm of motors, which has no brakes, is held as a whole.
    ///
    /// # Errors
    /// [`NoSettings::Invalid`]: motors or servos that cannot form a group.
    pub fn of(robot: &RobotModel) -> Result<Self, NoSettings> {
        group_of(robot).map_err(|cause| NoSettings::Invalid { robot: robot.name().to_owned(), cause })
    }
}

/// Checksum by which plan, gains and controller agree on the robot: of the fingerprint in the plan file; never 0, which
/// stands for any robot.
#[must_use]
pub fn robot_crc32(fingerprint: &str) -> u32 {
    Crc32::of(fingerprint.as_bytes()).max(1)
}

/// [`robot_crc32`] of a model.
#[must_use]
pub fn crc32_of(model: &RobotModel) -> u32 {
    robot_crc32(&fingerprint_of(model))
}

// Every robot fits a controller.
const _: () = assert!(robot_model::JOINTS_MAX <= protocol::JOINTS_MAX);

/// Settings for `robot`: addresses, ranges, limits and currents from its file; the rest as the firmware has it built in.
///
/// Gains belong to a robot. The built-in ones are kept for the robot that they were designed for, identified by its
/// fingerprint. Any other robot gets no gains and no certificate, so that it cannot be armed before it was tuned.
pub fn settings_of(model: &RobotModel) -> Result<Settings, NoSettings> {
    let robot = || model.name().to_owned();
    let mut settings = Settings::powercube6();
    settings.joints = model.n() as u32;
    let PerJoint(places) = &mut settings.joint;
    for (place, joint) in places.iter_mut().zip(model.joints()) {
        let limits = &joint.limits;
        *place = JointSettings {
            q_min_rad: limits.q_min_rad as f32,
            q_max_rad: limits.q_max_rad as f32,
            v_max_rad_s: limits.v_max_rad_s as f32,
            a_max_rad_s2: limits.a_control_max_rad_s2 as f32,
            jog_v_rad_s: place.jog_v_rad_s.min(limits.v_max_rad_s as f32),
            jog_a_rad_s2: place.jog_a_rad_s2.min(limits.a_control_max_rad_s2 as f32),
            ..*place
        };
    }
    let addresses = model.addresses().ok_or_else(|| NoSettings::NoDrives { robot: robot() })?;
    for (place, address) in places.iter_mut().zip(&addresses) {
        place.address = (*address).into();
    }
    for (place, drive) in places.iter_mut().zip(model.drives().unwrap_or_default()) {
        place.current_max_a = drive.current_max_a as f32;
    }
    if let Some(drives) = model.drives() {
        for (joint, drive) in JointIndex::first(drives.len()).zip(drives) {
            SLOW_CURRENT_A.set_at(&mut settings, joint, (SLOW_CURRENT_SHARE * drive.current_max_a) as f32);
        }
        // The gripper hangs on the last PowerCube, as in the simulated cell.
        GRIPPER_ADDRESS.set(&mut settings, addresses.last().copied().unwrap_or(0).into());
    }
    if let Some(opening_s) = model.opening_s() {
        settings.gripper_opening_us = (1e6 * opening_s).round() as u32;
    }
    if let Some(drive) = model.drive_loop() {
        settings.drive_lag_us = (2e6 * drive.damping_ratio / drive.natural_frequency_rad_s).round() as u32;
    }
    settings.limits_robot_crc32 = crc32_of(model);
    if settings.limits_robot_crc32 != settings.gains_robot_crc32 {
        (settings.gains_robot_crc32, settings.gains_certificate_crc32) = (0, 0);
        for joint in &mut settings.joint.0 {
            (joint.k_error_1_s2, joint.k_rate_1_s, joint.k_last) = (0.0, 0.0, 0.0);
        }
    }
    match settings.check() {
        Ok(()) => Ok(settings),
        Err(refusal) => Err(NoSettings::Invalid {
            robot: robot(),
            cause: format!("{:?} at joint {:?}", refusal.cause, refusal.joint.map(|joint| joint.get() + 1)),
        }),
    }
}

/// Settings for a part of the joints: those whose drives are `modules`, in the order of the robot.
///
/// # Errors
/// [`NoSettings::NoSuchModule`].
pub fn of_modules(settings: &Settings, modules: &[ModuleId]) -> Result<Settings, NoSettings> {
    let known = |module: ModuleId| settings.joints().any(|joint| settings.joint.at(joint).module() == module);
    if let Some(module) = modules.iter().copied().find(|module| !known(*module)) {
        return Err(NoSettings::NoSuchModule { module });
    }
    let kept: Vec<_> =
        settings.joints().filter(|joint| modules.contains(&settings.joint.at(*joint).module())).collect();
    let mut part = *settings;
    part.joints = kept.len() as u32;
    part.family = settings.family.of_joints(&kept.iter().copied());
    for (to, from) in JointIndex::first(kept.len()).zip(kept) {
        *part.joint.at_mut(to) = *settings.joint.at(from);
    }
    // The gripper hangs on a drive that may not be among them.
    GRIPPER_ADDRESS.set(&mut part, 0);
    Ok(part)
}

#[cfg(test)]
mod tests {
    use super::*;
    use firmware::groups::powercube::settings::REGISTERS;

    #[test]
    fn a_part_of_the_joints_keeps_its_order_and_an_unknown_module_is_refused() {
        let settings = settings_of(&RobotModel::load("powercube6").unwrap()).unwrap();
        let module = |n| ModuleId::new(n).unwrap();
        let part = of_modules(&settings, &[module(5), module(2)]).unwrap();
        let addresses: Vec<u8> = part.joints().map(|joint| part.joint.at(joint).module().get()).collect();
        assert_eq!(addresses, [2, 5]);
        assert_eq!(part.check(), Ok(()));
        assert_eq!(of_modules(&settings, &[module(9)]), Err(NoSettings::NoSuchModule { module: module(9) }));
    }

    #[test]
    fn the_built_in_robot_file_gives_the_built_in_settings() {
        let settings = settings_of(&RobotModel::load("powercube6").unwrap()).unwrap();
        let mut built_in = Settings::powercube6();
        built_in.take_family(&REGISTERS);
        let rounded = |settings: &Settings| {
            let mut settings = *settings;
            for joint in JointIndex::first(8) {
                let joint = settings.joint.at_mut(joint);
                // Degrees become radians in double precision here, in single precision there.
                for number in [&mut joint.q_min_rad, &mut joint.q_max_rad, &mut joint.v_max_rad_s] {
                    *number = (*number * 1e5).round();
                }
            }
            settings
        };
        assert_eq!(rounded(&settings), rounded(&built_in));
    }

    /// Found by abuse: another name, or another limit, is another robot.
    #[test]
    fn only_the_robot_that_the_built_in_gains_are_for_gets_them() {
        let text = robot_model::built_in_text("powercube6").unwrap();
        let limit = "control_acceleration_max_rad_s2 = 10.4";
        assert!(text.contains(limit));
        let slower = RobotModel::from_toml(
            "edited.toml",
            &text.replace(limit, "control_acceleration_max_rad_s2 = 8.0"),
        )
        .unwrap();
        let settings = settings_of(&slower).unwrap();
        assert_eq!((settings.gains_certificate_crc32, settings.gains_robot_crc32), (0, 0));
        assert!(settings.joint.0.iter().all(|joint| joint.gains() == firmware::feedback::Gains::default()));
        assert_eq!(settings.limits_robot_crc32, crc32_of(&slower));
        let same = settings_of(&RobotModel::load("powercube6").unwrap()).unwrap();
        assert_ne!(same.gains_certificate_crc32, 0);
        assert_ne!(same.limits_robot_crc32, settings.limits_robot_crc32);
    }

    #[test]
    fn a_limit_that_no_drive_can_have_makes_no_settings() {
        let text = robot_model::built_in_text("powercube6").unwrap();
        let limit = "control_acceleration_max_rad_s2 = 10.4";
        let wild = RobotModel::from_toml(
            "edited.toml",
            &text.replace(limit, "control_acceleration_max_rad_s2 = 1e9"),
        );
        // A stricter reader of robot files may refuse it first, by its name.
        match wild {
            Ok(wild) => assert!(matches!(settings_of(&wild), Err(NoSettings::Invalid { .. }))),
            Err(error) => assert!(error.to_string().contains("control_acceleration_max_rad_s2"), "{error}"),
        }
    }

    #[test]
    fn a_robot_without_drives_is_refused_with_the_next_step() {
        let error = settings_of(&RobotModel::load("kr16_2").unwrap()).unwrap_err();
        assert!(error.next().unwrap().contains("give each [[joint]]"), "{error}");
    }
}

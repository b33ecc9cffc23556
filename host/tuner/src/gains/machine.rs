//! Problem data from a robot model and, where there is one, the motion it follows.

use super::plant::Plant;
use super::problem::{JointInput, PhaseInput};
use crate::model::{DriveLag, Estimator};
use robot_model::RobotModel;

/// What gain design needs of a machine.
#[derive(Clone, Debug, PartialEq)]
pub struct Machine {
    /// Name of the robot model.
    pub robot: String,
    /// Joints from the base.
    pub joints: Vec<Plant>,
}

/// Why a machine cannot be tuned.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MachineError {
    /// The robot file describes no position loop.
    #[error("robot {robot} has no [drive_loop]; add natural frequency, damping and resolution of its drives")]
    NoDriveLoop { robot: String },
    /// A plan for another machine.
    #[error(
        "the plan is for robot {plan}, the gains are for {robot}; plan again for {robot} or pass --robot {plan}"
    )]
    OtherRobot {
        /// Robot of the plan.
        plan: String,
        /// Robot being tuned.
        robot: String,
    },
    /// A plan with another number of joints.
    #[error("the plan has {plan} joints, robot {robot} has {joints}")]
    OtherJoints {
        /// Joints in the plan.
        plan: usize,
        robot: String,
        /// Joints of the robot.
        joints: usize,
    },
}

impl Machine {
    /// From a robot model.
    ///
    /// # Errors
    /// [`MachineError::NoDriveLoop`].
    pub fn from_robot(model: &RobotModel) -> Result<Self, MachineError> {
        let robot = model.name().to_owned();
        let Some(drive) = model.drive_loop() else { return Err(MachineError::NoDriveLoop { robot }) };
        let joints = model
            .joints()
            .iter()
            .map(|joint| Plant {
                drive: DriveLag { wn_rad_s: drive.natural_frequency_rad_s, zeta: drive.damping_ratio },
                friction_rad_s2: drive.coulomb_friction_rad_s2,
                resolution_rad: drive.position_resolution_rad,
                velocity_max_rad_s: joint.limits.v_max_rad_s,
                acceleration_max_rad_s2: joint.limits.a_control_max_rad_s2,
            })
            .collect();
        Ok(Self { robot, joints })
    }
}

/// Largest reference accelerations of a motion, phase by phase.
///
/// The planner's file has its own form; the code that follows a plan fills this in.
#[derive(Clone, Debug, PartialEq)]
pub struct ReferenceProfile {
    /// Robot the motion was planned for.
    pub robot: String,
    /// Per joint, per stretch; the last stretch of each has no duration.
    pub phases: Vec<Vec<PhaseInput>>,
}

impl ReferenceProfile {
    /// Standing still, or any motion of which nothing is known but the share of the acceleration for
    /// control that it uses (0 <= `share` < 1).
    pub fn with_share(machine: &Machine, share: f64) -> Self {
        let phases = machine
            .joints
            .iter()
            .map(|j| {
                vec![PhaseInput { duration_s: None, reference_max_rad_s2: share * j.acceleration_max_rad_s2 }]
            })
            .collect();
        Self { robot: machine.robot.clone(), phases }
    }
}

/// Share of the period that the time between two measurements of a joint may differ from it: 2 ms, at least 10 %, at most 25 %.
///
/// At 3 ms, six drives on one bus, commands come within 16 % of the period and measurements within 20 %: a command
/// waits for other frames, and drives answer after 0.2 ms, ± 0.1 ms. Computers add up to milliseconds at longer
/// periods.
pub fn usual_jitter(period_s: f64) -> f64 {
    (0.002 / period_s).clamp(0.1, 0.25)
}

/// Initial errors that a design recovers from by default, rad and rad/s: the controller starts no plan farther from
/// its start (`start_tolerance_rad`), and a larger value than needed costs bandwidth.
pub const START_ERROR: f64 = 0.02;

/// Timing and error set, the same for all joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Demand {
    /// Command period, s.
    pub period_s: f64,
    /// Relative jitter of it.
    pub period_jitter: f64,
    /// Smallest and largest delay, s.
    pub delay_s: (f64, f64),
    /// The controller's estimator.
    pub estimator: Estimator,
    /// Initial position error, rad.
    pub error_position_rad: f64,
    /// Initial velocity error, rad/s.
    pub error_velocity_rad_s: f64,
}

impl Demand {
    /// A command that acts at the latest with the next measurement and [`usual_jitter`] earlier, the
    /// estimator usual at the period, errors of [`START_ERROR`].
    pub fn with_period(period_s: f64) -> Self {
        let jitter = usual_jitter(period_s);
        Self {
            period_s,
            period_jitter: jitter,
            delay_s: ((1.0 - jitter) * period_s, period_s),
            estimator: Estimator::usual(period_s),
            error_position_rad: START_ERROR,
            error_velocity_rad_s: START_ERROR,
        }
    }
}

/// Data of every joint, in order.
///
/// # Errors
/// [`MachineError`] if the motion is for another machine.
pub fn inputs(
    machine: &Machine,
    motion: &ReferenceProfile,
    demand: &Demand,
) -> Result<Vec<JointInput>, MachineError> {
    let robot = machine.robot.clone();
    if motion.robot != machine.robot {
        return Err(MachineError::OtherRobot { plan: motion.robot.clone(), robot });
    }
    if motion.phases.len() != machine.joints.len() {
        return Err(MachineError::OtherJoints {
            plan: motion.phases.len(),
            robot,
            joints: machine.joints.len(),
        });
    }
    let joints = machine.joints.iter().zip(&motion.phases).enumerate();
    Ok(joints
        .map(|(i, (plant, phases))| JointInput {
            joint: i + 1,
            period_s: demand.period_s,
            period_jitter: demand.period_jitter,
            delay_s: demand.delay_s,
            drive: plant.drive,
            estimator: demand.estimator,
            acceleration_max_rad_s2: plant.acceleration_max_rad_s2,
            phases: phases.clone(),
            error_position_rad: demand.error_position_rad,
            error_velocity_rad_s: demand.error_velocity_rad_s,
        })
        .collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn built_in_arm_gives_the_data_of_the_paper() {
        let machine = Machine::from_robot(&RobotModel::load("powercube6").unwrap()).unwrap();
        let a: Vec<f64> = machine.joints.iter().map(|j| j.acceleration_max_rad_s2).collect();
        assert_eq!(a, [10.4, 10.4, 10.4, 10.4, 16.6, 22.3]);
        assert_eq!(machine.joints[0].drive, DriveLag::POWERCUBE);
    }

    #[test]
    fn initial_errors_are_those_at_which_the_controller_starts_a_plan() {
        let settings = firmware::settings::Settings::powercube6();
        assert!(settings.joints().all(|j| settings.joint.at(j).start_tolerance_rad == START_ERROR as f32));
    }

    #[test]
    fn plan_for_another_robot_is_refused() {
        let machine = Machine::from_robot(&RobotModel::load("powercube6").unwrap()).unwrap();
        let demand = Demand::with_period(0.017);
        let mut motion = ReferenceProfile::with_share(&machine, 0.5);
        assert_eq!(inputs(&machine, &motion, &demand).unwrap().len(), 6);
        motion.phases.pop();
        assert!(matches!(inputs(&machine, &motion, &demand), Err(MachineError::OtherJoints { plan: 5, .. })));
        motion.robot = "kr16_2".into();
        assert!(matches!(inputs(&machine, &motion, &demand), Err(MachineError::OtherRobot { .. })));
    }
}

//! What the robot's program must hold for a throw, and the station that fits to it.

use firmware::groups::rsi::Options;
use firmware::joints::PerJoint;
use hil_sim::krc::KrcScenario;
use planner::follow::limits::Arm;
use planner::follow::plan::FollowPlan;
use protocol::Duration;

use super::plan::{Timing, settings_of, trajectory_file};
use super::station::Station;
use super::wire::{ConfigUnfit, Wire};
use crate::throw::trajectory::TrajectoryError;

/// Distance of correction limits from the range of an axis, degrees: a program whose limits reach the range is refused.
const INSIDE_DEG: f64 = 0.01;

/// There is no station for a throw.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NoStation {
    /// The configuration file.
    #[error(transparent)]
    Config(#[from] ConfigUnfit),
    /// The plan.
    #[error(transparent)]
    Plan(#[from] TrajectoryError),
    /// Another period.
    #[error(
        "the plan has a set point every {plan_ms} ms, the robot sends a telegram every {robot_ms} ms\n  next: plan for this robot controller"
    )]
    Period {
        /// Of the plan.
        plan_ms: f64,
        /// Of the robot.
        robot_ms: f64,
    },
    /// No gripper.
    #[error(
        "the robot has no output that opens the gripper\n  next: set output_bit in [gripper] of the scenario"
    )]
    NoGripper,
}

/// What is known of the lag between a set point and the axes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lag {
    /// Pure delay.
    pub dead_time: Duration,
    /// Time constant of the first order behind it.
    pub time_constant: Duration,
}

/// Lets the program of a scenario begin at the start of a plan, as its first motion command does, with corrections up to the
/// ranges of the axes; landings are told at the height of the target.
pub fn prepare(scenario: &mut KrcScenario, arm: &Arm, plan: &FollowPlan) {
    let Some(start) = plan.steps.first() else { return };
    let options = &mut scenario.options;
    let mut widest = options.correction.overall_axis_deg;
    for (axis, joint) in arm.joints().iter().enumerate().take(options.start_deg.len()) {
        let start_deg = start.q_rad[axis].to_degrees();
        let lower = joint.limits.q_min_rad.to_degrees() - start_deg + INSIDE_DEG;
        let upper = joint.limits.q_max_rad.to_degrees() - start_deg - INSIDE_DEG;
        options.start_deg[axis] = start_deg;
        (options.correction.lower[axis], options.correction.upper[axis]) = (lower, upper);
        widest = widest.max(-lower).max(upper);
    }
    options.correction.overall_axis_deg = widest;
    options.hand.gripper.landing_z_m = Some(plan.target_m[2]);
}

/// The station that throws a plan with the robot of a scenario.
///
/// # Errors
/// [`NoStation`].
pub fn station(scenario: &KrcScenario, arm: &Arm, plan: &FollowPlan, lag: Lag) -> Result<Station, NoStation> {
    let krc = &scenario.options;
    let (plan_s, robot_s) = (plan.period_s, krc.cycle.as_secs_f64());
    if (plan_s - robot_s).abs() > 1e-6 {
        return Err(NoStation::Period { plan_ms: 1e3 * plan_s, robot_ms: 1e3 * robot_s });
    }
    let output_bit = krc.hand.output_bit.ok_or(NoStation::NoGripper)?;
    let microseconds = |span: Duration| u32::try_from(span.as_micros()).unwrap_or(u32::MAX);
    let timing =
        Timing { period_us: microseconds(krc.cycle), gripper_delay_us: microseconds(krc.hand.gripper.delay) };
    let settings = settings_of(arm, &plan.robot.fingerprint, &timing, plan.release_time_s);
    let file = trajectory_file(plan, &settings)?;
    let wire = Wire::new(&scenario.config, &krc.outputs_name, output_bit)?;
    let options = Options {
        dead_time: lag.dead_time,
        time_constant: lag.time_constant,
        lower_rad: radians(&krc.correction.lower),
        upper_rad: radians(&krc.correction.upper),
        ..Options::default()
    };
    Ok(Station::new(wire, &settings, options, file))
}

fn radians(deg: &[f64; 6]) -> PerJoint<f32> {
    let mut all = PerJoint::splat(0.0);
    for (to, from) in all.0.iter_mut().zip(deg) {
        *to = from.to_radians() as f32;
    }
    all
}

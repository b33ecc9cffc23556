//! Settings and trajectory file of a throw that follows the flight.

use firmware::joints::PerJoint;
use firmware::registers;
use firmware::settings::{JointSettings, Settings};
use firmware::spline::{Knot, Spline};
use firmware::trajectory_format::{self, FILE_LEN_MAX, Header};
use planner::follow::limits::Arm;
use planner::follow::plan::{FollowPlan, Step};
use protocol::JointIndex;

use crate::bus::settings::robot_crc32;
use crate::throw::trajectory::TrajectoryError;

/// Steps between two knots are left out while the cubic stays this near to them, rad: 5 um at the hand.
const NEAR_RAD: f64 = 2e-6;
/// As [`NEAR_RAD`], of speeds in rad/s.
const NEAR_RAD_S: f64 = 2e-4;
/// Longest stretch without a knot, steps.
const STRETCH: usize = 16;
/// Distance from the reference at which a run ends, rad: the fastest axis moves this far in the longest delay of the path that
/// the group takes. The group itself bounds the distance from the path.
const ERROR_MAX_RAD: f32 = 0.45;
/// Share of the acceleration that a stop along the path uses: the commands lead by the lag, which makes three times as much
/// of its first step.
const STOP_SHARE: f32 = 0.2;
/// Time by which the gripper is ordered before the telegram whose answer shall carry the order, us.
const BEFORE_TELEGRAM_US: i64 = 2_000;

/// What else a throw needs to know about the robot's program.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Timing {
    /// Time between two telegrams, us.
    pub period_us: u32,
    /// From the output to the free ball, us.
    pub gripper_delay_us: u32,
}

/// Number `name` of the registers, the largest value that it takes.
fn largest(name: &str) -> f32 {
    registers::TABLE.iter().find(|info| info.name == name).map_or(f32::MAX, |info| info.max)
}

/// Settings of the controller for an arm whose own controller closes its loops.
///
/// Ranges and speeds are those of the robot file. Accelerations are bounded by the controller of the robot, so only what no
/// plan reaches is set here.
#[must_use]
pub fn settings_of(arm: &Arm, fingerprint: &str, timing: &Timing, release_s: f64) -> Settings {
    let mut settings = Settings::powercube6();
    settings.joints = arm.joints().len() as u32;
    settings.robot_crc32 = robot_crc32(fingerprint);
    settings.limits_robot_crc32 = settings.robot_crc32;
    settings.cycle_period_us = timing.period_us;
    settings.reply_missed_max = 3;
    settings.cycle_late_max = 5;
    settings.stop_share = STOP_SHARE;
    settings.gains_certificate_crc32 = 0;
    settings.gripper_opening_us = opening_us(timing, release_s);
    let (v_max, a_max) = (largest("joint.v_max_rad_s"), largest("joint.a_max_rad_s2"));
    let PerJoint(places) = &mut settings.joint;
    for (place, joint) in places.iter_mut().zip(arm.joints()) {
        let limits = &joint.limits;
        *place = JointSettings {
            q_min_rad: limits.q_min_rad as f32,
            q_max_rad: limits.q_max_rad as f32,
            v_max_rad_s: (limits.v_max_rad_s as f32).min(v_max),
            a_max_rad_s2: a_max,
            error_max_rad: ERROR_MAX_RAD,
            ..*place
        };
    }
    settings
}

/// From the order to the free ball, us, so that the order comes shortly before a telegram of the path.
///
/// The order goes out with the answer to a telegram, is in force one period later, and frees the ball after the delay of the
/// gripper. Of all telegrams the one is taken whose ball is free nearest to the release.
fn opening_us(timing: &Timing, release_s: f64) -> u32 {
    let (period, delay) = (i64::from(timing.period_us), i64::from(timing.gripper_delay_us));
    let release = (release_s * 1e6).round() as i64;
    let telegram = ((release - delay - period) as f64 / period as f64).round() as i64 * period;
    u32::try_from(release - (telegram - BEFORE_TELEGRAM_US)).unwrap_or(0)
}

/// Trajectory file of a plan, checked as the controller will check it.
///
/// # Errors
/// [`TrajectoryError`].
pub fn trajectory_file(plan: &FollowPlan, settings: &Settings) -> Result<Vec<u8>, TrajectoryError> {
    let kept = knots_kept(plan);
    let knots: Vec<Knot> = kept.iter().map(|k| knot(&plan.steps[*k])).collect();
    let too_long = || TrajectoryError::TooLong {
        knots: knots.len(),
        duration_s: plan.steps.last().map_or(0.0, |step| step.t_s),
    };
    let header = Header {
        joints: settings.joints as u8,
        period_us: settings.cycle_period_us,
        release_us: Some((plan.release_time_s * 1e6).round() as u32),
        robot_crc32: robot_crc32(&plan.robot.fingerprint),
    };
    let mut bytes = vec![0; FILE_LEN_MAX];
    let length = trajectory_format::encode(&header, &knots, &mut bytes).ok_or_else(too_long)?;
    bytes.truncate(length);
    let mut spline = Box::new(Spline::empty());
    let read = |offset: usize, out: &mut [u8]| {
        out.copy_from_slice(&bytes[offset..offset + out.len()]);
        Ok(())
    };
    trajectory_format::decode(length, read, &mut spline)
        .and_then(|header| trajectory_format::check(&header, &spline, settings))
        .map_err(|refusal| TrajectoryError::Refused {
            cause: refusal.cause,
            joint: refusal.joint.map(|joint| joint.get() + 1),
            place: refusal.index,
        })?;
    Ok(bytes)
}

fn knot(step: &Step) -> Knot {
    let mut knot = Knot { t_us: (step.t_s * 1e6).round() as u32, ..Knot::default() };
    for joint in JointIndex::first(step.q_rad.len()) {
        let k = joint.get();
        knot.state.set(joint, (step.q_rad[k] as f32, step.qd_rad_s[k] as f32));
    }
    knot
}

/// Indices of the steps that become knots: as few as keep the cubics near all steps.
fn knots_kept(plan: &FollowPlan) -> Vec<usize> {
    let last = plan.steps.len() - 1;
    let mut kept = vec![0];
    while let Some(&from) = kept.last().filter(|from| **from < last) {
        let fits = |to: &usize| (from + 1..*to).all(|k| is_near(plan, from, *to, k));
        let to = (from + 1..=last.min(from + STRETCH)).rev().find(fits).unwrap_or(from + 1);
        kept.push(to);
    }
    kept
}

fn is_near(plan: &FollowPlan, from: usize, to: usize, k: usize) -> bool {
    let (a, b, step) = (&plan.steps[from], &plan.steps[to], &plan.steps[k]);
    let h = b.t_s - a.t_s;
    let x = (step.t_s - a.t_s) / h;
    (0..step.q_rad.len()).all(|axis| {
        let (qa, qb) = (a.q_rad[axis], b.q_rad[axis]);
        let (va, vb) = (a.qd_rad_s[axis] * h, b.qd_rad_s[axis] * h);
        let (c2, c3) = (3.0 * (qb - qa) - 2.0 * va - vb, 2.0 * (qa - qb) + va + vb);
        let q = qa + x * (va + x * (c2 + x * c3));
        let qd = (va + x * (2.0 * c2 + 3.0 * x * c3)) / h;
        (q - step.q_rad[axis]).abs() <= NEAR_RAD && (qd - step.qd_rad_s[axis]).abs() <= NEAR_RAD_S
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn order_to_open_comes_before_a_telegram_and_frees_the_ball_within_half_a_period_of_the_release() {
        let timing = Timing { period_us: 12_000, gripper_delay_us: 20_000 };
        for release_us in (500_000..512_000).step_by(500) {
            let opening = i64::from(opening_us(&timing, f64::from(release_us) * 1e-6));
            let ordered = i64::from(release_us) - opening;
            let telegram = ordered + BEFORE_TELEGRAM_US;
            assert_eq!(telegram % 12_000, 0);
            let free = telegram + 12_000 + 20_000;
            assert!((free - i64::from(release_us)).abs() <= 6_000, "{release_us}");
        }
    }
}

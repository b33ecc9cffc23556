//! Settings and motion of a throw that follows the flight.

use firmware::joints::PerJoint;
use firmware::registers;
use firmware::settings::{JointSettings, Settings};
use planner::follow::limits::Arm;
use planner::follow::plan::{FollowPlan, Step};
use planner::motion::{GripperEvent, Knot, Motion};
use planner::plan::Joints;
use robot_model::cubic::Cubic;

use crate::bus::settings::robot_crc32;

/// Steps between two knots are left out while the cubic stays this near to them, rad: 5 um at the hand.
const NEAR_RAD: f64 = 2e-6;
/// As [`NEAR_RAD`], of speeds in rad/s.
const NEAR_RAD_S: f64 = 2e-4;
/// Longest stretch without a knot, steps.
const STRETCH: usize = 16;
/// Largest distance of an axis from its path while the robot accepts every answer, rad. The group removes the known lag and the
/// measured delay of the path from the positions, so only the distance of an axis from its path remains: 0.0004 rad with
/// the simulated robot.
const OFF_PATH_RAD: f64 = 0.06;
/// Cycles in a row that a robot may hold its set points before the run ends by their number (`reply_missed_max`, and the late
/// answers of [`firmware::groups::rsi::Options`]).
const CYCLES_TOLERATED: u32 = 2;
/// Largest acceleration of an axis, rad/s²: twice what a set point may have, so that no plan reaches it.
const A_MAX_RAD_S2: f32 = 70.0;
/// Share of it that a stop along the path uses. The commands lead by the lag, which makes its first step three
/// times as large: 21 rad/s² within a cycle of 12 ms are 100 000 deg/s³. A KR C2 stops by itself at 150 000.
const STOP_SHARE: f32 = 0.1;
/// Time by which the gripper is ordered before the telegram whose answer carries the order, us.
const BEFORE_TELEGRAM_US: i64 = 2_000;

/// What else a throw needs to know about the robot's program.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Timing {
    /// Time between two telegrams, us.
    pub period_us: u32,
    /// Dead time of the axes, us. Set points are sent so much earlier: the path begins this time and whole periods after a telegram.
    pub dead_time_us: u32,
    /// From the output to the free ball, us.
    pub gripper_delay_us: u32,
}

/// Number `name` of the registers, the largest value that it takes.
fn largest(name: &str) -> f32 {
    registers::TABLE.iter().find(|info| info.name == name).map_or(f32::MAX, |info| info.max)
}

/// Settings of the controller for an arm whose own controller closes its loops.
///
/// Ranges and speeds are those of the robot file. The controller of the robot limits accelerations, so the limit
/// here is one that no plan reaches.
#[must_use]
pub fn settings_of(arm: &Arm, fingerprint: &str, timing: &Timing, release_s: f64) -> Settings {
    let mut settings = Settings::powercube6();
    settings.joints = arm.joints().len() as u32;
    settings.robot_crc32 = robot_crc32(fingerprint);
    settings.limits_robot_crc32 = settings.robot_crc32;
    settings.cycle_period_us = timing.period_us;
    settings.reply_missed_max = CYCLES_TOLERATED + 1;
    settings.cycle_late_max = 5;
    settings.stop_share = STOP_SHARE;
    settings.gains_certificate_crc32 = 0;
    settings.gripper_opening_us = opening_us(timing, release_s);
    let v_max = largest("joint.v_max_rad_s");
    let PerJoint(places) = &mut settings.joint;
    for (place, joint) in places.iter_mut().zip(arm.joints()) {
        let limits = &joint.limits;
        *place = JointSettings {
            q_min_rad: limits.q_min_rad as f32,
            q_max_rad: limits.q_max_rad as f32,
            v_max_rad_s: (limits.v_max_rad_s as f32).min(v_max),
            a_max_rad_s2: A_MAX_RAD_S2,
            error_max_rad: error_max_rad(limits.v_max_rad_s, timing),
            ..*place
        };
    }
    settings
}

/// Distance of an axis from its reference at which a run ends, rad.
///
/// A late answer is reported by the count of late answers, not as an axis off its path: the bound is larger than
/// the way of the axis in the tolerated cycles, at its largest speed. In one cycle of 12 ms that is 0.13 rad for A6
/// of a KR 16 and 0.03 rad for A1, so the axes have bounds of their own. An axis that does not follow its set
/// points ends the run by the model of the drives, for any value of this bound.
fn error_max_rad(v_max_rad_s: f64, timing: &Timing) -> f32 {
    let held_s = f64::from(CYCLES_TOLERATED * timing.period_us) * 1e-6;
    let bound = (OFF_PATH_RAD + v_max_rad_s * held_s) as f32;
    bound.min(largest("joint.error_max_rad"))
}

/// From the order to the free ball, us, so that the order comes shortly before a telegram of the path.
///
/// The order goes out with the answer to a telegram, is in force one period later, and frees the ball after the delay of the
/// gripper. Of all telegrams the one is taken whose ball is free nearest to the release, so the ball is free up to half a period
/// early or late.
fn opening_us(timing: &Timing, release_s: f64) -> u32 {
    let period = i64::from(timing.period_us);
    let (dead_time, delay) = (i64::from(timing.dead_time_us), i64::from(timing.gripper_delay_us));
    let release = (release_s * 1e6).round() as i64;
    // By the time of the path telegrams come a dead time before whole periods.
    let periods = ((release - delay - period + dead_time) as f64 / period as f64).round() as i64;
    let telegram = periods * period - dead_time;
    u32::try_from(release - (telegram - BEFORE_TELEGRAM_US)).unwrap_or(0)
}

/// The motion of a plan, with as few knots as keep it near all steps; the gripper opens at the release.
#[must_use]
pub fn motion_of(plan: &FollowPlan) -> Motion {
    let knot = |step: &Step| Knot {
        t_s: step.t_s,
        q_rad: Joints::from_slice(&step.q_rad),
        qd_rad_s: Joints::from_slice(&step.qd_rad_s),
    };
    Motion {
        knots: knots_kept(plan).into_iter().map(|k| knot(&plan.steps[k])).collect(),
        events: vec![(plan.release_time_s, GripperEvent::Open)],
    }
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
    let t_s = step.t_s - a.t_s;
    (0..step.q_rad.len()).all(|axis| {
        let cubic = Cubic::between(
            b.t_s - a.t_s,
            (a.q_rad[axis], a.qd_rad_s[axis]),
            (b.q_rad[axis], b.qd_rad_s[axis]),
        );
        (cubic.position(t_s) - step.q_rad[axis]).abs() <= NEAR_RAD
            && (cubic.velocity(t_s) - step.qd_rad_s[axis]).abs() <= NEAR_RAD_S
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_axis_may_be_away_by_the_way_that_it_makes_in_the_cycles_that_may_be_late() {
        let arm = Arm::load("kr16_2").expect("built in");
        let timing = Timing { period_us: 12_000, dead_time_us: 96_000, gripper_delay_us: 20_000 };
        let bounds =
            settings_of(&arm, "0123456789abcdef", &timing, 1.0).joint.0.map(|joint| joint.error_max_rad);
        for (bound, joint) in bounds.iter().zip(arm.joints()) {
            let two_cycles = 0.024 * joint.limits.v_max_rad_s as f32;
            assert!((bound - two_cycles - 0.06).abs() < 1e-6, "{bound}");
        }
        // 150 and 615 deg/s.
        assert!((bounds[0] - 0.123).abs() < 1e-3 && (0.317..0.319).contains(&bounds[5]), "{bounds:?}");
        let fast = Timing { period_us: 4_000, ..timing };
        assert!(settings_of(&arm, "0123456789abcdef", &fast, 1.0).joint.0[5].error_max_rad < 0.5 * bounds[5]);
    }

    #[test]
    fn order_to_open_comes_before_a_telegram_and_frees_the_ball_within_half_a_period_of_the_release() {
        // Telegrams are whole periods and the dead time before the path.
        for dead_time_us in [0, 96_000, 99_000, 78_300] {
            let timing = Timing { period_us: 12_000, dead_time_us, gripper_delay_us: 20_000 };
            let mut late = Vec::new();
            for release_us in (500_000..512_000).step_by(500) {
                let opening = i64::from(opening_us(&timing, f64::from(release_us) * 1e-6));
                let ordered = i64::from(release_us) - opening;
                let telegram = ordered + BEFORE_TELEGRAM_US;
                assert_eq!((telegram + i64::from(dead_time_us)) % 12_000, 0);
                let free = telegram + 12_000 + 20_000;
                late.push(free - i64::from(release_us));
            }
            assert!(late.iter().all(|late| late.abs() <= 6_000), "{dead_time_us}: {late:?}");
            assert!(late.iter().any(|late| *late > 5_000), "{dead_time_us}: {late:?}");
            assert!(late.iter().any(|late| *late < -5_000), "{dead_time_us}: {late:?}");
        }
    }
}

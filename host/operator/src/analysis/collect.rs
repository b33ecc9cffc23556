//! Samples of a run by time of the plan.

use protocol::cyphal::cubecell::group_state::{GroupState, State};
use protocol::cyphal::cubecell::joint_state::JointSample;
use serde::Serialize;

use super::{Counts, PlanClock};
use crate::samples::{At, JointSamples, Samples};

/// A number at a time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Reading {
    /// Time of the plan, s.
    pub t_s: f64,
    pub value: f64,
}

/// A ramp that a drive was ordered to make.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Commanded {
    /// Time of the plan at which the order was given, s.
    pub t_s: f64,
    /// Angle of the joint to ramp to, rad.
    pub target_rad: f64,
    /// Speed of the ramp as last written, rad/s.
    pub v_rad_s: Option<f64>,
    /// Acceleration of the ramp as last written, rad/s².
    pub a_rad_s2: Option<f64>,
}

/// What is known of one joint.
#[derive(Clone, Debug, Default)]
pub struct JointLog {
    /// Measured angles in rad.
    pub positions: Vec<Reading>,
    /// Current in A, positive if it turns the joint forwards.
    pub currents: Vec<Reading>,
    /// Temperature in degrees Celsius.
    pub temperatures: Vec<Reading>,
    /// Ramps ordered.
    pub commands: Vec<Commanded>,
    /// Telemetry of the controller about this joint.
    pub telemetry: Vec<(f64, JointSample)>,
}

/// Data recorded of a group.
#[derive(Clone, Debug, Default)]
pub struct Heard {
    pub joints: Vec<JointLog>,
    /// The controller's own account, by time of the plan.
    pub group: Vec<(f64, GroupState)>,
    /// When the gripper was ordered to open or to close.
    pub gripper_ordered_t_s: Vec<f64>,
}

impl Heard {
    /// True if the group left Running for Ready after the plan had ended.
    #[must_use]
    pub fn completed(&self, end_t_s: f64) -> bool {
        let mut ran = false;
        for (t_s, group) in self.group.iter().filter(|(t_s, _)| *t_s > 0.0) {
            match group.state {
                State::Running => ran = true,
                State::Ready if ran => return *t_s >= end_t_s,
                State::Stopping | State::Stopped | State::Fault => return false,
                _ => {}
            }
        }
        false
    }

    /// Differences of the controller's counts over the run.
    #[must_use]
    pub fn counts(&self, end_t_s: f64) -> Counts {
        let before = self.group.iter().rev().find(|(t_s, _)| *t_s <= 0.0).or(self.group.first());
        // The count of the last cycles comes with the change to the next state.
        let after = self
            .group
            .iter()
            .find(|(t_s, group)| *t_s > 0.0 && *t_s >= end_t_s && group.state != State::Running)
            .or(self.group.last());
        let (Some((_, from)), Some((_, to))) = (before, after) else { return Counts::default() };
        Counts {
            cycles_saturated: to.cycles_saturated.saturating_sub(from.cycles_saturated),
            cycles_late: to.cycles_late.saturating_sub(from.cycles_late),
            replies_missed: to.replies_missed.saturating_sub(from.replies_missed),
        }
    }
}

#[must_use]
pub fn collect(samples: &Samples, clock: PlanClock) -> Heard {
    Heard {
        joints: samples.joints.iter().map(|joint| joint_log(joint, clock)).collect(),
        group: samples.group.iter().map(|reported| (clock.t_s(reported.at), reported.state)).collect(),
        gripper_ordered_t_s: samples.gripper_ordered.iter().map(|at| clock.t_s(*at)).collect(),
    }
}

fn joint_log(joint: &JointSamples, clock: PlanClock) -> JointLog {
    let readings =
        |all: &[At]| all.iter().map(|x| Reading { t_s: clock.t_s(x.at), value: x.value }).collect();
    JointLog {
        positions: readings(&joint.positions),
        currents: readings(&joint.currents),
        temperatures: readings(&joint.temperatures),
        commands: joint
            .orders
            .iter()
            .map(|order| Commanded {
                t_s: clock.t_s(order.at),
                target_rad: order.target_rad,
                v_rad_s: order.v_rad_s,
                a_rad_s2: order.a_rad_s2,
            })
            .collect(),
        telemetry: joint.reported.iter().map(|(at, sample)| (clock.t_s(*at), *sample)).collect(),
    }
}

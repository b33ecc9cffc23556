//! What happened, by time of the plan; and the first fault with everything known at that moment.

use firmware::fault::Cause;
use serde::Serialize;

use super::PlanClock;
use crate::log::watch::Severity;
use crate::samples::{Freeze, Samples};
use planner::motion::Motion;

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RunEvent {
    /// Time of the plan, s.
    pub t_s: f64,
    /// How much it matters.
    pub severity: Severity,
    pub source: String,
    pub text: String,
}

/// The group at the moment of the first fault or stop after the start of the plan.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FirstFault {
    /// Time of the plan, s.
    pub t_s: f64,
    /// Number; `cubectl explain` knows it.
    pub code: u16,
    /// Joint from 1; `None`: the group.
    pub joint: Option<u8>,
    pub what: String,
    /// What to do.
    pub recovery: String,
    pub state_before: String,
    /// What was known of each joint.
    pub joints: Vec<FrozenJoint>,
    /// The last frames before it, oldest first.
    pub frames: Vec<String>,
}

/// A joint at the moment of a fault, from the last messages.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct FrozenJoint {
    pub q_rad: Option<f64>,
    /// Reference minus position at the time of the position, rad.
    pub error_rad: Option<f64>,
    pub age_s: Option<f64>,
    pub current_a: Option<f64>,
    /// Acceleration written last, rad/s².
    pub ramp_a_rad_s2: Option<f64>,
    /// Target of the last ramp ordered, rad.
    pub ramp_target_rad: Option<f64>,
}

/// Everything that happened, by time of the plan.
#[must_use]
pub fn events(samples: &Samples, clock: PlanClock) -> Vec<RunEvent> {
    let reported = samples.events.iter().map(|event| RunEvent {
        t_s: clock.t_s(event.at),
        severity: event.severity,
        source: event.source.clone(),
        text: event.text.clone(),
    });
    reported.collect()
}

/// The first fault after the start of the plan.
#[must_use]
pub fn first_fault(samples: &Samples, motion: &Motion, clock: PlanClock) -> Option<FirstFault> {
    let freeze = samples.freezes.iter().find(|freeze| clock.t_s(freeze.at) > 0.0)?;
    Some(in_time_of(freeze, motion, clock))
}

fn in_time_of(freeze: &Freeze, motion: &Motion, clock: PlanClock) -> FirstFault {
    let t_s = clock.t_s(freeze.at);
    let group = &freeze.group;
    let info = Cause::from_code(group.fault_cause).and_then(Cause::info);
    let joints = freeze
        .joints
        .iter()
        .enumerate()
        .map(|(j, known)| {
            let position = known.position.map(|p| (clock.t_s(p.at), p.value));
            FrozenJoint {
                q_rad: position.map(|(_, q_rad)| q_rad),
                error_rad: position.map(|(at_s, q_rad)| motion.at(at_s).q[j] - q_rad),
                age_s: position.map(|(at_s, _)| t_s - at_s),
                current_a: known.current_a,
                ramp_a_rad_s2: known.ramp_a_rad_s2,
                ramp_target_rad: known.ramp_target_rad,
            }
        })
        .collect();
    FirstFault {
        t_s,
        code: group.fault_cause,
        joint: (group.fault_joint > 0).then_some(group.fault_joint),
        what: info.map_or_else(|| format!("cause {}", group.fault_cause), |info| info.what.to_owned()),
        recovery: info.map_or_else(String::new, |info| info.recovery.to_owned()),
        state_before: freeze.before.to_string(),
        joints,
        frames: freeze.frames.iter().map(|(at, text)| format!("{:+.6} s  {text}", clock.t_s(*at))).collect(),
    }
}

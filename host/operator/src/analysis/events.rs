//! What happened, by time of the plan; and the first fault with everything known at that moment.

use std::collections::BTreeMap;

use firmware::fault::Cause;
use serde::Serialize;

use super::drives::Drives;
use super::{PlanClock, Run};
use crate::log::watch::{FreezeFrame, Severity, Watch};
use planner::verify::motion;

/// Something that happened.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Event {
    /// Time of the plan, s.
    pub t_s: f64,
    /// How much it matters.
    pub severity: Severity,
    /// Who says so.
    pub source: String,
    /// What.
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
    /// What happened.
    pub what: String,
    /// What to do.
    pub recovery: String,
    /// State before.
    pub state_before: String,
    /// What was known of each joint.
    pub joints: Vec<FrozenJoint>,
    /// The last frames before it, oldest first.
    pub frames: Vec<String>,
}

/// A joint at the moment of a fault, as last heard.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct FrozenJoint {
    /// Position, rad.
    pub q_rad: Option<f64>,
    /// Reference minus position at the time of the position, rad.
    pub error_rad: Option<f64>,
    /// Age of the position, s.
    pub age_s: Option<f64>,
    /// Current, A.
    pub current_a: Option<f64>,
    /// Acceleration written last, rad/s².
    pub ramp_a_rad_s2: Option<f64>,
    /// Target of the last ramp ordered, rad.
    pub ramp_target_rad: Option<f64>,
}

/// Everything that happened in the log, and the first fault after the start of the plan.
#[must_use]
pub fn events(run: &Run<'_>, drives: &Drives, clock: PlanClock) -> (Vec<Event>, Option<FirstFault>) {
    let names =
        drives.address.iter().zip(run.arm.joints()).map(|(address, joint)| (*address, joint.name.clone()));
    let mut watch = Watch::new(names.collect::<BTreeMap<_, _>>());
    let (mut events, mut fault) = (Vec::new(), None);
    for line in run.lines {
        let notes = watch.take(line.at, &line.frame);
        events.extend(notes.events.into_iter().map(|event| Event {
            t_s: clock.t_s(event.at),
            severity: event.severity,
            source: event.source,
            text: event.text,
        }));
        if let Some(freeze) = notes.freeze.filter(|freeze| clock.t_s(freeze.at) > 0.0) {
            fault.get_or_insert_with(|| first_fault(run, drives, clock, &freeze));
        }
    }
    (events, fault)
}

fn first_fault(run: &Run<'_>, drives: &Drives, clock: PlanClock, freeze: &FreezeFrame) -> FirstFault {
    let t_s = clock.t_s(freeze.at);
    let group = &freeze.group;
    let info = Cause::from_code(group.fault_cause).and_then(Cause::info);
    let joints = drives
        .address
        .iter()
        .enumerate()
        .map(|(j, address)| {
            let heard = freeze.drives.get(address).copied().unwrap_or_default();
            let position = heard.position.map(|(at, rad)| (clock.t_s(at), drives.joint_rad(j, rad)));
            FrozenJoint {
                q_rad: position.map(|(_, q_rad)| q_rad),
                error_rad: position.map(|(at_s, q_rad)| motion::at(run.plan, at_s).q[j] - q_rad),
                age_s: position.map(|(at_s, _)| t_s - at_s),
                current_a: heard.current_a.map(|a| drives.turned(j, a)),
                ramp_a_rad_s2: heard.ramp_a_rad_s2,
                ramp_target_rad: heard.ramp_target_rad.map(|rad| drives.joint_rad(j, rad)),
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
        frames: freeze
            .frames
            .iter()
            .map(|(at, frame)| format!("{:+.6} s  {frame}", clock.t_s(*at)))
            .collect(),
    }
}

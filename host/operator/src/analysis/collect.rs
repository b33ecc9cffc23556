//! One pass over the log: what each drive and the controller said, in time of the plan.

use protocol::bits;
use protocol::cyphal::cubecell::group_state::{GroupState, State};
use protocol::cyphal::cubecell::joint_state::JointSample;
use protocol::powercube::{MotionCommand, Parameter, Reply, Request, Value};
use serde::Serialize;

use super::drives::Drives;
use super::{Counts, PlanClock, span_of};
use crate::log::candump::Line;
use crate::log::facts::{Decoder, Fact, position};
use planner::throw::JOINTS;

/// A number at a time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Reading {
    /// Time of the plan, s.
    pub t_s: f64,
    /// The number.
    pub value: f64,
}

/// A ramp that a drive was told to make.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Commanded {
    /// Time of the plan at which the order was on the bus, s.
    pub t_s: f64,
    /// Angle of the joint to ramp to, rad.
    pub target_rad: f64,
    /// Speed of the ramp as last written, rad/s.
    pub v_rad_s: Option<f64>,
    /// Acceleration of the ramp as last written, rad/s².
    pub a_rad_s2: Option<f64>,
}

/// What one drive said and was told.
#[derive(Clone, Debug, Default)]
pub struct DriveLog {
    /// Angle of the joint in rad, at the time at which the answer that carries it began: drives measure just before they answer.
    pub positions: Vec<Reading>,
    /// Current in A, positive if it turns the joint forwards.
    pub currents: Vec<Reading>,
    /// Ramps ordered.
    pub commands: Vec<Commanded>,
    /// Telemetry of the controller about this joint.
    pub telemetry: Vec<(f64, JointSample)>,
    v_rad_s: Option<f64>,
    a_rad_s2: Option<f64>,
}

/// What was heard of a group.
#[derive(Clone, Debug, Default)]
pub struct Heard {
    /// One per joint.
    pub drives: Vec<DriveLog>,
    /// The controller's own account, by time of the plan.
    pub group: Vec<(f64, GroupState)>,
    /// When a digital output of a module was written during the plan: the gripper.
    pub output_written_t_s: Vec<f64>,
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

/// Reads the whole log. `bit_s` is the time of a bit.
#[must_use]
pub fn collect(lines: &[Line], drives: &Drives, clock: PlanClock, bit_s: f64) -> Heard {
    let mut decoder = Decoder::default();
    let mut heard = Heard { drives: vec![DriveLog::default(); JOINTS], ..Heard::default() };
    for line in lines {
        let Some(fact) = decoder.take(line.at, &line.frame) else { continue };
        let t_s = clock.t_s(line.at);
        match fact {
            Fact::Request { module, request } => {
                if let Request::Set(Parameter::DioData, _) = request {
                    heard.output_written_t_s.push(t_s);
                }
                if let Some(joint) = drives.joint_of(module) {
                    heard.drives[joint].ordered(t_s, request, Mounting { drives, joint });
                }
            }
            Fact::Reply { module, reply } => {
                let begun = line.at.saturating_sub(span_of(bits::length(&line.frame).frame(), bit_s));
                if let Some(joint) = drives.joint_of(module) {
                    heard.drives[joint].answered(clock.t_s(begun), &reply, Mounting { drives, joint });
                }
            }
            Fact::Group { state, .. } => heard.group.push((t_s, state)),
            Fact::Joints { state, .. } => {
                for (drive, sample) in heard.drives.iter_mut().zip(state.joints()) {
                    drive.telemetry.push((t_s, *sample));
                }
            }
            _ => {}
        }
    }
    heard
}

/// How one drive is mounted.
#[derive(Clone, Copy)]
struct Mounting<'a> {
    drives: &'a Drives,
    joint: usize,
}

impl DriveLog {
    fn ordered(&mut self, t_s: f64, request: Request, mounting: Mounting<'_>) {
        match request {
            Request::Set(Parameter::TargetVel, Value::F32(v)) => self.v_rad_s = Some(v.into()),
            Request::Set(Parameter::TargetAcc, Value::F32(a)) => self.a_rad_s2 = Some(a.into()),
            Request::Move(motion) => {
                if let MotionCommand::Ramp { target } = motion.command() {
                    let target_rad = mounting.drives.joint_rad(mounting.joint, target.get().into());
                    let (v_rad_s, a_rad_s2) = (self.v_rad_s, self.a_rad_s2);
                    self.commands.push(Commanded { t_s, target_rad, v_rad_s, a_rad_s2 });
                }
            }
            _ => {}
        }
    }

    fn answered(&mut self, t_s: f64, reply: &Reply, Mounting { drives, joint }: Mounting<'_>) {
        if let Some((q_rad, _)) = position(reply) {
            self.positions.push(Reading { t_s, value: drives.joint_rad(joint, q_rad) });
        }
        if let Reply::Value(Parameter::Cur, Value::F32(a)) = reply {
            self.currents.push(Reading { t_s, value: drives.turned(joint, f64::from(*a)) });
        }
    }
}

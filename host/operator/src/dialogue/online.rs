//! New end states for a controller that runs a trajectory with an envelope: sent without waiting, answered one by one.
//!
//! ```text
//! upload a plan with an envelope ──▶ arm ──▶ start_run ──▶ send_target, up to 120 a second ──▶ rest
//!                                              read_clock       └──▶ target_answers
//! ```
//!
//! * **When it acts.** A message takes 1 to 6 ms on a bus that the drives share at a cycle of 3 ms. After that it takes two
//!   control periods and the lag of the drives (11 ms with PowerCubes) until the new motion begins; the end state must be reached
//!   at least 20 ms later ([`REACH_MIN_US`]).
//! * **The way.** Per joint the least peak acceleration that keeps the time, within the envelope ([`firmware::retarget`]), then
//!   braking to rest. A host that plans with [`Course`] plans what the controller does, to single precision.
//! * **Refused.** The answer has the cause ([`Cause`]) and the joint. The motion before continues.
//! * **Times** are those of the controller's clock: [`ControllerClock`](super::clock::ControllerClock).
//!
//! [`REACH_MIN_US`]: firmware::retarget::REACH_MIN_US
//! [`Course`]: firmware::retarget::Course

use firmware::events::Action;
use firmware::fault::{Cause, Refusal};
use protocol::cyphal::cubecell::command::{self, Run, Trajectory};
use protocol::cyphal::cubecell::group_state::State;
use protocol::cyphal::cubecell::target::{TargetEvent, TargetJoint, TargetState};
use protocol::cyphal::id::NodeId;
use protocol::{Duration, Instant, JointIndex};

use super::operator::OperatorError;
use crate::bus::session::Session;

/// Longest time until a run that was ordered to begin at once shows.
const BEGIN_MAX: Duration = Duration::from_secs(1);

/// An end state of all joints.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct EndStates {
    /// When, in the time of the controller.
    pub at: Instant,
    /// Positions, base first, rad; within ±8.38 rad.
    pub q_rad: Vec<f64>,
    pub qd_rad_s: Vec<f64>,
    /// Up to two events and when they happen, within 8.38 s of `at`; they replace all that are still to come.
    pub events: Vec<(Instant, Action)>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Answered {
    /// When the answer came, in our time.
    pub at: Instant,
    /// The number that [`Session::send_target`] was given.
    pub sequence: u8,
    /// Taken, or why not.
    pub outcome: Result<(), Refusal>,
}

impl Session {
    /// Begins the armed trajectory and returns as soon as it runs; the arm is halted if the session ends before
    /// [`Session::release_motion`].
    pub fn start_run(&mut self, node: NodeId, name: &Trajectory) -> Result<(), OperatorError> {
        self.guard_motion();
        let Trajectory { trajectory_crc64, length_bytes } = *name;
        self.order(node, "to run", command::RUN, &Run { trajectory_crc64, length_bytes, start_us: 0 })?;
        self.wait_for(BEGIN_MAX, &|state| state == State::Running)
    }

    /// Sends a new end state and does not wait. `sequence` comes back with the answer.
    ///
    /// # Errors
    /// [`OperatorError::TargetNotSaid`] if the message cannot hold the end state, or the queue to the bus is full;
    /// nothing is sent then.
    pub fn send_target(&mut self, sequence: u8, end: &EndStates) -> Result<(), OperatorError> {
        let message = message_of(sequence, end)?;
        self.host_node()
            .publish_target(&message)
            .map_err(|_| OperatorError::TargetNotSaid { what: "the queue to the bus is full" })
    }

    /// The answers of `node` that have come since the last call, oldest first. The newest 256 are kept.
    pub fn target_answers(&mut self, node: NodeId) -> Vec<Answered> {
        let Some(inbox) = self.host_node().inbox() else { return Vec::new() };
        let answers = inbox.target_answers.drain(..).filter(|(_, source, _)| *source == node);
        answers
            .map(|(at, _, answer)| Answered { at, sequence: answer.sequence, outcome: outcome_of(answer) })
            .collect()
    }
}

/// An end state as it is on the wire.
pub(crate) fn message_of(sequence: u8, end: &EndStates) -> Result<TargetState, OperatorError> {
    let not_said = |what| OperatorError::TargetNotSaid { what };
    if end.q_rad.len() != end.qd_rad_s.len() || end.q_rad.len() > protocol::JOINTS_MAX {
        return Err(not_said("as many velocities as positions are needed, eight at most"));
    }
    let mut joints = Vec::new();
    for (q_rad, qd_rad_s) in end.q_rad.iter().zip(&end.qd_rad_s) {
        let q_urad = (q_rad * 1e6).round();
        if !(q_urad.abs() < f64::from(1 << 23) && qd_rad_s.is_finite()) {
            return Err(not_said("a position is beyond 8.38 rad, or a number is not finite"));
        }
        joints.push(TargetJoint { q_urad: q_urad as i32, qd_rad_s: *qd_rad_s as f32 });
    }
    if end.events.len() > protocol::cyphal::cubecell::target::EVENTS_MAX {
        return Err(not_said("there is room for two events"));
    }
    let mut events = Vec::new();
    for (at, action) in &end.events {
        let offset_us = at.as_micros() as i64 - end.at.as_micros() as i64;
        if offset_us.abs() >= 1 << 23 {
            return Err(not_said("an event is more than 8.38 s from the end state"));
        }
        events.push(TargetEvent { action: action.number(), offset_us: offset_us as i32 });
    }
    Ok(TargetState::new(end.at.as_micros(), sequence, &joints, &events))
}

fn outcome_of(answer: protocol::cyphal::cubecell::target::TargetAnswer) -> Result<(), Refusal> {
    if answer.cause == 0 {
        return Ok(());
    }
    let joint = usize::from(answer.joint).checked_sub(1).and_then(|index| JointIndex::new(index).ok());
    // A cause of a newer controller that is not known here.
    let cause = Cause::from_code(answer.cause).unwrap_or(Cause::BadValue);
    Err(Refusal { cause, joint, index: answer.index })
}

//! The operator's side of a controller: orders, upload, arming in two steps, following a run.
//!
//! ```text
//! upload ──▶ commit (by hash) ──▶ arm: offer, then confirm ──▶ run ──▶ follow to the end
//! ```
//!
//! The host's heartbeat keeps a motion alive. It is sent every [`crate::node::inbox::HEARTBEAT`], and stops when
//! this program stops; then the controller ramps down.

use firmware::authority::sha256;
use firmware::fault::Cause;
use protocol::cyphal::bits::{Decode, Encode, to_bytes};
use protocol::cyphal::client::Policy;
use protocol::cyphal::crc::Crc64;
use protocol::cyphal::cubecell::TRAJECTORY_PATH;
use protocol::cyphal::cubecell::command::{
    self, ArmConfirm, ArmOffer, ArmPrepare, ClearFault, Home, Refusal, Run, Trajectory,
};
use protocol::cyphal::cubecell::group_state::{GroupState, State};
use protocol::cyphal::id::{NodeId, ServiceId};
use protocol::cyphal::uavcan::command::{CommandRequest, CommandResponse, SERVICE, Status};
use protocol::cyphal::uavcan::file::{self, WriteResponse};
use protocol::cyphal::upload::Upload;
use protocol::{Duration, Instant};

pub use super::error::OperatorError;
pub(crate) use super::error::{fault_text, refused, stopped};
use super::extending::Extending;
use super::following::Following;
use super::presence::PRESENCE;
use crate::bus::session::{Ended, Session};
use crate::trajectory::Segment;

/// Validity of an offer to arm, and of an arming, ms.
pub(crate) const ARMING_VALID_MS: u16 = 5_000;
/// Time in which a controller at rest has read every drive again, with a margin: it reads four values of each in turn,
/// 10 ms apart by default.
pub(crate) const FRESH: Duration = Duration::from_millis(500);
/// Time between two confirmations while it does.
pub(crate) const FRESH_LOOK: Duration = Duration::from_millis(50);
/// Longest time for a controller to look at its drives again: a start that takes longer has ended with a cause. A step of a
/// drive has five attempts of 0.11 s. Six steps take 3.3 s at most, 3.3 s more if they are repeated because a drive is halted,
/// and the proof of the watchdogs reads each drive up to six times, 3.3 s.
pub const FINDING_MAX: Duration = Duration::from_secs(10);
/// A halted arm is at rest after a few tenths of a second; if it still moves then, it is moved from outside.
const REST_MAX: Duration = Duration::from_secs(2);
/// Longest time for one request with all its attempts.
const REQUEST_MAX: Duration = Duration::from_secs(30);
/// Most bytes of a command's parameter.
const PARAMETER_MAX: usize = 64;

/// Name of a trajectory file: its size and CRC-64/WE.
///
/// # Errors
/// [`OperatorError::TooLong`].
pub fn name_of(file: &[u8]) -> Result<Trajectory, OperatorError> {
    let length_bytes = u32::try_from(file.len()).map_err(|_| OperatorError::TooLong(file.len()))?;
    Ok(Trajectory { trajectory_crc64: Crc64::of(file), length_bytes })
}

impl Session {
    /// Waits for a message of a controller; `node` selects one.
    ///
    /// # Errors
    /// [`OperatorError::NoController`].
    pub fn find_controller(&mut self, node: Option<NodeId>) -> Result<NodeId, OperatorError> {
        self.join()?;
        let until = self.now() + PRESENCE;
        let mut found = None;
        let ended = self.run(until, &mut |host_node| {
            found = host_node.inbox().and_then(|inbox| inbox.group).map(|(_, source, _)| source);
            found.is_some_and(|source| node.is_none_or(|node| node == source))
        })?;
        match (ended, found) {
            (Ended::Interrupted, _) => Err(OperatorError::Interrupted),
            (Ended::Done, Some(found)) => Ok(found),
            _ => Err(OperatorError::NoController),
        }
    }

    /// Waits until the controller has found its drives.
    pub fn find_drives(&mut self) -> Result<(), OperatorError> {
        self.wait_for(FINDING_MAX, &|state| state != State::Boot)
    }

    /// Last reported state of the controller.
    pub fn group(&mut self) -> Option<GroupState> {
        self.host_node().inbox().and_then(|inbox| inbox.group).map(|(_, _, state)| state)
    }

    /// Joint angles of the controller's next message, rad: measured from now on.
    ///
    /// # Errors
    /// [`OperatorError::NoAnswer`] if none comes within 1.5 s; or another [`OperatorError`].
    pub fn measured_pose(&mut self, node: NodeId) -> Result<Vec<f64>, OperatorError> {
        let now = self.now();
        let mut pose = None;
        let ended = self.run(now + PRESENCE, &mut |host_node| {
            let heard = host_node.inbox().and_then(|inbox| inbox.joints.as_ref());
            if let Some((at, source, state)) = heard
                && *at > now
                && *source == node
            {
                pose = Some(state.joints().iter().map(|joint| f64::from(joint.q_rad)).collect());
            }
            pose.is_some()
        })?;
        match (ended, pose) {
            (Ended::Interrupted, _) => Err(OperatorError::Interrupted),
            (_, Some(pose)) => Ok(pose),
            (_, None) => Err(OperatorError::NoAnswer { node }),
        }
    }

    pub fn request(
        &mut self,
        node: NodeId,
        service: ServiceId,
        policy: Policy,
        request: &dyn Encode,
    ) -> Result<Vec<u8>, OperatorError> {
        self.join()?;
        self.heed_stops()?;
        let (link, now) = self.host_node().link();
        let ticket = link.request(now, node, service, policy, request).map_err(OperatorError::Start)?;
        let until = now + REQUEST_MAX;
        let mut answer = None;
        let ended = self.run(until, &mut |host_node| {
            let Some(inbox) = host_node.inbox() else { return false };
            while let Some((answered, result)) = inbox.answers.pop_front() {
                if answered == ticket {
                    answer = Some(result);
                }
            }
            answer.is_some()
        })?;
        if ended == Ended::Interrupted {
            self.host_node().link().0.cancel(ticket);
            return Err(OperatorError::Interrupted);
        }
        match answer {
            Some(Ok(payload)) => Ok(payload),
            Some(Err(_)) | None => Err(OperatorError::NoAnswer { node }),
        }
    }

    /// Gives an order, with its code if the session has a key; returns its output.
    ///
    /// # Errors
    /// [`OperatorError::Refused`] with the cause; or another [`OperatorError`].
    pub fn order(
        &mut self,
        node: NodeId,
        what: &'static str,
        number: u16,
        parameter: &dyn Encode,
    ) -> Result<Vec<u8>, OperatorError> {
        let mut bytes = [0; PARAMETER_MAX];
        let len = to_bytes(parameter, &mut bytes).map_err(|_| OperatorError::Unreadable { node })?;
        let parameter = bytes.get(..len).unwrap_or_default();
        self.authorize_command(node, number, parameter)?;
        self.order_plain(node, what, number, parameter)
    }

    /// As [`Session::order`]; while the controller refuses with `cause`, the order is given again, for `patience` at most.
    fn order_until_accepted(
        &mut self,
        (node, what, number): (NodeId, &'static str, u16),
        parameter: &dyn Encode,
        (cause, patience): (Cause, Duration),
    ) -> Result<Vec<u8>, OperatorError> {
        let until = self.now() + patience;
        loop {
            match self.order(node, what, number, parameter) {
                Err(OperatorError::Refused { refusal: Some(refusal), .. })
                    if refusal.cause == cause.code() && self.now() < until =>
                {
                    self.pass(FRESH_LOOK)?;
                }
                answer => return answer,
            }
        }
    }

    /// As [`Session::order`], without a code.
    pub(super) fn order_plain(
        &mut self,
        node: NodeId,
        what: &'static str,
        number: u16,
        parameter: &[u8],
    ) -> Result<Vec<u8>, OperatorError> {
        let request = CommandRequest { command: number, parameter };
        let payload = self.request(node, SERVICE, Policy::default(), &request)?;
        let response =
            CommandResponse::from_bytes(&payload).map_err(|_| OperatorError::Unreadable { node })?;
        if response.status == Status::SUCCESS {
            return Ok(response.output.to_vec());
        }
        let refusal =
            if response.output.is_empty() { None } else { Refusal::from_bytes(response.output).ok() };
        Err(OperatorError::Refused { what, status: response.status, refusal })
    }

    /// Lets the joints of `mask` (bit 0 = first joint) find their zeros, and waits for the end.
    pub fn home_group(&mut self, node: NodeId, joint_mask: u8, limit: Duration) -> Result<(), OperatorError> {
        self.guard_motion();
        self.order(node, "homing", command::HOME, &Home { joint_mask })?;
        // The order is answered before the state that it leads to is reported.
        self.wait_for(limit, &|state| state == State::Homing)?;
        self.wait_for(limit, &|state| matches!(state, State::Ready | State::Idle))?;
        self.release_motion();
        Ok(())
    }

    /// Stores a trajectory file in the controller and commits it: checked there, and named by its hash.
    pub fn upload(
        &mut self,
        node: NodeId,
        bytes: &[u8],
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<Trajectory, OperatorError> {
        let name = name_of(bytes)?;
        self.uploaded = Some((name, sha256(bytes)));
        let mut upload = Upload::new(TRAJECTORY_PATH, bytes);
        while let Some(piece) = upload.request() {
            let payload = self.request(node, file::WRITE, Policy::FILE, &piece)?;
            let response =
                WriteResponse::from_bytes(&payload).map_err(|_| OperatorError::Unreadable { node })?;
            upload.answered(response.result).map_err(OperatorError::Upload)?;
            let (done, all) = upload.progress();
            progress(done, all);
        }
        self.order(node, "the trajectory", command::COMMIT_TRAJECTORY, &name)?;
        Ok(name)
    }

    /// Arms for `name`: requests an offer and confirms it. The arming expires by itself. With a key the session
    /// confirms only content that it has uploaded itself, with the settings that it has read.
    ///
    /// # Errors
    /// [`OperatorError::OtherContent`] if the controller would arm something else; or another [`OperatorError`].
    pub fn arm(&mut self, node: NodeId, name: &Trajectory) -> Result<(), OperatorError> {
        let prepare = ArmPrepare { trajectory_crc64: name.trajectory_crc64, valid_ms: ARMING_VALID_MS };
        let output = self.order(node, "to arm", command::ARM_PREPARE, &prepare)?;
        let offer = ArmOffer::from_bytes(&output).map_err(|_| OperatorError::Unreadable { node })?;
        self.armed = match self.key {
            Some(_) => Some(self.signed_run(node, name, &offer.digest)?),
            None => None,
        };
        let confirm = ArmConfirm { token: offer.token, valid_ms: ARMING_VALID_MS };
        // After homing or a reset the controller reads the drives again before it trusts them.
        self.order_until_accepted(
            (node, "the arming", command::ARM_CONFIRM),
            &confirm,
            (Cause::DriveNotReady, FRESH),
        )?;
        self.wait_for(Duration::from_secs(2), &|state| state == State::Armed)
    }

    /// Makes the controller forget its latched fault, which is `cause`, and read every drive again. This resets
    /// errors and halts of the drives; nothing moves. A controller that still measures a motion refuses; the order
    /// is repeated for two seconds at most.
    ///
    /// # Errors
    /// [`OperatorError::Stopped`] if a cause is still there; or another [`OperatorError`].
    pub fn clear_fault(&mut self, node: NodeId, cause: u16) -> Result<(), OperatorError> {
        self.order_until_accepted(
            (node, "to forget the fault", command::CLEAR_FAULT),
            &ClearFault { fault_cause: cause },
            (Cause::StillMoving, REST_MAX),
        )?;
        let cleared_at = self.now();
        // Its next message may still contain the earlier state.
        let ended = self.run(cleared_at + FINDING_MAX, &mut |host_node| {
            let group =
                host_node.inbox().and_then(|inbox| inbox.group).filter(|(at, ..)| *at > cleared_at + FRESH);
            group.is_some_and(|(_, _, group)| group.state != State::Boot)
        })?;
        let group = self.group().unwrap_or_default();
        match (ended, group.state) {
            (Ended::Interrupted, _) => Err(OperatorError::Interrupted),
            (_, State::Fault) => Err(stopped(&group)),
            (Ended::TimedOut, state) => Err(OperatorError::NoProgress { state, limit: FINDING_MAX }),
            (Ended::Done, _) => Ok(()),
        }
    }

    /// Back to Ready.
    pub fn disarm(&mut self, node: NodeId) -> Result<(), OperatorError> {
        self.order(node, "to disarm", command::DISARM, &()).map(drop)
    }

    /// Runs the armed trajectory and follows it to its end; `progress` gets each message of the controller's state
    /// with the time of its arrival. Ctrl-C orders a stop along the path, and a halt if the controller does not
    /// obey. The plan begins at once, or at `start` of the controller's clock
    /// ([`ControllerClock`](super::clock::ControllerClock)), at least two control periods and at most 30 s ahead. It goes on with
    /// `segments` while it runs.
    ///
    /// # Errors
    /// [`OperatorError::NotStarted`] if the arming ended before; or another [`OperatorError`]. The arm stands then.
    pub fn run_trajectory_at(
        &mut self,
        node: NodeId,
        name: &Trajectory,
        start: Option<Instant>,
        limit: Duration,
        segments: &[Segment],
        progress: &mut dyn FnMut(Instant, &GroupState),
    ) -> Result<GroupState, OperatorError> {
        self.guard_motion();
        let Trajectory { trajectory_crc64, length_bytes } = *name;
        let start_us = start.map_or(0, Instant::as_micros);
        self.order(node, "to run", command::RUN, &Run { trajectory_crc64, length_bytes, start_us })?;
        let ordered_at = self.now();
        let until = ordered_at + limit;
        let (mut following, mut lost) = (Following::new(ordered_at), false);
        let mut extending = Extending::new(node, segments);
        let ended = self.run(until, &mut |host_node| {
            extending.go_on(host_node);
            lost = host_node.silence(ordered_at) > PRESENCE;
            let Some((at, _, state)) = host_node.inbox().and_then(|inbox| inbox.group) else { return false };
            // An order with a start time leaves Armed for Running, or for Ready if the arming ends.
            let not_started =
                start.is_some() && !following.has_run() && at > ordered_at && state.state == State::Ready;
            following.has_ended(at, &state, progress) || not_started || lost
        })?;
        if ended == Ended::Interrupted {
            self.stop_after_interrupt(node)?;
            return Err(OperatorError::Interrupted);
        }
        if lost {
            return Err(OperatorError::Lost);
        }
        let state = self.group().unwrap_or_default();
        match (ended, state.state) {
            (Ended::Done, State::Ready) => {
                self.release_motion();
                if !following.has_run() && start.is_some() {
                    return Err(OperatorError::NotStarted { state: state.state });
                }
                Ok(state)
            }
            (Ended::Done, State::Stopped | State::Fault) => {
                self.release_motion();
                Err(stopped(&state))
            }
            // In any other state the guard halts the joints.
            _ => Err(OperatorError::NoProgress { state: state.state, limit }),
        }
    }

    /// Ctrl-C: the stop order goes out although the session is interrupted; then a halt, if it still moves.
    fn stop_after_interrupt(&mut self, node: NodeId) -> Result<(), OperatorError> {
        let request = CommandRequest { command: command::STOP, parameter: &[] };
        let (link, now) = self.host_node().link();
        let _ = link.request(now, node, SERVICE, Policy::default(), &request);
        for _ in 0..100 {
            self.pass(Duration::from_millis(20))?;
            if self.group().is_some_and(|group| !matches!(group.state, State::Running | State::Stopping)) {
                self.release_motion();
                return Ok(());
            }
        }
        Ok(self.halt(protocol::cyphal::cubecell::stop::Reason::OPERATOR)?)
    }

    /// Waits until the controller reports a state that `wanted` accepts. A fault or a stop on the way is an error.
    ///
    /// # Errors
    /// [`OperatorError::Stopped`], [`OperatorError::NoProgress`], [`OperatorError::Lost`] and the others.
    pub fn wait_for(&mut self, limit: Duration, wanted: &dyn Fn(State) -> bool) -> Result<(), OperatorError> {
        let (begun, mut lost) = (self.now(), false);
        let ended = self.run(begun + limit, &mut |host_node| {
            lost = host_node.silence(begun) > PRESENCE;
            let state = host_node.inbox().and_then(|inbox| inbox.group).map(|(_, _, group)| group.state);
            lost || state.is_some_and(|state| wanted(state) || matches!(state, State::Fault | State::Stopped))
        })?;
        let group = self.group().unwrap_or_default();
        match ended {
            Ended::Interrupted => Err(OperatorError::Interrupted),
            Ended::Done if lost => Err(OperatorError::Lost),
            Ended::Done if wanted(group.state) => Ok(()),
            Ended::Done => Err(stopped(&group)),
            Ended::TimedOut => Err(OperatorError::NoProgress { state: group.state, limit }),
        }
    }
}

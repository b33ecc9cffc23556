//! The operator's side of a controller: orders, upload, arming in two steps, following a run.
//!
//! ```text
//! upload ──▶ commit (by hash) ──▶ arm: offer, then confirm ──▶ run ──▶ follow to the end
//! ```
//!
//! The host's heartbeat keeps a motion alive: it is sent every [`crate::node::inbox::HEARTBEAT`], and stops when this program does, upon
//! which the controller ramps down.

use firmware::authority::sha256;
use firmware::fault::Cause;
use protocol::cyphal::bits::{Decode, Encode, to_bytes};
use protocol::cyphal::client::{Policy, StartError};
use protocol::cyphal::crc::Crc64;
use protocol::cyphal::cubecell::TRAJECTORY_PATH;
use protocol::cyphal::cubecell::command::{
    self, ArmConfirm, ArmOffer, ArmPrepare, ClearFault, Home, Refusal, Run, Trajectory,
};
use protocol::cyphal::cubecell::group_state::{GroupState, State};
use protocol::cyphal::id::{NodeId, ServiceId};
use protocol::cyphal::uavcan::command::{CommandRequest, CommandResponse, SERVICE, Status};
use protocol::cyphal::uavcan::file::{self, WriteResponse};
use protocol::cyphal::upload::{Upload, UploadError};
use protocol::{Duration, Instant};

use super::following::Following;
use crate::bus::BusFailure;
use crate::bus::period::PERIOD_MAX_US;
use crate::bus::session::{Ended, Session};
use crate::node::stop_watch::{StopSeen, is_stop_by_other};

/// Validity of an offer to arm, and of an arming, ms.
pub(crate) const ARMING_VALID_MS: u16 = 5_000;
/// Time in which a controller at rest has read every drive again, with room: it looks at four things of each in turn,
/// 10 ms apart by default.
pub(crate) const FRESH: Duration = Duration::from_millis(500);
/// Time between two confirmations while it does.
pub(crate) const FRESH_LOOK: Duration = Duration::from_millis(50);
/// Longest time for a controller to look at its drives again: a start that takes longer has ended with a cause. A step of a
/// drive has five attempts of 0.11 s. Six steps take 3.3 s at most, 3.3 s more if they are repeated because a drive is halted,
/// and the proof of the watchdogs reads each drive up to six times, 3.3 s.
pub const FINDING_MAX: Duration = Duration::from_secs(10);
/// A halted arm is at rest after a few tenths of a second; one that still moves then is moved from outside.
const REST_MAX: Duration = Duration::from_secs(2);
/// A controller that is there has sent its state by then.
pub(crate) const PRESENCE: Duration = Duration::from_millis(1_500);
/// Longest time for one request with all its attempts.
const REQUEST_MAX: Duration = Duration::from_secs(30);
/// Most bytes of a command's parameter.
const PARAMETER_MAX: usize = 64;

/// Why an order was not carried out.
#[derive(Debug, thiserror::Error)]
pub enum OperatorError {
    /// The bus failed, or somebody else stopped the arm.
    #[error(transparent)]
    Bus(BusFailure),
    /// Ctrl-C.
    #[error("interrupted")]
    Interrupted,
    /// No controller.
    #[error(
        "no controller is heard on this bus\n  next: start it, or check its power and its `group_state` subject; `cubectl throw`, `home` and `jog` \
         without --controller use one in this program"
    )]
    NoController,
    /// The request table is full or the message too long; does not happen to a single operator.
    #[error("cannot ask the controller: {0}")]
    Start(StartError),
    /// It does not answer.
    #[error("controller {} does not answer\n  next: `cubectl doctor`; look at the bus load", .node.get())]
    NoAnswer { node: NodeId },
    /// The answer cannot be read.
    #[error("the answer of controller {} cannot be read\n  next: use a cubectl and a controller of the same version", .node.get())]
    Unreadable { node: NodeId },
    /// It says no.
    #[error("the controller refuses {what}: {}", refusal_text(.status, .refusal))]
    Refused {
        /// The order.
        what: &'static str,
        status: Status,
        /// Cause, joint and place, if it says so.
        refusal: Option<Refusal>,
    },
    /// A piece of the file was refused.
    #[error("upload: at byte {} the controller refuses the file (code {})\n  next: disarm, look for another host that uploads, then upload again", .0.offset, .0.error.0)]
    Upload(UploadError),
    /// The file is longer than a file can be.
    #[error("a file of {0} bytes is too long for a controller")]
    TooLong(usize),
    /// It has no such register.
    #[error(
        "the controller has no register {name}\n  next: `cubectl registers list`; use a cubectl and a controller of the same \
         version"
    )]
    NoRegister {
        /// Name asked for.
        name: String,
    },
    /// It keeps another value.
    #[error(
        "the controller does not take {name} = {wanted}, it keeps {found}\n  next: the value must be in the register's \
         range, go with the other settings, and nothing may move or be armed"
    )]
    RegisterRefused {
        name: String,
        /// Written.
        wanted: String,
        /// Read back.
        found: String,
    },
    /// With a key: another file than this session uploaded, or other settings than it has read.
    #[error(
        "the controller would arm another file than was uploaded here, or with other settings than it reports; nothing moves\n  \
         next: look for another node that writes on this bus (`cubectl doctor`), then upload again"
    )]
    OtherContent,
    /// A robot that is led was stopped, or its program has ended.
    #[error("{}", robot_text(.cause, .joint, .by_itself, .start_moves))]
    RobotStopped {
        /// Number of the cause.
        cause: u16,
        /// Axis, from 1; 0 = all.
        joint: u8,
        /// Why the robot stopped by itself, where that is known.
        by_itself: Option<String>,
        /// The start pose of its telegrams moves as the axes do.
        start_moves: bool,
        /// It was ready to be led before.
        was_ready: bool,
    },
    /// A robot that is heard and cannot be led.
    #[error(
        "the robot is not ready to be led after 10 s; {heard}\n  next: `cubectl doctor` looks at its telegrams; end the robot's program \
         and start it again at its start pose"
    )]
    RobotNotReady { heard: String },
    /// The socket of a robot.
    #[error("{0}\n  next: check the network interface, then run it again")]
    Socket(std::io::Error),
    /// It stopped, or reports a fault.
    #[error("the controller {}: {}", if *.state == State::Fault { "reports a fault" } else { "has stopped" }, fault_text(.cause, .joint))]
    Stopped {
        /// Stopped or Fault.
        state: State,
        /// Number of the cause.
        cause: u16,
        /// Joint, from 1; 0 = the group.
        joint: u8,
    },
    /// The controller fell silent.
    #[error(
        "the controller has not been heard for {} s; it may be without power, or the bus may be broken\n  next: `cubectl doctor`, \
         then start the controller again", PRESENCE.as_secs_f64()
    )]
    Lost,
    /// A run with a start time did not begin.
    #[error(
        "the run did not begin at its time: the controller is {state} and not armed any more\n  next: `cubectl explain` tells \
         the refusal in its trace (`cubectl doctor`); arm again"
    )]
    NotStarted {
        /// Where it is.
        state: State,
    },
    /// An end state that was not sent.
    #[error("the end state was not sent: {what}\n  next: send one that fits")]
    TargetNotSaid { what: &'static str },
    /// The clock of the controller does not go on from where it was.
    #[error(
        "the clock of controller {} has jumped by about {jump_ms:.1} ms; it may have been started again\n  next: look whether \
         the arm stands, then read the clock again", .node.get()
    )]
    ClockJumped {
        node: NodeId,
        /// By how much, ms.
        jump_ms: f64,
    },
    /// A state did not come.
    #[error("the controller is still {state:?} after {limit}\n  next: `cubectl monitor`")]
    NoProgress {
        /// Where it is.
        state: State,
        /// The bound.
        limit: Duration,
    },
}

impl From<BusFailure> for OperatorError {
    fn from(failure: BusFailure) -> Self {
        match failure {
            BusFailure::StoppedByOther(StopSeen { group: Some(group), by_other: false, .. }) => {
                stopped(&group)
            }
            other => Self::Bus(other),
        }
    }
}

impl OperatorError {
    /// Somebody stopped the arm, and no fault did.
    #[must_use]
    pub fn is_stop_by_other(&self) -> bool {
        match self {
            Self::Bus(failure) => matches!(failure, BusFailure::StoppedByOther(_)),
            Self::Stopped { cause, .. } => is_stop_by_other(*cause),
            // The stop button of a robot and the end of its program look like that.
            Self::RobotStopped { cause, was_ready: true, .. } => {
                [Cause::DriveSilent, Cause::RobotRestarted].iter().any(|known| known.code() == *cause)
            }
            _ => false,
        }
    }
}

fn refusal_text(status: &Status, refusal: &Option<Refusal>) -> String {
    match refusal {
        Some(refusal) => {
            let index = refusal.index;
            let detail = match Cause::from_code(refusal.cause) {
                _ if index == 0 => String::new(),
                Some(Cause::CycleTooShort) if u32::from(index) > PERIOD_MAX_US => format!(
                    "; it needs {:.1} ms, and the longest control period is {} ms: take drives off the bus, or raise its bit \
                     rate",
                    f64::from(index) / 1e3,
                    PERIOD_MAX_US / 1_000
                ),
                Some(Cause::CycleTooShort) => {
                    format!(
                        "; {:.1} ms would do: `cubectl tune --period {}`",
                        f64::from(index) / 1e3,
                        f64::from(index) / 1e3
                    )
                }
                _ => format!(" (place {index})"),
            };
            fault_text(&refusal.cause, &refusal.joint) + &detail
        }
        None => format!("status {}", status.0),
    }
}

fn fault_text(cause: &u16, joint: &u8) -> String {
    let place = if *joint == 0 { String::new() } else { format!("joint {joint}: ") };
    match Cause::from_code(*cause).and_then(Cause::info) {
        Some(info) => format!("{place}{} (fault {cause})\n  next: {}", info.what, info.recovery),
        None => format!("{place}cause {cause}"),
    }
}

/// The words of drives on a bus do not fit a robot that is led.
fn robot_text(cause: &u16, joint: &u8, by_itself: &Option<String>, start_moves: &bool) -> String {
    let cause = Cause::from_code(*cause);
    let what = match cause {
        Some(Cause::DriveSilent) => "no telegram came from the robot in time",
        other => other.and_then(Cause::info).map_or("the robot was stopped", |info| info.what),
    };
    let code = cause.map_or(0, Cause::code);
    let axis = if *joint == 0 { String::new() } else { format!(" (A{joint})") };
    let by_itself =
        by_itself.as_ref().map_or(String::new(), |why| format!("; the robot stopped by itself: {why}"));
    let next = match cause {
        Some(Cause::RobotRestarted) if *start_moves => {
            "the start pose (ASPos) moves with the axes: send DEF_ASPos, the programmed axes without corrections, or leave it out"
                .to_owned()
        }
        None | Some(Cause::DriveSilent) => {
            "look at the pendant why the robot's program ended, and at the network".to_owned()
        }
        Some(cause) => format!("`cubectl explain {}` says what to do", cause.code()),
    };
    format!("{what}{axis}, fault {code}{by_itself}\n  next: {next}")
}

/// What a controller in this program refuses.
pub(crate) fn refused(what: &'static str, refusal: firmware::fault::Refusal) -> OperatorError {
    let joint = refusal.joint.map_or(0, |joint| joint.get() as u8 + 1);
    let refusal = Refusal { cause: refusal.cause.code(), joint, index: refusal.index };
    OperatorError::Refused { what, status: Status::FAILURE, refusal: Some(refusal) }
}

/// Name of a trajectory file: its size and CRC-64/WE.
///
/// # Errors
/// [`OperatorError::TooLong`].
pub fn name_of(file: &[u8]) -> Result<Trajectory, OperatorError> {
    let length_bytes = u32::try_from(file.len()).map_err(|_| OperatorError::TooLong(file.len()))?;
    Ok(Trajectory { trajectory_crc64: Crc64::of(file), length_bytes })
}

impl Session {
    /// Waits for a controller to be heard; `node` narrows it to one.
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
    ///
    /// # Errors
    /// As [`Session::wait_for`].
    pub fn find_drives(&mut self) -> Result<(), OperatorError> {
        self.wait_for(FINDING_MAX, &|state| state != State::Boot)
    }

    /// State of the controller heard last.
    pub fn group(&mut self) -> Option<GroupState> {
        self.host_node().inbox().and_then(|inbox| inbox.group).map(|(_, _, state)| state)
    }

    /// Joint angles of the controller's next message, rad: what it measures from now on.
    ///
    /// # Errors
    /// [`OperatorError::NoAnswer`] if none comes within 1.5 s, and the others.
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

    /// One request, with all its attempts.
    ///
    /// # Errors
    /// [`OperatorError`].
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
    /// [`OperatorError::Refused`] with the cause, and the others.
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
    ///
    /// # Errors
    /// [`OperatorError`].
    pub fn home_group(&mut self, node: NodeId, joint_mask: u8, limit: Duration) -> Result<(), OperatorError> {
        self.guard_motion();
        self.order(node, "homing", command::HOME, &Home { joint_mask })?;
        // The order is answered before the state that it leads to is told.
        self.wait_for(limit, &|state| state == State::Homing)?;
        self.wait_for(limit, &|state| matches!(state, State::Ready | State::Idle))?;
        self.release_motion();
        Ok(())
    }

    /// Stores a trajectory file in the controller and commits it: checked there, and named by its hash.
    ///
    /// # Errors
    /// [`OperatorError`].
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

    /// Arms for `name`: asks for an offer and takes it. The arming expires by itself. With a key the session confirms only what
    /// it has uploaded itself, with the settings that it has read.
    ///
    /// # Errors
    /// [`OperatorError::OtherContent`] if the controller would arm something else, and the others.
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

    /// Lets the controller forget its latched fault, which is `cause`, and look at every drive again. Errors and halts of
    /// the drives are reset by it; nothing moves. A controller that still measures a motion refuses, and is asked again for
    /// two seconds at most.
    ///
    /// # Errors
    /// [`OperatorError::Stopped`] if a cause is still there, and the others.
    pub fn clear_fault(&mut self, node: NodeId, cause: u16) -> Result<(), OperatorError> {
        self.order_until_accepted(
            (node, "to forget the fault", command::CLEAR_FAULT),
            &ClearFault { fault_cause: cause },
            (Cause::StillMoving, REST_MAX),
        )?;
        let cleared_at = self.now();
        // Its next message may still tell the earlier state.
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
    ///
    /// # Errors
    /// [`OperatorError`].
    pub fn disarm(&mut self, node: NodeId) -> Result<(), OperatorError> {
        self.order(node, "to disarm", command::DISARM, &()).map(drop)
    }

    /// Runs the armed trajectory and follows it to its end; `progress` gets each message of the controller's state with
    /// the time of its arrival. Ctrl-C orders a stop along the path, and a halt if the
    /// controller does not obey.
    ///
    /// # Errors
    /// [`OperatorError`]; what moved stands.
    pub fn run_trajectory(
        &mut self,
        node: NodeId,
        name: &Trajectory,
        limit: Duration,
        progress: &mut dyn FnMut(Instant, &GroupState),
    ) -> Result<GroupState, OperatorError> {
        self.run_trajectory_at(node, name, None, limit, progress)
    }

    /// As [`Session::run_trajectory`]; the plan begins at `start` of the controller's clock
    /// ([`ControllerClock`](super::clock::ControllerClock)), at least two control periods and at most 30 s ahead.
    ///
    /// # Errors
    /// [`OperatorError::NotStarted`] if the arming ended before, and as [`Session::run_trajectory`].
    pub fn run_trajectory_at(
        &mut self,
        node: NodeId,
        name: &Trajectory,
        start: Option<Instant>,
        limit: Duration,
        progress: &mut dyn FnMut(Instant, &GroupState),
    ) -> Result<GroupState, OperatorError> {
        self.guard_motion();
        let Trajectory { trajectory_crc64, length_bytes } = *name;
        let start_us = start.map_or(0, Instant::as_micros);
        self.order(node, "to run", command::RUN, &Run { trajectory_crc64, length_bytes, start_us })?;
        let ordered_at = self.now();
        let until = ordered_at + limit;
        let (mut following, mut lost) = (Following::new(ordered_at), false);
        let ended = self.run(until, &mut |host_node| {
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

    /// Waits until the controller tells a state that `wanted` takes. A fault or a stop on the way is an error.
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

pub(crate) fn stopped(group: &GroupState) -> OperatorError {
    OperatorError::Stopped { state: group.state, cause: group.fault_cause, joint: group.fault_joint }
}

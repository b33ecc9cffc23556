//! Why an order to a controller was not carried out, in words with a next step.

use firmware::fault::Cause;
use protocol::Duration;
use protocol::cyphal::client::StartError;
use protocol::cyphal::cubecell::command::Refusal;
use protocol::cyphal::cubecell::group_state::{DriveDifference, GroupState, State};
use protocol::cyphal::id::NodeId;
use protocol::cyphal::uavcan::command::Status;
use protocol::cyphal::upload::UploadError;

use super::presence::PRESENCE;
use crate::bus::BusFailure;
use crate::bus::period::PERIOD_MAX_US;
use crate::drives::difference_text;
use crate::node::stop_watch::{StopSeen, is_stop_by_other};

/// Why an order was not carried out.
#[derive(Debug, thiserror::Error)]
pub enum OperatorError {
    /// The bus failed, or another node or a person stopped the arm.
    #[error(transparent)]
    Bus(BusFailure),
    /// Ctrl-C.
    #[error("interrupted")]
    Interrupted,
    #[error("no controller is heard on this bus")]
    NoController,
    /// The request table is full or the message too long; does not happen to a single operator.
    #[error("cannot ask the controller: {0}")]
    Start(StartError),
    #[error("controller {} does not answer", .node.get())]
    NoAnswer { node: NodeId },
    /// The answer cannot be read.
    #[error("the answer of controller {} cannot be read", .node.get())]
    Unreadable { node: NodeId },
    #[error("the controller refuses {what}: {}", refusal_text(.status, .refusal))]
    Refused {
        /// The order.
        what: &'static str,
        status: Status,
        /// Cause, joint and place, if the controller gives them.
        refusal: Option<Refusal>,
    },
    /// A piece of the file was refused.
    #[error("upload: at byte {} the controller refuses the file (code {})", .0.offset, .0.error.0)]
    Upload(UploadError),
    /// The file is longer than a file can be.
    #[error("a file of {0} bytes is too long for a controller")]
    TooLong(usize),
    /// The controller has no such register.
    #[error("the controller has no register {name}")]
    NoRegister {
        /// Requested name.
        name: String,
    },
    /// The controller keeps the value because it is in use.
    #[error("the controller is {state}: another program works with the arm, so {name} cannot be changed")]
    InUse {
        /// What it does.
        state: State,
        name: String,
    },
    /// It keeps another value.
    #[error("the controller does not take {name} = {wanted}, it keeps {found}")]
    RegisterRefused {
        name: String,
        /// Written.
        wanted: String,
        /// Read back.
        found: String,
    },
    /// With a key: another file than this session uploaded, or other settings than it has read.
    #[error(
        "the controller would arm another file than was uploaded here, or with other settings than it reports; nothing moves"
    )]
    OtherContent,
    /// A robot that is led was stopped, or its program has ended.
    #[error("{}", robot_text(.cause, .joint, .by_itself))]
    RobotStopped {
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
    /// A robot that sends telegrams but is not ready.
    #[error("the robot is not ready to be led after 10 s; {heard}")]
    RobotNotReady { heard: String },
    #[error("{0}")]
    Socket(std::io::Error),
    /// It stopped, or reports a fault.
    #[error("the controller {}: {}", if *.state == State::Fault { "reports a fault" } else { "has stopped" }, fault_text(*.cause, *.joint, *.differs))]
    Stopped {
        /// Stopped or Fault.
        state: State,
        cause: u16,
        /// Joint, from 1; 0 = the group.
        joint: u8,
        /// What in its drive is not as the robot file says.
        differs: DriveDifference,
    },
    /// The robot's program does not let the motion pass.
    #[error("{what}")]
    NotPassed { what: String, next: Option<String> },
    /// The controller fell silent.
    #[error("the controller has not been heard for {} s; it may be without power, or the bus may be broken", PRESENCE.as_secs_f64())]
    Lost,
    /// A run with a start time did not begin.
    #[error("the run did not begin at its time: the controller is {state} and not armed any more")]
    NotStarted {
        /// Where it is.
        state: State,
    },
    /// An end state that was not sent.
    #[error("the end state was not sent: {what}")]
    TargetNotSaid { what: &'static str },
    /// The clock of the controller contradicts its earlier readings.
    #[error("the clock of controller {} has jumped by about {jump_ms:.1} ms; it may have been started again", .node.get())]
    ClockJumped {
        node: NodeId,
        /// By how much, ms.
        jump_ms: f64,
    },
    /// A state did not come.
    #[error("the controller is still {state:?} after {limit}")]
    NoProgress {
        /// Where it is.
        state: State,
        /// The bound.
        limit: Duration,
    },
}

impl OperatorError {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        Some(match self {
            Self::NoController => "start it, or check its power and its `group_state` subject; `cubectl throw`, `home` and `jog` \
         without --controller use one in this program".to_owned(),
            Self::NoAnswer { .. } => "`cubectl doctor`; look at the bus load".to_owned(),
            Self::Unreadable { .. } => "use a cubectl and a controller of the same version".to_owned(),
            Self::Upload(..) => "disarm, look for another host that uploads, then upload again".to_owned(),
            Self::NoRegister { .. } => "`cubectl controller registers list`; use a cubectl and a controller of the same \
         version".to_owned(),
            Self::InUse { .. } => "wait until it has \
         ended (`cubectl arm monitor` shows it), or end it with `cubectl stop`".to_owned(),
            Self::RegisterRefused { .. } => "the value must be in the register's \
         range, go with the other settings, and nothing may move or be armed".to_owned(),
            Self::OtherContent => "look for another node that writes on this bus (`cubectl doctor`), then upload again".to_owned(),
            Self::RobotNotReady { .. } => "`cubectl doctor` looks at its telegrams; end the robot's program \
         and start it again at its start pose".to_owned(),
            Self::Socket(..) => "check the network interface, then run it again".to_owned(),
            Self::NotPassed { next, .. } => return next.clone(),
            Self::Lost => "`cubectl doctor`, then start the controller again".to_owned(),
            Self::NotStarted { .. } => "`cubectl explain` explains \
         the refusal in its trace (`cubectl doctor`); arm again".to_owned(),
            Self::TargetNotSaid { .. } => "send one that fits".to_owned(),
            Self::ClockJumped { .. } => "look whether the arm stands, then read the clock again".to_owned(),
            Self::NoProgress { .. } => "`cubectl arm monitor`".to_owned(),
            Self::Bus(error) => return error.next(),
            Self::Refused { refusal: Some(refusal), .. } => return next_of_refusal(refusal),
            Self::Stopped { cause, .. } => return recovery(*cause),
            Self::RobotStopped { cause, start_moves, .. } => next_of_robot(*cause, *start_moves),
            _ => return None,
        })
    }
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
    /// Another node or a person stopped the arm; it was not a fault.
    #[must_use]
    pub fn is_stop_by_other(&self) -> bool {
        match self {
            Self::Bus(failure) => matches!(failure, BusFailure::StoppedByOther(_)),
            Self::Stopped { cause, .. } => is_stop_by_other(*cause),
            // The stop button of a robot and the end of its program look the same.
            Self::RobotStopped { cause, was_ready: true, .. } => {
                [Cause::DriveSilent, Cause::RobotRestarted].iter().any(|known| known.code() == *cause)
            }
            _ => false,
        }
    }
}

fn refusal_text(status: &Status, refusal: &Option<Refusal>) -> String {
    let Some(refusal) = refusal else { return format!("status {}", status.0) };
    let text = fault_text(refusal.cause, refusal.joint, DriveDifference::default());
    // With a next step it stands behind that.
    if recovery(refusal.cause).is_some() { text } else { text + &detail(refusal) }
}

fn next_of_refusal(refusal: &Refusal) -> Option<String> {
    recovery(refusal.cause).map(|step| step + &detail(refusal))
}

/// Text for the place of a refusal.
fn detail(refusal: &Refusal) -> String {
    let index = refusal.index;
    let period_ms = f64::from(index) / 1e3;
    match Cause::from_code(refusal.cause) {
        _ if index == 0 => String::new(),
        Some(Cause::CycleTooShort) if u32::from(index) > PERIOD_MAX_US => format!(
            "; it needs {period_ms:.1} ms, and the longest control period is {} ms: take drives off the bus, or raise its bit rate",
            PERIOD_MAX_US / 1_000
        ),
        Some(Cause::CycleTooShort) => {
            format!("; {period_ms:.1} ms would do: `cubectl tune --period-ms {period_ms}`")
        }
        _ => format!(" (place {index})"),
    }
}

/// What the fault table advises, with the verb that does it.
fn recovery(cause: u16) -> Option<String> {
    let cause = Cause::from_code(cause)?;
    let verb = match cause {
        Cause::NotAtStart => {
            ": `cubectl throw --plan` goes there by itself, `cubectl move --joints` on order"
        }
        Cause::NotHomed => ": `cubectl home`",
        _ => "",
    };
    cause.info().map(|info| format!("{}{verb}", info.recovery))
}

/// A fault in words. If the controller reports what in a drive differs from the robot file, the text names that.
pub(crate) fn fault_text(cause: u16, joint: u8, differs: DriveDifference) -> String {
    let place = if joint == 0 { String::new() } else { format!("joint {joint}: ") };
    let info = || Cause::from_code(cause).and_then(Cause::info).map(|info| info.what.to_owned());
    match difference_text(differs).or_else(info) {
        Some(what) => format!("{place}{what} (fault {cause})"),
        None => format!("{place}cause {cause}"),
    }
}

/// The words of drives on a bus do not fit a robot that is led.
fn robot_text(cause: &u16, joint: &u8, by_itself: &Option<String>) -> String {
    let cause = Cause::from_code(*cause);
    let what = match cause {
        Some(Cause::DriveSilent) => "no telegram came from the robot in time",
        other => other.and_then(Cause::info).map_or("the robot was stopped", |info| info.what),
    };
    let code = cause.map_or(0, Cause::code);
    let axis = if *joint == 0 { String::new() } else { format!(" (A{joint})") };
    let by_itself =
        by_itself.as_ref().map_or(String::new(), |why| format!("; the robot stopped by itself: {why}"));
    format!("{what}{axis}, fault {code}{by_itself}")
}

/// Next step after a robot that is led was stopped.
fn next_of_robot(cause: u16, start_moves: bool) -> String {
    match Cause::from_code(cause) {
        Some(Cause::RobotRestarted) if start_moves => {
            "the start pose (ASPos) moves with the axes: send DEF_ASPos, the programmed axes without corrections, or leave it out"
                .to_owned()
        }
        None | Some(Cause::DriveSilent) => {
            "look at the pendant why the robot's program ended, and at the network".to_owned()
        }
        Some(cause) => format!("`cubectl explain {}` says what to do", cause.code()),
    }
}

/// What a controller in this program refuses.
pub(crate) fn refused(what: &'static str, refusal: firmware::fault::Refusal) -> OperatorError {
    let joint = refusal.joint.map_or(0, |joint| joint.get() as u8 + 1);
    let refusal = Refusal { cause: refusal.cause.code(), joint, index: refusal.index };
    OperatorError::Refused { what, status: Status::FAILURE, refusal: Some(refusal) }
}

pub(crate) fn stopped(group: &GroupState) -> OperatorError {
    OperatorError::Stopped {
        state: group.state,
        cause: group.fault_cause,
        joint: group.fault_joint,
        differs: group.differs,
    }
}

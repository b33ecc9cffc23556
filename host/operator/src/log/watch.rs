//! Follows a bus and gives its events as text; at a fault also everything known at that moment.
//!
//! Used while recording and afterwards, so that a viewer's log and a report show the same events.

use std::collections::{BTreeMap, VecDeque};

use protocol::cyphal::cubecell::group_state::{DriveDifference, GroupState, State};
use protocol::cyphal::uavcan::command::Status;
use protocol::cyphal::uavcan::diagnostic::Severity as RecordSeverity;
use protocol::powercube::{
    Broadcast, CubeState, MotionCommand, Parameter, Reply, Request, ShortState, SimpleCommand, Value,
};
use protocol::{Duration, Frame, Instant};
use serde::Serialize;

use super::facts::{Decoder, Fact, order_name, position};
use super::numbering::Numbering;
use crate::dialogue::operator::fault_text;
use crate::node::stop_watch::is_stop_by_other;
use crate::tap::Way;

/// How much an event matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Severity {
    /// As it should be.
    Info,
    /// Needs attention.
    Warning,
    /// It stopped something.
    Error,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogEvent {
    pub at: Instant,
    /// How much it matters.
    pub severity: Severity,
    pub source: String,
    pub text: String,
}

/// A drive by its last messages.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LastHeard {
    /// Position, rad, and when its answer ended.
    pub position: Option<(Instant, f64)>,
    pub current_a: Option<f64>,
    pub short_state: Option<ShortState>,
    pub state: Option<CubeState>,
    /// Target of the last ramp ordered, rad.
    pub ramp_target_rad: Option<f64>,
    /// Acceleration written last, rad/s².
    pub ramp_a_rad_s2: Option<f64>,
}

/// Everything known at the moment of a fault.
#[derive(Clone, Debug, PartialEq)]
pub struct FreezeFrame {
    /// When the controller reported it.
    pub at: Instant,
    pub group: GroupState,
    pub before: State,
    pub drives: BTreeMap<u8, LastHeard>,
    /// The last frames, oldest first.
    pub frames: Vec<(Instant, Frame)>,
}

/// What one frame led to.
#[derive(Clone, Debug, Default)]
pub struct Notes {
    /// Content, if it is the last frame of a transfer.
    pub fact: Option<Fact>,
    pub events: Vec<LogEvent>,
    /// A fault or stop that was not there before.
    pub freeze: Option<Box<FreezeFrame>>,
}

/// A halt of the drives follows the stop message of its sender within this time.
const STOP_WITHIN: Duration = Duration::from_secs(1);
/// Frames kept for a freeze frame.
const FRAMES_KEPT: usize = 24;
/// Signs of life farther apart than this begin again.
const LIFE_GAP: Duration = Duration::from_millis(500);

#[derive(Clone, Debug, Default)]
pub struct Watch {
    decoder: Decoder,
    joints: Numbering,
    group: Option<GroupState>,
    drives: BTreeMap<u8, LastHeard>,
    frames: VecDeque<(Instant, Frame)>,
    life_at: Option<Instant>,
    /// Who stopped last; a halt of the drives alone has no sender.
    stopped_by: Option<(Instant, String)>,
    way: Option<Way>,
    events: Vec<LogEvent>,
}

impl Watch {
    /// Watch of the arm with these joints: address of the drive and name of each, base first.
    #[must_use]
    pub fn new(joints: Vec<(u8, String)>) -> Self {
        Self { joints: Numbering::new(joints), ..Self::default() }
    }

    /// Takes the next frame, of another node or of this program.
    pub fn pass(&mut self, at: Instant, way: Way, frame: &Frame) -> Notes {
        self.way = Some(way);
        self.take(at, frame)
    }

    /// Sender of the stop that was just received.
    #[must_use]
    pub fn stopped_by(&self, now: Instant) -> Option<&str> {
        let (at, by) = self.stopped_by.as_ref()?;
        (now.saturating_since(*at) < STOP_WITHIN).then_some(by)
    }

    /// The text of a cause, with the sender if it is a stop that was sent.
    #[must_use]
    pub fn named(&self, code: u16, what: &str) -> String {
        match &self.stopped_by {
            Some((_, by)) if is_stop_by_other(code) => format!("{what}: it was {by}"),
            _ => what.to_owned(),
        }
    }

    fn note_stop(&mut self, at: Instant, from: Option<u8>) {
        // The first one counts: a program that is stopped by another one stops, too.
        if self.stopped_by(at).is_none() {
            self.stopped_by = match (self.way, from) {
                (Some(Way::Sent), _) => Some((at, "this program".to_owned())),
                (_, node) => node.map(|node| (at, format!("node {node}"))),
            };
        }
    }

    pub fn take(&mut self, at: Instant, frame: &Frame) -> Notes {
        if self.frames.len() == FRAMES_KEPT {
            self.frames.pop_front();
        }
        self.frames.push_back((at, *frame));
        let Some(fact) = self.decoder.take(at, frame) else { return Notes::default() };
        self.take_fact(at, fact)
    }

    /// Takes a fact that did not come in frames.
    pub fn take_fact(&mut self, at: Instant, mut fact: Fact) -> Notes {
        self.joints.renumber(at, &mut fact);
        let freeze = self.fact(at, &fact);
        Notes { fact: Some(fact), events: std::mem::take(&mut self.events), freeze }
    }

    fn note(&mut self, at: Instant, severity: Severity, source: impl Into<String>, text: impl Into<String>) {
        self.events.push(LogEvent { at, severity, source: source.into(), text: text.into() });
    }

    /// The controller reports that it starts.
    fn boots(&self) -> bool {
        self.group.is_some_and(|group| group.state == State::Boot)
    }

    fn drive_name(&self, address: u8) -> String {
        match self.joints.name(address) {
            Some(name) => format!("drive {address} ({name})"),
            None => format!("drive {address}"),
        }
    }

    fn fact(&mut self, at: Instant, fact: &Fact) -> Option<Box<FreezeFrame>> {
        match fact {
            Fact::Group { from, state, .. } => return self.group_state(at, from.get(), state),
            Fact::Joints { .. } | Fact::Answer { status: Status::SUCCESS, .. } => {}
            Fact::Record { from, severity, text } => {
                let severity = match *severity {
                    s if s >= RecordSeverity::Error => Severity::Error,
                    s if s >= RecordSeverity::Notice => Severity::Warning,
                    _ => Severity::Info,
                };
                self.note(at, severity, format!("controller {}", from.get()), format!("says: {text}"));
            }
            Fact::Order { from, number, .. } => {
                let text = format!("orders: {}", order_name(*number));
                self.note(at, Severity::Info, format!("host {}", from.get()), text);
            }
            Fact::Answer { from, number, refusal, status } => {
                let what = number.map_or("an order", order_name);
                let why = refusal.map_or_else(
                    || format!("status {}", status.0),
                    |refusal| fault_text(refusal.cause, refusal.joint, DriveDifference::default()),
                );
                let text = format!("refuses \"{what}\": {why}");
                self.note(at, Severity::Warning, format!("controller {}", from.get()), text);
            }
            Fact::Stop { from, .. } => {
                self.note_stop(at, from.map(protocol::cyphal::id::NodeId::get));
                let source =
                    from.map_or("an unknown sender".to_owned(), |from| format!("node {}", from.get()));
                self.note(at, Severity::Warning, source, "stop message");
            }
            Fact::Broadcast(broadcast) => self.broadcast(at, *broadcast),
            Fact::Request { module, request } => self.request(at, module.get(), request),
            Fact::Reply { module, reply } => self.reply(at, module.get(), reply),
        }
        None
    }

    fn group_state(&mut self, at: Instant, from: u8, state: &GroupState) -> Option<Box<FreezeFrame>> {
        let source = format!("controller {from}");
        let before = self.group.replace(*state);
        if before.map(|b| b.state) != Some(state.state) {
            let severity = match state.state {
                State::Fault => Severity::Error,
                State::Stopping | State::Stopped => Severity::Warning,
                _ => Severity::Info,
            };
            let mut text = match before {
                Some(before) => format!("{} → {}", before.state, state.state),
                None => format!("is in state {}", state.state),
            };
            if state.fault_cause != 0 {
                let cause = fault_text(state.fault_cause, state.fault_joint, state.differs);
                text += &format!(": {}", self.named(state.fault_cause, &cause));
            }
            self.note(at, severity, source.clone(), text);
        }
        let before = before?;
        if before.gripper_open != state.gripper_open {
            let text = if state.gripper_open { "gripper open" } else { "gripper closed" };
            self.note(at, Severity::Info, source.clone(), text);
        }
        if before.homed_mask != state.homed_mask {
            let homed = state.homed_mask.count_ones();
            let text = format!("{homed} joint{} homed", if homed == 1 { "" } else { "s" });
            self.note(at, Severity::Info, source.clone(), text);
        }
        if !before.bus_warning && state.bus_warning {
            self.note(at, Severity::Warning, source.clone(), "its CAN controller warns of errors");
        }
        let missed = state.replies_missed.saturating_sub(before.replies_missed);
        if missed > 0 {
            self.note(at, Severity::Warning, source.clone(), format!("missed answers: {missed}"));
        }
        let late = state.cycles_late.saturating_sub(before.cycles_late);
        if late > 0 {
            self.note(at, Severity::Warning, source, format!("late cycles: {late}"));
        }
        (before.fault_cause == 0 && state.fault_cause != 0).then(|| {
            Box::new(FreezeFrame {
                at,
                group: *state,
                before: before.state,
                drives: self.drives.clone(),
                frames: self.frames.iter().copied().collect(),
            })
        })
    }

    fn broadcast(&mut self, at: Instant, broadcast: Broadcast) {
        let (severity, text) = match broadcast {
            // Only the first sign of life in a while is news.
            Broadcast::Watchdog => {
                let last = self.life_at.replace(at);
                if last.is_some_and(|last| at.saturating_since(last) < LIFE_GAP) {
                    return;
                }
                (Severity::Info, "signs of life begin".to_owned())
            }
            Broadcast::Halt => {
                self.note_stop(at, None);
                (Severity::Warning, "halt".to_owned())
            }
            other => (Severity::Info, format!("{other:?}").to_lowercase()),
        };
        self.note(at, severity, "all drives", text);
    }

    fn request(&mut self, at: Instant, address: u8, request: &Request) {
        let drive = self.drives.entry(address).or_default();
        let text = match request {
            Request::Move(motion) => {
                if let MotionCommand::Ramp { target } = motion.command() {
                    drive.ramp_target_rad = Some(target.get().into());
                }
                return;
            }
            Request::Set(Parameter::TargetAcc, Value::F32(a)) => {
                drive.ramp_a_rad_s2 = Some(f64::from(*a));
                return;
            }
            Request::Simple(SimpleCommand::Reset) => "gets the order to reset",
            Request::Simple(SimpleCommand::Home) => "gets the order to search its zero",
            Request::Simple(SimpleCommand::Halt) => "gets the order to halt",
            Request::Set(Parameter::DioData, _) => "gets the order to switch its digital outputs",
            _ => return,
        };
        let name = self.drive_name(address);
        self.note(at, Severity::Info, name, text);
    }

    fn reply(&mut self, at: Instant, address: u8, reply: &Reply) {
        let drive = self.drives.entry(address).or_default();
        let was = *drive;
        if let Some((q_rad, short)) = position(reply) {
            drive.position = Some((at, q_rad));
            drive.short_state = short.or(was.short_state);
        }
        match reply {
            Reply::State(state) => drive.state = Some(*state),
            Reply::Value(Parameter::CubeState, Value::U32(bits)) => {
                drive.state = Some(CubeState::from_bits(*bits));
            }
            Reply::Value(Parameter::Cur, Value::F32(a)) => drive.current_a = Some(f64::from(*a)),
            _ => {}
        }
        let now = *drive;
        let not_ok = |heard: &LastHeard| heard.short_state.map(|s| s.intersects(ShortState::NOT_OK));
        match (not_ok(&was), not_ok(&now)) {
            (None | Some(false), Some(true)) => {
                let name = self.drive_name(address);
                // Before they are homed drives are never ready.
                let severity = if self.boots() { Severity::Info } else { Severity::Warning };
                self.note(at, severity, name, "not ready: in error, halted or not homed");
            }
            (Some(true), Some(false)) => {
                let name = self.drive_name(address);
                self.note(at, Severity::Info, name, "ready");
            }
            _ => {}
        }
        let causes = |heard: &LastHeard| heard.state.map_or(0, |s| s.bits() & CubeState::CAUSES.bits());
        let new = causes(&now) & !causes(&was);
        if new != 0 {
            let name = self.drive_name(address);
            // While nothing moves it stops nothing.
            let moving = self.group.is_none_or(|group| {
                matches!(
                    group.state,
                    State::Homing | State::Running | State::Stopping | State::Jogging | State::Fault
                )
            });
            let proves = self.boots() && new == CubeState::COMM_ERROR.bits();
            let (severity, why) = match (moving, proves) {
                (true, _) => (Severity::Error, ""),
                (false, true) => {
                    (Severity::Info, ": its watchdog works, which the starting controller proves")
                }
                (false, false) => (Severity::Warning, ""),
            };
            self.note(at, severity, name, format!("reports {}{why}", CubeState::from_bits(new)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::ModuleId;
    use protocol::cyphal::cubecell::group_state;
    use protocol::cyphal::id::{NodeId, Priority, Route, TransferId};
    use protocol::cyphal::tx::{TxMeta, TxQueue};

    fn group(watch: &mut Watch, at_us: u64, number: u8, state: &GroupState) -> Notes {
        let route = Route::Message { subject: group_state::SUBJECT, source: NodeId::from_low_bits(10) };
        let (deadline, transfer_id) = (Instant::FAR_FUTURE, TransferId::from_low_bits(number));
        let meta = TxMeta { route, priority: Priority::Nominal, transfer_id, deadline };
        let mut tx = TxQueue::<16, 64>::default();
        tx.push(&meta, state).unwrap();
        let mut last = Notes::default();
        while let Some(frame) = tx.pop() {
            last = watch.take(Instant::from_micros(at_us), &frame);
        }
        last
    }

    #[test]
    fn the_first_fault_comes_with_everything_known_before_it() {
        let mut watch = Watch::new(vec![(3, "joint3".to_owned())]);
        let module = ModuleId::new(3).unwrap();
        let current = Reply::Value(Parameter::Cur, Value::F32(-4.5)).encode(module);
        watch.take(Instant::from_micros(10), &current);
        let bits = CubeState::ERROR.bits() | CubeState::TOW_ERROR.bits();
        let word = Reply::Value(Parameter::CubeState, Value::U32(bits)).encode(module);
        let notes = watch.take(Instant::from_micros(20), &word);
        assert_eq!((notes.events.len(), notes.events[0].severity), (1, Severity::Error));
        assert!(notes.events[0].source == "drive 3 (joint3)", "{:?}", notes.events);
        assert!(watch.take(Instant::from_micros(30), &word).events.is_empty(), "said once");

        let running = GroupState { state: State::Running, ..GroupState::default() };
        assert!(group(&mut watch, 40, 0, &running).freeze.is_none());
        let fault = GroupState { state: State::Fault, fault_cause: 201, fault_joint: 3, ..running };
        let notes = group(&mut watch, 50, 1, &fault);
        let freeze = notes.freeze.expect("a new fault");
        assert_eq!((freeze.before, freeze.group.fault_cause), (State::Running, 201));
        assert_eq!(freeze.drives[&3].current_a, Some(-4.5));
        assert_eq!(freeze.frames.first().map(|(at, _)| at.as_micros()), Some(10));
        assert!(notes.events[0].text.contains("running → fault: joint 3:"), "{:?}", notes.events);
        assert!(group(&mut watch, 60, 2, &fault).freeze.is_none(), "the first one counts");
    }

    #[test]
    fn a_watchdog_error_is_expected_of_a_starting_controller_only() {
        let module = ModuleId::new(2).unwrap();
        let word = |cause: CubeState| {
            let bits = CubeState::ERROR.bits() | cause.bits();
            Reply::Value(Parameter::CubeState, Value::U32(bits)).encode(module)
        };
        let table = [
            (State::Boot, CubeState::COMM_ERROR, Severity::Info, "its watchdog works"),
            (State::Boot, CubeState::TOW_ERROR, Severity::Warning, "TOW_ERROR"),
            (State::Idle, CubeState::COMM_ERROR, Severity::Warning, "COMM_ERROR"),
            (State::Running, CubeState::COMM_ERROR, Severity::Error, "COMM_ERROR"),
        ];
        for (state, cause, severity, text) in table {
            let mut watch = Watch::new(Vec::new());
            group(&mut watch, 10, 0, &GroupState { state, ..GroupState::default() });
            let notes = watch.take(Instant::from_micros(20), &word(cause));
            let event = &notes.events[0];
            assert!(event.severity == severity && event.text.contains(text), "{state}: {event:?}");
            assert_eq!(
                event.text.contains("watchdog"),
                state == State::Boot && cause == CubeState::COMM_ERROR
            );
        }
    }
}

//! What happened, in words; and the first fault with everything known at that moment.

use firmware::fault::Cause;
use protocol::cyphal::cubecell::group_state::{GroupState, State};
use protocol::cyphal::uavcan::command::Status;
use protocol::cyphal::uavcan::diagnostic::Severity as RecordSeverity;
use protocol::powercube::{
    Broadcast, CubeState, Parameter, Reply, Request, ShortState, SimpleCommand, Value,
};
use serde::Serialize;

use super::PlanClock;
use super::collect::{Heard, Reading, position};
use crate::log::candump::Line;
use crate::log::facts::{Decoder, Fact, order_name};
use crate::plan::file::PlanFile;
use crate::plan::throw::{Arm, JOINTS};
use crate::verify::motion;

/// How much an event matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Severity {
    /// As it should be.
    Info,
    /// Worth a look.
    Warning,
    /// It stopped something.
    Error,
}

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

/// The group at the moment of the first fault.
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
    /// Acceleration of the last ramp ordered, rad/s².
    pub ramp_a_rad_s2: Option<f64>,
    /// Target of the last ramp ordered, rad.
    pub ramp_target_rad: Option<f64>,
}

/// Frames kept before a fault.
const FRAMES_BEFORE: usize = 24;

/// Everything that happened in the log, in order.
#[must_use]
pub fn events(lines: &[Line], arm: &Arm, addresses: &[u8; JOINTS], clock: PlanClock) -> Vec<Event> {
    let mut watch = Watch::new(arm, addresses);
    for line in lines {
        watch.take(clock.t_s(line.at), line);
    }
    watch.events
}

struct Watch<'a> {
    arm: &'a Arm,
    addresses: &'a [u8; JOINTS],
    decoder: Decoder,
    group: Option<GroupState>,
    not_ok: [bool; 32],
    causes: [u32; 32],
    watchdog_t_s: Option<f64>,
    events: Vec<Event>,
}

impl<'a> Watch<'a> {
    fn new(arm: &'a Arm, addresses: &'a [u8; JOINTS]) -> Self {
        Self {
            arm,
            addresses,
            decoder: Decoder::default(),
            group: None,
            not_ok: [false; 32],
            causes: [0; 32],
            watchdog_t_s: None,
            events: Vec::new(),
        }
    }

    fn note(&mut self, t_s: f64, severity: Severity, source: impl Into<String>, text: impl Into<String>) {
        self.events.push(Event { t_s, severity, source: source.into(), text: text.into() });
    }

    fn drive_name(&self, address: u8) -> String {
        match self.addresses.iter().position(|known| *known == address) {
            Some(joint) => format!("drive {address} ({})", self.arm.joints()[joint].name),
            None => format!("drive {address}"),
        }
    }

    fn take(&mut self, t_s: f64, line: &Line) {
        let Some(fact) = self.decoder.take(line.at, &line.frame) else { return };
        match fact {
            Fact::Group { from, state, .. } => self.group_state(t_s, from.get(), &state),
            Fact::Joints { .. } => {}
            Fact::Record { from, severity, text } => {
                let severity = match severity {
                    s if s >= RecordSeverity::Error => Severity::Error,
                    s if s >= RecordSeverity::Notice => Severity::Warning,
                    _ => Severity::Info,
                };
                self.note(t_s, severity, format!("controller {}", from.get()), format!("says: {text}"));
            }
            Fact::Order { from, number, .. } => {
                let text = format!("orders: {}", order_name(number));
                self.note(t_s, Severity::Info, format!("host {}", from.get()), text);
            }
            Fact::Answer { status: Status::SUCCESS, .. } => {}
            Fact::Answer { from, number, refusal, status } => {
                let what = number.map_or("an order", order_name);
                let why = refusal.map_or_else(
                    || format!("status {}", status.0),
                    |refusal| cause_text(refusal.cause, refusal.joint),
                );
                let text = format!("refuses \"{what}\": {why}");
                self.note(t_s, Severity::Warning, format!("controller {}", from.get()), text);
            }
            Fact::Stop { from, .. } => {
                let source = from.map_or("somebody".to_owned(), |from| format!("node {}", from.get()));
                self.note(t_s, Severity::Warning, source, "stop message");
            }
            Fact::Broadcast(broadcast) => self.broadcast(t_s, broadcast),
            Fact::Request { module, request } => {
                let text = match request {
                    Request::Simple(SimpleCommand::Reset) => "is told to reset",
                    Request::Simple(SimpleCommand::Home) => "is told to look for its zero",
                    Request::Simple(SimpleCommand::Halt) => "is told to halt",
                    Request::Set(Parameter::DioData, _) => "is told to switch its digital outputs",
                    _ => return,
                };
                let name = self.drive_name(module.get());
                self.note(t_s, Severity::Info, name, text);
            }
            Fact::Reply { module, reply } => self.reply(t_s, module.get(), &reply),
        }
    }

    fn group_state(&mut self, t_s: f64, from: u8, state: &GroupState) {
        let source = format!("controller {from}");
        let before = self.group.replace(*state);
        let before_state = before.map(|b| b.state);
        if before_state != Some(state.state) {
            let severity = match state.state {
                State::Fault => Severity::Error,
                State::Stopping | State::Stopped => Severity::Warning,
                _ => Severity::Info,
            };
            let mut text = match before_state {
                Some(from) => format!("{from} → {}", state.state),
                None => format!("is in state {}", state.state),
            };
            if state.fault_cause != 0 {
                text += &format!(": {}", cause_text(state.fault_cause, state.fault_joint));
            }
            self.note(t_s, severity, source.clone(), text);
        }
        let Some(before) = before else { return };
        if before.gripper_open != state.gripper_open {
            let text = if state.gripper_open { "gripper open" } else { "gripper closed" };
            self.note(t_s, Severity::Info, source.clone(), text);
        }
        if before.homed_mask != state.homed_mask {
            let text = format!("{} of the joints homed", state.homed_mask.count_ones());
            self.note(t_s, Severity::Info, source.clone(), text);
        }
        if !before.bus_warning && state.bus_warning {
            self.note(t_s, Severity::Warning, source.clone(), "its CAN controller warns of errors");
        }
        let missed = state.replies_missed.saturating_sub(before.replies_missed);
        let late = state.cycles_late.saturating_sub(before.cycles_late);
        if missed > 0 {
            self.note(t_s, Severity::Warning, source.clone(), format!("missed {missed} answers"));
        }
        if late > 0 {
            self.note(t_s, Severity::Warning, source, format!("{late} late cycles"));
        }
    }

    fn broadcast(&mut self, t_s: f64, broadcast: Broadcast) {
        let (severity, text) = match broadcast {
            // Only the first sign of life in a while is news.
            Broadcast::Watchdog => {
                let last = self.watchdog_t_s.replace(t_s);
                if last.is_some_and(|last| t_s - last < 0.5) {
                    return;
                }
                (Severity::Info, "signs of life begin".to_owned())
            }
            Broadcast::Halt => (Severity::Warning, "halt".to_owned()),
            other => (Severity::Info, format!("{other:?}").to_lowercase()),
        };
        self.note(t_s, severity, "all drives", text);
    }

    fn reply(&mut self, t_s: f64, address: u8, reply: &Reply) {
        let place = usize::from(address & 31);
        if let Some((_, Some(short))) = position(reply) {
            let not_ok = short.intersects(ShortState::NOT_OK);
            if not_ok != self.not_ok[place] {
                self.not_ok[place] = not_ok;
                let (severity, text) = if not_ok {
                    (Severity::Warning, "not ready: in error, halted or not homed")
                } else {
                    (Severity::Info, "ready")
                };
                let name = self.drive_name(address);
                self.note(t_s, severity, name, text);
            }
        }
        let state = match reply {
            Reply::State(state) => *state,
            Reply::Value(Parameter::CubeState, Value::U32(bits)) => CubeState::from_bits(*bits),
            _ => return,
        };
        let causes = state.bits() & CubeState::CAUSES.bits();
        let new = causes & !self.causes[place];
        self.causes[place] = causes;
        if new != 0 {
            let name = self.drive_name(address);
            self.note(t_s, Severity::Error, name, format!("reports {}", CubeState::from_bits(new)));
        }
    }
}

/// A cause in words, with its joint.
fn cause_text(code: u16, joint: u8) -> String {
    let place = if joint == 0 { String::new() } else { format!("joint {joint}: ") };
    match Cause::from_code(code).and_then(Cause::info) {
        Some(info) => format!("{place}{} ({code})", info.what),
        None => format!("{place}cause {code}"),
    }
}

/// The first fault or ordered stop after the start of the plan.
#[must_use]
pub fn first_fault(lines: &[Line], plan: &PlanFile, heard: &Heard, clock: PlanClock) -> Option<FirstFault> {
    let index = heard.group.iter().position(|(t_s, group)| *t_s > 0.0 && group.fault_cause != 0)?;
    let (t_s, group) = heard.group[index];
    let before = index.checked_sub(1).map_or(State::Boot, |i| heard.group[i].1.state);
    let info = Cause::from_code(group.fault_cause).and_then(Cause::info);
    let last = |readings: &[Reading]| readings.iter().rev().find(|r| r.t_s <= t_s).copied();
    let joints = heard
        .drives
        .iter()
        .enumerate()
        .map(|(j, drive)| {
            let q = last(&drive.positions);
            let ramp = drive.commands.iter().rev().find(|c| c.t_s <= t_s);
            FrozenJoint {
                q_rad: q.map(|r| r.value),
                error_rad: q.map(|r| motion::at(plan, r.t_s).q[j] - r.value),
                age_s: q.map(|r| t_s - r.t_s),
                current_a: last(&drive.currents).map(|r| r.value),
                ramp_a_rad_s2: ramp.and_then(|c| c.a_rad_s2),
                ramp_target_rad: ramp.map(|c| c.target_rad),
            }
        })
        .collect();
    let until = lines.partition_point(|line| clock.t_s(line.at) <= t_s);
    let frames = lines[until.saturating_sub(FRAMES_BEFORE)..until]
        .iter()
        .map(|line| format!("{:+.6} s  {}", clock.t_s(line.at), line.frame))
        .collect();
    Some(FirstFault {
        t_s,
        code: group.fault_cause,
        joint: (group.fault_joint > 0).then_some(group.fault_joint),
        what: info.map_or_else(|| format!("cause {}", group.fault_cause), |info| info.what.to_owned()),
        recovery: info.map_or_else(String::new, |info| info.recovery.to_owned()),
        state_before: before.to_string(),
        joints,
        frames,
    })
}

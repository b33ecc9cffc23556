//! What was heard last on a bus, as one snapshot.

use std::collections::{BTreeMap, VecDeque};
use std::io;
use std::sync::{Arc, Mutex, PoisonError};

use can_link::BusError;
use firmware::fault::Cause;
use protocol::cyphal::cubecell::group_state::GroupState;
use protocol::cyphal::cubecell::joint_state::JointSample;
use protocol::powercube::{CubeState, Parameter, Reply, ShortState, Value};
use protocol::{Duration, Frame, Instant};
use robot_model::{AnyRobot, JointVec, Pose, for_any_robot};
use serde::Serialize;

use crate::log::facts::{Fact, position};
use crate::log::watch::{LogEvent, Severity, Watch};
use crate::node::host_node::frame_bits;
use crate::tap::{Tap, Way};

/// Time over which the load of the bus is taken.
const LOAD_SPAN: Duration = Duration::from_millis(500);
/// Events kept.
const EVENTS_KEPT: usize = 200;

/// The bodies at joint angles in rad.
type Place = dyn Fn(&[f64]) -> Placed + Send;

/// What stands behind the bus: names, addresses and kinematics of the joints.
pub struct Machine {
    /// Name of the robot.
    pub robot: String,
    /// Names of the joints.
    pub joints: Vec<String>,
    /// Address of the drive of each joint; empty if the robot file has none.
    pub addresses: Vec<u8>,
    /// Bodies: number of the link (0 is the base), pose in its frame, half edges in m.
    pub boxes: Vec<(usize, Pose, [f64; 3])>,
    place: Box<Place>,
}

/// The bodies of an arm in the world frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Placed {
    /// Pose of each link: rotation by rows, then place in m.
    pub links: Vec<[f64; 12]>,
    /// Where the hand holds the ball, m.
    pub hand_m: [f64; 3],
}

impl Machine {
    /// The machine that a robot file describes; drives read the angles of their joints.
    #[must_use]
    pub fn of(robot: &AnyRobot) -> Self {
        let own = robot.clone();
        for_any_robot!(robot, arm => Self {
            robot: arm.name().to_owned(),
            joints: arm.joints().iter().map(|joint| joint.name.clone()).collect(),
            addresses: arm.drives().map_or_else(Vec::new, |drives| drives.iter().map(|drive| drive.address).collect()),
            boxes: arm.collision().boxes().iter().map(|b| (b.link, b.x_lb, b.half_m.into())).collect(),
            place: Box::new(move |q_rad| placed(&own, q_rad)),
        })
    }
}

fn placed(robot: &AnyRobot, q_rad: &[f64]) -> Placed {
    for_any_robot!(robot, arm => {
        let frames = arm.fk(&JointVec::from_fn(|j, _| q_rad.get(j).copied().unwrap_or_default()));
        let hand = arm.ball(&frames).pos;
        Placed { links: frames.x_w.iter().map(numbers).collect(), hand_m: [hand.x, hand.y, hand.z] }
    })
}

fn numbers(pose: &Pose) -> [f64; 12] {
    let mut all = [0.0; 12];
    let values = pose.rot.transpose();
    for (to, from) in all.iter_mut().zip(values.iter().chain(pose.pos.iter())) {
        *to = *from;
    }
    all
}

/// Everything a page shows.
#[derive(Clone, Debug, Serialize)]
pub struct Snapshot {
    /// Time of the session, s.
    pub t_s: f64,
    /// Unix time, s; zero in virtual time.
    pub unix_s: f64,
    /// Frames seen.
    pub frames: u64,
    /// Share of the bus that was taken in the last half second, without stuff bits, %.
    pub load_percent: f64,
    /// Errors that the bus reported.
    pub bus_errors: u64,
    /// The controller as it told last.
    pub controller: Option<ControllerView>,
    /// The joints, in the order of the robot file.
    pub joints: Vec<JointView>,
    /// The arm; `None` until every joint has told its angle.
    pub placed: Option<Placed>,
    /// What happened, oldest first.
    pub events: Vec<EventView>,
}

/// A controller as it told last.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ControllerView {
    /// Cyphal node-ID.
    pub node_id: u8,
    /// State of the group.
    pub state: String,
    /// Age of the message, s.
    pub age_s: f64,
    /// The latched fault.
    pub fault: Option<FaultView>,
    /// Time of the plan, s.
    pub plan_s: f64,
    /// Control period, µs.
    pub period_us: u16,
    /// Cycles that began late, since start.
    pub cycles_late: u16,
    /// Answers that did not come in time, since start.
    pub replies_missed: u16,
    /// Cycles in which an acceleration was clipped, since start.
    pub cycles_saturated: u16,
    /// The gripper is ordered to be open.
    pub gripper_open: bool,
    /// The host's heartbeat is fresh.
    pub host_alive: bool,
}

/// A fault in words.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FaultView {
    /// Number; `cubectl explain` knows it.
    pub code: u16,
    /// Joint from 1; zero is the group.
    pub joint: u8,
    /// What happened.
    pub what: String,
    /// What to do.
    pub next: String,
}

/// A joint as last heard.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct JointView {
    /// Name in the robot file.
    pub name: String,
    /// Angle that the drive told last, rad.
    pub q_rad: Option<f64>,
    /// Age of the angle, s.
    pub age_s: Option<f64>,
    /// Speed, as the controller told last, rad/s.
    pub qd_rad_s: Option<f64>,
    /// Reference minus measurement, as the controller told last, rad.
    pub error_rad: Option<f64>,
    /// Motor current that the drive told last, A.
    pub current_a: Option<f64>,
    /// State of the drive in words.
    pub state: String,
}

/// Something that happened.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EventView {
    /// Number of the event, from 1.
    pub number: u64,
    /// Time of the session, s.
    pub t_s: f64,
    /// `info`, `warning` or `error`.
    pub severity: Severity,
    /// Who says so.
    pub source: String,
    /// What.
    pub text: String,
}

/// What a drive told last.
#[derive(Clone, Debug, Default)]
struct Drive {
    position: Option<(Instant, f64)>,
    current_a: Option<f64>,
    short_state: Option<ShortState>,
    state: Option<CubeState>,
}

/// Follows a bus; [`LiveState::snapshot`] shows it.
pub struct LiveState {
    machine: Machine,
    zero_unix: Duration,
    watch: Watch,
    now: Instant,
    frames: u64,
    bits: VecDeque<(Instant, u64)>,
    bit_rate_bit_s: u32,
    bus_errors: u64,
    group: Option<(Instant, u8, GroupState)>,
    told: Vec<JointSample>,
    drives: BTreeMap<u8, Drive>,
    events: VecDeque<EventView>,
    event_number: u64,
}

impl LiveState {
    /// Nothing heard yet. `zero_unix` is the Unix time at the session's time zero; zero in virtual time.
    #[must_use]
    pub fn new(machine: Machine, zero_unix: Duration, bit_rate_bit_s: u32) -> Self {
        let names = machine.addresses.iter().copied().zip(machine.joints.iter().cloned()).collect();
        Self {
            machine,
            zero_unix,
            watch: Watch::new(names),
            now: Instant::ZERO,
            frames: 0,
            bits: VecDeque::new(),
            bit_rate_bit_s,
            bus_errors: 0,
            group: None,
            told: Vec::new(),
            drives: BTreeMap::new(),
            events: VecDeque::new(),
            event_number: 0,
        }
    }

    /// The machine behind the bus.
    #[must_use]
    pub const fn machine(&self) -> &Machine {
        &self.machine
    }

    /// Time passes.
    pub fn advance_to(&mut self, now: Instant) {
        self.now = self.now.max(now);
        while self.bits.front().is_some_and(|(at, _)| self.now.saturating_since(*at) > LOAD_SPAN) {
            self.bits.pop_front();
        }
    }

    /// Takes the next frame.
    pub fn take(&mut self, at: Instant, frame: &Frame) {
        self.advance_to(at);
        self.frames += 1;
        self.bits.push_back((at, frame_bits(frame)));
        let notes = self.watch.take(at, frame);
        match notes.fact {
            Some(Fact::Reply { module, reply }) => {
                let drive = self.drives.entry(module.get()).or_default();
                if let Some((q_rad, short)) = position(&reply) {
                    drive.position = Some((at, q_rad));
                    drive.short_state = short.or(drive.short_state);
                }
                match reply {
                    Reply::State(state) => drive.state = Some(state),
                    Reply::Value(Parameter::CubeState, Value::U32(bits)) => {
                        drive.state = Some(CubeState::from_bits(bits));
                    }
                    Reply::Value(Parameter::Cur, Value::F32(a)) => drive.current_a = Some(f64::from(a)),
                    _ => {}
                }
            }
            Some(Fact::Group { from, state, .. }) => self.group = Some((at, from.get(), state)),
            Some(Fact::Joints { state, .. }) => self.told = state.joints().to_vec(),
            _ => {}
        }
        for event in notes.events {
            self.note(event);
        }
    }

    /// An error of the bus.
    pub fn bus_error(&mut self, at: Instant, error: &BusError) {
        self.advance_to(at);
        self.bus_errors += 1;
        self.note(LogEvent {
            at,
            severity: Severity::Warning,
            source: "bus".to_owned(),
            text: error.to_string(),
        });
    }

    fn note(&mut self, event: LogEvent) {
        self.event_number += 1;
        if self.events.len() == EVENTS_KEPT {
            self.events.pop_front();
        }
        let LogEvent { at, severity, source, text } = event;
        let (number, t_s) = (self.event_number, at.as_secs_f64());
        self.events.push_back(EventView { number, t_s, severity, source, text });
    }

    /// What is known now; of the events those with a number above `after`.
    #[must_use]
    pub fn snapshot(&self, after: u64) -> Snapshot {
        let joints: Vec<JointView> = (0..self.machine.joints.len()).map(|j| self.joint(j)).collect();
        let q_rad: Option<Vec<f64>> = joints.iter().map(|joint| joint.q_rad).collect();
        let bits: u64 = self.bits.iter().map(|(_, bits)| bits).sum();
        let available = LOAD_SPAN.as_secs_f64() * f64::from(self.bit_rate_bit_s);
        let unix =
            if self.zero_unix == Duration::ZERO { 0.0 } else { (self.now + self.zero_unix).as_secs_f64() };
        Snapshot {
            t_s: self.now.as_secs_f64(),
            unix_s: unix,
            frames: self.frames,
            load_percent: (100.0 * bits as f64 / available).min(100.0),
            bus_errors: self.bus_errors,
            controller: self.group.as_ref().map(|(at, node_id, group)| self.controller(*at, *node_id, group)),
            placed: q_rad.filter(|q_rad| !q_rad.is_empty()).map(|q_rad| (self.machine.place)(&q_rad)),
            joints,
            events: self.events.iter().filter(|event| event.number > after).cloned().collect(),
        }
    }

    fn controller(&self, at: Instant, node_id: u8, group: &GroupState) -> ControllerView {
        let info = Cause::from_code(group.fault_cause).and_then(Cause::info);
        ControllerView {
            node_id,
            state: group.state.to_string(),
            age_s: self.now.saturating_since(at).as_secs_f64(),
            fault: (group.fault_cause != 0).then(|| FaultView {
                code: group.fault_cause,
                joint: group.fault_joint,
                what: info.map_or_else(String::new, |info| info.what.to_owned()),
                next: info.map_or_else(String::new, |info| info.recovery.to_owned()),
            }),
            plan_s: f64::from(group.trajectory_time_us) * 1e-6,
            period_us: group.cycle_us,
            cycles_late: group.cycles_late,
            replies_missed: group.replies_missed,
            cycles_saturated: group.cycles_saturated,
            gripper_open: group.gripper_open,
            host_alive: group.host_alive,
        }
    }

    fn joint(&self, j: usize) -> JointView {
        let drive = self.machine.addresses.get(j).and_then(|address| self.drives.get(address));
        let told = self.told.get(j);
        let measured = drive.and_then(|drive| drive.position);
        // Beside drives whose answers nobody hears there is what the controller tells.
        let q_rad = measured.map(|(_, q_rad)| q_rad).or_else(|| told.map(|told| f64::from(told.q_rad)));
        JointView {
            name: self.machine.joints.get(j).cloned().unwrap_or_default(),
            q_rad,
            age_s: measured.map(|(at, _)| self.now.saturating_since(at).as_secs_f64()),
            qd_rad_s: told.map(|told| f64::from(told.qd_rad_s)),
            error_rad: told.map(|told| f64::from(told.error_q_rad)),
            current_a: drive
                .and_then(|drive| drive.current_a)
                .or_else(|| told.map(|told| f64::from(told.current_a)).filter(|a| a.is_finite())),
            state: drive.map_or_else(String::new, in_words),
        }
    }
}

/// State of a drive: the word if it was told, else what the short one says.
fn in_words(drive: &Drive) -> String {
    match (drive.state, drive.short_state) {
        (Some(state), _) => state.to_string(),
        (None, Some(short)) if short.intersects(ShortState::NOT_OK) => "not ready".to_owned(),
        (None, Some(_)) => "ready".to_owned(),
        (None, None) => String::new(),
    }
}

/// Sees the frames of a session, and keeps a state that others read.
#[derive(Clone)]
pub struct LiveTap(pub Arc<Mutex<LiveState>>);

impl LiveTap {
    fn with(&self, act: impl FnOnce(&mut LiveState)) {
        // Whoever panicked only read.
        act(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner));
    }
}

impl Tap for LiveTap {
    fn frame(&mut self, at: Instant, _: Way, frame: &Frame) -> io::Result<()> {
        self.with(|state| state.take(at, frame));
        Ok(())
    }

    fn bus_error(&mut self, at: Instant, error: &BusError) -> io::Result<()> {
        self.with(|state| state.bus_error(at, error));
        Ok(())
    }

    fn time(&mut self, now: Instant) -> io::Result<()> {
        self.with(|state| state.advance_to(now));
        Ok(())
    }
}

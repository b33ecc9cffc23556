//! The latest data of a bus, as one snapshot.

use std::collections::{BTreeMap, VecDeque};
use std::io;
use std::sync::{Arc, Mutex, PoisonError};

use can_link::BusError;
use firmware::fault::Cause;
use protocol::cyphal::cubecell::group_state::{GroupState, State};
use protocol::cyphal::cubecell::joint_state::JointSample;
use protocol::powercube::{Broadcast, CubeState, Parameter, Reply, ShortState, Value};
use protocol::{Duration, Frame, Instant};
use serde::Serialize;

use super::age::{Age, Heard, Tone};
use super::events::{EventView, Events};
use super::stopping::{StopView, Stopping};
use crate::drives::difference_text;
use crate::log::facts::{Fact, position};
use crate::log::watch::{LogEvent, Severity, Watch};
use crate::machine::{Machine, Placed};
use crate::tap::{Tap, Way};

/// The load of the bus is the mean over this time.
const LOAD_SPAN: Duration = Duration::from_millis(500);
/// The load over a shorter time is not reported.
const LOAD_SPAN_MIN: Duration = Duration::from_millis(50);
/// Everything a page shows.
#[derive(Clone, Debug, Serialize)]
pub struct Snapshot {
    /// Time of the session, s.
    pub t_s: f64,
    /// Unix time, s; zero in virtual time.
    pub unix_s: f64,
    pub frames: u64,
    /// Share of the bus that was taken in the last half second, or since the beginning, without stuff bits, %.
    pub load_percent: f64,
    pub bus_errors: u64,
    /// The last stop and who obeys it, until it is over.
    pub stop: Option<StopView>,
    /// The controller by its last report.
    pub controller: Option<ControllerView>,
    /// Age of the last frame, s; `None` before the first.
    pub age_s: Option<f64>,
    /// `live`, or the source that is not heard and for how long.
    pub link: LinkView,
    /// The joints, in the order of the robot file.
    pub joints: Vec<JointView>,
    /// Modules on the bus that are not in the robot file.
    pub strangers: Vec<StrangerView>,
    /// The arm; `None` until every joint has reported its angle.
    pub placed: Option<Placed>,
    /// What happened, oldest first.
    pub events: Vec<EventView>,
}

/// Whether the shown data are present ones.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LinkView {
    /// In words.
    pub text: String,
    /// How it is shown.
    pub tone: Tone,
}

/// A controller by its last report.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ControllerView {
    pub node_id: u8,
    /// State of the group; `not heard for N s` if the message is old.
    pub state: String,
    /// How the state is shown.
    pub tone: Tone,
    pub age_s: f64,
    /// Nothing here need be so any more.
    pub old: bool,
    pub fault: Option<FaultView>,
    pub plan_s: f64,
    /// Control period, µs.
    pub period_us: u16,
    /// Cycles that began late, since start.
    pub cycles_late: u16,
    /// Answers that did not come in time, since start.
    pub replies_missed: u16,
    /// Cycles in which an acceleration was clipped, since start.
    pub cycles_saturated: u16,
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

/// A joint by its last messages.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct JointView {
    /// Name in the robot file.
    pub name: String,
    pub module: Option<u8>,
    /// Angle that the drive reported last, rad.
    pub q_rad: Option<f64>,
    pub age_s: Option<f64>,
    /// Nothing here need be so any more.
    pub old: bool,
    /// Speed, as the controller reports it, rad/s; `None` where it is old.
    pub qd_rad_s: Option<f64>,
    /// Reference minus measurement, as the controller reports it, rad; `None` where it is old.
    pub error_rad: Option<f64>,
    /// Motor current, A; `None` where it is old.
    pub current_a: Option<f64>,
    /// State of the drive in words; `not heard for N s` where it is old.
    pub state: String,
    /// The state word they were made of, if that is not old.
    pub state_bits: Option<u32>,
}

/// A module that is not in the robot file, by its last messages.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct StrangerView {
    /// Address.
    pub module: u8,
    /// Angle that the drive reported last, rad.
    pub q_rad: Option<f64>,
    /// Age of its last answer, s.
    pub age_s: f64,
    /// Motor current, A; `None` where it is old.
    pub current_a: Option<f64>,
    /// State of the drive in words; `not heard for N s` where it is old.
    pub state: String,
}

/// Last reports of a drive.
#[derive(Clone, Debug, Default)]
struct Drive {
    /// Last answer.
    heard: Instant,
    position: Option<Heard<f64>>,
    current_a: Option<Heard<f64>>,
    short_state: Option<Heard<ShortState>>,
    state: Option<Heard<CubeState>>,
}

/// Follows a bus; [`LiveState::snapshot`] shows it.
pub struct LiveState {
    machine: Machine,
    zero_unix: Duration,
    watch: Watch,
    now: Instant,
    /// When the first frame or time was received.
    began: Option<Instant>,
    /// Last frame.
    heard: Option<Instant>,
    frames: u64,
    bits: VecDeque<(Instant, u64)>,
    bit_rate_bit_s: u32,
    bus_errors: u64,
    group: Option<Heard<(u8, GroupState)>>,
    /// What the controller reports of each joint, by its number in the robot from 1.
    reported: BTreeMap<u8, Heard<JointSample>>,
    drives: BTreeMap<u8, Drive>,
    events: Events,
    stopping: Stopping,
}

impl LiveState {
    /// No data yet. `zero_unix` is the Unix time at the session's time zero; zero in virtual time.
    #[must_use]
    pub fn new(machine: Machine, zero_unix: Duration, bit_rate_bit_s: u32) -> Self {
        let names = machine.names();
        Self {
            machine,
            zero_unix,
            watch: Watch::new(names),
            now: Instant::ZERO,
            began: None,
            heard: None,
            frames: 0,
            bits: VecDeque::new(),
            bit_rate_bit_s,
            bus_errors: 0,
            group: None,
            reported: BTreeMap::new(),
            drives: BTreeMap::new(),
            events: Events::default(),
            stopping: Stopping::default(),
        }
    }

    /// Time passes.
    pub fn advance_to(&mut self, now: Instant) {
        self.now = self.now.max(now);
        self.began.get_or_insert(now);
        self.events.advance_to(self.now);
        while self.bits.front().is_some_and(|(at, _)| self.now.saturating_since(*at) > LOAD_SPAN) {
            self.bits.pop_front();
        }
    }

    /// Takes the next frame of another node.
    pub fn take(&mut self, at: Instant, frame: &Frame) {
        self.pass(at, Way::Received, frame);
    }

    /// Takes the next frame.
    pub fn pass(&mut self, at: Instant, way: Way, frame: &Frame) {
        self.advance_to(at);
        self.frames += 1;
        self.heard = Some(at);
        self.bits.push_back((at, self.machine.frame_bits(frame, self.bit_rate_bit_s)));
        let notes = self.watch.pass(at, way, frame);
        self.follow_stop(at, notes.fact.as_ref());
        match notes.fact {
            Some(Fact::Reply { module, reply }) => {
                let drive = self.drives.entry(module.get()).or_default();
                drive.heard = at;
                if let Some((q_rad, short)) = position(&reply) {
                    drive.position = Some(Heard::new(at, q_rad));
                    drive.short_state = short.map(|short| Heard::new(at, short)).or(drive.short_state);
                }
                match reply {
                    Reply::State(state) => drive.state = Some(Heard::new(at, state)),
                    Reply::Value(Parameter::CubeState, Value::U32(bits)) => {
                        drive.state = Some(Heard::new(at, CubeState::from_bits(bits)));
                    }
                    Reply::Value(Parameter::Cur, Value::F32(a)) => {
                        drive.current_a = Some(Heard::new(at, f64::from(a)));
                    }
                    _ => {}
                }
            }
            Some(Fact::Group { from, state, .. }) => self.group = Some(Heard::new(at, (from.get(), state))),
            Some(Fact::Joints { joints, .. }) => {
                self.reported
                    .extend(joints.into_iter().map(|(number, sample)| (number, Heard::new(at, sample))));
            }
            _ => {}
        }
        for event in notes.events {
            self.events.add(event);
        }
    }

    fn follow_stop(&mut self, at: Instant, fact: Option<&Fact>) {
        let is_controlled = self.group.is_some_and(|group| group.fresh(at).is_some());
        match fact {
            Some(Fact::Stop { .. } | Fact::Broadcast(Broadcast::Halt)) => {
                self.stopping.stop(at, self.watch.stopped_by(at));
            }
            Some(Fact::Group { state, .. }) => {
                self.stopping.report(matches!(state.state, State::Stopping | State::Stopped | State::Fault));
            }
            Some(Fact::Joints { joints, .. }) => {
                for (number, sample) in joints {
                    self.stopping.angle(*number, at, sample.q_rad.into());
                }
            }
            Some(Fact::Reply { module, reply }) => {
                let joint = self.machine.addresses.iter().position(|address| *address == module.get());
                let number = joint.and_then(|joint| u8::try_from(joint + 1).ok());
                if let Some((number, (q_rad, _))) = number.zip(position(reply)) {
                    self.stopping.angle(number, at, q_rad);
                }
                if let Reply::Value(Parameter::CubeState, Value::U32(bits)) = reply
                    && !is_controlled
                {
                    self.stopping.report(CubeState::from_bits(*bits).contains(CubeState::HALTED));
                }
            }
            _ => {}
        }
    }

    pub fn bus_error(&mut self, at: Instant, error: &BusError) {
        self.advance_to(at);
        self.bus_errors += 1;
        self.events.add(LogEvent {
            at,
            severity: Severity::Warning,
            source: "bus".to_owned(),
            text: error.to_string(),
        });
    }

    /// What is known now; of the events those with a number above `after`.
    #[must_use]
    pub fn snapshot(&self, after: u64) -> Snapshot {
        let joints: Vec<JointView> = (0..self.machine.joints.len()).map(|j| self.joint(j)).collect();
        let q_rad: Option<Vec<f64>> = joints.iter().map(|joint| joint.q_rad).collect();
        let bits: u64 = self.bits.iter().map(|(_, bits)| bits).sum();
        let seen = self.began.map_or(Duration::ZERO, |began| self.now.saturating_since(began));
        let span = seen.clamp(LOAD_SPAN_MIN, LOAD_SPAN);
        let available = span.as_secs_f64() * f64::from(self.bit_rate_bit_s);
        let unix =
            if self.zero_unix == Duration::ZERO { 0.0 } else { (self.now + self.zero_unix).as_secs_f64() };
        Snapshot {
            t_s: self.now.as_secs_f64(),
            unix_s: unix,
            frames: self.frames,
            load_percent: (100.0 * bits as f64 / available).min(100.0),
            bus_errors: self.bus_errors,
            age_s: self.heard.map(|at| Age::of(at, self.now).s()),
            link: self.link(),
            strangers: self.strangers(),
            stop: self.stopping.view(self.now),
            controller: self.group.map(|group| self.controller(group)),
            placed: q_rad.filter(|q_rad| !q_rad.is_empty()).map(|q_rad| self.machine.place(&q_rad)),
            joints,
            events: self.events.after(after),
        }
    }

    fn link(&self) -> LinkView {
        let silent =
            |who: &str, age: Age| LinkView { text: format!("{who}{}", age.words()), tone: Tone::Warn };
        match (self.heard, self.group.map(|group| group.age(self.now))) {
            (None, _) => LinkView { text: "nothing was heard yet".to_owned(), tone: Tone::Warn },
            (Some(at), _) if Age::of(at, self.now).is_old() => silent("the bus is ", Age::of(at, self.now)),
            (_, Some(age)) if age.is_old() => silent("the controller is ", age),
            _ => LinkView { text: "live".to_owned(), tone: Tone::Good },
        }
    }

    fn strangers(&self) -> Vec<StrangerView> {
        let strangers = self.drives.iter().filter(|(address, _)| !self.machine.addresses.contains(address));
        let view = |(module, drive): (&u8, &Drive)| StrangerView {
            module: *module,
            q_rad: drive.position.map(|position| position.value),
            age_s: Age::of(drive.heard, self.now).s(),
            current_a: drive.current_a.and_then(|a| a.fresh(self.now)),
            state: drive.words(self.now),
        };
        strangers.map(view).collect()
    }

    fn controller(&self, heard: Heard<(u8, GroupState)>) -> ControllerView {
        let (age, (node_id, group)) = (heard.age(self.now), heard.value);
        let info = Cause::from_code(group.fault_cause).and_then(Cause::info);
        ControllerView {
            node_id,
            state: if age.is_old() { age.words() } else { group.state.to_string() },
            tone: if age.is_old() { Tone::Bad } else { tone(group.state) },
            age_s: age.s(),
            old: age.is_old(),
            fault: (group.fault_cause != 0).then(|| FaultView {
                code: group.fault_cause,
                joint: group.fault_joint,
                what: difference_text(group.differs).unwrap_or_else(|| {
                    self.watch.named(group.fault_cause, info.map_or("", |info| info.what))
                }),
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
        let (now, module) = (self.now, self.machine.addresses.get(j).copied());
        let drive = module.and_then(|address| self.drives.get(&address));
        let reported = u8::try_from(j + 1).ok().and_then(|number| self.reported.get(&number).copied());
        let fresh = reported.and_then(|reported| reported.fresh(now));
        // For drives whose answers are not visible, the controller's reports are used.
        let measured = drive.and_then(|drive| drive.position);
        let angle = measured
            .or_else(|| reported.map(|reported| Heard::new(reported.at, f64::from(reported.value.q_rad))));
        let old = angle.map(|angle| angle.age(now)).filter(|age| age.is_old());
        JointView {
            name: self.machine.joints.get(j).cloned().unwrap_or_default(),
            module,
            q_rad: angle.map(|angle| angle.value),
            age_s: angle.map(|angle| angle.age(now).s()),
            old: old.is_some(),
            qd_rad_s: fresh.map(|reported| f64::from(reported.qd_rad_s)),
            error_rad: fresh.map(|reported| f64::from(reported.error_q_rad)),
            current_a: drive
                .and_then(|drive| drive.current_a?.fresh(now))
                .or_else(|| fresh.map(|reported| f64::from(reported.current_a)).filter(|a| a.is_finite())),
            state: match drive {
                Some(drive) => drive.words(now),
                None => old.map_or_else(String::new, Age::words),
            },
            state_bits: drive.and_then(|drive| drive.state?.fresh(now)).map(CubeState::bits),
        }
    }
}

const fn tone(state: State) -> Tone {
    match state {
        State::Ready | State::Running => Tone::Good,
        State::Armed | State::Stopping | State::Stopped => Tone::Warn,
        State::Fault => Tone::Bad,
        _ => Tone::Plain,
    }
}

/// A state word in words: first what is wrong, then what the drive does.
#[must_use]
fn in_words(state: CubeState) -> String {
    let meaning = |bits: CubeState| {
        CubeState::BITS.iter().filter(move |info| bits.bits() >> info.bit & 1 != 0).map(|info| info.meaning)
    };
    let causes: Vec<&str> = meaning(CubeState::from_bits(state.bits() & CubeState::CAUSES.bits())).collect();
    let mut words = Vec::new();
    if !causes.is_empty() {
        words.push(format!("error: {}", causes.join("; ")));
    } else if state.contains(CubeState::ERROR) {
        words.push("error".to_owned());
    }
    let reported = [
        (CubeState::HALTED, "halted"),
        (CubeState::BRAKEACTIVE, "brake on"),
        (CubeState::CURLIMIT, "controller output at its limit"),
        (CubeState::SWR, "on the home switch"),
        (CubeState::SW1, "on limit switch 1"),
        (CubeState::SW2, "on limit switch 2"),
    ];
    words.extend(reported.iter().filter(|(bit, _)| state.contains(*bit)).map(|(_, word)| (*word).to_owned()));
    let homed = if state.contains(CubeState::HOME_OK) { "homed" } else { "not homed" };
    let phases = [
        (CubeState::RAMP_ACC, "accelerates"),
        (CubeState::RAMP_STEADY, "moves at constant speed"),
        (CubeState::RAMP_DEC, "brakes"),
    ];
    let phase = phases.iter().find(|(bit, _)| state.contains(*bit)).map(|(_, word)| *word);
    let moves = if state.contains(CubeState::MOTION) { "moves" } else { "stands" };
    words.extend([homed, phase.unwrap_or(moves)].map(str::to_owned));
    words.join(", ")
}

impl Drive {
    /// State: from the word, otherwise from the short one, otherwise for how long neither was received.
    fn words(&self, now: Instant) -> String {
        let word = self.state.and_then(|state| state.fresh(now)).map(in_words);
        let short = || {
            Some(if self.short_state?.fresh(now)?.intersects(ShortState::NOT_OK) {
                "not ready"
            } else {
                "ready"
            })
        };
        let age = || {
            let reported = [self.state.map(|state| state.at), self.short_state.map(|short| short.at)];
            let age = Age::of(reported.into_iter().flatten().max().unwrap_or(self.heard), now);
            if age.is_old() { age.words() } else { String::new() }
        };
        word.or_else(|| short().map(str::to_owned)).unwrap_or_else(age)
    }
}

/// Sees the frames of a session, and keeps a state that others read.
#[derive(Clone)]
pub struct LiveTap(pub Arc<Mutex<LiveState>>);

impl LiveTap {
    fn with(&self, act: impl FnOnce(&mut LiveState)) {
        // A thread that panicked has only read.
        act(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner));
    }
}

impl Tap for LiveTap {
    fn frame(&mut self, at: Instant, way: Way, frame: &Frame) -> io::Result<()> {
        self.with(|state| state.pass(at, way, frame));
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_state_word_is_shown_in_words_with_errors_first() {
        let homed = CubeState::HOME_OK;
        assert_eq!(in_words(homed), "homed, stands");
        assert_eq!(in_words(CubeState::default()), "not homed, stands");
        assert_eq!(in_words(homed | CubeState::MOTION | CubeState::RAMP_DEC), "homed, brakes");
        let lost = CubeState::ERROR | CubeState::COMM_ERROR | CubeState::HALTED;
        assert_eq!(
            in_words(homed | lost),
            "error: communication lost: the watchdog expired, halted, homed, stands"
        );
        for info in CubeState::BITS {
            let bit = CubeState::from_bits(1 << info.bit);
            assert_eq!(
                in_words(bit).contains(info.meaning),
                CubeState::CAUSES.contains(bit),
                "each cause of an error is shown: {}",
                info.name
            );
        }
    }

    #[test]
    fn what_was_not_heard_for_a_second_is_shown_as_old() {
        let robot = robot_model::RobotModel::load("powercube6").unwrap();
        let mut state = LiveState::new(Machine::of(&robot), Duration::ZERO, 1_000_000);
        for module in [3, 9] {
            let module = protocol::ModuleId::new(module).unwrap();
            state.take(Instant::ZERO, &Reply::Value(Parameter::ActPos, Value::F32(0.25)).encode(module));
        }
        state.advance_to(Instant::from_micros(1_000_000));
        let fresh = state.snapshot(0);
        assert_eq!(
            (fresh.joints[2].old, fresh.joints[2].q_rad, fresh.joints[2].module),
            (false, Some(0.25), Some(3))
        );
        assert_eq!((fresh.strangers.len(), fresh.strangers[0].module, fresh.age_s), (1, 9, Some(1.0)));
        state.advance_to(Instant::from_micros(4_000_000));
        let old = state.snapshot(0);
        assert_eq!((old.joints[2].old, old.joints[2].state.as_str()), (true, "not heard for 4 s"));
        assert_eq!((old.joints[1].old, old.strangers[0].state.as_str()), (false, "not heard for 4 s"));
        assert_eq!((fresh.link.text.as_str(), fresh.link.tone), ("live", Tone::Good));
        assert_eq!((old.link.text.as_str(), old.link.tone), ("the bus is not heard for 4 s", Tone::Warn));
        // A position that still comes makes neither state word nor current new.
        let module = protocol::ModuleId::new(3).unwrap();
        let homed = CubeState::HOME_OK.bits();
        state.take(
            Instant::from_micros(4_000_000),
            &Reply::Value(Parameter::CubeState, Value::U32(homed)).encode(module),
        );
        state.take(
            Instant::from_micros(4_000_000),
            &Reply::Value(Parameter::Cur, Value::F32(1.5)).encode(module),
        );
        assert_eq!(
            (state.snapshot(0).joints[2].state.as_str(), state.snapshot(0).joints[2].current_a),
            ("homed, stands", Some(1.5))
        );
        state.take(
            Instant::from_micros(9_000_000),
            &Reply::Value(Parameter::ActPos, Value::F32(0.5)).encode(module),
        );
        let joint = &state.snapshot(0).joints[2];
        assert_eq!((joint.state.as_str(), joint.current_a, joint.old), ("not heard for 5 s", None, false));
    }

    #[test]
    fn the_load_is_reported_as_it_is_from_the_beginning() {
        let robot = robot_model::RobotModel::load("powercube6").unwrap();
        let mut state = LiveState::new(Machine::of(&robot), Duration::ZERO, 1_000_000);
        let frame = Frame::from_array(protocol::StandardId::from_low_bits(0x0A5), [8]);
        // A monitor begins to look a second after the session has begun.
        let mut loads = Vec::new();
        for ms in 1_000..1_800_u64 {
            state.take(Instant::from_micros(1_000 * ms), &frame);
            if matches!(ms, 1_100 | 1_790) {
                loads.push(state.snapshot(0).load_percent);
            }
        }
        let wanted = 100.0 * f64::from(frame.nominal_bits()) / 1_000.0;
        for load in loads {
            assert!((load / wanted - 1.0).abs() < 0.02, "{load} % instead of {wanted} %");
        }
    }
}

//! Power, network management, SYNC, emergencies.

use std::collections::VecDeque;

use protocol::canopen::block::BlockRequest;
use protocol::canopen::cia402::{self, Control, State};
use protocol::canopen::emcy::Emergency;
use protocol::canopen::nmt;
use protocol::canopen::pdo::Map;
use protocol::canopen::sdo::{AbortCode, Request};
use protocol::canopen::{Function, NodeId, Object};
use protocol::{Duration, Frame, Id, Instant, Node, StandardId};

use super::dictionary::{Dictionary, PDOS, Situation};
use super::options::{ServoFaults, ServoOptions};
use super::path::Path;
use super::server::{Objects, Server};
use crate::drive::bench::ShaftMotor;
use crate::mechanics::{AxisInput, AxisState};

/// Time between two segments of a block: more than a frame of 8 bytes takes at 500 kbit/s.
const SEGMENT_PERIOD: Duration = Duration::from_micros(300);
/// Frames that wait at most.
const FRAMES_MAX: usize = 32;
/// A code of [`Emergency`]: a heartbeat stayed away.
const HEARTBEAT_LOST: u16 = 0x8130;

/// One servo.
#[derive(Clone, Debug)]
pub struct CanopenServo {
    pub(super) options: ServoOptions,
    pub(super) faults: ServoFaults,
    pub(super) dictionary: Dictionary,
    powered: bool,
    /// The first heartbeat comes then.
    boots_at: Option<Instant>,
    network: nmt::State,
    pub(super) state: State,
    pub(super) control: Control,
    pub(super) path: Path,
    /// A target came since the last SYNC.
    pub(super) target_is_new: bool,
    /// A SYNC came since the node started.
    pub(super) is_synchronized: bool,
    /// SYNCs since the last target.
    pub(super) cycles_without_data: u32,
    /// A module looks for its commutation since then.
    pub(super) commutation_since: Option<Instant>,
    /// Since when the distance from the reference is beyond its window.
    pub(super) away_since: Option<Instant>,
    /// Homing: it has ended, or failed.
    pub(super) homing_done: Option<bool>,
    pub(super) axis: AxisState,
    /// Time of the mechanics.
    pub(super) grid: Instant,
    pub(super) step: Duration,
    /// True angle of the shaft at which it counts 0, rad.
    pub(super) origin_rad: f64,
    /// Process data that wait for the SYNC.
    received: [Option<(Map, [i32; 8])>; PDOS as usize],
    server: Server,
    heartbeat_at: Instant,
    heard_at: Option<Instant>,
    waiting: VecDeque<(Instant, Frame)>,
    ready: VecDeque<Frame>,
    /// Service data in blocks, one frame per [`SEGMENT_PERIOD`].
    block: VecDeque<(Instant, Frame)>,
    transmitted: u32,
    /// Status word in the process data that are sent by event.
    shown: i64,
    last: [Option<Frame>; PDOS as usize],
    /// Outputs that are switched, and since when.
    outputs: (u32, Instant),
}

impl CanopenServo {
    /// A servo with power whose shaft stands at `q_rad`. It boots at time 0.
    pub fn new(options: ServoOptions, q_rad: f64) -> Self {
        let mut servo = Self {
            dictionary: Dictionary::of(&options),
            options,
            faults: ServoFaults::default(),
            powered: false,
            boots_at: None,
            network: nmt::State::BootUp,
            state: State::NotReady,
            control: Control::DISABLE_VOLTAGE,
            path: Path::Hold(q_rad),
            target_is_new: false,
            is_synchronized: false,
            cycles_without_data: 0,
            commutation_since: None,
            away_since: None,
            homing_done: None,
            axis: AxisState { q_rad, ..AxisState::default() },
            grid: Instant::ZERO,
            step: Duration::ZERO,
            origin_rad: 0.0,
            received: [None; PDOS as usize],
            server: Server::Idle,
            heartbeat_at: Instant::ZERO,
            heard_at: None,
            waiting: VecDeque::new(),
            ready: VecDeque::new(),
            block: VecDeque::new(),
            transmitted: 0,
            shown: 0,
            last: [None; PDOS as usize],
            outputs: (0, Instant::ZERO),
        };
        servo.set_power(Instant::ZERO, true);
        servo
    }

    /// What is wrong with it, from now on.
    pub fn faults_mut(&mut self) -> &mut ServoFaults {
        &mut self.faults
    }

    /// State of its drive.
    pub fn state(&self) -> State {
        self.state
    }

    /// State of its node.
    pub fn network(&self) -> nmt::State {
        self.network
    }

    /// Angle of the shaft as it counts it, rad.
    pub fn shaft_rad(&self) -> f64 {
        self.axis.q_rad - self.origin_rad
    }

    /// Whether it has its gripper open, and since when; `None`: no gripper hangs on it.
    pub fn gripper(&self) -> Option<(bool, Instant)> {
        let (outputs, since) = self.outputs;
        self.options.gripper_bit.map(|bit| (outputs >> bit & 1 != 0, since))
    }

    /// Outputs that are wanted and released.
    fn switch_outputs(&mut self, now: Instant) {
        let [wanted, mask] = [1, 2].map(|sub| self.dictionary.get(cia402::OUTPUTS, sub) as u32);
        if self.outputs.0 != wanted & mask {
            self.outputs = (wanted & mask, now);
        }
    }

    /// Value of an object, for tests; `None`: the object does not exist.
    pub fn object(&self, index: u16, sub: u8) -> Option<Vec<u8>> {
        self.dictionary.read(Object::new(index, sub)).ok()
    }

    /// Switches the power off or on. Objects that were written are lost, and with an incremental encoder the angle.
    pub fn set_power(&mut self, now: Instant, on: bool) {
        self.powered = on;
        self.waiting.clear();
        self.ready.clear();
        self.block.clear();
        self.restart(now);
        self.boots_at = on.then(|| now + self.options.boot);
        self.origin_rad = if self.options.is_absolute { self.options.zero_rad } else { self.axis.q_rad };
    }

    fn restart(&mut self, now: Instant) {
        self.dictionary = Dictionary::of(&self.options);
        (self.state, self.control) = (State::NotReady, Control::DISABLE_VOLTAGE);
        (self.network, self.server) = (nmt::State::BootUp, Server::Idle);
        (self.received, self.last) = ([None; PDOS as usize], [None; PDOS as usize]);
        (self.away_since, self.homing_done, self.heard_at) = (None, None, None);
        (self.is_synchronized, self.cycles_without_data, self.commutation_since) = (false, 0, None);
        self.path = Path::Hold(self.axis.q_rad);
        self.boots_at = Some(now + self.options.boot);
        self.switch_outputs(now);
    }

    fn communicates(&self) -> bool {
        self.powered && self.boots_at.is_none() && !self.faults.is_silent
    }

    fn send_at(&mut self, at: Instant, frame: Frame) {
        if self.waiting.len() < FRAMES_MAX {
            let place = self.waiting.iter().position(|(other, _)| *other > at).unwrap_or(self.waiting.len());
            self.waiting.insert(place, (at, frame));
        }
    }

    /// Reports an error. One of the class "monitoring, overrun" changes nothing else.
    pub fn emergency(&mut self, now: Instant, code: u16) {
        let register = 1 | match code >> 8 {
            0x20..=0x2F => 1 << 1,
            0x30..=0x3F => 1 << 2,
            0x40..=0x4F => 1 << 3,
            0x81 => 1 << 4,
            _ => 1 << 5,
        };
        self.dictionary.set(0x1001, 0, register);
        if code != 0 {
            self.dictionary.note_error(code);
        }
        let emergency = Emergency { code, register: register as u8, maker: [0; 5] };
        self.send_at(now, emergency.encode(self.options.node));
    }

    /// Reports that the errors are cleared.
    pub(super) fn cleared(&mut self, now: Instant) {
        self.dictionary.set(0x1001, 0, 0);
        self.dictionary.set(0x603F, 0, 0);
        let emergency = Emergency { code: 0, register: 0, maker: [0; 5] };
        self.send_at(now, emergency.encode(self.options.node));
    }

    fn enter_network(&mut self, network: nmt::State) {
        self.network = network;
        self.received = [None; PDOS as usize];
    }

    fn manage(&mut self, now: Instant, command: nmt::Command) {
        match command {
            nmt::Command::Start => self.enter_network(nmt::State::Operational),
            nmt::Command::Stop => {
                self.enter_network(nmt::State::Stopped);
                self.link_lost(now);
            }
            nmt::Command::PreOperational => self.enter_network(nmt::State::PreOperational),
            nmt::Command::ResetNode | nmt::Command::ResetCommunication => self.restart(now),
        }
    }

    /// The node whose heartbeat is supervised, and for how long it may stay away.
    fn supervised(&self) -> Option<(u8, Duration)> {
        let entry = self.dictionary.get(0x1016, 1);
        let ms = (entry & 0xFFFF) as u64;
        (ms > 0).then(|| ((entry >> 16) as u8, Duration::from_millis(ms)))
    }

    fn misses_host_at(&self) -> Option<Instant> {
        let (_, most) = self.supervised()?;
        self.heard_at.filter(|_| !self.faults.supervision_is_dead).map(|at| at + most)
    }

    fn heartbeat_period(&self) -> Option<Duration> {
        let ms = self.dictionary.get(0x1017, 0) as u64;
        (ms > 0 && self.communicates()).then(|| Duration::from_millis(ms))
    }

    fn synchronize(&mut self, now: Instant) {
        for pdo in 0..PDOS {
            if let Some((map, values)) = self.received[usize::from(pdo)].take() {
                self.take_values(now, &map, &values);
            }
        }
        self.at_sync(now);
        for pdo in 0..PDOS {
            if let Some((id, _, map)) = self.dictionary.process_data(0x1800, pdo, |_, kind| kind <= 240) {
                self.transmit(now, pdo, id, &map);
            }
        }
    }

    /// Process data by event: the status word has changed, or process data begin to run.
    fn show(&mut self, now: Instant) {
        if self.network != nmt::State::Operational {
            self.shown = -1;
            return;
        }
        self.measure(now);
        let status = self.dictionary.get(cia402::STATUS, 0);
        if std::mem::replace(&mut self.shown, status) == status {
            return;
        }
        for pdo in 0..PDOS {
            if let Some((id, _, map)) = self.dictionary.process_data(0x1800, pdo, |_, kind| kind >= 254) {
                self.transmit(now, pdo, id, &map);
            }
        }
    }

    fn transmit(&mut self, now: Instant, pdo: u8, id: u16, map: &Map) {
        self.transmitted = self.transmitted.wrapping_add(1);
        let lost = self.faults.answer_lost_every;
        if lost > 0 && self.transmitted.is_multiple_of(lost) {
            return;
        }
        self.measure(now);
        let mut values = [0; 8];
        for (to, entry) in values.iter_mut().zip(map.entries()) {
            *to = self.dictionary.get(entry.object.index, entry.object.sub) as i32;
            if entry.object.index == cia402::POSITION && self.faults.torn_answers > 0 {
                self.faults.torn_answers -= 1;
                *to ^= 0x0001_0000;
            }
        }
        let data = map.pack(&values);
        let id = Id::Standard(StandardId::from_low_bits(id));
        let Ok(frame) = Frame::new(id, data.get()) else { return };
        let last = &mut self.last[usize::from(pdo)];
        let frame = if self.faults.answers_are_stale { last.unwrap_or(frame) } else { frame };
        *last = Some(frame);
        self.send_at(now + self.options.process_after, frame);
    }

    fn receive(&mut self, now: Instant, id: u16, frame: &Frame) {
        for pdo in 0..PDOS {
            let Some((_, kind, map)) = self.dictionary.process_data(0x1400, pdo, |own, _| own == id) else {
                continue;
            };
            match (map.unpack(frame.data()), kind) {
                (None, _) => self.emergency(now, 0x8210),
                (Some(values), 0..=240) => self.received[usize::from(pdo)] = Some((map, values)),
                (Some(values), _) => self.take_values(now, &map, &values),
            }
        }
    }

    fn take_values(&mut self, now: Instant, map: &Map, values: &[i32; 8]) {
        for (entry, value) in map.entries().iter().zip(values) {
            let bytes = &value.to_le_bytes()[..usize::from(entry.bytes)];
            let situation = Situation { is_operational: true, maps_are_fixed: true };
            if self.dictionary.write(entry.object, bytes, situation).is_ok() {
                self.written(now, entry.object);
            }
        }
    }

    fn written(&mut self, now: Instant, object: Object) {
        match object.index {
            cia402::CONTROL => self.take_control(now),
            cia402::MODE => self.take_mode(now),
            cia402::TARGET_POSITION | cia402::INTERPOLATION_DATA => self.target_is_new = true,
            cia402::OUTPUTS => self.switch_outputs(now),
            0x1016 => self.heard_at = None,
            0x1017 => self.heartbeat_at = now,
            _ => {}
        }
    }

    /// A heartbeat that is supervised stayed away.
    fn miss_host(&mut self, now: Instant) {
        self.heard_at = None;
        self.emergency(now, HEARTBEAT_LOST);
        match self.dictionary.get(0x1029, 1) {
            0 if self.network == nmt::State::Operational => self.enter_network(nmt::State::PreOperational),
            2 => self.enter_network(nmt::State::Stopped),
            _ => {}
        }
        self.link_lost(now);
    }

    /// Reaction that object 6007 requires.
    fn link_lost(&mut self, now: Instant) {
        match self.dictionary.get(0x6007, 0) {
            1 => self.fail_silently(now, HEARTBEAT_LOST),
            2 => self.power_off(),
            3 => self.quick_stop(now),
            _ => {}
        }
    }
}

/// The dictionary as service data see it.
struct Served<'a> {
    servo: &'a mut CanopenServo,
    now: Instant,
    written: Option<Object>,
}

impl Objects for Served<'_> {
    fn read(&mut self, object: Object) -> Result<Vec<u8>, AbortCode> {
        self.servo.measure(self.now);
        self.servo.dictionary.read(object)
    }

    fn write(&mut self, object: Object, value: &[u8]) -> Result<(), AbortCode> {
        let situation = Situation {
            is_operational: self.servo.network == nmt::State::Operational,
            maps_are_fixed: self.servo.options.maps_are_fixed,
        };
        self.servo.dictionary.write(object, value, situation)?;
        self.written = Some(object);
        Ok(())
    }
}

impl CanopenServo {
    fn serve(&mut self, now: Instant, asked: &Frame) {
        let node = self.options.node;
        let mut server = std::mem::take(&mut self.server);
        let mut served = Served { servo: self, now, written: None };
        let (block, answer) = match BlockRequest::decode(asked) {
            Some((_, request)) => (server.answer_block(node, request, &mut served), None),
            None => {
                let request = Request::decode(asked).map(|(_, request)| request);
                (Vec::new(), server.answer(request, &mut served))
            }
        };
        let written = served.written;
        self.server = server;
        if let Some(object) = written {
            self.written(now, object);
        }
        let first = now + self.options.answer_after;
        self.block = (0..).zip(block).map(|(k, frame)| (first + SEGMENT_PERIOD * k, frame)).collect();
        if let Some(answer) = answer {
            self.send_at(now + self.options.answer_after, answer.encode(node));
        }
    }
}

impl ShaftMotor for CanopenServo {
    fn name(&self) -> String {
        format!("servo at node {}", self.options.node)
    }

    fn q_rad(&self) -> f64 {
        self.axis.q_rad
    }

    fn input(&self) -> AxisInput {
        self.input_at(self.grid + Duration::from_micros(self.step.as_micros() / 2))
    }

    fn tick(&mut self, axis: AxisState, dt_s: f64) {
        self.step = Duration::from_secs_f64(dt_s);
        (self.axis, self.grid) = (axis, self.grid + self.step);
        if self.powered {
            self.supervise(self.grid);
        }
    }
}

impl Node for CanopenServo {
    fn handle_frame(&mut self, now: Instant, frame: &Frame) {
        self.handle_timeout(now);
        let (Id::Standard(id), true) = (frame.id(), self.communicates()) else { return };
        let own = self.options.node;
        let is_own = |node: NodeId| node == own;
        match Function::of_frame(frame) {
            Some(Function::Nmt) => {
                if let Some((command, to)) = nmt::Command::decode(frame)
                    && to.is_none_or(is_own)
                {
                    self.manage(now, command);
                }
            }
            _ if self.network == nmt::State::Stopped => {}
            Some(Function::SdoToNode(node)) if is_own(node) && frame.data().len() == 8 => {
                self.serve(now, frame);
            }
            Some(Function::Heartbeat(node))
                if self.supervised().is_some_and(|(other, _)| other == node.get()) =>
            {
                self.heard_at = Some(now);
            }
            Some(Function::Sync) if self.network == nmt::State::Operational => self.synchronize(now),
            _ if self.network == nmt::State::Operational => self.receive(now, id.get(), frame),
            _ => {}
        }
        self.show(now);
    }

    fn handle_timeout(&mut self, now: Instant) {
        if !self.powered {
            return;
        }
        if self.boots_at.is_some_and(|at| at <= now) {
            (self.boots_at, self.network) = (None, nmt::State::PreOperational);
            self.state = State::SwitchOnDisabled;
            self.heartbeat_at = now;
            self.send_at(now, nmt::State::BootUp.encode(self.options.node));
        }
        if self.misses_host_at().is_some_and(|at| at <= now) {
            self.miss_host(now);
        }
        if let Some(period) = self.heartbeat_period()
            && self.heartbeat_at <= now
        {
            self.heartbeat_at = now + period;
            if !self.faults.heartbeat_is_lost {
                self.send_at(now, self.network.encode(self.options.node));
            }
        }
        for queue in [&mut self.waiting, &mut self.block] {
            while let Some((_, frame)) = queue.pop_front_if(|(at, _)| *at <= now) {
                if !self.faults.is_silent {
                    self.ready.push_back(frame);
                }
            }
        }
    }

    fn poll_frame(&mut self) -> Option<Frame> {
        self.ready.pop_front()
    }

    fn poll_timeout(&self) -> Option<Instant> {
        if !self.powered {
            return None;
        }
        let frame = [&self.waiting, &self.block].into_iter().filter_map(|queue| Some(queue.front()?.0)).min();
        let heartbeat = self.heartbeat_period().map(|_| self.heartbeat_at);
        [self.boots_at, self.misses_host_at(), heartbeat, frame].into_iter().flatten().min()
    }
}

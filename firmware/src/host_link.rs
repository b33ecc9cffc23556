//! The controller with its host link: one [`Node`] that speaks PowerCube on 11-bit ids and Cyphal on 29-bit ids.
//!
//! Only translation lives here: commands to [`Order`]s, register values to numbers, samples to messages. The
//! numbers, parameters and messages are those of [`protocol::cyphal::cubecell`].
//!
//! # Who is the host
//!
//! The node that gave the last accepted order. Its heartbeats and its commands keep a motion alive; those of
//! others do not. While armed or moving, others may only stop. A host must send its heartbeat faster than
//! `host.timeout_us`, not once a second as the standard asks at least.
//!
//! # Pace
//!
//! The drives come first. While a control cycle runs, Cyphal frames go out in what is left of it after the last
//! motion's answer, or one per two cycles if nothing is left. At rest they keep a distance, so that a long answer never
//! fills a transmit queue before a halt. A stop that is received is acted on at once and needs no frame of this node.
//! A call that makes a control step makes nothing else: samples are taken in the next call.

use core::borrow::BorrowMut;

use protocol::cyphal::bits::{Decode, Encode, Writer};
use protocol::cyphal::cubecell::TRAJECTORY_PATH;
use protocol::cyphal::cubecell::command::{
    self, ArmConfirm, ArmOffer, ArmPrepare, ClearFault, Gripper, Home, Jog,
};
use protocol::cyphal::cubecell::{group_state, joint_state, stop};
use protocol::cyphal::id::{NodeId, Priority, Route, SubjectId};
use protocol::cyphal::rx::{Port, Transfer};
use protocol::cyphal::server::{Application, ControllerCore, NodeStatus, Publication, Register};
use protocol::cyphal::uavcan::command::{Status, standard};
use protocol::cyphal::uavcan::diagnostic::Severity;
use protocol::cyphal::uavcan::file::FileError;
use protocol::cyphal::uavcan::heartbeat::{self, Health, Mode};
use protocol::cyphal::uavcan::info::{NodeInfo, Version};
use protocol::cyphal::uavcan::value::{Value, ValueBuf};
use protocol::{Duration, Frame, Instant, JOINTS_MAX, JointIndex, Node};

use crate::controller::Controller;
use crate::fault::{Cause, Refusal};
use crate::orders::{Done, Order};
use crate::registers::{self, Kind, Number};
use crate::settings::Settings;
use crate::spline::Spline;
use crate::state::StateKind;
use crate::store::{FileName, Storage};
use crate::telemetry::{GroupSample, JointSample};

/// Registers beside the settings: the types of the ports, as the standard wants them.
const TYPES: [(&str, &str); 3] = [
    ("uavcan.sub.stop.type", stop::TYPE),
    ("uavcan.pub.group_state.type", group_state::TYPE),
    ("uavcan.pub.joint_state.type", joint_state::TYPE),
];

/// Time between Cyphal frames: a little more than a frame takes at 1 Mbit/s.
const SPACING: Duration = Duration::from_micros(160);
/// Longest wait of telemetry behind a control step, if no frame comes before.
const LATER: Duration = Duration::from_millis(1);

/// Name of the program in `GetInfo`.
pub const NODE_NAME: &[u8] = b"cubecell.controller";

/// What a board knows about itself.
#[derive(Clone, Copy, Debug, Default)]
pub struct Identity {
    /// Number of this very board in the world.
    pub unique_id: [u8; 16],
    /// Board, major and minor version.
    pub hardware: (u8, u8),
}

/// Controller and host link.
pub struct ControllerNode<S, M = Spline> {
    link: ControllerCore,
    app: App<S, M>,
    group_state: Publication,
    joint_state: Publication,
    last_state: Option<StateKind>,
    sequence: u16,
    last_bits: u32,
    last_at: Instant,
    /// When the last Cyphal frame was handed out.
    last_frame: Instant,
    held: Option<Frame>,
    /// A control step was made in the last call: what is not urgent comes with the next one, at the latest then.
    later: Option<Instant>,
    now: Instant,
}

struct App<S, M> {
    controller: Controller<S, M>,
    identity: Identity,
    ports: [Port; 2],
    subjects: [SubjectId; 2],
    host: Option<NodeId>,
    complete: bool,
}

#[inline(never)]
fn link(now: Instant) -> ControllerCore {
    ControllerCore::new(now, NodeId::from_low_bits(0))
}

/// Until the settings are known.
const UNSET: SubjectId = SubjectId::from_low_bits(0);

impl<S: Storage, M: BorrowMut<Spline>> App<S, M> {
    #[inline(never)]
    fn asleep(storage: S, spline: M, identity: Identity) -> Self {
        Self {
            identity,
            ports: [stop::port(UNSET), heartbeat::PORT],
            subjects: [UNSET; 2],
            host: None,
            complete: false,
            controller: Controller::asleep(storage, spline),
        }
    }
}

impl<S: Storage> ControllerNode<S> {
    /// [`Self::with_spline`] with a spline of its own.
    pub fn new(now: Instant, storage: S, defaults: &Settings, identity: Identity) -> Self {
        Self::with_spline(now, storage, Spline::empty(), defaults, identity)
    }
}

impl<S: Storage, M: BorrowMut<Spline>> ControllerNode<S, M> {
    /// Node that starts at `now`; see [`Controller::with_spline`]. Node-ID and subjects are those of the settings.
    pub fn with_spline(now: Instant, storage: S, spline: M, defaults: &Settings, identity: Identity) -> Self {
        let mut node = Self::asleep(now, storage, spline, identity);
        node.wake(defaults);
        node
    }

    /// First half of [`Self::with_spline`], for a board: what this returns is made in the place it is kept in, and
    /// [`Self::wake`] must follow before anything else. In one call the node would be made and then moved, with stack for
    /// two of them.
    // The large parts come last and from a call each, or they would be made elsewhere (see `Controller::asleep`).
    #[inline(never)]
    pub fn asleep(now: Instant, storage: S, spline: M, identity: Identity) -> Self {
        let valid = Duration::from_millis(200);
        Self {
            group_state: Publication::new(UNSET, Priority::Nominal, valid),
            joint_state: Publication::new(UNSET, Priority::Low, valid),
            last_state: None,
            sequence: 0,
            last_bits: 0,
            last_at: now,
            last_frame: now,
            held: None,
            later: None,
            now,
            link: link(now),
            app: App::asleep(storage, spline, identity),
        }
    }

    /// Second half of [`Self::with_spline`]: takes over what is stored, over `defaults`.
    #[inline(never)]
    pub fn wake(&mut self, defaults: &Settings) {
        self.app.controller.wake(defaults);
        let Settings { node_id, stop_subject, group_state_subject, joint_state_subject, .. } =
            *self.app.controller.settings();
        let subject = |number: u32| SubjectId::from_low_bits(number as u16);
        let subjects = [subject(group_state_subject), subject(joint_state_subject)];
        self.app.ports = [stop::port(subject(stop_subject)), heartbeat::PORT];
        self.app.subjects = subjects;
        [self.group_state.subject, self.joint_state.subject] = subjects;
        self.link.set_address(NodeId::from_low_bits(node_id as u8));
    }

    /// The controller behind the link.
    pub const fn controller(&self) -> &Controller<S, M> {
        &self.app.controller
    }

    /// An order of whoever runs this node, such as a stop before it is switched off. Not through the host link: who is the
    /// host stays as it is.
    ///
    /// # Errors
    ///
    /// As [`Controller::order`].
    pub fn order(&mut self, now: Instant, order: Order) -> Result<Done, Refusal> {
        self.now = now;
        self.app.controller.order(now, order)
    }

    /// As a stop message on the bus: the halt broadcast is the next frame out.
    pub fn stop_now(&mut self, now: Instant) {
        self.now = now;
        self.app.controller.stop_now(now);
    }

    /// Level to put on the board's gripper output, once per change.
    pub const fn take_gripper_level(&mut self) -> Option<bool> {
        self.app.controller.take_gripper_level()
    }

    /// Messages that are due: at once when the state changes, else with the period of the telemetry.
    fn publish(&mut self, now: Instant) {
        let state = self.app.controller.state().kind();
        let changed = self.last_state != Some(state);
        let due = self.app.controller.take_telemetry_due(now);
        if !changed && !due {
            return;
        }
        let sample = self.app.controller.take_sample(now);
        if changed {
            self.last_state = Some(state);
            self.log_change(now, &sample);
        }
        let elapsed_us = now.saturating_since(self.last_at).as_micros().max(1);
        let bits = sample.bus_bits.wrapping_sub(self.last_bits);
        (self.last_bits, self.last_at) = (sample.bus_bits, now);
        // At 1 Mbit/s a bit is a microsecond. 32-bit arithmetic: 64 bits would bring in a long division.
        let elapsed_us = u32::try_from(elapsed_us).unwrap_or(u32::MAX);
        let load = u32::min(bits, 4_000_000).saturating_mul(1_000).checked_div(elapsed_us).unwrap_or(0);
        self.sequence = self.sequence.wrapping_add(1);
        let mut message = group_message(&sample, self.sequence, self.app.complete);
        message.bus_load_permille = load.min(1_000) as u16;
        let _ = self.link.publish(now, &mut self.group_state, &message);
        if due {
            let controller = &self.app.controller;
            let mut joints = [JointSample::default(); JOINTS_MAX];
            for (to, joint) in joints.iter_mut().zip(controller.joints()) {
                *to = controller.joint_sample(joint);
            }
            let count = controller.settings().joints as usize;
            let joints = joints.get(..count).unwrap_or(&joints);
            let cycle = sample.counters.cycles as u16;
            let message = joint_state::JointState::new(now.as_micros(), cycle, joints);
            let _ = self.link.publish(now, &mut self.joint_state, &message);
        }
    }

    /// What a call does once the drives are served.
    fn after_the_drives(&mut self, now: Instant) {
        self.later = None;
        self.publish(now);
        if self.link.poll_timeout() <= now {
            self.link.handle_timeout(now, &self.app);
        }
        self.refill();
    }

    fn log_change(&mut self, now: Instant, sample: &GroupSample) {
        let Some(fault) = sample.fault else { return };
        if matches!(sample.state, StateKind::Fault | StateKind::Stopped) {
            let severity = if fault.cause.is_plain_stop() { Severity::Notice } else { Severity::Error };
            self.link.log(now, severity, fault.cause.latched_name());
        }
    }

    /// When a Cyphal frame may be handed out.
    fn may_send_at(&self) -> Instant {
        let settings = self.app.controller.settings();
        if self.app.controller.is_keeping_time() && !self.app.controller.is_cycle_done() {
            self.last_frame + settings.cycle_period() * 2
        } else {
            self.last_frame + SPACING
        }
    }

    fn refill(&mut self) {
        if self.held.is_none() {
            self.held = self.link.poll_frame();
        }
    }
}

impl<S: Storage, M: BorrowMut<Spline>> Node for ControllerNode<S, M> {
    fn handle_frame(&mut self, now: Instant, frame: &Frame) {
        self.now = now;
        if frame.is_extended() {
            self.app.controller.count_foreign(frame);
            self.link.handle_frame(now, frame, &mut self.app);
        } else {
            self.app.controller.handle_frame(now, frame);
        }
        self.after_the_drives(now);
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.now = now;
        let cycles = self.app.controller.counters().cycles;
        // Harmless where nothing is due, and cheaper than the question.
        self.app.controller.handle_timeout(now);
        if self.app.controller.counters().cycles == cycles {
            self.after_the_drives(now);
        } else {
            self.later = Some(now + LATER);
        }
    }

    fn poll_frame(&mut self) -> Option<Frame> {
        if let Some(frame) = self.app.controller.poll_frame() {
            return Some(frame);
        }
        self.refill();
        if self.may_send_at() > self.now {
            return None;
        }
        let frame = self.held.take()?;
        self.last_frame = self.now;
        self.app.controller.count_foreign(&frame);
        self.refill();
        Some(frame)
    }

    fn poll_timeout(&self) -> Option<Instant> {
        let paced = self.held.is_some().then(|| self.may_send_at()).filter(|at| *at > self.now);
        let link = self.later.unwrap_or_else(|| self.link.poll_timeout());
        self.app.controller.poll_timeout().into_iter().chain([link]).chain(paced).min()
    }
}

impl<S: Storage, M: BorrowMut<Spline>> Application for App<S, M> {
    fn info(&self) -> NodeInfo<'_> {
        let version = |(major, minor)| Version { major, minor };
        NodeInfo {
            protocol: version((1, 0)),
            hardware: version(self.identity.hardware),
            software: version((0, 1)),
            software_vcs_revision: 0,
            unique_id: self.identity.unique_id,
            name: NODE_NAME,
            software_image_crc: None,
            certificate: &[],
        }
    }

    fn status(&self) -> NodeStatus {
        let kind = self.controller.state().kind();
        let health = match kind {
            StateKind::Fault => Health::Warning,
            StateKind::Stopping | StateKind::Stopped => Health::Advisory,
            _ => Health::Nominal,
        };
        let mode = if kind == StateKind::Boot { Mode::INITIALIZATION } else { Mode::OPERATIONAL };
        NodeStatus { health, mode, vendor_status: kind as u8 }
    }

    fn subscriptions(&self) -> &[Port] {
        &self.ports
    }

    fn publications(&self) -> &[SubjectId] {
        &self.subjects
    }

    fn register_count(&self) -> u16 {
        (registers::TABLE.len() + TYPES.len()) as u16
    }

    fn register_name(&self, index: u16) -> &[u8] {
        let index = usize::from(index);
        let own = registers::TABLE.get(index).map(|info| info.name);
        let name =
            own.or_else(|| TYPES.get(index.checked_sub(registers::TABLE.len())?).map(|(name, _)| *name));
        name.unwrap_or("").as_bytes()
    }

    fn register_read(&self, index: u16) -> Option<Register> {
        let index = usize::from(index);
        if let Some(info) = registers::TABLE.get(index) {
            let numbers = self.controller.register(index)?;
            let value = to_value(info.name, info.kind, numbers.as_slice())?;
            return Some(Register { mutable: true, persistent: true, value });
        }
        let (_, text) = TYPES.get(index.checked_sub(registers::TABLE.len())?)?;
        let value = Value::string(text).ok()?.into();
        Some(Register { mutable: false, persistent: true, value })
    }

    fn register_write(&mut self, now: Instant, index: u16, value: &Value<'_>) {
        let index = usize::from(index);
        let Some(info) = registers::TABLE.get(index) else { return };
        let mut numbers = [Number::Bit(false); JOINTS_MAX];
        let mut count = 0;
        for (place, at) in numbers.iter_mut().zip(0..value.len()) {
            let number = match info.kind {
                Kind::Real32 => value.f32(at).map(Number::Real32),
                Kind::Natural32 => value.u64(at).and_then(|x| u32::try_from(x).ok()).map(Number::Natural32),
                Kind::Bit => value.bool(at).map(Number::Bit),
            };
            let Some(number) = number else { return };
            *place = number;
            count += 1;
        }
        // More than fit are too many for any register; the refusal shows in the value read back.
        if value.len() == count
            && let Some(numbers) = numbers.get(..count)
        {
            let _ = self.controller.write_register_at(now, index, numbers);
        }
    }

    fn execute(
        &mut self,
        now: Instant,
        client: NodeId,
        number: u16,
        parameter: &[u8],
        output: &mut Writer<'_>,
    ) -> Status {
        if number == standard::EMERGENCY_STOP {
            self.controller.stop_now(now);
            return Status::SUCCESS;
        }
        let order = match order_of(number, parameter) {
            Ok(order) => order,
            Err(status) => return status,
        };
        let kind = self.controller.state().kind();
        let engaged = kind.may_move() || kind == StateKind::Armed;
        if engaged && self.host.is_some_and(|host| host != client) && order != Order::Stop {
            return Status::NOT_AUTHORIZED;
        }
        let before = (self.host, self.controller.host_heartbeat_at());
        if order != Order::Stop {
            self.host = Some(client);
            // A command is a sign of life too.
            self.controller.host_heartbeat(now);
        }
        match self.controller.order(now, order) {
            Ok(Done::Taken) => Status::SUCCESS,
            Ok(Done::Offer { token, valid }) => {
                let valid_ms = (valid.as_micros().min(60_000_000) as u32 / 1_000) as u16;
                ArmOffer { token, valid_ms }.encode(output);
                Status::SUCCESS
            }
            Err(refusal) => {
                // Whoever was the host stays it.
                if engaged || before.0.is_some_and(|host| host != client) {
                    self.host = before.0;
                    self.controller.set_host_heartbeat_at(before.1);
                }
                to_message(&refusal).encode(output);
                status_of(refusal.cause)
            }
        }
    }

    fn file_write(&mut self, now: Instant, path: &[u8], offset: u64, data: &[u8]) -> Result<(), FileError> {
        if path != TRAJECTORY_PATH {
            return Err(FileError::NOT_FOUND);
        }
        let offset = usize::try_from(offset).map_err(|_| FileError::FILE_TOO_LARGE)?;
        if data.is_empty() {
            // The end: everything before it must be there.
            let whole = self.controller.uploaded().is_some_and(|name| name.len as usize == offset);
            self.complete = whole;
            return if whole { Ok(()) } else { Err(FileError::INVALID_VALUE) };
        }
        let before = self.controller.uploaded();
        let outcome = self.controller.upload(now, offset, data);
        if self.controller.uploaded() != before {
            self.complete = false;
        }
        outcome.map_err(|refusal| match refusal.cause {
            Cause::UploadOutOfOrder => FileError::INVALID_VALUE,
            Cause::FileTooLong => FileError::FILE_TOO_LARGE,
            Cause::BankBusy => FileError::ACCESS_DENIED,
            _ => FileError::IO_ERROR,
        })
    }

    fn file_read(&mut self, path: &[u8], offset: u64, data: &mut [u8]) -> Result<usize, FileError> {
        if path != TRAJECTORY_PATH {
            return Err(FileError::NOT_FOUND);
        }
        let offset = usize::try_from(offset).map_err(|_| FileError::INVALID_VALUE)?;
        self.controller.download(offset, data).map_err(|_| FileError::IO_ERROR)
    }

    fn message(&mut self, now: Instant, transfer: &Transfer<'_>) {
        let [stop_port, _] = self.ports;
        match transfer.route {
            // Whatever it says, from whomever.
            Route::Message { subject, .. } | Route::Anonymous { subject, .. }
                if subject.get() == stop_port.id =>
            {
                self.controller.stop_now(now);
            }
            Route::Message { subject, source }
                if subject == heartbeat::SUBJECT && self.host == Some(source) =>
            {
                self.controller.host_heartbeat(now);
            }
            _ => {}
        }
    }
}

/// Order of a command; an error if there is none or its parameter cannot be read.
fn order_of(number: u16, parameter: &[u8]) -> Result<Order, Status> {
    fn read<'a, T: Decode<'a>>(parameter: &'a [u8]) -> Result<T, Status> {
        T::from_bytes(parameter).map_err(|_| Status::BAD_PARAMETER)
    }
    let ms = |ms: u16| Duration::from_millis(ms.into());
    let name = |parameter| {
        read::<command::Trajectory>(parameter)
            .map(|file| FileName { crc64: file.trajectory_crc64, len: file.length_bytes })
    };
    Ok(match number {
        command::ARM_PREPARE => {
            let ArmPrepare { trajectory_crc64, valid_ms } = read(parameter)?;
            Order::ArmPrepare { crc64: trajectory_crc64, valid: ms(valid_ms) }
        }
        command::ARM_CONFIRM => {
            let ArmConfirm { token, valid_ms } = read(parameter)?;
            Order::ArmConfirm { token, valid: ms(valid_ms) }
        }
        command::DISARM => Order::Disarm,
        command::RUN => Order::Run(name(parameter)?),
        command::STOP => Order::Stop,
        command::CLEAR_FAULT => {
            let ClearFault { fault_cause } = read(parameter)?;
            Order::ClearFault { code: fault_cause }
        }
        command::HOME => {
            let Home { joint_mask } = read(parameter)?;
            Order::Home { mask: joint_mask }
        }
        command::JOG => {
            let Jog { joint, qd_rad_s, hold_ms } = read(parameter)?;
            let joint = JointIndex::new(joint.into()).map_err(|_| Status::BAD_PARAMETER)?;
            Order::Jog { joint, qd_rad_s, hold: ms(hold_ms) }
        }
        command::COMMIT_TRAJECTORY => Order::Commit(name(parameter)?),
        command::GRIPPER => {
            let Gripper { open } = read(parameter)?;
            Order::Gripper { open }
        }
        standard::STORE_PERSISTENT_STATES => Order::SaveSettings,
        _ => return Err(Status::BAD_COMMAND),
    })
}

const fn status_of(cause: Cause) -> Status {
    match cause {
        Cause::OrderNotNow | Cause::GripperBusy | Cause::BankBusy => Status::BAD_STATE,
        Cause::BadValue | Cause::JointUnknown => Status::BAD_PARAMETER,
        _ => Status::FAILURE,
    }
}

fn to_message(refusal: &Refusal) -> command::Refusal {
    command::Refusal {
        cause: refusal.cause.code(),
        joint: refusal.joint.map_or(0, |joint| joint.get() as u8 + 1),
        index: refusal.index,
    }
}

/// Port numbers are 16 bits wide in the standard, all others as wide as they are here.
fn to_value(name: &str, kind: Kind, numbers: &[Number]) -> Option<ValueBuf> {
    let (mut floats, mut naturals, mut bits) =
        ([0.0f32; JOINTS_MAX], [0u32; JOINTS_MAX], [false; JOINTS_MAX]);
    let places = floats.iter_mut().zip(&mut naturals).zip(&mut bits);
    for (((float, natural), bit), number) in places.zip(numbers) {
        match *number {
            Number::Real32(x) => *float = x,
            Number::Natural32(x) => *natural = x,
            Number::Bit(x) => *bit = x,
        }
    }
    let count = numbers.len();
    match kind {
        Kind::Real32 => ValueBuf::try_from(floats.get(..count)?).ok(),
        Kind::Natural32 if name.starts_with("uavcan.") => Some(ValueBuf::from(*naturals.first()? as u16)),
        Kind::Natural32 => ValueBuf::try_from(naturals.get(..count)?).ok(),
        Kind::Bit => ValueBuf::bits(bits.get(..count)?).ok(),
    }
}

fn group_message(sample: &GroupSample, sequence: u16, complete: bool) -> group_state::GroupState {
    let us16 = |span: Duration| u16::try_from(span.as_micros()).unwrap_or(u16::MAX);
    let ms = (sample.arming_left.as_micros().min(u64::from(u32::MAX)) as u32) / 1_000;
    group_state::GroupState {
        uptime_us: sample.at.as_micros(),
        sequence,
        state: sample.state,
        fault_joint: sample.fault.and_then(|fault| fault.joint).map_or(0, |joint| joint.get() as u8 + 1),
        fault_cause: sample.fault.map_or(0, |fault| fault.cause.code()),
        homed_mask: sample.homed_mask,
        trajectory_stored: complete,
        trajectory_committed: sample.committed.is_some(),
        host_alive: sample.host_alive,
        gripper_open: sample.gripper_open,
        bus_warning: false,
        cycle_us: us16(sample.cycle),
        cycle_jitter_us: us16(sample.jitter),
        cycles_late: sample.counters.cycles_late,
        replies_missed: sample.counters.replies_missed,
        cycles_saturated: sample.counters.cycles_saturated,
        bus_load_permille: 0,
        trajectory_crc64: sample.committed.map_or(0, |name| name.crc64),
        trajectory_time_us: sample.path_us,
        arming_left_ms: u16::try_from(ms).unwrap_or(u16::MAX),
    }
}

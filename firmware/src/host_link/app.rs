//! Requests to the Cyphal node: info, registers, commands and files, answered by the controller.

use core::borrow::BorrowMut;

use protocol::cyphal::bits::{Decode, Encode, Writer};
use protocol::cyphal::cubecell::authorization::{Content, KEY_REGISTER, KEYED_REGISTER};
use protocol::cyphal::cubecell::command::{self, ArmOffer, Challenge, ClockReading, Room};
use protocol::cyphal::cubecell::history::{FREEZE_PATH, TRACE_PATH};
use protocol::cyphal::cubecell::target::{self, TargetAnswer, TargetState};
use protocol::cyphal::cubecell::{TRAJECTORY_PATH, group_state, joint_state, stop};
use protocol::cyphal::id::{NodeId, Route, SubjectId};
use protocol::cyphal::rx::{Port, Transfer};
use protocol::cyphal::server::{Application, NodeStatus, Register};
use protocol::cyphal::uavcan::command::{Status, standard};
use protocol::cyphal::uavcan::file::FileError;
use protocol::cyphal::uavcan::heartbeat::{self, Health, Heartbeat, Mode};
use protocol::cyphal::uavcan::info::{NodeInfo, Version};
use protocol::cyphal::uavcan::value::{Value, ValueBuf, ValueType};
use protocol::{Duration, Instant, JOINTS_MAX};

use super::history;
use super::messages::{order_of, status_of, target_of, to_message, to_value};
use super::{Identity, NODE_NAME, UNSET};
use crate::authority::{CHALLENGE_VALID, KEY_LEN, Key, Peer, Seed, Source};
use crate::controller::Controller;
use crate::fault::{Cause, Refusal};
use crate::group::DriveGroup;
use crate::orders::{Done, Order};
use crate::registers::{self, Kind, Number, Writable};
use crate::spline::Spline;
use crate::state::StateKind;
use crate::store::Storage;

/// Registers beside the settings: the types of the ports, which the standard requires.
const TYPES: [(&str, &str); 5] = [
    ("uavcan.sub.stop.type", stop::TYPE),
    ("uavcan.pub.group_state.type", group_state::TYPE),
    ("uavcan.pub.joint_state.type", joint_state::TYPE),
    ("uavcan.sub.target.type", target::TYPE),
    ("uavcan.pub.target_answer.type", target::ANSWER_TYPE),
];

/// Files, in the order in which they are listed.
const FILES: [&[u8]; 3] = [TRAJECTORY_PATH, FREEZE_PATH, TRACE_PATH];

/// Registers of the key, after those.
const KEYS: [&str; 2] = [KEY_REGISTER, KEYED_REGISTER];

/// A node in the numbering of the controller.
const fn peer(node: NodeId) -> Peer {
    Peer::new(node.get())
}

/// The output of a command, from its result.
fn answer<T>(
    outcome: Result<T, Refusal>,
    output: &mut Writer<'_>,
    write: impl FnOnce(T, &mut Writer<'_>),
) -> Status {
    match outcome {
        Ok(done) => {
            write(done, output);
            Status::SUCCESS
        }
        Err(refusal) => {
            to_message(&refusal).encode(output);
            status_of(refusal.cause)
        }
    }
}

fn ms(span: Duration) -> u16 {
    (span.as_micros().min(60_000_000) as u32 / 1_000) as u16
}

/// The application behind the node.
pub(super) struct App<S, M, G> {
    pub(super) controller: Controller<S, M, G>,
    identity: Identity,
    pub(super) ports: [Port; 3],
    pub(super) subjects: [SubjectId; 3],
    /// Answer to the last new end state, until it is sent.
    pub(super) answer: Option<TargetAnswer>,
    /// Node whose heartbeat was last accepted as the host's, and its uptime, s.
    beat: Option<(NodeId, u32)>,
    pub(super) complete: bool,
    pub(super) late_host: LateHost,
}

/// Whether a warning about a late host was sent: one for each arming or motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum LateHost {
    /// The host was in time.
    No,
    /// A sign of life came late; the warning is still to be sent.
    Seen,
    /// The warning was sent.
    Warned,
}

impl<S: Storage, M: BorrowMut<Spline>, G: DriveGroup> App<S, M, G> {
    #[inline(never)]
    pub(super) fn blank(storage: S, spline: M, identity: Identity, seed: Seed) -> Self {
        Self {
            identity,
            ports: [stop::port(UNSET), heartbeat::PORT, target::port(UNSET)],
            subjects: [UNSET; 3],
            answer: None,
            beat: None,
            complete: false,
            late_host: LateHost::No,
            controller: Controller::blank(storage, spline, seed),
        }
    }

    /// Heartbeat of a node. If its uptime has decreased, the node has started again and its earlier orders are void.
    fn take_heartbeat(&mut self, now: Instant, source: NodeId, payload: &[u8]) {
        let Ok(beat) = Heartbeat::from_bytes(payload) else { return };
        let peer = peer(source);
        if self.controller.host() == Some(peer) {
            if self.late_host == LateHost::No && self.controller.is_host_late(now) {
                self.late_host = LateHost::Seen;
            }
            let restarted =
                self.beat.is_some_and(|(node, uptime_s)| node == source && beat.uptime_s < uptime_s);
            self.beat = Some((source, beat.uptime_s));
            if restarted {
                self.controller.host_restarted(now, peer);
                return;
            }
        }
        self.controller.host_heartbeat(now, peer);
    }

    /// A new end state; its answer is sent with the next messages.
    fn take_target(&mut self, now: Instant, source: NodeId, payload: &[u8]) {
        let Ok(message) = TargetState::from_bytes(payload) else { return };
        let outcome = target_of(&message)
            .and_then(|target| self.controller.order(now, peer(source), Order::Retarget(target)));
        let sequence = message.sequence;
        self.answer = Some(match outcome {
            Ok(_) => TargetAnswer { sequence, ..TargetAnswer::default() },
            Err(refusal) => {
                let command::Refusal { cause, joint, index } = to_message(&refusal);
                TargetAnswer { sequence, cause, joint, index }
            }
        });
    }

    /// Registers of the controller and its drives; those of the host link follow.
    fn own_registers(&self) -> usize {
        registers::all(self.controller.settings()).count()
    }

    /// Takes the key, or removes it if the value is empty. A refusal is visible in register `security.keyed`, and in the trace.
    fn write_key(&mut self, now: Instant, source: Source<'_>, value: &Value<'_>) {
        if value.kind() != ValueType::Unstructured {
            return;
        }
        let bytes = value.bytes();
        let key = <[u8; KEY_LEN]>::try_from(bytes).ok().map(Key::new);
        if key.is_some() || bytes.is_empty() {
            let _ = self.controller.set_key(now, source, key);
        }
    }
}

impl<S: Storage, M: BorrowMut<Spline>, G: DriveGroup> Application for App<S, M, G> {
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
        (self.own_registers() + TYPES.len() + KEYS.len()) as u16
    }

    fn register_name(&self, index: u16) -> &[u8] {
        let index = usize::from(index);
        let own = registers::info(self.controller.settings(), index).map(|info| info.name);
        let name = own.or_else(|| {
            let mut others = TYPES.iter().map(|(name, _)| *name).chain(KEYS);
            others.nth(index.checked_sub(self.own_registers())?)
        });
        name.unwrap_or("").as_bytes()
    }

    fn register_read(&self, index: u16) -> Option<Register> {
        let index = usize::from(index);
        if let Some(info) = registers::info(self.controller.settings(), index) {
            let numbers = self.controller.register(index)?;
            let value = to_value(info.name, info.kind, numbers.as_slice())?;
            let mutable = info.writable != Writable::Never;
            return Some(Register { mutable, persistent: mutable, value });
        }
        let index = index.checked_sub(self.own_registers())?;
        if let Some((_, text)) = TYPES.get(index) {
            let value = Value::string(text).ok()?.into();
            return Some(Register { mutable: false, persistent: true, value });
        }
        if KEYS.get(index.checked_sub(TYPES.len())?) == Some(&KEY_REGISTER) {
            // Never returns the key itself.
            let value = Value::unstructured(&[]).ok()?.into();
            return Some(Register { mutable: true, persistent: true, value });
        }
        let value = ValueBuf::bits(&[self.controller.is_keyed()]).ok()?;
        Some(Register { mutable: false, persistent: true, value })
    }

    fn register_write(&mut self, now: Instant, client: NodeId, index: u16, value: &Value<'_>) {
        let content = Content::of_register(self.register_name(index), value).ok();
        let content = content.as_ref().map_or(&[][..], Content::as_slice);
        let source = Source { peer: peer(client), content };
        let index = usize::from(index);
        let Some(info) = registers::info(self.controller.settings(), index) else {
            // The only other register that can be written.
            self.write_key(now, source, value);
            return;
        };
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
        // More numbers than fit are too many for any register; the value read back shows the refusal.
        if value.len() == count
            && let Some(numbers) = numbers.get(..count)
        {
            let _ = self.controller.write_register_at(now, source, index, numbers);
        }
    }

    fn is_urgent(&self, number: u16) -> bool {
        matches!(number, standard::EMERGENCY_STOP | command::STOP | command::DISARM)
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
        if number == command::CLOCK {
            ClockReading { uptime_us: now.as_micros() }.encode(output);
            return Status::SUCCESS;
        }
        let peer = peer(client);
        if number == command::EXTEND {
            self.controller.host_heartbeat(now, peer);
            // Needs no code: the armed file contains the digest of the segment.
            return answer(self.controller.extend(now, peer, parameter), output, |knots, output| {
                Room { knots: knots as u16 }.encode(output);
            });
        }
        let order = match order_of(number, parameter) {
            Ok(order) => order,
            Err(status) => return status,
        };
        // A command is a sign of life too.
        self.controller.host_heartbeat(now, peer);
        let content = Content::of_command(number, parameter).ok();
        let content = content.as_ref().map_or(&[][..], Content::as_slice);
        answer(self.controller.order(now, Source { peer, content }, order), output, |done, output| match done
        {
            Done::Taken => {}
            Done::Offer { token, valid, digest } => {
                ArmOffer { token, valid_ms: ms(valid), digest }.encode(output);
            }
            Done::Challenge(nonce) => {
                Challenge { nonce, valid_ms: ms(CHALLENGE_VALID) }.encode(output);
            }
        })
    }

    fn file_name(&self, index: u32) -> &[u8] {
        FILES.get(index as usize).copied().unwrap_or_default()
    }

    fn file_write(
        &mut self,
        now: Instant,
        client: NodeId,
        path: &[u8],
        offset: u64,
        data: &[u8],
    ) -> Result<(), FileError> {
        if path != TRAJECTORY_PATH {
            return Err(FileError::NOT_FOUND);
        }
        let offset = usize::try_from(offset).map_err(|_| FileError::FILE_TOO_LARGE)?;
        if data.is_empty() {
            // End of the file: everything before it must be there.
            let whole = self.controller.uploaded().is_some_and(|name| name.len as usize == offset);
            self.complete = whole;
            return if whole { Ok(()) } else { Err(FileError::INVALID_VALUE) };
        }
        let before = self.controller.uploaded();
        let outcome = self.controller.upload(now, peer(client), offset, data);
        if self.controller.uploaded() != before {
            self.complete = false;
        }
        outcome.map_err(|refusal| match refusal.cause {
            Cause::UploadOutOfOrder => FileError::INVALID_VALUE,
            Cause::FileTooLong => FileError::FILE_TOO_LARGE,
            Cause::BankBusy | Cause::UploadOfOther => FileError::ACCESS_DENIED,
            _ => FileError::IO_ERROR,
        })
    }

    fn file_read(&mut self, path: &[u8], offset: u64, data: &mut [u8]) -> Result<usize, FileError> {
        let offset = usize::try_from(offset).map_err(|_| FileError::INVALID_VALUE)?;
        match path {
            TRAJECTORY_PATH => self.controller.download(offset, data).map_err(|_| FileError::IO_ERROR),
            FREEZE_PATH => Ok(history::read_freeze(&self.controller, offset, data)),
            TRACE_PATH => Ok(history::read_trace(&self.controller, offset, data)),
            _ => Err(FileError::NOT_FOUND),
        }
    }

    fn message(&mut self, now: Instant, transfer: &Transfer<'_>) {
        let [stop_port, _, target_port] = self.ports;
        match transfer.route {
            // A stop counts with any content, from any node.
            Route::Message { subject, .. } | Route::Anonymous { subject, .. }
                if subject.get() == stop_port.id =>
            {
                self.controller.stop_now(now);
            }
            Route::Message { subject, source } if subject == heartbeat::SUBJECT => {
                self.take_heartbeat(now, source, transfer.payload);
            }
            Route::Message { subject, source } if subject.get() == target_port.id => {
                self.take_target(now, source, transfer.payload);
            }
            _ => {}
        }
    }
}

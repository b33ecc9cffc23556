//! What the Cyphal node is asked for: info, registers, commands and files, answered by the controller.

use core::borrow::BorrowMut;

use protocol::cyphal::bits::{Encode, Writer};
use protocol::cyphal::cubecell::command::ArmOffer;
use protocol::cyphal::cubecell::{TRAJECTORY_PATH, group_state, joint_state, stop};
use protocol::cyphal::id::{NodeId, Route, SubjectId};
use protocol::cyphal::rx::{Port, Transfer};
use protocol::cyphal::server::{Application, NodeStatus, Register};
use protocol::cyphal::uavcan::command::{Status, standard};
use protocol::cyphal::uavcan::file::FileError;
use protocol::cyphal::uavcan::heartbeat::{self, Health, Mode};
use protocol::cyphal::uavcan::info::{NodeInfo, Version};
use protocol::cyphal::uavcan::value::Value;
use protocol::{Instant, JOINTS_MAX};

use super::messages::{order_of, status_of, to_message, to_value};
use super::{Identity, NODE_NAME, UNSET};
use crate::controller::Controller;
use crate::fault::Cause;
use crate::orders::{Done, Order};
use crate::registers::{self, Kind, Number};
use crate::spline::Spline;
use crate::state::StateKind;
use crate::store::Storage;

/// Registers beside the settings: the types of the ports, as the standard wants them.
const TYPES: [(&str, &str); 3] = [
    ("uavcan.sub.stop.type", stop::TYPE),
    ("uavcan.pub.group_state.type", group_state::TYPE),
    ("uavcan.pub.joint_state.type", joint_state::TYPE),
];

/// The application behind the node: the controller, and who its host is.
pub(super) struct App<S, M> {
    pub(super) controller: Controller<S, M>,
    identity: Identity,
    pub(super) ports: [Port; 2],
    pub(super) subjects: [SubjectId; 2],
    host: Option<NodeId>,
    pub(super) complete: bool,
}

impl<S: Storage, M: BorrowMut<Spline>> App<S, M> {
    #[inline(never)]
    pub(super) fn asleep(storage: S, spline: M, identity: Identity) -> Self {
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

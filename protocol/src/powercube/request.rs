//! Frames to one module.

use core::fmt;

use super::address::{Address, Channel};
use super::bytes_at;
use super::command::{Command, SimpleCommand};
use super::motion::{MotionKind, MotionRequest};
use super::parameter::Parameter;
use super::value::{Value, ValueKind};
use crate::frame::Frame;
use crate::id::Id;
use crate::module::ModuleId;

/// Order or read request to one module.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Request {
    /// One-byte command.
    Simple(SimpleCommand),
    /// Seven bytes of unknown meaning.
    Internal([u8; 7]),
    /// Read a parameter.
    Get(Parameter),
    /// Write a parameter. The value's type is the parameter's; [`Request::set`] checks it.
    Set(Parameter, Value),
    /// Start a motion.
    Move(MotionRequest),
    /// Step motion in ticks with a command byte of its own.
    SetStepInc {
        /// Where to, ticks.
        target_ticks: i32,
        /// In which time, ms.
        time_ms: u16,
    },
}

/// Value of a type the parameter does not have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct KindMismatch {
    /// The parameter.
    pub parameter: Parameter,
    /// Type of the refused value.
    pub found: ValueKind,
}

impl fmt::Display for KindMismatch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { parameter, found } = self;
        write!(f, "{parameter} is of type {:?}, not {found:?}", parameter.kind())
    }
}

impl core::error::Error for KindMismatch {}

/// Why a frame is not a request. A module stays silent on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RequestError {
    /// Not a data frame on a GET or PUT id.
    NotARequest(Id),
    /// No data.
    Empty,
    /// No addressed command with this byte.
    UnknownCommand(u8),
    /// No parameter with this number.
    UnknownParameter(u8),
    /// No motion with this number.
    UnknownMotion(u8),
    /// Length that command, parameter or motion does not have.
    Length {
        /// Byte 0.
        command: Command,
        /// Bytes seen.
        len: usize,
    },
}

impl fmt::Display for RequestError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotARequest(id) => write!(f, "{id} is not a data frame to a module"),
            Self::Empty => f.write_str("request without a command byte"),
            Self::UnknownCommand(code) => write!(f, "unknown command {code:#04X}"),
            Self::UnknownParameter(code) => write!(f, "unknown parameter {code:#04X}"),
            Self::UnknownMotion(code) => write!(f, "unknown motion {code:#04X}"),
            Self::Length { command, len } => write!(f, "{} does not have {len} bytes here", command.name()),
        }
    }
}

impl core::error::Error for RequestError {}

/// A request, its module and the channel it came on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AddressedRequest {
    /// Module that is to act on it.
    pub module: ModuleId,
    /// GET or PUT; modules decide by the command byte, and some hosts use either channel.
    pub channel: Channel,
    /// The request.
    pub request: Request,
}

impl Request {
    /// Write request, if the value is of the parameter's type.
    pub fn set(parameter: Parameter, value: Value) -> Result<Self, KindMismatch> {
        if value.kind() == parameter.kind() {
            Ok(Self::Set(parameter, value))
        } else {
            Err(KindMismatch { parameter, found: value.kind() })
        }
    }

    /// The command byte.
    pub const fn command(&self) -> Command {
        match self {
            Self::Simple(simple) => simple.command(),
            Self::Internal(_) => Command::Internal,
            Self::Get(_) => Command::GetParameter,
            Self::Set(..) => Command::SetParameter,
            Self::Move(_) => Command::SetMotion,
            Self::SetStepInc { .. } => Command::SetStepInc,
        }
    }

    /// The customary channel: GET for reads, PUT for all else.
    pub const fn channel(&self) -> Channel {
        match self {
            Self::Get(_) => Channel::Get,
            _ => Channel::Put,
        }
    }

    /// The frame to `module` on the customary channel.
    // By reference: a controller encodes a request for each drive in each control period, and a copy costs more than the frame.
    pub fn encode(&self, module: ModuleId) -> Frame {
        self.encode_with(self.channel().id(module))
    }

    fn encode_with(&self, id: Id) -> Frame {
        let command = self.command().code();
        match *self {
            Self::Simple(_) => Frame::from_array(id, [command]),
            Self::Internal([a, b, c, d, e, f, g]) => Frame::from_array(id, [command, a, b, c, d, e, f, g]),
            Self::Get(parameter) => Frame::from_array(id, [command, parameter.code()]),
            Self::Set(parameter, value) => frame_of_value(id, command, parameter, value),
            Self::Move(motion) => {
                let body = motion.to_wire();
                let [a, b, c, d, e, f, g] = body.bytes;
                head(id, [command, a, b, c, d, e, f, g], 1 + body.len)
            }
            Self::SetStepInc { target_ticks, time_ms } => {
                let [a, b, c, d] = target_ticks.to_le_bytes();
                let [e, f] = time_ms.to_le_bytes();
                Frame::from_array(id, [command, a, b, c, d, e, f])
            }
        }
    }
}

impl AddressedRequest {
    /// The frame, on the channel given.
    pub fn encode(&self) -> Frame {
        self.request.encode_with(self.channel.id(self.module))
    }

    /// Understands a frame to a module.
    pub fn decode(frame: &Frame) -> Result<Self, RequestError> {
        let (module, channel) = match Address::of(frame.id()) {
            Some(Address::Module(channel @ (Channel::Get | Channel::Put), module)) if !frame.is_remote() => {
                (module, channel)
            }
            _ => return Err(RequestError::NotARequest(frame.id())),
        };
        let data = frame.data();
        let code = *data.first().ok_or(RequestError::Empty)?;
        let command = Command::from_code(code).ok_or(RequestError::UnknownCommand(code))?;
        let wrong_length = RequestError::Length { command, len: data.len() };
        let parameter = || {
            let code = *data.get(1).ok_or(wrong_length)?;
            Parameter::from_code(code).ok_or(RequestError::UnknownParameter(code))
        };
        let request = match command {
            Command::GetParameter => {
                let parameter = parameter()?;
                if data.len() != 2 {
                    return Err(wrong_length);
                }
                Request::Get(parameter)
            }
            Command::SetParameter => {
                let parameter = parameter()?;
                Request::Set(parameter, Value::from_wire(parameter.kind(), data, 2).ok_or(wrong_length)?)
            }
            Command::SetMotion => {
                let code = *data.get(1).ok_or(wrong_length)?;
                let (kind, ack) = MotionKind::from_code(code).ok_or(RequestError::UnknownMotion(code))?;
                Request::Move(MotionRequest::from_wire(kind, ack, data).ok_or(wrong_length)?)
            }
            Command::SetStepInc => match data.len() {
                7 => Request::SetStepInc {
                    target_ticks: bytes_at(data, 1).map(i32::from_le_bytes).ok_or(wrong_length)?,
                    time_ms: bytes_at(data, 5).map(u16::from_le_bytes).ok_or(wrong_length)?,
                },
                _ => return Err(wrong_length),
            },
            Command::Internal => match data.len() {
                8 => Request::Internal(bytes_at(data, 1).ok_or(wrong_length)?),
                _ => return Err(wrong_length),
            },
            // Broadcasts only; no source sends them to one module.
            Command::SavePosition | Command::StartMotion => {
                return Err(RequestError::UnknownCommand(code));
            }
            Command::Reset
            | Command::Home
            | Command::Halt
            | Command::ToggleHome
            | Command::Watchdog
            | Command::Recalc
            | Command::SaveParameters
            | Command::ResetClock => match (data.len(), SimpleCommand::of(command)) {
                (1, Some(simple)) => Request::Simple(simple),
                _ => return Err(wrong_length),
            },
        };
        Ok(Self { module, channel, request })
    }
}

/// `command parameter value`, as SET requests and GET answers carry it.
pub(super) fn frame_of_value(id: Id, command: u8, parameter: Parameter, value: Value) -> Frame {
    let [a, b, c, d, e, f] = value.to_wire();
    head(id, [command, parameter.code(), a, b, c, d, e, f], 2 + value.kind().wire_len())
}

/// Data frame of the first `len` of eight bytes.
pub(super) fn head(id: Id, bytes: [u8; 8], len: usize) -> Frame {
    // `len` is at most eight by construction of the callers; `get` keeps that free of a panic path.
    Frame::new(id, bytes.get(..len).unwrap_or(&bytes)).unwrap_or(Frame::from_array(id, bytes))
}

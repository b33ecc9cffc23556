//! Frames from a module.

use core::fmt;

use super::ACCEPTED;
use super::address::{Address, Channel};
use super::bytes_at;
use super::command::{Command, SimpleCommand};
use super::motion::{MotionAck, MotionKind};
use super::parameter::Parameter;
use super::request::{Request, frame_of_value, head};
use super::state::{CubeState, Dio, ShortState};
use super::value::Value;
use crate::frame::Frame;
use crate::id::Id;
use crate::module::ModuleId;
use crate::units::Radians;

/// Actual position in the answer to a motion, in the unit of the motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MotionPosition {
    /// Answer to a motion in rad.
    Radians(Radians),
    /// Answer to a motion in ticks.
    Ticks(i32),
}

/// What a module sends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reply {
    /// A one-byte command was taken.
    Simple(SimpleCommand),
    /// Eight bytes of unknown meaning.
    Internal([u8; 7]),
    /// A parameter's value.
    Value(Parameter, Value),
    /// A write was taken or refused.
    SetAck {
        /// The parameter written.
        parameter: Parameter,
        /// Byte 2: [`ACCEPTED`], another value, or `None` if the byte is missing (some hosts do not need it).
        code: Option<u8>,
    },
    /// Short answer to a motion.
    MotionAck {
        /// The motion taken.
        kind: MotionKind,
        /// Byte 2: [`ACCEPTED`] or something else.
        code: u8,
    },
    /// Long answer to a motion.
    MotionExtended {
        /// The motion taken.
        kind: MotionKind,
        /// Actual position, before the motion starts to act.
        position: MotionPosition,
        /// Short state.
        short_state: ShortState,
        /// Digital lines.
        dio: Dio,
    },
    /// Answer to [`Request::SetStepInc`]; its length is not known, and further bytes are not kept.
    SetStepInc,
    /// State word sent unasked on the module's STATE id.
    State(CubeState),
}

/// Why a frame is not a reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReplyError {
    /// Not a data frame on an ACK or STATE id.
    NotAReply(Id),
    /// No data.
    Empty,
    /// No answer begins with this byte.
    UnknownCommand(u8),
    /// No parameter with this number.
    UnknownParameter(u8),
    /// No motion with this number.
    UnknownMotion(u8),
    /// Length that the answer does not have.
    Length {
        /// Byte 0, `None` for a STATE frame.
        command: Option<Command>,
        /// Bytes seen.
        len: usize,
    },
}

impl fmt::Display for ReplyError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotAReply(id) => write!(f, "{id} is not a data frame from a module"),
            Self::Empty => f.write_str("answer without a command byte"),
            Self::UnknownCommand(code) => write!(f, "answer to unknown command {code:#04X}"),
            Self::UnknownParameter(code) => write!(f, "answer with unknown parameter {code:#04X}"),
            Self::UnknownMotion(code) => write!(f, "answer with unknown motion {code:#04X}"),
            Self::Length { command: Some(command), len } => {
                write!(f, "answer to {} does not have {len} bytes here", command.name())
            }
            Self::Length { command: None, len } => write!(f, "a STATE frame does not have {len} bytes"),
        }
    }
}

impl core::error::Error for ReplyError {}

impl Reply {
    /// The frame from `module`.
    pub fn encode(self, module: ModuleId) -> Frame {
        let id = Channel::Ack.id(module);
        match self {
            Self::Simple(simple) => Frame::from_array(id, [simple.command().code()]),
            Self::Internal([a, b, c, d, e, f, g]) => {
                Frame::from_array(id, [Command::Internal.code(), a, b, c, d, e, f, g])
            }
            Self::Value(parameter, value) => {
                frame_of_value(id, Command::GetParameter.code(), parameter, value)
            }
            Self::SetAck { parameter, code } => {
                let bytes =
                    [Command::SetParameter.code(), parameter.code(), code.unwrap_or(0), 0, 0, 0, 0, 0];
                head(id, bytes, if code.is_some() { 3 } else { 2 })
            }
            Self::MotionAck { kind, code } => {
                // Every kind has a simple form.
                let motion = kind.code(MotionAck::Simple).unwrap_or(0);
                Frame::from_array(id, [Command::SetMotion.code(), motion, code])
            }
            Self::MotionExtended { kind, position, short_state, dio } => {
                // Loops never answer in this form; a made-up one gets the simple number.
                let motion = kind.code(MotionAck::Extended).or(kind.code(MotionAck::Simple)).unwrap_or(0);
                let [a, b, c, d] = match position {
                    MotionPosition::Radians(position) => position.get().to_le_bytes(),
                    MotionPosition::Ticks(ticks) => ticks.to_le_bytes(),
                };
                let bytes = [Command::SetMotion.code(), motion, a, b, c, d, short_state.bits(), dio.0];
                Frame::from_array(id, bytes)
            }
            Self::SetStepInc => Frame::from_array(id, [Command::SetStepInc.code()]),
            Self::State(state) => Frame::from_array(Channel::State.id(module), state.bits().to_le_bytes()),
        }
    }

    /// Understands a frame from a module.
    pub fn decode(frame: &Frame) -> Result<(ModuleId, Self), ReplyError> {
        let data = frame.data();
        match Address::of(frame.id()) {
            Some(Address::Module(Channel::Ack, module)) if !frame.is_remote() => {
                Ok((module, Self::decode_ack(data)?))
            }
            Some(Address::Module(Channel::State, module)) if !frame.is_remote() => match *data {
                [a, b, c, d] => {
                    Ok((module, Self::State(CubeState::from_bits(u32::from_le_bytes([a, b, c, d])))))
                }
                _ => Err(ReplyError::Length { command: None, len: data.len() }),
            },
            _ => Err(ReplyError::NotAReply(frame.id())),
        }
    }

    fn decode_ack(data: &[u8]) -> Result<Self, ReplyError> {
        let code = *data.first().ok_or(ReplyError::Empty)?;
        let command = Command::from_code(code).ok_or(ReplyError::UnknownCommand(code))?;
        let wrong_length = ReplyError::Length { command: Some(command), len: data.len() };
        let parameter = || {
            let code = *data.get(1).ok_or(wrong_length)?;
            Parameter::from_code(code).ok_or(ReplyError::UnknownParameter(code))
        };
        match command {
            Command::GetParameter => {
                let parameter = parameter()?;
                let value = Value::from_wire(parameter.kind(), data, 2).ok_or(wrong_length)?;
                Ok(Self::Value(parameter, value))
            }
            // Tolerant: nothing after the parameter, or more than the one byte, is still an answer.
            Command::SetParameter => Ok(Self::SetAck { parameter: parameter()?, code: data.get(2).copied() }),
            Command::SetMotion => {
                let code = *data.get(1).ok_or(wrong_length)?;
                let (kind, ack) = MotionKind::from_code(code).ok_or(ReplyError::UnknownMotion(code))?;
                match (ack, data) {
                    (MotionAck::Simple, &[_, _, code]) => Ok(Self::MotionAck { kind, code }),
                    (MotionAck::Extended, &[_, _, a, b, c, d, short, dio]) => {
                        let position = if kind.in_ticks() {
                            MotionPosition::Ticks(i32::from_le_bytes([a, b, c, d]))
                        } else {
                            MotionPosition::Radians(Radians::new(f32::from_le_bytes([a, b, c, d])))
                        };
                        let short_state = ShortState::from_bits(short);
                        Ok(Self::MotionExtended { kind, position, short_state, dio: Dio(dio) })
                    }
                    _ => Err(wrong_length),
                }
            }
            Command::SetStepInc => Ok(Self::SetStepInc),
            Command::Internal => match data.len() {
                8 => Ok(Self::Internal(bytes_at(data, 1).ok_or(wrong_length)?)),
                _ => Err(wrong_length),
            },
            Command::SavePosition | Command::StartMotion => Err(ReplyError::UnknownCommand(code)),
            Command::Reset
            | Command::Home
            | Command::Halt
            | Command::ToggleHome
            | Command::Watchdog
            | Command::Recalc
            | Command::SaveParameters
            | Command::ResetClock => match (data.len(), SimpleCommand::of(command)) {
                (1, Some(simple)) => Ok(Self::Simple(simple)),
                _ => Err(wrong_length),
            },
        }
    }

    /// True if this can be the answer to `request`: same command, same parameter or motion, same
    /// form. The protocol has no sequence number; only one such request may be open per module.
    pub fn answers(&self, request: &Request) -> bool {
        match (*self, *request) {
            (Self::Simple(done), Request::Simple(asked)) => done == asked,
            (Self::Internal(_), Request::Internal(_)) | (Self::SetStepInc, Request::SetStepInc { .. }) => {
                true
            }
            (Self::Value(done, _), Request::Get(asked)) => done == asked,
            (Self::SetAck { parameter, .. }, Request::Set(asked, _)) => parameter == asked,
            (Self::MotionAck { kind, .. }, Request::Move(motion)) => {
                motion.ack() == MotionAck::Simple && motion.command().kind() == kind
            }
            (Self::MotionExtended { kind, .. }, Request::Move(motion)) => {
                motion.ack() == MotionAck::Extended && motion.command().kind() == kind
            }
            _ => false,
        }
    }

    /// False if the module reported that it refused a write or motion. True for answers that cannot report this,
    /// and for the missing byte that some hosts tolerate.
    pub fn is_accepted(&self) -> bool {
        match self {
            Self::SetAck { code: Some(code), .. } | Self::MotionAck { code, .. } => *code == ACCEPTED,
            _ => true,
        }
    }
}

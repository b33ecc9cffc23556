//! `uavcan.node.ExecuteCommand.1.3`: order a node to do something now.
//!
//! Version 1.3 is the newest one and what `yakut` 0.14.2 and `pycyphal` 1.27.1 use through their
//! alias `ExecuteCommand_1`. Its request is bit for bit that of 1.1 and 1.2; its response appends
//! `output` to theirs, which an older client cuts off and which reads as empty from an older server.

use super::super::bits::{Decode, DecodeError, Encode, Reader, Writer};
use super::super::id::ServiceId;

/// Fixed service.
pub const SERVICE: ServiceId = ServiceId::from_low_bits(435);
/// Most bytes of a parameter.
pub const PARAMETER_LEN_MAX: usize = 255;
/// Most bytes of an output.
pub const OUTPUT_LEN_MAX: usize = 46;
/// Bytes of a request.
pub const REQUEST_EXTENT: u16 = 2 + 1 + PARAMETER_LEN_MAX as u16;
/// Bytes of a response.
pub const RESPONSE_EXTENT: u16 = 1 + 1 + OUTPUT_LEN_MAX as u16;

/// Numbers of the standard commands.
pub mod standard {
    /// Start the node again.
    pub const RESTART: u16 = 65535;
    /// Switch off.
    pub const POWER_OFF: u16 = 65534;
    /// Fetch a new program by `file.Read`; the parameter is its path.
    pub const BEGIN_SOFTWARE_UPDATE: u16 = 65533;
    /// Forget all settings.
    pub const FACTORY_RESET: u16 = 65532;
    /// Go into a safe state at once and stay there until a restart.
    pub const EMERGENCY_STOP: u16 = 65531;
    /// Write the settings into permanent memory.
    pub const STORE_PERSISTENT_STATES: u16 = 65530;
    /// Blink, beep.
    pub const IDENTIFY: u16 = 65529;
}

/// Outcome of a command; other numbers are not defined by the standard.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Status(pub u8);

impl Status {
    /// Done, or begun.
    pub const SUCCESS: Self = Self(0);
    /// Could not begin, or the wanted end is out of reach.
    pub const FAILURE: Self = Self(1);
    /// The sender may not.
    pub const NOT_AUTHORIZED: Self = Self(2);
    /// The node does not have this command.
    pub const BAD_COMMAND: Self = Self(3);
    /// The parameter does not fit the command.
    pub const BAD_PARAMETER: Self = Self(4);
    /// Not in the present state of the node.
    pub const BAD_STATE: Self = Self(5);
    /// Should have worked.
    pub const INTERNAL_ERROR: Self = Self(6);
}

/// Request of `uavcan.node.ExecuteCommand`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CommandRequest<'a> {
    /// Number of the command.
    pub command: u16,
    /// At most [`PARAMETER_LEN_MAX`] bytes (the rest of a longer one is not sent).
    pub parameter: &'a [u8],
}

/// Response of `uavcan.node.ExecuteCommand`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CommandResponse<'a> {
    /// Outcome.
    pub status: Status,
    /// Output of the command, at most [`OUTPUT_LEN_MAX`] bytes (the rest of a longer one is not sent).
    pub output: &'a [u8],
}

impl Encode for CommandRequest<'_> {
    fn encode(&self, out: &mut Writer<'_>) {
        out.u16(self.command);
        let parameter = self.parameter.get(..PARAMETER_LEN_MAX).unwrap_or(self.parameter);
        out.u8(parameter.len() as u8);
        out.bytes(parameter);
    }
}

impl<'a> Decode<'a> for CommandRequest<'a> {
    fn decode(input: &mut Reader<'a>) -> Result<Self, DecodeError> {
        Ok(Self { command: input.u16(), parameter: input.byte_array(8, PARAMETER_LEN_MAX)? })
    }
}

impl Encode for CommandResponse<'_> {
    fn encode(&self, out: &mut Writer<'_>) {
        out.u8(self.status.0);
        let output = self.output.get(..OUTPUT_LEN_MAX).unwrap_or(self.output);
        out.u8(output.len() as u8);
        out.bytes(output);
    }
}

impl<'a> Decode<'a> for CommandResponse<'a> {
    fn decode(input: &mut Reader<'a>) -> Result<Self, DecodeError> {
        Ok(Self { status: Status(input.u8()), output: input.byte_array(8, OUTPUT_LEN_MAX)? })
    }
}

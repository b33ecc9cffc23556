//! `uavcan.register.Access.1.0` and `List.1.0`: named, typed values of a node.
//!
//! Access writes first (unless the value is empty) and reads afterwards; the answer holds the value after that. An
//! unknown name is answered with an empty value. List returns the name of the register with an index, and an empty
//! name past the last one.

use super::super::bits::{Decode, DecodeError, Encode, Reader, Writer};
use super::super::id::ServiceId;
use super::value::Value;

/// Fixed service of [`AccessRequest`] and [`AccessResponse`].
pub const ACCESS: ServiceId = ServiceId::from_low_bits(384);
/// Fixed service of [`ListRequest`] and [`ListResponse`].
pub const LIST: ServiceId = ServiceId::from_low_bits(385);
/// Most bytes of a register name.
pub const NAME_LEN_MAX: usize = 255;
/// Bytes of an access request.
pub const ACCESS_REQUEST_EXTENT: u16 = 1 + NAME_LEN_MAX as u16 + Value::LEN_MAX as u16;
/// Bytes of an access response.
pub const ACCESS_RESPONSE_EXTENT: u16 = 7 + 1 + Value::LEN_MAX as u16;
/// Bytes of a list request.
pub const LIST_REQUEST_EXTENT: u16 = 2;
/// Bytes of a list response.
pub const LIST_RESPONSE_EXTENT: u16 = 1 + NAME_LEN_MAX as u16;

/// Write (if the value is not empty) and read a register.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AccessRequest<'a> {
    /// Name, at most [`NAME_LEN_MAX`] bytes (the rest of a longer one is not sent).
    pub name: &'a [u8],
    /// Value to write; empty = read only.
    pub value: Value<'a>,
}

/// Present content of the register.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AccessResponse<'a> {
    /// Time of the reading, µs of the network time, 56 bits; 0 = unknown.
    pub timestamp_us: u64,
    /// It can be written.
    pub mutable: bool,
    /// It survives a restart.
    pub persistent: bool,
    /// Its value; empty = no such register.
    pub value: Value<'a>,
}

/// Request for the name of the register with this index.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ListRequest {
    /// From 0 on without gaps.
    pub index: u16,
}

/// Name of a register.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ListResponse<'a> {
    /// Empty past the last register.
    pub name: &'a [u8],
}

fn encode_name(name: &[u8], out: &mut Writer<'_>) {
    let name = name.get(..NAME_LEN_MAX).unwrap_or(name);
    out.u8(name.len() as u8);
    out.bytes(name);
}

impl Encode for AccessRequest<'_> {
    fn encode(&self, out: &mut Writer<'_>) {
        encode_name(self.name, out);
        self.value.encode(out);
    }
}

impl<'a> Decode<'a> for AccessRequest<'a> {
    fn decode(input: &mut Reader<'a>) -> Result<Self, DecodeError> {
        Ok(Self { name: input.byte_array(8, NAME_LEN_MAX)?, value: Value::decode(input)? })
    }
}

impl Encode for AccessResponse<'_> {
    fn encode(&self, out: &mut Writer<'_>) {
        out.uint(self.timestamp_us, 56);
        out.bool(self.mutable);
        out.bool(self.persistent);
        out.void(6);
        self.value.encode(out);
    }
}

impl<'a> Decode<'a> for AccessResponse<'a> {
    fn decode(input: &mut Reader<'a>) -> Result<Self, DecodeError> {
        let timestamp_us = input.uint(56);
        let (mutable, persistent) = (input.bool(), input.bool());
        input.void(6);
        Ok(Self { timestamp_us, mutable, persistent, value: Value::decode(input)? })
    }
}

impl Encode for ListRequest {
    fn encode(&self, out: &mut Writer<'_>) {
        out.u16(self.index);
    }
}

impl Decode<'_> for ListRequest {
    fn decode(input: &mut Reader<'_>) -> Result<Self, DecodeError> {
        Ok(Self { index: input.u16() })
    }
}

impl Encode for ListResponse<'_> {
    fn encode(&self, out: &mut Writer<'_>) {
        encode_name(self.name, out);
    }
}

impl<'a> Decode<'a> for ListResponse<'a> {
    fn decode(input: &mut Reader<'a>) -> Result<Self, DecodeError> {
        Ok(Self { name: input.byte_array(8, NAME_LEN_MAX)? })
    }
}

//! `uavcan.diagnostic.Record.1.1`: a line of text for people.

use super::super::bits::{Decode, DecodeError, Encode, Reader, Writer};
use super::super::id::SubjectId;

/// Fixed subject.
pub const SUBJECT: SubjectId = SubjectId::from_low_bits(8184);
/// Most bytes of text.
pub const TEXT_LEN_MAX: usize = 255;
/// Bytes of the message.
pub const EXTENT: u16 = 7 + 1 + 1 + TEXT_LEN_MAX as u16;

/// How much a record matters, least first (`uavcan.diagnostic.Severity.1.0`).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
#[allow(missing_docs, reason = "the names say it")]
pub enum Severity {
    Trace = 0,
    Debug = 1,
    Info = 2,
    Notice = 3,
    Warning = 4,
    Error = 5,
    Critical = 6,
    Alert = 7,
}

impl Severity {
    const fn from_low_bits(value: u8) -> Self {
        match value & 7 {
            0 => Self::Trace,
            1 => Self::Debug,
            2 => Self::Info,
            3 => Self::Notice,
            4 => Self::Warning,
            5 => Self::Error,
            6 => Self::Critical,
            _ => Self::Alert,
        }
    }
}

/// `uavcan.diagnostic.Record`: a line of text for people.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Record<'a> {
    /// Time of the event, µs of the network time, 56 bits; 0 = unknown.
    pub timestamp_us: u64,
    /// How much it matters.
    pub severity: Severity,
    /// UTF-8, at most [`TEXT_LEN_MAX`] bytes (the rest of a longer text is not sent).
    pub text: &'a [u8],
}

impl Encode for Record<'_> {
    fn encode(&self, out: &mut Writer<'_>) {
        out.uint(self.timestamp_us, 56);
        out.u8(self.severity as u8);
        let text = self.text.get(..TEXT_LEN_MAX).unwrap_or(self.text);
        out.u8(text.len() as u8);
        out.bytes(text);
    }
}

impl<'a> Decode<'a> for Record<'a> {
    fn decode(input: &mut Reader<'a>) -> Result<Self, DecodeError> {
        Ok(Self {
            timestamp_us: input.uint(56),
            severity: Severity::from_low_bits(input.u8()),
            text: input.byte_array(8, TEXT_LEN_MAX)?,
        })
    }
}

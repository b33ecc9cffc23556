//! Typed values of parameters, little endian on the wire.

use core::fmt;

use super::bytes_at;
use super::state::{Dio, ShortState};

/// Type of a parameter on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ValueKind {
    /// IEEE-754 binary32.
    F32,
    /// int32.
    I32,
    /// uint32.
    U32,
    /// int16.
    I16,
    /// uint16.
    U16,
    /// uint8.
    U8,
    /// Position, short state and digital lines: six bytes.
    PosStateDio,
}

impl ValueKind {
    /// Bytes on the wire: 1, 2, 4 or 6.
    pub const fn wire_len(self) -> usize {
        match self {
            Self::F32 | Self::I32 | Self::U32 => 4,
            Self::I16 | Self::U16 => 2,
            Self::U8 => 1,
            Self::PosStateDio => 6,
        }
    }
}

/// Answer to parameter 0x62 and the tail of every extended motion answer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PosStateDio {
    /// Actual position, rad.
    pub position_rad: f32,
    /// Short state.
    pub short_state: ShortState,
    /// Digital lines.
    pub dio: Dio,
}

impl PosStateDio {
    /// Six bytes on the wire.
    pub fn to_bytes(self) -> [u8; 6] {
        let [a, b, c, d] = self.position_rad.to_le_bytes();
        [a, b, c, d, self.short_state.bits(), self.dio.0]
    }

    /// From six bytes on the wire; every bit pattern has a meaning.
    pub fn from_bytes([a, b, c, d, short, dio]: [u8; 6]) -> Self {
        Self {
            position_rad: f32::from_le_bytes([a, b, c, d]),
            short_state: ShortState::from_bits(short),
            dio: Dio(dio),
        }
    }
}

/// A parameter's value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Value {
    /// IEEE-754 binary32.
    F32(f32),
    /// int32.
    I32(i32),
    /// uint32.
    U32(u32),
    /// int16.
    I16(i16),
    /// uint16.
    U16(u16),
    /// uint8.
    U8(u8),
    /// Position, short state and digital lines.
    PosStateDio(PosStateDio),
}

impl Value {
    /// Type of the value.
    pub const fn kind(self) -> ValueKind {
        match self {
            Self::F32(_) => ValueKind::F32,
            Self::I32(_) => ValueKind::I32,
            Self::U32(_) => ValueKind::U32,
            Self::I16(_) => ValueKind::I16,
            Self::U16(_) => ValueKind::U16,
            Self::U8(_) => ValueKind::U8,
            Self::PosStateDio(_) => ValueKind::PosStateDio,
        }
    }

    /// The number as double; `None` for the composite.
    pub fn as_f64(self) -> Option<f64> {
        match self {
            Self::F32(v) => Some(v.into()),
            Self::I32(v) => Some(v.into()),
            Self::U32(v) => Some(v.into()),
            Self::I16(v) => Some(v.into()),
            Self::U16(v) => Some(v.into()),
            Self::U8(v) => Some(v.into()),
            Self::PosStateDio(_) => None,
        }
    }

    /// The six bytes that follow command and parameter; only the first [`ValueKind::wire_len`] are sent.
    pub(super) fn to_wire(self) -> [u8; 6] {
        let four = |[a, b, c, d]: [u8; 4]| [a, b, c, d, 0, 0];
        let two = |[a, b]: [u8; 2]| [a, b, 0, 0, 0, 0];
        match self {
            Self::F32(v) => four(v.to_le_bytes()),
            Self::I32(v) => four(v.to_le_bytes()),
            Self::U32(v) => four(v.to_le_bytes()),
            Self::I16(v) => two(v.to_le_bytes()),
            Self::U16(v) => two(v.to_le_bytes()),
            Self::U8(v) => [v, 0, 0, 0, 0, 0],
            Self::PosStateDio(v) => v.to_bytes(),
        }
    }

    /// Reads a value that starts at byte `at` of `data` and fills the rest; `None` if the length is
    /// not that of the kind.
    pub(super) fn from_wire(kind: ValueKind, data: &[u8], at: usize) -> Option<Self> {
        if data.len().checked_sub(at)? != kind.wire_len() {
            return None;
        }
        Some(match kind {
            ValueKind::F32 => Self::F32(f32::from_le_bytes(bytes_at(data, at)?)),
            ValueKind::I32 => Self::I32(i32::from_le_bytes(bytes_at(data, at)?)),
            ValueKind::U32 => Self::U32(u32::from_le_bytes(bytes_at(data, at)?)),
            ValueKind::I16 => Self::I16(i16::from_le_bytes(bytes_at(data, at)?)),
            ValueKind::U16 => Self::U16(u16::from_le_bytes(bytes_at(data, at)?)),
            ValueKind::U8 => Self::U8(u8::from_le_bytes(bytes_at(data, at)?)),
            ValueKind::PosStateDio => Self::PosStateDio(PosStateDio::from_bytes(bytes_at(data, at)?)),
        })
    }
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::F32(v) => v.fmt(f),
            Self::I32(v) => v.fmt(f),
            Self::U32(v) => v.fmt(f),
            Self::I16(v) => v.fmt(f),
            Self::U16(v) => v.fmt(f),
            Self::U8(v) => v.fmt(f),
            Self::PosStateDio(v) => {
                write!(f, "{} rad, {}, {}", v.position_rad, v.short_state, v.dio)
            }
        }
    }
}

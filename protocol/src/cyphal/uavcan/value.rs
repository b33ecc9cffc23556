//! `uavcan.register.Value.1.0`: the tagged union of everything a register can hold.
//!
//! [`Value`] borrows, [`ValueBuf`] owns. Both keep the elements as they lie on the wire (little
//! endian, bits packed), so any value passes through unchanged, NaN payloads included.

use core::fmt;

use super::super::bits::{Decode, DecodeError, Encode, Reader, Writer, f32_from_f16};

/// What a value is; the numbers are the tags on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum ValueType {
    /// Nothing: "do not write" in a request, "no such register" in an answer.
    Empty = 0,
    /// UTF-8 text.
    String = 1,
    /// Bytes.
    Unstructured = 2,
    /// Truth values, eight to a byte.
    Bit = 3,
    /// Signed numbers of 64 bits; and so on down.
    Integer64 = 4,
    /// `i32`.
    Integer32 = 5,
    /// `i16`.
    Integer16 = 6,
    /// `i8`.
    Integer8 = 7,
    /// `u64`.
    Natural64 = 8,
    /// `u32`.
    Natural32 = 9,
    /// `u16`.
    Natural16 = 10,
    /// `u8`.
    Natural8 = 11,
    /// `f64`.
    Real64 = 12,
    /// `f32`.
    Real32 = 13,
    /// IEEE 754 binary16.
    Real16 = 14,
}

impl ValueType {
    /// Type of a tag.
    pub const fn from_tag(tag: u8) -> Option<Self> {
        Some(match tag {
            0 => Self::Empty,
            1 => Self::String,
            2 => Self::Unstructured,
            3 => Self::Bit,
            4 => Self::Integer64,
            5 => Self::Integer32,
            6 => Self::Integer16,
            7 => Self::Integer8,
            8 => Self::Natural64,
            9 => Self::Natural32,
            10 => Self::Natural16,
            11 => Self::Natural8,
            12 => Self::Real64,
            13 => Self::Real32,
            14 => Self::Real16,
            _ => return None,
        })
    }

    /// Bits of one element: 1, 8, 16, 32 or 64; 0 for [`Self::Empty`].
    pub const fn element_bits(self) -> usize {
        match self {
            Self::Empty => 0,
            Self::Bit => 1,
            Self::String | Self::Unstructured | Self::Integer8 | Self::Natural8 => 8,
            Self::Integer16 | Self::Natural16 | Self::Real16 => 16,
            Self::Integer32 | Self::Natural32 | Self::Real32 => 32,
            Self::Integer64 | Self::Natural64 | Self::Real64 => 64,
        }
    }

    /// Most elements: every array type ends at 256 bytes.
    pub const fn capacity(self) -> usize {
        match self.element_bits() {
            0 => 0,
            bits => 8 * DATA_LEN_MAX / bits,
        }
    }

    /// Bits of the length prefix: 16 where more than 255 elements fit.
    const fn prefix_bits(self) -> u32 {
        if self.element_bits() <= 8 { 16 } else { 8 }
    }
}

/// Most bytes of elements.
pub const DATA_LEN_MAX: usize = 256;

/// A value that borrows its elements.
#[derive(Clone, Copy)]
pub struct Value<'a> {
    kind: ValueType,
    count: usize,
    /// Exactly the bytes of `count` elements; unused bits of the last one mean nothing.
    bytes: &'a [u8],
}

/// Bit for bit, so NaN equals the same NaN.
impl PartialEq for Value<'_> {
    fn eq(&self, other: &Self) -> bool {
        self.kind == other.kind
            && self.count == other.count
            && (0..self.count).all(|index| self.element(index) == other.element(index))
    }
}

impl Eq for Value<'_> {}

/// More elements than the type holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ValueTooLong {
    /// Elements given.
    pub len: usize,
    /// Most elements of the type.
    pub capacity: usize,
}

impl fmt::Display for ValueTooLong {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} elements, a register value holds {}", self.len, self.capacity)
    }
}

impl core::error::Error for ValueTooLong {}

impl<'a> Value<'a> {
    /// Most bytes on the wire: tag, length, elements.
    pub const LEN_MAX: usize = 1 + 2 + DATA_LEN_MAX;
    /// The value that holds nothing.
    pub const EMPTY: Value<'static> = Value { kind: ValueType::Empty, count: 0, bytes: &[] };

    /// Text.
    pub const fn string(text: &'a str) -> Result<Self, ValueTooLong> {
        Self::raw(ValueType::String, text.as_bytes())
    }

    /// Bytes.
    pub const fn unstructured(bytes: &'a [u8]) -> Result<Self, ValueTooLong> {
        Self::raw(ValueType::Unstructured, bytes)
    }

    const fn raw(kind: ValueType, bytes: &'a [u8]) -> Result<Self, ValueTooLong> {
        if bytes.len() <= DATA_LEN_MAX {
            Ok(Self { kind, count: bytes.len(), bytes })
        } else {
            Err(ValueTooLong { len: bytes.len(), capacity: DATA_LEN_MAX })
        }
    }

    /// What it is.
    pub const fn kind(&self) -> ValueType {
        self.kind
    }

    /// Number of elements: bytes for text and bytes, bits for truth values.
    pub const fn len(&self) -> usize {
        self.count
    }

    /// True for no elements; also for a value of an array type of length zero.
    pub const fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// The elements as they lie on the wire.
    pub const fn bytes(&self) -> &'a [u8] {
        self.bytes
    }

    /// The text, if it is a string of valid UTF-8.
    pub fn text(&self) -> Option<&'a str> {
        match self.kind {
            ValueType::String => core::str::from_utf8(self.bytes).ok(),
            _ => None,
        }
    }

    /// Raw bits of element `index`; `None` past the end.
    fn element(&self, index: usize) -> Option<u64> {
        if index >= self.count {
            return None;
        }
        let bits = self.kind.element_bits();
        let mut input = Reader::new(self.bytes.get(index * bits / 8..)?);
        input.void((index * bits % 8) as u32);
        Some(input.uint(bits as u32))
    }

    /// Truth value `index` of a bit array.
    pub fn bool(&self, index: usize) -> Option<bool> {
        match self.kind {
            ValueType::Bit => Some(self.element(index)? != 0),
            _ => None,
        }
    }

    /// Element `index` of a natural, or of an integer that is not negative.
    pub fn u64(&self, index: usize) -> Option<u64> {
        match self.kind {
            ValueType::Natural64 | ValueType::Natural32 | ValueType::Natural16 | ValueType::Natural8 => {
                self.element(index)
            }
            _ => u64::try_from(self.i64(index)?).ok(),
        }
    }

    /// Element `index` of an integer, or of a natural below 2^63.
    pub fn i64(&self, index: usize) -> Option<i64> {
        let bits = self.element(index)?;
        Some(match self.kind {
            ValueType::Integer64 => bits as i64,
            ValueType::Integer32 => i64::from(bits as i32),
            ValueType::Integer16 => i64::from(bits as i16),
            ValueType::Integer8 => i64::from(bits as i8),
            ValueType::Natural64 | ValueType::Natural32 | ValueType::Natural16 | ValueType::Natural8 => {
                i64::try_from(bits).ok()?
            }
            _ => return None,
        })
    }

    /// Element `index` of a real: exact for 16 and 32 bits, nearest for 64.
    pub fn f32(&self, index: usize) -> Option<f32> {
        let bits = self.element(index)?;
        Some(match self.kind {
            ValueType::Real64 => f64::from_bits(bits) as f32,
            ValueType::Real32 => f32::from_bits(bits as u32),
            ValueType::Real16 => f32_from_f16(bits as u16),
            _ => return None,
        })
    }

    /// Element `index` of a real of any width, exact.
    pub fn f64(&self, index: usize) -> Option<f64> {
        match self.kind {
            ValueType::Real64 => Some(f64::from_bits(self.element(index)?)),
            _ => self.f32(index).map(f64::from),
        }
    }
}

impl Encode for Value<'_> {
    fn encode(&self, out: &mut Writer<'_>) {
        out.u8(self.kind as u8);
        if self.kind != ValueType::Empty {
            out.uint(self.count as u64, self.kind.prefix_bits());
            let (whole, odd) = (self.count * self.kind.element_bits() / 8, self.count % 8);
            out.bytes(self.bytes.get(..whole).unwrap_or(&[]));
            if self.kind == ValueType::Bit {
                out.uint(u64::from(self.bytes.get(whole).copied().unwrap_or(0)), odd as u32);
            }
        }
    }
}

impl<'a> Decode<'a> for Value<'a> {
    fn decode(input: &mut Reader<'a>) -> Result<Self, DecodeError> {
        let tag = input.u8();
        let kind = ValueType::from_tag(tag).ok_or(DecodeError::UnknownTag(tag))?;
        if kind == ValueType::Empty {
            return Ok(Self::EMPTY);
        }
        let count = input.array_len(kind.prefix_bits(), kind.capacity())?;
        let bits = count * kind.element_bits();
        let bytes = input.bytes(bits.div_ceil(8))?;
        Ok(Self { kind, count, bytes })
    }
}

impl fmt::Debug for Value<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}({self})", self.kind)
    }
}

/// Elements separated by blanks; text as it is; bytes in hexadecimal; `(empty)`.
impl fmt::Display for Value<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.kind == ValueType::Empty {
            return f.write_str("(empty)");
        }
        if let Some(text) = self.text() {
            return f.write_str(text);
        }
        for index in 0..self.count {
            if index > 0 {
                f.write_str(" ")?;
            }
            if let Some(value) = self.i64(index) {
                value.fmt(f)?;
            } else if let Some(value) = self.u64(index) {
                value.fmt(f)?;
            } else if let Some(value) = self.f64(index) {
                value.fmt(f)?;
            } else if let Some(value) = self.bool(index) {
                u8::from(value).fmt(f)?;
            } else if let Some(byte) = self.element(index) {
                write!(f, "{byte:02X}")?;
            }
        }
        Ok(())
    }
}

/// A value that owns its elements: 260 bytes.
#[derive(Clone)]
pub struct ValueBuf {
    kind: ValueType,
    count: u16,
    bytes: [u8; DATA_LEN_MAX],
}

impl ValueBuf {
    /// The value that holds nothing.
    pub const EMPTY: Self = Self { kind: ValueType::Empty, count: 0, bytes: [0; DATA_LEN_MAX] };

    /// Borrows it.
    pub fn as_value(&self) -> Value<'_> {
        let count = usize::from(self.count);
        let len = (count * self.kind.element_bits()).div_ceil(8);
        Value { kind: self.kind, count, bytes: self.bytes.get(..len).unwrap_or(&[]) }
    }

    /// Truth values.
    pub fn bits(values: &[bool]) -> Result<Self, ValueTooLong> {
        let mut this = Self::sized(ValueType::Bit, values.len())?;
        let mut out = Writer::new(&mut this.bytes);
        for value in values {
            out.bool(*value);
        }
        Ok(this)
    }

    fn single(kind: ValueType, bytes: &[u8]) -> Self {
        Value { kind, count: 1, bytes }.into()
    }

    fn sized(kind: ValueType, len: usize) -> Result<Self, ValueTooLong> {
        if len <= kind.capacity() {
            Ok(Self { kind, count: len as u16, bytes: [0; DATA_LEN_MAX] })
        } else {
            Err(ValueTooLong { len, capacity: kind.capacity() })
        }
    }
}

impl From<Value<'_>> for ValueBuf {
    fn from(value: Value<'_>) -> Self {
        let mut this = Self { kind: value.kind, count: value.count as u16, ..Self::EMPTY };
        for (to, from) in this.bytes.iter_mut().zip(value.bytes) {
            *to = *from;
        }
        this
    }
}

impl PartialEq for ValueBuf {
    fn eq(&self, other: &Self) -> bool {
        self.as_value() == other.as_value()
    }
}

impl fmt::Debug for ValueBuf {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.as_value().fmt(f)
    }
}

macro_rules! numbers {
    ($($repr:ty => $kind:ident,)*) => {$(
        impl TryFrom<&[$repr]> for ValueBuf {
            type Error = ValueTooLong;
            fn try_from(values: &[$repr]) -> Result<Self, ValueTooLong> {
                let mut this = Self::sized(ValueType::$kind, values.len())?;
                let bytes = values.iter().flat_map(|value| value.to_le_bytes());
                for (to, from) in this.bytes.iter_mut().zip(bytes) {
                    *to = from;
                }
                Ok(this)
            }
        }

        /// One element.
        impl From<$repr> for ValueBuf {
            fn from(value: $repr) -> Self {
                Self::single(ValueType::$kind, &value.to_le_bytes())
            }
        }
    )*};
}

numbers! {
    i64 => Integer64,
    i32 => Integer32,
    i16 => Integer16,
    i8 => Integer8,
    u64 => Natural64,
    u32 => Natural32,
    u16 => Natural16,
    u8 => Natural8,
    f64 => Real64,
    f32 => Real32,
}

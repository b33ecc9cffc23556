//! Bits to bytes and back: the serialisation rules of DSDL, one cursor each way.
//!
//! Little-endian, least significant bit first, no padding other than what a type declares (Cyphal
//! specification v1.0, section 3.7). Two rules make old and new readers understand each other:
//!
//! * *implicit zero extension*: what lies past the end of the data reads as zero;
//! * *implicit truncation*: bytes after the last known field are ignored.
//!
//! Numbers follow the first rule here. Byte arrays are borrowed from the data and cannot be
//! extended, so a cut one is [`DecodeError::ArrayCut`]; the [receiver](super::rx::Receiver) appends
//! zeros up to the extent of the port, which makes the rule hold in full for everything that comes
//! from the bus.

use core::fmt;

/// Why bytes are not a value of the expected type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DecodeError {
    /// The length prefix of an array is above the capacity of its type.
    ArrayTooLong {
        /// Elements announced.
        len: u32,
        /// Most elements the type allows.
        capacity: u32,
    },
    /// The data ends before the array does.
    ArrayCut {
        /// Bytes the array needs.
        needed: usize,
        /// Bytes that are there.
        present: usize,
    },
    /// A union tag that the type does not define.
    UnknownTag(u8),
    /// A delimiter header announces more bytes than follow.
    DelimiterTooLong {
        /// Bytes announced.
        len: u32,
        /// Bytes that follow.
        present: usize,
    },
    /// A number that the type does not define.
    UnknownValue(u32),
}

impl fmt::Display for DecodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::ArrayTooLong { len, capacity } => {
                write!(f, "array of {len} elements, its type holds {capacity}")
            }
            Self::ArrayCut { needed, present } => write!(f, "array of {needed} bytes cut after {present}"),
            Self::UnknownTag(tag) => write!(f, "union tag {tag} is not defined"),
            Self::DelimiterTooLong { len, present } => {
                write!(f, "delimiter header says {len} bytes, {present} follow")
            }
            Self::UnknownValue(value) => write!(f, "value {value} is not defined"),
        }
    }
}

impl core::error::Error for DecodeError {}

/// The buffer cannot hold the serialised value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BufferTooSmall {
    /// Bytes the value needs.
    pub needed: usize,
    /// Bytes the buffer has.
    pub available: usize,
}

impl fmt::Display for BufferTooSmall {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} bytes needed, {} available", self.needed, self.available)
    }
}

impl core::error::Error for BufferTooSmall {}

/// A value that can be serialised.
pub trait Encode {
    /// Appends the fields; a full buffer is noticed by [`Writer::finish`].
    fn encode(&self, out: &mut Writer<'_>);

    /// Serialises into the head of `buffer` and returns the number of bytes.
    fn to_bytes(&self, buffer: &mut [u8]) -> Result<usize, BufferTooSmall>
    where
        Self: Sized,
    {
        to_bytes(self, buffer)
    }
}

/// [`Encode::to_bytes`] of any value: one copy of the code for all types.
#[inline(never)]
pub fn to_bytes(value: &dyn Encode, buffer: &mut [u8]) -> Result<usize, BufferTooSmall> {
    let mut out = Writer::new(buffer);
    value.encode(&mut out);
    out.finish()
}

/// A value that can be read back; arrays borrow from the data.
pub trait Decode<'a>: Sized {
    /// Takes the fields from the cursor.
    fn decode(input: &mut Reader<'a>) -> Result<Self, DecodeError>;

    /// Reads a value from the head of `data`; the rest is ignored (implicit truncation).
    fn from_bytes(data: &'a [u8]) -> Result<Self, DecodeError> {
        Self::decode(&mut Reader::new(data))
    }
}

/// Empty request or response: no bytes.
impl Encode for () {
    fn encode(&self, _: &mut Writer<'_>) {}
}

impl Decode<'_> for () {
    fn decode(_: &mut Reader<'_>) -> Result<Self, DecodeError> {
        Ok(())
    }
}

/// Cursor that writes bit fields into a byte buffer.
///
/// Writing past the end does not fail at once; [`Writer::finish`] returns the size that was needed.
#[derive(Debug)]
pub struct Writer<'a> {
    out: &'a mut [u8],
    bit: usize,
}

impl<'a> Writer<'a> {
    /// Starts at the first bit of `out`; old contents of the buffer do not matter.
    pub fn new(out: &'a mut [u8]) -> Self {
        Self { out, bit: 0 }
    }

    /// The low `bits` (0..=64) of `value`, least significant first.
    #[inline(never)]
    pub fn uint(&mut self, mut value: u64, bits: u32) {
        let mut left = bits.min(64);
        while left > 0 {
            let offset = (self.bit & 7) as u32;
            let take = (8 - offset).min(left);
            let chunk = (value as u8) & (0xFF >> (8 - take));
            if let Some(byte) = self.out.get_mut(self.bit >> 3) {
                *byte = if offset == 0 { chunk } else { *byte | chunk << offset };
            }
            value >>= take;
            left -= take;
            self.bit += take as usize;
        }
    }

    /// One bit.
    pub fn bool(&mut self, value: bool) {
        self.uint(u64::from(value), 1);
    }

    /// Eight bits.
    pub fn u8(&mut self, value: u8) {
        self.uint(u64::from(value), 8);
    }

    /// Sixteen bits.
    pub fn u16(&mut self, value: u16) {
        self.uint(u64::from(value), 16);
    }

    /// Thirty-two bits.
    pub fn u32(&mut self, value: u32) {
        self.uint(u64::from(value), 32);
    }

    /// Sixty-four bits.
    pub fn u64(&mut self, value: u64) {
        self.uint(value, 64);
    }

    /// 56 low bits of an unsigned number.
    pub fn u56(&mut self, value: u64) {
        self.uint(value, 56);
    }

    /// 24-bit signed integer, saturated.
    pub fn i24(&mut self, value: i32) {
        self.uint(u64::from(value.clamp(I24_MIN, I24_MAX) as u32), 24);
    }

    /// IEEE 754 binary32.
    pub fn f32(&mut self, value: f32) {
        self.u32(value.to_bits());
    }

    /// IEEE 754 binary16, rounded to nearest, ties to even; finite values beyond ±65504 saturate
    /// (DSDL cast mode *saturated*), infinities and NaN stay.
    pub fn f16(&mut self, value: f32) {
        self.u16(f16_from_f32(value));
    }

    /// `bits` (0..=64) zeros: DSDL `void`.
    pub fn void(&mut self, bits: u32) {
        self.uint(0, bits);
    }

    /// Whole bytes; the cursor is rounded up to a byte boundary first.
    #[inline(never)]
    pub fn bytes(&mut self, data: &[u8]) {
        let start = (self.bit + 7) >> 3;
        if let Some(room) = self.out.get_mut(start..) {
            for (to, from) in room.iter_mut().zip(data) {
                *to = *from;
            }
        }
        self.bit = (start + data.len()) << 3;
    }

    /// Array of bytes with a fixed length: no prefix.
    pub fn array<const N: usize>(&mut self, data: [u8; N]) {
        for byte in data {
            self.u8(byte);
        }
    }

    /// Bytes written so far, a started one included; may be above the buffer's length.
    pub fn len(&self) -> usize {
        (self.bit + 7) >> 3
    }

    /// True before the first field.
    pub fn is_empty(&self) -> bool {
        self.bit == 0
    }

    /// Leaves room for the 32-bit delimiter header of a nested extensible type; returns the mark
    /// that [`Self::close_delimiter`] needs.
    pub fn open_delimiter(&mut self) -> usize {
        let mark = self.len();
        self.u32(0);
        mark
    }

    /// Writes into the header at `mark` how many bytes followed it.
    pub fn close_delimiter(&mut self, mark: usize) {
        let len = self.len().saturating_sub(mark + 4) as u32;
        for (i, byte) in len.to_le_bytes().into_iter().enumerate() {
            if let Some(to) = self.out.get_mut(mark + i) {
                *to = byte;
            }
        }
    }

    /// Leaves room for an 8-bit array length that is not known yet; returns the mark that
    /// [`Self::close_count`] needs.
    pub fn open_count(&mut self) -> usize {
        let mark = self.len();
        self.u8(0);
        mark
    }

    /// Writes the array length at `mark`.
    pub fn close_count(&mut self, mark: usize, count: u8) {
        if let Some(to) = self.out.get_mut(mark) {
            *to = count;
        }
    }

    /// Number of bytes used, the last one filled up with zero bits.
    pub fn finish(self) -> Result<usize, BufferTooSmall> {
        let needed = self.len();
        if needed <= self.out.len() {
            Ok(needed)
        } else {
            Err(BufferTooSmall { needed, available: self.out.len() })
        }
    }
}

/// Cursor that reads bit fields from bytes.
#[derive(Clone, Debug)]
pub struct Reader<'a> {
    data: &'a [u8],
    bit: usize,
}

impl<'a> Reader<'a> {
    /// Starts at the first bit of `data`.
    pub fn new(data: &'a [u8]) -> Self {
        Self { data, bit: 0 }
    }

    /// Unsigned number of `bits` (0..=64); bits past the end are zero.
    #[inline(never)]
    pub fn uint(&mut self, bits: u32) -> u64 {
        let bits = bits.min(64);
        let mut value = 0;
        let mut done = 0;
        while done < bits {
            let offset = (self.bit & 7) as u32;
            let take = (8 - offset).min(bits - done);
            let byte = self.data.get(self.bit >> 3).copied().unwrap_or(0);
            let chunk = (byte >> offset) & (0xFF >> (8 - take));
            value |= u64::from(chunk) << done;
            done += take;
            self.bit = self.bit.saturating_add(take as usize);
        }
        value
    }

    /// One bit.
    pub fn bool(&mut self) -> bool {
        self.uint(1) != 0
    }

    /// Eight bits.
    pub fn u8(&mut self) -> u8 {
        self.uint(8) as u8
    }

    /// Sixteen bits.
    pub fn u16(&mut self) -> u16 {
        self.uint(16) as u16
    }

    /// Thirty-two bits.
    pub fn u32(&mut self) -> u32 {
        self.uint(32) as u32
    }

    /// Sixty-four bits.
    pub fn u64(&mut self) -> u64 {
        self.uint(64)
    }

    /// 56-bit unsigned number.
    pub fn u56(&mut self) -> u64 {
        self.uint(56)
    }

    /// 24-bit signed integer.
    pub fn i24(&mut self) -> i32 {
        // Moved up and back, so that the sign fills the upper bits.
        ((self.uint(24) as u32) << 8).cast_signed() >> 8
    }

    /// IEEE 754 binary32.
    pub fn f32(&mut self) -> f32 {
        f32::from_bits(self.u32())
    }

    /// IEEE 754 binary16; every value of it is exact in `f32`.
    pub fn f16(&mut self) -> f32 {
        f32_from_f16(self.u16())
    }

    /// Skips a DSDL `void`, whatever it holds.
    pub fn void(&mut self, bits: u32) {
        self.bit = self.bit.saturating_add(bits as usize);
    }

    /// The next `len` whole bytes; the cursor is rounded up to a byte boundary first.
    pub fn bytes(&mut self, len: usize) -> Result<&'a [u8], DecodeError> {
        let rest = self.rest();
        let data = rest.get(..len).ok_or(DecodeError::ArrayCut { needed: len, present: rest.len() })?;
        self.bit = (self.data.len() - rest.len() + len) << 3;
        Ok(data)
    }

    /// Array of bytes with a fixed length; missing bytes read as zero, as the standard requires.
    pub fn array<const N: usize>(&mut self) -> [u8; N] {
        let mut data = [0; N];
        for byte in &mut data {
            *byte = self.u8();
        }
        data
    }

    /// Byte array with a length prefix of `prefix_bits` and at most `capacity` bytes.
    pub fn byte_array(&mut self, prefix_bits: u32, capacity: usize) -> Result<&'a [u8], DecodeError> {
        let len = self.array_len(prefix_bits, capacity)?;
        self.bytes(len)
    }

    /// Length prefix of an array of at most `capacity` elements.
    pub fn array_len(&mut self, prefix_bits: u32, capacity: usize) -> Result<usize, DecodeError> {
        let len = self.uint(prefix_bits) as usize;
        if len <= capacity {
            Ok(len)
        } else {
            Err(DecodeError::ArrayTooLong { len: len as u32, capacity: capacity as u32 })
        }
    }

    /// Cursor over a nested extensible type: its delimiter header is read here, and the outer cursor moves past the
    /// nested type independently of the nested reader (section 3.7, delimiter header).
    pub fn delimited(&mut self) -> Result<Self, DecodeError> {
        let len = self.u32();
        let present = self.rest().len();
        match self.bytes(len as usize) {
            Ok(data) => Ok(Self::new(data)),
            Err(_) => Err(DecodeError::DelimiterTooLong { len, present }),
        }
    }

    /// Whole bytes not read yet.
    pub fn rest(&self) -> &'a [u8] {
        let start = self.bit.saturating_add(7) >> 3;
        self.data.get(start..).unwrap_or(&[])
    }
}

/// Largest finite binary16.
/// Range of a 24-bit signed integer.
const I24_MIN: i32 = -(1 << 23);
const I24_MAX: i32 = (1 << 23) - 1;

const F16_MAX: u16 = 0x7BFF;

/// binary32 to binary16: nearest, ties to even; finite overflow saturates to ±65504.
pub fn f16_from_f32(value: f32) -> u16 {
    let bits = value.to_bits();
    let sign = (bits >> 16) as u16 & 0x8000;
    let magnitude = bits & 0x7FFF_FFFF;
    let half = match magnitude {
        // NaN: quiet bit set, so that dropping low payload bits cannot turn it into an infinity.
        0x7F80_0001.. => 0x7E00 | (magnitude >> 13) as u16 & 0x03FF,
        0x7F80_0000 => 0x7C00,
        // From 65520 on, rounding would give an infinity.
        0x477F_F000.. => F16_MAX,
        // Normal binary16 numbers, from 2^-14: rebias the exponent by 15 - 127 and round.
        0x3880_0000.. => {
            let round = 0xFFF + (magnitude >> 13 & 1);
            ((magnitude + round - 0x3800_0000) >> 13) as u16
        }
        // Subnormal: one unit is 2^-24, as is the last place of a number in [0.5, 1), so an
        // addition to 0.5 rounds to that place.
        _ => (f32::from_bits(magnitude) + 0.5).to_bits().wrapping_sub(0.5_f32.to_bits()) as u16,
    };
    sign | half
}

/// binary16 to binary32, exact.
pub fn f32_from_f16(half: u16) -> f32 {
    let sign = u32::from(half & 0x8000) << 16;
    let magnitude = u32::from(half & 0x7FFF) << 13;
    let bits = match half & 0x7C00 {
        0x7C00 => 0x7F80_0000 | magnitude,
        // Zero and subnormals: the fraction counts units of 2^-24.
        0 => (f32::from(half & 0x03FF) * f32::from_bits(0x3380_0000)).to_bits(),
        _ => magnitude + 0x3800_0000,
    };
    f32::from_bits(sign | bits)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn bit_fields_fill_bytes_from_the_least_significant_bit() {
        let mut buffer = [0xFF; 4];
        let mut out = Writer::new(&mut buffer);
        out.uint(0b1, 1);
        out.uint(0b010, 3);
        out.uint(0xABC, 12);
        out.uint(0b11, 2);
        assert_eq!(out.finish(), Ok(3));
        assert_eq!(buffer, [0b1100_0101, 0xAB, 0b11, 0xFF]);
    }

    #[test]
    fn data_past_the_end_reads_as_zero() {
        let mut input = Reader::new(&[0xFF]);
        assert_eq!(input.u16(), 0x00FF);
        assert_eq!(input.u32(), 0);
        assert_eq!(input.rest(), &[] as &[u8]);
        assert_eq!(input.bytes(1), Err(DecodeError::ArrayCut { needed: 1, present: 0 }));
    }

    #[test]
    fn overflow_is_reported_with_the_size_that_is_needed() {
        let mut buffer = [0; 2];
        let mut out = Writer::new(&mut buffer);
        out.u32(1);
        out.bytes(&[1, 2, 3]);
        assert_eq!(out.finish(), Err(BufferTooSmall { needed: 7, available: 2 }));
    }

    #[test]
    fn delimiter_header_longer_than_the_data_is_refused() {
        let mut input = Reader::new(&[3, 0, 0, 0, 9, 9]);
        assert_eq!(input.delimited().unwrap_err(), DecodeError::DelimiterTooLong { len: 3, present: 2 });
        let mut input = Reader::new(&[0xFF, 0xFF, 0xFF, 0xFF, 9]);
        assert!(input.delimited().is_err());
    }

    #[test]
    fn every_binary16_survives_the_way_through_binary32() {
        for half in 0..=u16::MAX {
            let wide = f32_from_f16(half);
            let back = f16_from_f32(wide);
            if wide.is_nan() {
                assert_eq!(back, half | 0x0200, "{half:04X}");
            } else {
                assert_eq!(back, half, "{half:04X}");
            }
        }
    }

    #[test]
    fn binary16_rounds_to_nearest_even_and_saturates() {
        // IEEE 754 table values.
        for (value, half) in [
            (0.0, 0x0000),
            (-0.0, 0x8000),
            (1.0, 0x3C00),
            (-2.0, 0xC000),
            (65504.0, 0x7BFF),
            (65519.9, 0x7BFF),
            (1e9, 0x7BFF),
            (-1e9, 0xFBFF),
            (f32::INFINITY, 0x7C00),
            (5.960_464_5e-8, 0x0001),
            (2.980_232_2e-8, 0x0000),
            (2.980_233e-8, 0x0001),
            (6.097_555e-5, 0x03FF),
            (6.103_515_6e-5, 0x0400),
            (1.000_488_3, 0x3C00),
            (1.001_464_8, 0x3C02),
            (f32::from_bits(1), 0x0000),
        ] {
            assert_eq!(f16_from_f32(value), half, "{value}");
        }
    }

    proptest! {
        #[test]
        fn fields_of_any_width_come_back(fields in proptest::collection::vec((any::<u64>(), 0_u32..=64), 0..20)) {
            let mut buffer = [0xAA; 200];
            let mut out = Writer::new(&mut buffer);
            for (value, bits) in &fields {
                out.uint(*value, *bits);
            }
            let len = out.finish().unwrap();
            let mut input = Reader::new(&buffer[..len]);
            for (value, bits) in &fields {
                let mask = if *bits == 64 { u64::MAX } else { (1 << bits) - 1 };
                prop_assert_eq!(input.uint(*bits), value & mask);
            }
        }

        #[test]
        fn binary16_is_the_nearest_of_its_neighbours(value in -70000.0_f32..70000.0) {
            let half = f16_from_f32(value);
            let error = (f64::from(f32_from_f16(half)) - f64::from(value)).abs();
            for other in [half.wrapping_sub(1), half + 1] {
                let other = f32_from_f16(other);
                if other.is_finite() {
                    prop_assert!(error <= (f64::from(other) - f64::from(value)).abs());
                }
            }
        }
    }
}

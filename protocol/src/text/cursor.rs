//! Reading position in a line, and the error that names it.

use core::fmt;

use crate::frame::{CAPACITY, FdFlags, Frame, MAX_DATA_LEN};
use crate::id::{ExtendedId, Id, StandardId};
use crate::time::Instant;

/// What a decoder wanted to see at the position where it gave up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Expected {
    /// This very byte.
    Byte(u8),
    /// One or more blanks.
    Blank,
    /// A decimal digit.
    Digit,
    /// Seconds that fit 64 bits of microseconds.
    Seconds,
    /// A hexadecimal digit.
    HexDigit,
    /// An 11-bit id, at most 7FF.
    StandardId,
    /// A 29-bit id, at most 1FFFFFFF.
    ExtendedId,
    /// An id of three or eight hexadecimal digits.
    Id,
    /// A data length code, 0 to 8.
    Dlc,
    /// A whole data byte: two hexadecimal digits.
    DataByte,
    /// No more data bytes: a classical CAN frame holds eight.
    AtMostEightBytes,
    /// A length of CAN FD.
    FdLength,
    /// As many data bytes as the length code says.
    BytesOfDlc(u8),
    /// The name of a bus.
    BusName,
    /// A command word.
    Verb,
    /// A value of a command, in its own range.
    Value,
    /// `T` (sent) or `R` (received).
    Direction,
    /// Nothing: the line should end here.
    End,
}

impl fmt::Display for Expected {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Byte(byte) => return write!(f, "'{}'", byte.escape_ascii()),
            Self::BytesOfDlc(dlc) => return write!(f, "{dlc} data bytes as the length code says"),
            Self::Blank => "a blank",
            Self::Digit => "a decimal digit",
            Self::Seconds => "seconds below 18446744073710",
            Self::HexDigit => "a hexadecimal digit",
            Self::StandardId => "an 11-bit id of at most 7FF",
            Self::ExtendedId => "a 29-bit id of at most 1FFFFFFF",
            Self::Id => "an id of three or eight hexadecimal digits",
            Self::Dlc => "a data length of 0 to 8",
            Self::DataByte => "a data byte of two hexadecimal digits",
            Self::AtMostEightBytes => "no more than eight data bytes",
            Self::FdLength => "0 to 8, 12, 16, 20, 24, 32, 48 or 64 data bytes of a CAN FD frame",
            Self::BusName => "a bus name of 1 to 16 visible characters",
            Self::Verb => "a command",
            Self::Value => "a value in the range of the command",
            Self::Direction => "T or R",
            Self::End => "the end",
        })
    }
}

/// A line that does not follow its grammar: where, what was expected, what was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SyntaxError {
    /// Position in the line, in bytes, counted from 1. Of a value out of range: its first digit.
    pub column: usize,
    /// What the grammar asks for at this position.
    pub expected: Expected,
    /// The byte found there; `None` at the end of the line.
    pub found: Option<u8>,
}

impl fmt::Display for SyntaxError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "column {}: expected {}, found ", self.column, self.expected)?;
        match self.found {
            Some(byte) => write!(f, "'{}'", byte.escape_ascii()),
            None => f.write_str("the end"),
        }
    }
}

impl core::error::Error for SyntaxError {}

/// Reads a line from left to right. Every method that fails leaves the position at the offending byte.
#[derive(Clone, Copy)]
pub(crate) struct Cursor<'a> {
    line: &'a [u8],
    at: usize,
}

impl<'a> Cursor<'a> {
    pub(crate) const fn new(line: &'a [u8]) -> Self {
        Self { line, at: 0 }
    }

    pub(crate) const fn position(&self) -> usize {
        self.at
    }

    pub(crate) fn peek(&self) -> Option<u8> {
        self.line.get(self.at).copied()
    }

    /// Moves on by one byte; callers have peeked at it.
    pub(crate) fn advance(&mut self) {
        self.at = self.at.saturating_add(1).min(self.line.len());
    }

    pub(crate) fn error(&self, expected: Expected) -> SyntaxError {
        self.error_at(self.at, expected)
    }

    pub(crate) fn error_at(&self, at: usize, expected: Expected) -> SyntaxError {
        SyntaxError { column: at.saturating_add(1), expected, found: self.line.get(at).copied() }
    }

    pub(crate) fn eat(&mut self, byte: u8) -> bool {
        let found = self.peek() == Some(byte);
        if found {
            self.advance();
        }
        found
    }

    pub(crate) fn expect(&mut self, byte: u8) -> Result<(), SyntaxError> {
        if self.eat(byte) { Ok(()) } else { Err(self.error(Expected::Byte(byte))) }
    }

    pub(crate) fn skip_blanks(&mut self) -> bool {
        let start = self.at;
        while matches!(self.peek(), Some(b' ' | b'\t')) {
            self.advance();
        }
        self.at > start
    }

    pub(crate) fn blanks(&mut self) -> Result<(), SyntaxError> {
        if self.skip_blanks() { Ok(()) } else { Err(self.error(Expected::Blank)) }
    }

    /// Trailing blanks and line ends, then nothing.
    pub(crate) fn end(&mut self) -> Result<(), SyntaxError> {
        while matches!(self.peek(), Some(b' ' | b'\t' | b'\r' | b'\n')) {
            self.advance();
        }
        if self.peek().is_none() { Ok(()) } else { Err(self.error(Expected::End)) }
    }

    /// The bytes up to the next blank, `stop` or line end; may be empty.
    pub(crate) fn word(&mut self, stop: u8) -> &'a [u8] {
        let start = self.at;
        while let Some(byte) = self.peek() {
            if byte == stop || !byte.is_ascii_graphic() {
                break;
            }
            self.advance();
        }
        self.line.get(start..self.at).unwrap_or(&[])
    }

    /// The bytes from `start` up to the position.
    pub(crate) fn since(&self, start: usize) -> &'a [u8] {
        self.line.get(start..self.at).unwrap_or(&[])
    }

    pub(crate) fn hex_digit(&mut self) -> Result<u8, SyntaxError> {
        match self.peek().and_then(hex_value) {
            Some(value) => {
                self.advance();
                Ok(value)
            }
            None => Err(self.error(Expected::HexDigit)),
        }
    }

    /// A run of one to eight hexadecimal digits: value and number of digits.
    pub(crate) fn hex_run(&mut self) -> Result<(u32, usize), SyntaxError> {
        let mut value = u32::from(self.hex_digit()?);
        let mut digits = 1;
        while digits < 8 {
            let Ok(digit) = self.hex_digit() else { break };
            value = value << 4 | u32::from(digit);
            digits += 1;
        }
        Ok((value, digits))
    }

    /// Exactly `digits` (at most eight) hexadecimal digits.
    pub(crate) fn hex_exact(&mut self, digits: usize) -> Result<u32, SyntaxError> {
        let mut value = 0;
        for _ in 0..digits.min(8) {
            value = value << 4 | u32::from(self.hex_digit()?);
        }
        Ok(value)
    }

    /// Two hexadecimal digits; the error points at the missing one.
    pub(crate) fn data_byte(&mut self) -> Result<u8, SyntaxError> {
        let high = self.hex_digit().map_err(|_| self.error(Expected::DataByte))?;
        let low = self.hex_digit().map_err(|_| self.error(Expected::DataByte))?;
        Ok(high << 4 | low)
    }

    /// `17`, `17.25`, `17.250000123`: microseconds are kept, finer digits are cut off.
    pub(crate) fn seconds(&mut self) -> Result<Instant, SyntaxError> {
        let start = self.at;
        let Some(first) = self.decimal_digit() else {
            return Err(self.error(Expected::Digit));
        };
        let mut us = Some(u64::from(first));
        while let Some(digit) = self.decimal_digit() {
            us = us.and_then(|us| us.checked_mul(10)?.checked_add(u64::from(digit)));
        }
        us = us.and_then(|s| s.checked_mul(1_000_000));
        if self.eat(b'.') {
            if !matches!(self.peek(), Some(b'0'..=b'9')) {
                return Err(self.error(Expected::Digit));
            }
            let mut weight = 100_000;
            while let Some(digit) = self.decimal_digit() {
                us = us.and_then(|us| us.checked_add(u64::from(digit) * weight));
                weight /= 10;
            }
        }
        us.map(Instant::from_micros).ok_or_else(|| self.error_at(start, Expected::Seconds))
    }

    pub(crate) fn decimal_digit(&mut self) -> Option<u8> {
        let digit = self.peek().filter(u8::is_ascii_digit)?;
        self.advance();
        Some(digit - b'0')
    }

    /// A decimal data length code, 0 to 8.
    pub(crate) fn dlc(&mut self) -> Result<usize, SyntaxError> {
        match self.peek() {
            Some(digit @ b'0'..=b'8') => {
                self.advance();
                Ok(usize::from(digit - b'0'))
            }
            _ => Err(self.error(Expected::Dlc)),
        }
    }

    /// An id whose form or value gives its format: eight digits or a value above 7FF mean 29 bits, anything else 11
    /// bits.
    pub(crate) fn loose_id(&mut self) -> Result<Id, SyntaxError> {
        let start = self.at;
        let (value, digits) = self.hex_run()?;
        if digits == 8 || value > u32::from(StandardId::MAX.get()) {
            return match ExtendedId::new(value) {
                Ok(id) => Ok(Id::Extended(id)),
                Err(_) => Err(self.error_at(start, Expected::ExtendedId)),
            };
        }
        Ok(Id::Standard(StandardId::from_low_bits(value as u16)))
    }
}

pub(crate) const fn hex_value(byte: u8) -> Option<u8> {
    match byte {
        b'0'..=b'9' => Some(byte - b'0'),
        b'A'..=b'F' => Some(byte - b'A' + 10),
        b'a'..=b'f' => Some(byte - b'a' + 10),
        _ => None,
    }
}

/// Collects the data bytes of a frame.
#[derive(Clone, Copy)]
pub(crate) struct Payload {
    bytes: [u8; CAPACITY],
    len: usize,
}

impl Default for Payload {
    fn default() -> Self {
        Self { bytes: [0; CAPACITY], len: 0 }
    }
}

impl Payload {
    /// False if eight bytes are there already.
    pub(crate) fn push(&mut self, byte: u8) -> bool {
        self.push_within(byte, MAX_DATA_LEN)
    }

    /// False if `most` bytes are there already.
    pub(crate) fn push_within(&mut self, byte: u8, most: usize) -> bool {
        match self.bytes.get_mut(self.len).filter(|_| self.len < most) {
            Some(slot) => {
                *slot = byte;
                self.len += 1;
                true
            }
            None => false,
        }
    }

    pub(crate) const fn len(&self) -> usize {
        self.len
    }

    /// The first eight places; those beyond the length are zero.
    pub(crate) fn bytes(&self) -> [u8; MAX_DATA_LEN] {
        self.bytes.first_chunk().copied().unwrap_or_default()
    }

    /// `None`: CAN FD has no such length.
    pub(crate) fn fd_frame(&self, id: Id, flags: FdFlags) -> Option<Frame> {
        Frame::new_fd(id, flags, self.bytes.get(..self.len)?).ok()
    }

    pub(crate) fn data_frame(&self, id: Id) -> Frame {
        let data = self.bytes.get(..self.len).unwrap_or(&[]);
        // The callers push at most eight bytes, so the fallback is never taken.
        Frame::new(id, data).unwrap_or_else(|_| Frame::from_array(id, []))
    }
}

/// Remote frame for a length code that was read as 0..=8.
pub(crate) fn remote_frame(id: Id, dlc: usize) -> Frame {
    // The callers have checked the length; the clamp is for the compiler.
    Frame::remote(id, dlc.min(MAX_DATA_LEN)).unwrap_or_else(|_| Frame::from_array(id, []))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seconds(text: &str) -> Result<u64, SyntaxError> {
        Cursor::new(text.as_bytes()).seconds().map(Instant::as_micros)
    }

    #[test]
    fn seconds_take_any_number_of_decimals_and_keep_microseconds() {
        assert_eq!(seconds("17"), Ok(17_000_000));
        assert_eq!(seconds("17.25"), Ok(17_250_000));
        assert_eq!(seconds("1700000000.123456"), Ok(1_700_000_000_123_456));
        assert_eq!(seconds("1.123456999"), Ok(1_123_456));
        assert_eq!(seconds("18446744073709.551615"), Ok(u64::MAX));
    }

    #[test]
    fn seconds_that_do_not_fit_are_refused_at_their_first_digit() {
        for text in ["18446744073709.551616", "99999999999999999999999", "18446744073710"] {
            let error = seconds(text).unwrap_err();
            assert_eq!((error.column, error.expected), (1, Expected::Seconds), "{text}");
        }
        assert_eq!(seconds("1.").unwrap_err().column, 3);
        assert_eq!(seconds(".5").unwrap_err().expected, Expected::Digit);
    }

    #[test]
    fn errors_print_column_wish_and_find() {
        let error = SyntaxError { column: 4, expected: Expected::Byte(b'#'), found: Some(b'\n') };
        assert_eq!(error.to_string(), "column 4: expected '#', found '\\n'");
        let error = SyntaxError { column: 9, expected: Expected::BytesOfDlc(3), found: None };
        assert_eq!(
            error.to_string(),
            "column 9: expected 3 data bytes as the length code says, found the end"
        );
    }

    #[test]
    fn loose_id_goes_by_digits_and_value() {
        let id = |text: &str| Cursor::new(text.as_bytes()).loose_id();
        assert_eq!(id("7FF").unwrap().to_string(), "7FF");
        assert_eq!(id("1").unwrap().to_string(), "001");
        assert_eq!(id("800").unwrap().to_string(), "00000800");
        assert_eq!(id("0000007f").unwrap().to_string(), "0000007F");
        assert_eq!(id("20000000").unwrap_err().expected, Expected::ExtendedId);
    }
}

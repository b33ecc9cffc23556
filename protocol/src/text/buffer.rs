//! Fixed-size text and checked bus names, for the encoders.

use core::fmt;

use crate::id::Id;
use crate::time::Instant;

/// ASCII text of at most `N` bytes, on the stack.
///
/// Encoders choose `N` for the longest text they can make, so nothing is ever cut there; appending to
/// a full buffer is harmless and shows in [`Self::is_truncated`].
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct TextBuf<const N: usize> {
    bytes: [u8; N],
    len: usize,
    truncated: bool,
}

impl<const N: usize> TextBuf<N> {
    /// No text.
    pub const fn new() -> Self {
        Self { bytes: [0; N], len: 0, truncated: false }
    }

    /// The text as bytes, all of them ASCII.
    pub fn as_bytes(&self) -> &[u8] {
        self.bytes.get(..self.len).unwrap_or(&[])
    }

    /// The text.
    pub fn as_str(&self) -> &str {
        // Only ASCII is ever stored, so the fallback is never taken.
        core::str::from_utf8(self.as_bytes()).unwrap_or("")
    }

    /// True if more was appended than fits; the excess is lost.
    pub const fn is_truncated(&self) -> bool {
        self.truncated
    }

    /// Appends one byte; anything outside ASCII becomes `?`.
    pub(crate) fn push(&mut self, byte: u8) {
        match self.bytes.get_mut(self.len) {
            Some(slot) => {
                *slot = if byte.is_ascii() { byte } else { b'?' };
                self.len += 1;
            }
            None => self.truncated = true,
        }
    }

    pub(crate) fn push_str(&mut self, text: &str) {
        for byte in text.bytes() {
            self.push(byte);
        }
    }

    /// Appends the low `digits` hexadecimal digits of `value`, upper case.
    pub(crate) fn push_hex(&mut self, value: u32, digits: u32) {
        for place in (0..digits.min(8)).rev() {
            self.push(hex_digit(value >> (4 * place)));
        }
    }

    /// Appends three digits for an 11-bit id, eight for a 29-bit id.
    pub(crate) fn push_id(&mut self, id: Id) {
        self.push_hex(id.raw(), if id.is_extended() { 8 } else { 3 });
    }

    pub(crate) fn push_data(&mut self, data: &[u8]) {
        for byte in data {
            self.push_hex(u32::from(*byte), 2);
        }
    }

    /// Appends `value` in decimal with at least `width` digits.
    pub(crate) fn push_decimal(&mut self, value: u64, width: usize) {
        // u64::MAX has twenty digits; they come out in reverse.
        let mut reversed = [b'0'; 20];
        let mut rest = value;
        let mut count = 0;
        for slot in &mut reversed {
            if rest == 0 && count >= width {
                break;
            }
            *slot = b'0' + (rest % 10) as u8;
            rest /= 10;
            count += 1;
        }
        for byte in reversed.iter().take(count).rev() {
            self.push(*byte);
        }
    }

    /// Appends seconds with six decimals; seconds have at least `width` digits.
    pub(crate) fn push_seconds(&mut self, at: Instant, width: usize) {
        let us = at.as_micros();
        self.push_decimal(us / 1_000_000, width);
        self.push(b'.');
        self.push_decimal(us % 1_000_000, 6);
    }
}

fn hex_digit(value: u32) -> u8 {
    match (value & 0xF) as u8 {
        digit @ 0..=9 => b'0' + digit,
        digit => b'A' + (digit - 10),
    }
}

impl<const N: usize> Default for TextBuf<N> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const N: usize> AsRef<[u8]> for TextBuf<N> {
    fn as_ref(&self) -> &[u8] {
        self.as_bytes()
    }
}

impl<const N: usize> fmt::Display for TextBuf<N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

impl<const N: usize> fmt::Debug for TextBuf<N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}", self.as_str())
    }
}

/// Name of a bus or interface (`can0`): 1..=[`BusName::MAX_LEN`] visible ASCII characters other than
/// `<`, `>` and `/`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct BusName<'a>(&'a str);

/// Why a text is no bus name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BusNameError {
    /// No characters.
    Empty,
    /// More than [`BusName::MAX_LEN`] bytes.
    TooLong {
        /// The length found, in bytes.
        len: usize,
    },
    /// A byte that is not allowed.
    Character {
        /// Position of the byte, counted from 1.
        column: usize,
        /// The byte.
        found: u8,
    },
}

impl<'a> BusName<'a> {
    /// Longest name: what the socketcand protocol allows. Linux allows interfaces of fifteen.
    pub const MAX_LEN: usize = 16;

    /// Checks length and characters.
    pub fn new(name: &'a str) -> Result<Self, BusNameError> {
        if name.is_empty() {
            return Err(BusNameError::Empty);
        }
        if name.len() > Self::MAX_LEN {
            return Err(BusNameError::TooLong { len: name.len() });
        }
        for (index, byte) in name.bytes().enumerate() {
            if !byte.is_ascii_graphic() || matches!(byte, b'<' | b'>' | b'/') {
                return Err(BusNameError::Character { column: index + 1, found: byte });
            }
        }
        Ok(Self(name))
    }

    /// The name.
    pub const fn as_str(self) -> &'a str {
        self.0
    }
}

impl fmt::Display for BusName<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.0)
    }
}

impl fmt::Display for BusNameError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Empty => f.write_str("the bus name is empty"),
            Self::TooLong { len } => {
                write!(f, "the bus name has {len} characters (at most {})", BusName::MAX_LEN)
            }
            Self::Character { column, found } => {
                write!(f, "character {column} of the bus name is '{}'", found.escape_ascii())
            }
        }
    }
}

impl core::error::Error for BusNameError {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decimal_is_padded_to_the_width_and_never_cut() {
        let mut text = TextBuf::<64>::new();
        for (value, width) in [(0, 1), (0, 0), (7, 3), (1234, 2), (u64::MAX, 1)] {
            text.push_decimal(value, width);
            text.push(b' ');
        }
        assert_eq!(text.as_str(), "0  007 1234 18446744073709551615 ");
    }

    #[test]
    fn hex_takes_the_low_digits_in_upper_case() {
        let mut text = TextBuf::<16>::new();
        text.push_hex(0xABCD_1234, 8);
        text.push_hex(0xFA, 1);
        assert_eq!(text.as_str(), "ABCD1234A");
    }

    #[test]
    fn a_full_buffer_keeps_what_it_has_and_says_so() {
        let mut text = TextBuf::<3>::new();
        text.push_str("ab\u{e9}");
        assert_eq!((text.as_str(), text.is_truncated()), ("ab?", true));
    }

    #[test]
    fn bus_names_are_checked_for_length_and_characters() {
        assert_eq!(BusName::new("vcan0").map(BusName::as_str), Ok("vcan0"));
        assert_eq!(BusName::new(""), Err(BusNameError::Empty));
        assert_eq!(BusName::new("a23456789012345678"), Err(BusNameError::TooLong { len: 18 }));
        assert_eq!(BusName::new("can 0"), Err(BusNameError::Character { column: 4, found: b' ' }));
        assert_eq!(BusName::new("a>"), Err(BusNameError::Character { column: 2, found: b'>' }));
    }
}

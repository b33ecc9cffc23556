//! Adapter to host.

use super::{BELL, CR, LINE_MAX, frame, is_frame_letter, push_frame};
use crate::frame::Frame;
use crate::text::buffer::TextBuf;
use crate::text::cursor::{Cursor, Expected, SyntaxError};

/// Message of an adapter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reply<'a> {
    /// A lone CR: the last command was carried out.
    Done,
    /// A BELL: the last command was refused.
    Refused,
    /// `z` (11 bit) or `Z` (29 bit): the last frame was accepted for transmission.
    Taken {
        /// True for a frame with a 29-bit id.
        extended: bool,
    },
    /// `t`, `T`, `r`, `R`: a frame of the bus.
    Frame {
        /// The frame.
        frame: Frame,
        /// The adapter's time stamp if it sends them: milliseconds, wrapping at one minute
        /// ([`super::TIMESTAMP_PERIOD_MS`]).
        timestamp_ms: Option<u16>,
    },
    /// `F00`: status flags. Bit 0: receive queue full, 1: transmit queue full, 2: error warning,
    /// 3: data overrun, 5: error passive, 6: arbitration lost, 7: bus error (SJA1000).
    Status(u8),
    /// `V1013`: version, by the manual two digits of hardware and two of software.
    Version(&'a str),
    /// `N1234`: serial number.
    Serial(&'a str),
}

impl<'a> Reply<'a> {
    /// Reads one line without its end, as the [`super::Assembler`] cuts it; a BELL is not a line.
    ///
    /// # Errors
    ///
    /// The column and what should stand there.
    pub fn parse(line: &'a [u8]) -> Result<Self, SyntaxError> {
        let mut cursor = Cursor::new(line);
        let Some(letter) = cursor.peek() else { return Ok(Self::Done) };
        if is_frame_letter(letter) {
            let frame = frame(&mut cursor)?;
            let timestamp_ms = match cursor.peek() {
                Some(_) => Some(cursor.hex_exact(4)? as u16),
                None => None,
            };
            return end(&cursor, Self::Frame { frame, timestamp_ms });
        }
        cursor.advance();
        match letter {
            b'z' => end(&cursor, Self::Taken { extended: false }),
            b'Z' => end(&cursor, Self::Taken { extended: true }),
            b'F' => {
                let flags = cursor.hex_exact(2)? as u8;
                end(&cursor, Self::Status(flags))
            }
            b'V' => Ok(Self::Version(words(line)?)),
            b'N' => Ok(Self::Serial(words(line)?)),
            _ => Err(cursor.error_at(0, Expected::Verb)),
        }
    }

    /// The line with its CR, or a single BELL. Text that does not fit [`LINE_MAX`] is cut.
    pub fn encode(&self) -> TextBuf<LINE_MAX> {
        let mut text = TextBuf::new();
        match self {
            Self::Done => {}
            Self::Refused => {
                text.push(BELL);
                return text;
            }
            Self::Taken { extended } => text.push(if *extended { b'Z' } else { b'z' }),
            Self::Frame { frame, timestamp_ms } => {
                push_frame(&mut text, frame);
                if let Some(ms) = timestamp_ms {
                    text.push_hex(u32::from(*ms), 4);
                }
            }
            Self::Status(flags) => {
                text.push(b'F');
                text.push_hex(u32::from(*flags), 2);
            }
            Self::Version(version) => push_words(&mut text, b'V', version),
            Self::Serial(serial) => push_words(&mut text, b'N', serial),
        }
        text.push(CR);
        text
    }
}

fn push_words(text: &mut TextBuf<LINE_MAX>, letter: u8, words: &str) {
    text.push(letter);
    for byte in words.bytes().take(LINE_MAX - 2) {
        text.push(if matches!(byte, b' '..=b'~') { byte } else { b'?' });
    }
}

/// What stands behind the letter.
fn words(line: &[u8]) -> Result<&str, SyntaxError> {
    let words = line.get(1..).unwrap_or(&[]);
    let printable = words.iter().take_while(|byte| matches!(**byte, b' '..=b'~')).count();
    if printable < words.len() {
        return Err(Cursor::new(line).error_at(printable + 1, Expected::Value));
    }
    // Printable ASCII is always text, so the fallback is never taken.
    Ok(core::str::from_utf8(words).unwrap_or(""))
}

fn end<'a>(cursor: &Cursor<'_>, reply: Reply<'a>) -> Result<Reply<'a>, SyntaxError> {
    if cursor.peek().is_none() { Ok(reply) } else { Err(cursor.error(Expected::End)) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::id::{ExtendedId, StandardId};
    use crate::text::arbitrary;
    use proptest::prelude::*;

    #[test]
    fn each_reply_has_its_line_both_ways() {
        let frame = Frame::from_array(StandardId::new(0x0A5).unwrap(), [0x08, 0x4F, 0x64]);
        let remote = Frame::remote(ExtendedId::new(0x7F).unwrap(), 2).unwrap();
        for (line, reply) in [
            ("", Reply::Done),
            ("z", Reply::Taken { extended: false }),
            ("Z", Reply::Taken { extended: true }),
            ("t0A53084F64", Reply::Frame { frame, timestamp_ms: None }),
            ("t0A53084F64EA5F", Reply::Frame { frame, timestamp_ms: Some(59_999) }),
            ("R0000007F2", Reply::Frame { frame: remote, timestamp_ms: None }),
            ("R0000007F20001", Reply::Frame { frame: remote, timestamp_ms: Some(1) }),
            ("F84", Reply::Status(0x84)),
            ("V1013", Reply::Version("1013")),
            // As adapters of today answer.
            ("VL2K22 git a1b2c3", Reply::Version("L2K22 git a1b2c3")),
            ("NA123", Reply::Serial("A123")),
        ] {
            assert_eq!(Reply::parse(line.as_bytes()), Ok(reply), "{line}");
            assert_eq!(reply.encode().as_str(), format!("{line}\r"));
        }
        assert_eq!(Reply::Refused.encode().as_bytes(), [BELL]);
    }

    #[test]
    fn wrong_replies_are_refused_with_column_and_wish() {
        for (line, column, expected) in [
            (&b"t0A53084F64EA5"[..], 15, Expected::HexDigit),
            (b"t0A53084F64EA5F0", 16, Expected::End),
            (b"z0", 2, Expected::End),
            (b"F8", 3, Expected::HexDigit),
            (b"x", 1, Expected::Verb),
            (b"V10\xFF", 4, Expected::Value),
        ] {
            let error = Reply::parse(line).unwrap_err();
            assert_eq!((error.column, error.expected), (column, expected), "{error}");
        }
    }

    #[test]
    fn wordy_versions_are_cut_before_the_end_of_the_line() {
        let words = "x".repeat(100);
        let text = Reply::Version(&words).encode();
        assert!(!text.is_truncated() && text.as_bytes().ends_with(b"\r"));
        assert_eq!(text.as_bytes().len(), LINE_MAX);
    }

    proptest! {
        #[test]
        fn every_frame_survives_the_round_trip(frame in arbitrary::frame(), timestamp_ms: Option<u16>) {
            let reply = Reply::Frame { frame, timestamp_ms };
            let text = reply.encode();
            prop_assert_eq!(Reply::parse(text.as_bytes().strip_suffix(b"\r").unwrap()), Ok(reply));
        }

        #[test]
        fn any_bytes_are_read_without_panic(bytes in arbitrary::bytes()) {
            let _ = Reply::parse(&bytes);
        }
    }
}

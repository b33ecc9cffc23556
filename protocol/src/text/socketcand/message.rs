//! Server to client.

use core::fmt;

use super::MESSAGE_MAX;
use crate::frame::Frame;
use crate::text::buffer::TextBuf;
use crate::text::cursor::{Cursor, Expected, Payload, SyntaxError, remote_frame};
use crate::time::Instant;

/// Message of a server.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Message<'a> {
    /// `< hi >`: greeting of a new connection.
    Hi,
    /// `< ok >`: the last `open` or mode command was done.
    Ok,
    /// `< echo >`: answer to the client's echo.
    Echo,
    /// `< frame 0A5 23.424242 084F64 >`, `< rtr 0A5 23.424242 3 >`: a frame of the bus.
    Frame {
        /// When the server saw it; its clock, usually Unix time.
        at: Instant,
        /// The frame.
        frame: Frame,
    },
    /// `< time 23.424242 >`, of this project: the virtual time in lock step, and the client's turn.
    Time(Instant),
    /// `< error 040 23.424242 >`: the controller of the server reports a bus error.
    BusError {
        /// When the server saw it.
        at: Instant,
        /// Error class bits of Linux `can/error.h` (bit 6: bus-off), 29 bits.
        class: u32,
    },
    /// `< error unknown command >`: the last command was refused.
    Refused {
        /// The server's text, without blanks around it. A text that looks like a class and a time (`40 1.5`) cannot
        /// be distinguished from a bus error.
        reason: &'a str,
    },
}

/// Why a message of the server could not be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MessageError {
    /// Not a message that this implementation requests: statistics, ISO-TP, CAN FD, or not a message at all.
    Unknown,
    /// A known message with wrong arguments.
    Syntax(SyntaxError),
}

/// Ends the text of a refusal that is too long for a message.
const CUT: &str = "...";

impl<'a> Message<'a> {
    /// Reads one message from `<` to `>`, as the [`super::Assembler`] cuts it.
    ///
    /// Data bytes may be separated by blanks, as the description of the protocol has it.
    pub fn parse(message: &'a [u8]) -> Result<Self, MessageError> {
        let mut cursor = Cursor::new(message);
        cursor.expect(b'<')?;
        cursor.skip_blanks();
        let parsed = match cursor.word(b'>') {
            b"frame" => frame_arguments(&mut cursor)?,
            b"rtr" => rtr_arguments(&mut cursor)?,
            b"error" => return error_arguments(cursor, message),
            b"hi" => Self::Hi,
            b"ok" => Self::Ok,
            b"echo" => Self::Echo,
            b"time" => {
                cursor.blanks()?;
                Self::Time(cursor.seconds()?)
            }
            _ => return Err(MessageError::Unknown),
        };
        close(&mut cursor)?;
        Ok(parsed)
    }

    /// The message from `<` to `>`.
    ///
    /// In a refusal, angle brackets become round ones, anything outside ASCII becomes `?`, and text that does not
    /// fit [`MESSAGE_MAX`] is cut.
    pub fn encode(&self) -> TextBuf<MESSAGE_MAX> {
        let mut text = TextBuf::new();
        match self {
            Self::Hi => text.push_str("< hi"),
            Self::Ok => text.push_str("< ok"),
            Self::Echo => text.push_str("< echo"),
            Self::Time(now) => {
                text.push_str("< time ");
                text.push_seconds(*now, 1);
            }
            Self::Frame { at, frame } => {
                text.push_str(if frame.is_remote() { "< rtr " } else { "< frame " });
                text.push_id(frame.id());
                text.push(b' ');
                text.push_seconds(*at, 1);
                text.push(b' ');
                if frame.is_remote() {
                    text.push_decimal(frame.dlc() as u64, 1);
                }
                text.push_data(frame.data());
            }
            Self::BusError { at, class } => {
                text.push_str("< error ");
                // Three digits unless more are needed, as "%03X" of the reference server.
                let digits = (35 - (class & 0x1FFF_FFFF).leading_zeros()) / 4;
                text.push_hex(class & 0x1FFF_FFFF, digits.max(3));
                text.push(b' ');
                text.push_seconds(*at, 1);
            }
            Self::Refused { reason } => {
                text.push_str("< error ");
                let room = MESSAGE_MAX - "< error  >".len();
                // A cut text is marked: otherwise it could end in a blank, or look like a bus error.
                let (kept, mark) = if reason.len() > room { (room - CUT.len(), CUT) } else { (room, "") };
                for byte in reason.bytes().take(kept) {
                    text.push(match byte {
                        b'<' => b'(',
                        b'>' => b')',
                        b' '..=b'~' => byte,
                        _ => b'?',
                    });
                }
                text.push_str(mark);
            }
        }
        text.push_str(" >");
        text
    }
}

fn frame_arguments<'a>(cursor: &mut Cursor<'_>) -> Result<Message<'a>, SyntaxError> {
    cursor.blanks()?;
    let id = cursor.loose_id()?;
    cursor.blanks()?;
    let at = cursor.seconds()?;
    cursor.blanks()?;
    let mut payload = Payload::default();
    while cursor.peek() != Some(b'>') {
        let start = cursor.position();
        let byte = cursor.data_byte()?;
        if !payload.push(byte) {
            return Err(cursor.error_at(start, Expected::AtMostEightBytes));
        }
        cursor.skip_blanks();
    }
    Ok(Message::Frame { at, frame: payload.data_frame(id) })
}

fn rtr_arguments<'a>(cursor: &mut Cursor<'_>) -> Result<Message<'a>, SyntaxError> {
    cursor.blanks()?;
    let id = cursor.loose_id()?;
    cursor.blanks()?;
    let at = cursor.seconds()?;
    cursor.blanks()?;
    Ok(Message::Frame { at, frame: remote_frame(id, cursor.dlc()?) })
}

/// A class and a time make a bus error; any other words are a refusal.
fn error_arguments<'a>(mut cursor: Cursor<'a>, message: &'a [u8]) -> Result<Message<'a>, MessageError> {
    cursor.skip_blanks();
    let start = cursor.position();
    let mut bus_error = cursor;
    let parsed = bus_error.hex_run().and_then(|(class, _)| {
        bus_error.blanks()?;
        let at = bus_error.seconds()?;
        close(&mut bus_error)?;
        Ok(Message::BusError { at, class: class & 0x1FFF_FFFF })
    });
    if let Ok(parsed) = parsed {
        return Ok(parsed);
    }
    while cursor.peek().is_some_and(|byte| byte != b'>') {
        cursor.advance();
    }
    let words = cursor.since(start);
    close(&mut cursor)?;
    match core::str::from_utf8(words) {
        Ok(reason) => Ok(Message::Refused { reason: reason.trim_matches([' ', '\t']) }),
        Err(error) => {
            let at = start.saturating_add(error.valid_up_to());
            Err(MessageError::Syntax(Cursor::new(message).error_at(at, Expected::Verb)))
        }
    }
}

fn close(cursor: &mut Cursor<'_>) -> Result<(), SyntaxError> {
    cursor.skip_blanks();
    cursor.expect(b'>')?;
    cursor.end()
}

impl From<SyntaxError> for MessageError {
    fn from(error: SyntaxError) -> Self {
        Self::Syntax(error)
    }
}

impl fmt::Display for MessageError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unknown => f.write_str("not a message of a classical CAN bus"),
            Self::Syntax(error) => error.fmt(f),
        }
    }
}

impl core::error::Error for MessageError {}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::id::{ExtendedId, StandardId};
    use crate::text::arbitrary;
    use proptest::prelude::*;

    const AT: Instant = Instant::from_micros(23_424_242);

    #[test]
    fn each_message_has_its_meaning() {
        let id = StandardId::new(0x123).unwrap();
        let frame = Message::Frame { at: AT, frame: Frame::from_array(id, [0x11, 0x22, 0x33, 0x44]) };
        let empty = Message::Frame { at: AT, frame: Frame::from_array(id, []) };
        let extended =
            Message::Frame { at: AT, frame: Frame::from_array(ExtendedId::new(0x7F).unwrap(), [0xAB]) };
        for (text, message) in [
            ("< hi >", Message::Hi),
            ("< ok >", Message::Ok),
            ("< echo >", Message::Echo),
            ("< time 23.424242 >", Message::Time(AT)),
            // As the description has it, and as the reference server writes it.
            ("< frame 123 23.424242 11 22 33 44 >", frame),
            ("< frame 123 23.424242 11223344 >", frame),
            ("< frame 123 23.424242  >", empty),
            ("< frame 123 23.424242 >", empty),
            ("< frame 0000007F 23.424242 ab >", extended),
            ("< rtr 123 23.424242 4 >", Message::Frame { at: AT, frame: Frame::remote(id, 4).unwrap() }),
            ("< error 040 23.424242 >", Message::BusError { at: AT, class: 0x40 }),
            ("< error unknown command >", Message::Refused { reason: "unknown command" }),
            ("< error add is not supported >", Message::Refused { reason: "add is not supported" }),
        ] {
            assert_eq!(Message::parse(text.as_bytes()), Ok(message), "{text}");
        }
    }

    #[test]
    fn text_is_what_python_can_reads() {
        let id = StandardId::new(0x0A5).unwrap();
        for (message, text) in [
            (Message::Hi, "< hi >"),
            (Message::Ok, "< ok >"),
            (
                Message::Frame { at: AT, frame: Frame::from_array(id, [0x08, 0x4F]) },
                "< frame 0A5 23.424242 084F >",
            ),
            // Two blanks: python-can splits at single ones and takes the third part.
            (Message::Frame { at: AT, frame: Frame::from_array(id, []) }, "< frame 0A5 23.424242  >"),
            (Message::Frame { at: AT, frame: Frame::remote(id, 0).unwrap() }, "< rtr 0A5 23.424242 0 >"),
            (Message::BusError { at: AT, class: 0x40 }, "< error 040 23.424242 >"),
            (Message::BusError { at: AT, class: 0x1000 }, "< error 1000 23.424242 >"),
            (Message::BusError { at: AT, class: u32::MAX }, "< error 1FFFFFFF 23.424242 >"),
            (Message::Refused { reason: "no <such> b\u{fc}s" }, "< error no (such) b??s >"),
        ] {
            assert_eq!(message.encode().as_str(), text);
        }
    }

    #[test]
    fn wrong_arguments_are_refused_with_column_and_wish() {
        for (text, column, expected) in [
            ("< frame 123 23.424242 112 >", 26, Expected::DataByte),
            ("< frame 123 23.424242 112233445566778899 >", 39, Expected::AtMostEightBytes),
            ("< frame 123 now 11 >", 13, Expected::Digit),
            ("< frame 123 >", 13, Expected::Digit),
            ("< rtr 123 1.0 9 >", 15, Expected::Dlc),
            ("< hi there >", 6, Expected::Byte(b'>')),
        ] {
            match Message::parse(text.as_bytes()) {
                Err(MessageError::Syntax(error)) => {
                    assert_eq!((error.column, error.expected), (column, expected), "{text}");
                }
                other => panic!("{text}: {other:?}"),
            }
        }
        assert_eq!(Message::parse(b"< stat 1 2 3 4 >"), Err(MessageError::Unknown));
        assert_eq!(Message::parse(b"< fdframe 123 00 1.0 11 >"), Err(MessageError::Unknown));
    }

    #[test]
    fn the_longest_messages_fit_and_long_words_are_cut_before_the_bracket() {
        let frame = Frame::from_array(ExtendedId::MAX, [0xFF; 8]);
        let text = Message::Frame { at: Instant::FAR_FUTURE, frame }.encode();
        assert_eq!(text.as_str(), "< frame 1FFFFFFF 18446744073709.551615 FFFFFFFFFFFFFFFF >");
        let reason = "x".repeat(500);
        let text = Message::Refused { reason: &reason }.encode();
        assert!(!text.is_truncated() && text.as_str().ends_with("x... >"));
        assert_eq!(text.as_bytes().len(), MESSAGE_MAX);
    }

    #[test]
    fn words_that_are_cut_stay_the_same_words_when_they_are_written_again() {
        // Found by fuzzing: a blank where the words were cut is trimmed when they are read, and not written again.
        let blank_at_the_cut = "?".repeat(117) + " 0";
        // Cut to a class and a time they would be a bus error.
        let number = "40 1.".to_owned() + &"5".repeat(120);
        let gap = "40 1.5".to_owned() + &" ".repeat(120) + "x";
        for reason in [blank_at_the_cut.as_str(), &number, &gap] {
            let text = Message::Refused { reason }.encode();
            let again = Message::parse(text.as_bytes()).unwrap();
            assert!(matches!(again, Message::Refused { .. }), "{again:?}");
            assert_eq!(again.encode().as_bytes(), text.as_bytes());
        }
    }

    #[test]
    fn words_after_control_characters_stay_words() {
        // Found by fuzzing: trimmed away, they left what looks like a bus error.
        let message = Message::parse(b"< error \r\r 40 1.5 >").unwrap();
        assert_eq!(message, Message::Refused { reason: "\r\r 40 1.5" });
        let text = message.encode();
        assert_eq!(Message::parse(text.as_bytes()), Ok(Message::Refused { reason: "?? 40 1.5" }));
    }

    proptest! {
        #[test]
        fn every_frame_survives_the_round_trip(frame in arbitrary::frame(), us: u64) {
            let message = Message::Frame { at: Instant::from_micros(us), frame };
            let text = message.encode();
            prop_assert_eq!(Message::parse(text.as_bytes()), Ok(message));
        }

        #[test]
        fn every_time_survives_the_round_trip(us: u64) {
            let message = Message::Time(Instant::from_micros(us));
            let text = message.encode();
            prop_assert_eq!(Message::parse(text.as_bytes()), Ok(message));
        }

        #[test]
        fn every_bus_error_survives_the_round_trip(class in 0_u32..=0x1FFF_FFFF, us: u64) {
            let message = Message::BusError { at: Instant::from_micros(us), class };
            let text = message.encode();
            prop_assert_eq!(Message::parse(text.as_bytes()), Ok(message));
        }

        #[test]
        fn any_bytes_are_read_without_panic(bytes in arbitrary::bytes()) {
            let _ = Message::parse(&bytes);
        }
    }
}

//! Client to server.

use core::fmt;

use super::MESSAGE_MAX;
use crate::frame::Frame;
use crate::text::buffer::{BusName, TextBuf};
use crate::text::cursor::{Cursor, Expected, Payload, SyntaxError, remote_frame};
use crate::time::Instant;

/// Message of a client.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command<'a> {
    /// `< open can0 >`: attach to this bus.
    Open(BusName<'a>),
    /// `< rawmode >`: receive every frame from now on.
    RawMode,
    /// `< bcmmode >`: no frames but those subscribed to; the mode after `open`.
    BcmMode,
    /// `< echo >`: the server repeats it, which checks the connection and measures its latency.
    Echo,
    /// `< lockstep >`, of this project: from now on virtual time waits for this client.
    LockStep,
    /// `< wait 23.424242 23.400000 >`, of this project: ends the client's turn in lock step.
    Wait {
        /// When the client needs its next turn, if no frame comes before.
        until: Instant,
        /// Frames that come before this time wait until then.
        frames_from: Instant,
    },
    /// `< send 0A5 3 8 4f 64 >`, `< sendrtr 0A5 3 >`: put this frame on the bus.
    Send(Frame),
}

/// Why a message is no [`Command`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CommandError<'a> {
    /// Part of the protocol, but not of this implementation: cyclic jobs, filters and subscriptions
    /// of the broadcast manager, statistics, ISO-TP, CAN FD.
    Unsupported {
        /// The command word as sent.
        verb: &'a str,
    },
    /// The command word is not part of the protocol, or not text.
    Unknown,
    /// The command is known, its arguments are wrong.
    Syntax(SyntaxError),
}

/// Command words of the protocol that need a broadcast manager, a statistics counter, ISO-TP or FD.
const UNSUPPORTED: [&[u8]; 13] = [
    b"add",
    b"update",
    b"delete",
    b"filter",
    b"muxfilter",
    b"subscribe",
    b"unsubscribe",
    b"controlmode",
    b"statistics",
    b"isotpmode",
    b"isotpconf",
    b"sendpdu",
    b"fdsend",
];

impl<'a> Command<'a> {
    /// Reads one message from `<` to `>`, as the [`super::Assembler`] cuts it.
    ///
    /// Blanks inside the brackets may be missing or repeated.
    pub fn parse(message: &'a [u8]) -> Result<Self, CommandError<'a>> {
        let mut cursor = Cursor::new(message);
        cursor.expect(b'<')?;
        cursor.skip_blanks();
        let command = match cursor.word(b'>') {
            b"send" => Self::Send(send_arguments(&mut cursor)?),
            b"sendrtr" => Self::Send(sendrtr_arguments(&mut cursor)?),
            b"rawmode" => Self::RawMode,
            b"bcmmode" => Self::BcmMode,
            b"echo" => Self::Echo,
            b"lockstep" => Self::LockStep,
            b"wait" => {
                cursor.blanks()?;
                let until = cursor.seconds()?;
                cursor.blanks()?;
                Self::Wait { until, frames_from: cursor.seconds()? }
            }
            b"open" => Self::Open(open_arguments(&mut cursor)?),
            b"" => return Err(CommandError::Syntax(cursor.error(Expected::Verb))),
            word if UNSUPPORTED.contains(&word) => {
                return Err(core::str::from_utf8(word)
                    .map_or(CommandError::Unknown, |verb| CommandError::Unsupported { verb }));
            }
            _ => return Err(CommandError::Unknown),
        };
        close(&mut cursor)?;
        Ok(command)
    }

    /// The message from `<` to `>`.
    pub fn encode(&self) -> TextBuf<MESSAGE_MAX> {
        let mut text = TextBuf::new();
        match self {
            Self::Open(bus) => {
                text.push_str("< open ");
                text.push_str(bus.as_str());
            }
            Self::RawMode => text.push_str("< rawmode"),
            Self::BcmMode => text.push_str("< bcmmode"),
            Self::Echo => text.push_str("< echo"),
            Self::LockStep => text.push_str("< lockstep"),
            Self::Wait { until, frames_from } => {
                text.push_str("< wait ");
                text.push_seconds(*until, 1);
                text.push(b' ');
                text.push_seconds(*frames_from, 1);
            }
            Self::Send(frame) => {
                text.push_str(if frame.is_remote() { "< sendrtr " } else { "< send " });
                text.push_id(frame.id());
                text.push(b' ');
                text.push_decimal(frame.dlc() as u64, 1);
                for byte in frame.data() {
                    text.push(b' ');
                    text.push_hex(u32::from(*byte), 2);
                }
            }
        }
        text.push_str(" >");
        text
    }
}

fn open_arguments<'a>(cursor: &mut Cursor<'a>) -> Result<BusName<'a>, SyntaxError> {
    cursor.blanks()?;
    let start = cursor.position();
    let word = cursor.word(b'>');
    core::str::from_utf8(word)
        .ok()
        .and_then(|name| BusName::new(name).ok())
        .ok_or_else(|| cursor.error_at(start, Expected::BusName))
}

/// `ID DLC B0 B1 …`, bytes of one or two digits. A length without any byte is a remote frame.
fn send_arguments(cursor: &mut Cursor<'_>) -> Result<Frame, SyntaxError> {
    cursor.blanks()?;
    let id = cursor.loose_id()?;
    cursor.blanks()?;
    let dlc = cursor.dlc()?;
    let mut payload = Payload::default();
    while cursor.skip_blanks() && cursor.peek() != Some(b'>') {
        let (mut value, mut digits) = (0, 0);
        while digits < 2 {
            match cursor.hex_digit() {
                Ok(digit) => value = value << 4 | digit,
                Err(error) if digits == 0 => return Err(error),
                Err(_) => break,
            }
            digits += 1;
        }
        if !payload.push(value) {
            return Err(cursor.error(Expected::AtMostEightBytes));
        }
    }
    match payload.len() {
        len if len == dlc => Ok(payload.data_frame(id)),
        0 => Ok(remote_frame(id, dlc)),
        _ => Err(cursor.error(Expected::BytesOfDlc(dlc as u8))),
    }
}

fn sendrtr_arguments(cursor: &mut Cursor<'_>) -> Result<Frame, SyntaxError> {
    cursor.blanks()?;
    let id = cursor.loose_id()?;
    cursor.blanks()?;
    Ok(remote_frame(id, cursor.dlc()?))
}

fn close(cursor: &mut Cursor<'_>) -> Result<(), SyntaxError> {
    cursor.skip_blanks();
    cursor.expect(b'>')?;
    cursor.end()
}

impl From<SyntaxError> for CommandError<'_> {
    fn from(error: SyntaxError) -> Self {
        Self::Syntax(error)
    }
}

impl fmt::Display for CommandError<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unsupported { verb } => write!(f, "{verb} is not supported, use rawmode and send"),
            Self::Unknown => f.write_str("unknown command"),
            Self::Syntax(error) => error.fmt(f),
        }
    }
}

impl core::error::Error for CommandError<'_> {}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::id::{ExtendedId, StandardId};
    use crate::text::arbitrary;
    use proptest::prelude::*;

    fn standard(id: u16, data: &[u8]) -> Frame {
        Frame::new(StandardId::new(id).unwrap(), data).unwrap()
    }

    #[test]
    fn each_command_has_its_meaning() {
        let can0 = Command::Open(BusName::new("can0").unwrap());
        let extended = Frame::from_array(ExtendedId::new(0x1AAA_AAAA).unwrap(), [0x01, 0xF1]);
        let remote = Frame::remote(StandardId::new(0x123).unwrap(), 4).unwrap();
        for (text, command) in [
            ("< open can0 >", can0),
            // The description itself writes it without the first blank.
            ("<open can0>", can0),
            ("< rawmode >", Command::RawMode),
            ("< bcmmode >", Command::BcmMode),
            ("< echo >", Command::Echo),
            ("< lockstep >", Command::LockStep),
            (
                "< wait 1.5 0.25 >",
                Command::Wait {
                    until: Instant::from_micros(1_500_000),
                    frames_from: Instant::from_micros(250_000),
                },
            ),
            // From the description.
            ("< send 123 0 >", Command::Send(standard(0x123, &[]))),
            ("< send 1AAAAAAA 2 1 F1 >", Command::Send(extended)),
            // As python-can writes them: no leading zeros, a second blank when there is no data.
            ("< send 0A5 3 8 4f 64 >", Command::Send(standard(0x0A5, &[0x08, 0x4F, 0x64]))),
            ("< send 123 0  >", Command::Send(standard(0x123, &[]))),
            // python-can's remote frame: a length and no bytes.
            ("< send 123 4  >", Command::Send(remote)),
            ("< sendrtr 123 4 >", Command::Send(remote)),
        ] {
            assert_eq!(Command::parse(text.as_bytes()), Ok(command), "{text}");
        }
    }

    #[test]
    fn eight_digits_or_a_large_value_make_an_extended_id() {
        for (text, extended) in [("07F", false), ("7FF", false), ("0000007F", true), ("800", true)] {
            let message = format!("< send {text} 0 >");
            let Ok(Command::Send(frame)) = Command::parse(message.as_bytes()) else { panic!("{text}") };
            assert_eq!(frame.is_extended(), extended, "{text}");
        }
    }

    #[test]
    fn commands_of_the_broadcast_manager_are_named_in_the_refusal() {
        for text in ["< add 1 0 123 8 11 22 33 44 55 66 77 88 >", "< subscribe 0 0 123 >", "< isotpmode >"] {
            let error = Command::parse(text.as_bytes()).unwrap_err();
            let CommandError::Unsupported { verb } = error else { panic!("{text}: {error}") };
            assert!(text.contains(verb));
        }
        assert_eq!(Command::parse(b"< can0 B 1000000 >"), Err(CommandError::Unknown));
        assert_eq!(
            Command::parse(b"< \xff >"),
            Err(CommandError::Syntax(SyntaxError { column: 3, expected: Expected::Verb, found: Some(0xFF) }))
        );
    }

    #[test]
    fn wrong_arguments_are_refused_with_column_and_wish() {
        for (text, column, expected) in [
            ("< open  >", 9, Expected::BusName),
            ("< open a_name_that_is_too_long >", 8, Expected::BusName),
            ("< send 20000000 0 >", 8, Expected::ExtendedId),
            ("< send xyz 0 >", 8, Expected::HexDigit),
            ("< wait soon >", 8, Expected::Digit),
            ("< wait 1.5 >", 12, Expected::Digit),
            ("< send 123 9 >", 12, Expected::Dlc),
            ("< send 123 2 1 >", 16, Expected::BytesOfDlc(2)),
            ("< send 123 2 1 2 3 >", 20, Expected::BytesOfDlc(2)),
            ("< send 123 2 1 g >", 16, Expected::HexDigit),
            ("< send 123 8 1 2 3 4 5 6 7 8 9 >", 31, Expected::AtMostEightBytes),
            ("< send 123 1 123 >", 16, Expected::Byte(b'>')),
            ("< sendrtr 123 9 >", 15, Expected::Dlc),
            ("< echo", 7, Expected::Byte(b'>')),
            ("< echo > x", 10, Expected::End),
            ("echo", 1, Expected::Byte(b'<')),
            ("< >", 3, Expected::Verb),
        ] {
            match Command::parse(text.as_bytes()) {
                Err(CommandError::Syntax(error)) => {
                    assert_eq!((error.column, error.expected), (column, expected), "{text}");
                }
                other => panic!("{text}: {other:?}"),
            }
        }
    }

    #[test]
    fn the_longest_command_fits() {
        let frame = Frame::from_array(ExtendedId::MAX, [0xFF; 8]);
        let text = Command::Send(frame).encode();
        assert_eq!(text.as_str(), "< send 1FFFFFFF 8 FF FF FF FF FF FF FF FF >");
        let text = Command::Open(BusName::new("a123456789012345").unwrap()).encode();
        assert!(!text.is_truncated());
    }

    proptest! {
        #[test]
        fn every_frame_survives_the_round_trip(frame in arbitrary::frame()) {
            let text = Command::Send(frame).encode();
            prop_assert!(!text.is_truncated());
            prop_assert_eq!(Command::parse(text.as_bytes()), Ok(Command::Send(frame)));
        }

        #[test]
        fn every_wait_survives_the_round_trip(until_us: u64, frames_us: u64) {
            let until = Instant::from_micros(until_us);
            let command = Command::Wait { until, frames_from: Instant::from_micros(frames_us) };
            let text = command.encode();
            prop_assert_eq!(Command::parse(text.as_bytes()), Ok(command));
        }

        #[test]
        fn any_bytes_are_read_without_panic(bytes in arbitrary::bytes()) {
            let _ = Command::parse(&bytes);
        }
    }
}

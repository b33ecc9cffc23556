//! Host to adapter.

use super::{LINE_MAX, frame, is_frame_letter, push_frame};
use crate::frame::Frame;
use crate::text::buffer::TextBuf;
use crate::text::cursor::{Cursor, Expected, SyntaxError};

/// Bit rates that have a code.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Bitrate {
    /// `S0`: 10 kbit/s.
    K10,
    /// `S1`: 20 kbit/s.
    K20,
    /// `S2`: 50 kbit/s.
    K50,
    /// `S3`: 100 kbit/s.
    K100,
    /// `S4`: 125 kbit/s.
    K125,
    /// `S5`: 250 kbit/s.
    K250,
    /// `S6`: 500 kbit/s.
    K500,
    /// `S7`: 800 kbit/s.
    K800,
    /// `S8`: 1 Mbit/s.
    M1,
}

impl Bitrate {
    /// All codes in their order, `S0` first.
    pub const ALL: [Self; 9] = [
        Self::K10,
        Self::K20,
        Self::K50,
        Self::K100,
        Self::K125,
        Self::K250,
        Self::K500,
        Self::K800,
        Self::M1,
    ];

    /// The rate in bit/s.
    pub const fn bits_per_second(self) -> u32 {
        match self {
            Self::K10 => 10_000,
            Self::K20 => 20_000,
            Self::K50 => 50_000,
            Self::K100 => 100_000,
            Self::K125 => 125_000,
            Self::K250 => 250_000,
            Self::K500 => 500_000,
            Self::K800 => 800_000,
            Self::M1 => 1_000_000,
        }
    }

    /// The code for exactly this rate in bit/s; `None` if there is no such code.
    pub fn from_bits_per_second(rate: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|bitrate| bitrate.bits_per_second() == rate)
    }

    /// The digit behind `S`, 0..=8.
    pub const fn code(self) -> u8 {
        self as u8
    }
}

/// Command of a host to an adapter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    /// An empty line: hosts send some to end a line that the adapter has half read.
    Nothing,
    /// `S0`..`S8`: bit rate; only while closed.
    SetBitrate(Bitrate),
    /// `sxxyy`: bit timing registers BTR0 (high byte) and BTR1 of an SJA1000; only while closed.
    SetTiming(u16),
    /// `O`: open the channel.
    Open,
    /// `L`: open the channel, listen only.
    OpenListenOnly,
    /// `C`: close the channel.
    Close,
    /// `t`, `T`, `r`, `R`: transmit.
    Send(Frame),
    /// `F`: read and clear the status flags.
    ReadStatus,
    /// `V`: read the version.
    ReadVersion,
    /// `N`: read the serial number.
    ReadSerial,
    /// `Z0`, `Z1`: time stamps on received frames.
    Timestamps(bool),
    /// `Mxxxxxxxx`: acceptance code register of an SJA1000; only while closed.
    AcceptanceCode(u32),
    /// `mxxxxxxxx`: acceptance mask register (ones mean "do not care"); only while closed.
    AcceptanceMask(u32),
}

impl Command {
    /// Reads one line without its end, as the [`super::Assembler`] cuts it.
    ///
    /// # Errors
    ///
    /// The column and what should stand there; an adapter answers with BELL.
    pub fn parse(line: &[u8]) -> Result<Self, SyntaxError> {
        let mut cursor = Cursor::new(line);
        let Some(letter) = cursor.peek() else { return Ok(Self::Nothing) };
        if is_frame_letter(letter) {
            let frame = frame(&mut cursor)?;
            return end(&cursor, Self::Send(frame));
        }
        cursor.advance();
        let command = match letter {
            b'S' => Self::SetBitrate(bitrate(&mut cursor)?),
            b's' => Self::SetTiming(cursor.hex_exact(4)? as u16),
            b'O' => Self::Open,
            b'L' => Self::OpenListenOnly,
            b'C' => Self::Close,
            b'F' => Self::ReadStatus,
            b'V' => Self::ReadVersion,
            b'N' => Self::ReadSerial,
            b'Z' => Self::Timestamps(switch(&mut cursor)?),
            b'M' => Self::AcceptanceCode(cursor.hex_exact(8)?),
            b'm' => Self::AcceptanceMask(cursor.hex_exact(8)?),
            _ => return Err(cursor.error_at(0, Expected::Verb)),
        };
        end(&cursor, command)
    }

    /// The line with its CR.
    pub fn encode(&self) -> TextBuf<LINE_MAX> {
        let mut text = TextBuf::new();
        match self {
            Self::Nothing => {}
            Self::SetBitrate(bitrate) => {
                text.push(b'S');
                text.push(b'0' + bitrate.code());
            }
            Self::SetTiming(btr) => {
                text.push(b's');
                text.push_hex(u32::from(*btr), 4);
            }
            Self::Open => text.push(b'O'),
            Self::OpenListenOnly => text.push(b'L'),
            Self::Close => text.push(b'C'),
            Self::Send(frame) => push_frame(&mut text, frame),
            Self::ReadStatus => text.push(b'F'),
            Self::ReadVersion => text.push(b'V'),
            Self::ReadSerial => text.push(b'N'),
            Self::Timestamps(on) => text.push_str(if *on { "Z1" } else { "Z0" }),
            Self::AcceptanceCode(code) => {
                text.push(b'M');
                text.push_hex(*code, 8);
            }
            Self::AcceptanceMask(mask) => {
                text.push(b'm');
                text.push_hex(*mask, 8);
            }
        }
        text.push(super::CR);
        text
    }
}

fn end(cursor: &Cursor<'_>, command: Command) -> Result<Command, SyntaxError> {
    if cursor.peek().is_none() { Ok(command) } else { Err(cursor.error(Expected::End)) }
}

fn bitrate(cursor: &mut Cursor<'_>) -> Result<Bitrate, SyntaxError> {
    let start = cursor.position();
    let code = cursor.decimal_digit().map(usize::from);
    code.and_then(|code| Bitrate::ALL.get(code).copied())
        .ok_or_else(|| cursor.error_at(start, Expected::Value))
}

fn switch(cursor: &mut Cursor<'_>) -> Result<bool, SyntaxError> {
    if cursor.eat(b'1') {
        Ok(true)
    } else if cursor.eat(b'0') {
        Ok(false)
    } else {
        Err(cursor.error(Expected::Value))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::id::{ExtendedId, StandardId};
    use crate::text::arbitrary;
    use proptest::prelude::*;

    #[test]
    fn each_command_has_its_line_both_ways() {
        let standard = StandardId::new(0x0A5).unwrap();
        let extended = ExtendedId::new(0x1234_ABCD).unwrap();
        for (line, command) in [
            ("", Command::Nothing),
            ("S8", Command::SetBitrate(Bitrate::M1)),
            ("S0", Command::SetBitrate(Bitrate::K10)),
            // 500 kbit/s with an SJA1000 at 16 MHz: BTR0 = 0x00, BTR1 = 0x1C.
            ("s001C", Command::SetTiming(0x001C)),
            ("O", Command::Open),
            ("L", Command::OpenListenOnly),
            ("C", Command::Close),
            ("t0A53084F64", Command::Send(Frame::from_array(standard, [0x08, 0x4F, 0x64]))),
            ("t0A50", Command::Send(Frame::from_array(standard, []))),
            ("T1234ABCD2FF00", Command::Send(Frame::from_array(extended, [0xFF, 0]))),
            ("r0A54", Command::Send(Frame::remote(standard, 4).unwrap())),
            ("R1234ABCD8", Command::Send(Frame::remote(extended, 8).unwrap())),
            ("F", Command::ReadStatus),
            ("V", Command::ReadVersion),
            ("N", Command::ReadSerial),
            ("Z0", Command::Timestamps(false)),
            ("Z1", Command::Timestamps(true)),
            ("M00001234", Command::AcceptanceCode(0x1234)),
            ("mFFFFFFFF", Command::AcceptanceMask(u32::MAX)),
        ] {
            assert_eq!(Command::parse(line.as_bytes()), Ok(command), "{line}");
            assert_eq!(command.encode().as_str(), format!("{line}\r"));
        }
    }

    #[test]
    fn bit_rates_and_codes_match_one_to_one() {
        for (code, bitrate) in Bitrate::ALL.into_iter().enumerate() {
            assert_eq!(usize::from(bitrate.code()), code);
            assert_eq!(Bitrate::from_bits_per_second(bitrate.bits_per_second()), Some(bitrate));
        }
        assert_eq!(Bitrate::from_bits_per_second(33_333), None);
    }

    #[test]
    fn lower_case_digits_are_read_and_written_in_upper_case() {
        assert_eq!(Command::parse(b"t0a53084f64").unwrap().encode().as_str(), "t0A53084F64\r");
    }

    #[test]
    fn wrong_commands_are_refused_with_column_and_wish() {
        for (line, column, expected) in [
            ("X1", 1, Expected::Verb),
            ("S9", 2, Expected::Value),
            ("S", 2, Expected::Value),
            ("S81", 3, Expected::End),
            ("s00", 4, Expected::HexDigit),
            ("O1", 2, Expected::End),
            ("t8000", 2, Expected::StandardId),
            ("T200000000", 2, Expected::ExtendedId),
            ("t12", 4, Expected::HexDigit),
            ("t1239", 5, Expected::Dlc),
            ("t1231", 6, Expected::DataByte),
            ("t123111F", 8, Expected::End),
            ("r12341122", 6, Expected::End),
            ("Z2", 2, Expected::Value),
            ("m123", 5, Expected::HexDigit),
        ] {
            let error = Command::parse(line.as_bytes()).unwrap_err();
            assert_eq!((error.column, error.expected), (column, expected), "{line}: {error}");
        }
    }

    proptest! {
        #[test]
        fn every_frame_survives_the_round_trip(frame in arbitrary::frame()) {
            let text = Command::Send(frame).encode();
            let line = text.as_bytes().strip_suffix(b"\r").unwrap();
            prop_assert_eq!(Command::parse(line), Ok(Command::Send(frame)));
        }

        #[test]
        fn any_bytes_are_read_without_panic(bytes in arbitrary::bytes()) {
            let _ = Command::parse(&bytes);
        }
    }
}

//! The log format of `candump -L`: one frame per line.
//!
//! ```text
//! (1700000000.123456) can0 0A5#084F64
//! (1700000000.123789) can0 0000007F#R4 R
//! (1700000000.123901) can0 001##1FFFFFFFFFFFFFFFC
//! ```
//!
//! Three digits are an 11-bit id, eight digits a 29-bit id; `R` with an optional length is a remote
//! frame; a second `#` and a digit of flags (1 BRS, 2 ESI) are CAN FD. Read tolerantly: any number of decimals (beyond six they are cut off), dots between data
//! bytes (as `cansend` takes them), a raw length code behind `_` (as `candump -8` writes it, means
//! eight bytes), a trailing `T` or `R` for sent or received (as `candump -L -x` writes it).
//!
//! A line that reports an error of the bus (flag 20000000 in the id) has an error of its own.
//!
//! Source: `lib.c` and `candump.c` of can-utils.

use core::fmt;

use super::buffer::{BusName, TextBuf};
use super::cursor::{Cursor, Expected, Payload, SyntaxError, remote_frame};
use crate::frame::{CAPACITY, FdFlags, Frame, MAX_DATA_LEN};
use crate::id::{ExtendedId, Id, StandardId};
use crate::time::Instant;

/// Longest line made, without a line end, in bytes.
pub const LINE_MAX: usize = 54 + 2 * CAPACITY;

/// Bit of the id that marks an error frame of the controller (`CAN_ERR_FLAG` of Linux `can.h`).
const ERROR_FLAG: u32 = 0x2000_0000;

/// Which way a frame went, seen from the machine that wrote the log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// `T`: sent by the machine itself.
    Sent,
    /// `R`: received.
    Received,
}

/// One line of a log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Record<'a> {
    /// Time stamp; Unix time in logs of `candump`, any origin in logs of a simulation.
    pub at: Instant,
    /// The interface.
    pub bus: BusName<'a>,
    /// The frame.
    pub frame: Frame,
    /// Direction, if the log has it.
    pub direction: Option<Direction>,
}

/// Why a line is no [`Record`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ParseError {
    /// The line is well formed, but reports an error of the bus instead of a frame.
    NotADataFrame {
        /// Time stamp.
        at: Instant,
        /// Error class bits of Linux `can/error.h`, 29 bits.
        class: u32,
        /// Details of the error; bytes that the line does not have are zero.
        details: [u8; MAX_DATA_LEN],
    },
    /// The line does not follow the format.
    Syntax(SyntaxError),
}

impl<'a> Record<'a> {
    /// Reads one line, with or without its line end.
    pub fn parse(line: &'a [u8]) -> Result<Self, ParseError> {
        let mut cursor = Cursor::new(line);
        cursor.skip_blanks();
        cursor.expect(b'(')?;
        let at = cursor.seconds()?;
        cursor.expect(b')')?;
        cursor.blanks()?;
        let bus = bus_name(&mut cursor)?;
        cursor.blanks()?;
        let content = content(&mut cursor)?;
        let direction = direction(&mut cursor)?;
        match content {
            Content::Frame(frame) => Ok(Self { at, bus, frame, direction }),
            Content::Error { class, details } => Err(ParseError::NotADataFrame { at, class, details }),
        }
    }

    /// The line, without a line end; seconds have at least ten digits, as `candump` writes them.
    pub fn encode(&self) -> TextBuf<LINE_MAX> {
        let mut text = TextBuf::new();
        text.push(b'(');
        text.push_seconds(self.at, 10);
        text.push_str(") ");
        text.push_str(self.bus.as_str());
        text.push(b' ');
        text.push_id(self.frame.id());
        text.push(b'#');
        if let Some(flags) = self.frame.fd() {
            text.push(b'#');
            text.push_hex(flags.nibble().into(), 1);
        }
        if self.frame.is_remote() {
            text.push(b'R');
            if self.frame.dlc() > 0 {
                text.push_decimal(self.frame.dlc() as u64, 1);
            }
        }
        text.push_data(self.frame.data());
        match self.direction {
            Some(Direction::Sent) => text.push_str(" T"),
            Some(Direction::Received) => text.push_str(" R"),
            None => {}
        }
        text
    }
}

enum Content {
    Frame(Frame),
    Error { class: u32, details: [u8; MAX_DATA_LEN] },
}

fn bus_name<'a>(cursor: &mut Cursor<'a>) -> Result<BusName<'a>, SyntaxError> {
    let start = cursor.position();
    core::str::from_utf8(cursor.word(b' '))
        .ok()
        .and_then(|name| BusName::new(name).ok())
        .ok_or_else(|| cursor.error_at(start, Expected::BusName))
}

fn content(cursor: &mut Cursor<'_>) -> Result<Content, ParseError> {
    let start = cursor.position();
    let (value, digits) = cursor.hex_run()?;
    if !matches!(digits, 3 | 8) {
        return Err(cursor.error_at(start, Expected::Id).into());
    }
    cursor.expect(b'#')?;
    let is_fd = cursor.eat(b'#');
    if !is_fd && digits == 8 && value & ERROR_FLAG != 0 && value < ERROR_FLAG << 1 {
        let payload = data(cursor, MAX_DATA_LEN)?;
        return Ok(Content::Error { class: value & !ERROR_FLAG, details: payload.bytes() });
    }
    let id = if digits == 3 {
        // Three digits go up to FFF.
        StandardId::new(value as u16)
            .map(Id::Standard)
            .map_err(|_| cursor.error_at(start, Expected::StandardId))?
    } else {
        ExtendedId::new(value).map(Id::Extended).map_err(|_| cursor.error_at(start, Expected::ExtendedId))?
    };
    if is_fd {
        // Newer kernels set bit 2, too, which says that the frame is one of CAN FD.
        let flags = FdFlags::from_nibble(cursor.hex_digit()?);
        let start = cursor.position();
        let payload = data(cursor, CAPACITY)?;
        let frame = payload.fd_frame(id, flags);
        return frame.map(Content::Frame).ok_or_else(|| cursor.error_at(start, Expected::FdLength).into());
    }
    if cursor.eat(b'R') || cursor.eat(b'r') {
        let dlc = if cursor.peek().is_some_and(|byte| byte.is_ascii_digit()) { cursor.dlc()? } else { 0 };
        raw_length_code(cursor, dlc)?;
        return Ok(Content::Frame(remote_frame(id, dlc)));
    }
    let payload = data(cursor, MAX_DATA_LEN)?;
    raw_length_code(cursor, payload.len())?;
    Ok(Content::Frame(payload.data_frame(id)))
}

/// Pairs of digits, at most `most`, with or without dots in between.
fn data(cursor: &mut Cursor<'_>, most: usize) -> Result<Payload, SyntaxError> {
    let mut payload = Payload::default();
    while cursor.peek().is_some_and(|byte| byte.is_ascii_hexdigit()) {
        let start = cursor.position();
        let byte = cursor.data_byte()?;
        if !payload.push_within(byte, most) {
            let expected = if most > MAX_DATA_LEN { Expected::FdLength } else { Expected::AtMostEightBytes };
            return Err(cursor.error_at(start, expected));
        }
        if cursor.eat(b'.') && !cursor.peek().is_some_and(|byte| byte.is_ascii_hexdigit()) {
            return Err(cursor.error(Expected::DataByte));
        }
    }
    Ok(payload)
}

/// `_9` to `_F` behind eight bytes: length codes that mean eight too.
fn raw_length_code(cursor: &mut Cursor<'_>, len: usize) -> Result<(), SyntaxError> {
    if len == MAX_DATA_LEN && cursor.eat(b'_') {
        let start = cursor.position();
        if cursor.hex_digit()? <= MAX_DATA_LEN as u8 {
            return Err(cursor.error_at(start, Expected::Value));
        }
    }
    Ok(())
}

fn direction(cursor: &mut Cursor<'_>) -> Result<Option<Direction>, SyntaxError> {
    let blanks = cursor.skip_blanks();
    let direction = match cursor.peek() {
        None | Some(b'\r' | b'\n') => None,
        Some(_) if !blanks => return Err(cursor.error(Expected::DataByte)),
        Some(b'T') => Some(Direction::Sent),
        Some(b'R') => Some(Direction::Received),
        Some(_) => return Err(cursor.error(Expected::Direction)),
    };
    if direction.is_some() {
        cursor.advance();
    }
    cursor.end()?;
    Ok(direction)
}

impl From<SyntaxError> for ParseError {
    fn from(error: SyntaxError) -> Self {
        Self::Syntax(error)
    }
}

impl fmt::Display for ParseError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotADataFrame { class, .. } => {
                write!(f, "an error frame of the controller (class {class:03X}), not a frame of the bus")
            }
            Self::Syntax(error) => error.fmt(f),
        }
    }
}

impl core::error::Error for ParseError {}

/// The line of [`Record::encode`].
impl fmt::Display for Record<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.encode().as_str())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::text::arbitrary;
    use proptest::prelude::*;

    const AT: Instant = Instant::from_micros(1_700_000_000_123_456);

    fn record(frame: Frame) -> Record<'static> {
        Record { at: AT, bus: BusName::new("can0").unwrap(), frame, direction: None }
    }

    fn standard(id: u16) -> StandardId {
        StandardId::new(id).unwrap()
    }

    #[test]
    fn lines_of_candump_have_their_meaning_and_are_written_back_unchanged() {
        let low = ExtendedId::new(0x7F).unwrap();
        let bytes = [0x00, 0x11, 0x22, 0x33, 0x44, 0x55, 0x66, 0x77];
        for (text, frame) in [
            ("(1700000000.123456) can0 0A5#084F64", Frame::from_array(standard(0x0A5), [0x08, 0x4F, 0x64])),
            ("(1700000000.123456) can0 0000007F#", Frame::from_array(low, [])),
            ("(1700000000.123456) can0 1FFFFFFF#0011223344556677", Frame::from_array(ExtendedId::MAX, bytes)),
            ("(1700000000.123456) can0 123#R", Frame::remote(standard(0x123), 0).unwrap()),
            ("(1700000000.123456) can0 123#R4", Frame::remote(standard(0x123), 4).unwrap()),
        ] {
            assert_eq!(Record::parse(text.as_bytes()), Ok(record(frame)), "{text}");
            assert_eq!(record(frame).encode().as_str(), text);
            for (mark, direction) in [(" T", Direction::Sent), (" R", Direction::Received)] {
                let text = format!("{text}{mark}");
                let record = Record { direction: Some(direction), ..record(frame) };
                assert_eq!(Record::parse(text.as_bytes()), Ok(record), "{text}");
                assert_eq!(record.encode().as_str(), text);
            }
        }
    }

    #[test]
    fn spellings_of_other_tools_are_read() {
        let frame = Frame::from_array(standard(0x0A5), [0x08, 0x4F]);
        let full = Frame::from_array(standard(0x0A5), [0x11; 8]);
        for (text, frame) in [
            ("(1700000000.123456) can0 0a5#08.4f\r\n", frame),
            ("  (1700000000.123456789)\tcan0   0A5#084F  \n", frame),
            ("(1700000000.123456) can0 0A5#1111111111111111_F", full),
            ("(1700000000.123456) can0 0A5#R8_9 R", Frame::remote(standard(0x0A5), 8).unwrap()),
        ] {
            let parsed = Record::parse(text.as_bytes()).unwrap();
            assert_eq!((parsed.at, parsed.frame), (AT, frame), "{text}");
        }
        let parsed = Record::parse(b"(0) vcan0 0A5#").unwrap();
        assert_eq!((parsed.at, parsed.bus.as_str()), (Instant::ZERO, "vcan0"));
        assert_eq!(Record::parse(b"(1.5) can0 0A5#").unwrap().at, Instant::from_micros(1_500_000));
    }

    #[test]
    fn error_frames_are_not_data_frames_and_keep_class_and_details() {
        assert_eq!(
            Record::parse(b"(1700000000.123456) can0 20000088#0000080000000000"),
            Err(ParseError::NotADataFrame { at: AT, class: 0x88, details: [0, 0, 8, 0, 0, 0, 0, 0] })
        );
    }

    #[test]
    fn can_fd_frames_keep_flags_and_data_and_are_written_back_unchanged() {
        let enable = [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFC];
        let fd = |brs, esi, data| Frame::new_fd(standard(1), FdFlags { brs, esi }, data).unwrap();
        let mut cases = vec![
            ("001##1FFFFFFFFFFFFFFFC".to_owned(), fd(true, false, &enable[..])),
            ("001##0".to_owned(), fd(false, false, &[])),
            ("001##3AB".to_owned(), fd(true, true, &[0xAB])),
        ];
        if CAPACITY == 64 {
            cases.push((format!("001##1{}", "5A".repeat(64)), fd(true, false, &[0x5A; 64])));
        }
        for (text, frame) in cases {
            let line = format!("(1700000000.123456) can0 {text}");
            assert_eq!(Record::parse(line.as_bytes()), Ok(record(frame)), "{text}");
            assert_eq!(record(frame).encode().as_str(), line);
        }
        // As newer kernels mark them.
        let parsed = Record::parse(b"(1700000000.123456) can0 001##5FF.FC").unwrap();
        assert_eq!(parsed.frame, fd(true, false, &[0xFF, 0xFC]));
    }

    #[test]
    fn wrong_lines_are_refused_with_column_and_wish() {
        for (text, column, expected) in [
            ("", 1, Expected::Byte(b'(')),
            ("1.0 can0 123#", 1, Expected::Byte(b'(')),
            ("(x) can0 123#", 2, Expected::Digit),
            ("(1.) can0 123#", 4, Expected::Digit),
            ("(99999999999999) can0 123#", 2, Expected::Seconds),
            ("(1.0 can0 123#", 5, Expected::Byte(b')')),
            ("(1.0)can0 123#", 6, Expected::Blank),
            ("(1.0) a_name_beyond_the_limit 123#", 7, Expected::BusName),
            ("(1.0) can0", 11, Expected::Blank),
            ("(1.0) can0 123", 15, Expected::Byte(b'#')),
            ("(1.0) can0 12#00", 12, Expected::Id),
            ("(1.0) can0 0123#00", 12, Expected::Id),
            ("(1.0) can0 123456789#", 20, Expected::Byte(b'#')),
            ("(1.0) can0 800#00", 12, Expected::StandardId),
            ("(1.0) can0 80000123#00", 12, Expected::ExtendedId),
            ("(1.0) can0 123#0", 17, Expected::DataByte),
            ("(1.0) can0 123#00.", 19, Expected::DataByte),
            ("(1.0) can0 123#0011223344556677FF", 32, Expected::AtMostEightBytes),
            ("(1.0) can0 123#00_9", 18, Expected::DataByte),
            ("(1.0) can0 123#0011223344556677_8", 33, Expected::Value),
            ("(1.0) can0 123#R9", 17, Expected::Dlc),
            ("(1.0) can0 123##", 17, Expected::HexDigit),
            ("(1.0) can0 123##1001122334455667788", 18, Expected::FdLength),
            ("(1.0) can0 123#00 X", 19, Expected::Direction),
            ("(1.0) can0 123#00 T x", 21, Expected::End),
        ] {
            match Record::parse(text.as_bytes()) {
                Err(ParseError::Syntax(error)) => {
                    assert_eq!((error.column, error.expected), (column, expected), "{text}: {error}");
                }
                other => panic!("{text}: {other:?}"),
            }
        }
    }

    #[test]
    fn the_longest_line_fits() {
        let text = Record {
            at: Instant::FAR_FUTURE,
            bus: BusName::new("a123456789012345").unwrap(),
            frame: Frame::new_fd(ExtendedId::MAX, FdFlags::BRS, &[0xFF; CAPACITY]).unwrap(),
            direction: Some(Direction::Sent),
        }
        .encode();
        assert!(!text.is_truncated());
        assert_eq!(text.as_str().len(), LINE_MAX);
        assert!(text.as_str().ends_with("FFFFFFFF T"), "{text}");
    }

    proptest! {
        #[test]
        fn every_record_survives_the_round_trip(us: u64, frame in arbitrary::any_frame(), direction in 0..3_usize) {
            let direction = [None, Some(Direction::Sent), Some(Direction::Received)][direction];
            let record = Record { at: Instant::from_micros(us), direction, ..record(frame) };
            let text = record.encode();
            prop_assert_eq!(Record::parse(text.as_bytes()), Ok(record));
            // The frame field is also what `Frame` prints.
            prop_assert!(text.as_str().contains(&frame.to_string()));
        }

        #[test]
        fn any_bytes_are_read_without_panic(bytes in arbitrary::bytes()) {
            let _ = Record::parse(&bytes);
        }

        #[test]
        fn damaged_lines_are_read_without_panic(index in 0_usize..35, byte: u8, len in 0_usize..=35) {
            let mut line = *b"(1700000000.123456) can0 0A5#084F64";
            line[index] = byte;
            let _ = Record::parse(&line[..len]);
        }
    }
}

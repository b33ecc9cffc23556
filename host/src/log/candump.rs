//! The text log, `candump -L` with directions.

use std::io::{self, BufRead, Write};

use can_link::BusError;
use protocol::text::BusName;
use protocol::text::candump::{Direction, ParseError, Record};
use protocol::{Frame, Instant};

use crate::bus::session::Way;

/// Name used where the bus has none that the format can carry.
const FALLBACK_BUS: &str = "can0";

/// Writes one line per frame. Times are the session's.
pub struct Log<W: Write> {
    out: io::BufWriter<W>,
    bus: String,
}

impl<W: Write> Log<W> {
    /// Log with `bus` as the name of the interface in each line.
    pub fn new(out: W, bus: String) -> Self {
        let bus = if BusName::new(&bus).is_ok() { bus } else { FALLBACK_BUS.to_owned() };
        Self { out: io::BufWriter::new(out), bus }
    }

    /// Writes a frame.
    ///
    /// # Errors
    /// The medium's.
    pub fn frame(&mut self, at: Instant, way: Way, frame: &Frame) -> io::Result<()> {
        let Ok(bus) = BusName::new(&self.bus) else { return Ok(()) };
        let direction = Some(match way {
            Way::Sent => Direction::Sent,
            Way::Received => Direction::Received,
        });
        let line = Record { at, bus, frame: *frame, direction }.encode();
        self.out.write_all(line.as_bytes())?;
        self.out.write_all(b"\n")
    }

    /// Writes an error of the bus as candump does: an error frame.
    ///
    /// # Errors
    /// The medium's.
    pub fn bus_error(&mut self, at: Instant, error: &BusError) -> io::Result<()> {
        let id = 0x2000_0000 | error.class & 0x1FFF_FFFF;
        let details: String = error.details.iter().map(|byte| format!("{byte:02X}")).collect();
        let (s, us) = (at.as_micros() / 1_000_000, at.as_micros() % 1_000_000);
        writeln!(self.out, "({s:010}.{us:06}) {} {id:08X}#{details}", self.bus)
    }

    /// Hands everything to the operating system.
    ///
    /// # Errors
    /// The medium's.
    pub fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}

/// A frame of a log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Line {
    /// Number in the file, from 1.
    pub number: usize,
    /// Time stamp.
    pub at: Instant,
    /// The frame.
    pub frame: Frame,
    /// Sent by the program that recorded; `None` if the log does not say.
    pub sent: Option<bool>,
}

/// Why a log cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The medium.
    #[error("{0}")]
    Io(#[from] io::Error),
    /// A line that is none.
    #[error("line {line}: {error}")]
    Line {
        /// Number, from 1.
        line: usize,
        /// What is wrong.
        error: ParseError,
    },
    /// Time runs backwards.
    #[error("line {line}: time {at} is before the line above it")]
    Backwards {
        /// Number, from 1.
        line: usize,
        /// Its time stamp.
        at: Instant,
    },
}

/// Reads the frames of a log; error frames and empty lines are left out.
///
/// # Errors
/// [`ReadError`] with the number of the line.
pub fn read(input: impl BufRead) -> Result<Vec<Line>, ReadError> {
    let mut lines = Vec::new();
    let mut last = Instant::ZERO;
    for (index, text) in input.split(b'\n').enumerate() {
        let (text, line) = (text?, index + 1);
        if text.trim_ascii().is_empty() {
            continue;
        }
        match Record::parse(&text) {
            Ok(record) if record.at < last => return Err(ReadError::Backwards { line, at: record.at }),
            Ok(record) => {
                last = record.at;
                let sent = record.direction.map(|direction| direction == Direction::Sent);
                lines.push(Line { number: line, at: record.at, frame: record.frame, sent });
            }
            Err(ParseError::NotADataFrame { .. }) => {}
            Err(error) => return Err(ReadError::Line { line, error }),
        }
    }
    Ok(lines)
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::StandardId;

    #[test]
    fn what_is_written_is_read_back_and_errors_of_the_bus_are_left_out() {
        let mut bytes = Vec::new();
        let mut log = Log::new(&mut bytes, "no such name!".to_owned());
        let frame = Frame::from_array(StandardId::from_low_bits(0x0A5), [8, 0x4F, 0x64]);
        log.frame(Instant::from_micros(17), Way::Received, &frame).unwrap();
        log.bus_error(Instant::from_micros(18), &BusError::from_class(0x20)).unwrap();
        log.flush().unwrap();
        drop(log);
        let lines = read(bytes.as_slice()).unwrap();
        assert_eq!(lines, [Line { number: 1, at: Instant::from_micros(17), frame, sent: Some(false) }]);
        assert!(String::from_utf8(bytes).unwrap().contains("20000020#0000000000000000"));
    }

    #[test]
    fn a_bad_line_is_named_by_its_number() {
        let text = "(0.000001) can0 0A5#00\n\nnonsense\n";
        assert!(read(text.as_bytes()).unwrap_err().to_string().starts_with("line 3: "));
        let text = "(0.000002) can0 0A5#00\n(0.000001) can0 0A5#00\n";
        assert!(read(text.as_bytes()).unwrap_err().to_string().contains("line 2: time 0.000001 is before"));
    }
}

//! The text log, `candump -L` with directions.

use std::io::{self, BufRead, Write};
use std::path::Path;

use can_link::BusError;
use protocol::text::BusName;
use protocol::text::candump::{Direction, ParseError, Record};
use protocol::{Duration, Frame, Instant};
use serde::Serialize;

use crate::tap::Way;

/// Name used if the bus has no name that the format can hold.
const FALLBACK_BUS: &str = "can0";

/// Writes one line per frame. Times are those of the wall clock where the session has one, as `candump -L` writes them; else
/// the session's virtual time.
pub struct Log<W: Write> {
    out: io::BufWriter<W>,
    bus: String,
    zero_unix: Duration,
}

impl<W: Write> Log<W> {
    /// Log with `bus` as the name of the interface in each line. `zero_unix` is the Unix time at the session's time zero;
    /// zero in virtual time.
    pub fn new(out: W, bus: String, zero_unix: Duration) -> Self {
        let bus = if BusName::new(&bus).is_ok() { bus } else { FALLBACK_BUS.to_owned() };
        Self { out: io::BufWriter::new(out), bus, zero_unix }
    }

    pub fn frame(&mut self, at: Instant, way: Way, frame: &Frame) -> io::Result<()> {
        let Ok(bus) = BusName::new(&self.bus) else { return Ok(()) };
        let direction = Some(match way {
            Way::Sent => Direction::Sent,
            Way::Received => Direction::Received,
        });
        let line = Record { at: at + self.zero_unix, bus, frame: *frame, direction }.encode();
        self.out.write_all(line.as_bytes())?;
        self.out.write_all(b"\n")
    }

    /// Writes an error of the bus as candump does: an error frame.
    pub fn bus_error(&mut self, at: Instant, error: &BusError) -> io::Result<()> {
        let id = 0x2000_0000 | error.class & 0x1FFF_FFFF;
        let details: String = error.details.iter().map(|byte| format!("{byte:02X}")).collect();
        let at_us = (at + self.zero_unix).as_micros();
        let (s, us) = (at_us / 1_000_000, at_us % 1_000_000);
        writeln!(self.out, "({s:010}.{us:06}) {} {id:08X}#{details}", self.bus)
    }

    /// Hands everything to the operating system.
    pub fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Line {
    /// Number in the file, from 1.
    pub number: usize,
    /// Time stamp.
    pub at: Instant,
    pub frame: Frame,
    /// Sent by the program that recorded; `None` if the log does not show it.
    pub sent: Option<bool>,
}

/// Longest line that is read, bytes. The longest line of a classical frame has less than a hundred.
pub const LINE_MAX_BYTES: usize = 1_024;
/// Most frames that are read: an hour of a full bus. They take about a gigabyte of memory.
pub const FRAMES_MAX: usize = 30_000_000;

/// What is left of a line at the end of a log that was cut off, by a kill or a loss of power.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Tear {
    /// Number of the line, from 1.
    pub line: usize,
    /// Where it begins in the file.
    pub offset_bytes: u64,
    /// Bytes of it that are there.
    pub left_bytes: usize,
}

impl std::fmt::Display for Tear {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { line, offset_bytes, left_bytes } = self;
        write!(
            f,
            "the log is cut off in line {line} (byte {offset_bytes}, {left_bytes} bytes left of it); everything before is \
             read"
        )
    }
}

/// A log that was read.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Recording {
    /// Its frames, in ascending time.
    pub lines: Vec<Line>,
    /// Where it was cut off.
    pub tear: Option<Tear>,
}

/// Why a log cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The medium.
    #[error("{0}")]
    Io(#[from] io::Error),
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
    #[error("line {line} has more than {LINE_MAX_BYTES} bytes")]
    LongLine {
        /// Number, from 1.
        line: usize,
    },
    /// More than fits in memory.
    #[error("the log has more than {FRAMES_MAX} frames")]
    TooMany,
}

impl ReadError {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        Some(match self {
            Self::LongLine { .. } => "name a candump log (`candump -L`, `cubectl log record`)".to_owned(),
            Self::Io(error) => return toml_reader::next_of_file(error).map(str::to_owned),
            Self::TooMany => "cut the part of interest out of it (`split -l`)".to_owned(),
            _ => return None,
        })
    }
}

/// Reads the frames of a log; error frames and empty lines are left out. A last line without its end is not an
/// error: everything before it is read, and [`Recording::tear`] reports it.
///
/// # Errors
/// [`ReadError`] with the number of the line.
pub fn read(mut input: impl BufRead) -> Result<Recording, ReadError> {
    let mut recording = Recording::default();
    let (mut last, mut offset_bytes) = (Instant::ZERO, 0_u64);
    let mut text = Vec::new();
    for line in 1.. {
        text.clear();
        let most = LINE_MAX_BYTES as u64 + 1;
        let read_bytes = io::Read::take(&mut input, most).read_until(b'\n', &mut text)?;
        if read_bytes == 0 {
            break;
        }
        let tear = Tear { line, offset_bytes, left_bytes: read_bytes };
        offset_bytes += read_bytes as u64;
        let ended = text.last() == Some(&b'\n');
        // After a loss of power some file systems leave zeros at the end.
        let cut_off = !ended && (input.fill_buf()?.is_empty() || text.contains(&0));
        if !ended && !cut_off {
            return Err(ReadError::LongLine { line });
        }
        if text.trim_ascii().is_empty() {
            continue;
        }
        match Record::parse(&text) {
            // Only a direction shows that the data before it is whole.
            Ok(record) if cut_off && (record.direction.is_none() || record.at < last) => {
                recording.tear = Some(tear);
                break;
            }
            Ok(record) if record.at < last => return Err(ReadError::Backwards { line, at: record.at }),
            Ok(record) => {
                last = record.at;
                let sent = record.direction.map(|direction| direction == Direction::Sent);
                recording.lines.push(Line { number: line, at: record.at, frame: record.frame, sent });
            }
            Err(_) if cut_off => {
                recording.tear = Some(tear);
                break;
            }
            Err(ParseError::NotADataFrame { .. }) => {}
            Err(error) => return Err(ReadError::Line { line, error }),
        }
        if recording.lines.len() > FRAMES_MAX {
            return Err(ReadError::TooMany);
        }
    }
    Ok(recording)
}

/// A text log that cannot be read.
#[derive(Debug, thiserror::Error)]
#[error("{}: {cause}", path.display())]
pub struct UnreadableFile {
    pub path: std::path::PathBuf,
    /// The error, with the line if there is one.
    pub cause: String,
    /// What to do.
    pub next: Option<String>,
}

/// Reads the log at `path`.
///
/// # Errors
/// The file and its error.
pub fn read_file(path: &Path) -> Result<Recording, UnreadableFile> {
    let refuse = |cause: String, next| UnreadableFile { path: path.to_owned(), cause, next };
    let file = std::fs::File::open(path)
        .map_err(ReadError::from)
        .map_err(|error| refuse(error.to_string(), error.next()))?;
    // A device, to which a recording can be written, has no end to read to.
    if file.metadata().is_ok_and(|found| !found.is_file()) {
        return Err(refuse("not a file that can be read again".to_owned(), None));
    }
    read(io::BufReader::new(file)).map_err(|error| refuse(error.to_string(), error.next()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::StandardId;

    #[test]
    fn what_is_written_is_read_back_and_errors_of_the_bus_are_left_out() {
        let mut bytes = Vec::new();
        let mut log = Log::new(&mut bytes, "no such name!".to_owned(), Duration::ZERO);
        let frame = Frame::from_array(StandardId::from_low_bits(0x0A5), [8, 0x4F, 0x64]);
        log.frame(Instant::from_micros(17), Way::Received, &frame).unwrap();
        log.bus_error(Instant::from_micros(18), &BusError::from_class(0x20)).unwrap();
        log.flush().unwrap();
        drop(log);
        let lines = read(bytes.as_slice()).unwrap().lines;
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

    #[test]
    fn a_log_that_is_cut_off_anywhere_is_read_up_to_there_and_the_tear_is_reported() {
        let text = "(0.000001) can0 0A5#0102030405060708 R\n(0.000002) can0 0A5#0A0B T\n";
        let whole = read(text.as_bytes()).unwrap();
        assert_eq!((whole.lines.len(), whole.tear), (2, None));
        let first = text.find('\n').unwrap() + 1;
        for cut in 1..text.len() {
            let found = read(&text.as_bytes()[..cut]).unwrap();
            // A frame whose line is there up to its direction is whole; nothing else is taken.
            let lines = usize::from(cut + 1 >= first) + usize::from(cut + 1 >= text.len());
            assert_eq!(found.lines, whole.lines[..lines], "cut at {cut}");
            let is_torn = !(cut + 1 == first || cut == first || cut + 1 >= text.len());
            let begin = if cut < first { 0 } else { first };
            let tear = Tear {
                line: if begin == 0 { 1 } else { 2 },
                offset_bytes: begin as u64,
                left_bytes: cut - begin,
            };
            assert_eq!(found.tear, is_torn.then_some(tear), "cut at {cut}");
        }
        // What some file systems leave after a loss of power.
        let zeros = [text.as_bytes(), &[0; 70_000]].concat();
        let found = read(zeros.as_slice()).unwrap();
        assert_eq!((found.lines.len(), found.tear.unwrap().line), (2, 3));
        // In the middle it is an error.
        assert!(read("(0.000001) can0 0A5#01\n(0.0\n(0.000002) can0 0A5#0A0B T\n".as_bytes()).is_err());
    }

    #[test]
    fn a_line_that_is_too_long_is_refused_without_reading_it() {
        struct Endless(u64);
        impl io::Read for Endless {
            fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
                out.fill(b'a');
                self.0 += out.len() as u64;
                assert!(self.0 < 100_000, "read on");
                Ok(out.len())
            }
        }
        let error = read(io::BufReader::new(Endless(0))).unwrap_err();
        assert!(error.to_string() == "line 1 has more than 1024 bytes" && error.next().is_some(), "{error}");
    }
}

//! The log of an exchange: all input and output of a station, so that it can be run again.
//!
//! Text, one line each: time in us, a letter, and for telegrams and answers their bytes (control characters and bytes that are
//! not ASCII are written as `\n`, `\x00`, ...).
//!
//! | letter | what |
//! |---|---|
//! | `F` | one more trajectory file to run |
//! | `N` | a segment with which the last one goes on |
//! | `E` | a new end state for the motion that runs |
//! | `C` | the telegram that follows comes from another socket than the ones before |
//! | `W` | a telegram that waited behind a newer one |
//! | `R` | the newest telegram; the station had to answer it |
//! | `A` | the answer |
//! | `T` | a deadline of the station |
//! | `S` | stopped by the host |
//! | `O`, `G` | the gripper was ordered open, closed |
//! | `H`, `P` | the last trajectory is held at its start, may be run |
//! | `L` | the robot's program was ordered to end |

use std::fmt::Write as _;

use protocol::Instant;

/// First line of a log.
pub const HEAD: &str = "# cubectl rsi log 1";
/// Longest log that is read, bytes: an hour of 4 ms cycles takes 600 MB, a throw 2 MB.
pub const FILE_MAX_BYTES: u64 = 1 << 30;

#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Entry {
    /// A trajectory file to run.
    File(Vec<u8>),
    /// A segment with which it goes on.
    Segment(Vec<u8>),
    /// A new end state in flight, as on the wire (`cubecell.TargetState`).
    Target(Vec<u8>),
    /// The next telegram comes from another socket than the ones before.
    NewConnection,
    /// A telegram that waited behind a newer one.
    Waited(Vec<u8>),
    Telegram(Vec<u8>),
    Answer(Vec<u8>),
    /// A deadline.
    Timeout,
    /// Stopped by the host.
    Stop,
    /// The gripper was ordered open or closed.
    Gripper(bool),
    /// The last trajectory is held at its start.
    Hold,
    /// The last trajectory may be run.
    Proceed,
    /// The robot's program was ordered to end.
    Leave,
}

/// One entry with its time on the station's clock.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Line {
    pub at: Instant,
    pub entry: Entry,
}

/// A line of a log cannot be read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: {problem}")]
pub struct LogError {
    /// Line, from 1.
    pub line: usize,
    /// What is wrong with it.
    pub problem: &'static str,
}

impl Line {
    /// The line as text, with its end.
    #[must_use]
    pub fn to_text(&self) -> String {
        let (letter, bytes) = match &self.entry {
            Entry::File(bytes) => ('F', Some(bytes)),
            Entry::Segment(bytes) => ('N', Some(bytes)),
            Entry::Target(bytes) => ('E', Some(bytes)),
            Entry::NewConnection => ('C', None),
            Entry::Waited(bytes) => ('W', Some(bytes)),
            Entry::Telegram(bytes) => ('R', Some(bytes)),
            Entry::Answer(bytes) => ('A', Some(bytes)),
            Entry::Timeout => ('T', None),
            Entry::Stop => ('S', None),
            Entry::Gripper(true) => ('O', None),
            Entry::Gripper(false) => ('G', None),
            Entry::Hold => ('H', None),
            Entry::Proceed => ('P', None),
            Entry::Leave => ('L', None),
        };
        let mut text = format!("{} {letter}", self.at.as_micros());
        if let Some(bytes) = bytes {
            text.push(' ');
            for &byte in bytes {
                match byte {
                    b'\\' => text.push_str("\\\\"),
                    b' '..=b'~' => text.push(char::from(byte)),
                    _ => {
                        let _ = write!(text, "\\x{byte:02x}");
                    }
                }
            }
        }
        text.push('\n');
        text
    }

    fn parse(text: &str) -> Result<Self, &'static str> {
        let (at, rest) = text.split_once(' ').ok_or("no time and letter")?;
        let at = Instant::from_micros(at.parse().map_err(|_| "the time is no number")?);
        let (letter, bytes) = match rest.split_once(' ') {
            Some((letter, bytes)) => (letter, Some(unescaped(bytes)?)),
            None => (rest, None),
        };
        let entry = match (letter, bytes) {
            ("F", Some(bytes)) => Entry::File(bytes),
            ("N", Some(bytes)) => Entry::Segment(bytes),
            ("E", Some(bytes)) => Entry::Target(bytes),
            ("C", None) => Entry::NewConnection,
            ("W", Some(bytes)) => Entry::Waited(bytes),
            ("R", Some(bytes)) => Entry::Telegram(bytes),
            ("A", Some(bytes)) => Entry::Answer(bytes),
            ("T", None) => Entry::Timeout,
            ("S", None) => Entry::Stop,
            ("O", None) => Entry::Gripper(true),
            ("G", None) => Entry::Gripper(false),
            ("H", None) => Entry::Hold,
            ("P", None) => Entry::Proceed,
            ("L", None) => Entry::Leave,
            _ => return Err("no such entry"),
        };
        Ok(Self { at, entry })
    }
}

fn unescaped(text: &str) -> Result<Vec<u8>, &'static str> {
    let mut out = Vec::with_capacity(text.len());
    let mut rest = text.bytes();
    while let Some(byte) = rest.next() {
        if byte != b'\\' {
            out.push(byte);
            continue;
        }
        match rest.next() {
            Some(b'\\') => out.push(b'\\'),
            Some(b'x') => {
                let digits = [rest.next().unwrap_or(0), rest.next().unwrap_or(0)];
                let digits = std::str::from_utf8(&digits).unwrap_or_default();
                out.push(u8::from_str_radix(digits, 16).map_err(|_| "a byte after \\x is no number")?);
            }
            _ => return Err("a backslash that escapes nothing"),
        }
    }
    Ok(out)
}

/// Reads a log. A last line without an end was cut off and is left out.
///
/// # Errors
/// Another head, or a line that is not valid.
pub fn parse(text: &str) -> Result<Vec<Line>, LogError> {
    let whole = text.rfind('\n').map_or("", |end| &text[..end]);
    let mut lines = whole.lines().zip(1..);
    if lines.next().map(|(head, _)| head) != Some(HEAD) {
        return Err(LogError { line: 1, problem: "not the head of an RSI log" });
    }
    lines
        .filter(|(line, _)| !line.is_empty())
        .map(|(line, number)| Line::parse(line).map_err(|problem| LogError { line: number, problem }))
        .collect()
}

/// A log as text.
#[must_use]
pub fn to_text(lines: &[Line]) -> String {
    let mut text = format!("{HEAD}\n");
    text.extend(lines.iter().map(Line::to_text));
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_entry_is_read_back_and_a_torn_last_line_is_left_out() {
        let bytes = b"<Rob a=\"1\\\">\r\n\xff</Rob>".to_vec();
        let entries = [
            Entry::File(vec![0, 255, b'\\']),
            Entry::Segment(vec![0, 10]),
            Entry::Target(vec![7, 0, 200]),
            Entry::NewConnection,
            Entry::Waited(bytes.clone()),
            Entry::Telegram(bytes.clone()),
            Entry::Answer(bytes),
            Entry::Timeout,
            Entry::Stop,
            Entry::Gripper(true),
            Entry::Gripper(false),
            Entry::Hold,
            Entry::Proceed,
            Entry::Leave,
        ];
        let lines: Vec<Line> = (0..)
            .zip(entries)
            .map(|(k, entry)| Line { at: Instant::from_micros(12_000 * k), entry })
            .collect();
        let text = to_text(&lines);
        assert_eq!(parse(&text), Ok(lines.clone()));
        assert_eq!(parse(&text[..text.len() - 1]), Ok(lines[..lines.len() - 1].to_vec()));
    }

    #[test]
    fn other_texts_are_refused_with_the_line() {
        assert_eq!(parse("x\n").unwrap_err().line, 1);
        for wrong in ["R", "1 Q", "x R <Rob/>", "1 R a\\q", "1 R a\\xg1", "1 T more"] {
            let error = parse(&format!("{HEAD}\n1 T\n{wrong}\n")).unwrap_err();
            assert_eq!(error.line, 3, "{wrong}");
        }
    }
}

//! Cuts a byte stream into lines, within a fixed buffer.

use super::{BELL, CR, LINE_MAX};

/// What [`Assembler::push`] completed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Assembled<'a> {
    /// A line without its end; may be empty.
    Line(&'a [u8]),
    /// A BELL; bytes of an unfinished line before it are dropped.
    Bell,
    /// A line longer than [`LINE_MAX`]; it is dropped up to its end.
    Overlong,
}

/// Collects bytes of a serial line until a line of text is complete.
///
/// CR ends a line. LF does too, for terminals that send it; an LF right after a CR is ignored. Garbage destroys
/// only the line that it falls into.
#[derive(Clone, Debug)]
pub struct Assembler {
    bytes: [u8; LINE_MAX],
    len: usize,
    /// The line is too long: bytes are dropped up to its end.
    skipping: bool,
    after_cr: bool,
}

impl Assembler {
    /// Waits for the first byte of a line.
    pub const fn new() -> Self {
        Self { bytes: [0; LINE_MAX], len: 0, skipping: false, after_cr: false }
    }

    /// Takes the next byte; at most one line can end at it.
    pub fn push(&mut self, byte: u8) -> Option<Assembled<'_>> {
        let after_cr = core::mem::replace(&mut self.after_cr, byte == CR);
        match byte {
            b'\n' if after_cr => None,
            CR | b'\n' => {
                let len = core::mem::take(&mut self.len);
                if core::mem::take(&mut self.skipping) {
                    return None;
                }
                self.bytes.get(..len).map(Assembled::Line)
            }
            BELL => {
                self.len = 0;
                self.skipping = false;
                Some(Assembled::Bell)
            }
            _ if self.skipping => None,
            _ => match self.bytes.get_mut(self.len) {
                Some(slot) => {
                    *slot = byte;
                    self.len += 1;
                    None
                }
                None => {
                    self.len = 0;
                    self.skipping = true;
                    Some(Assembled::Overlong)
                }
            },
        }
    }
}

impl Default for Assembler {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lines(stream: &[u8]) -> Vec<String> {
        let mut assembler = Assembler::new();
        let mut all = Vec::new();
        for byte in stream {
            match assembler.push(*byte) {
                Some(Assembled::Line(line)) => all.push(String::from_utf8_lossy(line).into_owned()),
                Some(Assembled::Bell) => all.push("bell".to_owned()),
                Some(Assembled::Overlong) => all.push("overlong".to_owned()),
                None => {}
            }
        }
        all
    }

    #[test]
    fn cr_lf_and_both_end_a_line_once() {
        assert_eq!(lines(b"O\rC\r\nV\nN\r\rF"), ["O", "C", "V", "N", ""]);
    }

    #[test]
    fn a_bell_stands_alone_and_drops_what_was_begun() {
        assert_eq!(lines(b"\r\x07t12\x07z\r"), ["", "bell", "bell", "z"]);
    }

    #[test]
    fn an_overlong_line_is_reported_once_and_the_next_one_is_read() {
        let mut stream = vec![b'x'; 10_000];
        stream.extend_from_slice(b"\rt1230\r");
        assert_eq!(lines(&stream), ["overlong", "t1230"]);
        let mut stream = vec![b'x'; 10_000];
        stream.extend_from_slice(b"\x07t1230\r");
        assert_eq!(lines(&stream), ["overlong", "bell", "t1230"]);
    }

    #[test]
    fn a_line_of_exactly_the_limit_passes() {
        let mut stream = vec![b'x'; LINE_MAX];
        stream.push(b'\r');
        assert_eq!(lines(&stream)[0].len(), LINE_MAX);
        stream.insert(0, b'x');
        assert_eq!(lines(&stream), ["overlong"]);
    }
}

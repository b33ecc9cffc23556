//! Cuts a byte stream into bracketed messages, within a fixed buffer.

use super::MESSAGE_MAX;

/// What [`Assembler::push`] completed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Assembled<'a> {
    /// A whole message from `<` to `>`.
    Message(&'a [u8]),
    /// A message longer than [`MESSAGE_MAX`]; it is dropped up to the next `<`.
    Overlong,
}

/// Collects bytes of a TCP stream until a message is whole.
///
/// Bytes outside brackets are dropped; blanks and line ends between messages are normal, anything
/// else counts as garbage. A `<` always starts a message, so that one lost `>` costs one message.
#[derive(Clone, Debug)]
pub struct Assembler {
    bytes: [u8; MESSAGE_MAX],
    /// Zero while no message is open, else the number of bytes from its `<` on.
    len: usize,
    garbage: u64,
}

impl Assembler {
    /// Waits for the first `<`.
    pub const fn new() -> Self {
        Self { bytes: [0; MESSAGE_MAX], len: 0, garbage: 0 }
    }

    /// Takes the next byte of the stream; at most one message can end at it.
    pub fn push(&mut self, byte: u8) -> Option<Assembled<'_>> {
        if byte == b'<' {
            self.count_garbage(self.len);
            self.len = 0;
        } else if self.len == 0 {
            self.count_garbage(usize::from(!byte.is_ascii_whitespace()));
            return None;
        }
        let Some(slot) = self.bytes.get_mut(self.len) else {
            self.count_garbage(self.len + 1);
            self.len = 0;
            return Some(Assembled::Overlong);
        };
        *slot = byte;
        self.len += 1;
        if byte != b'>' {
            return None;
        }
        let len = core::mem::take(&mut self.len);
        self.bytes.get(..len).map(Assembled::Message)
    }

    /// Bytes dropped so far because they belong to no message.
    pub const fn garbage_bytes(&self) -> u64 {
        self.garbage
    }

    fn count_garbage(&mut self, bytes: usize) {
        self.garbage = self.garbage.saturating_add(bytes as u64);
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

    fn messages(stream: &[u8]) -> (Vec<String>, u64) {
        let mut assembler = Assembler::new();
        let mut all = Vec::new();
        for byte in stream {
            match assembler.push(*byte) {
                Some(Assembled::Message(text)) => all.push(String::from_utf8_lossy(text).into_owned()),
                Some(Assembled::Overlong) => all.push("overlong".to_owned()),
                None => {}
            }
        }
        (all, assembler.garbage_bytes())
    }

    #[test]
    fn messages_come_out_whole_however_the_stream_is_chopped() {
        let (all, garbage) = messages(b"< open can0 >< rawmode >\r\n < echo >");
        assert_eq!(all, ["< open can0 >", "< rawmode >", "< echo >"]);
        assert_eq!(garbage, 0);
    }

    #[test]
    fn a_lost_closing_bracket_costs_one_message() {
        let (all, garbage) = messages(b"< send 123 < echo >");
        assert_eq!((all.as_slice(), garbage), (&["< echo >".to_owned()][..], 11));
    }

    #[test]
    fn bytes_outside_brackets_are_counted_and_dropped() {
        let (all, garbage) = messages(b"GET / HTTP/1.1\r\n\r\n< echo >x");
        assert_eq!((all.as_slice(), garbage), (&["< echo >".to_owned()][..], 13));
    }

    #[test]
    fn an_endless_message_is_reported_once_and_the_next_one_is_read() {
        let mut stream = b"< ".to_vec();
        stream.resize(10_000, b'a');
        stream.extend_from_slice(b"> < echo >");
        let (all, garbage) = messages(&stream);
        assert_eq!(all, ["overlong", "< echo >"]);
        assert_eq!(garbage, 10_001);
    }

    #[test]
    fn a_message_of_exactly_the_limit_passes() {
        let mut stream = b"<".to_vec();
        stream.resize(MESSAGE_MAX - 1, b'a');
        stream.push(b'>');
        assert_eq!(messages(&stream).0.first().map(String::len), Some(MESSAGE_MAX));
        stream.insert(1, b'a');
        assert_eq!(messages(&stream).0, ["overlong"]);
    }
}

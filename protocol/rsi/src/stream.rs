//! Documents out of a TCP byte stream: back to back, in pieces, or torn.

use crate::MAX_READ_BYTES;

/// What the stream holds next.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StreamItem {
    Document(Vec<u8>),
    /// Bytes that are not part of a whole document: a torn document, or data between two documents.
    Dropped(usize),
}

/// Length of `<Rob` and `<Sen`.
const ROOT_BYTES: usize = 4;

/// Where in the document the next byte is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Place {
    /// Between documents, or in text.
    Text,
    /// After `<`.
    Open,
    /// In a start tag; the last byte was `/` or not.
    Start { slash: bool },
    /// In an attribute value of a start tag.
    Quoted { quote: u8 },
    /// In an end tag.
    End,
    /// In `<? ... ?>`; the last byte was `?` or not.
    Instruction { question: bool },
    /// After `<!`.
    Declaration,
    /// After `<!-`.
    CommentOpen,
    /// In a comment, after this many `-` in a row.
    Comment { dashes: u8 },
}

/// Cuts a byte stream into documents.
///
/// It follows tags, quotes and comments, so it finds the end of a document without knowing its names. A `<` inside
/// a tag, and a `<Rob` or `<Sen` inside a document, begin a new document: the one before was torn. It holds at most
/// one document of [`MAX_READ_BYTES`]; a longer one is dropped.
#[derive(Clone, Debug)]
pub struct Framer {
    document: Vec<u8>,
    place: Place,
    depth: usize,
    dropped: usize,
}

impl Default for Framer {
    fn default() -> Self {
        Self::new()
    }
}

impl Framer {
    /// At the beginning of a stream.
    #[must_use]
    pub fn new() -> Self {
        Self { document: Vec::new(), place: Place::Text, depth: 0, dropped: 0 }
    }

    /// Takes bytes as they arrive and returns the items that they complete, in order.
    pub fn push(&mut self, bytes: &[u8]) -> Vec<StreamItem> {
        let mut items = Vec::new();
        for &byte in bytes {
            self.byte(byte, &mut items);
        }
        self.tell_dropped(&mut items);
        items
    }

    /// Bytes of a document that is not whole yet.
    #[must_use]
    pub fn pending(&self) -> usize {
        self.document.len()
    }

    fn byte(&mut self, byte: u8, items: &mut Vec<StreamItem>) {
        if byte == b'<' && self.begins_anew() {
            self.drop_document();
        }
        if self.document.is_empty() && byte != b'<' {
            // White space and NUL between documents are usual; other bytes are counted as dropped.
            self.dropped += usize::from(!byte.is_ascii_whitespace() && byte != 0);
            return;
        }
        if self.names_a_root_inside(byte) {
            let torn = self.document.len() - ROOT_BYTES;
            self.dropped += torn;
            self.document.drain(..torn);
            self.depth = 0;
        }
        self.document.push(byte);
        self.place = self.next(byte);
        let whole = self.is_whole(byte);
        // An end tag alone is the rest of a document that was dropped.
        if self.document.len() > MAX_READ_BYTES || (whole && self.document.starts_with(b"</")) {
            self.drop_document();
        } else if whole {
            self.tell_dropped(items);
            items.push(StreamItem::Document(std::mem::take(&mut self.document)));
        }
    }

    /// A `<` cannot stand inside a tag, so the document before it was torn.
    fn begins_anew(&self) -> bool {
        matches!(
            self.place,
            Place::Open | Place::Start { .. } | Place::Quoted { .. } | Place::End | Place::Declaration
        )
    }

    /// A start tag `<Rob` or `<Sen` inside another document.
    fn names_a_root_inside(&self, next: u8) -> bool {
        let name_ends = next.is_ascii_whitespace() || matches!(next, b'>' | b'/');
        let in_tag = self.depth > 0 && matches!(self.place, Place::Start { .. });
        name_ends && in_tag && (self.document.ends_with(b"<Rob") || self.document.ends_with(b"<Sen"))
    }

    fn next(&mut self, byte: u8) -> Place {
        match (self.place, byte) {
            (Place::Text, b'<') => Place::Open,
            (Place::Text, _) => Place::Text,
            (Place::Open, b'/') => Place::End,
            (Place::Open, b'?') => Place::Instruction { question: false },
            (Place::Open, b'!') => Place::Declaration,
            (Place::Open, _) => Place::Start { slash: false },
            (Place::Start { .. }, b'"' | b'\'') => Place::Quoted { quote: byte },
            (Place::Start { slash }, b'>') => {
                self.depth += usize::from(!slash);
                Place::Text
            }
            (Place::Start { .. }, _) => Place::Start { slash: byte == b'/' },
            (Place::Quoted { quote }, _) if byte == quote => Place::Start { slash: false },
            (Place::Quoted { quote }, _) => Place::Quoted { quote },
            (Place::End, b'>') => {
                self.depth = self.depth.saturating_sub(1);
                Place::Text
            }
            (Place::End, _) => Place::End,
            (Place::Instruction { question: true }, b'>') => Place::Text,
            (Place::Instruction { .. }, _) => Place::Instruction { question: byte == b'?' },
            (Place::Declaration, b'-') => Place::CommentOpen,
            (Place::CommentOpen, b'-') => Place::Comment { dashes: 0 },
            (Place::Declaration | Place::CommentOpen, b'>') => Place::Text,
            (Place::Declaration | Place::CommentOpen, _) => Place::Declaration,
            (Place::Comment { dashes: 2.. }, b'>') => Place::Text,
            (Place::Comment { dashes }, b'-') => Place::Comment { dashes: dashes.saturating_add(1).min(2) },
            (Place::Comment { .. }, _) => Place::Comment { dashes: 0 },
        }
    }

    /// The last byte closed the root element: an end tag or `/>` at depth zero. A declaration or comment before the
    /// root ends with `>` too, but not with a tag.
    fn is_whole(&self, byte: u8) -> bool {
        byte == b'>' && self.place == Place::Text && self.depth == 0 && !self.is_prolog()
    }

    /// Only declarations and comments so far. They end with `?>`, `-->` or the `>` of `<!`; the byte after the last
    /// `<` distinguishes them.
    fn is_prolog(&self) -> bool {
        let last = self.document.iter().rposition(|byte| *byte == b'<');
        let after = last.and_then(|at| self.document.get(at + 1));
        matches!(after, Some(b'?' | b'!')) || self.document.ends_with(b"-->")
    }

    fn drop_document(&mut self) {
        self.dropped += self.document.len();
        self.document.clear();
        self.place = Place::Text;
        self.depth = 0;
    }

    fn tell_dropped(&mut self, items: &mut Vec<StreamItem>) {
        if self.dropped > 0 {
            items.push(StreamItem::Dropped(std::mem::take(&mut self.dropped)));
        }
    }
}

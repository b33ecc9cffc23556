//! Service data in blocks, frame by frame (CiA 301, 7.2.4.3.13 to 15). Only what a host needs to read.
//!
//! ```text
//! host  read    101 00 c 00   index sub  segments 0    node  110 00 c s 0   index sub  size 4
//! host  start   101 000 11    0
//! node  segment l nnnnnnn     7 bytes, up to as many as the host takes in a block
//! host  taken   101 000 10    last number in order, segments of the next block
//! node  end     110 nnn 01    check sum 2              host  ended   101 000 01
//! c: with a check sum; s: the size is known; l: the last one; nnnnnnn: 1 to 127; nnn: bytes of the last one that are not used
//! ```

use crate::Frame;

use super::Object;
use super::id::{Function, NodeId};

/// Most segments of a block.
pub const SEGMENTS_MAX: u8 = 127;

const OF_HOST: u8 = 0xA0;
const OF_NODE: u8 = 0xC0;
const SPECIFIER: u8 = 0xE0;
const HAS_CHECK: u8 = 1 << 2;
const HAS_SIZE: u8 = 1 << 1;
const LAST: u8 = 0x80;

/// What a host sends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BlockRequest {
    /// Begins to read; the host computes the check sum.
    Read {
        /// What is read.
        object: Object,
        /// Segments of a block, 1 to [`SEGMENTS_MAX`].
        segments: u8,
    },
    /// The first block may come.
    Start,
    /// A block has come.
    Taken {
        /// The last segment that came in order; 0: none.
        last: u8,
        /// Segments of the next block.
        segments: u8,
    },
    /// The end has come.
    Ended,
}

impl BlockRequest {
    /// The frame to `node`.
    #[must_use]
    pub fn encode(&self, node: NodeId) -> Frame {
        let data = match *self {
            Self::Read { object, segments } => {
                let [low, high] = object.index.to_le_bytes();
                [OF_HOST | HAS_CHECK, low, high, object.sub, segments, 0, 0, 0]
            }
            Self::Start => [OF_HOST | 3, 0, 0, 0, 0, 0, 0, 0],
            Self::Taken { last, segments } => [OF_HOST | 2, last, segments, 0, 0, 0, 0, 0],
            Self::Ended => [OF_HOST | 1, 0, 0, 0, 0, 0, 0, 0],
        };
        Function::SdoToNode(node).frame(data)
    }

    /// The request of a frame to a node, and the node.
    #[must_use]
    pub fn decode(from: &Frame) -> Option<(NodeId, Self)> {
        let Function::SdoToNode(node) = Function::of_frame(from)? else { return None };
        let [head, a, b, sub, segments, ..] = *from.data().first_chunk::<8>()?;
        if head & SPECIFIER != OF_HOST {
            return None;
        }
        let request = match head & 0b11 {
            0 => Self::Read { object: Object::new(u16::from_le_bytes([a, b]), sub), segments },
            1 => Self::Ended,
            2 => Self::Taken { last: a, segments: b },
            _ => Self::Start,
        };
        Some((node, request))
    }
}

/// What a node answers, but for the segments.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BlockAnswer {
    /// To [`BlockRequest::Read`].
    Begins {
        /// What is read.
        object: Object,
        /// Its bytes.
        size: Option<u32>,
        /// The end has a check sum.
        has_check: bool,
    },
    /// To the [`BlockRequest::Taken`] of the last segment.
    Ends {
        /// Bytes of the last segment that are not used, 0 to 7.
        unused: u8,
        /// CRC-16 of all bytes: polynomial 0x1021, from 0.
        check: u16,
    },
}

impl BlockAnswer {
    /// The frame of `node`.
    #[must_use]
    pub fn encode(&self, node: NodeId) -> Frame {
        let data = match *self {
            Self::Begins { object, size, has_check } => {
                let ([low, high], [a, b, c, d]) =
                    (object.index.to_le_bytes(), size.unwrap_or(0).to_le_bytes());
                let check = if has_check { HAS_CHECK } else { 0 };
                let known = if size.is_some() { HAS_SIZE } else { 0 };
                [OF_NODE | check | known, low, high, object.sub, a, b, c, d]
            }
            Self::Ends { unused, check } => {
                let [low, high] = check.to_le_bytes();
                [OF_NODE | (unused & 0b111) << 2 | 1, low, high, 0, 0, 0, 0, 0]
            }
        };
        Function::SdoFromNode(node).frame(data)
    }

    /// The answer of a node, and the node. While a block comes each frame is a [`BlockSegment`].
    #[must_use]
    pub fn decode(from: &Frame) -> Option<(NodeId, Self)> {
        let Function::SdoFromNode(node) = Function::of_frame(from)? else { return None };
        let [head, a, b, sub, c, d, e, f] = *from.data().first_chunk::<8>()?;
        if head & SPECIFIER != OF_NODE {
            return None;
        }
        let answer = if head & 1 == 0 {
            Self::Begins {
                object: Object::new(u16::from_le_bytes([a, b]), sub),
                size: (head & HAS_SIZE != 0).then(|| u32::from_le_bytes([c, d, e, f])),
                has_check: head & HAS_CHECK != 0,
            }
        } else {
            Self::Ends { unused: head >> 2 & 0b111, check: u16::from_le_bytes([a, b]) }
        };
        Some((node, answer))
    }
}

/// Seven bytes of a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BlockSegment {
    /// Place in the block, 1 to [`SEGMENTS_MAX`].
    pub number: u8,
    /// The value ends with it.
    pub last: bool,
    /// Bytes.
    pub bytes: [u8; 7],
}

impl BlockSegment {
    /// The frame of `node`.
    #[must_use]
    pub fn encode(&self, node: NodeId) -> Frame {
        let [a, b, c, d, e, f, g] = self.bytes;
        let last = if self.last { LAST } else { 0 };
        Function::SdoFromNode(node).frame([last | self.number & !LAST, a, b, c, d, e, f, g])
    }

    /// The segment of a node, and the node. `None`: another frame, or an abort, whose number would be 0.
    #[must_use]
    pub fn decode(from: &Frame) -> Option<(NodeId, Self)> {
        let Function::SdoFromNode(node) = Function::of_frame(from)? else { return None };
        let [head, bytes @ ..] = *from.data().first_chunk::<8>()?;
        let number = head & !LAST;
        (number > 0).then_some((node, Self { number, last: head & LAST != 0, bytes }))
    }
}

//! Service data, frame by frame (CiA 301, 7.2.4).
//!
//! ```text
//! host  write   001 0 nn e s  index sub  value 4 or size 4      node  011 00000  index sub 0
//! host  segment 000 t nnn c   7 bytes                           node  001 t 0000
//! host  read    010 00000     index sub 0                       node  010 0 nn e s  index sub  value 4 or size 4
//! host  next    011 t 0000    0                                 node  000 t nnn c   7 bytes
//! both  abort   100 00000     index sub  code 4
//! e: the value is here; s: its size is known; nn, nnn: bytes that are not used; t toggles; c: the last one
//! ```

use core::fmt;

use crate::Frame;

use super::Object;
use super::id::{Function, NodeId};

/// Up to `N` bytes.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Bytes<const N: usize> {
    bytes: [u8; N],
    len: u8,
}

impl<const N: usize> Bytes<N> {
    /// What fits of `from`.
    #[must_use]
    pub fn of(from: &[u8]) -> Self {
        let mut bytes = [0; N];
        for (to, from) in bytes.iter_mut().zip(from) {
            *to = *from;
        }
        Self { bytes, len: from.len().min(N) as u8 }
    }

    /// The bytes.
    #[must_use]
    pub fn get(&self) -> &[u8] {
        self.bytes.get(..usize::from(self.len)).unwrap_or_default()
    }
}

impl<const N: usize> fmt::Debug for Bytes<N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:02x?}", self.get())
    }
}

/// Beginning of a transfer: the value itself (1 to 4 bytes), or its length if that is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Start {
    /// The value.
    Expedited(Bytes<4>),
    /// Segments follow.
    Segmented {
        /// Bytes in all.
        size: Option<u32>,
    },
}

/// Seven bytes of a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Segment {
    /// Changes from segment to segment, from false.
    pub toggle: bool,
    /// Bytes.
    pub bytes: Bytes<7>,
    /// There are no more.
    pub last: bool,
}

/// Why a transfer ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct AbortCode(pub u32);

impl AbortCode {
    /// The toggle did not change.
    pub const TOGGLE: Self = Self(0x0503_0000);
    /// No answer in time.
    pub const TIME_OUT: Self = Self(0x0504_0000);
    /// An unknown command.
    pub const COMMAND: Self = Self(0x0504_0001);
    /// The check sum of a block is wrong.
    pub const CHECK: Self = Self(0x0504_0004);
    /// It can only be read.
    pub const READ_ONLY: Self = Self(0x0601_0002);
    /// There is no such object.
    pub const NO_OBJECT: Self = Self(0x0602_0000);
    /// The length is wrong.
    pub const LENGTH: Self = Self(0x0607_0010);
    /// There is no such sub-index.
    pub const NO_SUB_INDEX: Self = Self(0x0609_0011);
    /// The value is outside its range.
    pub const RANGE: Self = Self(0x0609_0030);
    /// Not in this state of the device.
    pub const STATE: Self = Self(0x0800_0022);
}

impl fmt::Display for AbortCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let meaning = match *self {
            Self::TOGGLE => "the toggle bit did not change",
            Self::TIME_OUT => "no answer in time",
            Self::COMMAND => "unknown command",
            Self::CHECK => "wrong check sum",
            Self::READ_ONLY => "the object can only be read",
            Self::NO_OBJECT => "no such object",
            Self::LENGTH => "another length is expected",
            Self::NO_SUB_INDEX => "no such sub-index",
            Self::RANGE => "the value is outside its range",
            Self::STATE => "not in this state of the device",
            Self(0x0601_0000) => "access is not supported",
            Self(0x0601_0001) => "the object can only be written",
            Self(0x0604_0041) => "the object cannot be mapped",
            Self(0x0604_0042) => "the mapped objects are longer than a PDO",
            Self(0x0606_0000) => "a hardware error",
            Self(0x0609_0031) => "the value is too large",
            Self(0x0609_0032) => "the value is too small",
            Self(0x0800_0000) => "general error",
            _ => "a code of the maker",
        };
        write!(f, "{meaning} (0x{:08X})", self.0)
    }
}

/// What a host sends to a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Request {
    /// Begins to write.
    Write(Object, Start),
    /// More of what is written.
    WriteSegment(Segment),
    /// Begins to read.
    Read(Object),
    /// The next seven bytes of what is read.
    ReadSegment {
        /// As [`Segment::toggle`].
        toggle: bool,
    },
    /// Ends a transfer.
    Abort(Object, AbortCode),
}

/// What a node answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    /// To [`Request::Write`].
    Written(Object),
    /// To [`Request::WriteSegment`].
    SegmentWritten {
        /// That of the segment.
        toggle: bool,
    },
    /// To [`Request::Read`].
    Read(Object, Start),
    /// To [`Request::ReadSegment`].
    Segment(Segment),
    /// To any of them.
    Abort(Object, AbortCode),
}

const ABORT: u8 = 0x80;
const TOGGLE: u8 = 0x10;
/// Upper three bits of the first byte.
const SPECIFIER: u8 = 0xE0;

fn initiate(specifier: u8, object: Object, start: &Start) -> [u8; 8] {
    let [low, high] = object.index.to_le_bytes();
    let (flags, [a, b, c, d]) = match start {
        Start::Expedited(bytes) => {
            let unused = 4 - bytes.get().len().min(4) as u8;
            (unused << 2 | 0b11, Bytes::<4>::of(bytes.get()).bytes)
        }
        Start::Segmented { size: Some(size) } => (0b01, size.to_le_bytes()),
        Start::Segmented { size: None } => (0b00, [0; 4]),
    };
    [specifier | flags, low, high, object.sub, a, b, c, d]
}

fn start_of(head: u8, value: [u8; 4]) -> Start {
    match head & 0b11 {
        0b11 => {
            Start::Expedited(Bytes::of(value.get(..4 - usize::from(head >> 2 & 0b11)).unwrap_or_default()))
        }
        // Expedited without a size: all four bytes; the reader must know how many are valid.
        0b10 => Start::Expedited(Bytes::of(&value)),
        0b01 => Start::Segmented { size: Some(u32::from_le_bytes(value)) },
        _ => Start::Segmented { size: None },
    }
}

fn segment(specifier: u8, segment: &Segment) -> [u8; 8] {
    let unused = 7 - segment.bytes.get().len().min(7) as u8;
    let toggle = if segment.toggle { TOGGLE } else { 0 };
    let [a, b, c, d, e, f, g] = Bytes::<7>::of(segment.bytes.get()).bytes;
    [specifier | toggle | unused << 1 | u8::from(segment.last), a, b, c, d, e, f, g]
}

fn segment_of(head: u8, bytes: [u8; 7]) -> Segment {
    let used = 7 - usize::from(head >> 1 & 0b111);
    Segment {
        toggle: head & TOGGLE != 0,
        bytes: Bytes::of(bytes.get(..used).unwrap_or_default()),
        last: head & 1 != 0,
    }
}

fn abort(object: Object, AbortCode(code): AbortCode) -> [u8; 8] {
    let ([low, high], [a, b, c, d]) = (object.index.to_le_bytes(), code.to_le_bytes());
    [ABORT, low, high, object.sub, a, b, c, d]
}

fn plain(head: u8, object: Object) -> [u8; 8] {
    let [low, high] = object.index.to_le_bytes();
    [head, low, high, object.sub, 0, 0, 0, 0]
}

impl Request {
    /// The frame to `node`.
    #[must_use]
    pub fn encode(&self, node: NodeId) -> Frame {
        let data = match *self {
            Self::Write(object, start) => initiate(0x20, object, &start),
            Self::WriteSegment(ref part) => segment(0x00, part),
            Self::Read(object) => plain(0x40, object),
            Self::ReadSegment { toggle } => [0x60 | if toggle { TOGGLE } else { 0 }, 0, 0, 0, 0, 0, 0, 0],
            Self::Abort(object, code) => abort(object, code),
        };
        Function::SdoToNode(node).frame(data)
    }

    /// The request of a frame to a node, and the node. `None`: not a request, or one of [`super::block`]: a node without blocks answers
    /// it with [`AbortCode::COMMAND`].
    #[must_use]
    pub fn decode(from: &Frame) -> Option<(NodeId, Self)> {
        let Function::SdoToNode(node) = Function::of_frame(from)? else { return None };
        let [head, a, b, c, d, e, f, g] = *from.data().first_chunk::<8>()?;
        let (object, value) = (Object::new(u16::from_le_bytes([a, b]), c), [d, e, f, g]);
        let request = match head & SPECIFIER {
            0x20 => Self::Write(object, start_of(head, value)),
            0x00 => Self::WriteSegment(segment_of(head, [a, b, c, d, e, f, g])),
            0x40 => Self::Read(object),
            0x60 => Self::ReadSegment { toggle: head & TOGGLE != 0 },
            ABORT => Self::Abort(object, AbortCode(u32::from_le_bytes(value))),
            _ => return None,
        };
        Some((node, request))
    }
}

impl Answer {
    /// The frame of `node`.
    #[must_use]
    pub fn encode(&self, node: NodeId) -> Frame {
        let data = match *self {
            Self::Written(object) => plain(0x60, object),
            Self::SegmentWritten { toggle } => [0x20 | if toggle { TOGGLE } else { 0 }, 0, 0, 0, 0, 0, 0, 0],
            Self::Read(object, start) => initiate(0x40, object, &start),
            Self::Segment(ref part) => segment(0x00, part),
            Self::Abort(object, code) => abort(object, code),
        };
        Function::SdoFromNode(node).frame(data)
    }

    /// The answer of a node, and the node.
    #[must_use]
    pub fn decode(from: &Frame) -> Option<(NodeId, Self)> {
        let Function::SdoFromNode(node) = Function::of_frame(from)? else { return None };
        let [head, a, b, c, d, e, f, g] = *from.data().first_chunk::<8>()?;
        let (object, value) = (Object::new(u16::from_le_bytes([a, b]), c), [d, e, f, g]);
        let answer = match head & SPECIFIER {
            0x60 => Self::Written(object),
            0x20 => Self::SegmentWritten { toggle: head & TOGGLE != 0 },
            0x40 => Self::Read(object, start_of(head, value)),
            0x00 => Self::Segment(segment_of(head, [a, b, c, d, e, f, g])),
            ABORT => Self::Abort(object, AbortCode(u32::from_le_bytes(value))),
            _ => return None,
        };
        Some((node, answer))
    }
}

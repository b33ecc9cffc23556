//! `uavcan.node.port.List.1.0`: the ports that a node receives and sends, every few seconds.

use super::super::bits::{Decode, DecodeError, Encode, Reader, Writer};
use super::super::id::{ServiceId, SubjectId};
use crate::time::Duration;

/// Fixed subject.
pub const SUBJECT: SubjectId = SubjectId::from_low_bits(7510);
/// Bytes of the longest message: two subject masks, two service masks, their headers.
pub const EXTENT: u16 = 2 * (4 + 1 + 1024) + 2 * (4 + 64);
/// Longest time between two of a node.
pub const PERIOD_MAX: Duration = Duration::from_secs(10);

const SUBJECTS: usize = 8192;
const SERVICES: usize = 512;

/// Set of subjects in one of its three forms (`SubjectIDList.1.0`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SubjectIds<'a> {
    /// Bit `n % 8` of byte `n / 8` is subject `n`; bytes that are missing are zero.
    Mask(&'a [u8]),
    /// Up to 255 numbers.
    Sparse(SparseIds<'a>),
    /// All of them.
    Total,
}

/// Sequence of subjects as it lies on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SparseIds<'a> {
    count: u8,
    bytes: &'a [u8],
}

impl SparseIds<'_> {
    /// The subjects in the order sent.
    pub fn iter(&self) -> impl Iterator<Item = SubjectId> + '_ {
        (0..usize::from(self.count)).map(|i| {
            let byte = |at: usize| self.bytes.get(at).copied().unwrap_or(0);
            SubjectId::from_low_bits(u16::from_le_bytes([byte(2 * i), byte(2 * i + 1)]))
        })
    }
}

impl SubjectIds<'_> {
    /// True if the subject is in the set.
    pub fn contains(&self, subject: SubjectId) -> bool {
        match self {
            Self::Mask(mask) => bit(mask, usize::from(subject.get())),
            Self::Sparse(ids) => ids.iter().any(|id| id == subject),
            Self::Total => true,
        }
    }
}

/// Set of services (`ServiceIDList.1.0`): bit `n % 8` of byte `n / 8` is service `n`; bytes that are
/// missing are zero.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ServiceIds<'a>(pub &'a [u8]);

impl ServiceIds<'_> {
    /// True if the service is in the set.
    pub fn contains(&self, service: ServiceId) -> bool {
        bit(self.0, usize::from(service.get()))
    }
}

fn bit(mask: &[u8], n: usize) -> bool {
    mask.get(n / 8).is_some_and(|byte| byte >> (n % 8) & 1 != 0)
}

/// The message.
///
/// Decode it from the bytes that came ([`Transfer::len`](crate::cyphal::rx::Transfer::len)), without
/// the zeros behind them: its parts carry their own lengths, and a cut one is an error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PortList<'a> {
    /// Subjects the node sends.
    pub publishers: SubjectIds<'a>,
    /// Subjects the node listens to.
    pub subscribers: SubjectIds<'a>,
    /// Services the node uses.
    pub clients: ServiceIds<'a>,
    /// Services the node provides.
    pub servers: ServiceIds<'a>,
}

/// Writes a set of subjects given one by one, in the sparse form; at most 255.
pub fn encode_subjects(out: &mut Writer<'_>, subjects: &mut dyn Iterator<Item = SubjectId>) {
    let mark = out.open_delimiter();
    out.u8(1);
    let count_at = out.open_count();
    let mut count = 0;
    for subject in subjects.take(usize::from(u8::MAX)) {
        out.u16(subject.get());
        count += 1;
    }
    out.close_count(count_at, count);
    out.close_delimiter(mark);
}

/// Writes a set of services as a mask.
pub fn encode_services(out: &mut Writer<'_>, contains: &dyn Fn(ServiceId) -> bool) {
    let mark = out.open_delimiter();
    for service in 0..SERVICES as u16 {
        out.bool(contains(ServiceId::from_low_bits(service)));
    }
    out.close_delimiter(mark);
}

fn encode_mask(out: &mut Writer<'_>, mask: &[u8], bytes: usize) {
    for at in 0..bytes {
        out.u8(mask.get(at).copied().unwrap_or(0));
    }
}

impl Encode for PortList<'_> {
    fn encode(&self, out: &mut Writer<'_>) {
        for subjects in [self.publishers, self.subscribers] {
            match subjects {
                SubjectIds::Sparse(ids) => encode_subjects(out, &mut ids.iter()),
                SubjectIds::Mask(mask) => {
                    let mark = out.open_delimiter();
                    out.u8(0);
                    encode_mask(out, mask, SUBJECTS / 8);
                    out.close_delimiter(mark);
                }
                SubjectIds::Total => {
                    let mark = out.open_delimiter();
                    out.u8(2);
                    out.close_delimiter(mark);
                }
            }
        }
        for services in [self.clients, self.servers] {
            let mark = out.open_delimiter();
            encode_mask(out, services.0, SERVICES / 8);
            out.close_delimiter(mark);
        }
    }
}

fn decode_subjects<'a>(input: &mut Reader<'a>) -> Result<SubjectIds<'a>, DecodeError> {
    let mut input = input.delimited()?;
    match input.u8() {
        0 => Ok(SubjectIds::Mask(head(input.rest(), SUBJECTS / 8))),
        1 => Ok(SubjectIds::Sparse(SparseIds { count: input.u8(), bytes: input.rest() })),
        2 => Ok(SubjectIds::Total),
        tag => Err(DecodeError::UnknownTag(tag)),
    }
}

fn head(bytes: &[u8], len: usize) -> &[u8] {
    bytes.get(..len).unwrap_or(bytes)
}

impl<'a> Decode<'a> for PortList<'a> {
    fn decode(input: &mut Reader<'a>) -> Result<Self, DecodeError> {
        Ok(Self {
            publishers: decode_subjects(input)?,
            subscribers: decode_subjects(input)?,
            clients: ServiceIds(head(input.delimited()?.rest(), SERVICES / 8)),
            servers: ServiceIds(head(input.delimited()?.rest(), SERVICES / 8)),
        })
    }
}

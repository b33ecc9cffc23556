//! Service data of a node: one transfer at a time, expedited, in segments, or read in blocks.

use protocol::Frame;
use protocol::canopen::block::{BlockAnswer, BlockRequest, BlockSegment, SEGMENTS_MAX};
use protocol::canopen::sdo::{AbortCode, Answer, Bytes, Request, Segment, Start};
use protocol::canopen::{NodeId, Object};
use protocol::cyphal::crc::Crc16;

/// Longest value that is written in segments.
const WRITTEN_MAX: usize = 64;

/// A transfer in segments.
#[derive(Clone, Debug, Default)]
pub(super) enum Server {
    #[default]
    Idle,
    /// What is left to send.
    Reading {
        object: Object,
        rest: Vec<u8>,
        toggle: bool,
    },
    /// What came so far.
    Writing {
        object: Object,
        bytes: Vec<u8>,
        toggle: bool,
    },
    Blocks(Blocks),
}

/// Access to the objects.
pub(super) trait Objects {
    fn read(&mut self, object: Object) -> Result<Vec<u8>, AbortCode>;
    fn write(&mut self, object: Object, value: &[u8]) -> Result<(), AbortCode>;
}

impl Server {
    /// Answers a request; `None`: no answer is needed.
    pub(super) fn answer(&mut self, request: Option<Request>, objects: &mut impl Objects) -> Option<Answer> {
        let abort = |object, code| Some(Answer::Abort(object, code));
        match request {
            None => {
                *self = Self::Idle;
                abort(Object::new(0, 0), AbortCode::COMMAND)
            }
            Some(Request::Abort(..)) => {
                *self = Self::Idle;
                None
            }
            Some(Request::Read(object)) => {
                *self = Self::Idle;
                match objects.read(object) {
                    Ok(value) if value.len() <= 4 => {
                        Some(Answer::Read(object, Start::Expedited(Bytes::of(&value))))
                    }
                    Ok(rest) => {
                        let size = Some(rest.len() as u32);
                        *self = Self::Reading { object, rest, toggle: false };
                        Some(Answer::Read(object, Start::Segmented { size }))
                    }
                    Err(code) => abort(object, code),
                }
            }
            Some(Request::Write(object, Start::Expedited(value))) => {
                *self = Self::Idle;
                match objects.write(object, value.get()) {
                    Ok(()) => Some(Answer::Written(object)),
                    Err(code) => abort(object, code),
                }
            }
            Some(Request::Write(object, Start::Segmented { .. })) => {
                *self = Self::Writing { object, bytes: Vec::new(), toggle: false };
                Some(Answer::Written(object))
            }
            Some(Request::ReadSegment { toggle }) => self.next(toggle),
            Some(Request::WriteSegment(segment)) => self.take(&segment, objects),
        }
    }

    fn next(&mut self, asked: bool) -> Option<Answer> {
        let Self::Reading { object, rest, toggle } = self else {
            return Some(Answer::Abort(Object::new(0, 0), AbortCode::COMMAND));
        };
        if asked != *toggle {
            let aborted = Answer::Abort(*object, AbortCode::TOGGLE);
            *self = Self::Idle;
            return Some(aborted);
        }
        let sent: Vec<u8> = rest.drain(..rest.len().min(7)).collect();
        let segment = Segment { toggle: asked, bytes: Bytes::of(&sent), last: rest.is_empty() };
        *toggle = !*toggle;
        if segment.last {
            *self = Self::Idle;
        }
        Some(Answer::Segment(segment))
    }

    fn take(&mut self, segment: &Segment, objects: &mut impl Objects) -> Option<Answer> {
        let Self::Writing { object, bytes, toggle } = self else {
            return Some(Answer::Abort(Object::new(0, 0), AbortCode::COMMAND));
        };
        let object = *object;
        bytes.extend(segment.bytes.get());
        let wrong = if segment.toggle != *toggle {
            Some(AbortCode::TOGGLE)
        } else if bytes.len() > WRITTEN_MAX {
            Some(AbortCode::LENGTH)
        } else if segment.last {
            objects.write(object, bytes).err()
        } else {
            None
        };
        *toggle = !*toggle;
        if wrong.is_some() || segment.last {
            *self = Self::Idle;
        }
        Some(match wrong {
            Some(code) => Answer::Abort(object, code),
            None => Answer::SegmentWritten { toggle: segment.toggle },
        })
    }
}

/// A value that is read in blocks.
#[derive(Clone, Debug)]
pub(super) struct Blocks {
    object: Object,
    value: Vec<u8>,
    /// Segments that the host has confirmed.
    done: usize,
    /// Segments of a block.
    size: usize,
}

impl Blocks {
    fn segments(&self) -> usize {
        self.value.len().div_ceil(7).max(1)
    }

    fn block(&self, node: NodeId) -> Vec<Frame> {
        let end = self.segments().min(self.done + self.size);
        let segment = |k: usize| {
            let mut bytes = [0; 7];
            bytes.iter_mut().zip(&self.value[7 * k..]).for_each(|(to, from)| *to = *from);
            BlockSegment { number: (k - self.done + 1) as u8, last: k + 1 == self.segments(), bytes }
        };
        (self.done..end).map(|k| segment(k).encode(node)).collect()
    }

    fn end(&self, node: NodeId) -> Frame {
        let mut check = Crc16::ZERO;
        check.update(&self.value);
        let unused = (7 * self.segments() - self.value.len()) as u8;
        BlockAnswer::Ends { unused, check: check.get() }.encode(node)
    }
}

impl Server {
    /// Answers a request of the block protocol: the frames in their order.
    pub(super) fn answer_block(
        &mut self,
        node: NodeId,
        request: BlockRequest,
        objects: &mut impl Objects,
    ) -> Vec<Frame> {
        let abort = |object, code| vec![Answer::Abort(object, code).encode(node)];
        let (blocks, frames) = match (std::mem::take(self), request) {
            (_, BlockRequest::Read { object, segments }) if (1..=SEGMENTS_MAX).contains(&segments) => {
                match objects.read(object) {
                    Ok(value) => {
                        let size = Some(value.len() as u32);
                        let begins = BlockAnswer::Begins { object, size, has_check: true };
                        let blocks = Blocks { object, value, done: 0, size: segments.into() };
                        (Some(blocks), vec![begins.encode(node)])
                    }
                    Err(code) => return abort(object, code),
                }
            }
            (Self::Blocks(blocks), BlockRequest::Start) => {
                let frames = blocks.block(node);
                (Some(blocks), frames)
            }
            (Self::Blocks(blocks), BlockRequest::Taken { last, segments })
                if (1..=SEGMENTS_MAX).contains(&segments) && usize::from(last) <= blocks.size =>
            {
                let done = blocks.done + usize::from(last);
                let blocks = Blocks { done, size: segments.into(), ..blocks };
                let frames =
                    if done < blocks.segments() { blocks.block(node) } else { vec![blocks.end(node)] };
                (Some(blocks), frames)
            }
            (Self::Blocks(blocks), BlockRequest::Ended) if blocks.done >= blocks.segments() => {
                (None, Vec::new())
            }
            (Self::Blocks(Blocks { object, .. }), _) => return abort(object, AbortCode::COMMAND),
            _ => return abort(Object::new(0, 0), AbortCode::COMMAND),
        };
        *self = blocks.map_or(Self::Idle, Self::Blocks);
        frames
    }
}

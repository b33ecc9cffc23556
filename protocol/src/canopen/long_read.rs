//! A read of an object of any length: in blocks, or in segments if the node has no blocks. Frames in, frames and bytes out, time as an
//! argument.
//!
//! Segments of a block that follow a lost one are not taken: the node sends them again in the next block. The unused bytes of the last
//! segment are known at the end only, so each segment waits for the next one.

use crate::cyphal::crc::Crc16;
use crate::{Duration, Frame, Instant};

use super::Object;
use super::block::{BlockAnswer, BlockRequest, BlockSegment, SEGMENTS_MAX};
use super::client::{Failure, Plain, Then};
use super::id::NodeId;
use super::sdo::{AbortCode, Answer, Request};

/// How a read begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// In blocks. A node without blocks is read in segments then.
    Blocks,
    /// In segments; an object of up to 4 bytes comes with the first answer.
    Segments,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// The host has asked for blocks.
    Asked,
    /// A block comes. `next`: number of the next segment. `has_come`: a segment came since the last frame of the host.
    Block {
        next: u8,
        has_come: bool,
    },
    Ending,
    Plain(Plain),
    Ended(Result<(), Failure>),
}

/// See the [module](self).
#[derive(Clone, Debug)]
pub struct LongRead {
    node: NodeId,
    object: Object,
    phase: Phase,
    held: Option<[u8; 7]>,
    has_last: bool,
    /// Bytes given so far, and at most.
    given: u32,
    size_max: u32,
    check: Crc16,
    has_check: bool,
    patience: Duration,
    deadline: Instant,
}

impl LongRead {
    /// Begins to read; the frame is to be sent. Each answer may take `patience`, the object may have `size_max` bytes.
    #[must_use]
    pub fn new(
        now: Instant,
        patience: Duration,
        node: NodeId,
        object: Object,
        size_max: u32,
        form: Form,
    ) -> (Self, Frame) {
        let (phase, asked) = match form {
            Form::Blocks => {
                (Phase::Asked, BlockRequest::Read { object, segments: SEGMENTS_MAX }.encode(node))
            }
            Form::Segments => (Phase::Plain(Plain::Object), Request::Read(object).encode(node)),
        };
        let read = Self {
            node,
            object,
            phase,
            held: None,
            has_last: false,
            given: 0,
            size_max,
            check: Crc16::ZERO,
            has_check: false,
            patience,
            deadline: now + patience,
        };
        (read, asked)
    }

    /// Whether the read has ended; `None` while it runs.
    ///
    /// # Errors
    /// Why it failed.
    #[must_use]
    pub const fn outcome(&self) -> Option<Result<(), Failure>> {
        match self.phase {
            Phase::Ended(outcome) => Some(outcome),
            _ => None,
        }
    }

    /// Latest time of the node's next frame; `None` at the end.
    #[must_use]
    pub const fn poll_timeout(&self) -> Option<Instant> {
        match self.phase {
            Phase::Ended(_) => None,
            _ => Some(self.deadline),
        }
    }

    /// A deadline has come: the end of a block may be lost, so what came is confirmed once; else the read ends. The frame is to be sent.
    pub fn handle_timeout(&mut self, now: Instant) -> Option<Frame> {
        if self.poll_timeout().is_none_or(|at| at > now) {
            return None;
        }
        self.deadline = now + self.patience;
        match self.phase {
            Phase::Block { next, has_come: true } => Some(self.taken(next)),
            _ => Some(self.fail(Failure::TimeOut, AbortCode::TIME_OUT)),
        }
    }

    /// Takes a frame; what is not an answer of the node to this read is ignored. Gives the bytes of the object to `sink`, in order. They
    /// count once the read has ended without a failure. The frame that comes back is to be sent.
    pub fn handle_frame(
        &mut self,
        now: Instant,
        frame: &Frame,
        sink: &mut impl FnMut(&[u8]),
    ) -> Option<Frame> {
        if matches!(self.phase, Phase::Ended(_)) {
            return None;
        }
        if let Phase::Block { next, .. } = self.phase
            && let Some((node, segment)) = BlockSegment::decode(frame)
        {
            return (node == self.node).then(|| self.take(now, next, &segment, sink)).flatten();
        }
        if let Some((node, answer)) = BlockAnswer::decode(frame) {
            return (node == self.node).then(|| self.take_block_answer(now, answer, sink)).flatten();
        }
        let (node, answer) = Answer::decode(frame)?;
        (node == self.node).then(|| self.take_answer(now, answer, sink)).flatten()
    }

    fn take_block_answer(
        &mut self,
        now: Instant,
        answer: BlockAnswer,
        sink: &mut impl FnMut(&[u8]),
    ) -> Option<Frame> {
        self.deadline = now + self.patience;
        match (self.phase, answer) {
            (Phase::Asked, BlockAnswer::Begins { object, size, has_check }) if object == self.object => {
                if let Some(size) = size.filter(|size| *size > self.size_max) {
                    return Some(self.fail(Failure::TooLong { size }, AbortCode::LENGTH));
                }
                self.has_check = has_check;
                self.phase = Phase::Block { next: 1, has_come: false };
                Some(BlockRequest::Start.encode(self.node))
            }
            (Phase::Ending, BlockAnswer::Ends { unused, check }) => {
                let held = self.held.take().unwrap_or_default();
                let used = 7_usize.saturating_sub(usize::from(unused));
                if let Err(size) = self.give(held.get(..used).unwrap_or_default(), sink) {
                    return Some(self.fail(Failure::TooLong { size }, AbortCode::LENGTH));
                }
                if self.has_check && check != self.check.get() {
                    return Some(self.fail(Failure::Corrupt, AbortCode::CHECK));
                }
                self.phase = Phase::Ended(Ok(()));
                Some(BlockRequest::Ended.encode(self.node))
            }
            _ => Some(self.fail(Failure::Unexpected, AbortCode::COMMAND)),
        }
    }

    fn take_answer(&mut self, now: Instant, answer: Answer, sink: &mut impl FnMut(&[u8])) -> Option<Frame> {
        if let Answer::Read(object, _) | Answer::Abort(object, _) = answer
            && object != self.object
            // A node that does not know this request may answer with any object.
            && !(self.phase == Phase::Asked && matches!(answer, Answer::Abort(..)))
        {
            return None;
        }
        self.deadline = now + self.patience;
        match (self.phase, answer) {
            (Phase::Asked, Answer::Abort(_, AbortCode::COMMAND)) => {
                self.phase = Phase::Plain(Plain::Object);
                Some(Request::Read(self.object).encode(self.node))
            }
            (_, Answer::Abort(_, code)) => {
                self.phase = Phase::Ended(Err(Failure::Aborted(code)));
                None
            }
            (Phase::Plain(plain), _) => {
                let then = plain.take(answer, self.size_max, &mut |read| self.give(read, sink));
                self.follow(then)
            }
            _ => Some(self.fail(Failure::Unexpected, AbortCode::COMMAND)),
        }
    }

    fn follow(&mut self, then: Then) -> Option<Frame> {
        match then {
            Then::Ask(plain, request) => {
                self.phase = Phase::Plain(plain);
                Some(request.encode(self.node))
            }
            Then::Ended(outcome) => {
                self.phase = Phase::Ended(outcome);
                None
            }
            Then::Failed(failure, code) => Some(self.fail(failure, code)),
        }
    }

    /// Takes a segment of a block. `next`: number of the segment that is due.
    fn take(
        &mut self,
        now: Instant,
        next: u8,
        segment: &BlockSegment,
        sink: &mut impl FnMut(&[u8]),
    ) -> Option<Frame> {
        self.deadline = now + self.patience;
        let mut next = next;
        if segment.number == next {
            let before = self.held.replace(segment.bytes);
            if let Some(Err(size)) = before.map(|held| self.give(&held, sink)) {
                return Some(self.fail(Failure::TooLong { size }, AbortCode::LENGTH));
            }
            (self.has_last, next) = (segment.last, next.saturating_add(1));
        }
        self.phase = Phase::Block { next, has_come: true };
        let is_over = segment.last || segment.number == SEGMENTS_MAX;
        is_over.then(|| self.taken(next))
    }

    /// Confirms the segments before `next`.
    fn taken(&mut self, next: u8) -> Frame {
        self.phase = if self.has_last { Phase::Ending } else { Phase::Block { next: 1, has_come: false } };
        let last = next.saturating_sub(1);
        BlockRequest::Taken { last, segments: SEGMENTS_MAX }.encode(self.node)
    }

    /// Hands bytes on; an error is how many there are, which is too many.
    fn give(&mut self, bytes: &[u8], sink: &mut impl FnMut(&[u8])) -> Result<(), u32> {
        self.given = self.given.saturating_add(bytes.len() as u32);
        if self.given > self.size_max {
            return Err(self.given);
        }
        self.check.update(bytes);
        sink(bytes);
        Ok(())
    }

    fn fail(&mut self, failure: Failure, code: AbortCode) -> Frame {
        self.phase = Phase::Ended(Err(failure));
        Request::Abort(self.object, code).encode(self.node)
    }
}

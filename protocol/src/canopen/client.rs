//! One read or write of an object: frames in, frames out, time as an argument.

use core::fmt;

use crate::{Duration, Frame, Instant};

use super::Object;
use super::id::NodeId;
use super::sdo::{AbortCode, Answer, Bytes, Request, Segment, Start};

/// Why a transfer failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Failure {
    /// The node ended it.
    Aborted(AbortCode),
    /// The node did not answer in time.
    TimeOut,
    /// The value is longer than the room for it, bytes.
    TooLong {
        /// As far as it is known.
        size: u32,
    },
    /// The check sum of a value that came in blocks is another one.
    Corrupt,
    /// The node's answer does not belong to the request, or a segment is out of order.
    Unexpected,
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Aborted(code) => write!(f, "the node refuses: {code}"),
            Self::TimeOut => f.write_str("the node does not answer"),
            Self::TooLong { size } => write!(f, "the value has {size} bytes, more than there is room for"),
            Self::Corrupt => f.write_str("the value came damaged: its check sum is another one"),
            Self::Unexpected => f.write_str("the node answers what was not asked"),
        }
    }
}

impl core::error::Error for Failure {}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    WriteBegun,
    /// Bytes in the segment that waits for its answer.
    Writing {
        in_flight: usize,
    },
    Reading(Plain),
    Ended(Result<(), Failure>),
}

/// A read at once or in segments: what the host has asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Plain {
    Object,
    Segment { toggle: bool },
}

/// What comes after an answer.
#[derive(Clone, Copy)]
pub(crate) enum Then {
    Ask(Plain, Request),
    /// The node has nothing more to send.
    Ended(Result<(), Failure>),
    Failed(Failure, AbortCode),
}

impl Plain {
    /// Takes an answer. `give` hands the bytes of the object on; its error is how many there are, which is too many.
    pub(crate) fn take(
        self,
        answer: Answer,
        size_max: u32,
        give: &mut impl FnMut(&[u8]) -> Result<(), u32>,
    ) -> Then {
        let too_long = |size| Then::Failed(Failure::TooLong { size }, AbortCode::LENGTH);
        let ask = |toggle| Then::Ask(Self::Segment { toggle }, Request::ReadSegment { toggle });
        match (self, answer) {
            (Self::Object, Answer::Read(_, Start::Expedited(value))) => {
                Then::Ended(give(value.get()).map_err(|size| Failure::TooLong { size }))
            }
            (Self::Object, Answer::Read(_, Start::Segmented { size: Some(size) })) if size > size_max => {
                too_long(size)
            }
            (Self::Object, Answer::Read(_, Start::Segmented { .. })) => ask(false),
            (Self::Segment { toggle }, Answer::Segment(segment)) if segment.toggle == toggle => {
                match give(segment.bytes.get()) {
                    Ok(()) if segment.last => Then::Ended(Ok(())),
                    Ok(()) => ask(!toggle),
                    Err(size) => too_long(size),
                }
            }
            (_, Answer::Segment(_) | Answer::SegmentWritten { .. }) => {
                Then::Failed(Failure::Unexpected, AbortCode::TOGGLE)
            }
            _ => Then::Failed(Failure::Unexpected, AbortCode::COMMAND),
        }
    }
}

/// A transfer of at most `N` bytes.
#[derive(Clone, Debug)]
pub struct Transfer<const N: usize> {
    node: NodeId,
    object: Object,
    bytes: [u8; N],
    len: usize,
    /// Written so far.
    done: usize,
    toggle: bool,
    phase: Phase,
    patience: Duration,
    deadline: Instant,
}

impl<const N: usize> Transfer<N> {
    fn new(now: Instant, patience: Duration, node: NodeId, object: Object, phase: Phase) -> Self {
        let deadline = now + patience;
        Self { node, object, bytes: [0; N], len: 0, done: 0, toggle: false, phase, patience, deadline }
    }

    /// Begins to read; the frame is to be sent. Each answer may take `patience`.
    #[must_use]
    pub fn read(now: Instant, patience: Duration, node: NodeId, object: Object) -> (Self, Frame) {
        let transfer = Self::new(now, patience, node, object, Phase::Reading(Plain::Object));
        (transfer, Request::Read(object).encode(node))
    }

    /// Begins to write; the frame is to be sent. Up to four bytes go with it, more go in segments.
    ///
    /// # Errors
    /// More than `N` bytes, or none.
    pub fn write(
        now: Instant,
        patience: Duration,
        node: NodeId,
        object: Object,
        value: &[u8],
    ) -> Result<(Self, Frame), Failure> {
        if value.is_empty() || value.len() > N {
            return Err(Failure::TooLong { size: value.len() as u32 });
        }
        let mut transfer = Self::new(now, patience, node, object, Phase::WriteBegun);
        for (to, from) in transfer.bytes.iter_mut().zip(value) {
            *to = *from;
        }
        transfer.len = value.len();
        let start = if value.len() <= 4 {
            transfer.done = value.len();
            Start::Expedited(Bytes::of(value))
        } else {
            Start::Segmented { size: Some(value.len() as u32) }
        };
        Ok((transfer, Request::Write(object, start).encode(node)))
    }

    /// The object.
    #[must_use]
    pub const fn object(&self) -> Object {
        self.object
    }

    /// Result of the transfer: the bytes that were read (empty after a write); `None` while it runs.
    ///
    /// # Errors
    /// Why the transfer failed.
    #[must_use]
    pub fn outcome(&self) -> Option<Result<&[u8], Failure>> {
        match self.phase {
            Phase::Ended(Ok(())) => {
                let read = if self.done > 0 { 0 } else { self.len };
                Some(Ok(self.bytes.get(..read).unwrap_or_default()))
            }
            Phase::Ended(Err(failure)) => Some(Err(failure)),
            _ => None,
        }
    }

    /// Latest time of the node's next answer; `None` at the end.
    #[must_use]
    pub const fn poll_timeout(&self) -> Option<Instant> {
        match self.phase {
            Phase::Ended(_) => None,
            _ => Some(self.deadline),
        }
    }

    /// Ends a transfer whose deadline has come; the frame is to be sent.
    pub fn handle_timeout(&mut self, now: Instant) -> Option<Frame> {
        let due = self.poll_timeout().is_some_and(|at| at <= now);
        due.then(|| self.fail(Failure::TimeOut, AbortCode::TIME_OUT))
    }

    fn fail(&mut self, failure: Failure, code: AbortCode) -> Frame {
        self.phase = Phase::Ended(Err(failure));
        Request::Abort(self.object, code).encode(self.node)
    }

    /// Takes a frame; what is not an answer of the node to this transfer is ignored. The frame that comes back is to be sent.
    pub fn handle_frame(&mut self, now: Instant, frame: &Frame) -> Option<Frame> {
        let (node, answer) = Answer::decode(frame)?;
        if node != self.node || matches!(self.phase, Phase::Ended(_)) {
            return None;
        }
        match answer {
            // An answer to an older transfer that was given up.
            Answer::Written(object) | Answer::Read(object, _) | Answer::Abort(object, _)
                if object != self.object =>
            {
                return None;
            }
            Answer::Abort(_, code) => {
                self.phase = Phase::Ended(Err(Failure::Aborted(code)));
                return None;
            }
            _ => {}
        }
        self.deadline = now + self.patience;
        match (self.phase, answer) {
            (Phase::WriteBegun, Answer::Written(_)) => self.next_segment(),
            (Phase::Writing { in_flight }, Answer::SegmentWritten { toggle }) if toggle == self.toggle => {
                self.done += in_flight;
                self.toggle = !self.toggle;
                self.next_segment()
            }
            (Phase::Reading(plain), _) => {
                let then = plain.take(answer, N as u32, &mut |read| self.take(read));
                self.follow(then)
            }
            (_, Answer::Segment(_) | Answer::SegmentWritten { .. }) => {
                Some(self.fail(Failure::Unexpected, AbortCode::TOGGLE))
            }
            _ => Some(self.fail(Failure::Unexpected, AbortCode::COMMAND)),
        }
    }

    /// Sends what is left, or ends.
    fn next_segment(&mut self) -> Option<Frame> {
        let left = self.bytes.get(self.done..self.len).unwrap_or_default();
        if left.is_empty() {
            self.phase = Phase::Ended(Ok(()));
            return None;
        }
        let bytes = Bytes::<7>::of(left);
        let in_flight = bytes.get().len();
        let segment = Segment { toggle: self.toggle, bytes, last: in_flight == left.len() };
        self.phase = Phase::Writing { in_flight };
        Some(Request::WriteSegment(segment).encode(self.node))
    }

    fn follow(&mut self, then: Then) -> Option<Frame> {
        match then {
            Then::Ask(plain, request) => {
                self.phase = Phase::Reading(plain);
                Some(request.encode(self.node))
            }
            Then::Ended(outcome) => {
                self.phase = Phase::Ended(outcome);
                None
            }
            Then::Failed(failure, code) => Some(self.fail(failure, code)),
        }
    }

    /// Appends what was read; an error is the length for which there is no room.
    fn take(&mut self, read: &[u8]) -> Result<(), u32> {
        let end = self.len + read.len();
        let room = self.bytes.get_mut(self.len..end).ok_or(end as u32)?;
        for (to, from) in room.iter_mut().zip(read) {
            *to = *from;
        }
        self.len = end;
        Ok(())
    }
}

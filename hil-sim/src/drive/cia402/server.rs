//! Service data of a node: one transfer at a time, expedited or in segments.

use canopen_protocol::Object;
use canopen_protocol::sdo::{AbortCode, Answer, Bytes, Request, Segment, Start};

/// Longest value that is written in segments.
const WRITTEN_MAX: usize = 64;

/// A transfer in segments.
#[derive(Clone, Debug, Default)]
pub(super) enum Server {
    #[default]
    Idle,
    /// What is left to send.
    Reading { object: Object, rest: Vec<u8>, toggle: bool },
    /// What came so far.
    Writing { object: Object, bytes: Vec<u8>, toggle: bool },
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

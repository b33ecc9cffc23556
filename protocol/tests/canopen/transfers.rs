//! Transfers with a node that is played here.

use protocol::canopen::client::{Failure, Transfer};
use protocol::canopen::sdo::{AbortCode, Answer, Bytes, Request, Segment, Start};
use protocol::canopen::{NodeId, Object};
use protocol::{Duration, Frame, Instant};

use super::golden::{frame, node};

const PATIENCE: Duration = Duration::from_millis(50);
const NAME: Object = Object::new(0x1008, 0);

fn at(ms: u64) -> Instant {
    Instant::ZERO + Duration::from_millis(ms)
}

/// A node with one object.
struct Node {
    value: Vec<u8>,
    sent: usize,
    taken: Vec<u8>,
}

impl Node {
    fn answer(&mut self, asked: &Frame) -> Option<Frame> {
        let (_, request) = Request::decode(asked).expect("a request");
        let answer = match request {
            Request::Read(object) if object != NAME => Answer::Abort(object, AbortCode::NO_OBJECT),
            Request::Read(object) if self.value.len() <= 4 => {
                Answer::Read(object, Start::Expedited(Bytes::of(&self.value)))
            }
            Request::Read(object) => {
                Answer::Read(object, Start::Segmented { size: Some(self.value.len() as u32) })
            }
            Request::ReadSegment { toggle } => {
                let bytes = Bytes::<7>::of(&self.value[self.sent..]);
                self.sent += bytes.get().len();
                Answer::Segment(Segment { toggle, bytes, last: self.sent == self.value.len() })
            }
            Request::Write(object, start) => {
                self.taken.clear();
                if let Start::Expedited(bytes) = start {
                    self.taken.extend(bytes.get());
                }
                Answer::Written(object)
            }
            Request::WriteSegment(segment) => {
                self.taken.extend(segment.bytes.get());
                Answer::SegmentWritten { toggle: segment.toggle }
            }
            Request::Abort(..) => return None,
        };
        Some(answer.encode(node()))
    }
}

fn node_with(value: &[u8]) -> Node {
    Node { value: value.to_vec(), sent: 0, taken: Vec::new() }
}

fn run<const N: usize>(transfer: &mut Transfer<N>, mut asked: Frame, played: &mut Node) {
    for ms in 1..1000 {
        let Some(answer) = played.answer(&asked) else { return };
        match transfer.handle_frame(at(ms), &answer) {
            Some(next) => asked = next,
            None => return,
        }
    }
    panic!("it does not end");
}

#[test]
fn values_of_every_length_are_read_and_written() {
    for len in 1..=64_usize {
        let value: Vec<u8> = (0..len).map(|k| (k * 37 + len) as u8).collect();
        let mut played = node_with(&value);
        let (mut read, asked) = Transfer::<64>::read(at(0), PATIENCE, node(), NAME);
        run(&mut read, asked, &mut played);
        assert_eq!(read.outcome(), Some(Ok(&value[..])), "{len}");
        let (mut write, asked) = Transfer::<64>::write(at(0), PATIENCE, node(), NAME, &value).unwrap();
        run(&mut write, asked, &mut played);
        assert_eq!(write.outcome(), Some(Ok(&[][..])));
        assert_eq!(played.taken, value);
        assert!(read.poll_timeout().is_none() && write.poll_timeout().is_none());
    }
    assert!(Transfer::<4>::write(at(0), PATIENCE, node(), NAME, &[0; 5]).is_err());
    assert!(Transfer::<4>::write(at(0), PATIENCE, node(), NAME, &[]).is_err());
}

#[test]
fn a_node_that_refuses_is_quoted() {
    let (mut read, asked) = Transfer::<64>::read(at(0), PATIENCE, node(), Object::new(0x2000, 0));
    run(&mut read, asked, &mut node_with(&[1]));
    assert_eq!(read.outcome(), Some(Err(Failure::Aborted(AbortCode::NO_OBJECT))));
    let text = "the node refuses: no such object (0x06020000)";
    assert_eq!(Failure::Aborted(AbortCode::NO_OBJECT).to_string(), text);
}

#[test]
fn a_transfer_without_an_answer_in_time_ends_with_an_abort_to_the_node() {
    let (mut read, _) = Transfer::<64>::read(at(0), PATIENCE, node(), NAME);
    let begins = frame("583 41 08 10 00 13 00 00 00");
    assert_eq!(read.handle_frame(at(10), &begins), Some(frame("603 60 00 00 00 00 00 00 00")));
    assert_eq!(read.poll_timeout(), Some(at(60)));
    assert_eq!(read.handle_timeout(at(59)), None);
    assert_eq!(read.handle_timeout(at(60)), Some(frame("603 80 08 10 00 00 00 04 05")));
    assert_eq!(read.outcome(), Some(Err(Failure::TimeOut)));
    // What comes afterwards changes nothing.
    assert_eq!(read.handle_frame(at(70), &frame("583 00 53 69 6d 75 6c 61 74")), None);
    assert_eq!(read.outcome(), Some(Err(Failure::TimeOut)));
}

#[test]
fn answers_of_other_nodes_and_of_older_transfers_are_ignored() {
    let (mut read, _) = Transfer::<64>::read(at(0), PATIENCE, node(), NAME);
    let other = Answer::Abort(NAME, AbortCode::NO_OBJECT).encode(NodeId::new(4).unwrap());
    let older = Answer::Read(Object::new(0x1000, 0), Start::Expedited(Bytes::of(&[1]))).encode(node());
    for frame in [other, older, frame("703 05"), frame("183 00 00")] {
        assert_eq!(read.handle_frame(at(1), &frame), None);
        assert_eq!(read.outcome(), None);
    }
}

#[test]
fn a_segment_out_of_order_or_too_long_a_value_ends_the_transfer() {
    let begin = |size: u32| Answer::Read(NAME, Start::Segmented { size: Some(size) }).encode(node());
    let (mut read, _) = Transfer::<8>::read(at(0), PATIENCE, node(), NAME);
    read.handle_frame(at(1), &begin(8));
    // The toggle of the second segment in place of the first one's.
    let abort = read.handle_frame(at(2), &frame("583 10 65 64 20 73 65 72 76"));
    assert_eq!(abort, Some(frame("603 80 08 10 00 00 00 03 05")));
    assert_eq!(read.outcome(), Some(Err(Failure::Unexpected)));
    let (mut read, _) = Transfer::<8>::read(at(0), PATIENCE, node(), NAME);
    assert!(read.handle_frame(at(1), &begin(9)).is_some());
    assert_eq!(read.outcome(), Some(Err(Failure::TooLong { size: 9 })));
    // A node that states too small a size.
    let (mut read, _) = Transfer::<8>::read(at(0), PATIENCE, node(), NAME);
    read.handle_frame(at(1), &begin(8));
    read.handle_frame(at(2), &frame("583 00 53 69 6d 75 6c 61 74"));
    assert!(read.handle_frame(at(3), &frame("583 10 65 64 20 73 65 72 76")).is_some());
    assert_eq!(read.outcome(), Some(Err(Failure::TooLong { size: 14 })));
    // A value that comes at once and has no room.
    let (mut read, _) = Transfer::<2>::read(at(0), PATIENCE, node(), NAME);
    assert!(read.handle_frame(at(1), &frame("583 43 08 10 00 92 01 02 00")).is_none());
    assert_eq!(read.outcome(), Some(Err(Failure::TooLong { size: 4 })));
    // A read in place of a write.
    let (mut write, _) = Transfer::<8>::write(at(0), PATIENCE, node(), NAME, &[1]).unwrap();
    assert!(write.handle_frame(at(1), &begin(8)).is_some());
    assert_eq!(write.outcome(), Some(Err(Failure::Unexpected)));
}

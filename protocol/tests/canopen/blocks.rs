//! Reads in blocks, with a node that is played here and that may lose segments.

use protocol::canopen::block::{BlockAnswer, BlockRequest, BlockSegment};
use protocol::canopen::client::Failure;
use protocol::canopen::long_read::{Form, LongRead};
use protocol::canopen::sdo::{AbortCode, Answer, Bytes, Request, Segment, Start};
use protocol::canopen::{NodeId, Object};
use protocol::{Duration, Frame, Instant};

use super::golden::{frame, node};

const PATIENCE: Duration = Duration::from_millis(50);
const SHEET: Object = Object::new(0x1021, 0);
const MOST: u32 = 1 << 20;

fn at(ms: u64) -> Instant {
    Instant::ZERO + Duration::from_millis(ms)
}

/// CRC-16/XMODEM bit by bit.
fn check_of(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0, |crc: u16, byte| {
        (0..8)
            .fold(crc ^ u16::from(*byte) << 8, |crc, _| crc << 1 ^ if crc & 0x8000 != 0 { 0x1021 } else { 0 })
    })
}

#[test]
fn the_check_sum_is_that_of_the_catalogue_of_such_codes() {
    assert_eq!(check_of(b"123456789"), 0x31C3);
    let mut ours = protocol::cyphal::crc::Crc16::ZERO;
    ours.update(b"123456789");
    assert_eq!(ours.get(), 0x31C3);
}

struct Node {
    value: Vec<u8>,
    /// Segments that the host has confirmed.
    done: usize,
    /// Which segments are lost, counted over all that are sent.
    lost: Vec<usize>,
    sent: usize,
    check: u16,
    has_check: bool,
    ended: bool,
}

impl Node {
    fn with(value: &[u8], lost: &[usize]) -> Self {
        let (value, lost) = (value.to_vec(), lost.to_vec());
        let check = check_of(&value);
        Self { value, done: 0, lost, sent: 0, check, has_check: true, ended: false }
    }

    fn answers(&mut self, asked: &Frame) -> Vec<Frame> {
        let segments = self.value.len().div_ceil(7).max(1);
        let Some((_, request)) = BlockRequest::decode(asked) else { return Vec::new() };
        match request {
            BlockRequest::Read { object, segments } => {
                assert_eq!((object, segments), (SHEET, 127));
                let size = Some(self.value.len() as u32);
                return vec![BlockAnswer::Begins { object, size, has_check: self.has_check }.encode(node())];
            }
            BlockRequest::Start => {}
            BlockRequest::Taken { last, segments } => {
                assert_eq!(segments, 127);
                self.done += usize::from(last);
            }
            BlockRequest::Ended => {
                self.ended = true;
                return Vec::new();
            }
        }
        if self.done == segments {
            let unused = (7 * segments - self.value.len()) as u8;
            return vec![BlockAnswer::Ends { unused, check: self.check }.encode(node())];
        }
        let mut out = Vec::new();
        for k in self.done..segments.min(self.done + 127) {
            let mut bytes = [0; 7];
            bytes.iter_mut().zip(&self.value[7 * k..]).for_each(|(to, from)| *to = *from);
            if !self.lost.contains(&self.sent) {
                let number = (k - self.done + 1) as u8;
                out.push(BlockSegment { number, last: k + 1 == segments, bytes }.encode(node()));
            }
            self.sent += 1;
        }
        out
    }
}

/// Returns the bytes, the outcome of the read, and how many times no frame came.
fn read(played: &mut Node) -> (Vec<u8>, Result<(), Failure>, usize) {
    let (mut read, asked) = LongRead::new(at(0), PATIENCE, node(), SHEET, MOST, Form::Blocks);
    let (mut bytes, mut waited) = (Vec::new(), 0);
    let mut asked = Some(asked);
    for ms in (0..).step_by(100).take(2_000) {
        let answers = asked.take().map_or_else(Vec::new, |asked| played.answers(&asked));
        for answer in answers {
            asked = asked.or(read.handle_frame(at(ms), &answer, &mut |part| bytes.extend(part)));
        }
        if asked.is_none() {
            waited += 1;
            asked = read.handle_timeout(at(ms + 99));
        }
        if let (None, Some(outcome)) = (&asked, read.outcome()) {
            return (bytes, outcome, waited);
        }
    }
    panic!("it does not end");
}

#[test]
fn values_of_every_length_come_whole() {
    for len in [0, 1, 6, 7, 8, 13, 14, 888, 889, 890, 1_778, 5_000, 20_000] {
        let value: Vec<u8> = (0..len).map(|k: usize| (k * 37 + k / 256) as u8).collect();
        let mut played = Node::with(&value, &[]);
        let (bytes, outcome, _) = read(&mut played);
        assert_eq!((bytes == value, outcome, played.ended), (true, Ok(()), true), "{len}");
    }
}

#[test]
fn segments_that_are_lost_are_asked_for_again() {
    let value: Vec<u8> = (0..3_000).map(|k: usize| (k * 41 + k / 256) as u8).collect();
    // The first, one in the middle, the last of a block, the one before, the last of all; several; the first again.
    for lost in [&[0][..], &[60], &[126], &[125], &[428], &[3, 4, 5, 126, 127], &[0, 127]] {
        let mut played = Node::with(&value, lost);
        let (bytes, outcome, waited) = read(&mut played);
        assert_eq!((bytes == value, outcome), (true, Ok(())), "{lost:?}");
        // At the end, and where the end of a block is lost.
        assert!(waited <= 1 + lost.len(), "{lost:?}: {waited}");
    }
}

#[test]
fn a_node_that_falls_silent_or_gives_another_check_sum_ends_the_read() {
    let value = vec![7; 900];
    let all: Vec<usize> = (100..1_000).collect();
    let (_, outcome, _) = read(&mut Node::with(&value, &all));
    assert_eq!(outcome, Err(Failure::TimeOut));
    let mut played = Node { check: 1, ..Node::with(&value, &[]) };
    assert_eq!(read(&mut played).1, Err(Failure::Corrupt));
    assert!(!played.ended);
    let mut played = Node { check: 1, has_check: false, ..Node::with(&value, &[]) };
    assert_eq!(read(&mut played), (value, Ok(()), 1));
}

#[test]
fn frames_have_the_bits_of_the_standard() {
    for (line, request) in [
        ("603 a4 21 10 00 7f 00 00 00", BlockRequest::Read { object: SHEET, segments: 127 }),
        ("603 a3 00 00 00 00 00 00 00", BlockRequest::Start),
        ("603 a2 7f 7f 00 00 00 00 00", BlockRequest::Taken { last: 127, segments: 127 }),
        ("603 a1 00 00 00 00 00 00 00", BlockRequest::Ended),
    ] {
        assert_eq!(BlockRequest::decode(&frame(line)), Some((node(), request)), "{line}");
        assert_eq!((request.encode(node()), Request::decode(&frame(line))), (frame(line), None));
    }
    let begins = BlockAnswer::Begins { object: SHEET, size: Some(0x1234), has_check: true };
    for (line, answer) in [
        ("583 c6 21 10 00 34 12 00 00", begins),
        ("583 d5 c3 31 00 00 00 00 00", BlockAnswer::Ends { unused: 5, check: 0x31C3 }),
    ] {
        assert_eq!(BlockAnswer::decode(&frame(line)), Some((node(), answer)), "{line}");
        assert_eq!((answer.encode(node()), Answer::decode(&frame(line))), (frame(line), None));
    }
    let segment = BlockSegment { number: 3, last: true, bytes: *b"1234567" };
    let line = frame("583 83 31 32 33 34 35 36 37");
    assert_eq!((segment.encode(node()), BlockSegment::decode(&line)), (line, Some((node(), segment))));
    assert_eq!(BlockSegment::decode(&frame("583 80 21 10 00 00 00 02 06")), None);
}

#[test]
fn a_node_without_blocks_is_read_in_segments() {
    for refused in [SHEET, Object::new(0, 0)] {
        let (mut read, _) = LongRead::new(at(0), PATIENCE, node(), SHEET, MOST, Form::Blocks);
        let mut bytes = Vec::new();
        let mut sink = |part: &[u8]| bytes.extend(part);
        let mut answer = |answer: Answer| read.handle_frame(at(1), &answer.encode(node()), &mut sink);
        let plain = answer(Answer::Abort(refused, AbortCode::COMMAND));
        assert_eq!(plain, Some(Request::Read(SHEET).encode(node())));
        let next = answer(Answer::Read(SHEET, Start::Segmented { size: Some(9) }));
        assert_eq!(next, Some(Request::ReadSegment { toggle: false }.encode(node())));
        let part =
            |toggle, bytes: &[u8], last| Answer::Segment(Segment { toggle, bytes: Bytes::of(bytes), last });
        let next = answer(part(false, b"[FileIn", false));
        assert_eq!(next, Some(Request::ReadSegment { toggle: true }.encode(node())));
        assert_eq!(answer(part(true, b"fo", true)), None);
        assert_eq!((read.outcome(), &bytes[..]), (Some(Ok(())), &b"[FileInfo"[..]));
    }
}

#[test]
fn a_value_that_is_too_long_and_a_refusal_end_the_read() {
    let begins = BlockAnswer::Begins { object: SHEET, size: Some(101), has_check: true }.encode(node());
    let (mut read, _) = LongRead::new(at(0), PATIENCE, node(), SHEET, 100, Form::Blocks);
    let abort = Request::Abort(SHEET, AbortCode::LENGTH).encode(node());
    assert_eq!(read.handle_frame(at(1), &begins, &mut |_| ()), Some(abort));
    assert_eq!(read.outcome(), Some(Err(Failure::TooLong { size: 101 })));
    // A node that does not say how long it is.
    let begins = BlockAnswer::Begins { object: SHEET, size: None, has_check: true }.encode(node());
    let (mut read, _) = LongRead::new(at(0), PATIENCE, node(), SHEET, 13, Form::Blocks);
    let mut given = 0;
    assert!(read.handle_frame(at(1), &begins, &mut |_| ()).is_some());
    let mut ended = None;
    for number in 1..=3 {
        let segment = BlockSegment { number, last: false, bytes: [number; 7] }.encode(node());
        ended = read.handle_frame(at(2), &segment, &mut |part| given += part.len());
    }
    assert_eq!((ended, given), (Some(abort), 7));
    let (mut read, _) = LongRead::new(at(0), PATIENCE, node(), SHEET, MOST, Form::Blocks);
    let refused = Answer::Abort(SHEET, AbortCode::NO_OBJECT).encode(node());
    assert_eq!(read.handle_frame(at(1), &refused, &mut |_| ()), None);
    assert_eq!(read.outcome(), Some(Err(Failure::Aborted(AbortCode::NO_OBJECT))));
    // Those of another node change nothing.
    let (mut read, _) = LongRead::new(at(0), PATIENCE, node(), SHEET, MOST, Form::Blocks);
    let other = Answer::Abort(SHEET, AbortCode::NO_OBJECT).encode(NodeId::new(4).unwrap());
    assert_eq!((read.handle_frame(at(1), &other, &mut |_| ()), read.outcome()), (None, None));
}

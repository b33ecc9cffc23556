//! Properties over all frames and values.

use proptest::prelude::*;
use protocol::canopen::block::{BlockAnswer, BlockRequest, BlockSegment};
use protocol::canopen::client::Transfer;
use protocol::canopen::emcy::Emergency;
use protocol::canopen::long_read::{Form, LongRead};
use protocol::canopen::nmt::{Command, State};
use protocol::canopen::pdo::{Entry, Map};
use protocol::canopen::sdo::{Answer, Request};
use protocol::canopen::{Function, Object};
use protocol::{Duration, Frame, Id, Instant, StandardId};

use super::golden::node;

fn frames() -> impl Strategy<Value = Frame> {
    let ids = prop_oneof![Just(0x583), Just(0x603), Just(0), 0..0x800_u16];
    let data = prop_oneof![prop::collection::vec(any::<u8>(), 8), prop::collection::vec(any::<u8>(), 0..=8),];
    (ids, data).prop_map(|(id, data)| Frame::new(Id::Standard(StandardId::new(id).unwrap()), &data).unwrap())
}

proptest! {
    #[test]
    fn any_frame_is_read_or_refused_and_what_is_read_is_written_to_be_read_the_same(frame in frames()) {
        if let Some((node, request)) = Request::decode(&frame) {
            prop_assert_eq!(Request::decode(&request.encode(node)), Some((node, request)));
        }
        if let Some((node, answer)) = Answer::decode(&frame) {
            prop_assert_eq!(Answer::decode(&answer.encode(node)), Some((node, answer)));
        }
        if let Some((node, request)) = BlockRequest::decode(&frame) {
            prop_assert_eq!(BlockRequest::decode(&request.encode(node)), Some((node, request)));
        }
        if let Some((node, answer)) = BlockAnswer::decode(&frame) {
            prop_assert_eq!(BlockAnswer::decode(&answer.encode(node)), Some((node, answer)));
        }
        if let Some((node, segment)) = BlockSegment::decode(&frame) {
            prop_assert_eq!(segment.encode(node), frame);
        }
        if let Some((command, to)) = Command::decode(&frame) {
            prop_assert_eq!(command.encode(to), frame);
        }
        if let Some((node, state)) = State::decode(&frame) {
            prop_assert_eq!(State::decode(&state.encode(node)), Some((node, state)));
        }
        if let Some((node, emergency)) = Emergency::decode(&frame) {
            prop_assert_eq!(emergency.encode(node), frame);
            prop_assert!(!emergency.meaning().is_empty());
        }
        if let Some(function) = Function::of_frame(&frame) {
            prop_assert_eq!(Id::Standard(StandardId::new(function.id()).unwrap()), frame.id());
        }
    }

    #[test]
    fn whatever_a_node_answers_a_transfer_ends_in_time_and_keeps_its_room(
        answers in prop::collection::vec(frames(), 0..40), write in any::<bool>(),
    ) {
        let (now, patience) = (Instant::ZERO, Duration::from_millis(50));
        let object = Object::new(0x1008, 0);
        let mut transfer = if write {
            Transfer::<16>::write(now, patience, node(), object, &[7; 16]).unwrap().0
        } else {
            Transfer::<16>::read(now, patience, node(), object).0
        };
        for answer in &answers {
            let sent = transfer.handle_frame(now, answer);
            prop_assert!(sent.is_none_or(|frame| Request::decode(&frame).is_some()));
        }
        transfer.handle_timeout(now + patience);
        let outcome = transfer.outcome();
        prop_assert!(outcome.is_some_and(|ended| ended.is_err() || ended.unwrap().len() <= 16));
    }

    #[test]
    fn whatever_a_node_answers_a_long_read_ends_in_time_and_gives_no_more_than_it_may(
        answers in prop::collection::vec(frames(), 0..40), blocks in any::<bool>(),
    ) {
        let (now, patience) = (Instant::ZERO, Duration::from_millis(50));
        let object = Object::new(0x1021, 0);
        let form = if blocks { Form::Blocks } else { Form::Segments };
        let (mut read, _) = LongRead::new(now, patience, node(), object, 20, form);
        let mut given = 0;
        for answer in &answers {
            read.handle_frame(now, answer, &mut |part| given += part.len());
        }
        // What came of a block is confirmed once.
        read.handle_timeout(now + patience);
        read.handle_timeout(now + patience * 2);
        prop_assert!(read.outcome().is_some() && given <= 20);
    }

    #[test]
    fn what_is_packed_is_unpacked(sizes in prop::collection::vec(1..=4_u8, 0..=8), values in prop::array::uniform8(any::<i32>())) {
        let entries: Vec<Entry> = sizes.iter().enumerate().map(|(k, bytes)| Entry::new(0x2000 + k as u16, 0, *bytes)).collect();
        let bytes: usize = sizes.iter().map(|bytes| usize::from(*bytes)).sum();
        let Some(map) = Map::new(&entries) else {
            prop_assert!(bytes > 8);
            return Ok(());
        };
        prop_assert!(bytes <= 8 && map.len() == bytes && map.is_empty() == (bytes == 0));
        let packed = map.pack(&values);
        let read = map.unpack(packed.get()).unwrap();
        for ((read, value), bytes) in read.iter().zip(values).zip(&sizes) {
            let shift = 32 - 8 * u32::from(*bytes);
            prop_assert_eq!(*read, value << shift >> shift);
        }
    }
}

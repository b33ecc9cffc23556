//! Any frames on any ids: decoders return, frames that they understand are written in a form that is read as the
//! same, and a transfer ends in time with any answer of a node.
#![no_main]

use protocol::canopen::client::Transfer;
use protocol::canopen::emcy::Emergency;
use protocol::canopen::long_read::{Form, LongRead};
use protocol::canopen::nmt::{Command, State};
use protocol::canopen::pdo::{Entry, Map};
use protocol::canopen::sdo::{Answer, Request};
use protocol::canopen::{Function, NodeId, Object};
use libfuzzer_sys::fuzz_target;
use protocol::{Duration, Instant};
use protocol_fuzz::Input;

fuzz_target!(|bytes: &[u8]| {
    let mut input = Input(bytes);
    let (now, patience) = (Instant::ZERO, Duration::from_millis(50));
    let (node, object) = (NodeId::new(3).expect("a node"), Object::new(0x1008, 0));
    let mut read = Transfer::<16>::read(now, patience, node, object).0;
    let mut write = Transfer::<16>::write(now, patience, node, object, &[7; 16]).expect("it fits").0;
    let mut long = LongRead::new(now, patience, node, object, 1_000, Form::Blocks).0;
    let mut given = 0;
    let map = Map::new(&[Entry::new(0x6041, 0, 2), Entry::new(0x6064, 0, 4)]).expect("six bytes");
    while !input.is_empty() {
        let frame = input.frame();
        if let Some((node, request)) = Request::decode(&frame) {
            assert_eq!(Request::decode(&request.encode(node)), Some((node, request)));
        }
        if let Some((node, answer)) = Answer::decode(&frame) {
            assert_eq!(Answer::decode(&answer.encode(node)), Some((node, answer)));
        }
        if let Some((command, to)) = Command::decode(&frame) {
            assert_eq!(command.encode(to), frame);
        }
        if let Some((node, emergency)) = Emergency::decode(&frame) {
            assert_eq!(emergency.encode(node).data(), &frame.data()[..8]);
        }
        if let Some((node, state)) = State::decode(&frame) {
            assert_eq!(State::decode(&state.encode(node)), Some((node, state)));
        }
        if let Some(function) = Function::of_frame(&frame) {
            assert_eq!(Function::of(function.id()), Some(function));
        }
        if let Some(values) = map.unpack(frame.data()) {
            assert_eq!(map.pack(&values).get(), frame.data());
        }
        read.handle_frame(now, &frame);
        write.handle_frame(now, &frame);
        long.handle_frame(now, &frame, &mut |part| given += part.len());
    }
    for transfer in [&mut read, &mut write] {
        transfer.handle_timeout(now + patience);
        assert!(transfer.outcome().is_some());
    }
    // What came of a block is confirmed once.
    long.handle_timeout(now + patience);
    long.handle_timeout(now + patience * 2);
    assert!(long.outcome().is_some() && given <= 1_000);
});

//! Any sequence of frames at any times: the receiver returns, and its transfers obey its rules. Half of the frames
//! are directed at the ports of the node.
#![no_main]

use libfuzzer_sys::fuzz_target;
use protocol::cyphal::id::{NodeId, Priority, Route, ServiceId, SubjectId};
use protocol::cyphal::rx::{Port, Receiver};
use protocol::{Duration, Frame, Instant};
use protocol_fuzz::Input;

const EXTENT: u16 = 40;

fuzz_target!(|bytes: &[u8]| {
    let mut input = Input(bytes);
    let local = NodeId::from_low_bits(42);
    let service = ServiceId::from_low_bits(384);
    let ports = [
        Port::message(SubjectId::from_low_bits(1234), EXTENT),
        Port::message(SubjectId::from_low_bits(7509), 7).idempotent(),
        Port::request(service, EXTENT),
        Port::response(service, EXTENT),
    ];
    let mut receiver = Receiver::<3, 2, 64>::new();
    let mut now = Instant::ZERO;
    while !input.is_empty() {
        let step = input.byte();
        // Mostly small steps, sometimes beyond every time-out.
        now += Duration::from_millis(1 << (step & 0x0F));
        let frame = if step & 0x80 == 0 {
            input.frame()
        } else {
            let source = NodeId::from_low_bits(input.byte() & 3);
            let route = match step >> 4 & 3 {
                0 => Route::Message { subject: SubjectId::from_low_bits(1234), source },
                1 => Route::Message { subject: SubjectId::from_low_bits(7509), source },
                2 => Route::Request { service, source, destination: local },
                _ => Route::Response { service, source, destination: local },
            };
            let len = usize::from(input.byte() & 0x0F).min(8);
            Frame::new(route.can_id(Priority::Nominal), input.take(len)).expect("at most eight bytes")
        };
        let before = receiver.counters().transfers;
        match receiver.accept(now, Some(local), &frame, &[&ports]) {
            Some(transfer) => {
                assert!(transfer.at <= now);
                assert!(
                    transfer.len <= transfer.payload.len() && transfer.payload.len() <= usize::from(EXTENT)
                );
                assert!(transfer.payload[transfer.len..].iter().all(|byte| *byte == 0));
                assert_ne!(transfer.route.source(), Some(local));
                assert_eq!(receiver.counters().transfers, before + 1);
            }
            None => assert_eq!(receiver.counters().transfers, before),
        }
    }
});

//! Hostile payloads in whole transfers with the right CRC: they arrive as they were sent, and every
//! message type reads them without harm.
#![no_main]

use libfuzzer_sys::fuzz_target;
use protocol::Instant;
use protocol::cyphal::bits::{Decode, Encode, Writer};
use protocol::cyphal::id::{NodeId, Priority, Route, ServiceId, TransferId};
use protocol::cyphal::rx::{Port, Receiver};
use protocol::cyphal::tx::{TxMeta, TxQueue};
use protocol::cyphal::uavcan::register;
use protocol::for_every_cyphal_type;

/// Longest payload the target sends; more than the largest message.
const LEN_MAX: usize = 400;

struct Bytes<'a>(&'a [u8]);

impl Encode for Bytes<'_> {
    fn encode(&self, out: &mut Writer<'_>) {
        out.bytes(self.0);
    }
}

/// A message that is understood is written; to read and write it again changes nothing. Bytes are compared, because
/// a NaN is not equal to itself.
macro_rules! check {
    ($payload:expr, $first:expr, $second:expr, $($message:ty),* $(,)?) => {$(
        if let Ok(message) = <$message>::from_bytes($payload) {
            let len = message.to_bytes(&mut $first).expect("fits");
            let again = <$message>::from_bytes(&$first[..len]).expect("what was written is understood");
            let len_again = again.to_bytes(&mut $second).expect("fits");
            assert_eq!($first[..len], $second[..len_again], stringify!($message));
        }
    )*};
}

fuzz_target!(|bytes: &[u8]| {
    let bytes = &bytes[..bytes.len().min(LEN_MAX)];
    let (service, local) = (ServiceId::from_low_bits(384), NodeId::from_low_bits(42));
    let route = Route::Request { service, source: NodeId::from_low_bits(7), destination: local };
    let mut queue = TxQueue::<2, LEN_MAX>::new();
    let meta = TxMeta {
        route,
        priority: Priority::Nominal,
        transfer_id: TransferId::ZERO,
        deadline: Instant::FAR_FUTURE,
    };
    queue.push(&meta, &Bytes(bytes)).expect("fits");
    let mut receiver = Receiver::<1, 1, LEN_MAX>::new();
    let ports = [Port::request(service, LEN_MAX as u16)];
    let mut received = None;
    while let Some(frame) = queue.pop() {
        assert_eq!(received, None, "a transfer ends with its last frame");
        if let Some(transfer) = receiver.accept(Instant::ZERO, Some(local), &frame, &[&ports]) {
            received = Some((transfer.payload[..transfer.len].to_vec(), transfer.payload.to_vec()));
        }
    }
    let (sent, padded) = received.expect("a whole transfer arrives");
    // The last frame of a transfer may be padded with zeros, never cut.
    assert!(sent.starts_with(bytes) && sent.len() <= bytes.len() + 7);
    // A port list can grow when it is written in the plain form.
    let (mut first, mut second) = ([0; 4096], [0; 4096]);
    for payload in [sent.as_slice(), padded.as_slice()] {
        for_every_cyphal_type!(check, payload, first, second);
        if let Ok(request) = register::AccessRequest::from_bytes(payload) {
            let value = request.value;
            for index in 0..=value.len() {
                let _ = (value.bool(index), value.u64(index), value.i64(index), value.f64(index));
            }
            let _ = value.text();
        }
    }
});

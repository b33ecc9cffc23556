//! Any frame on any id: decoders return, and what they understand encodes to a frame they understand
//! the same way.
#![no_main]

use libfuzzer_sys::fuzz_target;
use protocol::powercube::broadcast::BroadcastFrame;
use protocol::powercube::request::AddressedRequest;
use protocol::powercube::{Address, Reply};
use protocol_fuzz::Input;

fuzz_target!(|bytes: &[u8]| {
    let frame = Input(bytes).frame();
    let address = Address::of(frame.id());
    if let Ok(addressed) = AddressedRequest::decode(&frame) {
        assert!(address.is_some());
        // A request has exactly one form on the wire.
        assert_eq!(addressed.encode(), frame);
    }
    if let Ok(broadcast) = BroadcastFrame::decode(&frame) {
        // The pad byte may be anything and is written as zero.
        let written = broadcast.encode();
        assert_eq!(written.dlc(), frame.dlc());
        assert_eq!(BroadcastFrame::decode(&written), Ok(broadcast));
    }
    if let Ok((module, reply)) = Reply::decode(&frame) {
        // Answers are read tolerantly, so the first written form may be shorter; the second must be equal to it.
        // Frames are compared, because a NaN is not equal to itself.
        let written = reply.encode(module);
        let (same, again) = Reply::decode(&written).expect("what was written is understood");
        assert_eq!((same, again.encode(module)), (module, written));
        if let Ok(addressed) = AddressedRequest::decode(&frame) {
            reply.answers(&addressed.request);
        }
    }
});

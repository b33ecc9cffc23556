//! Any frame on any id: decoders return, and what they understand is written to be understood the same.
#![no_main]

use libfuzzer_sys::fuzz_target;
use protocol::odrive::{Order, Report, Request, Version};
use protocol_fuzz::Input;

fuzz_target!(|bytes: &[u8]| {
    let frame = Input(bytes).frame();
    for version in [Version::V05, Version::V06] {
        let order = Order::decode(&frame, version);
        if let Some((node, order)) = order {
            let (written, _) = order.encode(node, version).expect("what was read is finite");
            assert_eq!(Order::decode(&written, version), Some((node, order)));
        }
        if let Some((node, report)) = Report::decode(&frame, version) {
            assert!(order.is_none());
            // Numbers may be NaN: frames are compared.
            let written = report.encode(node, version);
            let (same, again) = Report::decode(&written, version).expect("what was written is understood");
            assert_eq!((same, again.encode(node, version)), (node, written));
        }
        if let Some((node, request)) = Request::decode(&frame, version) {
            assert_eq!(Request::decode(&request.encode(node), version), Some((node, request)));
        }
    }
});

//! PowerCube M5: host and module side.

use core::hint::black_box;

use protocol::Frame;
use protocol::powercube::broadcast::BroadcastFrame;
use protocol::powercube::request::AddressedRequest;
use protocol::powercube::{FirmwareVersion, Gate, Reply, Request, Value};

/// Every decoder sees the frame; what it understands is encoded again.
pub fn exercise(frame: &Frame) {
    if let Ok(addressed) = black_box(AddressedRequest::decode(frame)) {
        black_box(addressed.encode());
        black_box(addressed.request.encode(addressed.module));
        if let Request::Get(parameter) | Request::Set(parameter, _) = addressed.request {
            let version = FirmwareVersion(black_box(0));
            let info = parameter.info();
            black_box((info.readable(version), info.writable(version), Gate::allows(info_gate(), version)));
            black_box(Request::set(parameter, black_box(Value::U8(0))).is_ok());
        }
        if let Ok((module, reply)) = black_box(Reply::decode(frame)) {
            black_box((reply.answers(&addressed.request), module));
        }
    }
    if let Ok((module, reply)) = black_box(Reply::decode(frame)) {
        black_box(reply.encode(module));
        black_box(reply.is_accepted());
        if let Reply::Value(_, value) = reply {
            black_box(value.as_f64());
        }
        if let Reply::State(state) = reply {
            black_box(state.short());
        }
    }
    if let Ok(broadcast) = black_box(BroadcastFrame::decode(frame)) {
        black_box((broadcast.encode(), broadcast.broadcast.encode()));
    }
}

fn info_gate() -> Gate {
    black_box(Gate::Always)
}
